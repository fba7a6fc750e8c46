"""Compiled loops of halftoning, separation and the z-buffer (numba, cached on disk after the first call)."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.kernel_compilation import jit_kernel, log_compilation

log_compilation(__file__)

Ranks = npt.NDArray[np.int64]
Pattern = npt.NDArray[np.bool_]


@jit_kernel()
def _change(energy: FloatArray, kernel: FloatArray, size: int, at: int, sign: float) -> None:
    """Add a point's Gaussian to the energies, or take it away, on the torus."""
    width = kernel.shape[0]
    reach = width // 2
    row, col = at // size, at % size
    for i in range(width):
        r = (row + i - reach) % size
        for j in range(width):
            energy[r * size + (col + j - reach) % size] += sign * kernel[i, j]


@jit_kernel()
def _extreme(energy: FloatArray, pattern: Pattern, tightest: bool) -> int:
    """The point with the most energy (tightest cluster), or the gap with the least (largest void)."""
    found, best = -1, -np.inf
    for n in range(energy.size):
        if pattern[n] == tightest:
            value = energy[n] if tightest else -energy[n]
            if value > best:
                found, best = n, value
    return found


@jit_kernel()
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


log_compilation(__file__)

Float32 = npt.NDArray[np.float32]
Int64 = npt.NDArray[np.int64]
Dots = npt.NDArray[np.uint8]
Scalar = float | np.floating[Any]

ZERO, HALF, ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
SLIGHT = np.float32(1e-6)
FAR = np.float32(1e30)
OUTSIDE, TOO_BRIGHT = 0, 1
CHANNELS = 3


@jit_kernel(inline="always", fastmath=True)
def _residual(colours: Float32, weights: Float32, aim: Float32) -> Scalar:
    """Squared distance between a mixture of inks and the colour aimed at."""
    total: Scalar = ZERO
    for row in range(CHANNELS):
        off: Scalar = -aim[row]
        for k in range(weights.size):
            off += colours[row, k] * weights[k]
        total += off * off
    return total


@jit_kernel(inline="always", fastmath=True)
def _solved(solver: Float32, aim: Float32, weights: Float32) -> Scalar:
    """Fill the weights of one set of inks; their sum, or −1 where one is negative."""
    total: Scalar = ZERO
    for k in range(weights.size):
        one = solver[k, 0] * aim[0] + solver[k, 1] * aim[1] + solver[k, 2] * aim[2]
        if one < -SLIGHT:
            return -ONE
        weights[k] = max(one, ZERO)
        total += weights[k]
    return total


@jit_kernel(fastmath=True)
def _mixture(
    aim: Float32, colours: Float32, solvers: Float32, exact: int, trial: Float32, found: Float32
) -> Scalar:
    """Non-negative least squares, with the least ink where several mixtures meet a colour; the squared distance left.

    The first ``exact`` sets of inks, of three each, meet any colour; of the others the best one counts.
    """
    least: Scalar = FAR
    for n in range(exact):
        total = _solved(solvers[n], aim, trial)
        if ZERO <= total < least:
            least = total
            for k in range(found.size):
                found[k] = trial[k]
    if least < FAR:
        return ZERO
    best: Scalar = aim[0] * aim[0] + aim[1] * aim[1] + aim[2] * aim[2]
    for k in range(found.size):
        found[k] = ZERO
    for n in range(exact, solvers.shape[0]):
        if _solved(solvers[n], aim, trial) < ZERO:
            continue
        off = _residual(colours, trial, aim)
        if off < best:
            best = off
            for k in range(found.size):
                found[k] = trial[k]
    return best


@jit_kernel(nogil=True)
def separate(
    linear: Float32,
    colours: Float32,
    solvers: Float32,
    exact: int,
    tolerance: float,
    cover: Float32,
    counts: Int64,
    scratch: Float32,
) -> None:
    """Coverages of K inks that come closest to colours; sums above 1 are scaled down to 1.

    Args:
        linear: (rows, cols, 3) linear sRGB to aim at.
        colours: (3, K) linear sRGB of the inks, a column each.
        solvers: (S, K, 3) least-squares solutions on sets of inks; rows of inks left out are zero.
        exact: how many of them, the first, are of three inks and meet any colour.
        tolerance: distance in linear sRGB from which a colour counts as out of gamut.
        cover: (rows, cols, K), filled.
        counts: (2,) pixels out of gamut, pixels whose sum was above 1; added to.
        scratch: (2, K).
    """
    limit = np.float32(tolerance * tolerance)
    inks = cover.shape[2]
    trial, weights = scratch[0], scratch[1]
    for r in range(linear.shape[0]):
        for c in range(linear.shape[1]):
            off = _mixture(linear[r, c], colours, solvers, exact, trial, weights)
            total = ZERO
            for k in range(inks):
                total += weights[k]
            if off > limit:
                counts[OUTSIDE] += 1
            scale = ONE
            if total > ONE + SLIGHT:
                counts[TOO_BRIGHT] += 1
            if total > ONE:
                scale = ONE / total
            for k in range(inks):
                cover[r, c, k] = weights[k] * scale


@jit_kernel(nogil=True)
def limit_sum(cover: Float32, counts: Int64) -> None:
    """Scale sums of coverages above 1 down to 1, in place; ``counts`` as for :func:`separate`."""
    for r in range(cover.shape[0]):
        for c in range(cover.shape[1]):
            total = ZERO
            for k in range(cover.shape[2]):
                total += cover[r, c, k]
            if total > ONE + SLIGHT:
                counts[TOO_BRIGHT] += 1
            if total > ONE:
                for k in range(cover.shape[2]):
                    cover[r, c, k] /= total


@jit_kernel(nogil=True)
def screen(cover: Float32, thresholds: Float32, first_row: int, dots: Dots) -> None:
    """Dot off dot: the k-th ink where the threshold is between the sums of coverages before and after it.

    Args:
        cover: (rows, cols, K), sums at most 1.
        thresholds: (N, N), tiled.
        first_row: of the whole print, to which the first row here belongs.
        dots: (rows, cols), filled with 0 for no ink or 1 to K.
    """
    size, inks = thresholds.shape[0], cover.shape[2]
    for r in range(cover.shape[0]):
        line = (first_row + r) % size
        for c in range(cover.shape[1]):
            threshold = thresholds[line, c % size]
            total, passed = ZERO, 0
            for k in range(inks):
                total += cover[r, c, k]
                passed += threshold >= total
            dots[r, c] = 0 if passed == inks else 1 + passed


@jit_kernel(nogil=True)
def diffuse(cover: Float32, first_row: int, error: Float32, dots: Dots) -> None:
    """Vector error diffusion: the nearest of no ink and the K inks; Floyd and Steinberg's weights, serpentine.

    Args:
        cover: (rows, cols, K), sums at most 1.
        first_row: of the whole print, to which the first row here belongs.
        error: (2, cols + 2, K) errors carried into this row and the next, kept between calls; zeros at the top.
        dots: (rows, cols), filled with 0 for no ink or 1 to K.
    """
    cols, inks = cover.shape[1:]
    ahead_w, back_w, below_w, over_w = (
        np.float32(7 / 16),
        np.float32(3 / 16),
        np.float32(5 / 16),
        np.float32(1 / 16),
    )
    for r in range(cover.shape[0]):
        now, after = (first_row + r) % 2, (first_row + r + 1) % 2
        step = 1 if now == 0 else -1
        c = 0 if step == 1 else cols - 1
        for j in range(cols + 2):
            for k in range(inks):
                error[after, j, k] = ZERO
        for _ in range(cols):
            chosen = 0
            largest = HALF
            for k in range(inks):
                one = cover[r, c, k] + error[now, c + 1, k]
                if one > largest:
                    chosen, largest = k + 1, one
            dots[r, c] = chosen
            for k in range(inks):
                left = np.float32(cover[r, c, k] + error[now, c + 1, k] - (chosen == k + 1))
                error[now, c + 1 + step, k] += ahead_w * left
                error[after, c + 1 - step, k] += back_w * left
                error[after, c + 1, k] += below_w * left
                error[after, c + 1 + step, k] += over_w * left
            c += step


@jit_kernel(nogil=True)
def count_blocks(
    cover: Float32, dots: Dots, block: int, aimed: npt.NDArray[np.float64], printed: Int64
) -> None:
    """Add coverages and dots of a band up by blocks.

    Args:
        cover: (rows, cols, K).
        dots: (rows, cols).
        block: side of a block.
        aimed: (block rows, block columns, K) of the band; added to.
        printed: (block rows, block columns, K + 1) dots without ink and of each ink; added to.
    """
    for r in range(dots.shape[0]):
        for c in range(dots.shape[1]):
            i, j = r // block, c // block
            printed[i, j, dots[r, c]] += 1
            for k in range(cover.shape[2]):
                aimed[i, j, k] += cover[r, c, k]


log_compilation(__file__)

IntArray = npt.NDArray[np.int64]


@jit_kernel(nogil=True)
def draw(
    point: FloatArray, vertex: FloatArray, triangles: IntArray, depth: FloatArray, result: FloatArray
) -> None:
    """Draw triangles; the nearest one wins, a pixel is sampled at its middle.

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
