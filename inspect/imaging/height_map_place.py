"""Position of the recipe's height map on the part, by matching its rendered views to the pictures of the poses.

Across the ridges the pattern repeats after one pitch. The pattern of the ridges gives the phase, within half a pitch;
the ridge number and the position along the ridges follow only from marks and roughness that map and picture share. So
the part of the signal that is common to all ridges is removed before whole pitches are compared, and the best position
counts only where it is clearly better than every other one. Otherwise the position is unresolved, and only means are
compared.

Pictures and map are first reduced to a few points per pitch and cropped about their centres, which bounds the cost. The
result is informative: the verdict compares the means of region and map, which need no position.
"""

import hashlib
import io
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cache import LIBRARIES, Cache
from anisoscope.base.errors import AnisoscopeError, MeasurementError, RegistrationError
from anisoscope.imaging.phase_map import crest_of, phase_map
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.prediction.expectation import Expectation
from anisoscope.prediction.recipe_models import lobe_on
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.record.schema import MapPlaceRecord
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.relief import Relief, radiance_maps

Image = npt.NDArray[np.float32]
Spectrum = npt.NDArray[np.complex128]

OPENCV = "opencv-contrib-python-headless"
MIN_RATIO = 1.5
MIN_CORRELATION = 0.2
OTHER_PART = 0.1
"""Correlation below which a map is that of another part, such as a master or a golden one."""
MIN_OVERLAP = 0.3
PHASE_TOLERANCE = 0.25
"""In pitches; reflections, which the rendered map lacks, brighten one side of each groove and so shift the phase."""


@dataclass(frozen=True)
class MapPlace:
    """Position of the centre of the height map in the region.

    Attributes:
        x_um: across the ridges, from the centre of the region.
        y_um: along them.
        phase_um: x_um within ± half a pitch, from the pattern of the ridges; without uncertainty, and shifted by marks.
        correlation: of map and pictures, ridges removed.
        ratio: correlation over that of the best other position.
        resolved: the position is unambiguous; otherwise only means and phase are valid.
    """

    x_um: float
    y_um: float
    phase_um: float
    correlation: float
    ratio: float
    resolved: bool

    @property
    def words(self) -> str:
        """The result in words."""
        if self.resolved:
            return (
                f"the height map lies {self.x_um:+.1f} µm across and {self.y_um:+.1f} µm along the ridges from the "
                f"middle of the region (correlation {self.correlation:.2f}, {self.ratio:.1f} times the next best place)"
            )
        return (
            f"unresolved: only means are compared; the ridges' phase is about {self.phase_um:+.0f} µm, but which ridge "
            f"is which cannot be told (correlation {self.correlation:.2f}, {self.ratio:.1f} times the next best place; "
            f"at least {MIN_CORRELATION:g} and {MIN_RATIO:g} times needed)"
        )

    @property
    def note(self) -> str | None:
        """For the operator, where the map seems to be of this part and is not placed."""
        return None if self.resolved or self.correlation < OTHER_PART else f"height map {self.words}"


def place_rendered(
    aligned: Sequence[Image], rendered: Sequence[Image], pixel_um: float, pitch_um: float
) -> MapPlace:
    """Match the rendered views of the height map (`render`) to the aligned pictures, both of the same pixel size.

    Raises:
        MeasurementError: the ridges of the map are not visible.
    """
    pitch = pitch_um / pixel_um
    phase = _ridge_shift(aligned, rendered, pixel_um, pitch_um)
    best, second, (across, along) = _features(aligned, rendered, phase, pitch)
    ratio = best / max(second, 1e-6)
    x_um, y_um = across * pixel_um, along * pixel_um
    resolved = best >= MIN_CORRELATION and ratio >= MIN_RATIO
    phase_um = (x_um + pitch_um / 2.0) % pitch_um - pitch_um / 2.0 if resolved else phase * pixel_um
    return MapPlace(x_um, y_um, phase_um, best, ratio, resolved)


def surface_pixels(surface: HeightMap) -> tuple[float, float]:
    """Distances of the rows and of the columns of a map in µm."""
    return surface.pixel_y_um, surface.pixel_x_um


VIEWS = "height-map-views"
"""Kind of entry in the cache."""


@lru_cache(maxsize=2)
def render(
    surface: HeightMap,
    poses: tuple[Pose, ...],
    material: Material,
    convention: Convention,
    pixel_um: float,
    pitch_um: float | None = None,
    turn_deg: float = 0.0,
) -> tuple[Image, ...]:
    """Render the height map in each pose on square pixels, the first row farthest along the ridges.

    All parts of a recipe, and place and report of one part, take the same pictures: the last ones are remembered. Of a
    map on which the ridges run askew, the largest rectangle about its middle with sides along and across them.

    Args:
        surface: the height map.
        poses: P poses.
        material: the plastic.
        convention: how the angles are counted.
        pixel_um: size of the pixels.
        pitch_um: after which the surface repeats.
        turn_deg: azimuth on the map of the direction across the ridges.

    Returns:
        P pictures, centred on the map; not to be written to.
    """
    heights = hashlib.sha256(np.ascontiguousarray(surface.height_um).data).hexdigest()
    seen = [(pose.stage_deg, pose.tilt_deg) for pose in poses]
    key = [heights, surface.shape, surface_pixels(surface), seen, asdict(material), asdict(convention)]
    entry = Cache().entry(
        VIEWS, [*key, pixel_um, pitch_um, turn_deg], __name__, libraries=(*LIBRARIES, OPENCV)
    )
    views = entry.result(
        lambda: _views(surface, poses, material, convention, pixel_um, pitch_um, turn_deg),
        _packed,
        lambda content: np.load(io.BytesIO(content), allow_pickle=False),
    )
    views.flags.writeable = False
    return tuple(views)


def _packed(views: Image) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, views)
    return buffer.getvalue()


def _views(
    surface: HeightMap,
    poses: tuple[Pose, ...],
    material: Material,
    convention: Convention,
    pixel_um: float,
    pitch_um: float | None,
    turn_deg: float,
) -> Image:
    """(P, rows, cols) pictures of `render`."""
    to_light, to_camera = directions(poses, convention)
    cos, sin = float(np.cos(np.radians(turn_deg))), float(np.sin(np.radians(turn_deg)))
    sides = [(size - 1) * pixel for size, pixel in zip(surface.shape, surface_pixels(surface), strict=True)]
    inside = min(
        one / (one * abs(cos) + other * abs(sin)) for one, other in (tuple(sides), tuple(reversed(sides)))
    )
    rows, cols = (max(1, int(inside * side / pixel_um + 1e-9)) for side in sides)
    repeat = None if pitch_um is None else pitch_um / cos
    relief = Relief(surface, repeat, direction_deg=turn_deg, turn_deg=turn_deg)
    found = []
    for radiance in radiance_maps(relief, to_light, to_camera, material):
        filled = np.nan_to_num(radiance, nan=float(np.nanmean(radiance)))
        steps = (pixel_um / surface.pixel_x_um, pixel_um / surface.pixel_y_um)
        calm = cv2.GaussianBlur(
            filled, (0, 0), sigmaX=max(0.29 * steps[0], 1e-3), sigmaY=max(0.29 * steps[1], 1e-3)
        )
        column, row = np.meshgrid(np.arange(cols) - (cols - 1) / 2.0, np.arange(rows) - (rows - 1) / 2.0)
        at_column = (cos * column + sin * row) * steps[0] + (filled.shape[1] - 1) / 2.0
        at_row = (filled.shape[0] - 1) / 2.0 + (sin * column - cos * row) * steps[
            1
        ]  # rows of a map rise with +y
        measured = cv2.remap(calm, at_column.astype(np.float32), at_row.astype(np.float32), cv2.INTER_LINEAR)
        found.append(np.asarray(measured, dtype=np.float32))
    return np.stack(found)


def _ridge_shift(
    aligned: Sequence[Image], rendered: Sequence[Image], pixel_um: float, pitch_um: float
) -> float:
    """Shift of the map's centre within ± half a pitch, in pixels, by which its crests stand at those of the part."""
    pitch = pitch_um / pixel_um

    def crest(pictures: Sequence[Image]) -> float:
        cols = pictures[0].shape[1]
        across = np.broadcast_to((np.arange(cols) - 0.5 * (cols - 1)) / pitch, pictures[0].shape)
        return crest_of(pictures, across, 0.0)

    try:
        place = phase_map(aligned, pixel_um, pitch_um, 0.0, 3.0).place
    except (
        MeasurementError
    ):  # texture hides the ridges point by point; their mean over all rows has a phase still
        shift = crest(aligned) - crest(rendered)
    else:
        middle = tuple(slice((size - 1) // 2, size // 2 + 1) for size in place.shape)
        shift = -float(place[middle].mean()) - crest(rendered)
    return float((shift + 0.5) % 1.0 - 0.5) * pitch


def _without_ridges(picture: Image, pitch: float) -> Image:
    """Ln of a picture with the mean ridge profile and slow changes removed."""
    filled = np.nan_to_num(picture, nan=float(np.nanmean(picture)))
    logs = np.log(np.maximum(filled, 1e-3 * float(filled.mean())))
    logs -= np.median(logs, axis=0)
    slow = cv2.GaussianBlur(logs, (0, 0), pitch, borderType=cv2.BORDER_REFLECT)
    return np.asarray(logs - slow, dtype=np.float32)


def _features(
    aligned: Sequence[Image], rendered: Sequence[Image], phase: float, pitch: float
) -> tuple[float, float, tuple[float, float]]:
    """Best correlation of features, the best one elsewhere, and the best position (across, along) in pixels."""
    surface, centre = _correlations(aligned, rendered, pitch)
    rows, cols = np.indices(surface.shape)
    across = cols - centre[1]
    off = (across - phase + pitch / 2.0) % pitch - pitch / 2.0
    allowed = np.where(np.abs(off) <= max(1.5, PHASE_TOLERANCE * pitch), surface, -np.inf)
    row, col = (int(i) for i in np.unravel_index(allowed.argmax(), surface.shape))
    elsewhere = np.hypot(rows - row, cols - col) > max(3.0, 0.25 * pitch)
    second = float(allowed[elsewhere].max(initial=0.0))
    place = (_top(surface[row], col) - centre[1], centre[0] - _top(surface[:, col], row))
    return float(surface[row, col]), second, place


def _correlations(
    aligned: Sequence[Image], rendered: Sequence[Image], pitch: float
) -> tuple[FloatArray, tuple[float, float]]:
    """Mean normalised correlation for every position of the map, and the (row, col) where both centres coincide.

    Pictures are zero-padded, so that a map may extend beyond them; positions with little overlap do not count.
    """
    shape, size = aligned[0].shape, rendered[0].shape
    total, overlap = np.zeros([a + b - 1 for a, b in zip(shape, size, strict=True)]), _Overlap(shape, size)
    for measured, rendered_map in zip(aligned, rendered, strict=True):
        total += overlap.correlations(_without_ridges(measured, pitch), _without_ridges(rendered_map, pitch))
    return total / len(aligned), ((shape[0] + size[0]) / 2.0 - 1.0, (shape[1] + size[1]) / 2.0 - 1.0)


class _Overlap:
    """Relative positions of pictures of one shape over pictures of another."""

    def __init__(self, measured: tuple[int, ...], rendered_map: tuple[int, ...]) -> None:
        self._full = tuple(a + b - 1 for a, b in zip(measured, rendered_map, strict=True))
        self._size = tuple(cv2.getOptimalDFTSize(n) for n in self._full)
        self._ones = self._spectrum(np.ones(measured)), self._spectrum(np.ones(rendered_map))
        self._count = np.maximum(np.rint(self._product(*self._ones)), 1.0)
        self._sufficient = self._count >= MIN_OVERLAP * min(
            int(np.prod(measured)), int(np.prod(rendered_map))
        )

    def _spectrum(self, picture: FloatArray) -> Spectrum:
        return np.asarray(np.fft.rfft2(picture, self._size))

    def _product(self, one: Spectrum, two: Spectrum) -> FloatArray:
        found = np.fft.irfft2(one * two, self._size)
        return np.asarray(found[: self._full[0], : self._full[1]])

    def correlations(self, measured: Image, rendered_map: Image) -> FloatArray:
        """Full normalised cross-correlation of two pictures; 0 where they overlap too little."""
        a, b = measured.astype(np.float64), rendered_map[::-1, ::-1].astype(np.float64)
        of_a, of_b = self._spectrum(a), self._spectrum(b)
        sum_a, sum_b = self._product(of_a, self._ones[1]), self._product(self._ones[0], of_b)
        product = self._product(of_a, of_b) - sum_a * sum_b / self._count
        spread_a = self._product(self._spectrum(a * a), self._ones[1]) - sum_a**2 / self._count
        spread_b = self._product(self._ones[0], self._spectrum(b * b)) - sum_b**2 / self._count
        found = product / np.sqrt(np.maximum(spread_a * spread_b, 1e-12))
        return np.where(self._sufficient, found, 0.0)


def _top(line: FloatArray, at: int) -> float:
    """Sub-point position of a peak: the vertex of a parabola through three points."""
    if not 0 < at < len(line) - 1:
        return float(at)
    before, top, after = line[at - 1 : at + 2]
    bend = before - 2.0 * top + after
    return float(at + (np.clip(0.5 * (before - after) / bend, -0.5, 0.5) if bend < 0.0 else 0.0))


POINTS_A_PITCH = 12
MAX_POINTS = 256
MAP_POINTS_A_PITCH = 50
MAX_PITCHES = 12


def match_map(
    recipe: SurfaceRecipe, expected: Expectation, measured: Measured
) -> tuple[MapPlaceRecord | None, str | None]:
    """Record of the height map's position, and a note; None and None where the recipe has no map."""
    if expected.surface is None:
        return None, None
    try:
        return _matched(recipe, expected, measured)
    except AnisoscopeError as problem:
        return None, f"where the height map lies is not known ({problem}): only means are compared"


def _matched(
    recipe: SurfaceRecipe, expected: Expectation, measured: Measured
) -> tuple[MapPlaceRecord, str | None]:
    assert expected.surface is not None
    pitch_um = recipe.surface.pitch_um
    chosen = [k for k, pose in enumerate(expected.poses) if pose.tilt_deg == expected.poses[0].tilt_deg]
    pixel_um = measured.grid.pixel_mm * 1000.0
    factor = max(1, int(pitch_um / pixel_um / POINTS_A_PITCH))
    pictures = [reduced_picture(measured.aligned[k], factor) for k in chosen]
    surface = reduced_map(expected.surface, pitch_um)
    sizes = [n * size for n, size in zip(surface.shape, surface_pixels(surface), strict=True)]
    if min(sizes) < pitch_um + pixel_um * factor:
        raise RegistrationError("it is smaller than one pitch")
    rendered = render(
        surface,
        tuple(expected.poses[k] for k in chosen),
        lobe_on(Relief(expected.surface, direction_deg=expected.turn_deg), recipe),
        expected.convention,
        pixel_um * factor,
        pitch_um,
        expected.turn_deg,
    )
    place = place_rendered(pictures, rendered, pixel_um * factor, pitch_um)
    record = MapPlaceRecord(
        x_um=place.x_um if place.resolved else None,
        y_um=place.y_um if place.resolved else None,
        phase_um=place.phase_um,
        correlation=place.correlation,
        ratio=min(place.ratio, 1e6),
        resolved=place.resolved,
        says=place.words,
    )
    if not place.resolved:
        return record, place.note
    shared = _shared(pictures, rendered, place, pixel_um * factor, pitch_um)
    if recipe.surface.bounces != 1:
        # what is reflected again is even over the map: that of the prediction is added to the rendered direct light
        again = [expected.radiance[k] - float(one.mean()) for k, one in zip(chosen, rendered, strict=True)]
        means = tuple(one + more for one, more in zip(shared.predicted, again, strict=True))
        shared = shared._replace(predicted=means)
    return record.model_copy(update=shared._asdict()), None


def reduced_picture(picture: Image, factor: int) -> Image:
    """Block means about the centre, at most `MAX_POINTS` per side."""
    rows, cols = (min(size // factor, MAX_POINTS) for size in picture.shape)
    top, left = ((size - n * factor) / 2.0 for size, n in zip(picture.shape, (rows, cols), strict=True))
    # an odd remainder would move the centre by half a point
    shift = np.array([[1.0, 0.0, left], [0.0, 1.0, top]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    filled = np.nan_to_num(picture, nan=float(np.nanmean(picture)))
    cut = cv2.warpAffine(filled, shift, (cols * factor, rows * factor), flags=flags)
    small = cv2.resize(cut, (cols, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32)


@lru_cache(maxsize=2)
def reduced_map(surface: HeightMap, pitch_um: float) -> HeightMap:
    """The centre of a map, a few pitches wide, with a few points per pitch."""
    steps, cuts = [], []
    for size, pixel in zip(surface.shape, surface_pixels(surface), strict=True):
        step = max(1, int(pitch_um / MAP_POINTS_A_PITCH / pixel))
        half = min(size - 1, int(MAX_PITCHES * pitch_um / pixel)) // 2 // step * step
        middle = (size - 1) // 2
        steps.append(step)
        cuts.append(slice(max(middle - half, 0), middle + half + 1, step))
    return replace(
        surface,
        height_um=surface.height_um[cuts[0], cuts[1]],
        pixel_x_um=surface.pixel_x_um * steps[1],
        pixel_y_um=surface.pixel_y_um * steps[0],
    )


class _Shared(NamedTuple):
    shared_share: float
    measured: tuple[float, ...]
    predicted: tuple[float, ...]


def _shared(
    pictures: Sequence[Image], rendered: Sequence[Image], place: MapPlace, pixel_um: float, pitch_um: float
) -> _Shared:
    """Means of pictures and map over their common area, whole pitches across."""
    shape, size = pictures[0].shape, rendered[0].shape
    offset = (-place.y_um / pixel_um, place.x_um / pixel_um)
    ranges = []
    for wide, small, off, whole in zip(shape, size, offset, (1.0, pitch_um / pixel_um), strict=True):
        low = max(-(wide - 1) / 2.0, off - (small - 1) / 2.0)
        high = min((wide - 1) / 2.0, off + (small - 1) / 2.0)
        count = round(int((high - low + 1.0) / whole) * whole)
        ranges.append((low, max(count, 1)))
    (top, rows), (left, cols) = ranges
    measured = [_window(one, top, left, (rows, cols)) for one in pictures]
    rendered_map = [_window(one, top - offset[0], left - offset[1], (rows, cols)) for one in rendered]
    return _Shared(
        rows * cols / float(shape[0] * shape[1]),
        tuple(float(one.mean()) for one in measured),
        tuple(float(one.mean()) for one in rendered_map),
    )


def _window(picture: Image, top: float, left: float, shape: tuple[int, int]) -> Image:
    """A crop whose corner is given relative to the picture's centre."""
    at = (left + (picture.shape[1] - 1) / 2.0, top + (picture.shape[0] - 1) / 2.0)
    shift = np.array([[1.0, 0.0, at[0]], [0.0, 1.0, at[1]]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    cut = cv2.warpAffine(picture, shift, shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(cut, dtype=np.float32)
