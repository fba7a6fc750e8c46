"""Depths of etch passes whose levels have a zero mean phase, at one wavelength or over a band, and their tolerances.

n passes, each masked or not, leave 2ⁿ levels: all sums of the depths. If all are equally likely their mean phase is a
product, |τ(λ)| = Π |cos(2π·h_z·d_i/λ)|: every pass makes it vanish at one wavelength.

Etching too deep moves the zero of the mean phase to another wavelength. Features too wide give the etched levels more
area than the others, so that no wavelength has a zero mean (Levin et al. 2013, section 5); the lobe changes little.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError

MOST_PASSES = 6
SAMPLES = 601
BAND_NM = (400.0, 700.0)


@dataclass(frozen=True)
class Depths:
    """Etch passes and the levels that they leave.

    Attributes:
        passes_nm: depth of every pass, rising.
        band_nm: shortest and longest wavelength that the mean was made small for; equal for one wavelength.
        h_z: z component of the half vector that they are for.
    """

    passes_nm: tuple[float, ...]
    band_nm: tuple[float, float]
    h_z: float = 1.0

    def __post_init__(self) -> None:
        if not self.passes_nm or not min(self.passes_nm) > 0.0 or len(self.passes_nm) > 2 * MOST_PASSES:
            raise ModelError(
                f"steps need levels: one to {2 * MOST_PASSES} etch passes of positive depth in nm, not "
                f"{list(self.passes_nm)}"
            )

    @property
    def levels_nm(self) -> tuple[float, ...]:
        """2ⁿ heights in nm, 0 and below; bit i of a level's number is set if pass i etches it."""
        return level_heights(self.passes_nm)

    @property
    def levels_um(self) -> tuple[float, ...]:
        """The same in µm."""
        return tuple(1e-3 * level for level in self.levels_nm)

    def tau(self, wavelength_nm: FloatArray) -> FloatArray:
        """|τ| at wavelengths in nm."""
        return mean_phases(np.array(self.passes_nm), np.asarray(wavelength_nm, dtype=np.float64), self.h_z)

    def tau_at(self, wavelength_nm: float) -> float:
        """|τ| at one wavelength in nm."""
        return float(self.tau(np.array([wavelength_nm]))[0])

    @property
    def epsilon(self) -> float:
        """Largest |τ| over the band (Levin et al. 2013, Eq. 18, with its modulus and factor of 2)."""
        return float(self.tau(wavelengths(self.band_nm)).max())

    @property
    def worst_nm(self) -> float:
        """Wavelength of the largest |τ| in the band."""
        band = wavelengths(self.band_nm)
        return float(band[self.tau(band).argmax()])

    def spike_over_lobe(
        self, coherence_um: float, width_um: float, wavelength_nm: float | None = None
    ) -> float:
        """Height of the spike over the lobe's, |τ|²·(Δc/a)²/(1 − |τ|²), by default at the worst wavelength."""
        at = self.worst_nm if wavelength_nm is None else wavelength_nm
        share = self.tau_at(at) ** 2
        return float("inf") if share >= 1.0 else share / (1.0 - share) * (coherence_um / width_um) ** 2


def level_heights(passes: tuple[float, ...]) -> tuple[float, ...]:
    """Heights of all 2ⁿ levels, in the unit of the passes: −Σ of the depths whose bit is set."""
    numbers = np.arange(2 ** len(passes))
    bits = (numbers[:, None] >> np.arange(len(passes))) & 1
    return tuple((-(bits @ np.asarray(passes)) + 0.0).tolist())


def mean_phases(passes_nm: FloatArray, wavelength_nm: FloatArray, h_z: float = 1.0) -> FloatArray:
    """|τ| = Π |cos(2π·h_z·d/λ)|; passes (..., n), wavelengths (W,); returns (..., W)."""
    turns = passes_nm[..., :, None] / wavelength_nm
    return np.asarray(np.prod(np.abs(np.cos(2.0 * np.pi * h_z * turns)), axis=-2))


def wavelengths(band_nm: tuple[float, float]) -> FloatArray:
    """(W,) wavelengths of a band, even in 1/λ, as the phase is."""
    low, high = band_nm
    return np.array([low]) if low == high else np.asarray(1.0 / np.linspace(1.0 / low, 1.0 / high, SAMPLES))


def design_depths(
    levels: int, band_nm: tuple[float, float] = BAND_NM, h_z: float = 1.0, seed: int = 0
) -> Depths:
    """Etch passes for K levels with the smallest largest |τ| over a band: global search, then a minimax polish.

    Args:
        levels: K, a power of two.
        band_nm: shortest and longest wavelength; equal for one, where quarter waves make τ vanish.
        h_z: z component of the half vector.
        seed: of the global search.

    Raises:
        ModelError: levels that are no power of two, or a band that is none.
    """
    passes = _passes(levels)
    low, high = band_nm
    if not (100.0 <= low <= high <= 20000.0 and 0.0 < h_z <= 1.0):
        raise ModelError(
            f"a band needs two rising wavelengths of 100 to 20000 nm, h_z 0 to 1, not {low:g},{high:g} and {h_z:g}"
        )
    if low == high:
        return Depths((low / 4.0 / h_z,) * passes, band_nm, h_z)
    found = _polished(_searched(passes, band_nm, seed), band_nm)
    return Depths(tuple(np.sort(found / h_z).tolist()), band_nm, h_z)


def _passes(levels: int) -> int:
    passes = levels.bit_length() - 1
    if levels < 2 or 2**passes != levels or passes > MOST_PASSES:
        raise ModelError(
            f"{levels} levels cannot be etched: n passes leave 2ⁿ levels; take 2, 4, 8, … or {2**MOST_PASSES}"
        )
    return passes


def _searched(passes: int, band_nm: tuple[float, float], seed: int) -> FloatArray:
    from scipy.optimize import Bounds, differential_evolution  # noqa: PLC0415 - slow to import

    band = wavelengths(band_nm)[::4]

    def worst(depths: FloatArray) -> Any:  # noqa: ANN401 - one number for every column
        return mean_phases(depths.T, band).max(axis=-1)

    bounds = Bounds([0.9 * band_nm[0] / 4.0] * passes, [1.1 * band_nm[1] / 4.0] * passes)
    found = differential_evolution(
        worst,
        bounds,
        rng=seed,
        vectorized=True,
        updating="deferred",
        popsize=12,
        maxiter=250,
        tol=1e-8,
        polish=False,
    )
    return np.sort(found.x)


def _polished(depths: FloatArray, band_nm: tuple[float, float]) -> FloatArray:
    """Minimise t with |τ(λ)| ≤ t for all λ: sequential quadratic programming from where the global search ended."""
    from scipy.optimize import NonlinearConstraint, minimize  # noqa: PLC0415 - slow to import

    band = wavelengths(band_nm)

    def signed(x: FloatArray) -> FloatArray:
        return np.asarray(np.prod(np.cos(2.0 * np.pi * x[:-1, None] / band), axis=0))

    start = float(mean_phases(depths, band).max())
    scale = 1.0 / start

    def room(x: FloatArray) -> FloatArray:
        return np.asarray(scale * np.concatenate([x[-1] - signed(x), x[-1] + signed(x)]))

    found = minimize(  # type: ignore[call-overload] # the stubs want options by method
        lambda x: float(scale * x[-1]),
        np.append(depths, start),
        method="SLSQP",
        constraints=NonlinearConstraint(room, 0.0, np.inf),
        options={"maxiter": 200, "ftol": 1e-10},
    ).x[:-1]
    better = mean_phases(found, band).max() < start
    return np.asarray(found if better else depths)


OVER_ETCH_NM = (-10.0, -5.0, -2.0, 0.0, 2.0, 5.0, 10.0)
WIDTH_BIAS_NM = (0.0, 25.0, 50.0, 100.0, 200.0)


@dataclass(frozen=True)
class Tolerance:
    """Effect of one error.

    Attributes:
        over_etch_nm: every pass etches deeper by this.
        width_bias_nm: etched features are wider by this, half of it at each edge.
        tau: |τ| at the wavelength of the design.
        worst_tau: largest |τ| over the band.
        spike_over_lobe: height of the spike over the lobe's at the wavelength of the design.
        lobe_energy: share of the light that is left to the lobe there.
        lobe_change: ‖lobe − intended‖/‖intended‖ of the lobe's shape.
    """

    over_etch_nm: float
    width_bias_nm: float
    tau: float
    worst_tau: float
    spike_over_lobe: float
    lobe_energy: float
    lobe_change: float


def edge_length(tiles: npt.NDArray[np.integer], passes: int, grid_um: float) -> tuple[FloatArray, FloatArray]:
    """(passes,) share of the area that each pass etches, and length of its edges in µm per µm²; of (T, n, n) levels.

    Tiles count as going on at their edges with themselves.
    """
    share, edges = np.empty(passes), np.empty(passes)
    for bit in range(passes):
        mask = ((tiles >> bit) & 1).astype(bool)
        turns = sum(int(np.count_nonzero(mask != np.roll(mask, 1, axis=axis))) for axis in (1, 2))
        share[bit] = mask.mean()
        edges[bit] = turns * grid_um / (mask.size * grid_um**2)
    return share, edges


def mean_phase_of(
    passes_nm: FloatArray, share: FloatArray, wavelength_nm: FloatArray, h_z: float = 1.0
) -> FloatArray:
    """(W,) |τ| of independent passes that etch shares q of the area: Π |1 − q + q·exp(−4πi·h_z·d/λ)|."""
    turns = 2.0 * h_z * passes_nm[:, None] / wavelength_nm
    return np.asarray(np.prod(np.abs(1.0 - share[:, None] * (1.0 - np.exp(-2j * np.pi * turns))), axis=0))


def tolerances(
    depths: Depths,
    tiles: npt.NDArray[np.integer],
    grid_um: float,
    *,
    wavelength_nm: float,
    coherence_um: float,
    width_um: float,
    over_etch_nm: Sequence[float] = OVER_ETCH_NM,
    width_bias_nm: Sequence[float] = WIDTH_BIAS_NM,
) -> tuple[Tolerance, ...]:
    """Each error on its own.

    Args:
        depths: the etch passes.
        tiles: (T, n, n) levels of the design's dots.
        grid_um: of the tiles.
        wavelength_nm: of the design.
        coherence_um: Δc.
        width_um: a, mean width of the steps, for the height of the lobe.
        over_etch_nm: errors of depth.
        width_bias_nm: errors of width.

    Returns:
        One row for every error of depth, then for every error of width but 0.
    """
    _, edges = edge_length(tiles, len(depths.passes_nm), grid_um)
    cases = [(deep, 0.0) for deep in over_etch_nm] + [(0.0, wide) for wide in width_bias_nm if wide != 0.0]
    found = []
    for deep, wide in cases:
        passes = np.array(depths.passes_nm) + deep
        share = np.clip(0.5 + 0.5e-3 * wide * edges, 0.0, 1.0)
        tau = float(mean_phase_of(passes, share, np.array([wavelength_nm]))[0])
        worst = float(mean_phase_of(passes, share, wavelengths(depths.band_nm)).max())
        spike = tau**2 / max(1.0 - tau**2, 1e-12) * (coherence_um / width_um) ** 2
        change = lobe_change(width_um, 1e-3 * wide, coherence_um) if wide else 0.0
        found.append(Tolerance(deep, wide, tau, worst, spike, 1.0 - tau**2, change))
    return tuple(found)


def lobe_change(
    width_um: float, bias_um: float, coherence_um: float, windows: int = 100, seed: int = 0
) -> float:
    """Relative change (L2) of the lobe along one axis where etched steps of mean width a grow, and others shrink.

    From the same random profiles of two levels half a wave apart, with and without the bias; the mean is taken off, so
    that the spike does not count.
    """
    rng = np.random.default_rng(seed)
    steps = max(16, int(np.ceil(7.0 * coherence_um / width_um)))
    signs = rng.choice([-1.0, 1.0], (windows, steps))
    turns = 0.5 * np.diff(signs, axis=1, prepend=signs[:, :1])  # +1 where the unetched begins
    at = np.arange(steps) * width_um
    f = np.linspace(-1.5, 1.5, 121) / width_um
    f = f[np.abs(f) > 0.5 / coherence_um]  # edges alone say nothing about the mean
    spectra = []
    for bias in (0.0, bias_um):
        wave = np.exp(-2j * np.pi * f[:, None, None] * (at + 0.5 * bias * turns)) * turns
        spectra.append(np.mean(np.abs(wave.sum(axis=2)) ** 2, axis=1) / f**2)
    shift = spectra[1] / spectra[1].sum() - spectra[0] / spectra[0].sum()
    return float(np.linalg.norm(shift) / np.linalg.norm(spectra[0] / spectra[0].sum()))
