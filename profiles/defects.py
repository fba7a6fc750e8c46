"""Defects of ridged parts, added to a map with a known extent.

Every defect takes its dimensions in µm and a :class:`numpy.random.Generator` where it is random, so that a
spoiled surface can be made again.

Among them are defects of the shape of ridges: incomplete filling, wrong pitch, missing ridges, chatter of the cutter.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.defects_layout import RidgeLayout, positions, ridge_layout, ridge_numbers
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.fold import Folded, fold
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


def incomplete_filling(surface: HeightMap, loss: float, *, gradient: float = 0.0) -> HeightMap:
    """Crests that end in a plateau because the melt froze before it reached the tip of the groove.

    In moulding: melt or mould too cold, packing pressure too low or too late, trapped air, a wall too thin far from
    the gate. Everything above the foot plus (1 − loss) of the height of the median ridge is cut off.

    Args:
        surface: the map, with ridges.
        loss: share of the ridge height that is missing, 0 to 1.
        gradient: the loss grows along +y from (1 − gradient)·loss to (1 + gradient)·loss, as it does away from the
            gate; −1 to 1.

    Raises:
        HeightMapError: a parameter outside its range, or no ridges.
    """
    if not 0.0 <= loss <= 1.0:
        raise HeightMapError(f"the loss must be a share of 0 to 1, not {loss}")
    if not -1.0 <= gradient <= 1.0:
        raise HeightMapError(f"the gradient must be within −1 and 1, not {gradient}")
    layout = ridge_layout(surface)
    place = np.linspace(-1.0, 1.0, surface.shape[0])[:, None]
    local = np.clip(loss * (1.0 + gradient * place), 0.0, 1.0)
    limit = layout.foot_um + (1.0 - local) * (layout.crest_um - layout.foot_um)
    # without loss nothing is cut, although peaks stand above the median crest
    cut = np.where(local > 0.0, np.maximum(layout.levelled_um - limit, 0.0), 0.0)
    return surface.with_height(surface.height_um - cut)


def pitch_error(surface: HeightMap, error_percent: float) -> HeightMap:
    """Ridges cut with a wrong feed: another pitch, the same angles, and so heights in proportion.

    In tooling: wrong feed per groove, a worn or hot lead screw; in moulding: wrong allowance for shrinkage. The median
    ridge is exchanged for one that is larger by the error in width and height; roughness, residue and form, which are
    the difference from it, stay where they are.

    Args:
        surface: the map, with ridges.
        error_percent: change of the pitch in percent, above −90.

    Raises:
        HeightMapError: a parameter outside its range, or no ridges.
    """
    if not error_percent > -90.0:
        raise HeightMapError(f"the pitch cannot change by {error_percent}%; −90% is the limit")
    layout = ridge_layout(surface)
    factor = 1.0 + 0.01 * error_percent
    across, _ = positions(surface, layout.period.direction_deg)
    now, mean = layout.folded, float(np.mean(layout.folded.height_um))
    target = factor * (now.at(np.mod(across / (factor * layout.period.pitch_um), 1.0)) - mean)
    return surface.with_height(surface.height_um + target - (now.at(now.phase) - mean))


def missing_ridges(surface: HeightMap, share: float, *, rng: np.random.Generator) -> HeightMap:
    """Missing ridges: the surface stays at the level of the foot.

    In moulding: grooves of the tool clogged with residue or plastic; in tooling: passes skipped, a broken cutter. The
    median ridge is taken off from foot to foot; roughness stays.

    Args:
        surface: the map, with ridges.
        share: share of the ridges that are missing, 0 to 1, rounded to whole ridges.
        rng: draws which ones; more of them include fewer.

    Raises:
        HeightMapError: a share outside its range, or no ridges.
    """
    if not 0.0 <= share <= 1.0:
        raise HeightMapError(f"the share of missing ridges must be 0 to 1, not {share}")
    layout = ridge_layout(surface)
    number = ridge_numbers(surface, layout)
    order = rng.permutation(int(number.max()) + 1)
    gone = np.zeros(order.size, dtype=np.bool_)
    gone[order[: round(share * order.size)]] = True
    return surface.with_height(surface.height_um - np.where(gone[number], _ridge(layout), 0.0))


def _ridge(layout: RidgeLayout) -> FloatArray:
    """(rows, cols) height of the median ridge above its foot in µm."""
    folded: Folded = layout.folded
    return folded.at(folded.phase) - layout.foot_um


def chatter(
    surface: HeightMap,
    amplitude_um: float,
    *,
    wavelength_um: float = 80.0,
    phase_step: float = 0.25,
    jitter: float = 0.1,
    rng: np.random.Generator,
) -> HeightMap:
    """Waves along the ridges, left by a cutter that vibrated while it cut the tool.

    In tooling: resonance of cutter, holder or spindle; wavelength = cutting speed / frequency. Each ridge is one pass:
    the whole ridge goes up and down with amplitude·cos(2π·(v/wavelength + phase)); from pass to pass the phase moves
    on by a step, with some jitter. A map without ridges counts as one pass along +y.

    Args:
        surface: the map.
        amplitude_um: amplitude in µm.
        wavelength_um: wavelength along the ridges in µm, at least two pixels.
        phase_step: shift from ridge to ridge as a share of the wavelength.
        jitter: standard deviation of that shift, as a share of the wavelength.
        rng: source of randomness.

    Raises:
        HeightMapError: a parameter outside its range.
    """
    check_heights("height map", surface.height_um)
    if not amplitude_um >= 0.0 or not jitter >= 0.0:
        raise HeightMapError(
            f"amplitude and jitter of chatter must not be negative, not {amplitude_um} µm and {jitter}"
        )
    if not wavelength_um >= 2.0 * max(surface.pixel_x_um, surface.pixel_y_um):
        raise HeightMapError(
            f"chatter of {wavelength_um:g} µm is shorter than two pixels; take a longer wave"
        )
    period = find_period(surface)
    direction = period.direction_deg if period.is_periodic else 0.0
    _, along = positions(surface, direction)
    if period.is_periodic:
        folded = fold(surface, period.pitch_um, direction)
        number = ridge_numbers(surface, RidgeLayout(period, surface.height_um, folded))
    else:
        number = np.zeros(surface.shape, dtype=np.int64)
    steps = phase_step + jitter * rng.standard_normal(int(number.max()) + 1)
    phase = rng.random() + np.cumsum(steps)
    wave = np.cos(2.0 * np.pi * (along / wavelength_um + phase[number]))
    return surface.with_height(surface.height_um + amplitude_um * wave)
