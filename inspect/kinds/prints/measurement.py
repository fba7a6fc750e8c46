"""Channels of a print from the raw pixels of its mosaic: none is interpolated, so that no demosaicking error enters.

Every pixel has been divided by its own flat, so that white is 1/π behind every filter. A pixel counts for its own
filter where its middle lies in the region; means over region and cells are those of the pixels themselves.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError, RegistrationError, Saturated
from anisoscope.imaging.registration.placement import Grid, View
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
    """

    channels: FloatArray
    cells: FloatArray
    cell_noise: FloatArray
    sources: tuple[Source, ...]
    grid: Grid
    drift: float | None
    pictures: Mosaics | None = None


def cell_grid(recipe: PrintRecipe) -> Grid:
    """Raster of whole cells in the region; where no map is judged, one cell that stands for all of it."""
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
    corners = ends[:, :2] / ends[:, 2:]
    size = np.array(view.image.value.shape[::-1])
    if np.any(corners < 0.0) or np.any(corners > size - 1.0):
        raise RegistrationError(
            f"at {view.stage_deg:g}° a part of the region lies outside the picture: make region.size_mm smaller or "
            "centre the fixture"
        )
    low, high = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int) + 1
    row, column = np.mgrid[low[1] : high[1], low[0] : high[0]]
    back = np.linalg.inv(to_pixel)
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
