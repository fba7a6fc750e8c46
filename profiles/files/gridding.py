"""Scattered points interpolated onto a regular grid."""

from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.files.checks import MAX_POINTS, check_claim, checked_map, refuse
from anisoscope.profiles.heightmap import INTERPOLATED, HeightMap

LONGEST = 4.0
"""Longest side of a triangle of neighbours over their usual distance: a longer one spans a gap."""
_CHUNK = 1_000_000


def gridded(name: str, points_um: FloatArray, step_um: float, origin: dict[str, Any]) -> HeightMap:
    """Interpolate points linearly on their Delaunay triangles (Qhull) onto a grid; gaps and surroundings are missing.

    Args:
        name: name of the file, for messages.
        points_um: (n, 3) x, y, z in µm; points without a height are left out.
        step_um: step of the grid.
        origin: provenance of the map; ``gridded`` is added: step, share of the grid points that are further than half
            a step from any measured point, and the usual distance of the points. The layer ``interpolated`` marks them.

    Raises:
        HeightMapError: a step that is not positive, or that makes too many or too few points; points on a line, or two
            heights at one place.
    """
    from scipy.interpolate import LinearNDInterpolator  # noqa: PLC0415 - heavy
    from scipy.spatial import Delaunay, QhullError, cKDTree  # noqa: PLC0415 - heavy

    if not (np.isfinite(step_um) and step_um > 0.0):
        refuse(name, "grid", f"{step_um:g} µm", "give a positive step in µm")
    points = points_um[np.isfinite(points_um).all(axis=1)]
    places, where = np.unique(points[:, :2], axis=0, return_index=True)
    if len(places) < len(points):
        refuse(name, "points", f"{len(points) - len(places)} share a place", "remove doubled points")
    if len(places) < 4:
        refuse(name, "points", f"only {len(places)}", "a height map needs at least 2 × 2 points")
    low, high = places.min(axis=0), places.max(axis=0)
    cols, rows = (int(count) for count in np.floor((high - low) / step_um * (1.0 + 1e-12)) + 1)
    if rows * cols > MAX_POINTS:
        refuse(
            name,
            "grid",
            f"{rows} × {cols} points",
            f"at most {MAX_POINTS // 10**6} million are made; take a larger step",
        )
    check_claim(name, rows, cols, 0, 0)
    try:
        triangles = Delaunay(places - low)
    except QhullError:
        refuse(name, "points", "on one line", "a height map needs points along x and y")
    corners = triangles.points[triangles.simplices]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    usual = float(np.median(sides.min(axis=1)))
    wide = sides.max(axis=1) > LONGEST * max(usual, float(np.median(sides)))
    linear, tree = LinearNDInterpolator(triangles, points[where, 2]), cKDTree(triangles.points)
    height, far = np.empty(rows * cols), np.zeros(rows * cols, dtype=np.float32)
    for start in range(0, rows * cols, _CHUNK):
        k = np.arange(start, min(start + _CHUNK, rows * cols))
        nodes = np.stack([k % cols, k // cols], axis=1) * step_um
        found = linear(nodes)
        found[wide[triangles.find_simplex(nodes)]] = np.nan
        distance, _ = tree.query(nodes, distance_upper_bound=step_um)
        far[k] = (distance > 0.5 * step_um) & np.isfinite(found)
        height[k] = found
    measured = max(int(np.count_nonzero(np.isfinite(height))), 1)
    said = {
        "step_um": step_um,
        "interpolated_share": float(far.sum(dtype=np.float64)) / measured,
        "usual_distance_um": usual,
    }
    layers = {INTERPOLATED: far.reshape(rows, cols)} if far.any() else {}
    return checked_map(
        name, height.reshape(rows, cols), (step_um, step_um), {**origin, "gridded": said}, layers=layers
    )
