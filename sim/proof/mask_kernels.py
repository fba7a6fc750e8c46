"""Compiled loop of the void-and-cluster method (numba, cached on disk after the first call)."""

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.light.compiled import announce, borrowing

announce()

Ranks = npt.NDArray[np.int64]
Pattern = npt.NDArray[np.bool_]


@borrowing()
def _change(energy: FloatArray, kernel: FloatArray, size: int, at: int, sign: float) -> None:
    """Add a point's Gaussian to the energies, or take it away, on the torus."""
    width = kernel.shape[0]
    reach = width // 2
    row, col = at // size, at % size
    for i in range(width):
        r = (row + i - reach) % size
        for j in range(width):
            energy[r * size + (col + j - reach) % size] += sign * kernel[i, j]


@borrowing()
def _extreme(energy: FloatArray, pattern: Pattern, tightest: bool) -> int:
    """The point with the most energy (tightest cluster), or the gap with the least (largest void)."""
    found, best = -1, -np.inf
    for n in range(energy.size):
        if pattern[n] == tightest:
            value = energy[n] if tightest else -energy[n]
            if value > best:
                found, best = n, value
    return found


@borrowing()
def rank(points: Pattern, kernel: FloatArray, size: int, energy: FloatArray, order: Ranks) -> None:
    """Ulichney's method: even out the points, number them backwards, then number the gaps forwards.

    Args:
        points: (N²,) points to begin with; worked on.
        kernel: (M, M) Gaussian about its middle, M odd and at most N.
        size: N, side of the square that the rows of the flat arrays make.
        energy: (N²,) zeros; scratch.
        order: (N²,) of −1, filled with 0 to N² − 1.
    """
    count = 0
    for n in range(points.size):
        if points[n]:
            _change(energy, kernel, size, n, 1.0)
            count += 1
    for _ in range(4 * size * size):
        cluster = _extreme(energy, points, True)
        points[cluster] = False
        _change(energy, kernel, size, cluster, -1.0)
        void = _extreme(energy, points, False)
        points[void] = True
        _change(energy, kernel, size, void, 1.0)
        if void == cluster:
            break
    for number in range(count - 1, -1, -1):
        cluster = _extreme(energy, points, True)
        points[cluster] = False
        order[cluster] = number
        _change(energy, kernel, size, cluster, -1.0)
    for n in range(points.size):
        energy[n] = 0.0
    for n in range(points.size):
        points[n] = order[n] >= 0
        if points[n]:
            _change(energy, kernel, size, n, 1.0)
    for number in range(count, points.size):
        void = _extreme(energy, points, False)
        points[void] = True
        order[void] = number
        _change(energy, kernel, size, void, 1.0)
