"""Compiled rays over a height map: which facet a ray meets, and the slopes of the light-giving facet there.

A ray goes from grid line to grid line; where it crosses one, its height is compared with that of the map, linear
between the two points. The first cell at whose far side it stands below the map is met, at the place where the
difference passes zero. A facet that straddles an edge is bent there, as if its neighbours were drawn on until
they meet: a chord would cut off the foot of a wall. Positions x, y count columns and rows, heights are in µm.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from anisoscope.base.kernel_compilation import jit_kernel
from anisoscope.sim.light.relief_blocks import leap

HeightArray = npt.NDArray[np.float32]
Met = tuple[bool, float, float, float, int, int]

EDGE = 1.5
"""Difference of the neighbours' slopes from which a facet between them straddles an edge."""

UNMET = -1.0
NEVER = 1e30


class Terrain(NamedTuple):
    """A height map for rays.

    Attributes:
        z: (rows, cols) heights in µm, NaN where missing.
        top: greatest height in µm: a ray that climbs past it is gone.
        period: columns after which the map repeats along x, 0 if it does not. Beyond all other edges the
            nearest point of the edge goes on.
        span: facet columns that the mean runs over, counted from 0.
        beyond_x: columns beyond the edges on which paths from the light begin too.
        beyond_y: rows beyond the edges on which paths from the light begin too.
        pixel_x: distance of columns in µm.
        pixel_y: distance of rows in µm.
        bulge: (rows − 1, cells) height in µm of the edge over the chord in facets that straddle one, else 0.
        part: (rows − 1, cells) share of such a facet before the edge.
        facets: 0: four points a facet, symmetric gradients; 1, 2: two triangles, cut by the diagonal that
            begins at (row, col) or at (row, col + 1).
        turn: cosine and sine of the direction of the ridges, counter-clockwise from y.
        ceiling: heights over which rays leap over blocks, from `relief_blocks.ceilings`.
    """

    z: HeightArray
    top: float
    period: int
    span: float
    beyond_x: float
    beyond_y: float
    pixel_x: float
    pixel_y: float
    bulge: HeightArray
    part: HeightArray
    facets: int
    turn: tuple[float, float]
    ceiling: HeightArray


@jit_kernel(inline="always")
def _columns(terrain: Terrain, col: int) -> tuple[int, int]:
    """Columns of the points left and right of a cell, anywhere along x."""
    if terrain.period > 0:
        left = col % terrain.period
        return left, left + 1
    last = terrain.z.shape[1] - 1
    return min(max(col, 0), last), min(max(col + 1, 0), last)


@jit_kernel(inline="always")
def _rows(terrain: Terrain, row: int) -> tuple[int, int]:
    """Rows of the points below and above a cell, anywhere along y."""
    last = terrain.z.shape[0] - 1
    return min(max(row, 0), last), min(max(row + 1, 0), last)


@jit_kernel(inline="always")
def _bend(terrain: Terrain, row: int, col: int) -> tuple[float, float]:
    """Bulge and part of a cell, anywhere."""
    rows, cells = terrain.bulge.shape
    if terrain.period > 0:
        col %= terrain.period
    elif col < 0 or col >= cells:
        return 0.0, 1.0
    row = min(max(row, 0), rows - 1)
    return terrain.bulge[row, col], terrain.part[row, col]


@njit(cache=True, nogil=True)
def bends(z: HeightArray, period: int, pixel_x: float) -> tuple[HeightArray, HeightArray]:
    """Bulge and part of every cell, for `Terrain`."""
    rows, cells = z.shape[0] - 1, period if period > 0 else z.shape[1] - 1
    bulge, part = np.zeros((rows, cells), dtype=np.float32), np.ones((rows, cells), dtype=np.float32)
    for r in range(rows):
        slope = (
            0.5 * (z[r, 1 : cells + 1] - z[r, :cells] + z[r + 1, 1 : cells + 1] - z[r + 1, :cells]) / pixel_x
        )
        for c in range(cells):
            if period == 0 and (c == 0 or c == cells - 1):
                continue
            before, here, after = slope[c - 1], slope[c], slope[(c + 1) % cells]
            if abs(after - before) > EDGE and (here - before) * (after - here) > 0.0:  # false where NaN
                first = (after - here) / (after - before)
                if 1e-6 < first < 1.0 - 1e-6:  # in single precision neither side may vanish
                    part[r, c] = first
                    bulge[r, c] = (before - here) * first * pixel_x
    return bulge, part


@jit_kernel(inline="always")
def _over_chord(bulge: float, part: float, u: float) -> float:
    """Height of a bent facet over its chord."""
    return bulge * (u / part if u < part else (1.0 - u) / (1.0 - part))


@jit_kernel()
def slopes(terrain: Terrain, row: int, col: int, u: float, v: float) -> tuple[float, float]:
    """Slopes along x and y of the facet at the place (u, v) within the cell at (row, col); NaN where missing."""
    z, (r0, r1), (c0, c1) = terrain.z, _rows(terrain, row), _columns(terrain, col)
    south, north = float(z[r0, c1] - z[r0, c0]), float(z[r1, c1] - z[r1, c0])
    west, east = float(z[r1, c0] - z[r0, c0]), float(z[r1, c1] - z[r0, c1])
    if terrain.facets != 0:
        known = 0.0 * (south + north)
        lower = u > v if terrain.facets == 1 else u + v < 1.0
        rise_x = south if lower else north
        rise_y = east if (u > v if terrain.facets == 1 else u + v >= 1.0) else west
        return rise_x / terrain.pixel_x + known, rise_y / terrain.pixel_y
    gx, gy = 0.5 * (south + north) / terrain.pixel_x, 0.5 * (west + east) / terrain.pixel_y
    bulge, part = _bend(terrain, row, col)
    if bulge != 0.0:
        gx += (bulge / part if u < part else -bulge / (1.0 - part)) / terrain.pixel_x
    return gx, gy


@jit_kernel()
def height(terrain: Terrain, row: int, col: int, u: float, v: float) -> float:
    """Height in µm at (u, v) within a cell; NaN where a point is missing."""
    z, (r0, r1), (c0, c1) = terrain.z, _rows(terrain, row), _columns(terrain, col)
    low = z[r0, c0] + u * (z[r0, c1] - z[r0, c0])
    flat = float(low + v * (z[r1, c0] + u * (z[r1, c1] - z[r1, c0]) - low))
    bulge, part = _bend(terrain, row, col) if terrain.facets == 0 else (0.0, 1.0)
    return flat + _over_chord(bulge, part, u) if bulge != 0.0 else flat


@jit_kernel()
def _meet_bent(
    bend: tuple[float, float], entry: float, leave: float, gap: float, left: float, first: bool
) -> tuple[float, float]:
    """Point at which a ray meets a bent facet, as a share of its way through the cell, and its lift.

    ``entry`` and ``leave`` are u of both ends of that way, ``gap`` and ``left`` its heights there over the chord.
    """
    bulge, part = bend
    over = _over_chord(bulge, part, entry)
    start = 0.0 if first else gap - over
    end, lift, share = left - _over_chord(bulge, part, leave), 0.0, 0.0
    if (entry - part) * (leave - part) < 0.0:
        share = (part - entry) / (leave - entry)
        middle = (over if first else gap) * (1.0 - share) + left * share - bulge
        if first:
            lift = max(0.0, -middle)
        elif middle < 0.0 and middle < start:
            return share * max(start, 0.0) / (max(start, 0.0) - middle), 0.0
        start, end = middle + lift, end + lift
    elif first:
        return UNMET, max(0.0, -end)
    if end < 0.0 and end < start:
        return share + (1.0 - share) * max(start, 0.0) / (max(start, 0.0) - end), lift
    return UNMET, lift


@jit_kernel(inline="always")
def _known(z: HeightArray, rows: tuple[int, int], cols: tuple[int, int]) -> bool:
    """Whether no corner of a cell is missing."""
    return not math.isnan(
        z[rows[0], cols[0]] + z[rows[0], cols[1]] + z[rows[1], cols[0]] + z[rows[1], cols[1]]
    )


@jit_kernel(inline="always")
def _first_line(start: float, cell: int, step: float) -> tuple[int, float, float]:
    """Side on which a ray leaves its cell along one axis (1: the far one), way to it, and from line to line."""
    if step == 0.0:
        return 0, NEVER, NEVER
    side = 1 if step > 0.0 else 0
    return side, (cell + side - start) / step, abs(1.0 / step)


@jit_kernel()
def meet(
    terrain: Terrain,
    start: tuple[float, float, float],
    cell: tuple[int, int],
    way: tuple[float, float, float],
) -> Met:
    """The first facet that a ray meets after the one on which it starts.

    A ray that would end within the facet on which it starts, which is not quite plane, is lifted over its far side.
    Missing cells let rays pass; one that comes out of them below the map meets the next cell at its border.

    Args:
        terrain: the map.
        start: (x, y, z) on the map.
        cell: (row, col) of the start.
        way: (x, y, z) unit vector in µm.

    Returns:
        Whether one is met, (x, y, z) there, and (row, col) of the cell, beyond the map too.
    """
    x, y, z = start
    row, col = cell
    dx, dy, dz = way[0] / terrain.pixel_x, way[1] / terrain.pixel_y, way[2]
    side_x, next_x, per_x = _first_line(x, col, dx)
    side_y, next_y, per_y = _first_line(y, row, dy)
    (c0, c1), (r0, r1) = _columns(terrain, col), _rows(terrain, row)
    heights = terrain.z
    behind, gap, first, leapt = 0.0, 0.0, True, False
    for _ in range(4 * (heights.shape[0] + heights.shape[1])):
        if next_x <= next_y:
            ahead = next_x
            at, part = (c1 if side_x == 1 else c0), y + ahead * dy - row
            ground = heights[r0, at] + part * (heights[r1, at] - heights[r0, at])
        else:
            ahead = next_y
            at, part = (r1 if side_y == 1 else r0), x + ahead * dx - col
            ground = heights[at, c0] + part * (heights[at, c1] - heights[at, c0])
        left = z + ahead * dz - ground
        # after a leap the way through the cell is not known, but it is above the ceiling
        bend = _bend(terrain, row, col) if terrain.facets == 0 and not leapt else (0.0, 1.0)
        if bend[0] != 0.0:
            entry, leave = x + behind * dx - col, x + ahead * dx - col
            share, lift = _meet_bent(bend, entry, leave, gap, left, first)
            z, left = z + lift, left + lift
            if share >= 0.0:
                place = behind + share * (ahead - behind)
                return True, x + place * dx, y + place * dy, z + place * dz, row, col
        elif first:
            lift = max(0.0, -left)
            z, left = z + lift, left + lift
        elif left < 0.0 and left < gap and _known(heights, (r0, r1), (c0, c1)):
            place = behind if gap <= 0.0 else behind + (ahead - behind) * gap / (gap - left)
            return True, x + place * dx, y + place * dy, z + place * dz, row, col
        first = False
        if dz > 0.0 and z + ahead * dz > terrain.top:
            break
        behind, gap = ahead, left
        if next_x <= next_y:
            next_x += per_x
            col += 2 * side_x - 1
        else:
            next_y += per_y
            row += 2 * side_y - 1
        (c0, c1), (r0, r1) = _columns(terrain, col), _rows(terrain, row)
        crossings = (next_x, per_x, dx, side_x), (next_y, per_y, dy, side_y)
        lines_x, lines_y = leap(terrain.ceiling, (r0, c0), crossings, (z + ahead * dz, z, dz))
        leapt = lines_x + lines_y > 0
        if leapt:
            next_x, next_y = next_x + lines_x * per_x, next_y + lines_y * per_y
            col, row = col + lines_x * (2 * side_x - 1), row + lines_y * (2 * side_y - 1)
            (c0, c1), (r0, r1) = _columns(terrain, col), _rows(terrain, row)
    return False, x, y, z, row, col
