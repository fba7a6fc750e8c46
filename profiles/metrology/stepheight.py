"""Height of a step, and depth of a groove, by the fit of ISO 5436-1 (types A1 and A2) on every line of a map.

One straight line on both sides of the groove and one on its bottom, parallel to it: z = αx + β ± h, depth 2h. Along the
width w of the groove only its middle third counts, and on either side the two thirds of w that begin w/3 from its
edges, so that rounded edges and walls do not. A single step has one plateau on either side of its edge; of each the
two thirds count that are farther from it.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.heightmap import HeightMap

Mask = npt.NDArray[np.bool_]
LEAST_POINTS = 3
"""Least number of points of a line on each plateau."""
MOST_LEVELS = 1000
"""Different heights from which on a map is not taken for rounded."""


@dataclass(frozen=True)
class StepHeight:
    """Depth of a groove, or height of a step.

    Attributes:
        kind: "groove", "ridge" (a groove upside down) or "step".
        height_um: mean over the lines: of the middle over its sides, negative for a groove; of a step, of the side at
            the larger x or y over the other.
        u_um: standard uncertainty of the mean: scatter of the lines, and that of rounding, which
            all points share unless they scatter by half a digit.
        scatter_um: standard deviation between lines.
        lines: number of lines.
        edges_um: places of its edges along the direction, from the first point.
        width_um: of the groove; of a step, of the plateau that counts on either side.
        slope_deg: mean tilt of the plateaus, which the fit takes out.
    """

    kind: Literal["groove", "ridge", "step"]
    height_um: float
    u_um: float
    scatter_um: float
    lines: int
    edges_um: tuple[float, ...]
    width_um: float
    slope_deg: float


def step_height(
    surface: HeightMap, direction: Literal["x", "y"] = "x", edges_um: tuple[float, ...] = ()
) -> StepHeight:
    """Height of the one step, or depth of the one groove, that lies across a direction.

    Args:
        surface: the map.
        direction: of the lines, across the step.
        edges_um: one edge of a step, or two of a groove, from the first point; found in the mean line where they are
            not given, halfway between its levels.

    Raises:
        HeightMapError: no step or several, edges outside the map, or too few points on a plateau.
    """
    surface = surface.measured()
    lines = surface.height_um if direction == "x" else surface.height_um.T
    pixel = surface.pixel_x_um if direction == "x" else surface.pixel_y_um
    place = np.arange(lines.shape[1], dtype=np.float64) * pixel
    edges = tuple(sorted(edges_um)) or _edges(lines, place, direction)
    if len(edges) > 2 or edges[0] <= place[0] or edges[-1] >= place[-1] or len(set(edges)) < len(edges):
        text = ", ".join(f"{one:g}" for one in edges)
        raise HeightMapError(
            f"step: one edge of a step or two of a groove, between 0 and {place[-1]:g} µm, not {text}"
        )
    inner, outer, width = _plateaus(place, edges)
    if min(np.count_nonzero(inner), np.count_nonzero(outer)) < LEAST_POINTS:
        raise HeightMapError(
            f"step: {min(np.count_nonzero(inner), np.count_nonzero(outer))} points of a line on a plateau, "
            f"{LEAST_POINTS} are needed: a groove needs its own width on either side of it"
        )
    heights, slopes = _fitted(lines, place, inner, outer)
    if not heights.size:
        raise HeightMapError(f"step: no line has {LEAST_POINTS} points on every plateau")
    scatter = float(heights.std(ddof=1)) if heights.size > 1 else float("nan")
    height = float(heights.mean())
    noise = scatter / np.sqrt(1.0 / np.count_nonzero(inner) + 1.0 / np.count_nonzero(outer))  # of a point
    u = float(np.hypot(scatter / np.sqrt(heights.size), _rounding(lines, noise)))
    kind: Literal["groove", "ridge", "step"] = "step"
    if len(edges) > 1:
        kind = "groove" if height < 0.0 else "ridge"
    slope = float(np.degrees(np.arctan(slopes.mean())))
    return StepHeight(kind, height, u, scatter, heights.size, edges, width, slope)


def _rounding(lines: FloatArray, noise: float) -> float:
    """Standard uncertainty of the difference of two rounded levels; 0 where noise makes the rounding a mean."""
    levels = np.unique(lines[np.isfinite(lines)])
    digit = float(np.diff(levels).min()) if 1 < levels.size < MOST_LEVELS else 0.0
    return 0.0 if noise > 0.5 * digit else digit / np.sqrt(6.0)


def _edges(lines: FloatArray, place: FloatArray, direction: str) -> tuple[float, ...]:
    """Places where the mean line crosses the middle between its two levels."""
    from skimage.filters import threshold_otsu  # noqa: PLC0415 - heavy

    counts = np.isfinite(lines).sum(axis=0)
    known = counts > 0
    mean = np.nansum(lines, axis=0)[known] / counts[known]
    x = place[known]
    middle = float(threshold_otsu(mean)) if np.ptp(mean) > 0.0 else 0.0  # type: ignore[no-untyped-call]
    high, low = mean[mean > middle], mean[mean <= middle]
    if not high.size or not low.size:
        raise HeightMapError(f"step: no step along {direction}: the surface is flat")
    level = 0.5 * (float(np.median(high)) + float(np.median(low)))
    above = mean > level
    at = np.flatnonzero(above[1:] != above[:-1])
    if not 1 <= at.size <= 2:
        raise HeightMapError(
            f"step: the mean line along {direction} crosses its middle {at.size} times: crop the map to one step or "
            "groove, level it, or give the edges"
        )
    share = (level - mean[at]) / (mean[at + 1] - mean[at])
    return tuple((x[at] + share * (x[at + 1] - x[at])).tolist())


def _plateaus(place: FloatArray, edges: tuple[float, ...]) -> tuple[Mask, Mask, float]:
    """Points of the plateau that counts as the height, those of the reference, and the width."""
    if len(edges) == 1:
        width = min(edges[0] - place[0], place[-1] - edges[0])
        near, far = width / 3.0, width * (1.0 + 1e-9)
        off = place - edges[0]
        return (off >= near) & (off <= far), (-off >= near) & (-off <= far), float(width)
    width = edges[1] - edges[0]
    off = np.maximum(edges[0] - place, place - edges[1])
    middle = np.abs(place - 0.5 * (edges[0] + edges[1])) <= width / 6.0
    outer = (off >= width / 3.0) & (off <= width)
    both = outer & (place < edges[0]), outer & (place > edges[1])
    return middle, outer if all(map(np.any, both)) else np.zeros_like(outer), float(width)


def _fitted(lines: FloatArray, place: FloatArray, inner: Mask, outer: Mask) -> tuple[FloatArray, FloatArray]:
    """Heights and slopes of the lines by least squares; lines without enough points are left out."""
    used = np.asarray(inner | outer)
    design = np.column_stack([place, np.ones_like(place), np.where(inner, 0.5, -0.5)])[used]
    heights, slopes = [], []
    for line in lines[:, used]:
        known = np.isfinite(line)
        of_plateau = (
            np.count_nonzero(known & (design[:, 2] > 0.0)),
            np.count_nonzero(known & (design[:, 2] < 0.0)),
        )
        if min(of_plateau) < LEAST_POINTS:
            continue
        (slope, _, height), *_ = np.linalg.lstsq(design[known], line[known], rcond=None)
        heights.append(height)
        slopes.append(slope)
    return np.array(heights), np.array(slopes)
