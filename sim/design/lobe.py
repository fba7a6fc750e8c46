"""Design of a glossy lobe of given width as a mixture of step widths.

Least squares over the corrected closed form of sampling process 1, blurred by the source. Densities are per area, so
that what is solved for are shares of the area; how often a width is drawn follows from them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.wave.claims import blurred_sinc2
from anisoscope.sim.light.wave.sampling import MIN_WIDTH_UM, Widths

POINTS = 401
REACH = 0.5
"""Largest |h| that the fit sees: there even the side lobes of the finest steps are small."""

SINGLE = 0.18
"""Width of the one step that comes closest to a Gaussian of σ_h, times σ_h/λ."""

MOST_WIDTHS = 2000
"""Widths that a mixture is chosen from, at most: the least squares grow with their square."""

SLACK = 1.25
"""How much worse than with steps of any width a fit may be before the least width counts as the limit."""


@dataclass(frozen=True)
class LobeTask:
    """Target lobe along one axis, and manufacturing limits.

    Attributes:
        sigma: σ_h of the Gaussian, in units of h.
        min_width_um: smallest feature.
        max_width_um: widest step that is considered.
        grid_um: widths are whole multiples of it, from the smallest feature on.
        wavelength_um: of the light.
        coherence_um: Δc of the source.

    Raises:
        ModelError: a width or wavelength that is none, or widths that leave no choice.
    """

    sigma: float
    min_width_um: float = MIN_WIDTH_UM
    max_width_um: float = 20.0
    grid_um: float = 0.25
    wavelength_um: float = 0.5
    coherence_um: float = 16.0

    def __post_init__(self) -> None:
        if not 0.0 < self.sigma < 1.0:
            raise ModelError(
                f"the width σ of a lobe must be between 0 and 1 in units of h, not {self.sigma:g}"
            )
        if not (0.0 < self.grid_um <= self.min_width_um < self.max_width_um < np.inf):
            raise ModelError(
                f"step widths from {self.min_width_um:g} to {self.max_width_um:g} µm on a grid of {self.grid_um:g} µm "
                "leave no choice: the smallest feature must be a grid step or more, and less than the largest"
            )
        if self.max_width_um - self.min_width_um > MOST_WIDTHS * self.grid_um:
            raise ModelError(
                f"step widths from {self.min_width_um:g} to {self.max_width_um:g} µm on a grid of {self.grid_um:g} µm "
                f"are more than {MOST_WIDTHS}: take a coarser grid, or a smaller largest width"
            )
        if not (0.1 <= self.wavelength_um <= 20.0 and self.coherence_um > 0.0):
            raise ModelError(
                f"a lobe needs a wavelength of 100 to 20000 nm and a positive coherence length, not "
                f"{1e3 * self.wavelength_um:g} nm and {self.coherence_um:g} µm"
            )

    @property
    def widths_um(self) -> FloatArray:
        """(A,) widths that can be chosen."""
        count = int(np.floor((self.max_width_um - self.min_width_um) / self.grid_um + 1e-9))
        return np.asarray(self.min_width_um + self.grid_um * np.arange(count + 1), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class AxisLobe:
    """The best mixture along one axis.

    Attributes:
        task: what was asked.
        widths_um: (N,) widths that are used.
        shares: (N,) shares of the area, 1 all together.
        probabilities: (N,) p_a, how often each is drawn, 1 all together.
        h: (H,) half vectors.
        target: (H,) wanted density, scaled to the achieved one.
        achieved: (H,) density in µm; of energy 1.
        rel_l2: ‖achieved − target‖/‖target‖; the part of the target that stays out of reach.
        one_width: the same for the best single width.
        intrinsic: the same with steps of any width.
    """

    task: LobeTask
    widths_um: FloatArray
    shares: FloatArray
    probabilities: FloatArray
    h: FloatArray
    target: FloatArray
    achieved: FloatArray
    rel_l2: float
    one_width: float
    intrinsic: float

    @property
    def unreachable(self) -> FloatArray:
        """(H,) target − achieved: as least squares has one minimum only, no mixture of these widths comes closer."""
        return self.target - self.achieved

    @property
    def unreachable_share(self) -> float:
        """Share of the target light that is missing."""
        return float(np.maximum(self.unreachable, 0.0).sum() / self.target.sum())

    @property
    def feasible(self) -> bool:
        """Whether the smallest feature and the source leave the target as reachable as steps can make it."""
        return self.rel_l2 <= SLACK * self.intrinsic

    @property
    def widths(self) -> Widths:
        """The distribution to draw steps from."""
        return Widths(
            tuple(self.widths_um.tolist()), tuple(self.probabilities.tolist()), self.task.min_width_um
        )

    def check(self) -> None:
        """Refuse a target that cannot be reached.

        Raises:
            ModelError: the remedy depends on whether the features or the source are too large.
        """
        if self.feasible:
            return
        start = (
            f"a lobe of σ = {self.task.sigma:g} is out of reach: {100.0 * self.rel_l2:.1f} % of it (L2) would be "
            f"missed, {100.0 * self.intrinsic:.1f} % with steps of any width"
        )
        if self.widths_um[0] > self.task.min_width_um + 1e-9:
            raise ModelError(
                f"{start}; the source with its coherence length of {self.task.coherence_um:g} µm, or steps of at most "
                f"{self.task.max_width_um:g} µm, are too wide for it: take a larger σ, a larger --coherence, or a "
                "larger --max-width"
            )
        raise ModelError(
            f"{start}; features of {self.task.min_width_um:g} µm reach σ = {widest_sigma(self.task):.3f}, and this "
            f"lobe needs features of {needed_width_um(self.task):.2g} µm: take a smaller σ, a smaller --min-width "
            "(electron beams), or --nearest for the nearest lobe"
        )


@dataclass(frozen=True, eq=False)
class LobeDesign:
    """A lobe in two dimensions: rectangles from one distribution of widths along each axis.

    Attributes:
        x: along x.
        y: along y.
    """

    x: AxisLobe
    y: AxisLobe

    @property
    def rel_l2(self) -> float:
        """‖achieved − target‖/‖target‖ over both axes; both are products of their axes."""

        def dots(axis: AxisLobe) -> tuple[float, float, float]:
            t, a = axis.target, axis.achieved
            return float(t @ t), float(a @ a), float(t @ a)

        (tx, ax, cx), (ty, ay, cy) = dots(self.x), dots(self.y)
        return float(np.sqrt(max(0.0, tx * ty + ax * ay - 2.0 * cx * cy) / (tx * ty)))

    def check(self) -> None:
        """Refuse a target that cannot be reached along one of the axes.

        Raises:
            ModelError: see :meth:`AxisLobe.check`.
        """
        self.x.check()
        self.y.check()


def design_lobe(x: LobeTask, y: LobeTask | None = None) -> LobeDesign:
    """Best mixtures of step widths for a Gaussian lobe (Levin et al. 2013, Eq. 15 and 16).

    Args:
        x: along x.
        y: along y; as along x where it is not given.

    Returns:
        The design; ask :meth:`LobeDesign.check` whether it is what was wanted.
    """
    along_x = design_axis(x)
    return LobeDesign(along_x, along_x if y is None or y == x else design_axis(y))


def design_axis(task: LobeTask) -> AxisLobe:
    """Best mixture along one axis: non-negative least squares with a free scale, then normalised to energy 1."""
    h = np.linspace(-REACH, REACH, POINTS)
    target = gaussian(h, task.sigma)
    lobes = _lobes(h, task.widths_um, task)
    weights, rel_l2 = _fitted(lobes, target)
    used = weights > 1e-6 * weights.sum()
    shares = weights[used] / weights[used].sum()
    widths = task.widths_um[used]
    drawn = shares / widths
    return AxisLobe(
        task,
        widths,
        shares,
        drawn / drawn.sum(),
        h,
        target / weights[used].sum(),
        lobes[:, used] @ shares,
        rel_l2,
        min(_alone(column, target) for column in lobes.T),
        _intrinsic(task, h, target),
    )


def gaussian(h: FloatArray, sigma: float) -> FloatArray:
    """exp(−h²/2σ²) (Levin et al. 2013, Eq. 16)."""
    return np.asarray(np.exp(-0.5 * (h / sigma) ** 2))


def _lobes(h: FloatArray, widths_um: FloatArray, task: LobeTask) -> FloatArray:
    f = 2.0 * h / task.wavelength_um
    return np.stack([blurred_sinc2(f, float(width), task.coherence_um) for width in widths_um], axis=1)


def _fitted(lobes: FloatArray, target: FloatArray) -> tuple[FloatArray, float]:
    from scipy.optimize import nnls  # noqa: PLC0415 - slow to import

    weights, rest = nnls(lobes, target)
    return weights, float(rest / np.linalg.norm(target))


def _alone(column: FloatArray, target: FloatArray) -> float:
    scale = float(column @ target) / float(column @ column)
    return float(np.linalg.norm(target - scale * column) / np.linalg.norm(target))


def _intrinsic(task: LobeTask, h: FloatArray, target: FloatArray) -> float:
    """Relative error with steps of any width, and a source of no extent."""
    sharp = replace(task, coherence_um=np.inf)
    return _fitted(_lobes(h, _any_widths(task), sharp), target)[1]


def _any_widths(task: LobeTask) -> FloatArray:
    return np.linspace(0.5, 3.0, 51) * SINGLE * task.wavelength_um / task.sigma


def widest_sigma(task: LobeTask) -> float:
    """Largest σ_h that the smallest feature reaches."""
    narrow = 0.5 * SINGLE * task.wavelength_um / task.min_width_um
    return _bisected(lambda share: _reached(replace(task, sigma=share * narrow)), 1.0, 3.0) * narrow


def needed_width_um(task: LobeTask) -> float:
    """Smallest feature in µm needed for the target σ_h."""
    single = SINGLE * task.wavelength_um / task.sigma
    return _bisected(lambda share: _reached(task, share * single), 0.5, 1.5) * single


def _reached(task: LobeTask, min_width_um: float | None = None) -> bool:
    """Whether a smallest feature reaches the target, apart from what the source blurs."""
    least = task.min_width_um if min_width_um is None else min_width_um
    h = np.linspace(-REACH, REACH, POINTS)
    target = gaussian(h, task.sigma)
    sharp = replace(task, coherence_um=np.inf)
    found = _fitted(_lobes(h, np.unique(np.maximum(_any_widths(task), least)), sharp), target)[1]
    return found <= SLACK * _intrinsic(task, h, target)


def _bisected(true_at: Callable[[float], bool], low: float, high: float) -> float:
    """Largest number at which something still holds that holds at ``low``."""
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if true_at(middle) else (low, middle)
    return low
