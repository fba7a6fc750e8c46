"""What a plate shows: the mean radiance of every field in every pose, and whether it is the plate of the plan."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError, RegistrationError
from anisoscope.imaging.pose_radiance import check_light, check_view
from anisoscope.imaging.quality_gates import check_views
from anisoscope.imaging.registration.placement import Grid, View, resample
from anisoscope.kinds.plates.code_symbol import read_plate
from anisoscope.kinds.plates.expectation import ExpectedPlate, Lying
from anisoscope.kinds.plates.field_places import FieldPlaces, field_places
from anisoscope.kinds.plates.recipe import PlateRecipe
from anisoscope.profiles.plates import Plan

Image = npt.NDArray[np.float32]

LEAST_PIXELS = 8
"""Camera pixels along the side of a field."""
ALIKE = 0.8
"""Correlation with the plan below which a plate is another one."""
CLOSER = 0.1
"""By how much ln L of another position of the plate must fit better, on average over the fields."""
FITS = 0.3
"""Mean distance of ln L from the best position up to which the plate is that of the plan, lying otherwise."""
LEVEL = 0.4
"""Largest common difference of ln L that is left out when positions are compared: plastic and lamp."""
FARTHEST = 1.0
UNLIKE_SHARE = 0.35
"""Scatter of ln L over the fields, by that of the plan, below which a plate shows no fields at all."""
LEAST_SCATTER = 0.05
"""Scatter of ln L over the fields of a plan below which there is nothing to correlate with."""
MOST_MISSING = 0.02
MOST_SHIFT, MOST_TURN_DEG = 0.25, 2.0
"""Shift in fields, and turn against the fixture, beyond which a plate does not lie in its seat."""
LEAST_FOLLOWED = 0.05
"""Shift in fields from which on the fields are measured where they lie."""


@dataclass(frozen=True, eq=False)
class MeasuredPlate:
    """Measurement of a plate.

    Attributes:
        radiance: (P, rows, cols) mean radiance of every field in 1/sr.
        u_place: (P, rows, cols) relative standard uncertainty from the place of the field.
        noise: (P,) relative standard uncertainty of a field from noise.
        aligned: P pictures of the plate, first row at the top.
        grid: their raster.
        drift: change of the first pose until the end, or None.
        alike: correlation with the plan.
        texts: what the code says in every pose; None where it is not read, or the plate has none.
        places: where the fields lie in every pose; None where too few borders show.
    """

    radiance: FloatArray
    u_place: FloatArray
    noise: FloatArray
    aligned: tuple[Image, ...]
    grid: Grid
    drift: float | None
    alike: float
    texts: tuple[str | None, ...]
    places: tuple[FieldPlaces | None, ...] = ()


def plate_grid(recipe: PlateRecipe, plan: Plan, pixel_um: float) -> tuple[Grid, int]:
    """Raster of the plate, a whole number of points a field, and that number.

    Raises:
        MeasurementError: the camera does not resolve the fields.
    """
    points = round(1000.0 * plan.module_mm / pixel_um)
    if points < LEAST_PIXELS:
        raise MeasurementError(
            f"fields of {1000.0 * plan.module_mm:g} µm are {points} pixels of {pixel_um:g} µm wide, {LEAST_PIXELS} are "
            "needed: take a lens of higher magnification, or larger fields"
        )
    rows, cols = plan.shape
    step = plan.module_mm / points
    shape = rows * points, cols * points
    return Grid(recipe.region.center_mm, step, shape, recipe.poses.facet_azimuth_deg), points


def field_means(picture: Image, points: int, interior: float, shift: tuple[int, int] = (0, 0)) -> FloatArray:
    """(rows, cols) means over the middle of every field; NaN where a part has no value."""
    rows, cols = picture.shape[0] // points, picture.shape[1] // points
    width = max(2, round(interior * points))
    first = (points - width) // 2
    y, x = first + shift[0], first + shift[1]
    blocks = picture.reshape(rows, points, cols, points)[:, y : y + width, :, x : x + width]
    known = np.isfinite(blocks)
    count = known.sum(axis=(1, 3))
    total = np.where(known, blocks, 0.0).sum(axis=(1, 3), dtype=np.float64)
    return np.where(count > 0.5 * width * width, total / np.maximum(count, 1), np.nan)


def measure_plate(
    views: list[View], closing: View | None, recipe: PlateRecipe, expected: ExpectedPlate, pixel_um: float
) -> MeasuredPlate:
    """Measure every field.

    Raises:
        MeasurementError: INVALID, with the reason.
    """
    for view in [*views, *([closing] if closing else [])]:
        check_light(view.stage_deg, view.image, recipe)
        alike = next(first for first in views if first.tilt_deg == view.tilt_deg)
        check_view(view, alike, recipe, pixel_um)
    check_views(views)
    grid, points = plate_grid(recipe, expected.plan, pixel_um)
    aligned = _aligned(views, grid)
    interior = recipe.interior
    # turned, it may show borders in too few poses to be placed
    check_lying(np.array([field_means(one, points, interior) for one in aligned]), expected)
    places = tuple(field_places(one, points, expected.plan.classes()) for one in aligned)
    x, y = check_places(places, expected.plan.module_mm)
    if np.hypot(x, y) > LEAST_FOLLOWED * expected.plan.module_mm:
        grid = moved_grid(grid, x, y)
        aligned = _aligned(views, grid)
    radiance = np.array([field_means(one, points, interior) for one in aligned])
    if not np.nanmin(radiance) > 0.0:
        raise MeasurementError(
            "some field is darker than the dark frames: check light, exposure and dark frames"
        )
    reach = max(1, round(points * 0.08))
    moved = [
        np.array([field_means(one, points, interior, shift) for one in aligned])
        for shift in ((reach, 0), (-reach, 0), (0, reach), (0, -reach))
    ]
    per_um = np.sqrt(np.nanmean((np.array(moved) / radiance - 1.0) ** 2, axis=0)) / (
        reach * grid.pixel_mm * 1000.0
    )
    noise = np.array([_noise(view, max(2, round(interior * points)) ** 2, pixel_um, grid) for view in views])
    drift = None
    if closing is not None:
        again = field_means(resample(closing.image.value, closing.placement, grid), points, interior)
        drift = float(np.nanmean(again) / np.nanmean(radiance[0]) - 1.0)
    correlation = check_plan(radiance, expected)
    texts = tuple(read_code(one, recipe, points) for one in aligned)
    return MeasuredPlate(
        radiance, per_um * recipe.u_place_um, noise, aligned, grid, drift, correlation, texts, places
    )


def _aligned(views: list[View], grid: Grid) -> tuple[Image, ...]:
    """The pictures on the raster of the fields.

    Raises:
        RegistrationError: it does not lie in the pictures.
    """
    found = tuple(resample(view.image.value, view.placement, grid) for view in views)
    for view, picture in zip(views, found, strict=True):
        missing = float(np.mean(~np.isfinite(picture)))
        if missing > MOST_MISSING:
            raise RegistrationError(
                f"at {view.stage_deg:g}° {missing:.1%} of the plate are outside the picture or saturated: centre the "
                "fixture, correct region.center_mm, or shorten acquisition.exposure_s"
            )
    return found


def moved_grid(grid: Grid, x_mm: float, y_mm: float) -> Grid:
    """A raster moved along its own axes, y up."""
    turn = np.radians(grid.turn_deg)
    cos, sin = float(np.cos(turn)), float(np.sin(turn))
    x, y = grid.center_mm
    return replace(grid, center_mm=(x + cos * x_mm - sin * y_mm, y + sin * x_mm + cos * y_mm))


def check_places(places: tuple[FieldPlaces | None, ...], module_mm: float) -> tuple[float, float]:
    """Check that the plate is in its seat.

    Returns:
        Shift (x, y) of the fields in mm, y up; 0 where no borders show.

    Raises:
        RegistrationError: it is shifted or turned against the markers.
    """
    known = [one for one in places if one is not None]
    if not known:
        return 0.0, 0.0
    x, y = (float(one) for one in np.median([one.shift for one in known], axis=0))
    if max(abs(x), abs(y)) > MOST_SHIFT:
        raise RegistrationError(
            f"the fields lie {x * module_mm:+.3f} mm, {y * module_mm:+.3f} mm (x, y) off their places (limit "
            f"{MOST_SHIFT * module_mm:g} mm): seat the plate against its stops, or correct region.center_mm"
        )
    turn = float(np.median([one.turn_deg for one in known]))
    if abs(turn) > MOST_TURN_DEG:
        raise RegistrationError(
            f"the plate lies turned by {turn:+.1f}° in its seat (limit ±{MOST_TURN_DEG:g}°): seat it against its stops"
        )
    return x * module_mm, y * module_mm


def _noise(view: View, points: int, pixel_um: float, grid: Grid) -> float:
    """Relative noise of the mean of one field, from the noise of the pixels of the picture."""
    noise = view.image.noise_in((slice(None, None, 7), slice(None, None, 7)))
    level = float(np.nanmean(view.image.value[::7, ::7]))
    pixels = points * (1000.0 * grid.pixel_mm / pixel_um) ** 2
    return float(np.sqrt(np.nanmean(np.square(noise)) / pixels)) / max(level, 1e-9)


def check_plan(radiance: FloatArray, expected: ExpectedPlate) -> float:
    """Correlation of the fields with those of the plan.

    Positions are compared by the mean distance of ln L from what each would show, and by the correlation: where no
    class faces the light in any pose, as often after a turn by 180°, hardly a field differs from another.

    Args:
        radiance: (P, rows, cols) measured.
        expected: the prediction.

    Raises:
        MeasurementError: the plate lies turned or upside down, or is not the one of the plan.
    """
    check_lying(radiance, expected)
    seen, right = np.log(radiance), expected.lying[0]
    alike = _alike(seen, right)
    distance = _distance(seen, right)
    if alike >= ALIKE:
        return alike
    shown, planned = (float(np.nanstd(_within_poses(one))) for one in (seen, _due(right)))
    if planned < LEAST_SCATTER and distance < FITS:
        return alike
    if shown < UNLIKE_SHARE * planned:
        raise MeasurementError(
            f"the fields hardly differ from each other (standard deviation of ln L {shown:.2f}, of the plan "
            f"{planned:.2f}): does the plate lie turned by 180° or upside down, or has it no ridges?"
        )
    raise MeasurementError(
        f"the fields are not those of the plan (correlation {alike:.2f}, at least {ALIKE:g} is needed): is it the plan "
        "of another plate?"
    )


def check_lying(radiance: FloatArray, expected: ExpectedPlate) -> None:
    """Check that the fields are not much more like those of the plate turned by quarters, or mirrored.

    Args:
        radiance: (P, rows, cols) measured; what is not above 0 does not count.
        expected: the prediction.

    Raises:
        MeasurementError: the plate lies turned, or the plan is mirrored.
    """
    seen = np.log(np.where(radiance > 0.0, radiance, np.nan))
    right, *others = expected.lying
    distance = _distance(seen, right)
    best = min(others, key=lambda one: _distance(seen, one), default=right)
    closest = _distance(seen, best)
    if closest < min(distance - CLOSER, FITS) and _alike(seen, best) >= ALIKE:
        turned = 90 * best.quarters
        if best.mirrored:
            raise MeasurementError(
                f"the fields are those of the plan mirrored and turned by {turned}° (mean distance of ln L "
                f"{closest:.2f}, as planned {distance:.2f}): the plan is mirrored, or is that of the mould"
            )
        raise MeasurementError(
            f"the plate lies turned by {turned}° (mean distance of ln L {closest:.2f}, as it should lie "
            f"{distance:.2f}): seat it as the recipe says"
        )


def _due(lying: Lying) -> FloatArray:
    """(P, rows, cols) ln L of the fields of a position; NaN for flat ones."""
    return np.where(lying.classes >= 0, lying.ln.T[:, np.maximum(lying.classes, 0)], np.nan)


def _within_poses(ln: FloatArray) -> FloatArray:
    """Ln L less its mean in every pose."""
    return np.asarray(ln - np.nanmean(ln, axis=(1, 2), keepdims=True))


def _distance(seen: FloatArray, lying: Lying) -> float:
    """Mean distance of ln L from what a position would show, its level aside; large ones count alike."""
    if lying.classes.shape != seen.shape[1:]:
        return float("inf")
    off = seen - _due(lying)
    level = float(np.clip(np.nanmedian(off), -LEVEL, LEVEL))
    return float(np.nanmean(np.minimum(np.abs(off - level), FARTHEST)))


def _alike(seen: FloatArray, lying: Lying) -> float:
    """Correlation of what is seen with the ln radiances of a position, over fields and poses."""
    due = _within_poses(_due(lying))
    seen = _within_poses(seen)
    known = np.isfinite(due) & np.isfinite(seen)
    a, b = seen[known] - seen[known].mean(), due[known] - due[known].mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else 0.0


def read_code(picture: Image, recipe: PlateRecipe, points: int) -> str | None:
    """Text of the code in a picture of the plate; None where none is read."""
    if recipe.code is None:
        return None
    known = np.nan_to_num(picture, nan=float(np.nanmedian(picture)))
    means = field_means(known, points, recipe.interior)
    return read_plate(known, points, means, recipe.code.symbology)
