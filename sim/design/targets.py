"""Surfaces for any wanted angular reflectance: the mixture of step structures that comes closest (Eq. 15 of the paper).

A target is a picture over half vectors, a radial profile, or a sum of them. What can be mixed are dots of rectangles
a_x × a_y with random levels, dots of anti-mirror blocks, and bare mirror; their densities are per area, so that
non-negative least squares with a free scale gives shares of the area. All of them reflect the same toward h, toward
−h, and mirrored at both axes: what a target has besides is out of reach of any mixture, and so is what is sharper than
the source or wider than the smallest feature. Source: Levin et al. 2013, Eq. 15, corrected: per area, blurred by the
source.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.base.parallel import one_blas_thread
from anisoscope.sim.design.models import (
    AntiMirrorModel,
    LobeModel,
    MirrorModel,
    MixtureModel,
    Single,
    model_density,
)
from anisoscope.sim.light.wave.sampling import MIN_WIDTH_UM

WIDTHS = 12
"""Widths of rectangles along each axis."""

ANTI_WIDTHS = 3
ARRANGEMENTS = ((2, 1), (1, 2), (2, 2), (4, 2), (2, 4))
FAINT_SHARE = 0.005
"""Shares of the area below this are left out, and the rest is solved again."""

MOST_UNREACHABLE = 0.5


@dataclass(frozen=True, eq=False)
class TargetTask:
    """A wanted angular reflectance.

    Attributes:
        wanted: (N, N) density of any scale over h from −reach to reach, rows along rising h_y; not negative.
        reach: largest |h_x| and |h_y|.
        levels: of the steps, a power of two, equally likely with a zero mean phase.
        min_width_um: smallest feature.
        max_width_um: widest step that is considered.
        grid_um: widths are whole multiples of it.
        wavelength_um: of the light.
        coherence_um: Δc of the source.
        dot_um: Δd, which gives a mirror its width.

    Raises:
        ModelError: a target that is none.
    """

    wanted: FloatArray
    reach: float = 0.2
    levels: int = 2
    min_width_um: float = MIN_WIDTH_UM
    max_width_um: float = 20.0
    grid_um: float = 0.25
    wavelength_um: float = 0.5
    coherence_um: float = 16.0
    dot_um: float = 112.0

    def __post_init__(self) -> None:
        if (
            self.wanted.ndim != 2
            or self.wanted.shape[0] != self.wanted.shape[1]
            or not self.wanted.shape[0] % 2
        ):
            raise ModelError(
                f"a target is a square with an odd number of values along each axis, not {self.wanted.shape}"
            )
        if not np.isfinite(self.wanted).all() or self.wanted.min() < 0.0 or self.wanted.max() <= 0.0:
            raise ModelError(
                "a target has no negative values, and some above 0: nothing reflects less than nothing"
            )
        if not 0.0 < self.reach <= 0.5:
            raise ModelError(f"the half vectors of a target reach above 0 and up to 0.5, not {self.reach:g}")
        if not 0.0 < self.grid_um <= self.min_width_um < self.max_width_um < np.inf:
            raise ModelError(
                f"step widths from {self.min_width_um:g} to {self.max_width_um:g} µm on a grid of {self.grid_um:g} µm "
                "leave no choice"
            )

    @property
    def h(self) -> FloatArray:
        """(N,) half vectors of the target."""
        return np.linspace(-self.reach, self.reach, self.wanted.shape[0])


@dataclass(frozen=True, eq=False)
class TargetDesign:
    """The closest mixture.

    Attributes:
        task: what was asked for.
        shares: (M,) of the area, falling, 1 all together.
        models: M models.
        achieved: (N, N) density in µm² on average.
        wanted: (N, N) target in µm², scaled to the mixture.
        rel_l2: ‖achieved − wanted‖/‖wanted‖.
        asymmetric: the same of the part of the target that is not mirror-symmetric about both axes.
    """

    task: TargetTask
    shares: tuple[float, ...]
    models: tuple[Single, ...]
    achieved: FloatArray = field(repr=False)
    wanted: FloatArray = field(repr=False)
    rel_l2: float
    asymmetric: float

    @property
    def unreachable(self) -> FloatArray:
        """(N, N) wanted − achieved: least squares has one minimum, so that no mixture of these comes closer."""
        return self.wanted - self.achieved

    @property
    def unreachable_share(self) -> float:
        """Share of the wanted light that is missing."""
        return float(np.maximum(self.unreachable, 0.0).sum() / self.wanted.sum())

    @property
    def model(self) -> MixtureModel | Single:
        """The mixture, or its only model."""
        if len(self.models) == 1:
            return self.models[0]
        return MixtureModel(shares=self.shares, models=self.models)

    def check(self, most: float = MOST_UNREACHABLE) -> None:
        """Refuse a target of which too much is missing.

        Raises:
            ModelError: the message states the unreachable share and its causes.
        """
        if self.unreachable_share <= most:
            return
        cause = (
            f"{100.0 * self.asymmetric:.0f} % of it (L2) is not mirror-symmetric about both axes, which no mixture of "
            "random steps reflects (design hologram does)"
            if self.asymmetric > 0.5 * self.rel_l2
            else f"features of {self.task.min_width_um:g} µm and a source with a coherence length of "
            f"{self.task.coherence_um:g} µm make nothing so wide, so sharp or so dark in the middle"
        )
        raise ModelError(
            f"{100.0 * self.unreachable_share:.0f} % of the wanted light is out of reach (at most {100.0 * most:.0f} % "
            f"is taken): {cause}; change the target, --min-width or --coherence, or ask for the --nearest"
        )


def radial_target(h: FloatArray, value: FloatArray, points: int, reach: float) -> FloatArray:
    """(points, points) target of a radial profile: values at rising |h|, linear between, 0 beyond.

    Raises:
        ModelError: half vectors that do not rise from 0 or more.
    """
    if h.size < 2 or h[0] < 0.0 or not np.all(np.diff(h) > 0.0):
        raise ModelError("a radial profile needs two rows or more with h rising from 0 or more")
    line = np.linspace(-reach, reach, points)
    radius = np.hypot(*np.meshgrid(line, line))
    return np.asarray(np.interp(radius, h, value, left=float(value[0]), right=0.0))


def design_target(task: TargetTask) -> TargetDesign:
    """Shares of the area of the mixture that comes closest to a target.

    Args:
        task: the target and what can be etched.
    """
    from scipy.optimize import nnls  # noqa: PLC0415 - slow to import

    symmetric = 0.25 * sum(task.wanted[::a, ::b] for a in (1, -1) for b in (1, -1))
    asymmetric = float(np.linalg.norm(task.wanted - symmetric) / np.linalg.norm(task.wanted))
    # a quadrant stands for all of them: what is not symmetric is orthogonal to everything that can be mixed
    middle = task.wanted.shape[0] // 2
    h = task.h[middle:]
    axis = np.where(h > 1e-12, 2.0, 1.0)
    weight = np.sqrt(np.outer(axis, axis)).ravel()
    target = np.asarray(symmetric)[middle:, middle:].ravel() * weight
    models = candidates(task)
    columns = np.stack([density(task, one, h).ravel() * weight for one in models], axis=1)
    scale = np.linalg.norm(columns, axis=0)
    with one_blas_thread():
        small = np.asarray(np.linalg.qr(np.column_stack([columns / scale, target]), mode="r"))
        chosen = np.arange(len(models))
        while True:
            found = nnls(small[:, chosen], small[:, -1])[0] / scale[chosen]
            shares = found / found.sum()
            if shares.min() >= FAINT_SHARE:
                break
            used = shares > 0.0
            chosen = chosen[used] if not used.all() else chosen[shares > shares.min()]
    order = np.argsort(-shares)
    shares, kept = shares[order], [models[chosen[number]] for number in order]
    achieved = np.zeros_like(task.wanted)
    for share, one in zip(shares, kept, strict=True):
        achieved = achieved + share * density(task, one, task.h)
    wanted = task.wanted / float(found.sum())
    return TargetDesign(
        task, tuple((shares / shares.sum()).tolist()), tuple(kept), achieved, wanted,
        float(np.linalg.norm(achieved - wanted) / np.linalg.norm(wanted)), asymmetric,
    )  # fmt: skip


def density(task: TargetTask, model: Single, h: FloatArray) -> FloatArray:
    """(H, H) density in µm² of dots of one model, rows along rising h_y."""
    f = 2.0 * h / task.wavelength_um
    return model_density(model, f, f, task.coherence_um, task.dot_um, 0.0 if model.kind != "mirror" else 1.0)


def candidates(task: TargetTask) -> list[Single]:
    """Candidates of a mixture: rectangles of several widths, anti-mirrors with all levels, and the mirror."""
    found: list[Single] = [
        LobeModel(widths_x_um=(x,), p_a_x=(1.0,), widths_y_um=(y,), p_a_y=(1.0,))
        for x in _widths(task, WIDTHS)
        for y in _widths(task, WIDTHS)
    ]
    found += [
        AntiMirrorModel(arrangement=many, widths_um=(x, y), levels=task.levels)
        for many in ARRANGEMENTS
        if (many[0] * many[1]) % task.levels == 0
        for x in _widths(task, ANTI_WIDTHS)
        for y in _widths(task, ANTI_WIDTHS)
    ]
    return [*found, MirrorModel()]


def _widths(task: TargetTask, count: int) -> Sequence[float]:
    """Different widths on the grid, even in the logarithm."""
    steps = np.geomspace(task.min_width_um, task.max_width_um, count) / task.grid_um
    return sorted(
        {
            float(round(step) * task.grid_um)
            for step in steps
            if round(step) * task.grid_um >= task.min_width_um
        }
    )
