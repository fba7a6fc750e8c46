"""Compiled census of slopes: how often a height map has which slope, so that many poses cost little more than one.

What a facet shines, all of it lit and seen, depends on its two slopes only. Facets are therefore counted once on a
grid of slopes, by the adjoint of cubic Lagrange interpolation; a pose is then evaluated at the nodes of that grid
instead of at every facet, and what lies in shadow is taken off facet by facet. With nodes a tenth of the roughness
apart, the interpolation is exact to a few 10⁻⁵ of the lobe's peak (error 3/128·h⁴·S⁗ on either axis). Facets that
straddle an edge, or are steeper than the grid, are *apart*: they are evaluated one by one.
"""

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from anisoscope.sim.light.kernels import _shine, around_edge, cell_slopes, split_shine, visible

FloatArray = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int64]

MISSING, COUNTED, APART = 0, 1, 2


@njit(cache=True, nogil=True)
def facet_slopes(
    z: FloatArray,
    pixel_x: float,
    pixel_y: float,
    triangles: int,
    limits: FloatArray,
    first: int,
    last: int,
    gx: Floats,
    gy: Floats,
    kind: npt.NDArray[np.uint8],
) -> None:
    """Slopes of the facets in the rows of cells from ``first`` to ``last``, and how each is to be counted.

    Args:
        z: (rows, cols) heights, NaN = missing.
        pixel_x: distance of the columns.
        pixel_y: distance of the rows.
        triangles: 0: one facet with the symmetric gradients of four points. 1, 2: two triangles, split along the
            diagonal from the first to the last corner (1) or along the other (2).
        limits: lowest and highest slope along x, lowest and highest along y, of the grid.
        first: first row of cells.
        last: row of cells after the last.
        gx: (parts·(rows − 1), cols − 1), filled with slopes along x; the second triangles below all the first.
        gy: the same along y.
        kind: the same, filled with kinds.
    """
    rows, cols = z.shape
    parts = 1 if triangles == 0 else 2
    for r in range(first, last):
        for c in range(cols - 1):
            whole = not math.isnan(z[r, c] + z[r + 1, c + 1] + z[r, c + 1] + z[r + 1, c])
            for part in range(parts):
                sx, sy = cell_slopes(z, r, c, pixel_x, pixel_y, triangles, part)
                row = r + part * (rows - 1)
                gx[row, c], gy[row, c] = sx, sy
                inside = limits[0] < sx < limits[1] and limits[2] < sy < limits[3]
                if not whole:
                    kind[row, c] = MISSING
                elif not inside or (triangles == 0 and around_edge(z, r, c, sx, pixel_x)[2] < 1.0):
                    kind[row, c] = APART
                else:
                    kind[row, c] = COUNTED


@njit(cache=True)
def facets_apart(
    z: FloatArray, pixel_x: float, pixel_y: float, triangles: int, kind: npt.NDArray[np.uint8]
) -> tuple[Indices, FloatArray]:
    """Facets that are evaluated one by one.

    Returns:
        (N, 2) row and column of the cell; (N, 4) slopes along x before and after the edge, share of the first, slope
        along y. Without an edge the share is 1.
    """
    rows, cols = z.shape[0] - 1, z.shape[1] - 1
    number = 0
    for r in range(kind.shape[0]):
        for c in range(cols):
            number += kind[r, c] == APART
    where, slopes = np.empty((number, 2), dtype=np.int64), np.empty((number, 4))
    n = 0
    for row in range(kind.shape[0]):
        r, part = row % rows, row // rows
        for c in range(cols):
            if kind[row, c] != APART:
                continue
            sx, sy = cell_slopes(z, r, c, pixel_x, pixel_y, triangles, part)
            before, after, first = around_edge(z, r, c, sx, pixel_x) if triangles == 0 else (sx, sx, 1.0)
            where[n], slopes[n, 0], slopes[n, 1], slopes[n, 2], slopes[n, 3] = (
                (r, c),
                before,
                after,
                first,
                sy,
            )
            n += 1
    return where, slopes


@njit(cache=True)
def extent(gx: Floats, gy: Floats, kind: npt.NDArray[np.uint8]) -> FloatArray:
    """Lowest and highest slope of the counted facets along x, then along y; zeros where there are none."""
    box = np.array([np.inf, -np.inf, np.inf, -np.inf])
    for r in range(gx.shape[0]):
        for c in range(gx.shape[1]):
            if kind[r, c] == COUNTED:
                box[0], box[1] = min(box[0], gx[r, c]), max(box[1], gx[r, c])
                box[2], box[3] = min(box[2], gy[r, c]), max(box[3], gy[r, c])
    return box if box[0] <= box[1] else np.zeros(4)


@njit(cache=True, inline="always")
def _lagrange(t: float, weights: FloatArray) -> None:
    """Cubic Lagrange weights of the nodes −1, 0, 1, 2 at 0 ≤ t < 1."""
    weights[0] = -t * (t - 1.0) * (t - 2.0) / 6.0
    weights[1] = (t + 1.0) * (t - 1.0) * (t - 2.0) * 0.5
    weights[2] = -(t + 1.0) * t * (t - 2.0) * 0.5
    weights[3] = (t + 1.0) * t * (t - 1.0) / 6.0


@njit(cache=True, nogil=True)
def count(
    gx: Floats,
    gy: Floats,
    kind: npt.NDArray[np.uint8],
    weights: FloatArray,
    grid: FloatArray,
    found: FloatArray,
) -> None:
    """Add the weight of counted facets to the grid of slopes.

    Args:
        gx: (R, C) slopes along x.
        gy: (R, C) slopes along y.
        kind: (R, C) kinds.
        weights: (C,) weights of the columns.
        grid: first node and distance of nodes along x, the same along y.
        found: (ny, nx) weights, NaN where no facet touched a node so far.
    """
    rows, cols = gx.shape
    wx, wy = np.empty(4), np.empty(4)
    for r in range(rows):
        for c in range(cols):
            if kind[r, c] != COUNTED:
                continue
            x, y = (gx[r, c] - grid[0]) / grid[1], (gy[r, c] - grid[2]) / grid[3]
            i, j = int(x), int(y)
            _lagrange(x - i, wx)
            _lagrange(y - j, wy)
            for b in range(4):
                for a in range(4):
                    old = found[j + b - 1, i + a - 1]
                    add = weights[c] * wy[b] * wx[a]
                    found[j + b - 1, i + a - 1] = add if math.isnan(old) else old + add


@njit(cache=True, nogil=True)
def shine_at(
    slopes: FloatArray,
    light: FloatArray,
    camera: FloatArray,
    half: FloatArray,
    lobe: FloatArray,
    table: FloatArray,
) -> FloatArray:
    """(N,) values of `kernels._shine` at (N, 2+) slopes."""
    values = np.empty(len(slopes))
    for n in range(len(slopes)):
        values[n] = _shine(slopes[n, 0], slopes[n, 1], light, camera, half, lobe, table)
    return values


@njit(cache=True, nogil=True)
def apart_shine(
    where: Indices,
    slopes: FloatArray,
    weights: FloatArray,
    lit: Floats,
    seen: Floats,
    same_side: bool,
    light: FloatArray,
    camera: FloatArray,
    half: FloatArray,
    lobe: FloatArray,
    table: FloatArray,
) -> float:
    """What the facets apart add; ``weights`` of the columns of cells, the rest as above."""
    total = 0.0
    for n in range(len(where)):
        r, c = where[n, 0], where[n, 1]
        first = slopes[n, 2]
        share = visible(lit[r, c], seen[r, c], same_side)
        if first < 1.0:
            edge = slopes[n, 0], slopes[n, 1], first
            value = split_shine(edge, slopes[n, 3], lit[r, c], seen[r, c], light, camera, half, lobe, table)
        else:
            value = share * _shine(slopes[n, 0], slopes[n, 3], light, camera, half, lobe, table)
        total += weights[c] * value
    return float(total)


@njit(cache=True, nogil=True)
def hidden(
    gx: Floats,
    gy: Floats,
    kind: npt.NDArray[np.uint8],
    weights: FloatArray,
    grid: FloatArray,
    shine: Floats,
    lit: Floats,
    seen: Floats,
    same_side: bool,
) -> float:
    """What the counted facets would add were they not in shadow or hidden.

    ``shine`` holds (ny, nx) values at the nodes of the grid; ``lit`` and ``seen`` (rows, C) shares, ``gx``, ``gy``
    and ``kind`` (R, C) with R = rows or, with triangles, 2·rows.
    """
    cols = gx.shape[1]
    rows = lit.shape[0]
    wx, wy = np.empty(4), np.empty(4)
    total = 0.0
    for r in range(gx.shape[0]):
        light, sight = lit[r % rows], seen[r % rows]
        for c in range(cols):
            if light[c] + sight[c] >= 2.0 or kind[r, c] != COUNTED:
                continue
            lost = 1.0 - visible(light[c], sight[c], same_side)
            x, y = (gx[r, c] - grid[0]) / grid[1], (gy[r, c] - grid[2]) / grid[3]
            i, j = int(x), int(y)
            _lagrange(x - i, wx)
            _lagrange(y - j, wy)
            value = 0.0
            for b in range(4):
                line = shine[j + b - 1, i - 1 : i + 3]
                value += wy[b] * (wx[0] * line[0] + wx[1] * line[1] + wx[2] * line[2] + wx[3] * line[3])
            total += weights[c] * lost * value
    return float(total)
