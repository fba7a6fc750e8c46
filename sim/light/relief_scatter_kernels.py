"""Compiled scattering of light by a facet of rough plastic, in the frame of the facet.

The frame is that of `facet_brdf`: along the ridges, across, normal; slopes gx, gy make the normal (−gx, −gy, 1). Ridges
need not run along y of the map: a turn (cosine, sine) leads from the axes of the map to those of the ridges.
"""

import math

from anisoscope.base.kernel_compilation import jit_kernel
from anisoscope.sim.light.kernels import _fresnel, _table, density, shadowing
from anisoscope.sim.light.shine import Plastic

Vector = tuple[float, float, float]
Frame = tuple[float, float, float, float, float, float]

FAINT = 50.0
"""Exponent of Beckmann's lobe from which it counts as nothing: e⁻⁵⁰."""

GLOSSY = 0.7
"""Share of directions that a path draws from the lobe, the rest from the cosine."""


@jit_kernel(inline="always")
def facet_frame(gx: float, gy: float, turn: tuple[float, float]) -> Frame:
    """Slopes across and along the ridges, lengths of the normal (−gx, −gy, 1) and the tangent (0, 1, gy), the turn."""
    cos, sin = turn
    gx, gy = cos * gx + sin * gy, cos * gy - sin * gx
    return gx, gy, math.sqrt(1.0 + gx * gx + gy * gy), math.sqrt(1.0 + gy * gy), cos, sin


@jit_kernel(inline="always")
def to_facet(frame: Frame, d: Vector) -> Vector:
    """Components of a direction along, across and normal to a facet."""
    gx, gy, size, slant, cos, sin = frame
    dx, dy = cos * d[0] + sin * d[1], cos * d[1] - sin * d[0]
    across = (slant * slant * dx - gx * gy * dy + gx * d[2]) / (size * slant)
    return (dy + gy * d[2]) / slant, across, (d[2] - gx * dx - gy * dy) / size


@jit_kernel(inline="always")
def from_facet(frame: Frame, d: Vector) -> Vector:
    """Direction with components along, across and normal to a facet."""
    gx, gy, size, slant, cos, sin = frame
    across, normal = d[1] / (size * slant), d[2] / size
    x, y = slant * slant * across - gx * normal, d[0] / slant - gx * gy * across - gy * normal
    return cos * x - sin * y, sin * x + cos * y, gy * d[0] / slant + gx * across + normal


@jit_kernel()
def reflectance(a: Vector, b: Vector, plastic: Plastic) -> tuple[float, float]:
    """BRDF [1/sr] between two local directions, and the density [1/sr] of the lobe; both are reciprocal."""
    if a[2] <= 0.0 or b[2] <= 0.0:
        return 0.0, 0.0
    value = plastic.diffuse * _table(plastic.table, a[2]) * _table(plastic.table, b[2])
    alpha_u, alpha_v = plastic.alpha_u, plastic.alpha_v
    hu, hv, hn = a[0] + b[0], a[1] + b[1], a[2] + b[2]
    exponent = ((hu / alpha_u) ** 2 + (hv / alpha_v) ** 2) / (hn * hn)
    if exponent >= FAINT * plastic.lobe.reach:
        return value, 0.0
    size = hu * hu + hv * hv + hn * hn
    cos_d = min(1.0, 0.5 * math.sqrt(size))
    cos_h = hn / math.sqrt(size)
    slopes_density = density(exponent, plastic.lobe) / (math.pi * alpha_u * alpha_v * cos_h**3)
    tan_a = math.sqrt((alpha_u * a[0]) ** 2 + (alpha_v * a[1]) ** 2) / a[2]
    tan_b = math.sqrt((alpha_u * b[0]) ** 2 + (alpha_v * b[1]) ** 2) / b[2]
    lobe = _fresnel(cos_d, plastic.refraction) * slopes_density / (cos_h * 4.0 * a[2] * b[2])
    return value + lobe / (
        1.0 + shadowing(tan_a, plastic.lobe) + shadowing(tan_b, plastic.lobe)
    ), slopes_density / (4.0 * cos_d)


@jit_kernel(inline="always")
def drawn_density(lobe: float, cosine: float) -> float:
    """Density [1/sr] with which a path draws a direction."""
    return GLOSSY * lobe + (1.0 - GLOSSY) * max(cosine, 0.0) / math.pi
