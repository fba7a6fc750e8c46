"""Missing points: masked, filled, and single wrong points taken out."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.base.regular_file import regular_file
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.heightmap import HeightMap

Mask = npt.NDArray[np.bool_]
FillMethod = Literal["harmonic", "nearest"]

BLOCK_POINTS = 4_000_000
MAD = 1.4826
MAX_WINDOW = 31


def polygon_mask(surface: HeightMap, corners_um: Sequence[tuple[float, float]]) -> Mask:
    """Points (rows, cols) of a map inside a polygon.

    Args:
        surface: the map.
        corners_um: (x, y) of at least three corners in µm from the first point.

    Raises:
        HeightMapError: fewer than three corners.
    """
    from skimage.draw import polygon2mask  # noqa: PLC0415 - slow to import

    if len(corners_um) < 3:
        raise HeightMapError(f"a polygon needs at least three corners x y, not {len(corners_um)}")
    corners = [(y / surface.pixel_y_um, x / surface.pixel_x_um) for x, y in corners_um]
    return np.asarray(polygon2mask(surface.shape, np.array(corners)))  # type: ignore[no-untyped-call]


def picture_mask(surface: HeightMap, path: Path) -> Mask:
    """Points (rows, cols) of a map where a picture of the same size is bright; its first row is the largest y.

    Raises:
        HeightMapError: no picture, or not of the size of the map.
    """
    from PIL import Image, UnidentifiedImageError  # noqa: PLC0415 - slow to import

    try:
        with regular_file(path) as file, Image.open(file) as picture:
            cols, rows = picture.size
            if (rows, cols) != surface.shape:
                raise HeightMapError(
                    f"{path.name}: a mask of {rows} × {cols} pixels does not fit a map of {surface.shape[0]} × "
                    f"{surface.shape[1]} points; draw it on a picture of the map of the same size"
                )
            grey = np.asarray(picture.convert("L"))
    except (OSError, UnidentifiedImageError, ValueError, Image.DecompressionBombError) as error:
        raise HeightMapError(f"{path}: cannot be read as a picture ({error}); take a PNG file") from None
    return np.asarray(grey[::-1] >= 128)


def fill_gaps(
    surface: HeightMap,
    method: FillMethod = "harmonic",
    *,
    max_area_um2: float = np.inf,
    border: bool = False,
) -> FloatArray:
    """Heights (rows, cols) in µm with gaps filled.

    Args:
        surface: the map.
        method: "harmonic" (∇²z = 0 inside a gap, the measured points around it as boundary, no slope at the ends of the
            field), or "nearest" (the nearest measured point).
        max_area_um2: largest gap that is filled; points that touch at a side or corner are one gap.
        border: fill gaps that reach the border of the field too.

    Raises:
        HeightMapError: nothing was measured, or no such method.
    """
    from scipy import ndimage  # noqa: PLC0415 - slow to import

    check_heights("height map", surface.height_um)
    if method not in ("harmonic", "nearest"):
        raise HeightMapError(f"gaps are filled harmonic or nearest, not {method!r}")
    missing = np.isnan(surface.height_um)
    labels, count = ndimage.label(missing, np.ones((3, 3), dtype=np.bool_))
    if count == 0:
        return surface.height_um
    area = np.bincount(labels.ravel(), minlength=count + 1) * surface.pixel_x_um * surface.pixel_y_um
    chosen = area <= max_area_um2
    chosen[0] = False
    if not border:
        edges = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
        chosen[np.unique(edges)] = False
    wanted = chosen[labels]
    if not wanted.any():
        return surface.height_um
    nearest = ndimage.distance_transform_edt(
        missing,
        sampling=(surface.pixel_y_um, surface.pixel_x_um),
        return_distances=False,
        return_indices=True,
    )
    height = np.array(surface.height_um)
    height[wanted] = surface.height_um[tuple(nearest)][wanted]
    if method == "harmonic":
        height[wanted] = _harmonic(surface, wanted)
    return height


def _harmonic(surface: HeightMap, wanted: Mask) -> FloatArray:
    """Solution of ∇²z = 0 at the wanted points; other missing points and the border let nothing through."""
    from scipy import sparse  # noqa: PLC0415 - slow to import
    from scipy.sparse.linalg import spsolve  # noqa: PLC0415

    number = np.full(surface.shape, -1, dtype=np.int64)
    number[wanted] = np.arange(np.count_nonzero(wanted))
    known = np.isfinite(surface.height_um)
    middle = float(np.mean(surface.height_um[known]))
    size = int(number.max()) + 1
    diagonal, right = np.zeros(size), np.zeros(size)
    rows: list[npt.NDArray[np.int64]] = []
    cols: list[npt.NDArray[np.int64]] = []
    weights: list[FloatArray] = []
    for axis, pixel in enumerate((surface.pixel_y_um, surface.pixel_x_um)):
        weight = 1.0 / pixel**2
        for step in (1, -1):
            here = [slice(None)] * 2
            there = [slice(None)] * 2
            here[axis] = slice(None, -1) if step == 1 else slice(1, None)
            there[axis] = slice(1, None) if step == 1 else slice(None, -1)
            mine, other = number[tuple(here)], number[tuple(there)]
            beside, heights = known[tuple(there)], surface.height_um[tuple(there)]
            bound = (mine >= 0) & beside
            np.add.at(diagonal, mine[bound], weight)
            np.add.at(right, mine[bound], weight * (heights[bound] - middle))
            free = (mine >= 0) & (other >= 0)
            np.add.at(diagonal, mine[free], weight)
            rows.append(mine[free])
            cols.append(other[free])
            weights.append(np.full(np.count_nonzero(free), -weight))
    everyone = np.arange(size)
    matrix = sparse.csc_matrix(
        (
            np.concatenate([diagonal, *weights]),
            (np.concatenate([everyone, *rows]), np.concatenate([everyone, *cols])),
        ),
        shape=(size, size),
    )
    return np.asarray(middle + spsolve(matrix, right))


def outlier_mask(surface: HeightMap, limit: float, window: int) -> Mask:
    """(rows, cols) mask of outliers from the median of their surroundings.

    A point stands out where it is further from the local median than ``limit`` times the larger of the local and the
    global standard deviation, both from the median of absolute deviations; steps and edges are spread too, and stay.

    Args:
        surface: the map.
        limit: in standard deviations, above 0.
        window: side of the surroundings in points, odd, 3 to 31.

    Raises:
        HeightMapError: a limit or window outside its range, or nothing was measured.
    """
    check_heights("height map", surface.height_um)
    if not limit > 0.0:
        raise HeightMapError(f"outliers need a limit above 0 standard deviations, not {limit:g}")
    if window % 2 == 0 or not 3 <= window <= MAX_WINDOW:
        raise HeightMapError(f"outliers are found in windows of 3, 5, … {MAX_WINDOW} points, not {window}")
    half = window // 2
    height = surface.height_um
    padded = np.pad(height, half, constant_values=np.nan)
    rows, cols = surface.shape
    off, spread = np.full(surface.shape, np.nan), np.full(surface.shape, np.nan)
    step = max(1, BLOCK_POINTS // (cols * window * window))
    for first in range(0, rows, step):
        last = min(first + step, rows)
        views = np.lib.stride_tricks.sliding_window_view(padded[first : last + 2 * half], (window, window))
        around = np.sort(views.reshape(last - first, cols, window * window), axis=-1)
        middle = _sorted_median(around)
        off[first:last] = np.abs(height[first:last] - middle)
        spread[first:last] = _sorted_median(np.sort(np.abs(around - middle[..., None]), axis=-1))
    known = np.isfinite(off)
    overall = float(np.median(off[known])) if known.any() else 0.0
    found: Mask = known & (off > limit * MAD * np.maximum(spread, overall))
    return found


def scar_mask(height_um: FloatArray, scan: Literal["x", "y"], limit: float, length: int) -> Mask:
    """(rows, cols) points of scars: stretches of a line that stand above, or below, both neighbouring lines.

    Args:
        height_um: (rows, cols), NaN where missing.
        scan: axis along which the instrument scanned.
        limit: least difference from both neighbours, in robust standard deviations of differences between lines.
        length: least number of points of a scar.

    Raises:
        HeightMapError: a limit or length out of range, or fewer than three lines.
    """
    from scipy import ndimage  # noqa: PLC0415 - slow to import

    if not limit > 0.0:
        raise HeightMapError(f"scars: the limit is above 0 standard deviations, not {limit:g}")
    if length < 2:
        raise HeightMapError(f"scars: a scar has 2 points or more, not {length}")
    lines = height_um if scan == "x" else height_um.T
    if len(lines) < 3:
        raise HeightMapError("scars: fewer than three lines")
    below, above = lines[1:-1] - lines[:-2], lines[1:-1] - lines[2:]
    known = np.isfinite(below)
    spread = MAD * float(np.median(np.abs(below[known] - np.median(below[known])))) if known.any() else 0.0
    found = np.zeros(lines.shape, dtype=bool)
    for sign in (1.0, -1.0):
        stands = np.zeros(lines.shape, dtype=bool)
        stands[1:-1] = (sign * below > limit * spread) & (sign * above > limit * spread)
        labels, _ = ndimage.label(stands, structure=[[0, 0, 0], [1, 1, 1], [0, 0, 0]])
        found |= (np.bincount(labels.ravel()) >= length)[labels] & stands
    return found if scan == "x" else found.T


def _sorted_median(values: FloatArray) -> FloatArray:
    """Median along the last axis of sorted values, NaN last; NaN where there is none."""
    count = np.count_nonzero(np.isfinite(values), axis=-1)
    middle = np.maximum(count - 1, 0) // 2, count // 2
    ends = [np.take_along_axis(values, k[..., None], axis=-1)[..., 0] for k in middle]
    return np.asarray(np.where(count > 0, 0.5 * (ends[0] + ends[1]), np.nan))
