"""Compiled z-buffer of triangles seen along −z in parallel rays (numba, cached on disk after the first call)."""

import math

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.light.kernel_compilation import jit_kernel, log_compilation

log_compilation()

IntArray = npt.NDArray[np.int64]


@jit_kernel(nogil=True)
def draw(
    point: FloatArray, vertex: FloatArray, triangles: IntArray, depth: FloatArray, result: FloatArray
) -> None:
    """Draw triangles; the nearest one wins, a pixel is seen at its middle.

    Args:
        point: (V, 3) column and row of the vertices in pixels, and their height toward the eye.
        vertex: (V, A) what is interpolated.
        triangles: (T, 3) numbers of vertices, counter-clockwise from outside.
        depth: (rows, cols) −inf; filled with heights.
        result: (rows, cols, A + 1) filled with what is interpolated, and 1 for an outer side or −1 for an inner one.
    """
    rows, cols = depth.shape
    wide = vertex.shape[1]
    for n in range(triangles.shape[0]):
        a, b, c = triangles[n, 0], triangles[n, 1], triangles[n, 2]
        ax, ay, bx, by, cx, cy = point[a, 0], point[a, 1], point[b, 0], point[b, 1], point[c, 0], point[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0.0:
            continue
        side = 1.0 if area < 0.0 else -1.0  # rows run downward
        left, right = (
            max(0, math.ceil(min(ax, bx, cx) - 0.5)),
            min(cols - 1, math.floor(max(ax, bx, cx) - 0.5)),
        )
        top, bottom = (
            max(0, math.ceil(min(ay, by, cy) - 0.5)),
            min(rows - 1, math.floor(max(ay, by, cy) - 0.5)),
        )
        for r in range(top, bottom + 1):
            y = r + 0.5
            for q in range(left, right + 1):
                x = q + 0.5
                u = ((bx - x) * (cy - y) - (cx - x) * (by - y)) / area
                v = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) / area
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                z = u * point[a, 2] + v * point[b, 2] + w * point[c, 2]
                if z <= depth[r, q]:
                    continue
                depth[r, q] = z
                for k in range(wide):
                    result[r, q, k] = u * vertex[a, k] + v * vertex[b, k] + w * vertex[c, k]
                result[r, q, wide] = side
