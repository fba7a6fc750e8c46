"""Where the recipe's height map lies in the pictures, and what pictures and map show on the ground that they share.

Pictures and map are reduced to some points a pitch and cut about their middles first, so that the cost is bounded. It
informs: the verdict compares the means of region and map, which need no place.
"""

from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.errors import AnisoscopeError, RegistrationError
from anisoscope.expectation import Expectation
from anisoscope.measurement import Measured
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe import Recipe
from anisoscope.record import MapPlaceRecord
from anisoscope.registration.maps import MapPlace, place_rendered, render, surface_pixels

FloatArray = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

POINTS_A_PITCH = 12
MAX_POINTS = 256
MAP_POINTS_A_PITCH = 50
MAX_PITCHES = 12


def match_map(
    recipe: Recipe, expected: Expectation, measured: Measured
) -> tuple[MapPlaceRecord | None, str | None]:
    """Where the height map lies, as the record tells it, and a note; None and None where the recipe has no map.

    The tile of a wafer is at no one place: it repeats.
    """
    if expected.surface is None or recipe.is_wafer:
        return None, None
    try:
        return _matched(recipe, expected, measured)
    except AnisoscopeError as problem:
        return None, f"where the height map lies is not known ({problem}): only means are compared"


def _matched(recipe: Recipe, expected: Expectation, measured: Measured) -> tuple[MapPlaceRecord, str | None]:
    assert expected.surface is not None
    pitch_um = recipe.surface.pitch_um
    chosen = [k for k, pose in enumerate(expected.poses) if pose.tilt_deg == expected.poses[0].tilt_deg]
    pixel_um = measured.grid.pixel_mm * 1000.0
    factor = max(1, int(pitch_um / pixel_um / POINTS_A_PITCH))
    pictures = [_reduced(measured.aligned[k], factor) for k in chosen]
    surface = _reduced_map(expected.surface, pitch_um)
    sizes = [n * size for n, size in zip(surface.shape, surface_pixels(surface), strict=True)]
    if min(sizes) < pitch_um + pixel_um * factor:
        raise RegistrationError("it is smaller than one pitch")
    rendered = render(
        surface,
        [expected.poses[k] for k in chosen],
        recipe.material.material(),
        expected.convention,
        pixel_um * factor,
        pitch_um,
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
        return record, f"height map {place.words}"
    shared = _shared(pictures, rendered, place, pixel_um * factor, pitch_um)
    return record.model_copy(update=shared), None


def _reduced(picture: Image, factor: int) -> Image:
    """Means of squares, at most `MAX_POINTS` a side about the middle."""
    rows, cols = (min(size // factor, MAX_POINTS) for size in picture.shape)
    top, left = ((size - n * factor) / 2.0 for size, n in zip(picture.shape, (rows, cols), strict=True))
    # an odd rest would move the middle by half a point
    shift = np.array([[1.0, 0.0, left], [0.0, 1.0, top]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    filled = np.nan_to_num(picture, nan=float(np.nanmean(picture)))
    cut = cv2.warpAffine(filled, shift, (cols * factor, rows * factor), flags=flags)
    small = cv2.resize(cut, (cols, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32)


def _reduced_map(surface: HeightMap, pitch_um: float) -> HeightMap:
    """The middle of a map, some pitches wide, with some points a pitch."""
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


def _shared(
    pictures: list[Image], rendered: list[Image], place: MapPlace, pixel_um: float, pitch_um: float
) -> dict[str, object]:
    """Means of pictures and map over the ground that they share, whole pitches across."""
    shape, size = pictures[0].shape, rendered[0].shape
    offset = (-place.y_um / pixel_um, place.x_um / pixel_um)
    ranges = []
    for wide, small, off, whole in zip(shape, size, offset, (1.0, pitch_um / pixel_um), strict=True):
        low = max(-(wide - 1) / 2.0, off - (small - 1) / 2.0)
        high = min((wide - 1) / 2.0, off + (small - 1) / 2.0)
        count = round(int((high - low + 1.0) / whole) * whole)
        ranges.append((low, max(count, 1)))
    (top, rows), (left, cols) = ranges
    seen = [_window(one, top, left, (rows, cols)) for one in pictures]
    drawn = [_window(one, top - offset[0], left - offset[1], (rows, cols)) for one in rendered]
    return {
        "shared_share": rows * cols / float(shape[0] * shape[1]),
        "measured": tuple(float(one.mean()) for one in seen),
        "predicted": tuple(float(one.mean()) for one in drawn),
    }


def _window(picture: Image, top: float, left: float, shape: tuple[int, int]) -> Image:
    """A cut whose corner is given from the picture's middle."""
    at = (left + (picture.shape[1] - 1) / 2.0, top + (picture.shape[0] - 1) / 2.0)
    shift = np.array([[1.0, 0.0, at[0]], [0.0, 1.0, at[1]]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    cut = cv2.warpAffine(picture, shift, shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(cut, dtype=np.float32)
