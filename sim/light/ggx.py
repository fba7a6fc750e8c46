"""The relief predictor with another lobe: Trowbridge-Reitz ("GGX") facets instead of Beckmann's.

Real plastics have longer tails than Beckmann's lobe. Studies render with this lobe what is then judged with the other,
so that the predictor meets a surface that it was not made from. D and Λ after Walter et al. 2007 and Heitz 2014
(Eqs. 85 and 72); shadows, edges and the Lambertian base are those of the relief predictor.
"""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.light.horizon import Horizon
from anisoscope.sim.light.kernel_compilation import jit_kernel, log_compilation
from anisoscope.sim.light.kernels import (
    _squares,
    _table,
    around_edge,
    cell_slopes,
    facet_radiance,
    split_shares,
    visible,
)
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.shine import Shine

log_compilation()

ShareArray = npt.NDArray[np.float32]
Lobe = Literal["beckmann", "ggx"]


@jit_kernel(inline="always")
def ggx_shine_of(gx: float, gy: float, shine: Shine) -> float:
    """f·cos_i·cos_o per macroscopic area of a facet with slopes (gx, gy), as `kernels.shine_of` but for the lobe."""
    light, camera, half = shine.light, shine.camera, shine.half
    steep = 1.0 + gy * gy
    square = steep + gx * gx
    size = math.sqrt(square)
    up_i = light[2] - gx * light[0] - gy * light[1]
    up_o = camera[2] - gx * camera[0] - gy * camera[1]
    up_h = half[2] - gx * half[0] - gy * half[1]
    if up_i <= 0.0 or up_o <= 0.0:
        return 0.0
    per = 1.0 / size
    entered = _table(shine.table, up_i * per) * _table(shine.table, up_o * per)
    value = shine.diffuse * entered * up_i * up_o * per
    if up_h > 0.0:
        wide_along, wide_across = (
            shine.alpha_along * shine.alpha_along,
            shine.alpha_across * shine.alpha_across,
        )
        along, across = _squares(half, gx, gy, steep, square)
        spread = (along / wide_along + across / wide_across) / (steep * up_h * up_h)
        along, across = _squares(light, gx, gy, steep, square)
        slant_i = (wide_along * along + wide_across * across) / (steep * up_i * up_i)
        along, across = _squares(camera, gx, gy, steep, square)
        slant_o = (wide_along * along + wide_across * across) / (steep * up_o * up_o)
        shadow = 0.5 * (math.sqrt(1.0 + slant_i) + math.sqrt(1.0 + slant_o))
        tall = square / (up_h * up_h)
        value += shine.mirror * tall * tall * size / ((1.0 + spread) ** 2 * shadow)
    return float(value / camera[2])


@jit_kernel(nogil=True)
def ggx_radiance(
    z: FloatArray,
    pixel_x: float,
    pixel_y: float,
    shine: Shine,
    lit: ShareArray,
    seen: ShareArray,
    result: ShareArray,
) -> None:
    """As `kernels.facet_radiance` for facets of symmetric gradients, with the other lobe."""
    rows, cols = result.shape
    light, camera = shine.light, shine.camera
    same_side = light[0] * camera[0] + light[1] * camera[1] >= 0.0
    for r in range(rows):
        for c in range(cols):
            gx, gy = cell_slopes(z, r, c, pixel_x, pixel_y, 0, 0)
            if math.isnan(gx) or math.isnan(gy):
                result[r, c] = math.nan
                continue
            share = visible(lit[r, c], seen[r, c], same_side)
            if share <= 0.0:
                result[r, c] = 0.0
                continue
            edge = around_edge(z, r, c, gx, pixel_x)
            if edge[2] < 1.0:
                shares = split_shares(edge, gy, lit[r, c], seen[r, c], light, camera)
                value = shares[0] * ggx_shine_of(edge[0], gy, shine)
                value += shares[1] * ggx_shine_of(edge[1], gy, shine)
            else:
                value = share * ggx_shine_of(gx, gy, shine)
            result[r, c] = value


def lobe_maps(relief: Relief, shines: Sequence[Shine], lobe: Lobe) -> list[ShareArray]:
    """For each pose, what every facet adds to the radiance per macroscopic area [1/sr], direct light.

    Args:
        relief: the surface, with facets of symmetric gradients.
        shines: one a pose.
        lobe: of the facets.

    Returns:
        Maps (rows − 1, cols − 1), NaN where the height is missing.
    """
    z = np.ascontiguousarray(relief.surface.height_um, dtype=np.float64)
    horizon = Horizon(relief)
    found = []
    for shine in shines:
        lit, seen = horizon.shares(np.array(shine.light)), horizon.shares(np.array(shine.camera))
        shown = np.empty(lit.shape, dtype=np.float32)
        pixel_x, pixel_y = relief.surface.pixel_x_um, relief.surface.pixel_y_um
        if lobe == "ggx":
            ggx_radiance(z, pixel_x, pixel_y, shine, lit, seen, shown)
        else:
            facet_radiance(z, pixel_x, pixel_y, 0, shine, lit, seen, 0, len(shown), shown)
        found.append(shown)
    return found
