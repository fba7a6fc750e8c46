"""What fabrication errors do to a design: etching too deep, and etched features that come out too wide.

Too deep moves the zero of the mean phase to another wavelength. Too wide gives the etched levels more area than the
others, so that no wavelength has a zero mean any more (Levin et al. 2013, section 5); the lobe changes little.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.design.depths import Depths, wavelengths

OVER_ETCH_NM = (-10.0, -5.0, -2.0, 0.0, 2.0, 5.0, 10.0)
WIDTH_BIAS_NM = (0.0, 25.0, 50.0, 100.0, 200.0)


@dataclass(frozen=True)
class Tolerance:
    """What one error does.

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
