"""Compiled horizon march: which part of every facet is reached from one direction (numba, cached on disk).

Along one azimuth the surface is cut into parallel slices. In the sheared coordinate s = distance − t·z along a
slice, a point is reached from the direction exactly if no point further toward the source has a smaller s, so one
running minimum per slice, the horizon, settles everything in O(N). A slice takes the height wherever it crosses a row
or a column of the map, so that no crest is missed. All slices march together, one step of the map's major axis at a
time, so that the inner loops run over neighbouring numbers. A shadow is no longer than the relief is high times the
tangent, so blocks of the major axis start `reach` steps ahead and need nothing from each other;
short blocks keep the slices that slant few. Facets of a large map are filled a band at a time, in the same blocks.
"""

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from anisoscope.base.kernel_compilation import log_compilation

log_compilation(__file__)

Floats = npt.NDArray[np.float32]

BLOCK = 250  # steps of the major axis


@njit(cache=True, inline="always")
def _fold(index: int, count: int, period: int) -> int:
    """Index outside the map → inside: by whole periods where the surface repeats, else the nearest edge."""
    if 0 <= index < count:
        return index
    if period > 0:
        while index >= count:
            index -= period
        while index < 0:
            index += period
        return index
    return 0 if index < 0 else count - 1


@njit(cache=True, error_model="numpy")
def _between(first: Floats, second: Floats, part: np.float32, height: Floats) -> None:
    """Heights interpolated between two neighbours; next to a gap, the neighbour that is known."""
    for k in range(height.size):
        z = first[k] + part * (second[k] - first[k])
        known = first[k] if first[k] == first[k] else second[k]
        height[k] = z if z == z else known  # noqa: PLR0124


@njit(cache=True, error_model="numpy")
def _heights(row: Floats, start: int, part: np.float32, period: int, height: Floats) -> None:
    """Heights at start + part, start + part + 1, … of one row of the map, folded back beyond its ends."""
    count = row.size
    low = min(max(0, -start), height.size)
    high = min(max(count - 1 - start, low), height.size)
    if high > low:
        i = start + low
        _between(row[i : i + high - low], row[i + 1 : i + 1 + high - low], part, height[low:high])
    for edge in range(2):
        for k in range(0 if edge == 0 else high, low if edge == 0 else height.size):
            z0, z1 = row[_fold(start + k, count, period)], row[_fold(start + k + 1, count, period)]
            z = z0 + part * (z1 - z0)
            if part == 0.0 or math.isnan(z):
                z = z1 if math.isnan(z0) else z0
            height[k] = z


@njit(cache=True, error_model="numpy")
def _crossings(near: Floats, far: Floats, start: int, part: np.float32, period: int, height: Floats) -> None:
    """Heights where the slices cross the columns start, start + 1, … between two rows of the map."""
    count = near.size
    low = min(max(0, -start), height.size)
    high = min(max(count - start, low), height.size)
    if high > low:
        _between(near[start + low : start + high], far[start + low : start + high], part, height[low:high])
    for edge in range(2):
        for k in range(0 if edge == 0 else high, low if edge == 0 else height.size):
            j = _fold(start + k, count, period)
            z = near[j] + part * (far[j] - near[j])
            height[k] = (far[j] if math.isnan(near[j]) else near[j]) if math.isnan(z) else z


@njit(cache=True)
def _lower(horizon: Floats, height: Floats, at: np.float32, tangent: np.float32, gap: Floats) -> None:
    """The horizon after one more point of every slice, and how far the points lie beyond it; NaN changes nothing."""
    for k in range(height.size):
        here = at - tangent * height[k]
        horizon[k] = min(horizon[k], here)
        gap[k] = here - horizon[k] if here > horizon[k] else np.float32(0.0)


@njit(cache=True, error_model="numpy")
def _shares(
    near: Floats,
    far: Floats,
    gap: Floats,
    part: np.float32,
    step: np.float32,
    tangent: np.float32,
    shift: np.float32,
    out: Floats,
) -> None:
    """Visible share of one row of facets: the part of each plane, along the azimuth, that the horizon leaves.

    Args:
        near: (n + 1,) heights at the end of the facets away from the source.
        far: (n + 1,) heights at the end toward the source.
        gap: (n + 1,) how far the slices on both sides of the facets' middles are in shadow at the far end.
        part: place of the middles between these slices.
        step: length of a facet along the azimuth.
        tangent: of the direction.
        shift: columns by which a slice moves per step.
        out: (n,) shares.
    """
    zero, one, half = np.float32(0.0), np.float32(1.0), np.float32(0.5)
    for r in range(out.size):
        low, high = near[r] + near[r + 1], far[r] + far[r + 1]
        across = near[r + 1] - near[r] + far[r + 1] - far[r]
        rise = half * (high - low + shift * across)  # along one step
        length = step - tangent * rise
        shadow = gap[r] + part * (gap[r + 1] - gap[r])
        value = (length - shadow) / length
        value = min(one, value)
        value = max(zero, value)
        out[r] = value if length > zero else zero


@njit(cache=True, nogil=True)
def march(
    z: Floats,
    step: float,
    tangent: float,
    shift: float,
    reverse: bool,
    reach: int,
    period_major: int,
    period_minor: int,
    lead: int,
    shares: Floats,
) -> None:
    """Visible share of every facet from a source beyond the high end of axis 0 (the low end if ``reverse``).

    Args:
        z: (major, minor) heights, NaN = missing; those beyond the facets, toward the source, cast shadows only.
        step: length of one step along a slice, in the unit of z.
        tangent: horizontal over vertical component of the direction, ≥ 0.
        shift: columns by which a slice moves toward the source per step, −1 to 1.
        reverse: the source is beyond index 0.
        reach: steps over which the relief can cast a shadow.
        period_major: steps after which the surface repeats, 0 if it does not.
        period_minor: columns after which the surface repeats, 0 if it does not.
        lead: steps of the first block before the first facet: bands of a map have the blocks of the whole.
        shares: (at most major − 1, minor − 1), filled with shares 0 to 1; between slices they are interpolated.
    """
    major, minor = z.shape
    facets_along = shares.shape[0]
    for origin in range(-lead, facets_along, BLOCK):
        low, high = max(0, origin), min(origin + BLOCK, facets_along)
        # slice k stands at column first + ½ + k + shift·(c − origin) at point c; all facets must lie between slices
        first = math.floor(min(0.0, -shift * (high - origin))) - 1
        count = minor + 2 + math.ceil(abs(shift) * (high - origin)) + 1
        horizon = np.full(count, np.float32(3e38), dtype=np.float32)
        height, gap = np.empty(count, dtype=np.float32), np.zeros(count, dtype=np.float32)
        far = z[0]
        for c in range(high + reach, low - 1, -1):
            folded = _fold(c, major, period_major)
            near = z[major - 1 - folded] if reverse else z[folded]
            position = first + 0.5 + shift * (c - origin)
            if c < high:
                # middle of facet r at the far end: r + ½ + ½·shift; slice k: first + ½ + k + shift·(c + 1 − origin)
                begin = -first - shift * (c + 0.5 - origin)
                k = math.floor(begin)
                facets = shares[facets_along - 1 - c] if reverse else shares[c]
                _shares(
                    near,
                    far,
                    gap[k : k + minor],
                    np.float32(begin - k),
                    np.float32(step),
                    np.float32(tangent),
                    np.float32(shift),
                    facets,
                )
            if c < high + reach and math.floor(position) != math.floor(position + shift):
                line = math.floor(max(position, position + shift))
                part = (line - position) / shift
                _crossings(near, far, line, np.float32(part), period_minor, height)
                _lower(horizon, height, np.float32((c + part - origin) * step), np.float32(tangent), gap)
            start = math.floor(position)
            _heights(near, start, np.float32(position - start), period_minor, height)
            _lower(horizon, height, np.float32((c - origin) * step), np.float32(tangent), gap)
            far = near
