"""Choice between geometric and wave optics for a surface.

The measure is f/Δc: the width of the mirrors (flat facets, or the pitch of what is curved) over the length on which
light is coherent. All that spreads directions shortens that length: the source, the camera's aperture, and roughness
below the pixels, which counts as a source of the width √(2π)·2h_z·σ of the same peak.

Of steps, the mirrors are the levels.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.light import LightSpectrum
from anisoscope.sim.light.wave.surface import (
    LINES,
    MAX_SHARE,
    Sampling,
    WaveSurface,
    lines_of,
    on_plateaus,
    sampling_of,
)
from anisoscope.sim.light.wave.windows import Window

FLAT = 1.0 / 32.0
"""How far a facet may leave its plane, in wavelengths: a phase of 0.8 rad there and back."""

SMALL_SHARE = 0.1
"""Facets narrower than the width that is stated cover less than this share."""

EDGE_SLOPE = 1.0
SHARP = 32.0
MAINLY = 0.8


@dataclass(frozen=True)
class Axis:
    """Structure of a surface along one axis.

    Attributes:
        width_um: smallest width of flat facets, or the pitch where it is curved; infinite where it does not change.
        flat: it is made of flat facets.
    """

    width_um: float
    flat: bool


@dataclass(frozen=True)
class Structure:
    """Structure of a surface.

    Attributes:
        along_x: along x.
        along_y: along y.
        stepped: level stretches with jumps between them.
    """

    along_x: Axis
    along_y: Axis
    stepped: bool


def structure_of(surface: WaveSurface, wavelength_um: float) -> Structure:
    """Look at up to 48 lines each way."""
    lines = lines_of(surface)
    across = min(surface.shape[0], LINES)
    along_x = _axis(lines[:across], surface.pixel_x_um, wavelength_um)
    along_y = Axis(float("inf"), True)
    if len(lines) > across:
        along_y = _axis(lines[across:], surface.pixel_y_um, wavelength_um)
    return Structure(along_x, along_y, on_plateaus(surface, wavelength_um).cells)


def _axis(lines: list[npt.NDArray[np.float32]], pixel_um: float, wavelength_um: float) -> Axis:
    found = [facet for line in lines for facet in facets_of(line, pixel_um, FLAT * wavelength_um)]
    length = lines[0].size * pixel_um
    if not found:
        return Axis(pixel_um, False)
    if all(flat and width >= length - 2.0 * pixel_um for width, flat in found):
        return Axis(float("inf"), True)
    found.sort()
    covered = np.cumsum([width for width, _ in found])
    at = int(np.searchsorted(covered, SMALL_SHARE * covered[-1]))
    return Axis(float(found[at][0]), found[at][1])


def facets_of(
    line: npt.NDArray[np.float32], pixel_um: float, tolerance_um: float
) -> list[tuple[float, bool]]:
    """Facets of a profile: (width in µm, flat) each; of a curved stretch its pitch.

    The profile is split where it leaves straight lines (Douglas and Peucker 1973). Where two of them meet at an angle
    that a curve within the tolerance would not make, there is an edge; the rest of the joints belong to curves. Walls
    steeper than 45° are no facets. The outermost facets of a line are cut off by its ends and left out where others
    remain.
    """
    from cv2 import approxPolyDP  # noqa: PLC0415 - slow to import

    flatten = 1e-3 * tolerance_um / max(float(np.ptp(line)), tolerance_um)  # distances become vertical ones
    points = np.stack([np.arange(line.size, dtype=np.float32) * 1e-3, line * flatten], axis=-1).astype(
        np.float32
    )
    corners = approxPolyDP(points[:, None], tolerance_um * flatten, closed=False)[:, 0, 0]
    where = np.unique(np.rint(corners / 1e-3).astype(int))
    width, rise = np.diff(where) * pixel_um, np.diff(line[where].astype(np.float64))
    slope = rise / width
    wall = np.abs(slope) > EDGE_SLOPE
    wall |= (np.diff(where) <= 2) & (np.abs(rise) > 4.0 * tolerance_um)
    groups: list[list[int]] = []
    for number in range(width.size):
        if wall[number]:
            groups.append([])
        elif groups and groups[-1] and not _sharp(slope, width, number, tolerance_um):
            groups[-1].append(number)
        else:
            groups.append([number])
    whole = [group for group in groups if group]
    inner = whole[1:-1] if len(whole) > 2 else whole
    return [_facet(group, width, slope) for group in inner]


def _sharp(slope: FloatArray, width: FloatArray, number: int, tolerance_um: float) -> bool:
    bend = abs(slope[number] - slope[number - 1]) * min(width[number], width[number - 1])
    return bool(bend > SHARP * tolerance_um)


def _facet(group: list[int], width: FloatArray, slope: FloatArray) -> tuple[float, bool]:
    total = float(width[group].sum())
    if width[group].max() > MAINLY * total:  # the rest is a pixel at an edge
        return total, True
    falling = np.signbit(slope[group])
    turns = int(np.count_nonzero(falling[1:] != falling[:-1]))
    return total / max(1.0, 0.5 * turns), False


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

EDGE_ERROR, SHADOW_ERROR = 1.05, 2.4


def stepped_error(depth_um: float, width_um: float, wavelength_um: float, slant: float) -> float:
    """Error of scalar waves without shadows on level steps: edges of metal, and shadows of the walls.

    λ/w·(1.05 + 2.4·tan θ)·min(1, 5·d/λ) bounds the error of every order of two-level gratings of aluminium, as a share
    of the brightest one (two thirds of it suffice), and all light that is misplaced or lost. Source: rigorous coupled
    waves of both polarisations, 0 to 45°, w = 2 to 16 µm, d = 60 to 400 nm at 550 nm
    (`tests/sim/light/wave/test_rigorous.py`).

    Args:
        depth_um: d, from the lowest to the highest level.
        width_um: w, of the narrowest steps.
        wavelength_um: of the light.
        slant: tan θ of light or camera from the normal, the larger one.
    """
    share = wavelength_um / width_um * (EDGE_ERROR + SHADOW_ERROR * slant)
    return min(1.0, share * min(1.0, 5.0 * depth_um / wavelength_um))


EDGE_REACH, EDGE_DEPTH, EDGE_SLANT, LEAST_STEP = 0.4, 4.5, 2.0, 0.5


def edge_widening_um(depth_um: float, wavelength_um: float, slant: float) -> float:
    """Largest modulus of the complex widening of etched features that represents the error of scalar waves at edges.

    Every edge adds a wave of its own: that of a strip ε wide, in some phase. A scalar strip that changes sides adds
    (exp(iφ) − 1)·δ/2, φ the phase of a step there and back; so δ = 2ε/|exp(iφ) − 1|, of which the real part is a
    widening and the imaginary one has no counterpart in a scalar wave. One ε explains the orders of all widths: what it
    leaves is a tenth to a third of the error. |ε| ≤ 0.36 λ in gratings and random tiles of aluminium with either
    polarisation near the normal. Source: rigorous coupled waves (`tests/sim/light/wave/test_edges.py`).

    Args:
        depth_um: of the step.
        wavelength_um: of the light.
        slant: tan θ of light or camera from the normal, the larger one.
    """
    strip = EDGE_REACH * min(1.0, EDGE_DEPTH * depth_um / wavelength_um) * wavelength_um
    step = abs(np.exp(4.0j * np.pi * depth_um / wavelength_um) - 1.0)
    return float(2.0 * strip * (1.0 + EDGE_SLANT * slant) / max(step, LEAST_STEP))


@dataclass(frozen=True)
class OpticsChoice:
    """Chosen optics, with the reason.

    Attributes:
        model: "geometric" or "wave".
        reason: one sentence with the numbers.
        stated_error: of the model that was chosen, as a share of the brightest direction, and of all light that is
            misplaced: that of neglecting waves; or of the wave model the numerical one and, of steps, that of scalar
            waves without shadows. Weak directions may be off by a larger share of themselves.
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
    surface: WaveSurface,
    window: Window,
    light: LightSpectrum | None = None,
    h_z: float = 1.0,
    slant: float = 0.0,
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
        slant: tan θ of light or camera from the normal, the largest one.
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
    if model == "wave" and found.stepped:
        depth = float(np.ptp(surface.height_um))
        error += stepped_error(depth, worst.axis.width_um, lines.longest_um, slant)
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
