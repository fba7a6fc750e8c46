"""Does anything stay in its place in the picture while the print turns under it?

Dirt on lens, sensor or white tile dims the same pixels by the same factor in every pose and every colour; what lies on
the print moves, and what the print's own form does changes with the tilt. Fours of pixels of the mosaic are compared at
their places in the picture, each with its surroundings, so that nothing is resampled.
"""

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError
from anisoscope.imaging.registration.placement import View, angle_between
from anisoscope.kinds.prints.colour import Eye
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.spot_area import fours_of

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
    """The gate.

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
    places = (projected[:, :2] / projected[:, 2:] - 0.5) / 2.0
    found = np.zeros(shape, dtype=np.uint8)
    cv2.fillConvexPoly(found, np.rint(places).astype(np.int32), 1)
    return found.astype(bool)


def _alike(maps: list[Image], least: float) -> Mask:
    """Where all poses are off by more than what counts and what scatters, to the same side and by about as much."""
    scatter = max(1.4826 * float(np.nanmedian(np.abs(one))) for one in maps)
    threshold = max(least, SIGMAS * scatter)
    low, high = np.min(maps, axis=0), np.max(maps, axis=0)  # NaN where one pose does not show the place
    brighter = (low > threshold) & (high < ALIKE * low)
    darker = (high < -threshold) & (low > ALIKE * high)
    return np.asarray(brighter | darker)
