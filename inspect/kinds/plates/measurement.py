"""What a plate shows: the mean radiance of every field in every pose, and whether it is the plate of the plan."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError, RegistrationError
from anisoscope.imaging.pose_radiance import check_light, check_view
from anisoscope.imaging.quality_gates import check_views
from anisoscope.imaging.registration.placement import Grid, View, resample
from anisoscope.kinds.plates.expectation import ExpectedPlate
from anisoscope.kinds.plates.recipe import PlateRecipe
from anisoscope.profiles.plates import Plan

Image = npt.NDArray[np.float32]

LEAST_PIXELS = 8
"""Camera pixels along the side of a field."""
ALIKE = 0.5
"""Correlation with the plan below which a plate is another one."""
BETTER = 0.2
"""By how much another position of the plate must correlate better."""
MOST_MISSING = 0.02
DECODED_POINTS = 6
"""Points a field in the pictures in which codes are read, at least."""


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
    """

    radiance: FloatArray
    u_place: FloatArray
    noise: FloatArray
    aligned: tuple[Image, ...]
    grid: Grid
    drift: float | None
    alike: float
    texts: tuple[str | None, ...]


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
    aligned = tuple(resample(view.image.value, view.placement, grid) for view in views)
    interior = recipe.fields.interior
    for view, picture in zip(views, aligned, strict=True):
        missing = float(np.mean(~np.isfinite(picture)))
        if missing > MOST_MISSING:
            raise RegistrationError(
                f"at {view.stage_deg:g}° {missing:.1%} of the plate are outside the picture or saturated: centre the "
                "fixture, correct region.center_mm, or shorten acquisition.exposure_s"
            )
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
        radiance, per_um * recipe.u_place_um, noise, aligned, grid, drift, correlation, texts
    )


def _noise(view: View, points: int, pixel_um: float, grid: Grid) -> float:
    """Relative noise of the mean of one field, from the noise of the pixels of the picture."""
    noise = view.image.noise_in((slice(None, None, 7), slice(None, None, 7)))
    level = float(np.nanmean(view.image.value[::7, ::7]))
    pixels = points * (1000.0 * grid.pixel_mm / pixel_um) ** 2
    return float(np.sqrt(np.nanmean(np.square(noise)) / pixels)) / max(level, 1e-9)


def check_plan(radiance: FloatArray, expected: ExpectedPlate) -> float:
    """Correlation of the fields with those of the plan.

    Args:
        radiance: (P, rows, cols) measured.
        expected: the prediction.

    Raises:
        MeasurementError: the plate lies turned, or is not the one of the plan.
    """
    seen = np.log(radiance)
    seen = seen - np.nanmean(seen, axis=(1, 2), keepdims=True)
    plan, found = expected.plan, {}
    for quarters in range(4):
        # a plate turned by quarters: its places turn, and so do its directions
        classes = np.rot90(plan.classes(), quarters)
        if classes.shape != plan.shape:
            continue
        found[f"turned by {90 * quarters}°"] = _alike(seen, classes, expected.turned[quarters])
        found[f"turned by {90 * quarters}°, mirrored"] = _alike(
            seen, classes[:, ::-1], expected.turned[quarters]
        )
    right = found.pop("turned by 0°")
    best = max(found, key=lambda name: found[name])
    if found[best] > max(right + BETTER, ALIKE):
        if best.endswith("mirrored"):
            raise MeasurementError(
                f"the fields are those of the plan {best} (correlation {found[best]:.2f}, as planned {right:.2f}): "
                "the plan is mirrored, or is that of the mould"
            )
        raise MeasurementError(
            f"the plate lies {best} (correlation with the plan {found[best]:.2f}, as it should lie {right:.2f}): seat "
            "it as the recipe says"
        )
    if right < ALIKE:
        raise MeasurementError(
            f"the fields are not those of the plan (correlation {right:.2f}, at least {ALIKE:g} is needed): is it the "
            "plan of another plate, or does the plate lie upside down?"
        )
    return right


def _alike(seen: FloatArray, classes: npt.NDArray[np.int64], light: FloatArray) -> float:
    """Correlation of what is seen with ln radiances (C, P) of classes, over fields and poses."""
    due = np.where(classes >= 0, light.T[:, np.maximum(classes, 0)], np.nan)
    known = np.isfinite(due) & np.isfinite(seen)
    due = due - np.nanmean(due, axis=(1, 2), keepdims=True)
    a, b = seen[known] - seen[known].mean(), due[known] - due[known].mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else 0.0


def read_code(picture: Image, recipe: PlateRecipe, points: int) -> str | None:
    """Text of the code in a picture of the plate; None where none is read."""
    if recipe.code is None:
        return None
    known = np.nan_to_num(picture, nan=float(np.nanmedian(picture)))
    # ridges are finer than modules: what is read is the mean over a good part of a module
    grey = np.asarray(cv2.blur(known, (max(1, points // 3),) * 2), dtype=np.float32)
    return decoded(grey, recipe.code.symbology)


def decoded(picture: FloatArray | Image, symbology: str) -> str | None:
    """Text of a code in a grey picture, dark on light or light on dark; None where none is read."""
    import importlib  # noqa: PLC0415
    from typing import Any  # noqa: PLC0415

    library: Any = importlib.import_module("zxingcpp")  # compiled, without types
    low, high = np.percentile(picture, [1.0, 99.0])
    grey = np.clip(255.0 * (picture - low) / max(high - low, 1e-12), 0.0, 255.0).astype(np.uint8)
    kind = {"datamatrix": library.BarcodeFormat.DataMatrix, "qr": library.BarcodeFormat.QRCode}[symbology]
    for one in (grey, 255 - grey):
        framed = cv2.copyMakeBorder(one, *(4 * DECODED_POINTS,) * 4, cv2.BORDER_REPLICATE)
        for found in library.read_barcodes(framed, formats=kind):
            if found.valid:
                return str(found.text)
    return None
