"""Compiled quadrature of the lobe of a rough interface (numba, cached on disk after the first call).

The points of a column of slopes across the plane of incidence are worked on one after the other in arrays of that
length, which the compiler turns into vector instructions; the shadowing of steep directions follows from tables.
"""

import math

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.kernel_compilation import jit_kernel
from anisoscope.sim.light.shadowing import (
    LAMBDA_BELLS,
    LAMBDA_NODES,
    LAMBDA_TAILS,
    PER_UNIT,
    UNSHADOWED,
)


@jit_kernel(inline="always")
def _beckmann_lambda(a: float) -> float:
    """Smith's Λ from a = 1/(α·tan θ), as `shadowing.beckmann_lambda`."""
    if a >= UNSHADOWED:
        return 0.0
    place = int(a * PER_UNIT + 0.5)
    node, bell, tail = float(LAMBDA_NODES[place]), float(LAMBDA_BELLS[place]), float(LAMBDA_TAILS[place])
    d = a - node
    bent = 0.5 - d * (node / 3.0 - d * (4.0 * node * node - 2.0) / 24.0)
    return max(0.5 * bell - node * tail + d * (d * bell * bent - tail), 0.0) / a


@jit_kernel(inline="always")
def _fresnel(cosine: float, index: float) -> float:
    """Unpolarised Fresnel reflectance, as `material.fresnel`."""
    sin2_inside = (1.0 - cosine * cosine) / (index * index)
    cos_inside = math.sqrt(max(1.0 - sin2_inside, 0.0))
    parallel = (index * cosine - cos_inside) / (index * cosine + cos_inside)
    perpendicular = (cosine - index * cos_inside) / (cosine + index * cos_inside)
    reflectance = 0.5 * (parallel * parallel + perpendicular * perpendicular)
    return 1.0 if sin2_inside >= 1.0 else reflectance


@jit_kernel(nogil=True, error_model="numpy", fastmath={"nnan", "ninf", "nsz"})
def lobe_albedos(
    cosines: FloatArray,
    alpha: float,
    index: float,
    steepest: float,
    across: tuple[FloatArray, FloatArray],
    along: tuple[FloatArray, FloatArray],
    scratch: FloatArray,
    albedos: FloatArray,
) -> None:
    """Directional albedos of the single-scattering Beckmann lobe, as `material.lobe_albedo` describes them.

    Args:
        cosines: (N,) of incidence.
        alpha: roughness.
        index: of refraction.
        steepest: slope in units of alpha up to which facets count.
        across: (A,) nodes and weights on −1…1 for slopes x in the plane of incidence.
        along: (B,) the same for slopes y across it, of which half is needed.
        scratch: (4, A) working memory.
        albedos: (N,) is written.
    """
    node, node_weight = across
    other, other_weight = along
    reach = steepest * alpha
    whole, slope, mirrored, shadow = scratch[0], scratch[1], scratch[2], scratch[3]
    for i in range(node.size):  # the slopes x where the horizon cuts none of them off
        x = reach * (node[i] + 1.0) - reach
        whole[i] = math.exp(-(x * x) / (alpha * alpha))
    for n in range(cosines.size):
        mu = min(max(cosines[n], 1e-4), 1.0)
        sine = math.sqrt(1.0 - mu * mu)
        entering = 1.0 + _beckmann_lambda(mu / max(alpha * sine, 1e-9 * mu))
        total = 0.0
        for j in range(other.size):
            y = 0.5 * reach * (other[j] + 1.0)
            grazing = (math.sqrt(max(sine * sine + mu * mu * (1.0 - y * y), 0.0)) - sine) / mu
            half = 0.5 * max(min(grazing, reach) + reach, 0.0)
            for i in range(node.size):
                x = half * (node[i] + 1.0) - reach
                spread = x * x + y * y
                cos_half = 1.0 / math.sqrt(1.0 + spread)
                dot = cos_half * (mu - x * sine)
                out = min(max(2.0 * dot * cos_half - mu, 1e-9), 1.0)
                slope[i] = x
                mirrored[i] = _fresnel(min(abs(dot), 1.0), index) * max(dot, 0.0) / (cos_half * mu)
                shadow[i] = out / max(alpha * math.sqrt(1.0 - out * out), 1e-9 * out)
            part = 0.0
            for i in range(node.size):
                x = slope[i]
                density = whole[i] if grazing >= reach else math.exp(-(x * x) / (alpha * alpha))
                part += node_weight[i] * density * mirrored[i] / (entering + _beckmann_lambda(shadow[i]))
            total += 2.0 * half * 0.5 * reach * other_weight[j] * math.exp(-(y * y) / (alpha * alpha)) * part
        albedos[n] = total / (np.pi * alpha * alpha)
