"""Compiled census of slopes: how often a height map has which slope, so that many poses cost little more than one.

What a facet shines, all of it lit and seen, depends on its normal only. Facets are therefore counted once on a grid
of normals, by the adjoint of cubic Lagrange interpolation; a pose is then evaluated at the nodes of that grid
instead of at every facet, and what lies in shadow is taken off facet by facet (`hidden`). The coordinates are
those of the stereographic projection, in which lobes are equally wide everywhere, so that the steepest wall needs no
finer grid than the level. With nodes an eighth of the roughness apart, the interpolation is exact to a few 10⁻⁵ of
the lobe's peak (error 3/128·h⁴·S⁗ on either axis). A facet that straddles an *edge* is counted as its two parts.
Normals beyond the grid, which only the smoothest plastics have, are *apart*: they are evaluated one by one.
"""

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from anisoscope.base.arrays import FloatArray
from anisoscope.base.kernel_compilation import jit_kernel
from anisoscope.sim.light.kernels import (
    EDGE,
    around_edge,
    blend,
    cell_slopes,
    shine_of,
    split_shares,
    visible,
)
from anisoscope.sim.light.shine import Shine, Vector

Floats = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int64]
Marks = npt.NDArray[np.bool_]

THIRD = 1.0 / 3.0  # in these loops a division costs as much as ten products


@jit_kernel(inline="always")
def projected(gx: float, gy: float) -> tuple[float, float]:
    """Coordinates of a normal (−gx, −gy, 1): twice its stereographic projection, about the slopes near the level."""
    scale = 2.0 / (1.0 + math.sqrt(1.0 + gx * gx + gy * gy))
    return scale * gx, scale * gy


def slopes_at(u: FloatArray, v: FloatArray) -> FloatArray:
    """(N, 2) slopes of normals whose coordinates (N,) are given: the inverse of `projected`."""
    scale = 1.0 / np.maximum(
        1.0 - 0.25 * (u * u + v * v), 1e-6
    )  # nodes about the steepest may lie past the horizon
    return np.stack([scale * u, scale * v], axis=-1)


@jit_kernel(nogil=True, error_model="numpy")
def steepest(z: Floats, first: int, last: int, slopes: Floats) -> None:
    """Least and greatest rise from column to column and from row to row, for every column of some rows of cells.

    Args:
        z: (rows, cols) heights.
        first: first row of cells.
        last: row of cells after the last; the upper points of the last row count along x, too.
        slopes: (4, cols), filled; the last column has none along x.
    """
    cols = z.shape[1]
    slopes[0], slopes[1], slopes[2], slopes[3] = np.inf, -np.inf, np.inf, -np.inf
    for r in range(first, last + 1):
        for c in range(cols - 1):
            rise = z[r, c + 1] - z[r, c]
            slopes[0, c] = rise if rise < slopes[0, c] else slopes[0, c]  # noqa: FURB136 - not where NaN
            slopes[1, c] = rise if rise > slopes[1, c] else slopes[1, c]  # noqa: FURB136
        if r < last:
            for c in range(cols):
                rise = z[r + 1, c] - z[r, c]
                slopes[2, c] = rise if rise < slopes[2, c] else slopes[2, c]  # noqa: FURB136
                slopes[3, c] = rise if rise > slopes[3, c] else slopes[3, c]  # noqa: FURB136


@jit_kernel(nogil=True, error_model="numpy")
def normals(
    z: FloatArray,
    pixel_x: float,
    pixel_y: float,
    triangles: int,
    limits: FloatArray,
    first: int,
    last: int,
    u: Floats,
    v: Floats,
    left: Indices,
) -> None:
    """Coordinates of the normals of the facets in the rows of cells from ``first`` to ``last``.

    Args:
        z: (rows, cols) heights, NaN = missing.
        pixel_x: distance of the columns.
        pixel_y: distance of the rows.
        triangles: as in `kernels.cell_slopes`.
        limits: lowest and highest u, lowest and highest v, of the grid.
        first: first row of cells.
        last: row of cells after the last.
        u: (parts·(rows − 1), cols − 1), filled; the second triangles below all the first. NaN where a facet is not
            to be counted: missing, straddling an edge, or beyond the grid.
        v: the same; NaN where one of the four points is missing, though a triangle has only three.
        left: (parts·(rows − 1),), filled with how many are not to be counted.
    """
    rows, cols = u.shape[0] if triangles == 0 else u.shape[0] // 2, u.shape[1]
    u0, u1, v0, v1 = limits[0], limits[1], limits[2], limits[3]
    for row in range(first, last):
        low, high = z[row], z[row + 1]
        for part in range(1 if triangles == 0 else 2):
            at = row + part * rows
            out_u, out_v = u[at], v[at]
            south, west = blend(triangles, part)
            number = 0
            for c in range(cols):
                gx = (south * (low[c + 1] - low[c]) + (1.0 - south) * (high[c + 1] - high[c])) / pixel_x
                gy = (west * (high[c] - low[c]) + (1.0 - west) * (high[c + 1] - low[c + 1])) / pixel_y
                here, there = projected(gx, gy)
                inside = (u0 < here) & (here < u1) & (v0 < there) & (there < v1)
                out_u[c], out_v[c] = here if inside else math.nan, there
                number += 0 if inside else 1
            left[at] = number
        if triangles != 0:
            continue
        for c in range(1, cols - 1):
            turn = (
                low[c + 2]
                - low[c + 1]
                - low[c]
                + low[c - 1]
                + high[c + 2]
                - high[c + 1]
                - high[c]
                + high[c - 1]
            )
            if abs(turn) > 1.99 * EDGE * pixel_x:  # seldom: only then is it worth looking closely
                gx, _ = cell_slopes(z, row, c, pixel_x, pixel_y, 0, 0)
                if around_edge(z, row, c, gx, pixel_x)[2] < 1.0:
                    u[row, c] = math.nan
                    left[row] += 1


@njit(cache=True, error_model="numpy")
def facets_left(
    z: FloatArray,
    pixel_x: float,
    pixel_y: float,
    triangles: int,
    limits: FloatArray,
    u: Floats,
    v: Floats,
    left: Indices,
) -> tuple[Indices, FloatArray, Marks]:
    """Facets that `normals` left out and that are not missing; arguments as there.

    Returns:
        (N, 2) row and column of the cell; (N, 4) slopes along x before and after the edge, share of the first, slope
        along y, without an edge the share is 1; (N,) whether the grid holds all of it.
    """
    rows, cols, most = z.shape[0] - 1, z.shape[1] - 1, left.sum()
    where, slopes = np.empty((most, 2), dtype=np.int64), np.empty((most, 4))
    held, n = np.ones(most, dtype=np.bool_), 0
    for row in range(u.shape[0]):
        if left[row] == 0:
            continue
        r, part = row % rows, row // rows
        for c in range(cols):
            if not math.isnan(u[row, c]) or math.isnan(v[row, c]):
                continue
            gx, gy = cell_slopes(z, r, c, pixel_x, pixel_y, triangles, part)
            before, after, first = around_edge(z, r, c, gx, pixel_x) if triangles == 0 else (gx, gx, 1.0)
            where[n, 0], where[n, 1] = r, c
            slopes[n, 0], slopes[n, 1], slopes[n, 2], slopes[n, 3] = before, after, first, gy
            for side in (before, after):
                here, there = projected(side, gy)
                held[n] &= limits[0] < here < limits[1] and limits[2] < there < limits[3]
            n += 1
    return where[:n], slopes[:n], held[:n]


@njit(cache=True)
def edge_parts(where: Indices, slopes: FloatArray, weights: FloatArray) -> tuple[Floats, Floats, FloatArray]:
    """Coordinates (1, 2N) and weights (2N,) of both parts of cells that straddle an edge, as `count` takes them."""
    u, v = np.empty((1, 2 * len(where)), dtype=np.float32), np.empty((1, 2 * len(where)), dtype=np.float32)
    parts = np.empty(2 * len(where))
    for n in range(len(where)):
        whole, first = weights[where[n, 1]], slopes[n, 2]
        for side in range(2):
            u[0, 2 * n + side], v[0, 2 * n + side] = projected(slopes[n, side], slopes[n, 3])
            parts[2 * n + side] = whole * (first if side == 0 else 1.0 - first)
    return u, v, parts


@jit_kernel(inline="always")
def cubic(t: float) -> tuple[float, float, float, float]:
    """Lagrange weights of the nodes −1, 0, 1, 2 at 0 ≤ t < 1."""
    before, after, far = t + 1.0, t - 1.0, t - 2.0
    inner, outer = after * far * 0.5, before * t
    return -t * inner * THIRD, before * inner, -0.5 * outer * far, 0.5 * THIRD * outer * after


@jit_kernel(nogil=True, error_model="numpy")
def count(
    u: Floats, v: Floats, weights: FloatArray, grid: FloatArray, found: FloatArray, cells: Marks
) -> None:
    """Add the weight of facets to the grid of normals.

    Args:
        u: (R, C) coordinates, NaN where there is nothing to count.
        v: (R, C) coordinates.
        weights: (C,) weights of the columns.
        grid: first node and number of nodes per unit along u, the same along v.
        found: (nv, nu) weights, added to.
        cells: (nv, nu) set where a facet lies between a node and the next ones.
    """
    for r in range(u.shape[0]):
        for c in range(u.shape[1]):
            if math.isnan(u[r, c]):
                continue
            x, y = (u[r, c] - grid[0]) * grid[1], (v[r, c] - grid[2]) * grid[3]
            i, j = np.uintp(x), np.uintp(y)
            cells[j, i] = True
            x0, x1, x2, x3 = cubic(x - i)
            y0, y1, y2, y3 = cubic(y - j)
            low, row = i - np.uintp(1), j - np.uintp(1)
            for weight in (y0, y1, y2, y3):
                w = weight * weights[c]
                found[row, low] += w * x0
                found[row, low + np.uintp(1)] += w * x1
                found[row, low + np.uintp(2)] += w * x2
                found[row, low + np.uintp(3)] += w * x3
                row += np.uintp(1)


@jit_kernel(nogil=True, error_model="numpy")
def shine_at(
    slopes: FloatArray,
    shine: Shine,
    values: FloatArray,
) -> None:
    """Fill (N,) values of `kernels.shine_of` at (N, 2) slopes."""
    for n in range(len(slopes)):
        values[n] = shine_of(slopes[n, 0], slopes[n, 1], shine)


@jit_kernel(inline="always")
def _between(shine: Floats, grid: FloatArray, u: float, v: float) -> float:
    """Radiance of a normal, from the values at the nodes around it."""
    x, y = (u - grid[0]) * grid[1], (v - grid[2]) * grid[3]
    i, j = np.uintp(x), np.uintp(y)
    x0, x1, x2, x3 = cubic(x - i)
    low, row, value = i - np.uintp(1), j - np.uintp(1), 0.0
    for weight in cubic(y - j):
        line = x0 * shine[row, low] + x1 * shine[row, low + np.uintp(1)]
        line += x2 * shine[row, low + np.uintp(2)] + x3 * shine[row, low + np.uintp(3)]
        value += weight * line
        row += np.uintp(1)
    return value


@jit_kernel(nogil=True, error_model="numpy")
def hidden(
    u: Floats,
    v: Floats,
    weights: FloatArray,
    grid: FloatArray,
    shine: Floats,
    lit: Floats,
    seen: Floats,
    same_side: bool,
) -> float:
    """Radiance of the counted facets, were they not in shadow or hidden.

    ``shine`` holds (nv, nu) values at the nodes of the grid; ``lit`` and ``seen`` (rows, C) shares, ``u``, ``v``
    (R, C) coordinates with R = rows or, with triangles, 2·rows.
    """
    rows, cols = lit.shape
    total = 0.0
    for r in range(rows):
        light, sight = lit[r], seen[r]
        for c in range(cols):
            if light[c] + sight[c] >= 2.0:
                continue
            lost = weights[c] * (1.0 - visible(light[c], sight[c], same_side))
            for row in range(r, u.shape[0], rows):
                if not math.isnan(u[row, c]):
                    total += lost * _between(shine, grid, u[row, c], v[row, c])
    return float(total)


@jit_kernel(nogil=True, error_model="numpy")
def hidden_edges(
    where: Indices,
    slopes: FloatArray,
    weights: FloatArray,
    grid: FloatArray,
    shine: Floats,
    lit: Floats,
    seen: Floats,
    light: Vector,
    camera: Vector,
) -> float:
    """The same for the facets that straddle an edge; ``where`` and ``slopes`` as in `census_kernels.facets_left`."""
    total = 0.0
    for n in range(len(where)):
        r, c = where[n, 0], where[n, 1]
        before, after, first, gy = slopes[n, 0], slopes[n, 1], slopes[n, 2], slopes[n, 3]
        shares = split_shares((before, after, first), gy, lit[r, c], seen[r, c], light, camera)
        for slope, part, share in ((before, first, shares[0]), (after, 1.0 - first, shares[1])):
            if share < part:
                u, v = projected(slope, gy)
                total += weights[c] * (part - share) * _between(shine, grid, u, v)
    return float(total)


@jit_kernel(nogil=True, error_model="numpy")
def counted_in_cells(
    u: Floats,
    v: Floats,
    grid: FloatArray,
    shine: Floats,
    lit: Floats,
    seen: Floats,
    same_side: bool,
    cell_row: Indices,
    cell_col: Indices,
    cells: FloatArray,
) -> None:
    """Add what the counted facets show to coarse cells; arguments as for `hidden`.

    ``cell_row`` (rows,) and ``cell_col`` (C,) are the places in ``cells`` of the rows and columns of facets.
    """
    rows, cols = lit.shape
    part = rows / u.shape[0]
    for r in range(rows):
        light, sight, cell = lit[r], seen[r], cells[cell_row[r]]
        for c in range(cols):
            share = visible(light[c], sight[c], same_side)
            if share <= 0.0:
                continue
            for row in range(r, u.shape[0], rows):
                if not math.isnan(u[row, c]):
                    cell[cell_col[c]] += part * share * _between(shine, grid, u[row, c], v[row, c])


@jit_kernel(inline="always")
def _facet_shine(slope: FloatArray, lit: float, seen: float, same_side: bool, shine: Shine) -> float:
    """Radiance of one facet; its slope (before, after, first, gy) may change at an edge."""
    before, after, first, gy = slope[0], slope[1], slope[2], slope[3]
    if first < 1.0:
        shares = split_shares((before, after, first), gy, lit, seen, shine.light, shine.camera)
    else:
        shares = visible(lit, seen, same_side), 0.0
    total = 0.0
    if shares[0] > 0.0:
        total += shares[0] * shine_of(before, gy, shine)
    if shares[1] > 0.0:
        total += shares[1] * shine_of(after, gy, shine)
    return total


@jit_kernel(nogil=True, error_model="numpy")
def left_in_cells(
    where: Indices,
    slopes: FloatArray,
    part: float,
    lit: Floats,
    seen: Floats,
    same_side: bool,
    shine: Shine,
    cell_row: Indices,
    cell_col: Indices,
    cells: FloatArray,
) -> None:
    """The same for the facets that are not counted, one by one; ``part`` is the share of a cell of the map of each."""
    for n in range(len(where)):
        r, c = where[n, 0], where[n, 1]
        cells[cell_row[r], cell_col[c]] += part * _facet_shine(
            slopes[n], lit[r, c], seen[r, c], same_side, shine
        )


@jit_kernel(nogil=True, error_model="numpy")
def apart_shine(
    where: Indices,
    slopes: FloatArray,
    weights: FloatArray,
    lit: Floats,
    seen: Floats,
    same_side: bool,
    shine: Shine,
) -> float:
    """Radiance of the facets beyond the grid, one by one; arguments as above."""
    total = 0.0
    for n in range(len(where)):
        r, c = where[n, 0], where[n, 1]
        total += weights[c] * _facet_shine(slopes[n], lit[r, c], seen[r, c], same_side, shine)
    return float(total)
