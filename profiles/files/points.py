"""Lists of points x y z that lie on a regular grid."""

from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.files.checks import AXIS_TOLERANCE, check_claim, checked_map, refuse
from anisoscope.profiles.heightmap import HeightMap

MIN_FILLED = 0.05


def _grid_axis(name: str, axis: str, values_um: FloatArray) -> tuple[float, float, int]:
    """(first position, step, count) of the regular grid on which the values lie.

    Lines of the grid without any point are allowed: the step is the smallest gap between positions.
    """
    ordered = np.unique(values_um)
    gaps = np.diff(ordered)
    extent = float(ordered[-1] - ordered[0])
    if extent <= 0:
        refuse(name, f"{axis} axis", "a single position", "a height map needs at least two along each axis")
    resolution = max(1e-6 * extent, 1e-3 * float(np.median(gaps)))
    real = gaps[gaps > resolution]
    smallest = float(np.median(real[real <= 1.5 * real.min()]))
    count = round(extent / smallest) + 1
    check_claim(name, 2, count, 0, 0)
    return float(ordered[0]), extent / (count - 1), count


def points_to_map(name: str, points_um: FloatArray, origin: dict[str, Any]) -> HeightMap:
    """Sort points into a grid; grid points without a point are missing.

    Args:
        name: name of the file, for messages.
        points_um: (n, 3) x, y, z in µm; a NaN height is a missing point.
        origin: provenance of the map.

    Raises:
        HeightMapError: positions are missing, irregular, or doubled; the grid is nearly empty.
    """
    x, y, z = points_um.T
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        refuse(name, "points", "x or y of a point is missing", "every point needs x and y")
    if len(points_um) < 4:
        refuse(name, "points", f"only {len(points_um)}", "a height map needs at least 2 × 2 points")
    x0, step_x, cols = _grid_axis(name, "x", x)
    y0, step_y, rows = _grid_axis(name, "y", y)
    column, row = (x - x0) / step_x, (y - y0) / step_y
    off = max(float(np.abs(column - np.rint(column)).max()), float(np.abs(row - np.rint(row)).max()))
    if off > AXIS_TOLERANCE:
        refuse(name, "grid", f"a point is {off:.2f} steps off", "resample the points to a regular grid")
    check_claim(name, rows, cols, MIN_FILLED, len(points_um))
    flat = np.rint(row).astype(np.int64) * cols + np.rint(column).astype(np.int64)
    if np.unique(flat).size != flat.size:
        refuse(
            name, "grid", f"{flat.size - np.unique(flat).size} points share a place", "remove doubled points"
        )
    height = np.full(rows * cols, np.nan)
    height[flat] = z
    return checked_map(name, height.reshape(rows, cols), (step_y, step_x), origin)
