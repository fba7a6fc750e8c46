"""Compiled scattering of light by a facet of rough plastic, in the frame of the facet.

The frame is that of `facet_brdf`: along the ridges, across, normal; slopes gx, gy make the normal (−gx, −gy, 1).
"""

import math
from typing import NamedTuple

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.light.kernel_compilation import jit_kernel
from anisoscope.sim.light.kernels import _fresnel, _lambda, _table

Vector = tuple[float, float, float]
Frame = tuple[float, float, float, float]

GLOSSY = 0.7
"""Share of directions that a path draws from the lobe, the rest from the cosine."""


class Plastic(NamedTuple):
    """Rough plastic: roughness along and across, index, scale of the base [1/sr], transmittance table."""

    alpha_u: float
    alpha_v: float
    refraction: float
    diffuse: float
    table: FloatArray


@jit_kernel(inline="always")
def facet_frame(gx: float, gy: float) -> Frame:
    """Slopes of a facet, the length of its normal (−gx, −gy, 1), and of its tangent (0, 1, gy)."""
    return gx, gy, math.sqrt(1.0 + gx * gx + gy * gy), math.sqrt(1.0 + gy * gy)


@jit_kernel(inline="always")
def to_facet(frame: Frame, d: Vector) -> Vector:
    """Components of a direction along, across and normal to a facet."""
    gx, gy, size, slant = frame
    across = (slant * slant * d[0] - gx * gy * d[1] + gx * d[2]) / (size * slant)
    return (d[1] + gy * d[2]) / slant, across, (d[2] - gx * d[0] - gy * d[1]) / size


@jit_kernel(inline="always")
def from_facet(frame: Frame, d: Vector) -> Vector:
    """Direction with components along, across and normal to a facet."""
    gx, gy, size, slant = frame
    across, normal = d[1] / (size * slant), d[2] / size
    return (
        slant * slant * across - gx * normal,
        d[0] / slant - gx * gy * across - gy * normal,
        gy * d[0] / slant + gx * across + normal,
    )


@jit_kernel()
def reflectance(a: Vector, b: Vector, plastic: Plastic) -> tuple[float, float]:
    """BRDF [1/sr] between two local directions, and the density [1/sr] of the lobe; both are reciprocal."""
    if a[2] <= 0.0 or b[2] <= 0.0:
        return 0.0, 0.0
    value = plastic.diffuse * _table(plastic.table, a[2]) * _table(plastic.table, b[2])
    alpha_u, alpha_v = plastic.alpha_u, plastic.alpha_v
    hu, hv, hn = a[0] + b[0], a[1] + b[1], a[2] + b[2]
    exponent = ((hu / alpha_u) ** 2 + (hv / alpha_v) ** 2) / (hn * hn)
    if exponent >= 50.0:
        return value, 0.0
    size = hu * hu + hv * hv + hn * hn
    cos_d = min(1.0, 0.5 * math.sqrt(size))
    cos_h = hn / math.sqrt(size)
    slopes_density = math.exp(-exponent) / (math.pi * alpha_u * alpha_v * cos_h**3)
    tan_a = math.sqrt((alpha_u * a[0]) ** 2 + (alpha_v * a[1]) ** 2) / a[2]
    tan_b = math.sqrt((alpha_u * b[0]) ** 2 + (alpha_v * b[1]) ** 2) / b[2]
    lobe = _fresnel(cos_d, plastic.refraction) * slopes_density / (cos_h * 4.0 * a[2] * b[2])
    return value + lobe / (1.0 + _lambda(tan_a) + _lambda(tan_b)), slopes_density / (4.0 * cos_d)


@jit_kernel(inline="always")
def drawn_density(lobe: float, cosine: float) -> float:
    """Density [1/sr] with which a path draws a direction."""
    return GLOSSY * lobe + (1.0 - GLOSSY) * max(cosine, 0.0) / math.pi
