"""Rough plastic of the path tracer: a microfacet lobe on a refracting interface over a diffuse base.

The interface is described by the distribution P of the slopes of its microfacets, stretched by α along and across
the ridges:

- ``beckmann``: P = exp(−r²)/π
- ``ggx``: P = (1 + r²)⁻²/π (Walter et al. 2007, Trowbridge and Reitz 1975)
- ``student``: P = (1 + r²/2)⁻³/π, Student's distribution with γ = 3 (Ribardière et al. 2017)
- ``two-scale``: 0.7 of the facets 0.8 times as rough and 0.3 of them 1.8 times as rough (Beckmann both)
- ``wide-base``: 0.85 of the facets as rough as stated and 0.15 of them 2.5 times as rough (Beckmann both)

Nothing here is shared with `anisoscope.sim.light.material`: the path tracer is what predictions are tested on.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError

LobeName = Literal["beckmann", "ggx", "student", "two-scale", "wide-base"]
LOBES: tuple[LobeName, ...] = get_args(LobeName)
TAIL: dict[LobeName, float] = {
    "beckmann": 0.0,
    "ggx": 1.0,
    "student": 0.5,
    "two-scale": 0.0,
    "wide-base": 0.0,
}
"""τ of P = (1 + τ r²)^−(1 + 1/τ)/π of every component; 0 is the Gaussian."""
COMPONENTS: dict[LobeName, tuple[tuple[float, float], ...]] = {
    "beckmann": ((1.0, 1.0),),
    "ggx": ((1.0, 1.0),),
    "student": ((1.0, 1.0),),
    "two-scale": ((0.7, 0.8), (0.3, 1.8)),
    "wide-base": ((0.85, 1.0), (0.15, 2.5)),
}
"""Share of the microfacets and factor on α of every component."""
TABLE_SIZE = 512
_RADII, _AZIMUTHS = 64, 24


@dataclass(frozen=True)
class Plastic:
    """A rough plastic.

    Attributes:
        alpha_along: roughness along the ridges (y), √2 times the rms slope of a Gaussian.
        alpha_across: roughness across the ridges.
        albedo: share of the light that the base sends back at each arrival from above, 0 to 1.
        index: refractive index.
        lobe: distribution of the slopes of the microfacets.

    Raises:
        ModelError: a value out of its range, or an unknown lobe.
    """

    alpha_along: float
    alpha_across: float
    albedo: float
    index: float = 1.5
    lobe: LobeName = "beckmann"

    def __post_init__(self) -> None:
        if self.lobe not in LOBES:
            raise ModelError(f"a lobe is one of {', '.join(LOBES)}, not {self.lobe!r}")
        if not (0.0 < self.alpha_along < 2.0 and 0.0 < self.alpha_across < 2.0):
            raise ModelError(
                f"roughness must lie between 0 and 2, not {self.alpha_along}, {self.alpha_across}"
            )
        if not (0.0 <= self.albedo <= 1.0 and 1.0 < self.index <= 4.0):
            raise ModelError(
                f"albedo must lie within 0 and 1, index above 1, not {self.albedo}, {self.index}"
            )

    @property
    def components(self) -> FloatArray:
        """(K, 2) shares of the microfacets and factors on α."""
        return np.array(COMPONENTS[self.lobe], dtype=np.float64)

    @property
    def tail(self) -> float:
        """τ of the components."""
        return TAIL[self.lobe]

    @property
    def alpha_mean(self) -> float:
        """√(α_u·α_v), of which the transmission of the interface is taken."""
        return float(np.sqrt(self.alpha_along * self.alpha_across))

    @property
    def transmission(self) -> FloatArray:
        """(TABLE_SIZE,) share of light that enters, at cosines of incidence from 0 to 1."""
        return _interface(self.alpha_mean, self.index, self.lobe)[0]

    @property
    def internal_reflectance(self) -> float:
        """Share of diffuse light from below that the interface sends back."""
        return _interface(self.alpha_mean, self.index, self.lobe)[1]

    @property
    def base(self) -> float:
        """Factor of T(μ_i)·T(μ_o) in the BRDF, 1/sr: reflections between base and interface are summed."""
        return self.albedo / (np.pi * self.index**2 * (1.0 - self.albedo * self.internal_reflectance))


def fresnel_reflectance(cosine: FloatArray, index: float) -> FloatArray:
    """Unpolarised Fresnel reflectance at an interface to a medium of relative ``index``; 1 at total reflection."""
    cosine = np.clip(cosine, 0.0, 1.0)
    refracted_squared = 1.0 - (1.0 - cosine**2) / index**2
    refracted = np.sqrt(np.maximum(refracted_squared, 0.0))
    normal = (cosine - index * refracted) / (cosine + index * refracted + 1e-300)
    parallel = (index * cosine - refracted) / (index * cosine + refracted + 1e-300)
    found = 0.5 * (normal**2 + parallel**2)
    return np.asarray(np.where(refracted_squared <= 0.0, 1.0, found))


def slope_density(radius_squared: FloatArray, tail: float) -> FloatArray:
    """P(r²), the density of slopes over their plane in units of α; its integral is 1."""
    if tail == 0.0:
        return np.asarray(np.exp(-radius_squared) / np.pi)
    return np.asarray((1.0 + tail * radius_squared) ** (-1.0 - 1.0 / tail) / np.pi)


def shadowing(cotangent: FloatArray, lobe: LobeName) -> FloatArray:
    """Smith's Λ at a = 1/(α·tan θ): (1/a)·∫ (q − a) P₁(q) dq over q > a, P₁ the density of one component of slope."""
    found = np.zeros_like(np.asarray(cotangent, dtype=np.float64))
    for share, factor in COMPONENTS[lobe]:
        found = found + share * _shadowing(np.asarray(cotangent, dtype=np.float64) / factor, TAIL[lobe])
    return found


def _shadowing(a: FloatArray, tail: float) -> FloatArray:
    a = np.maximum(a, 1e-6)
    if tail == 0.0:
        from scipy.special import erfc  # noqa: PLC0415 - start-up time

        return np.asarray(0.5 * (np.exp(-(np.minimum(a, 26.0) ** 2)) / (a * np.sqrt(np.pi)) - erfc(a)))
    if tail == 1.0:
        return np.asarray(0.5 * (np.sqrt(1.0 + 1.0 / a**2) - 1.0))
    # P₁ = 3/(4√2)·(1 + q²/2)^(−5/2); with q = √2·tan φ both integrals are elementary. What is left of 2/3 − s + s³/3
    # where s is nearly 1 is written as (1 − s)²·(2 + s)/3
    s = a / np.sqrt(2.0 + a**2)
    less = 2.0 / ((2.0 + a**2) * (1.0 + s))  # 1 − s
    first = 2.0 / 3.0 * (1.0 + 0.5 * a**2) ** -1.5
    second = np.sqrt(2.0) * less**2 * (2.0 + s) / 3.0
    return np.asarray(np.maximum(3.0 / (4.0 * np.sqrt(2.0)) * (first / a - second), 0.0))


@lru_cache(maxsize=64)
def _interface(alpha: float, index: float, lobe: LobeName) -> tuple[FloatArray, float]:
    cosines = np.linspace(0.0, 1.0, TABLE_SIZE)
    # computed where it bends most, near grazing, as well as where it is flat
    coarse = np.sin(0.5 * np.pi * np.linspace(0.0, 1.0, 65)) ** 2
    transmission = np.interp(cosines, coarse, 1.0 - lobe_reflectance(coarse, alpha, index, lobe))
    transmission.flags.writeable = False
    node, weight = np.polynomial.legendre.leggauss(40)
    critical = np.sqrt(1.0 - 1.0 / index**2)  # cosine below which a smooth interface reflects all from below
    mu = np.concatenate([0.5 * critical * (node + 1.0), critical + 0.5 * (1.0 - critical) * (node + 1.0)])
    weights = np.concatenate([critical * weight, (1.0 - critical) * weight])
    inside = lobe_reflectance(mu, alpha, 1.0 / index, lobe)
    return transmission, float(np.sum(weights * mu * inside))


def lobe_reflectance(cosine: FloatArray, alpha: float, index: float, lobe: LobeName) -> FloatArray:
    """Share of light that the lobe sends back, for (N,) cosines of incidence: one reflection, shadowing included.

    Mean over microfacets: each sends F·(i·h)⁺/(μ·h_z) times the light that falls on a level area, of which
    1/(1 + Λ_i + Λ_o) gets in and out. Radii of the slopes are taken at equal shares of the microfacets.
    """
    share = (np.arange(_RADII) + 0.5) / _RADII
    turn = np.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS  # both sides of the plane of incidence are alike
    mu = np.clip(np.asarray(cosine, dtype=np.float64), 1e-4, 1.0)[:, None, None]
    sine = np.sqrt(1.0 - mu**2)
    tail = TAIL[lobe]
    radius = np.sqrt(-np.log1p(-share) if tail == 0.0 else ((1.0 - share) ** -tail - 1.0) / tail)
    own = shadowing(mu / np.maximum(sine * alpha, 1e-12), lobe)
    total = np.zeros(len(mu))
    for weight, factor in COMPONENTS[lobe]:
        slope = factor * alpha * radius
        x, y = slope[:, None] * np.cos(turn), slope[:, None] * np.sin(turn)
        up = 1.0 / np.sqrt(1.0 + x**2 + y**2)
        toward = up * (mu - x * sine)  # i·h, with h = up·(−x, −y, 1) and i = (sine, 0, mu)
        out = 2.0 * toward * up - mu
        level = np.sqrt(np.maximum(1.0 - out**2, 1e-24))
        out_shadow = shadowing(np.maximum(out, 1e-9) / (level * alpha), lobe)
        sent = fresnel_reflectance(toward, index) * np.maximum(toward, 0.0) / (mu * up)
        sent = np.where(out > 0.0, sent / (1.0 + own + out_shadow), 0.0)
        total += weight * sent.mean(axis=(1, 2))
    return total


def brdf(to_light: FloatArray, to_camera: FloatArray, plastic: Plastic) -> FloatArray:
    """BRDF [1/sr] of a level facet (normal z, ridges along y) for (…, 3) unit vectors; 0 below the horizon."""
    light, camera = np.broadcast_arrays(np.asarray(to_light), np.asarray(to_camera))
    mu_i, mu_o = light[..., 2], camera[..., 2]
    above = (mu_i > 0.0) & (mu_o > 0.0)
    mu_i, mu_o = np.where(above, mu_i, 1.0), np.where(above, mu_o, 1.0)
    half = light + camera
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    x = half[..., 0] / (half[..., 2] * plastic.alpha_across)
    y = half[..., 1] / (half[..., 2] * plastic.alpha_along)
    density = np.zeros_like(mu_i)
    for share, factor in plastic.components:
        density += share * slope_density((x**2 + y**2) / factor**2, plastic.tail) / factor**2
    density /= plastic.alpha_along * plastic.alpha_across * half[..., 2] ** 4

    def shadow(side: FloatArray, cosine: FloatArray) -> FloatArray:
        spread = np.hypot(plastic.alpha_across * side[..., 0], plastic.alpha_along * side[..., 1])
        return shadowing(cosine / np.maximum(spread, 1e-12), plastic.lobe)

    mirror = fresnel_reflectance(np.sum(light * half, axis=-1), plastic.index)
    lobe = mirror * density / (4.0 * mu_i * mu_o * (1.0 + shadow(light, mu_i) + shadow(camera, mu_o)))
    grid = np.linspace(0.0, 1.0, TABLE_SIZE)
    entered = np.interp(mu_i, grid, plastic.transmission) * np.interp(mu_o, grid, plastic.transmission)
    return np.asarray(np.where(above, lobe + plastic.base * entered, 0.0))
