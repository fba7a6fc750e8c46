"""Compiled quadrature of light that reflects on one side of a ridge groove and then on the other.

Every side has its own frame (along the ridges, up the side away from the foot, normal). Between the sides light
travels at an angle χ to the first side, measured in the xz plane from the direction toward the foot, and at an
elevation φ out of that plane. The lobes stand at fixed sin φ, whatever χ, so panels can be laid around them.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.light.kernel_compilation import jit_kernel
from anisoscope.sim.light.kernels import _fresnel, _table, density, shadowing
from anisoscope.sim.light.relief_scatter import FAINT
from anisoscope.sim.light.shine import Plastic


class Ray(NamedTuple):
    """A direction in the frame of a side, and what a BRDF needs of it alone: transmittance and Smith's Λ."""

    along: float
    up: float
    normal: float
    through: float
    shadow: float


@jit_kernel(inline="always")
def _ray(along: float, up: float, normal: float, plastic: Plastic) -> Ray:
    """The direction (along, up, normal); below the side it passes nothing on."""
    if normal <= 0.0:
        return Ray(along, up, normal, 0.0, 0.0)
    slant = math.sqrt((plastic.alpha_u * along) ** 2 + (plastic.alpha_v * up) ** 2) / normal
    return Ray(along, up, normal, _table(plastic.table, normal), shadowing(slant, plastic.lobe))


@jit_kernel(inline="always")
def _brdf(first: Ray, second: Ray, plastic: Plastic) -> float:
    """BRDF [1/sr] of rough plastic between two directions, as `facet_brdf`."""
    if first.normal <= 0.0 or second.normal <= 0.0:
        return 0.0
    alpha_u, alpha_v = plastic.alpha_u, plastic.alpha_v
    value = plastic.diffuse * first.through * second.through
    hu, hv, hn = first.along + second.along, first.up + second.up, first.normal + second.normal
    exponent = ((hu / alpha_u) ** 2 + (hv / alpha_v) ** 2) / (hn * hn)
    if exponent < FAINT * plastic.lobe.reach:
        size = hu * hu + hv * hv + hn * hn
        cos_d = min(1.0, (first.along * hu + first.up * hv + first.normal * hn) / math.sqrt(size))
        lobe = _fresnel(cos_d, plastic.refraction) * density(exponent, plastic.lobe) * (size / (hn * hn)) ** 2
        lobe /= 4.0 * math.pi * alpha_u * alpha_v * first.normal * second.normal
        value += lobe / (1.0 + first.shadow + second.shadow)
    return value


@jit_kernel()
def _fill(first: FloatArray, second: FloatArray, rays: FloatArray, plastic: Plastic, out: FloatArray) -> None:
    """Write the BRDF between directions (N, 3) and (M, 3) to (N, M); ``rays`` (M, 2) is room to work in."""
    for m in range(len(second)):
        ray = _ray(second[m, 0], second[m, 1], second[m, 2], plastic)
        rays[m, 0], rays[m, 1] = ray.through, ray.shadow
    for n in range(len(first)):
        one = _ray(first[n, 0], first[n, 1], first[n, 2], plastic)
        for m in range(len(second)):
            other = Ray(second[m, 0], second[m, 1], second[m, 2], rays[m, 0], rays[m, 1])
            out[n, m] = _brdf(one, other, plastic)


def brdf_table(first: FloatArray, second: FloatArray, plastic: Plastic) -> FloatArray:
    """(N, M) BRDF [1/sr] between directions (N, 3) and (M, 3) in the frame of the side."""
    result = np.empty((len(first), len(second)))
    _fill(first, second, np.empty((len(second), 2)), plastic, result)
    return result


@njit(cache=True)
def _lay_panels(breaks: FloatArray, start: int, centre: float, width: float, steps: FloatArray) -> int:
    """Breakpoints at a centre and at steps of a width on both sides of it; returns the place after them."""
    breaks[start] = centre
    for n in range(steps.size):
        breaks[start + 1 + 2 * n] = centre - steps[n] * width
        breaks[start + 2 + 2 * n] = centre + steps[n] * width
    return start + 1 + 2 * int(steps.size)


@njit(cache=True)
def _ratio_angle(ratio: float, opening: float) -> float:
    """χ of a ray that leaves the first side at distance a from the foot and meets the second at ratio·a."""
    return math.atan2(ratio * math.sin(opening), 1.0 - ratio * math.cos(opening))


@njit(cache=True)
def _angle_breaks(
    light: FloatArray,
    camera: FloatArray,
    lit: FloatArray,
    seen: FloatArray,
    opening: float,
    width: float,
    steps: FloatArray,
) -> FloatArray:
    """Sorted breakpoints of χ: the mirror directions of both sides, and the kinks of the common length."""
    end = math.pi - opening
    breaks = np.empty(8 + 4 * steps.size)
    breaks[0], breaks[1] = 0.0, end
    place = _lay_panels(breaks, 2, math.atan2(light[2], light[1]), width, steps)
    place = _lay_panels(breaks, place, end - math.atan2(camera[2], camera[1]), width, steps)
    for n in range(4):
        own, other = lit[n % 2], seen[n // 2]
        breaks[place + n] = _ratio_angle(other / own, opening) if own > 0.0 else end
    return np.sort(np.minimum(np.maximum(breaks, 0.0), end))


@njit(cache=True)
def _elevation_integral(
    light: FloatArray,
    camera: FloatArray,
    angles: tuple[float, float],
    plastic: Plastic,
    steps: FloatArray,
    rule: FloatArray,
) -> float:
    """∫ f_1·f_2·cos²φ dφ for the angles (χ at the first side, at the second side) in the xz plane."""
    breaks = np.empty(4 + 4 * steps.size)
    breaks[0], breaks[1] = -0.5 * math.pi, 0.5 * math.pi
    place = 2
    for side in range(2):
        centre = math.asin(-light[0]) if side == 0 else math.asin(camera[0])
        cosine = max(0.02, math.cos(centre))
        upright = light[2] if side == 0 else camera[2]
        spread = plastic.alpha_u * (upright + cosine * math.sin(angles[side])) / cosine
        place = _lay_panels(breaks, place, centre, spread, steps)
    breaks = np.sort(np.minimum(np.maximum(breaks, breaks[0]), breaks[1]))
    from_light = _ray(light[0], light[1], light[2], plastic)
    to_camera = _ray(camera[0], camera[1], camera[2], plastic)
    up, normal = (-math.cos(angles[0]), -math.cos(angles[1])), (math.sin(angles[0]), math.sin(angles[1]))
    total = 0.0
    for panel in range(len(breaks) - 1):
        half = 0.5 * (breaks[panel + 1] - breaks[panel])
        if half < 1e-10:
            continue
        for node in range(rule.shape[1]):
            phi = breaks[panel] + half * (1.0 + rule[0, node])
            flat, rise = math.cos(phi), math.sin(phi)
            out = _ray(rise, flat * up[0], flat * normal[0], plastic)
            back = _ray(-rise, flat * up[1], flat * normal[1], plastic)
            pair = _brdf(from_light, out, plastic) * _brdf(back, to_camera, plastic)
            total += half * rule[1, node] * flat * flat * pair
    return total


@njit(cache=True, nogil=True)
def two_reflections(
    light: FloatArray,
    camera: FloatArray,
    lit: FloatArray,
    seen: FloatArray,
    opening: float,
    plastic: Plastic,
    steps: FloatArray,
    rule: FloatArray,
) -> float:
    """Light that reflects on a first side and then, once, on the second side of the groove.

    ∫∫ f_1 f_2 cos_i cos_o cos²φ sin χ M(χ) dφ dχ, where M is the length on the first side from which a ray at χ
    leaves a lit point and meets a seen point: sides are straight, so M is the overlap of two intervals.

    Args:
        light: (3,) direction to the light in the frame of the first side.
        camera: (3,) direction to the camera in the frame of the second side.
        lit: (2,) lit interval of the first side, distances from the foot.
        seen: (2,) seen interval of the second side.
        opening: angle between the sides, radians.
        plastic: the material of both sides.
        steps: ends of the panels on one side of a lobe's centre, in multiples of its width.
        rule: (2, Q) nodes and weights of a Gauss-Legendre rule, used in every panel.

    Returns:
        The integral, in the unit of length per sr; divided by pitch·ω_o,z it is a radiance.
    """
    if light[2] <= 0.0 or camera[2] <= 0.0 or lit[1] <= lit[0] or seen[1] <= seen[0]:
        return 0.0
    breaks = _angle_breaks(light, camera, lit, seen, opening, 2.0 * plastic.alpha_v, steps)
    total = 0.0
    for panel in range(len(breaks) - 1):
        half = 0.5 * (breaks[panel + 1] - breaks[panel])
        if half < 1e-10:
            continue
        for node in range(rule.shape[1]):
            chi = breaks[panel] + half * (1.0 + rule[0, node])
            other = math.pi - opening - chi
            ratio = math.sin(chi) / math.sin(other)
            common = min(lit[1], seen[1] / ratio) - max(lit[0], seen[0] / ratio)
            if common > 0.0:
                inner = _elevation_integral(light, camera, (chi, other), plastic, steps, rule)
                total += half * rule[1, node] * math.sin(chi) * common * inner
    return float(total * light[2] * camera[2])
