"""Defects of ridged parts, added to a map with a known extent.

Every defect takes its dimensions in µm and a :class:`numpy.random.Generator` where it is random, so that a
spoiled surface can be made again.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.fold import fold
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.period import Period, find_period

BoolArray = npt.NDArray[np.bool_]

LEAST_HEIGHT_UM = 1e-3
STEEPEST_RATIO = 0.6
ASPECT = (0.35, 0.7)
SPREAD_SHARE = 0.06
COVERAGE_TOLERANCE = 0.01
FEW_POINTS = 50
MAX_FUTILE = 400


@dataclass(frozen=True)
class Spoiled:
    """A spoiled map, and the (rows, cols) mask of the points where material was added."""

    map: HeightMap
    mask: BoolArray


@dataclass(frozen=True)
class _Burr:
    """One burr: centre, half length (along y), half width (along x) and height in µm, and its outline."""

    x_um: float
    y_um: float
    half_length_um: float
    half_width_um: float
    height_um: float
    lobes: FloatArray
    bumps: FloatArray

    def scaled(self, factor: float) -> "_Burr":
        return replace(
            self,
            half_length_um=factor * self.half_length_um,
            half_width_um=factor * self.half_width_um,
            height_um=factor * self.height_um,
        )

    def heights(self, x_um: FloatArray, y_um: FloatArray) -> FloatArray:
        """(rows, cols) added height in µm at columns x and rows y; 0 outside."""
        across = (x_um - self.x_um)[None, :] / self.half_width_um
        along = (y_um - self.y_um)[:, None] / self.half_length_um
        angle = np.arctan2(across, along)
        outline = 1.0 + sum(
            a * np.cos(k * angle + phase) for k, (a, phase) in enumerate(self.lobes.tolist(), start=2)
        )
        inside = np.maximum(0.0, 1.0 - (across**2 + along**2) / np.square(outline))
        rough = 1.0 + sum(
            a * np.sin(kx * across + ky * along + phase) for a, kx, ky, phase in self.bumps.tolist()
        )
        return np.asarray(self.height_um * inside**1.5 * rough)


def _draw(
    x_um: float,
    y_um: float,
    height_um: tuple[float, float],
    size_um: tuple[float, float],
    rng: np.random.Generator,
) -> _Burr:
    half_length = 0.5 * rng.uniform(*size_um)
    half_width = half_length * rng.uniform(*ASPECT)
    height = min(rng.uniform(*height_um), STEEPEST_RATIO * half_width)
    lobes = np.column_stack([rng.uniform(0.0, 0.12, 3), rng.uniform(0.0, 2.0 * np.pi, 3)])
    waves = rng.normal(0.0, 4.0, (4, 2))
    bumps = np.column_stack([rng.uniform(0.02, 0.08, 4), waves, rng.uniform(0.0, 2.0 * np.pi, 4)])
    return _Burr(x_um, y_um, half_length, half_width, height, lobes, bumps)


def _crest_phase(surface: HeightMap, pitch_um: float) -> float:
    """Position of the crest lines as a share of the pitch, from the median ridge."""
    folded = fold(surface, pitch_um)
    return float(folded.position[int(np.argmax(folded.height_um))])


class _Layer:
    """Material added so far, and how many measured points it covers."""

    def __init__(self, surface: HeightMap) -> None:
        self.known = np.isfinite(surface.height_um)
        self.added = np.zeros(surface.shape)
        rows, cols = surface.shape
        self.x: FloatArray = np.arange(cols, dtype=np.float64) * surface.pixel_x_um
        self.y: FloatArray = np.arange(rows, dtype=np.float64) * surface.pixel_y_um
        self.covered = 0

    def window(self, burr: _Burr) -> tuple[slice, slice]:
        reach = 1.4
        left, right = np.searchsorted(
            self.x, burr.x_um + reach * burr.half_width_um * np.array([-1.0, 1.0])
        ).tolist()
        top, bottom = np.searchsorted(
            self.y, burr.y_um + reach * burr.half_length_um * np.array([-1.0, 1.0])
        ).tolist()
        return slice(top, bottom), slice(left, right)

    def gain(self, burr: _Burr) -> tuple[tuple[slice, slice], FloatArray, int]:
        """Window, heights and number of newly covered points of a burr."""
        window = self.window(burr)
        height = burr.heights(self.x[window[1]], self.y[window[0]])
        height[(height < LEAST_HEIGHT_UM) | ~self.known[window]] = 0.0
        return window, height, int(np.count_nonzero((height > 0.0) & (self.added[window] == 0.0)))

    def add(self, window: tuple[slice, slice], height: FloatArray, gained: int) -> None:
        self.added[window] = np.maximum(self.added[window], height)
        self.covered += gained


def _place(layer: _Layer, burr: _Burr, missing: float, tolerance: float) -> bool:
    """Add a burr, shrunk if it would cover more than what is missing; False if nothing was gained."""
    for _ in range(12):
        window, height, gained = layer.gain(burr)
        if gained <= missing + tolerance:
            layer.add(window, height, gained)
            return gained > 0
        burr = burr.scaled(max(0.3, 0.97 * np.sqrt(missing / gained)))
    return False


def burrs(
    surface: HeightMap,
    coverage: float,
    *,
    pitch_um: float,
    height_um: tuple[float, float] = (2.0, 8.0),
    size_um: tuple[float, float] = (10.0, 60.0),
    rng: np.random.Generator,
) -> Spoiled:
    """Residue on the crest lines of ridges that run along y.

    In moulding, burrs are plastic that crept into cracks and worn edges of the tool, or that tore and stayed
    at the crest when the part was pulled out; in tooling, chips of cut metal that the cutter left at the edge
    of a groove, copied into every part. Each is a dome, longer along the ridge than across (aspect 1.4 to
    2.9), with an irregular outline and a bumpy top; its slope stays below about 50°, so small ones are low.

    Args:
        surface: the map; missing points stay missing and count neither as covered nor as area.
        coverage: share of the area that burrs cover, 0 to 1; reached within 5 % (relative) as long as the
            area sought holds at least about 50 points.
        pitch_um: distance of the ridges. The crest lines are found by folding the map.
        height_um: least and greatest height of a burr; a burr is at most 0.6 half widths high.
        size_um: least and greatest length of a burr along the ridge.
        rng: source of randomness.

    Returns:
        The spoiled map, nowhere lower than before, and the mask of the points that were raised.

    Raises:
        HeightMapError: a parameter outside its range, or a coverage that cannot be reached with these sizes.
    """
    _check_burrs(surface, coverage, pitch_um, height_um, size_um)
    layer = _Layer(surface)
    target = coverage * np.count_nonzero(layer.known)
    crest = _crest_phase(surface, pitch_um) * pitch_um
    width, length = layer.x[-1], layer.y[-1]
    ridges = np.arange(int(np.ceil(-crest / pitch_um)), int((width - crest) / pitch_um) + 1)
    if ridges.size == 0:
        ridges = np.zeros(1, dtype=np.int64)
    futile, tolerance = 0, COVERAGE_TOLERANCE * target
    while target - layer.covered > max(tolerance, 0.5):
        x = crest + pitch_um * (float(rng.choice(ridges)) + SPREAD_SHARE * float(rng.standard_normal()))
        burr = _draw(x, float(rng.uniform(0.0, length)), height_um, size_um, rng)
        futile = 0 if _place(layer, burr, target - layer.covered, tolerance) else futile + 1
        if futile > MAX_FUTILE and target - layer.covered < FEW_POINTS:
            break
        if futile > MAX_FUTILE:
            raise HeightMapError(
                f"burrs on the crest lines cannot cover {coverage:.1%} of this map "
                f"({layer.covered / layer.known.sum():.1%} reached); ask for less coverage or larger burrs"
            )
    note = {"coverage": coverage, "height_um": list(height_um), "size_um": list(size_um)}
    return Spoiled(surface.with_height(surface.height_um + layer.added, burrs=note), layer.added > 0.0)


def _check_burrs(
    surface: HeightMap,
    coverage: float,
    pitch_um: float,
    height_um: tuple[float, float],
    size_um: tuple[float, float],
) -> None:
    check_heights("height map", surface.height_um)
    if not 0.0 <= coverage < 1.0:
        raise HeightMapError(f"the coverage by burrs must be a share of 0 to 1, not {coverage}")
    if not pitch_um > 0.0:
        raise HeightMapError(f"the pitch must be a positive number of µm, not {pitch_um}")
    for what, (low, high) in (("height", height_um), ("size", size_um)):
        if not 0.0 < low <= high:
            raise HeightMapError(f"the {what} of burrs must be a positive range, not {low} to {high} µm")


def ridge_angle_error(
    surface: HeightMap, delta_deg: float, *, ridge_angle_deg: float, period: Period | None = None
) -> HeightMap:
    """Ridges whose facets are steeper or flatter by δ: heights scaled by tan(θ + δ)/tan θ.

    In tooling, a cutter that was ground or set at a wrong angle; in moulding, a part that shrank unevenly or
    was demoulded too hot and sagged. The lateral layout stays: only the median ridge is scaled, and
    roughness, residue and form, which are the difference from it, keep their heights. On a map without a
    period (fewer than four ridges), all heights are scaled about their mean, roughness included; the origin
    (``ridge_angle_error``, "scaled") says which.

    Args:
        surface: the map, (rows, cols) in µm.
        delta_deg: change δ of the ridge angle in degrees.
        ridge_angle_deg: ridge angle θ of the map in degrees, above 0.
        period: its period, if it is known already.

    Raises:
        HeightMapError: an angle θ or θ + δ outside 0–45°, or nothing was measured.
    """
    if not (0.0 < ridge_angle_deg < 45.0 and 0.0 <= ridge_angle_deg + delta_deg < 45.0):
        raise HeightMapError(
            "ridge angles must be within 0° and 45°, not "
            f"{ridge_angle_deg}° and {ridge_angle_deg + delta_deg}°"
        )
    check_heights("height map", surface.height_um)
    gain = float(np.tan(np.radians(ridge_angle_deg + delta_deg)) / np.tan(np.radians(ridge_angle_deg))) - 1.0
    period = find_period(surface) if period is None else period
    if period.is_periodic:
        folded = fold(surface, period.pitch_um, period.direction_deg)
        shape, scaled = folded.at(folded.phase) - float(np.mean(folded.height_um)), "median ridge"
    else:
        shape, scaled = surface.height_um - np.nanmean(surface.height_um), "all heights"
    note = {"delta_deg": delta_deg, "ridge_angle_deg": ridge_angle_deg, "scaled": scaled}
    return surface.with_height(surface.height_um + gain * shape, ridge_angle_error=note)
