"""Compiled inner loops of the relief predictor (numba, cached on disk after the first call).

The rough plastic of one facet, the slopes of facets, and what each facet adds to a picture. The horizon stands in
`horizon_kernels`, the census of slopes in `census_kernels`.
"""

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from anisoscope.sim.light.compiled import announce

announce()

FloatArray = npt.NDArray[np.float64]
ShareArray = npt.NDArray[np.float32]

EDGE = 1.5
"""Difference of the neighbours' slopes from which a facet between them straddles an edge."""


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
    exponent = 1e9
    if cos_h > 1e-6:
        exponent = ((h_along / alpha_along) ** 2 + (h_across / alpha_across) ** 2) / (cos_h * cos_h)
    value = diffuse * _table(table, cos_i) * _table(table, cos_o) * cos_i * cos_o
    if exponent < 60.0:
        i_along, o_along = (light[1] + gy * light[2]) / slant, (camera[1] + gy * camera[2]) / slant
        i_across = ((1.0 + gy * gy) * light[0] - gx * gy * light[1] + gx * light[2]) / across
        o_across = ((1.0 + gy * gy) * camera[0] - gx * gy * camera[1] + gx * camera[2]) / across
        tan_i = math.sqrt((alpha_along * i_along) ** 2 + (alpha_across * i_across) ** 2) / cos_i
        tan_o = math.sqrt((alpha_along * o_along) ** 2 + (alpha_across * o_across) ** 2) / cos_o
        glossy = scale * math.exp(-exponent) / (cos_h * cos_h * cos_h * cos_h)
        value += glossy / (1.0 + _lambda(tan_i) + _lambda(tan_o))
    return float(value * size / camera[2])


@njit(cache=True, inline="always")
def cell_slopes(
    z: FloatArray, r: int, c: int, pixel_x: float, pixel_y: float, triangles: int, part: int
) -> tuple[float, float]:
    """Slopes along x and y of the cell at (r, c), or of one of its two triangles.

    ``triangles`` is 0 for symmetric gradients, 1 for a split along the diagonal from the first to the last corner,
    2 along the other.
    """
    low, high = z[r, c + 1] - z[r, c], z[r + 1, c + 1] - z[r + 1, c]
    left, right = z[r + 1, c] - z[r, c], z[r + 1, c + 1] - z[r, c + 1]
    if triangles == 0:
        return 0.5 * (low + high) / pixel_x, 0.5 * (left + right) / pixel_y
    if triangles == 1:
        return (low / pixel_x, right / pixel_y) if part == 0 else (high / pixel_x, left / pixel_y)
    return (low / pixel_x, left / pixel_y) if part == 0 else (high / pixel_x, right / pixel_y)


@njit(cache=True, inline="always")
def around_edge(z: FloatArray, r: int, c: int, slope: float, pixel_x: float) -> tuple[float, float, float]:
    """Slopes before and after the cell where it straddles a sharp edge across x, and the share of the first; else 1.

    Such a facet (at a crest, a foot) has a slope between those of its neighbours that belongs to neither side. It
    is taken as the two parts whose slopes its neighbours have, in the proportion that gives its own. Otherwise
    every edge would carry a strip of a slope that the surface does not have, which shines where it happens to
    mirror the light.
    """
    before = _slope(z, r, c - 1, pixel_x) if c > 0 else slope
    after = _slope(z, r, c + 1, pixel_x) if c < z.shape[1] - 2 else slope
    if abs(after - before) > EDGE and (slope - before) * (after - slope) > 0.0:  # false where NaN
        first = (after - slope) / (after - before)
        if 1e-6 < first < 1.0 - 1e-6:
            return before, after, first
    return slope, slope, 1.0


@njit(cache=True, inline="always")
def visible(lit: float, seen: float, same_side: bool) -> float:
    """Share of a facet that is both lit and seen: light and camera leave the same end free, or opposite ends."""
    return min(lit, seen) if same_side else max(0.0, lit + seen - 1.0)


@njit(cache=True, inline="always")
def _reached(
    share: float, before: float, after: float, first: float, gy: float, direction: FloatArray
) -> tuple[float, float]:
    """From where to where along x a split cell is reached, given the share that its own plane would have.

    A direction leaves free the end away from it. Shares count projected length, of which a part with slope g has
    1 − (ω_x·g + ω_y·g_y)/ω_z per length; negative where the part faces away, and then the other ends earlier.
    """
    tx, ty = direction[0] / direction[2], direction[1] / direction[2]
    if share >= 1.0 and abs(tx) < 1e-9:
        return 0.0, 1.0
    own, other, middle = (before, after, first) if tx >= 0.0 else (after, before, 1.0 - first)
    near = middle * (1.0 - tx * own - ty * gy)
    length = near + (1.0 - middle) * (1.0 - tx * other - ty * gy)
    free = share * length
    if free <= near:
        end = middle * free / near if near > 0.0 else 0.0
    elif length - near > 1e-12:  # where the near part faces away, what it hides is counted with the far one
        end = middle + (1.0 - middle) * min(1.0, (free - near) / (length - near))
    else:
        end = middle
    return (0.0, end) if tx >= 0.0 else (1.0 - end, 1.0)


@njit(cache=True, inline="always")
def split_shine(
    edge: tuple[float, float, float],
    gy: float,
    lit: float,
    seen: float,
    light: FloatArray,
    camera: FloatArray,
    half: FloatArray,
    lobe: FloatArray,
    table: FloatArray,
) -> float:
    """What a cell that straddles an edge adds: slopes before and after the edge, share of the first."""
    before, after, first = edge
    start, end = _reached(lit, before, after, first, gy, light)
    begin, stop = _reached(seen, before, after, first, gy, camera)
    start, end = max(start, begin), min(end, stop)
    value = max(0.0, min(end, first) - start) * _shine(before, gy, light, camera, half, lobe, table)
    value += max(0.0, end - max(start, first)) * _shine(after, gy, light, camera, half, lobe, table)
    return float(value)


@njit(cache=True, nogil=True)
def facet_radiance(
    z: FloatArray,
    pixel_x: float,
    pixel_y: float,
    triangles: int,
    light: FloatArray,
    camera: FloatArray,
    half: FloatArray,
    lit: ShareArray,
    seen: ShareArray,
    lobe: FloatArray,
    table: FloatArray,
    begin: int,
    stop: int,
    result: ShareArray,
) -> None:
    """What each cell adds to the radiance per macroscopic area: V·f·cos_i·cos_o / (n_z · ω_o·n).

    Along is the direction of +y within a facet. ``lit`` and ``seen`` are (rows − 1, cols − 1) shares. The rows
    from ``begin`` to ``stop`` of ``result`` (rows − 1, cols − 1) are filled with values in 1/sr; NaN where one of the
    four points is missing.
    """
    cols = z.shape[1]
    same_side = light[0] * camera[0] + light[1] * camera[1] >= 0.0
    for r in range(begin, stop):
        for c in range(cols - 1):
            gx, gy = cell_slopes(z, r, c, pixel_x, pixel_y, 0, 0)
            if math.isnan(gx) or math.isnan(gy):
                result[r, c] = math.nan
                continue
            share = visible(lit[r, c], seen[r, c], same_side)
            if share <= 0.0:
                result[r, c] = 0.0
                continue
            value = 0.0
            edge = around_edge(z, r, c, gx, pixel_x) if triangles == 0 else (gx, gx, 1.0)
            if triangles != 0:
                for part in range(2):
                    gx, gy = cell_slopes(z, r, c, pixel_x, pixel_y, triangles, part)
                    value += 0.5 * share * _shine(gx, gy, light, camera, half, lobe, table)
            elif edge[2] < 1.0:
                value = split_shine(edge, gy, lit[r, c], seen[r, c], light, camera, half, lobe, table)
            else:
                value = share * _shine(gx, gy, light, camera, half, lobe, table)
            result[r, c] = value
