"""Which optics a surface needs: rays, or waves.

The measure is f/Δc: the width of the mirrors (flat facets, or the pitch of what is curved) over the length on which
light is coherent. All that spreads directions shortens that length: the source, the camera's aperture, and roughness
below the pixels, which counts as a source of the width √(2π)·2h_z·σ of the same peak.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from anisoscope.sim.light.wave.reflectance import LightSpectrum
from anisoscope.sim.light.wave.structure import Axis, structure_of
from anisoscope.sim.light.wave.surface import MAX_SHARE, Sampling, WaveSurface, sampling_of
from anisoscope.sim.light.wave.windows import Window

WAVE_BELOW = 8.0
SMOOTH_FROM = 16.0
FLAT_FROM = 32.0
SHARP_ERROR = 1.4
"""Error of the geometric model times f/Δc under a source and an aperture with edges.

A facet misplaces (ln(2π·f/Δc) + γ + 1)/π² times Δc/f of its light, 0.70 at 32 and 0.82 at 128 coherence lengths.
"""

ROUGH_ERROR = 0.7
"""The same under a Gaussian: the middle of a lobe is off by up to 0.63, of which a facet alone makes 1/π and the ridges
beside it the rest; of the light 0.39 is misplaced, half by the facets and half by their walls."""

NUMERICAL_ERROR = 5e-4


@dataclass(frozen=True)
class OpticsChoice:
    """Which optics, and why.

    Attributes:
        model: "geometric" or "wave".
        reason: one sentence with the numbers.
        stated_error: of the model that was chosen, as a share of the brightest direction, and of all light that is
            misplaced: that of neglecting waves, or the numerical one of the wave model. Weak directions may be off
            by a larger share of themselves.
        f_um: width of the mirrors along the axis that decides, in µm.
        coherence_um: effective coherence length along it, in µm.
        stepped: the surface is made of level steps.
        sampling: how finely the map samples the phase.
    """

    model: Literal["geometric", "wave"]
    reason: str
    stated_error: float
    f_um: float
    coherence_um: float
    stepped: bool
    sampling: Sampling

    @property
    def is_sampled(self) -> bool:
        """The wave model can be had from this map without interpolation."""
        return self.sampling.share <= MAX_SHARE


def effective_coherence_um(window: Window, wavelength_um: float, h_z: float = 1.0) -> tuple[float, float]:
    """Δc,eff in µm along x and y: λ over all that spreads directions; infinite where nothing does."""
    edges = 2.0 * np.add(window.source.reach, window.aperture.reach)
    total = np.hypot(edges, _rough_extent(window, h_z))
    x, y = (wavelength_um / extent if extent > 0.0 else float("inf") for extent in total.tolist())
    return x, y


def _rough_extent(window: Window, h_z: float) -> tuple[float, float]:
    if window.slope_variance is None:
        return 0.0, 0.0
    x, y = (np.sqrt(2.0 * np.pi) * 2.0 * h_z * np.sqrt(np.diag(window.slope_variance))).tolist()
    return x, y


def choose_optics(
    surface: WaveSurface, window: Window, light: LightSpectrum | None = None, h_z: float = 1.0
) -> OpticsChoice:
    """Choose the optics for a height map.

    Steps, or f < 8·Δc: wave. Geometric for smooth or rough surfaces from f = 16·Δc on, for flat facets from 32·Δc on,
    and from 8·Δc on where roughness below the pixels spreads light more than source and aperture do: its edge is soft.
    Between, wave where the map samples the phase. Where it does not, geometric with its stated error.

    Args:
        surface: the heights; they need not be sampled finely enough for the wave model.
        window: source, aperture and unresolved roughness.
        light: the wavelengths; 550 nm by default. The longest decides on coherence, the shortest on sampling.
        h_z: z component of h, at most 1.
    """
    lines = LightSpectrum() if light is None else light
    found = structure_of(surface, lines.shortest_um)
    coherence = effective_coherence_um(window, lines.longest_um, h_z)
    sampling = sampling_of(surface, lines.shortest_um, h_z)
    rough = _rough_extent(window, h_z)
    edges = 2.0 * np.add(window.source.reach, window.aperture.reach)
    cases = [
        _Case(axis, length, rough[n] > edges[n])
        for n, (axis, length) in enumerate(zip((found.along_x, found.along_y), coherence, strict=True))
    ]
    worst = max(cases, key=lambda case: case.error)
    sampled = sampling.share <= MAX_SHARE
    model: Literal["geometric", "wave"] = "wave"
    if not sampled or (not found.stepped and worst.ratio >= worst.geometric_from):
        model = "geometric"
    reason = _reason(worst, model, found.stepped, sampling)
    error = NUMERICAL_ERROR if model == "wave" else _geometric_error(worst, found.stepped)
    return OpticsChoice(
        model, reason, error, worst.axis.width_um, worst.coherence_um, found.stepped, sampling
    )


@dataclass(frozen=True)
class _Case:
    axis: Axis
    coherence_um: float
    soft: bool

    @property
    def ratio(self) -> float:
        if np.isinf(self.axis.width_um):
            return float("inf")
        return self.axis.width_um / self.coherence_um

    @property
    def error(self) -> float:
        factor = ROUGH_ERROR if self.soft else SHARP_ERROR
        return min(1.0, factor / self.ratio) if self.ratio > 0.0 else 1.0

    @property
    def geometric_from(self) -> float:
        if self.soft:
            return WAVE_BELOW
        return FLAT_FROM if self.axis.flat else SMOOTH_FROM


def _geometric_error(worst: _Case, stepped: bool) -> float:
    return 1.0 if stepped else worst.error


def _reason(worst: _Case, model: str, stepped: bool, sampling: Sampling) -> str:
    what = "flat facets" if worst.axis.flat else "structures"
    if np.isinf(worst.axis.width_um):
        size = "the surface is plain"
    else:
        size = (
            f"{what} of {worst.axis.width_um:.3g} µm are {worst.ratio:.3g} × the coherence length of "
            f"{worst.coherence_um:.3g} µm"
        )
    if model == "wave":
        return (
            f"the surface is stepped; {size}: wave"
            if stepped
            else f"{size}, below {worst.geometric_from:g}: wave"
        )
    if not stepped and worst.ratio >= worst.geometric_from:
        return f"{size}, at least {worst.geometric_from:g}: geometric within {worst.error:.2g}"
    start = "the surface is stepped" if stepped else f"{size}, below {worst.geometric_from:g}"
    return (
        f"{start}, but {sampling.share:.1%} of the pixels are too coarse for waves (they resolve "
        f"{sampling.slope_deg:.1f}°): geometric, off by up to {_geometric_error(worst, stepped):.2g}"
    )
