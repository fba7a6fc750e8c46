"""Blocks of cells that rays leap over: where one stays above the ceiling of a block, it meets nothing there."""

import numpy as np
import numpy.typing as npt

from anisoscope.base.kernel_compilation import jit_kernel

HeightArray = npt.NDArray[np.float32]
Axis = tuple[float, float, float, int]

BITS = 3
SIDE = 1 << BITS  # cells along a side of a block


def ceilings(z: HeightArray, bulge: HeightArray, period: int) -> HeightArray:
    """Greatest height in every block of SIDE × SIDE cells; cells past the end are those with which the map goes on.

    Args:
        z: (rows, cols) heights, NaN where missing.
        bulge: (rows − 1, cells) height of the edge over the chord in facets that straddle one, or empty.
        period: columns after which the map repeats, 0 if the nearest point goes on.

    Returns:
        (blocks along y, blocks along x); NaN where all is missing.
    """
    rows, cols = z.shape
    first, columns = np.arange(0, rows, SIDE), np.arange((cols + SIDE - 1) // SIDE * SIDE)
    columns = columns % period if period > 0 else np.minimum(columns, cols - 2)
    points = np.fmax.reduceat(z, first, axis=0)
    points = np.fmax(points, z[np.minimum(first + SIDE, rows - 1)])  # cells reach to the next point
    cells = np.fmax(points[:, :-1], points[:, 1:])[:, columns]
    if bulge.size:
        over = np.maximum.reduceat(bulge, first[first < rows - 1], axis=0)
        cells[: len(over)] += np.maximum(over, 0.0)[:, np.minimum(columns, bulge.shape[1] - 1)]
    return np.asarray(np.fmax.reduceat(cells, np.arange(0, columns.size, SIDE), axis=1))


@jit_kernel(inline="always")
def _to_border(cell: int, side: int) -> int:
    """Grid lines that a ray crosses along one axis before it leaves its block; ``side`` 1: toward larger cells."""
    return SIDE - 1 - (cell & (SIDE - 1)) if side == 1 else cell & (SIDE - 1)


@jit_kernel(inline="always")
def _crossed(line: float, border: float, step: float, most: int) -> int:
    """Grid lines along one axis up to the way ``border``, of which the next is at the way ``line``."""
    return min(most, int((border - line) * abs(step)) + 1) if line < border else 0


@jit_kernel(inline="always")
def leap(
    ceiling: HeightArray,
    cell: tuple[int, int],
    crossings: tuple[Axis, Axis],
    heights: tuple[float, float, float],
) -> tuple[int, int]:
    """Grid lines across x and across y that a ray may skip, so that the next it crosses is the border of its block.

    Args:
        ceiling: as above.
        cell: (row, col) of the cell that the ray enters, folded onto the map.
        crossings: along x and y: way to the next grid line, way from line to line, lines per way, and the side.
        heights: of the ray where it enters the cell, at its start, and by which it rises per way.
    """
    (next_x, per_x, dx, side_x), (next_y, per_y, dy, side_y) = crossings
    lines_x, lines_y = _to_border(cell[1], side_x), _to_border(cell[0], side_y)
    border = min(next_x + lines_x * per_x, next_y + lines_y * per_y)
    here, start, rise = heights
    low = here if rise > 0.0 else start + border * rise
    if low > ceiling[cell[0] >> BITS, cell[1] >> BITS]:  # false where all is missing
        return _crossed(next_x, border, dx, lines_x), _crossed(next_y, border, dy, lines_y)
    return 0, 0
