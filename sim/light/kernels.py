"""Compiled inner loops of the relief predictor (numba, cached on disk after the first call).

The rough plastic of one facet, the slopes of facets, and what each facet adds to a picture. The horizon stands in
`horizon_kernels`, the census of slopes in `census_kernels`.
"""

import math

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.kernel_compilation import jit_kernel, log_compilation
from anisoscope.sim.light.material import SHADOWING_ENDS, SLANTS_PER_E_FOLD
from anisoscope.sim.light.shine import LobeShape, Shine, Vector

log_compilation(__file__)

ShareArray = npt.NDArray[np.float32]

FAINT = 45.0
"""Exponent of the lobe from which it counts as nothing: e⁻⁴⁵."""

FIRST_SLANT = math.log(SHADOWING_ENDS[0])

EDGE = 1.5
"""Difference of the neighbours' slopes from which a facet between them straddles an edge."""


@jit_kernel(inline="always")
def _lambda(alpha_tan: float) -> float:
    """Smith's Λ of the Beckmann distribution."""
    if alpha_tan < 0.25:
        return 0.0
    a = 1.0 / alpha_tan
    return max(0.0, 0.5 * (math.exp(-a * a) / (a * math.sqrt(math.pi)) - math.erfc(a)))


@jit_kernel(inline="always")
def shadowing(alpha_tan: float, lobe: LobeShape) -> float:
    """Smith's Λ of a lobe: for any but Beckmann's from its table, where ln Λ is nearly straight over ln(α·tan θ)."""
    if lobe.tail == 0.0 and lobe.weight == 0.0:
        return _lambda(alpha_tan)
    if alpha_tan < 1e-9:
        return 0.0
    table = lobe.shadowing
    place = (math.log(alpha_tan) - FIRST_SLANT) * SLANTS_PER_E_FOLD
    index = min(max(int(place), 0), table.size - 2)
    return math.exp(table[index] + (place - index) * (table[index + 1] - table[index]))


@jit_kernel(inline="always")
def density(square: float, lobe: LobeShape) -> float:
    """π·P(r²), as `material.slope_density`."""
    if lobe.tail == 0.0:
        value = math.exp(-square)
    else:
        value = math.exp(-(1.0 + 1.0 / lobe.tail) * math.log1p(lobe.tail * square))
    if lobe.weight > 0.0:
        wide = lobe.width * lobe.width
        value = (1.0 - lobe.weight) * value + lobe.weight / wide * math.exp(-square / wide)
    return value


@jit_kernel(inline="always")
def _table(table: FloatArray, cosine: float) -> float:
    position = cosine * (table.size - 1)
    index = min(int(position), table.size - 2)
    return float(table[index] + (position - index) * (table[index + 1] - table[index]))


@jit_kernel(inline="always")
def _fresnel(cosine: float, index: float) -> float:
    inside = math.sqrt(1.0 - (1.0 - cosine * cosine) / (index * index))
    parallel = (index * cosine - inside) / (index * cosine + inside)
    perpendicular = (cosine - index * inside) / (cosine + index * inside)
    return 0.5 * (parallel * parallel + perpendicular * perpendicular)


@jit_kernel(inline="always")
def _slope(z: FloatArray, r: int, c: int, pixel_x: float) -> float:
    """Symmetric gradient along x of the facet at (r, c)."""
    return float(0.5 * (z[r, c + 1] - z[r, c] + z[r + 1, c + 1] - z[r + 1, c]) / pixel_x)


@jit_kernel(inline="always")
def _squares(d: Vector, gx: float, gy: float, steep: float, square: float) -> tuple[float, float]:
    """Squared components of a direction along and across a facet, both times ``square`` and ``steep``."""
    along, across = d[1] + gy * d[2], steep * d[0] - gx * gy * d[1] + gx * d[2]
    return along * along * square, across * across


@jit_kernel(inline="always")
def shine_of(gx: float, gy: float, shine: Shine) -> float:
    """f·cosθ_i·cosθ_o per macroscopic area of a fully visible facet with slopes (gx, gy).

    f = F·D/(4·cosθ_i·cosθ_o·(1 + Λ_i + Λ_o)) + Lambertian base, with D and Smith's Λ of the lobe's shape.

    Components of directions are taken in multiples of the lengths of normal (−gx, −gy, 1) and tangent (0, 1, gy),
    which spares roots and divisions.
    """
    light, camera, half = shine.from_light, shine.from_camera, shine.half
    gx, gy = shine.turn[0] * gx + shine.turn[1] * gy, shine.turn[0] * gy - shine.turn[1] * gx
    steep = 1.0 + gy * gy
    square = steep + gx * gx
    size = math.sqrt(square)
    up_i = light[2] - gx * light[0] - gy * light[1]
    up_o = camera[2] - gx * camera[0] - gy * camera[1]
    if up_i <= 0.0 or up_o <= 0.0:
        return 0.0
    per = 1.0 / size
    entered = _table(shine.table, up_i * per) * _table(shine.table, up_o * per)
    value = shine.diffuse * entered * up_i * up_o * per
    up_h = half[2] - gx * half[0] - gy * half[1]
    along, across = _squares(half, gx, gy, steep, square)
    wide_along, wide_across = shine.alpha_along * shine.alpha_along, shine.alpha_across * shine.alpha_across
    spread = along / wide_along + across / wide_across
    reach = steep * up_h * up_h
    if up_h > 0.0 and spread < FAINT * shine.lobe.reach * reach:
        along, across = _squares(light, gx, gy, steep, square)
        slant_i = (wide_along * along + wide_across * across) / (steep * up_i * up_i)
        along, across = _squares(camera, gx, gy, steep, square)
        slant_o = (wide_along * along + wide_across * across) / (steep * up_o * up_o)
        shadow = 1.0 + shadowing(math.sqrt(slant_i), shine.lobe) + shadowing(math.sqrt(slant_o), shine.lobe)
        tall = square / (up_h * up_h)
        value += shine.mirror * density(spread / reach, shine.lobe) * tall * tall * size / shadow
    return float(value / camera[2])


@jit_kernel(inline="always")
def blend(triangles: int, part: int) -> tuple[float, float]:
    """Shares of the first row in the slope along x, and of the first column in the slope along y, of a facet.

    ``triangles`` is 0 for symmetric gradients, 1 for triangles split along the diagonal from the first to the last
    corner, 2 along the other; ``part`` counts triangles.
    """
    if triangles == 0:
        return 0.5, 0.5
    return 1.0 - part, (1.0 * part if triangles == 1 else 1.0 - part)


@jit_kernel(inline="always")
def cell_slopes(
    z: FloatArray, r: int, c: int, pixel_x: float, pixel_y: float, triangles: int, part: int
) -> tuple[float, float]:
    """Slopes along x and y of the cell at (r, c), or of one of its two triangles; NaN where a corner is missing."""
    low, high = z[r, c + 1] - z[r, c], z[r + 1, c + 1] - z[r + 1, c]
    left, right = z[r + 1, c] - z[r, c], z[r + 1, c + 1] - z[r, c + 1]
    south, west = blend(triangles, part)
    return (south * low + (1.0 - south) * high) / pixel_x, (west * left + (1.0 - west) * right) / pixel_y


@jit_kernel(inline="always")
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


@jit_kernel(inline="always")
def visible(lit: float, seen: float, same_side: bool) -> float:
    """Share of a facet that is both lit and seen: light and camera leave the same end free, or opposite ends."""
    return min(lit, seen) if same_side else max(0.0, lit + seen - 1.0)


@jit_kernel(inline="always")
def _reached(
    share: float, before: float, after: float, first: float, gy: float, direction: Vector
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


@jit_kernel(inline="always")
def split_shares(
    edge: tuple[float, float, float],
    gy: float,
    lit: float,
    seen: float,
    light: Vector,
    camera: Vector,
) -> tuple[float, float]:
    """Shares of a cell across an edge that are both lit and seen, before and after the edge.

    ``edge``: slopes before and after, share of the first.
    """
    before, after, first = edge
    start, end = _reached(lit, before, after, first, gy, light)
    begin, stop = _reached(seen, before, after, first, gy, camera)
    start, end = max(start, begin), min(end, stop)
    return max(0.0, min(end, first) - start), max(0.0, end - max(start, first))


@jit_kernel(nogil=True)
def facet_radiance(
    z: FloatArray,
    pixel_x: float,
    pixel_y: float,
    triangles: int,
    shine: Shine,
    lit: ShareArray,
    seen: ShareArray,
    begin: int,
    stop: int,
    result: ShareArray,
) -> None:
    """Contribution of each cell to the radiance per macroscopic area: V·f·cos_i·cos_o / (n_z · ω_o·n).

    Along is the direction of +y within a facet. ``lit`` and ``seen`` are (rows − 1, cols − 1) shares. The rows
    from ``begin`` to ``stop`` of ``result`` (rows − 1, cols − 1) are filled with values in 1/sr; NaN where one of the
    four points is missing.
    """
    cols = z.shape[1]
    light, camera = shine.light, shine.camera
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
                    value += 0.5 * share * shine_of(gx, gy, shine)
            elif edge[2] < 1.0:
                shares = split_shares(edge, gy, lit[r, c], seen[r, c], light, camera)
                value = shares[0] * shine_of(edge[0], gy, shine)
                value += shares[1] * shine_of(edge[1], gy, shine)
            else:
                value = share * shine_of(gx, gy, shine)
            result[r, c] = value
