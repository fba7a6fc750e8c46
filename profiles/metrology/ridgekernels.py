"""Compiled passes over a ridged map: every point is folded to a ridge, a place on it, and a tile along it."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from anisoscope.base.arrays import FloatArray
from anisoscope.base.kernel_compilation import log_compilation

log_compilation(__file__)

Mask = npt.NDArray[np.bool_]


class Frame(NamedTuple):
    """Coordinates of a point of the grid: q = i·qi + j·qj − q0 pitches across, v = i·vi + j·vj − v0 µm along.

    Ridge k holds the points with ⌊q⌋ = k + first; t = q − ⌊q⌋ is their place on it, 0 to 1, from the middle of the wall
    down the large facet to the next wall. Tiles cut the ridges into lengths of ``tile`` µm. Bin b of a folded profile
    holds the height at t = (b + shift)/bins: where all rows sample the same places, these need not be the centres.
    """

    qi: float
    qj: float
    q0: float
    vi: float
    vj: float
    v0: float
    pitch: float
    first: int
    ridges: int
    tile: float
    tiles: int
    shift: float


@njit(cache=True, nogil=True)
def histogram(
    z: FloatArray,
    out: Mask,
    frame: Frame,
    bins: int,
    low: float,
    step: float,
    levels: int,
) -> tuple[npt.NDArray[np.int32], FloatArray]:
    """(bins, levels) count of levelled heights at every place on the ridge, and (bins,) sums of the places."""
    counts = np.zeros((bins, levels), dtype=np.int32)
    places = np.zeros(bins)
    rows, cols = z.shape
    for i in range(rows):
        for j in range(cols):
            height = z[i, j]
            if math.isnan(height) or out[i, j]:
                continue
            q = i * frame.qi + j * frame.qj - frame.q0
            t = q - math.floor(q)
            b = min(int(t * bins), bins - 1)
            level = int((height - low) / step)
            counts[b, min(max(level, 0), levels - 1)] += 1
            places[b] += t
    return counts, places


@njit(cache=True, inline="always")
def shape_at(profile: FloatArray, t: float, shift: float) -> tuple[float, float]:
    """Height of a periodic profile sampled at t = (b + shift)/bins, and the slope per pitch."""
    bins = profile.size
    at = t * bins - shift
    b = math.floor(at)
    part = at - b
    left = profile[b % bins]
    right = profile[(b + 1) % bins]
    return left + part * (right - left), (right - left) * bins


@njit(cache=True, nogil=True)
def above_profile(z: FloatArray, frame: Frame, profile: FloatArray) -> FloatArray:
    """(rows, cols) heights over the folded profile."""
    rows, cols = z.shape
    above = np.empty((rows, cols))
    for i in range(rows):
        for j in range(cols):
            q = i * frame.qi + j * frame.qj - frame.q0
            above[i, j] = z[i, j] - shape_at(profile, q - math.floor(q), frame.shift)[0]
    return above


@njit(cache=True, nogil=True)
def phase_sums(z: FloatArray, out: Mask, frame: Frame, profile: FloatArray, spread: FloatArray) -> FloatArray:
    """(ridges, tiles, 7) sums for the shift of each tile against the profile, tiles half a pitch about the walls.

    The seven: Σ 1/w, Σ s/w, Σ s²/w, Σ e/w, Σ e·s/w, Σ q·s²/w and Σ v·s²/w, with e the height above the profile,
    s its slope and w = ``spread``² the variance expected there.
    """
    sums = np.zeros((frame.ridges, frame.tiles, 7))
    rows, cols = z.shape
    bins = profile.size
    for i in range(rows):
        for j in range(cols):
            height = z[i, j]
            if math.isnan(height) or out[i, j]:
                continue
            q = i * frame.qi + j * frame.qj - frame.q0
            k = math.floor(q + 0.5) - frame.first  # a wall belongs to the ridge it leads to
            t = q - math.floor(q)
            v = i * frame.vi + j * frame.vj - frame.v0
            m = int(v / frame.tile)
            if k < 0 or k >= frame.ridges or m < 0 or m >= frame.tiles:
                continue
            expected, slope = shape_at(profile, t, frame.shift)
            e = height - expected
            allowed = spread[min(int(t * bins), bins - 1)]
            if abs(e) > 4.0 * allowed:
                continue
            s = slope / frame.pitch
            weight = 1.0 / (allowed * allowed)
            row = sums[k, m]
            row[0] += weight
            row[1] += s * weight
            row[2] += s * s * weight
            row[3] += e * weight
            row[4] += e * s * weight
            row[5] += q * s * s * weight
            row[6] += v * s * s * weight
    return sums


@njit(cache=True, nogil=True)
def facet_sums(
    z: FloatArray, out: Mask, frame: Frame, facet: tuple[float, float], planes: FloatArray, clip: FloatArray
) -> FloatArray:
    """(ridges, tiles, 10) sums of the points of every facet that lie near its plane.

    The ten: n, s, v, s², s·v, v², z, z·s, z·v and z², with s and v in µm from the middle of the facet and of the map.
    ``planes`` is (ridges, 3): height, slope across and along; ``clip`` (ridges,) the largest distance kept.
    """
    sums = np.zeros((frame.ridges, frame.tiles, 10))
    rows, cols = z.shape
    middle = 0.5 * (facet[0] + facet[1])
    half_length = 0.5 * frame.tile * frame.tiles
    for i in range(rows):
        for j in range(cols):
            height = z[i, j]
            if math.isnan(height) or out[i, j]:
                continue
            q = i * frame.qi + j * frame.qj - frame.q0
            whole = math.floor(q)
            t = q - whole
            k = int(whole) - frame.first
            if t < facet[0] or t > facet[1] or k < 0 or k >= frame.ridges:
                continue
            along = i * frame.vi + j * frame.vj - frame.v0
            m = min(max(int(along / frame.tile), 0), frame.tiles - 1)
            s = (t - middle) * frame.pitch
            v = along - half_length
            if abs(height - planes[k, 0] - planes[k, 1] * s - planes[k, 2] * v) > clip[k]:
                continue
            row = sums[k, m]
            row[0] += 1.0
            row[1] += s
            row[2] += v
            row[3] += s * s
            row[4] += s * v
            row[5] += v * v
            row[6] += height
            row[7] += height * s
            row[8] += height * v
            row[9] += height * height
    return sums


@njit(cache=True, nogil=True)
def residuals(
    z: FloatArray,
    frame: Frame,
    facet: tuple[float, float],
    planes: FloatArray,
    profile: FloatArray,
    mean: FloatArray,
) -> tuple[FloatArray, npt.NDArray[np.int16], npt.NDArray[np.int16]]:
    """Height above what the ridge should have there, the ridge of every point of a facet (else −1), and the bin.

    On a facet that is its plane; elsewhere the folded profile, moved and turned as the ridge's plane is against the
    ``mean`` plane (3,), and toward the wall more and more as the planes of both neighbours are. ``planes`` is
    (ridges, 3), NaN where there is no ridge to speak of.
    """
    rows, cols = z.shape
    above = np.full((rows, cols), np.nan)
    owner = np.full((rows, cols), -1, dtype=np.int16)
    place = np.zeros((rows, cols), dtype=np.int16)
    middle = 0.5 * (facet[0] + facet[1])
    half_length = 0.5 * frame.tile * frame.tiles
    bins = profile.size
    for i in range(rows):
        for j in range(cols):
            q = i * frame.qi + j * frame.qj - frame.q0
            whole = math.floor(q)
            t = q - whole
            k = int(whole) - frame.first
            place[i, j] = min(int(t * bins), bins - 1)
            if k < 0 or k >= frame.ridges or math.isnan(planes[k, 0]):
                continue
            v = i * frame.vi + j * frame.vj - frame.v0 - half_length
            s = (t - middle) * frame.pitch
            moved = planes[k, 0] - mean[0] + (planes[k, 1] - mean[1]) * s + (planes[k, 2] - mean[2]) * v
            if facet[0] <= t <= facet[1]:
                owner[i, j] = k
                above[i, j] = z[i, j] - (moved + mean[0] + mean[1] * s + mean[2] * v)
                continue
            other = k - 1 if t < facet[0] else k + 1
            if 0 <= other < frame.ridges and not math.isnan(planes[other, 0]):
                away = t if t < facet[0] else 1.0 - t
                room = facet[0] if t < facet[0] else 1.0 - facet[1]
                share = 0.5 * (1.0 - away / max(room, 1e-9))
                s += frame.pitch if other < k else -frame.pitch
                theirs = planes[other, 0] - mean[0] + (planes[other, 1] - mean[1]) * s
                moved += share * (theirs + (planes[other, 2] - mean[2]) * v - moved)
            above[i, j] = z[i, j] - (shape_at(profile, t, frame.shift)[0] + moved)
    return above, owner, place
