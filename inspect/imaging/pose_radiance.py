"""From aligned pictures to pose radiances, their uncertainty (V_meas), and the map of contrasts."""

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError, RegistrationError, Saturated
from anisoscope.base.parallel import for_each
from anisoscope.imaging.linearisation import RadianceImage
from anisoscope.imaging.registration.placement import (
    Grid,
    View,
    angle_between,
    lens_advice,
    resample,
)
from anisoscope.prediction.expectation import Component, Expectation
from anisoscope.recipe.base import LimitsPart
from anisoscope.recipe.surface import MOST_DEVIATION, SurfaceRecipe

Image = npt.NDArray[np.float32]

CELLS_PER_PITCH = 4
STAGE_ANGLE = "stage angle"
_NOISE_SAMPLE = 1 << 17  # pixels that determine the noise to a fifth of a percent


class Limited(Protocol):
    """The part of a recipe of any kind that limits what counts as a valid measurement."""

    @property
    def limits(self) -> LimitsPart:
        """Limits beyond which a measurement is INVALID."""
        ...


@dataclass(frozen=True, eq=False)
class Measured:
    """Result of the measurement.

    Attributes:
        radiance: (P,) mean radiance of the region in 1/sr, whole pitches.
        components: measurement uncertainties of ln L.
        aligned: P pictures of the region on the sample's raster, (rows, cols), first row at the top.
        cells: (P, cell rows, cell cols) mean radiance of square cells, a quarter of a pitch wide.
        cell_noise: (P,) standard uncertainty of a cell's ln L from noise.
        grid: raster of the aligned pictures.
        drift: L(first pose, at the end)/L(first pose, at the start) − 1, or None.
        unwatched: notes on what the gates could not see.
        mirroring: (cell rows, cell cols) True where a defect saturates a pose; its radiance is a lower bound. None:
            nothing does.
    """

    radiance: FloatArray
    components: tuple[Component, ...]
    aligned: tuple[Image, ...]
    cells: FloatArray
    cell_noise: FloatArray
    grid: Grid
    drift: float | None
    unwatched: tuple[str, ...] = ()
    mirroring: npt.NDArray[np.bool_] | None = None


def region_grid(recipe: SurfaceRecipe, pixel_um: float) -> tuple[Grid, int]:
    """Raster of the region: whole pitches across and along, a whole number of points per cell.

    Returns:
        The raster and the points per side of a cell.
    """
    pitch_mm = recipe.surface.pitch_um / 1000.0
    per_cell = max(1, round(recipe.surface.pitch_um / CELLS_PER_PITCH / pixel_um))
    across, along = (
        int(size / pitch_mm + 1e-6) * CELLS_PER_PITCH * per_cell for size in recipe.region.size_mm
    )
    step = pitch_mm / CELLS_PER_PITCH / per_cell
    return Grid(recipe.region.center_mm, step, (along, across), recipe.poses.facet_azimuth_deg), per_cell


def check_view(view: View, first: View, recipe: Limited, pixel_um: float) -> None:
    """Gates of one picture.

    Raises:
        RegistrationError: the markers do not fit, or their pose contradicts stage and rig file.
        MeasurementError: no light.
    """
    limits, place = recipe.limits, view.placement
    if place.residual_px > limits.registration_px:
        raise RegistrationError(
            f"at {view.stage_deg:g}° the fixture markers fit with {place.residual_px:.2f} px rms, limit "
            f"{limits.registration_px:g} px: {lens_advice(place.bent_share)}check focus, and that the markers stand "
            "where the rig file says"
        )
    off = angle_between(view.stage_deg, place.angle_deg - first.placement.angle_deg + first.stage_deg)
    if abs(off) > limits.angle_deg:
        raise RegistrationError(
            f"the stage says {view.stage_deg:g}°, the markers {view.stage_deg + off:.2f}° "
            f"(limit ±{limits.angle_deg:g}°): check the rotation sense in the rig file and that the fixture sits tight"
        )
    zero = angle_between(view.stage_deg, place.angle_deg)
    if abs(zero) > limits.angle_deg:
        raise RegistrationError(
            f"the fixture stands {zero:+.2f}° from where the stage says (limit ±{limits.angle_deg:g}°): "
            "correct stage.zero_deg in the rig file, or seat the fixture again"
        )
    if abs(place.pixel_um / pixel_um - 1.0) > limits.scale_share:
        raise RegistrationError(
            f"the markers give {place.pixel_um:.3f} µm a pixel, the rig file {pixel_um:g} µm (limit "
            f"{limits.scale_share:.0%}): correct camera.pixel_um or the fixture's measures"
        )
    moved_um = float(np.hypot(*np.subtract(place.axis_px, first.placement.axis_px))) * place.pixel_um
    if moved_um > limits.moved_um:
        raise RegistrationError(
            f"between {first.stage_deg:g}° and {view.stage_deg:g}° the fixture's centre moved by {moved_um:.0f} µm "
            f"(limit {limits.moved_um:g} µm, limits.moved_um): centre the fixture on the stage, and check that nothing "
            "slipped"
        )


def measure(
    views: list[View], closing: View | None, recipe: SurfaceRecipe, expected: Expectation, pixel_um: float
) -> Measured:
    """Pose radiances over the recipe's region.

    Args:
        views: one per pose, in the recipe's order.
        closing: the repetition of the first pose at the end.
        recipe: region and limits.
        expected: the prediction; gives the change with stage angle.
        pixel_um: size of a camera pixel on the sample according to the rig file.

    Raises:
        MeasurementError: INVALID, with the reason.
    """
    for view in [*views, *([closing] if closing else [])]:
        check_light(view.stage_deg, view.image, recipe)
        # a tilted arm looks from another direction: the centre must stay in place only within one tilt
        alike = next(first for first in views if first.tilt_deg == view.tilt_deg)
        check_view(view, alike, recipe, pixel_um)
    grid, per_cell = region_grid(recipe, pixel_um)

    def sampled(view: View) -> tuple[Image, float, FloatArray, float, npt.NDArray[np.bool_] | None]:
        picture = resample(view.image.value, view.placement, grid)
        usable = mean_of(picture)
        bright = _check_region(view, picture, grid, recipe, per_cell)
        return picture, _mean_noise(view, grid), _cell_means(picture, per_cell), usable, bright

    pictures, noises, blocks, usable, bright = zip(*for_each(sampled, views), strict=True)
    marked = [one for one in bright if one is not None]
    aligned, noise, cells = list(pictures), np.array(noises), np.stack(blocks)
    radiance = np.array([mean_of(picture) for picture in aligned])
    if np.any(radiance <= 0):
        raise MeasurementError(
            "the part is darker than the dark frames: check light, exposure and dark frames"
        )
    drift = None
    if closing is not None:
        again = mean_of(resample(closing.image.value, closing.placement, grid))
        drift = again / usable[0] - 1.0
    pixels_per_point = (grid.pixel_mm * 1000.0 / pixel_um) ** 2
    area_px, cell_px = grid.shape[0] * grid.shape[1] * pixels_per_point, per_cell**2 * pixels_per_point
    components = _components(recipe, expected, radiance, noise / np.sqrt(area_px), drift, views, aligned)
    return Measured(
        radiance,
        components,
        tuple(aligned),
        cells,
        noise / np.sqrt(cell_px) / radiance,
        grid,
        drift,
        mirroring=np.any(marked, axis=0) if marked else None,
    )


def drift_error(drift: float | None, limit: float) -> str | None:
    """Reason why the drift invalidates the measurement, or None: first pose against its repetition at the end."""
    if drift is None or abs(drift) <= limit:
        return None
    return (
        f"at the end the first pose is {abs(drift):.1%} {'brighter' if drift > 0 else 'darker'} than at the start "
        f"(limit {limit:.1%}): let the lamp warm up, and check that the part sits tight"
    )


def check_light(stage_deg: float, image: RadianceImage, recipe: Limited) -> None:
    """Check that the picture is lit.

    Raises:
        MeasurementError: next to none.
    """
    if image.signal_share < recipe.limits.min_signal_share:
        raise MeasurementError(
            f"at {stage_deg:g}° the brightest parts reach {image.signal_share:.1%} of full scale (limit "
            f"{recipe.limits.min_signal_share:.0%}): is the lens cap on, the light off, the exposure too short?"
        )


def mean_of(picture: Image) -> float:
    """Mean of the values of a picture."""
    total = float(picture.sum(dtype=np.float64))
    return total / picture.size if np.isfinite(total) else float(np.nanmean(picture, dtype=np.float64))


def _corners(view: View, grid: Grid) -> FloatArray:
    """(4, 2) column and row of the region's corners in the picture."""
    rows, cols = grid.shape
    ends = np.array([[x, y, 1.0] for x in (0, cols - 1) for y in (0, rows - 1)])
    sampled = ends @ (view.placement.homography @ grid.to_mm()).T
    return view.placement.seen(np.asarray(sampled[:, :2] / sampled[:, 2:]))


def _window(view: View, grid: Grid) -> tuple[slice, slice]:
    """Rows and columns of the picture that hold the region."""
    at, shape = _corners(view, grid), view.image.value.shape
    low = np.clip(np.floor(at.min(axis=0)), 0, np.array(shape[::-1]) - 1).astype(int)
    high = np.clip(np.ceil(at.max(axis=0)) + 1, low + 1, shape[::-1]).astype(int)
    cols, rows = (slice(int(first), int(last)) for first, last in zip(low, high, strict=True))
    return rows, cols


def _is_inside(view: View, grid: Grid) -> bool:
    """Whether the corners of the region, and so all of it, are within the picture."""
    at = _corners(view, grid)
    return bool(np.all((at >= 0.0) & (at <= np.array(view.image.value.shape[::-1]) - 1.0)))


def _check_region(
    view: View, picture: Image, grid: Grid, recipe: SurfaceRecipe, per_cell: int
) -> npt.NDArray[np.bool_] | None:
    """Check that the region is in the picture and not over-exposed.

    Returns:
        The cells that a defect saturates, or None; their pixels get the largest radiance that was measured.
    """
    share, bright, saturated = 0.0, None, np.zeros((0, 0), dtype=np.float32)
    if not _is_inside(view, grid) or view.image.saturated.any():
        saturated = resample(view.image.saturated.astype(np.float32), view.placement, grid)
        inside = np.isfinite(saturated)
        if not inside.all():
            raise RegistrationError(
                f"at {view.stage_deg:g}° {1 - inside.mean():.1%} of the region lie outside the picture: "
                "make region.size_mm smaller or centre the fixture"
            )
        share = float(np.mean(saturated > 0.01))
    if share > recipe.limits.saturated_share:
        rows, cols = _window(view, grid)
        largest = float(np.nanmax(view.image.value[rows, cols], initial=0.0))
        bright = _mirroring(saturated > 0.01, picture, recipe.limits, per_cell, largest)
        np.copyto(picture, largest, where=np.isnan(picture) & (saturated > 0.0))
    if share > recipe.limits.saturated_share and bright is None:
        raise Saturated(
            f"at {view.stage_deg:g}° {share:.2%} of the region are saturated (limit "
            f"{recipe.limits.saturated_share:.2%}): shorten acquisition.exposure_s in the recipe"
        )
    whole = np.isfinite(picture.sum(dtype=np.float64))
    missing = 0.0 if whole else float(np.mean(~np.isfinite(picture)))
    if missing > 0.05 + 10 * recipe.limits.saturated_share:
        raise MeasurementError(f"at {view.stage_deg:g}° {missing:.1%} of the region have no usable pixels")
    return bright


def _mirroring(
    saturated: npt.NDArray[np.bool_], picture: Image, limits: LimitsPart, per_cell: int, largest: float
) -> npt.NDArray[np.bool_] | None:
    """Cells that a defect saturates, which mirrors where the same flanks elsewhere do not; None: over-exposed.

    Args:
        saturated: (rows, cols) points of the region.
        picture: of the same size.
        limits: the share of points that may saturate elsewhere.
        per_cell: points a side of a cell.
        largest: radiance that was measured near them, which they have at least.
    """
    rows, cols = saturated.shape
    size = cols // per_cell, rows // per_cell
    share = cv2.resize(saturated.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    cells = np.asarray(share > 0.5)
    groups = cv2.connectedComponentsWithStats(cells.astype(np.uint8), connectivity=8)[2][1:, cv2.CC_STAT_AREA]
    if np.mean(cells) > 0.5 or groups.max(initial=0) < CELLS_PER_PITCH:
        return None
    near = cv2.resize(
        cv2.dilate(cells.astype(np.uint8), np.ones((3, 3))), (cols, rows), interpolation=cv2.INTER_NEAREST
    )
    least = largest / np.exp(MOST_DEVIATION)
    means = _cell_means(picture, per_cell)
    for phase in range(CELLS_PER_PITCH):
        own, taken = means[:, phase::CELLS_PER_PITCH], cells[:, phase::CELLS_PER_PITCH]
        if taken.mean() > 0.5 or np.median(own[~taken]) > least:
            return None
    elsewhere = float(np.mean(saturated & (near == 0)))
    return None if elsewhere > limits.saturated_share else cells


def _cell_means(picture: Image, side: int) -> FloatArray:
    """Means of square cells; a cell without any usable pixel takes the mean of the picture."""
    rows, cols = picture.shape
    size = cols // side, rows // side
    known = np.isfinite(picture)
    if known.all():
        means = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        return np.asarray(means, dtype=np.float64)
    share = cv2.resize(known.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    total = cv2.resize(np.where(known, picture, np.float32(0.0)), size, interpolation=cv2.INTER_AREA)
    return np.where(share > 0.0, total / np.maximum(share, 1e-6), mean_of(picture)).astype(np.float64)


def _mean_noise(view: View, grid: Grid) -> float:
    """Root mean square of the noise of the region's pixels; of a large region, of every n-th along either axis."""
    at = _corners(view, grid)
    rows, cols = _window(view, grid)
    low = np.array([cols.start, rows.start])
    pixels = float((rows.stop - rows.start) * (cols.stop - cols.start))
    step = 1 + 2 * int(0.5 * np.sqrt(pixels / _NOISE_SAMPLE))  # odd: on all filters of a mosaic
    rows, cols = slice(rows.start, rows.stop, step), slice(cols.start, cols.stop, step)
    noise = view.image.noise_in((rows, cols))
    inside = np.zeros(noise.shape, dtype=np.uint8)
    edges = np.rint((at[[0, 1, 3, 2]] - low) / step).astype(np.int32)
    cv2.fillConvexPoly(inside, edges, 1)
    found = noise[(inside > 0) & np.isfinite(noise)]
    return float(np.sqrt(np.mean(np.square(found), dtype=np.float64))) if found.size else 0.0


def _components(
    recipe: SurfaceRecipe,
    expected: Expectation,
    radiance: FloatArray,
    noise: FloatArray,
    drift: float | None,
    views: list[View],
    aligned: list[Image],
) -> tuple[Component, ...]:
    rig = recipe.uncertainty
    ones = np.ones_like(radiance)
    lamp = abs(drift) / np.sqrt(3.0) if drift is not None else recipe.limits.drift / np.sqrt(3.0)
    shift = np.array([_shift_sensitivity(picture) for picture in aligned])
    # registered by edges: the residual is already the uncertainty
    residual = np.array([v.placement.residual_px / np.sqrt(max(2 * v.placement.markers, 1)) for v in views])
    # few frames per pose, so the flicker of the lamp is estimated from all poses together
    flicker = np.sqrt(np.mean([view.image.flicker**2 for view in views]))
    frames = np.sqrt([view.image.frames for view in views])
    level = np.array([view.u_level for view in views])
    found = (
        ("noise of camera and photons", noise / radiance, False),
        ("flicker of the lamp", flicker / frames, False),
        ("flat field", rig.flat_share * ones, False),
        ("linearity of the camera", rig.linearity_share * ones, False),
        ("drift of the lamp", lamp * ones, False),
        ("stray light", rig.stray_radiance / radiance, True),
        (STAGE_ANGLE, rig.stage_deg * expected.per_degree, False),
        ("registration", shift * residual, False),
        *((("white of the markers", level, False),) if level.any() else ()),
    )
    return tuple(Component(name, "measurement", relative, shared) for name, relative, shared in found)


def _shift_sensitivity(picture: Image) -> float:
    """Relative change of the region's mean per pixel of shift, from the radiance at its edges."""
    mean = mean_of(picture)
    rows, cols = picture.shape
    across = abs(np.nanmean(picture[:, 0]) - np.nanmean(picture[:, -1])) / cols
    down = abs(np.nanmean(picture[0]) - np.nanmean(picture[-1])) / rows
    return float(np.hypot(across, down) / mean)
