"""Compiled sums over a census of slopes (`census_kernels`) in one pose."""

import math

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.light.census_kernels import cubic, projected
from anisoscope.sim.light.compiled import borrowing
from anisoscope.sim.light.kernels import shine_of, split_shares, visible
from anisoscope.sim.light.shine import Shine, Vector

Floats = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int64]


@borrowing(nogil=True, error_model="numpy")
def shine_at(
    slopes: FloatArray,
    shine: Shine,
    values: FloatArray,
) -> None:
    """Fill (N,) values of `kernels.shine_of` at (N, 2) slopes."""
    for n in range(len(slopes)):
        values[n] = shine_of(slopes[n, 0], slopes[n, 1], shine)


@borrowing(inline="always")
def _between(shine: Floats, grid: FloatArray, u: float, v: float) -> float:
    """What a normal shines, from the values at the nodes around it."""
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


@borrowing(nogil=True, error_model="numpy")
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
    """What the counted facets would add were they not in shadow or hidden.

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


@borrowing(nogil=True, error_model="numpy")
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


@borrowing(nogil=True, error_model="numpy")
def apart_shine(
    where: Indices,
    slopes: FloatArray,
    weights: FloatArray,
    lit: Floats,
    seen: Floats,
    same_side: bool,
    shine: Shine,
) -> float:
    """What the facets beyond the grid add, one by one; arguments as above."""
    total = 0.0
    for n in range(len(where)):
        r, c = where[n, 0], where[n, 1]
        before, after, first, gy = slopes[n, 0], slopes[n, 1], slopes[n, 2], slopes[n, 3]
        if first < 1.0:
            shares = split_shares(
                (before, after, first), gy, lit[r, c], seen[r, c], shine.light, shine.camera
            )
        else:
            shares = visible(lit[r, c], seen[r, c], same_side), 0.0
        for slope, share in ((before, shares[0]), (after, shares[1])):
            if share > 0.0:
                total += weights[c] * share * shine_of(slope, gy, shine)
    return float(total)
