"""Compiled inner loops of the relief predictor (numba, cached on disk after the first call).

Visibility: along one azimuth the surface is cut into parallel slices. In the sheared coordinate
s = distance − t·z along a slice, a point is reached from the direction exactly if no point further toward
the source has a smaller s, so one running minimum per slice settles every segment in O(N), exactly.
"""

import math

import numpy as np
import numpy.typing as npt
from numba import njit, prange

FloatArray = npt.NDArray[np.float64]
ShareArray = npt.NDArray[np.float32]

EDGE = 1.5
"""Difference of the neighbours' slopes from which a facet between them straddles an edge."""


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


@njit(cache=True, parallel=True)
def slice_shares(
    z: FloatArray,
    step: float,
    tangent: float,
    shift: float,
    reach: int,
    period_major: int,
    period_minor: int,
    first: int,
    count: int,
) -> ShareArray:
    """Visible share of every segment on slices that march along axis 1, seen from its high end.

    Args:
        z: (minor, major) heights, NaN = missing.
        step: length of one step along a slice, in the unit of z.
        tangent: horizontal over vertical component of the direction, ≥ 0.
        shift: rows by which a slice moves per column.
        reach: columns beyond the map that may still cast a shadow on it.
        period_major: columns after which the surface repeats, 0 if it does not.
        period_minor: rows after which the surface repeats, 0 if it does not.
        first: index of the first slice; slice k passes row k + ½ + shift·(c − major/2 + ½) at column c.
        count: number of slices.

    Returns:
        (count, major − 1) shares 0 to 1; the visible part of a segment is its low end.
    """
    minor, major = z.shape
    shares = np.zeros((count, major - 1), dtype=np.float32)
    middle = 0.5 * major - 0.5
    for k in prange(count):
        limit = np.inf
        previous = math.nan
        for column in range(major + reach - 1, -1, -1):
            row = k + first + 0.5 + shift * (column - middle)
            low = math.floor(row)
            part = row - low
            c = _fold(column, major, period_major)
            z0 = z[_fold(int(low), minor, period_minor), c]
            z1 = z[_fold(int(low) + 1, minor, period_minor), c]
            height = z0
            if part > 0.0:
                height = z0 + part * (z1 - z0)
                if math.isnan(height):  # beside a gap: the neighbour that is known
                    height = z1 if math.isnan(z0) else z0
            here = column * step - tangent * height
            if column < major - 1 and not math.isnan(here) and not math.isnan(previous) and previous > here:
                share = (limit - here) / (previous - here)
                shares[k, column] = min(1.0, max(0.0, share))
            limit = min(limit, here)
            previous = here
    return shares


@njit(cache=True, inline="always")
def _lambda(alpha_tan: float) -> float:
    """Smith's Λ of the Beckmann distribution."""
    if alpha_tan < 0.25:
        return 0.0
    a = 1.0 / alpha_tan
    return max(0.0, 0.5 * (math.exp(-a * a) / (a * math.sqrt(math.pi)) - math.erfc(a)))


@njit(cache=True, inline="always")
def _table(table: FloatArray, cosine: float) -> float:
    position = cosine * (table.size - 1)
    index = min(int(position), table.size - 2)
    return float(table[index] + (position - index) * (table[index + 1] - table[index]))


@njit(cache=True, inline="always")
def _fresnel(cosine: float, index: float) -> float:
    inside = math.sqrt(1.0 - (1.0 - cosine * cosine) / (index * index))
    parallel = (index * cosine - inside) / (index * cosine + inside)
    perpendicular = (cosine - index * inside) / (cosine + index * inside)
    return 0.5 * (parallel * parallel + perpendicular * perpendicular)


@njit(cache=True, inline="always")
def _slope(z: FloatArray, r: int, c: int, pixel_x: float) -> float:
    """Symmetric gradient along x of the facet at (r, c)."""
    return float(0.5 * (z[r, c + 1] - z[r, c] + z[r + 1, c + 1] - z[r + 1, c]) / pixel_x)


@njit(cache=True, inline="always")
def _shine(
    gx: float,
    gy: float,
    light: FloatArray,
    camera: FloatArray,
    half: FloatArray,
    lobe: FloatArray,
    table: FloatArray,
) -> float:
    """f·cos_i·cos_o per macroscopic area of a facet with slopes (gx, gy), all of it lit and seen.

    ``lobe`` holds F/(4π α_u α_v), α_u, α_v and the factor of the Lambertian base.
    """
    size = math.sqrt(1.0 + gx * gx + gy * gy)
    cos_i = (light[2] - gx * light[0] - gy * light[1]) / size
    cos_o = (camera[2] - gx * camera[0] - gy * camera[1]) / size
    if cos_i <= 0.0 or cos_o <= 0.0:
        return 0.0
    scale, alpha_along, alpha_across, diffuse = lobe[0], lobe[1], lobe[2], lobe[3]
    slant = math.sqrt(1.0 + gy * gy)  # length of the tangent (0, 1, gy) along the ridges
    across = size * slant
    cos_h = (half[2] - gx * half[0] - gy * half[1]) / size
    h_along = (half[1] + gy * half[2]) / slant
    h_across = ((1.0 + gy * gy) * half[0] - gx * gy * half[1] + gx * half[2]) / across
    exponent = ((h_along / alpha_along) ** 2 + (h_across / alpha_across) ** 2) / (cos_h * cos_h)
    value = diffuse * _table(table, cos_i) * _table(table, cos_o) * cos_i * cos_o
    if cos_h > 1e-6 and exponent < 60.0:
        i_along, o_along = (light[1] + gy * light[2]) / slant, (camera[1] + gy * camera[2]) / slant
        i_across = ((1.0 + gy * gy) * light[0] - gx * gy * light[1] + gx * light[2]) / across
        o_across = ((1.0 + gy * gy) * camera[0] - gx * gy * camera[1] + gx * camera[2]) / across
        tan_i = math.sqrt((alpha_along * i_along) ** 2 + (alpha_across * i_across) ** 2) / cos_i
        tan_o = math.sqrt((alpha_along * o_along) ** 2 + (alpha_across * o_across) ** 2) / cos_o
        glossy = scale * math.exp(-exponent) / (cos_h * cos_h * cos_h * cos_h)
        value += glossy / (1.0 + _lambda(tan_i) + _lambda(tan_o))
    return float(value * size / camera[2])


@njit(cache=True, parallel=True)
def facet_radiance(
    z: FloatArray,
    pixel_x: float,
    pixel_y: float,
    to_light: FloatArray,
    to_camera: FloatArray,
    lit: ShareArray,
    seen: ShareArray,
    alpha_along: float,
    alpha_across: float,
    index: float,
    diffuse: float,
    transmittance: FloatArray,
) -> ShareArray:
    """What each facet adds to the radiance per macroscopic area: V·f·cos_i·cos_o / (n_z · ω_o·n).

    A facet spans four neighbouring points and takes its normal from the symmetric gradients. Along is the
    direction of +y within the facet. Where a facet straddles a sharp edge across x (a crest, a foot), its slope
    lies between those of its neighbours and belongs to neither side: it is then taken as the two parts whose
    slopes its neighbours have, in the proportion that gives its own. Otherwise every edge would carry a strip of
    a slope that the surface does not have, which shines where it happens to mirror the light.
    ``lit`` and ``seen`` are (rows − 1, cols − 1) shares.

    Returns:
        (rows − 1, cols − 1) values in 1/sr; NaN where one of the four points is missing.
    """
    rows, cols = z.shape
    result = np.empty((rows - 1, cols - 1), dtype=np.float32)
    half = to_light + to_camera
    half = half / math.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
    cos_d = to_light[0] * half[0] + to_light[1] * half[1] + to_light[2] * half[2]
    scale = _fresnel(cos_d, index) / (4.0 * math.pi * alpha_along * alpha_across)
    lobe = np.array([scale, alpha_along, alpha_across, diffuse])
    same_side = to_light[0] * to_camera[0] + to_light[1] * to_camera[1] >= 0.0
    for r in prange(rows - 1):
        for c in range(cols - 1):
            gx = _slope(z, r, c, pixel_x)
            gy = 0.5 * (z[r + 1, c] - z[r, c] + z[r + 1, c + 1] - z[r, c + 1]) / pixel_y
            if math.isnan(gx) or math.isnan(gy):
                result[r, c] = math.nan
                continue
            share = min(lit[r, c], seen[r, c]) if same_side else max(0.0, lit[r, c] + seen[r, c] - 1.0)
            if share <= 0.0:
                result[r, c] = 0.0
                continue
            before = _slope(z, r, c - 1, pixel_x) if c > 0 else gx
            after = _slope(z, r, c + 1, pixel_x) if c < cols - 2 else gx
            if abs(after - before) > EDGE and (gx - before) * (after - gx) > 0.0:  # false where NaN
                part = (after - gx) / (after - before)
                first = _shine(before, gy, to_light, to_camera, half, lobe, transmittance)
                second = _shine(after, gy, to_light, to_camera, half, lobe, transmittance)
                result[r, c] = share * (part * first + (1.0 - part) * second)
            else:
                result[r, c] = share * _shine(gx, gy, to_light, to_camera, half, lobe, transmittance)
    return result
