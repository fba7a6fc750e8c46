"""Channels of a print from the raw pixels of its mosaic, and the gate that finds dirt on lens, sensor or white tile.

No pixel is interpolated, so that no demosaicking error enters. Every pixel has been divided by its own flat, so that
white is 1/π behind every filter. A pixel counts for its own filter where its middle lies in the region; means over
region and cells are those of the pixels themselves.

Dirt dims the same pixels by the same factor in every pose and every colour; a mark on the print moves as the print
turns, and the effect of the print's own form changes with the tilt. Quads of pixels of the mosaic are compared at their
places in the picture, each with its surroundings, so that nothing is resampled.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError, MeasurementError, RegistrationError, Saturated
from anisoscope.imaging.part_turn import check_follows
from anisoscope.imaging.registration.placement import Grid, View, angle_between, resample
from anisoscope.imaging.views import luminance
from anisoscope.kinds.prints.colour import Eye
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.sources import Source, of_each, of_poses
from anisoscope.rig.bayer import CHANNELS, channel_of_pixels

COLOURS = len(CHANNELS)
MAX_MISSING = 0.05
MIN_PIXELS = 4
"""Pixels of each filter in a cell, at least."""


@dataclass(frozen=True, eq=False)
class Mosaics:
    """The pictures of the poses themselves, divided by the flat, and the filters on their pixels."""

    views: tuple[View, ...]
    filters: str


@dataclass(frozen=True, eq=False)
class MeasuredPrint:
    """Measurement of a print.

    Attributes:
        channels: (P, 3) mean radiance of the region in 1/sr.
        cells: (P, 3, cell rows, cell cols) mean radiance of square cells, first row at the top.
        cell_noise: (P, 3) standard uncertainty of ln of a cell from noise.
        sources: of uncertainty, as estimated from the pictures themselves.
        grid: raster of the cells.
        drift: L(first pose, at the end)/L(first pose, at the start) − 1, or None.
        pictures: what the cells were taken from, for a closer look; None where there are none.
        unwatched: notes on what the gates could not see.
    """

    channels: FloatArray
    cells: FloatArray
    cell_noise: FloatArray
    sources: tuple[Source, ...]
    grid: Grid
    drift: float | None
    pictures: Mosaics | None = None
    unwatched: tuple[str, ...] = ()


def cell_grid(recipe: PrintRecipe) -> Grid:
    """Raster of whole cells in the region; where no map is judged, one cell for all of it."""
    width, height = recipe.region.size_mm
    if recipe.area is None:
        return Grid(recipe.region.center_mm, min(width, height), (1, 1), recipe.poses.facet_azimuth_deg)
    cols, rows = (int(size / recipe.area.cell_mm + 1e-6) for size in (width, height))
    return Grid(recipe.region.center_mm, recipe.area.cell_mm, (rows, cols), recipe.poses.facet_azimuth_deg)


@dataclass(frozen=True, eq=False)
class _PictureMeans:
    """One picture: means and noise of region and cells, by filter; pixels that count, and that are saturated."""

    mean: FloatArray
    noise: FloatArray
    cells: FloatArray
    cell_noise: FloatArray


def measure_print(
    views: Sequence[View], closing: View | None, recipe: PrintRecipe, filters: str
) -> MeasuredPrint:
    """Channels over the recipe's region.

    Args:
        views: one a pose, in the recipe's order; their pictures are mosaics divided by the flat.
        closing: the first pose photographed again at the end.
        recipe: region and limits.
        filters: of the camera, as `anisoscope.rig.bayer` names them.

    Raises:
        MeasurementError: INVALID, with the reason.
    """
    grid = cell_grid(recipe)
    means = [_picture_means(view, grid, filters, recipe) for view in views]
    channels = np.stack([one.mean for one in means])
    if np.any(channels <= 0.0):
        at, channel = (int(k) for k in np.unravel_index(int(channels.argmin()), channels.shape))
        raise MeasurementError(
            f"at {views[at].stage_deg:g}°, tilt {views[at].tilt_deg:g}°, the print is darker than the dark frames in "
            f"{CHANNELS[channel]}: check light and dark frames, and add a longer exposure (acquisition.brackets)"
        )
    noise, drift = np.stack([one.noise for one in means]) / channels, None
    if closing is not None:
        again = _picture_means(closing, grid, filters, recipe).mean
        drift = float(again.sum() / channels[0].sum() - 1.0)
    lamp = abs(drift) / np.sqrt(3.0) if drift is not None else recipe.limits.drift / np.sqrt(3.0)
    # few frames a pose, so all poses together say how much the lamp flickers
    flicker = np.sqrt(np.mean([view.image.flicker**2 for view in views]))
    frames = np.sqrt([view.image.frames for view in views])
    ones = np.ones_like(channels)
    cells = np.stack([one.cells for one in means])
    return MeasuredPrint(
        channels,
        cells,
        np.stack([one.cell_noise for one in means]) / channels,
        (
            of_each("noise of camera and photons", "measurement", noise.ravel()),
            of_poses("flicker of the lamp", "measurement", ones * (flicker / frames)[:, None]),
            of_poses("drift of the lamp", "measurement", lamp * ones),
        ),
        grid,
        drift,
        Mosaics(tuple(views), filters),
    )


def check_print_follows(views: Sequence[View], recipe: PrintRecipe, pixel_um: float) -> tuple[str, ...]:
    """Check by its pattern or texture that a print follows its fixture; as of `check_follows`."""
    side = 1000.0 * min(recipe.region.size_mm) / pixel_um
    grid = Grid(
        recipe.region.center_mm, pixel_um / 1000.0, (int(side), int(side)), recipe.poses.facet_azimuth_deg
    )
    pictures = [resample(luminance(view.image.value), view.placement, grid) for view in views]
    return check_follows(pictures, [view.stage_deg for view in views], recipe.limits.part_turn_deg)


def region_mean(view: View, recipe: PrintRecipe, filters: str) -> float:
    """Mean radiance of the region over all channels alike; errors as for `measure_print`."""
    return float(_picture_means(view, cell_grid(recipe), filters, recipe).mean.mean())


def _picture_means(view: View, grid: Grid, filters: str, recipe: PrintRecipe) -> _PictureMeans:
    window, cell = _cells_of_pixels(view, grid, recipe)
    value = view.image.value[window]
    inside = cell >= 0
    _check(view, window, inside, value, recipe)
    counted = inside & np.isfinite(value)
    channel = channel_of_pixels(filters, view.image.value.shape)[window]
    count = grid.shape[0] * grid.shape[1]
    place = channel[counted].astype(np.intp) * count + cell[counted]
    number = np.bincount(place, minlength=COLOURS * count)
    if number.min() < MIN_PIXELS:
        raise MeasurementError(
            f"at {view.stage_deg:g}° a cell of the map has {number.min()} usable pixels of some colour (at least "
            f"{MIN_PIXELS}): make area.cell_mm larger, or clean and focus"
        )
    sums = np.bincount(place, value[counted].astype(np.float64), COLOURS * count)
    variance = view.image.noise_in(window)[counted].astype(np.float64) ** 2
    squares = np.bincount(place, variance, COLOURS * count).reshape(COLOURS, count)
    number, sums = number.reshape(COLOURS, count), sums.reshape(COLOURS, count)
    whole = number.sum(axis=1)
    return _PictureMeans(
        sums.sum(axis=1) / whole,
        np.sqrt(squares.sum(axis=1)) / whole,
        (sums / number).reshape(COLOURS, *grid.shape),
        np.sqrt(np.mean(squares / number**2, axis=1)),
    )


def _to_mm(grid: Grid, recipe: PrintRecipe) -> FloatArray:
    """(3, 3) map from (column, row, 1) of a cell to sample millimetres; one cell is as wide and high as the region."""
    if recipe.area is not None:
        return grid.to_mm()
    (x, y), (width, height) = recipe.region.center_mm, recipe.region.size_mm
    return np.array([[width, 0.0, x], [0.0, -height, y], [0.0, 0.0, 1.0]])


def _cells_of_pixels(
    view: View, grid: Grid, recipe: PrintRecipe
) -> tuple[tuple[slice, slice], npt.NDArray[np.intp]]:
    """A window of the picture that holds the region, and the number of the cell of each of its pixels, −1 outside.

    Raises:
        RegistrationError: the region reaches beyond the picture.
    """
    rows, cols = grid.shape
    to_pixel = view.placement.homography @ _to_mm(grid, recipe)
    ends = np.array([[x, y, 1.0] for x in (-0.5, cols - 0.5) for y in (-0.5, rows - 0.5)]) @ to_pixel.T
    corners = view.placement.seen(ends[:, :2] / ends[:, 2:])
    size = np.array(view.image.value.shape[::-1])
    if np.any(corners < 0.0) or np.any(corners > size - 1.0):
        raise RegistrationError(
            f"at {view.stage_deg:g}° a part of the region lies outside the picture: make region.size_mm smaller or "
            "centre the fixture"
        )
    low, high = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int) + 1
    row, column = np.mgrid[low[1] : high[1], low[0] : high[0]]
    back = np.linalg.inv(to_pixel)
    column, row = np.moveaxis(view.placement.straight(np.stack([column, row], axis=-1)), -1, 0)
    x, y, scale = np.einsum("ij,jrc->irc", back, np.stack([column, row, np.ones_like(row)]))
    across, down = np.floor(x / scale + 0.5).astype(np.intp), np.floor(y / scale + 0.5).astype(np.intp)
    inside = (across >= 0) & (across < cols) & (down >= 0) & (down < rows)
    window = (slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0])))
    return window, np.where(inside, down * cols + across, -1)


def _check(
    view: View,
    window: tuple[slice, slice],
    inside: npt.NDArray[np.bool_],
    value: npt.NDArray[np.float32],
    recipe: PrintRecipe,
) -> None:
    share = float(np.mean(view.image.saturated[window][inside]))
    if share > recipe.limits.saturated_share:
        raise Saturated(
            f"at {view.stage_deg:g}°, tilt {view.tilt_deg:g}°, {share:.2%} of the region are saturated (limit "
            f"{recipe.limits.saturated_share:.2%}): shorten acquisition.exposure_s in the recipe"
        )
    missing = float(np.mean(~np.isfinite(value[inside])))
    if missing > MAX_MISSING:
        raise MeasurementError(f"at {view.stage_deg:g}° {missing:.1%} of the region have no usable pixels")


Image = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

FINE, COARSE = 3, 41
"""Sides of the squares of fours that are compared: the mean of a place, and the median of its surroundings."""
SAMPLE = 4000
"""Pixel quads from which the brightness gradient across the region is estimated."""
SIGMAS = 4.0
"""By how many times a picture's own scatter dirt must stand out: prints have grain."""
STEP = 0.005
"""Ln of the brightness between two of the 256 levels of which that median is taken."""
ALIKE = 1.8
"""The largest factor between poses in what dirt takes away: cells are dimmed alike, but for noise and edges."""
FEWEST = 4
"""Fours of pixels that count as dirt."""
FAR = 2.0
"""Smallest distance of dirt from the place to which a mark of the print would have moved, in sizes of the dirt."""
TURN_DEG = 20.0
"""Prints that are turned by less are not looked at."""


def check_print_dirt(
    views: list[View], recipe: PrintRecipe, filters: str, eye: Eye, channels: FloatArray
) -> None:
    """Check that nothing keeps its place in the picture while the print turns under the camera.

    Args:
        views: P poses.
        recipe: region, and from which CIEDE2000 on a cell deviates: half of it is dirt.
        filters: of the camera.
        eye: conversion of channels to colours.
        channels: (P, 3) of the region.

    Raises:
        CalibrationError: something stays in its place.
    """
    turn_deg = max(abs(angle_between(views[0].stage_deg, view.stage_deg)) for view in views)
    if turn_deg < TURN_DEG:
        return
    limit = 3.0 if recipe.area is None else recipe.area.cell_delta_e
    # how much CIEDE2000 a change of ln of all channels makes where it makes most
    most = float(np.sqrt(eye.metric(channels).sum(axis=(1, 2)).max()))
    maps = [_against_surroundings(view, recipe, filters) for view in views]
    fixed = _alike(maps, 0.5 * limit / most)
    border = cv2.dilate(np.isnan(np.sum(maps, axis=0)).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    count, places, stats, middles = cv2.connectedComponentsWithStats(fixed.astype(np.uint8), connectivity=8)
    axis = np.array(views[0].placement.axis_px)
    for label in range(1, count):
        width, height, size = (int(value) for value in stats[label, 2:])
        at = 2.0 * middles[label] + 0.5
        # a mark of the print that lies across the axis stays as well: dirt is where a mark would have moved away;
        # and so does the edge of a square sheet, where the region reaches beyond it
        moved = float(np.hypot(*(at - axis))) * np.sin(np.radians(turn_deg) / 2.0)
        at_border = bool(np.any(border[places == label]))
        if size >= FEWEST and moved > FAR * (max(width, height) + FINE) and not at_border:
            raise CalibrationError(
                f"something stays at column {at[0]:.0f}, row {at[1]:.0f} of the picture while the print turns "
                f"({4 * size} pixels): clean lens and camera, then the white tile, and take a new flat with "
                "`anisoscope calibrate flat`"
            )


def fours_of(value: npt.NDArray[np.float32], filters: str) -> npt.NDArray[np.float32]:
    """(3, rows/2, cols/2) red, green, blue of the pixel quads of a mosaic; NaN for an unusable quad."""
    rows, cols = (size - size % 2 for size in value.shape)
    found = np.zeros((len(CHANNELS), rows // 2, cols // 2), dtype=np.float32)
    channel = channel_of_pixels(filters, (2, 2))
    for (i, j), k in np.ndenumerate(channel):
        found[k] += value[i:rows:2, j:cols:2] / np.float32(np.sum(channel == k))
    return found


def _against_surroundings(view: View, recipe: PrintRecipe, filters: str) -> Image:
    """(rows/2, cols/2) ln of brightness of pixel quads over that of their surroundings; NaN outside the region."""
    grey = fours_of(view.image.value, filters).mean(axis=0)
    known = _inside(view, recipe, (grey.shape[0], grey.shape[1])) & (grey > 0.0)
    off = np.where(known, _flattened(np.log(np.maximum(grey, 1e-12)), known), 0.0)
    # the median of the surroundings, not their mean: else a large mark has a rim of the other sign
    levels = np.rint(np.clip(off / STEP + 128.0, 0.0, 255.0)).astype(np.uint8)
    usual = (cv2.medianBlur(levels, COARSE).astype(np.float32) - 128.0) * STEP
    near = cv2.blur((off - usual).astype(np.float32), (FINE, FINE))
    return np.where(known, near, np.nan).astype(np.float32)


def _flattened(logs: Image, known: Mask) -> Image:
    """Logarithms without what a curled sheet or the light's direction makes of them across the region: a parabola."""
    rows, cols = np.nonzero(known)
    if rows.size < FEWEST:
        return logs
    y, x = (axis - axis.mean() for axis in np.ogrid[: logs.shape[0], : logs.shape[1]])
    some = slice(None, None, max(1, rows.size // SAMPLE))
    u, v = x[0, cols[some]], y[rows[some], 0]
    base = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)
    c = np.linalg.lstsq(base, logs[rows[some], cols[some]].astype(np.float64), rcond=None)[0]
    flat = logs - (c[0] + c[1] * x + c[2] * y + c[3] * x * x + c[4] * x * y + c[5] * y * y)
    return np.asarray(flat - np.median(flat[rows[some], cols[some]]), dtype=np.float32)


def _inside(view: View, recipe: PrintRecipe, shape: tuple[int, int]) -> Mask:
    """(rows/2, cols/2) mask of the pixel quads within the recipe's region."""
    (x, y), (width, height) = recipe.region.center_mm, recipe.region.size_mm
    corners = np.array(
        [
            [x + a * width, y + b * height, 1.0]
            for a, b in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
        ]
    )
    projected = corners @ view.placement.homography.T
    places = (view.placement.seen(projected[:, :2] / projected[:, 2:]) - 0.5) / 2.0
    found = np.zeros(shape, dtype=np.uint8)
    cv2.fillConvexPoly(found, np.rint(places).astype(np.int32), 1)
    return found.astype(bool)


def _alike(maps: list[Image], least: float) -> Mask:
    """Mask of cells whose poses all deviate by more than limit and scatter, to the same side and by about as much."""
    scatter = max(1.4826 * float(np.nanmedian(np.abs(one))) for one in maps)
    threshold = max(least, SIGMAS * scatter)
    low, high = np.min(maps, axis=0), np.max(maps, axis=0)  # NaN where one pose does not show the place
    brighter = (low > threshold) & (high < ALIKE * low)
    darker = (high < -threshold) & (low > ALIKE * high)
    return np.asarray(brighter | darker)
