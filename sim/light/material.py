"""Rough plastic: a microfacet lobe over a Lambertian base, for one facet.

The lobe is F·D·G / (4 cos_i cos_o) with an anisotropic distribution of slopes about the facet's own normal and the
height-correlated Smith shadowing (Heitz 2014, Eq. 99). The base is
ρ/(1 − x) · T(cos_i) · T(cos_o) / (π η²): light enters through the rough interface (T), is scattered by the
plastic, and leaves through it; x counts what the interface sends back inside.

The distribution has a *tail* τ. With r² = (s_u/α_u)² + (s_v/α_v)² of the slopes s of the microfacets, their density is
P/(α_u α_v), P(r²) = (1 + τ r²)^−(1 + 1/τ)/π, and D = P/(α_u α_v cos⁴θ_h): Student's t distribution in two dimensions
with 2/τ degrees of freedom (Ribardière et al. 2017, STD, with γ = 1 + 1/τ). τ → 0 is Beckmann's (Luongo et al. 2017,
Eq. 3), τ = 1 is that of Trowbridge and Reitz ("GGX"). A *second lobe* of Beckmann's shape may be mixed in. Shadowing is
linear in P: Λ of a mixture is the mixture of Λ.

T and x remain those of Beckmann's lobe at √(α_u α_v), whatever the tail: they count what the interface reflects once,
and a lobe with a tail loses more of it at once than multiple scattering gives back later. Walks on Smith's surface that
follow every reflection and refraction, so that nothing is lost (Heitz et al. 2016), give the base that energy balance
asks for; with α = .15, a tail of 1 and an albedo of .6 the base here is 1 % below it, one with T and x of the tail
itself 5 %. `interface_bound` is the most by which the base is too dark.
"""

import sys
from dataclasses import dataclass
from functools import cache, lru_cache
from math import log, pi
from typing import Any, NamedTuple

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.material import SHORTEST_TAIL, Material
from anisoscope.sim.light.shadowing import UNSHADOWED, beckmann_lambda

TABLE_SIZE = 513
_ACROSS, _ALONG = 32, 16  # Gauss-Legendre nodes for facet slopes in and across the plane of incidence
SHADOWING_ENDS = 0.005, 1000.0  # α·tan θ between which shadowing is tabulated
SHADOWING_SIZE = 513
SLANTS_PER_E_FOLD = (SHADOWING_SIZE - 1) / log(SHADOWING_ENDS[1] / SHADOWING_ENDS[0])
_COSINES = 24  # of a table at a time: arrays of them stay in the cache
_ROWS = 16  # of a table of BRDFs at a time
TABLES_BY_ARRAYS = 60  # of the interface; more are worth the import of numba
_STEEPEST = 4.6  # slopes in units of alpha beyond which less than 1e-9 of the facets lie


@cache
def _gauss_legendre(nodes: int) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights on −1…1 of an even rule, by Newton's method on the recurrence of Legendre's polynomials.

    numpy's rule of 256 nodes solves a full matrix in 0.25 s, scipy's costs the import of scipy.special.
    """
    x = np.cos(np.pi * (np.arange(1, nodes // 2 + 1) - 0.25) / (nodes + 0.5))
    slope = np.ones_like(x)
    for _ in range(6):
        before, value = np.ones_like(x), x
        for order in range(2, nodes + 1):
            before, value = value, ((2 * order - 1) * x * value - (order - 1) * before) / order
        slope = nodes * (x * value - before) / (x * x - 1.0)
        x = x - value / slope
    weight = 2.0 / ((1.0 - x * x) * slope * slope)
    return np.concatenate([-x, x[::-1]]), np.concatenate([weight, weight[::-1]])


def fresnel(cosine: FloatArray, index: float) -> FloatArray:
    """Unpolarised Fresnel reflectance of a dielectric; ``index`` < 1 means from inside, 1 beyond total reflection."""
    cosine = np.clip(np.abs(cosine), 0.0, 1.0)
    sin2_inside = (1.0 - cosine**2) / index**2
    cos_inside = np.sqrt(np.maximum(0.0, 1.0 - sin2_inside))
    with np.errstate(divide="ignore", invalid="ignore"):
        parallel = (index * cosine - cos_inside) / (index * cosine + cos_inside)
        perpendicular = (cosine - index * cos_inside) / (cosine + index * cos_inside)
        reflectance = 0.5 * (parallel**2 + perpendicular**2)
    return np.where(sin2_inside >= 1.0, 1.0, reflectance)


def slope_density(square: FloatArray, material: Material) -> FloatArray:
    """π·P(r²): density of the slopes of microfacets over that of Beckmann's lobe at its centre, for r² ≥ 0."""
    if material.tail < SHORTEST_TAIL:
        value = np.exp(-square)
    else:
        value = np.exp(-(1.0 + 1.0 / material.tail) * np.log1p(material.tail * square))
    if material.second_lobe is not None:
        weight, width = material.second_lobe
        value = (1.0 - weight) * value + weight / width**2 * np.exp(-square / width**2)
    return np.asarray(value)


def distribution(
    half: FloatArray, along: FloatArray, across: FloatArray, normal: FloatArray, material: Material
) -> FloatArray:
    """Anisotropic distribution D [1/sr] of half vectors (…, 3) about ``normal`` (Luongo 2017, Eq. 3, for no tail)."""
    cosine = half @ normal
    slope = ((half @ along) / material.alpha_along) ** 2 + ((half @ across) / material.alpha_across) ** 2
    safe = np.where(cosine > 1e-6, cosine, 1.0)
    density = slope_density(slope / safe**2, material)
    value = density / (np.pi * material.alpha_along * material.alpha_across * safe**4)
    return np.where(cosine > 1e-6, value, 0.0)


def smith_lambda(
    alpha_tan: FloatArray, tail: float = 0.0, second_lobe: tuple[float, float] | None = None
) -> FloatArray:
    """Smith's Λ for α·tan θ ≥ 0 (Heitz 2014; Eq. 66 for Beckmann, Eq. 72 for a tail of 1).

    Λ = ∫_a^∞ (q − a) P₁(q) dq / a with a = 1/(α tan θ) and the density P₁ of the slopes along one axis, that of
    Student's t distribution with 2/τ degrees of freedom. Both parts of the integral are closed.
    """
    a = 1.0 / np.maximum(alpha_tan, 1e-9)
    if tail < SHORTEST_TAIL:
        value = np.where(a < UNSHADOWED, beckmann_lambda(np.minimum(a, UNSHADOWED)), 0.0)
    else:
        from scipy.special import betainc, gammaln  # noqa: PLC0415 - start-up time

        degrees = 1.0 / tail
        height = np.sqrt(tail / np.pi) * np.exp(gammaln(degrees + 0.5) - gammaln(degrees))
        grown = np.log1p(tail * a**2)
        mean = height * np.exp((0.5 - degrees) * grown) / ((2.0 - tail) * a)
        value = mean - 0.5 * betainc(degrees, 0.5, np.exp(-grown))
    value = np.asarray(np.maximum(value, 0.0), dtype=np.float64)
    if second_lobe is not None:
        weight, width = second_lobe
        value = (1.0 - weight) * value + weight * smith_lambda(width * np.asarray(alpha_tan))
    return np.asarray(value, dtype=np.float64)


@lru_cache(maxsize=64)
def shadowing_table(tail: float, second_lobe: tuple[float, float] | None) -> FloatArray:
    """Logarithm of Λ at SHADOWING_SIZE values of α·tan θ, evenly spaced in its logarithm between SHADOWING_ENDS."""
    value = smith_lambda(np.geomspace(*SHADOWING_ENDS, SHADOWING_SIZE), tail, second_lobe)
    table = np.log(np.maximum(value, 1e-300))
    table.flags.writeable = False
    return table


def smith(
    to_light: FloatArray,
    to_camera: FloatArray,
    along: FloatArray,
    across: FloatArray,
    normal: FloatArray,
    material: Material,
) -> FloatArray:
    """Height-correlated Smith shadowing-masking 1/(1 + Λ_i + Λ_o) of the facet's own roughness (Heitz 2014, Eq. 99)."""

    def alpha_tan(direction: FloatArray) -> FloatArray:
        spread = np.hypot(
            material.alpha_along * (direction @ along), material.alpha_across * (direction @ across)
        )
        cosine = np.maximum(direction @ normal, 1e-9)
        return np.asarray(spread / cosine, dtype=np.float64)

    slopes = material.tail, material.second_lobe
    return 1.0 / (
        1.0 + smith_lambda(alpha_tan(to_light), *slopes) + smith_lambda(alpha_tan(to_camera), *slopes)
    )


def lobe_albedo(cosine: FloatArray, alpha: float, index: float) -> FloatArray:
    """Directional albedo of the single-scattering Beckmann lobe, for cosines of incidence (N,).

    Integrates over the slopes of the microfacets, which are Gaussian, as far as they send light out of the surface:
    with slopes x in the plane of incidence and y across it, up to the root x of μ·(1 + x² + y²) = 2·(μ − x·sin θ).
    Gauss-Legendre; seen to be exact to 1e-5. ``index`` < 1 gives the counterpart from inside.
    """
    cosines = np.array(cosine, dtype=np.float64)  # writeable: the kernel is compiled for one kind of array
    rules = _gauss_legendre(_ACROSS), _gauss_legendre(_ALONG)
    albedos = np.empty_like(cosines)
    if "numba" in sys.modules or _interface.cache_info().misses > TABLES_BY_ARRAYS:
        from anisoscope.sim.light.interface_kernels import lobe_albedos  # noqa: PLC0415 - numba when first needed

        scratch = np.empty((4, _ACROSS))
        lobe_albedos(cosines, float(alpha), float(index), _STEEPEST, *rules, scratch, albedos)
        return albedos
    for start in range(0, cosines.size, _COSINES):
        part = slice(start, start + _COSINES)
        albedos[part] = _lobe_albedos(cosines[part], alpha, index, *rules)
    return albedos


def _lobe_albedos(
    cosine: FloatArray,
    alpha: float,
    index: float,
    across: tuple[FloatArray, FloatArray],
    along: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """The quadrature of `interface_kernels.lobe_albedos` in arrays (cosines, slopes across, slopes along)."""
    (node, weight), reach = across, _STEEPEST * alpha
    y = 0.5 * reach * (along[0] + 1.0)
    mu = np.clip(cosine, 1e-4, 1.0)[:, None, None]
    sine = np.sqrt(1.0 - mu * mu)

    def shadow(cosine: FloatArray) -> FloatArray:
        return smith_lambda(alpha * np.sqrt(1.0 - cosine * cosine) / cosine)

    grazing = (np.sqrt(np.maximum(sine * sine + mu * mu * (1.0 - (y * y)[:, None]), 0.0)) - sine) / mu
    half = 0.5 * np.maximum(np.minimum(grazing, reach) + reach, 0.0)
    x = half * (node + 1.0) - reach
    x_square = x * x
    half_square = 1.0 / (1.0 + x_square + (y * y)[:, None])  # cos² of the microfacet's angle
    dot = mu - x * sine
    cos_half = np.minimum(np.abs(dot) * np.sqrt(half_square), 1.0)
    out = np.clip(2.0 * dot * half_square - mu, 1e-9, 1.0)
    entering = np.broadcast_to(1.0 + shadow(mu), out.shape).copy()
    slanting = out * out < (UNSHADOWED * alpha) ** 2 * (1.0 - out * out)
    entering[slanting] += shadow(out[slanting])
    density = np.exp(x_square * -(alpha**-2.0))
    light = fresnel(cos_half, index) * np.maximum(dot, 0.0) * density / entering
    outer = reach * along[1] * np.exp(-((y / alpha) ** 2))
    return np.asarray(((light @ weight) * half[..., 0]) @ outer / (np.pi * alpha * alpha * mu[:, 0, 0]))


@cache
def _cosines() -> FloatArray:
    grid = np.linspace(0.0, 1.0, TABLE_SIZE)
    grid.flags.writeable = False
    return grid


@lru_cache(maxsize=256)
def _interface(alpha: float, index: float) -> tuple[FloatArray, float]:
    table = 1.0 - lobe_albedo(_cosines(), alpha, index)
    table.flags.writeable = False
    node, weight = _gauss_legendre(256)
    mu = 0.5 * (node + 1.0)
    inside = lobe_albedo(mu, alpha, 1.0 / index)
    return table, float(np.sum(weight * mu * inside))


@dataclass(frozen=True)
class HeldInterface(Material):
    """A material whose interface table belongs to a roughness held fixed while the lobes change.

    The table costs most of a fit and hardly depends on the roughness: by less than 5·10⁻⁵ of the radiance within .5 %.

    Attributes:
        interface_alpha: roughness of the transmittance table.
    """

    interface_alpha: float = 0.08

    @property
    def alpha_mean(self) -> float:
        """The roughness used for the transmittance of the interface."""
        return self.interface_alpha


def transmittance_table(material: Material) -> FloatArray:
    """T(μ) of the rough interface on a uniform grid of TABLE_SIZE cosines from 0 to 1."""
    return _interface(material.alpha_mean, material.index)[0]


def transmittance(cosine: FloatArray, material: Material) -> FloatArray:
    """T(μ) = 1 − directional albedo of the lobe, interpolated; α is √(α_u·α_v)."""
    table = transmittance_table(material)
    place = cosine * (TABLE_SIZE - 1)
    index = np.minimum(place.astype(np.intp), TABLE_SIZE - 2)
    low = table[index]
    return np.asarray(low + (place - index) * (table[index + 1] - low))


def diffuse_scale(material: Material) -> float:
    """The factor ρ/(1 − x)/(π η²) in front of T(cos_i)·T(cos_o), in 1/sr."""
    internal = _interface(material.alpha_mean, material.index)[1]
    returned = material.albedo * internal if material.internal_reflection == "nonlinear" else internal
    return material.albedo / (1.0 - returned) / (np.pi * material.index**2)


def interface_bound(material: Material) -> float:
    """Largest relative change of the albedo by which multiple scattering in the interface makes the base brighter.

    With all reflections F_dr exceeds that of single ones by up to 0.7·α², which in ρ/(1 − ρ·F_dr) acts as an albedo
    larger by 0.7·α²·ρ of itself, and T(μ_i)·T(μ_o) is larger by up to 0.1·α² near the normal: walks on Smith's surface
    with α up to 0.3 and any tail.
    """
    return (0.7 * material.albedo + 0.1) * material.alpha_mean**2


def facet_brdf(
    to_light: FloatArray,
    to_camera: FloatArray,
    along: FloatArray,
    across: FloatArray,
    normal: FloatArray,
    material: Material,
) -> FloatArray:
    """BRDF [1/sr] of a rough plastic facet with orthonormal frame (along, across, normal), each (3,).

    Args:
        to_light: (…, 3) unit vectors.
        to_camera: (…, 3) unit vectors.
        along: facet tangent along the ridges.
        across: facet tangent across the ridges.
        normal: facet normal.
        material: the plastic.

    Returns:
        (…) values; zero where light or camera is behind the facet.
    """
    cos_i, cos_o = to_light @ normal, to_camera @ normal
    front = (cos_i > 0) & (cos_o > 0)
    cos_i, cos_o = np.where(front, cos_i, 1.0), np.where(front, cos_o, 1.0)
    half = to_light + to_camera
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    mirror = fresnel(np.sum(to_light * half, axis=-1), material.index)
    lobe = mirror * distribution(half, along, across, normal, material)
    lobe = lobe * smith(to_light, to_camera, along, across, normal, material) / (4.0 * cos_i * cos_o)
    base = diffuse_scale(material) * transmittance(cos_i, material) * transmittance(cos_o, material)
    return np.where(front, lobe + base, 0.0)


def oren_nayar(
    to_light: FloatArray, to_camera: FloatArray, normal: FloatArray, albedo: float, roughness_deg: float
) -> FloatArray:
    """BRDF [1/sr] of a matte facet of V-shaped cavities (Oren and Nayar 1994, Eq. 30); Lambert's for no roughness.

    Args:
        to_light: (…, 3) unit vectors.
        to_camera: (…, 3) unit vectors.
        normal: facet normal.
        albedo: diffuse albedo.
        roughness_deg: standard deviation σ of the slopes' angles in degrees.

    Returns:
        (…) values; zero where light or camera is behind the facet.
    """
    cos_i, cos_o = to_light @ normal, to_camera @ normal
    front = (cos_i > 0) & (cos_o > 0)
    square = np.radians(roughness_deg) ** 2
    # sin α tan β cos(φi − φo) with α the larger and β the smaller angle is (ω_i·ω_o − cos_i cos_o)/max(cos_i, cos_o)
    beside = np.sum(to_light * to_camera, axis=-1) - cos_i * cos_o
    slanting = np.maximum(beside, 0.0) / np.where(front, np.maximum(cos_i, cos_o), 1.0)
    value = 1.0 - 0.5 * square / (square + 0.33) + 0.45 * square / (square + 0.09) * slanting
    return np.where(front, albedo / np.pi * value, 0.0)


class Rays(NamedTuple):
    """Directions in the frame of a side, and what a BRDF needs of each alone: transmittance and Smith's Λ."""

    along: FloatArray
    up: FloatArray
    normal: FloatArray
    through: FloatArray
    shadow: FloatArray

    def at(self, place: Any) -> "Rays":  # noqa: ANN401 - whatever an array takes
        """Rays at some places."""
        return Rays(*(one[place] for one in self))


def rays(along: FloatArray, up: FloatArray, normal: FloatArray, material: Material) -> Rays:
    """Directions (along, up, normal) above a side."""
    return Rays(along, up, normal, transmittance(normal, material), _shadowing(along, up, normal, material))


def rays_to(directions: FloatArray, material: Material) -> Rays:
    """(N, 3) directions above a side."""
    along, up, normal = np.ascontiguousarray(directions.T)
    return rays(along, up, normal, material)


def _shadowing(along: FloatArray, up: FloatArray, normal: FloatArray, material: Material) -> FloatArray:
    """Smith's Λ: for any lobe but Beckmann's from its table, where ln Λ is nearly straight over ln(α·tan θ)."""
    spread = (material.alpha_along * along) ** 2 + (material.alpha_across * up) ** 2
    if material.is_beckmann:
        found = np.zeros_like(spread)
        slanting = spread > (normal / UNSHADOWED) ** 2
        found[slanting] = beckmann_lambda(normal[slanting] / np.sqrt(spread[slanting]))
        return found
    table = shadowing_table(material.tail, material.second_lobe)
    place = np.log(np.maximum(np.sqrt(spread) / normal, 1e-9) / SHADOWING_ENDS[0]) * SLANTS_PER_E_FOLD
    index = np.clip(place.astype(np.intp), 0, table.size - 2)
    return np.asarray(np.exp(table[index] + (place - index) * (table[index + 1] - table[index])))


def brdf(first: Rays, second: Rays, material: Material) -> FloatArray:
    """BRDF [1/sr] of rough plastic between directions above a side, as `facet_brdf`; they broadcast."""
    alpha_u, alpha_v, index = material.alpha_along, material.alpha_across, material.index
    h_normal = first.normal + second.normal
    per_square = 1.0 / (h_normal * h_normal)
    h_along, h_up = (first.along + second.along) ** 2, (first.up + second.up) ** 2
    slope = (h_along * alpha_u**-2 + h_up * alpha_v**-2) * per_square
    h_along += h_up
    h_along *= per_square
    h_along += 1.0  # |h|²/h_n²
    square = 0.25 * h_along / per_square  # cos² of half the angle between unit vectors
    cosine = np.minimum(np.sqrt(square), 1.0)
    inside = np.sqrt(square + (index * index - 1.0))  # Fresnel's, times the index
    perpendicular = (inside - cosine) / (inside + cosine)
    parallel = (cosine * (inside + cosine) - 1.0) / (cosine * (inside - cosine) + 1.0)
    parallel *= parallel
    parallel += 1.0
    perpendicular *= perpendicular
    value = slope_density(slope, material)
    value *= perpendicular
    value *= parallel
    h_along *= h_along
    value *= h_along
    value /= (1.0 + first.shadow + second.shadow) * (first.normal * second.normal)
    value *= 1.0 / (8.0 * pi * alpha_u * alpha_v)
    value += diffuse_scale(material) * first.through * second.through
    return np.asarray(value)


def brdf_table(first: FloatArray, second: FloatArray, material: Material) -> FloatArray:
    """(N, M) BRDF [1/sr] between directions (N, 3) and (M, 3) in the frame of the side; 0 at or below its plane."""

    def above(directions: FloatArray) -> tuple[Rays, FloatArray]:
        along, up, normal = np.ascontiguousarray(directions.T)
        front = normal > 0.0
        return rays(along, up, np.where(front, normal, 1.0), material), front.astype(np.float64)

    (one, lit), (other, seen) = above(first), above(second)
    result = np.empty((len(first), len(second)))
    for start in range(0, len(first), _ROWS):
        rows = slice(start, start + _ROWS)
        result[rows] = brdf(one.at((rows, None)), other, material)
    if not (lit.all() and seen.all()):
        result *= lit[:, None] * seen
    return result
