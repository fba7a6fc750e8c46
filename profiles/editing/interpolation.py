"""Heights between the points of a map and over larger cells, where points may be missing.

A height between points counts as measured where the measured ones among its neighbours have at least half of the weight
of linear interpolation, so that a gap keeps its size. The missing neighbours are continued along straight lines from
the measured ones; a plane with gaps is interpolated exactly.
"""

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.heightmap import HeightMap, Layer
from anisoscope.profiles.textures.forms import fit_form

Mask = npt.NDArray[np.bool_]

DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
LEAST_SHARE = 0.5
ROUNDING = 1e-6
EXACT = 1e-9
REACH = {1: 1, 3: 2}
"""Points on each side that an interpolation of this order looks at."""


def continued(height_um: FloatArray, rings: int = 1) -> FloatArray:
    """Heights (rows, cols) with the missing ones replaced, for interpolation between measured points only.

    Args:
        height_um: heights, NaN where missing, at least one measured.
        rings: how many points beyond the measured ones follow straight lines; further ones repeat the nearest.
    """
    from scipy import ndimage  # noqa: PLC0415 - slow to import

    gaps = np.isnan(height_um)
    if not gaps.any():
        return height_um
    nearest = ndimage.distance_transform_edt(gaps, return_distances=False, return_indices=True)
    found = np.asarray(height_um[tuple(nearest)], dtype=np.float64)
    padded = np.pad(height_um, 2, constant_values=np.nan)
    for _ in range(rings):
        ring = ndimage.binary_dilation(~np.isnan(padded), np.ones((3, 3), dtype=np.bool_)) & np.isnan(padded)
        ring[:2] = ring[-2:] = False
        ring[:, :2] = ring[:, -2:] = False
        i, j = np.nonzero(ring)
        if not i.size:
            break
        guess = _straight(padded, i, j)
        known = np.isfinite(guess)
        padded[i[known], j[known]] = guess[known]
        found[i[known] - 2, j[known] - 2] = guess[known]
    return found


def _straight(padded: FloatArray, i: npt.NDArray[np.intp], j: npt.NDArray[np.intp]) -> FloatArray:
    """Mean of what the points on straight lines through a place predict there; NaN where there are none."""
    total, weight = np.zeros(i.size), np.zeros(i.size)

    def add(value: FloatArray, worth: float) -> None:
        known = np.isfinite(value)
        total[known] += worth * value[known]
        weight[known] += worth

    for di, dj in DIRECTIONS:
        one, two = padded[i + di, j + dj], padded[i - di, j - dj]
        add(0.5 * (one + two), 2.0)
        add(2.0 * one - padded[i + 2 * di, j + 2 * dj], 1.0)
        add(2.0 * two - padded[i - 2 * di, j - 2 * dj], 1.0)
    return np.asarray(np.where(weight > 0.0, total / np.maximum(weight, 1.0), np.nan))


class Interpolated:
    """A map between its points."""

    def __init__(self, surface: HeightMap, order: Literal[1, 3] = 1) -> None:
        """Prepare a map.

        Args:
            surface: the map, some of it measured.
            order: 1 (linear) or 3 (cubic spline).
        """
        from scipy import ndimage  # noqa: PLC0415 - slow to import

        self.surface = surface
        self.order: Literal[1, 3] = order
        height = continued(surface.height_um, REACH[order])
        self._coefficients = ndimage.spline_filter(height, order) if order > 1 else height
        known = np.isfinite(surface.height_um)
        self._known = None if known.all() else known.astype(np.float32)

    def at(self, y_um: FloatArray, x_um: FloatArray) -> FloatArray:
        """Heights in µm at positions from the first point; NaN where missing and beyond the outer points.

        Args:
            y_um: positions along y, any shape.
            x_um: positions along x, the same shape.
        """
        from scipy import ndimage  # noqa: PLC0415 - slow to import

        rows, cols = self.surface.shape
        i, j = y_um / self.surface.pixel_y_um, x_um / self.surface.pixel_x_um
        inside = (i >= -ROUNDING) & (i <= rows - 1 + ROUNDING) & (j >= -ROUNDING) & (j <= cols - 1 + ROUNDING)
        places = np.stack([np.clip(i, 0.0, rows - 1.0), np.clip(j, 0.0, cols - 1.0)])
        found = ndimage.map_coordinates(
            self._coefficients, places, order=self.order, mode="mirror", prefilter=False
        )
        if self._known is not None:
            share = ndimage.map_coordinates(self._known, places, order=1, mode="nearest")
            inside &= share >= LEAST_SHARE - ROUNDING
        return np.asarray(np.where(inside, found, np.nan), dtype=np.float64)


def carried(surface: HeightMap, move: Callable[[HeightMap], FloatArray]) -> dict[str, Layer]:
    """Layers of a map on another grid.

    Args:
        surface: the map with its layers.
        move: gives the numbers of a map, (rows, cols), on the other grid; every channel of a layer is one.
    """
    found = {}
    for name, layer in surface.layers.items():
        parts = []
        for channel in np.dsplit(np.atleast_3d(layer), layer.shape[2] if layer.ndim == 3 else 1):
            values = channel[..., 0].astype(np.float64)
            known = np.isfinite(values).any()
            part = move(
                HeightMap(values if known else np.zeros_like(values), surface.pixel_x_um, surface.pixel_y_um)
            )
            parts.append(part if known else np.full_like(part, np.nan))
        found[name] = (np.stack(parts, axis=2) if layer.ndim == 3 else parts[0]).astype(np.float32)
    return found


def averaged(surface: HeightMap, pixel_um: tuple[float, float]) -> HeightMap:
    """Means over larger cells, each of the measured points that at least half of it holds.

    Cells cut through points, and points are missing, so that the mean stands for another place than the middle of the
    cell: the plane of the map is taken off before and added after.

    Args:
        surface: the map, (rows, cols) in µm.
        pixel_um: (y, x) size of the cells, not smaller than the pixel.

    Raises:
        HeightMapError: less than two cells along an axis.
    """
    known = np.isfinite(surface.height_um)
    plane, wide = _plane(surface, pixel_um)
    matrices = [
        _overlaps(count, old, new)
        for count, old, new in zip(
            surface.shape, (surface.pixel_y_um, surface.pixel_x_um), pixel_um, strict=True
        )
    ]
    total = matrices[0] @ np.where(known, surface.height_um - plane, 0.0) @ matrices[1].T
    share = matrices[0] @ known.astype(np.float64) @ matrices[1].T
    enough = share >= LEAST_SHARE - EXACT
    at_y, at_x = (np.arange(count) for count in share.shape)
    middles = wide[0] + np.add.outer(wide[1] * at_y, wide[2] * at_x)
    height = np.where(enough, middles + total / np.maximum(share, EXACT), np.nan)
    layers = carried(surface, lambda one: averaged(one, pixel_um).height_um)
    return HeightMap(height, pixel_um[1], pixel_um[0], surface.origin, layers)


def _plane(
    surface: HeightMap, pixel_um: tuple[float, float]
) -> tuple[FloatArray, tuple[float, float, float]]:
    """The plane of a map, and its height in the first of larger cells, and steps from cell to cell along y and x."""
    try:
        plane = fit_form(surface, "plane").height_um
    except HeightMapError:  # the points stand on a line
        plane = fit_form(surface, "none").height_um
    rise_y, rise_x = float(plane[1, 0] - plane[0, 0]), float(plane[0, 1] - plane[0, 0])
    ratio_y, ratio_x = pixel_um[0] / surface.pixel_y_um, pixel_um[1] / surface.pixel_x_um
    first = float(plane[0, 0]) + 0.5 * (ratio_y - 1.0) * rise_y + 0.5 * (ratio_x - 1.0) * rise_x
    return plane, (first, ratio_y * rise_y, ratio_x * rise_x)


def _overlaps(count: int, old: float, new: float) -> Any:  # noqa: ANN401 - a sparse matrix; scipy is slow to import
    """Share (new points, old points) that each old cell has in each new one."""
    from scipy import sparse  # noqa: PLC0415 - slow to import

    size = int(np.floor(count * old / new + EXACT))
    if size < 2:
        raise HeightMapError(
            f"resample: a pixel of {new:g} µm leaves less than two points of a field of {count * old:g} µm"
        )
    edges = np.arange(size + 1) * new / old
    first = np.floor(edges[:-1] + EXACT).astype(np.intp)
    reach = int(np.ceil(new / old)) + 1
    columns = first[:, None] + np.arange(reach)[None, :]
    share = np.minimum(columns + 1, edges[1:, None]) - np.maximum(columns, edges[:-1, None])
    share = np.maximum(share, 0.0) * old / new
    inside = (share > EXACT) & (columns < count)
    rows = np.broadcast_to(np.arange(size)[:, None], columns.shape)
    return sparse.csr_matrix((share[inside], (rows[inside], columns[inside])), shape=(size, count))
