"""Compiled sums over the heights above the ridges: differences, noise, profiles about the walls."""

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.metrology.ridgekernels import Frame, Mask, shape_at


@njit(cache=True, nogil=True)
def structure_sums(
    above: FloatArray,
    owner: npt.NDArray[np.int16],
    lags: npt.NDArray[np.int64],
    limits: FloatArray,
    ridges: int,
    every: int,
) -> FloatArray:
    """(ridges, lags, 2) count and Σ squares of height differences between points of the same facet.

    ``lags`` (n, 2) are steps down and across the grid, rows not negative; differences beyond ``limits`` (n,) are left
    out; of the first points, ``every``-th row is taken.
    """
    count = lags.shape[0]
    sums = np.zeros((ridges, count, 2))
    rows, cols = above.shape
    for i in range(0, rows, every):
        for n in range(count):
            down, right = lags[n]
            if i + down >= rows:
                continue
            limit = limits[n]
            for j in range(max(0, -right), min(cols, cols - right)):
                k = owner[i, j]
                if k < 0 or owner[i + down, j + right] != k:
                    continue
                difference = above[i + down, j + right] - above[i, j]
                if abs(difference) <= limit:  # never of NaN
                    sums[k, n, 0] += 1.0
                    sums[k, n, 1] += difference * difference
    return sums


@njit(cache=True, nogil=True)
def noise_sums(above: FloatArray, owner: npt.NDArray[np.int16], limit: float, ridges: int) -> FloatArray:
    """(ridges, 2) count and Σ squares of the third difference along both axes, 4 × 4 points on the same facet."""
    sums = np.zeros((ridges, 2))
    rows, cols = above.shape
    for i in range(rows - 3):
        d0 = d1 = d2 = d3 = np.nan
        for j in range(cols):
            # third difference down each column, NaN where a point is missing
            d0, d1, d2 = d1, d2, d3
            d3 = above[i + 3, j] - 3.0 * above[i + 2, j] + 3.0 * above[i + 1, j] - above[i, j]
            if j < 3:
                continue
            third = d3 - 3.0 * d2 + 3.0 * d1 - d0
            k = owner[i, j]
            if math.isnan(third) or k < 0 or abs(third) > limit:
                continue
            if owner[i, j - 3] != k or owner[i + 3, j] != k or owner[i + 3, j - 3] != k:
                continue
            sums[k, 0] += 1.0
            sums[k, 1] += third * third
    return sums


@njit(cache=True, nogil=True)
def profile_sums(
    above: FloatArray,
    out: Mask,
    frame: Frame,
    facet: tuple[float, float],
    profile: FloatArray,
    mean: FloatArray,
    bins: int,
) -> FloatArray:
    """(ridges, bins, 3) count, sum of heights and sum of places, by the ridge a wall leads to.

    Heights are those of the mean ridge: what a ridge is higher or steeper than that is taken off.

    Bins run from half a pitch before the wall to half a pitch after it; places are in pitches from the wall.
    """
    sums = np.zeros((frame.ridges, bins, 3))
    rows, cols = above.shape
    for i in range(rows):
        for j in range(cols):
            e = above[i, j]
            if math.isnan(e) or out[i, j]:
                continue
            q = i * frame.qi + j * frame.qj - frame.q0 + 0.5
            whole = math.floor(q)
            k = int(whole) - frame.first
            if k < 0 or k >= frame.ridges:
                continue
            b = min(int((q - whole) * bins), bins - 1)
            t = q - 0.5 - math.floor(q - 0.5)
            if facet[0] <= t <= facet[1]:
                e += mean[0] + mean[1] * (t - 0.5 * (facet[0] + facet[1])) * frame.pitch
            else:
                e += shape_at(profile, t, frame.shift)[0]
            sums[k, b, 0] += 1.0
            sums[k, b, 1] += e
            sums[k, b, 2] += q - whole - 0.5
    return sums


@njit(cache=True, nogil=True)
def wall_sums(
    above: FloatArray, frame: Frame, profile: FloatArray, zone: tuple[float, float], limit: float
) -> FloatArray:
    """(ridges, 5) sums n, t, t², z, t·z of the points within the ``zone`` of every wall, t in µm from its middle.

    Points further than ``limit`` from the profile are left out.
    """
    sums = np.zeros((frame.ridges, 5))
    rows, cols = above.shape
    for i in range(rows):
        for j in range(cols):
            e = above[i, j]
            if not abs(e) <= limit:  # missing too
                continue
            q = i * frame.qi + j * frame.qj - frame.q0
            whole = math.floor(q + 0.5)
            t = (q - whole) * frame.pitch
            k = int(whole) - frame.first
            if t < zone[0] or t > zone[1] or k < 0 or k >= frame.ridges:
                continue
            height = e + shape_at(profile, q - math.floor(q), frame.shift)[0]
            row = sums[k]
            row[0] += 1.0
            row[1] += t
            row[2] += t * t
            row[3] += height
            row[4] += height * t
    return sums
