"""How the normals of an ink's flakes are distributed, and how flakes hide one another.

The paper's distribution (Pranovich 2024, Eq. 3) is Trowbridge-Reitz, alias GGX; Beckmann's is another. Both belong to
the family of `anisoscope.sim.light.material`, with a tail of 1 and of 0. Any may be anisotropic, as brushing makes
them. Forms and Smith's Λ: Walter 2007; Heitz 2014, Eqs. 71 and 85.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.material import LONGEST_TAIL, SHORTEST_TAIL, Material
from anisoscope.sim.light.material import slope_density
from anisoscope.sim.light.material import smith_lambda as hidden_lambda

Distribution = Literal["ggx", "beckmann"] | Annotated[float, Field(ge=0.0, le=LONGEST_TAIL)]
"""By name, or by its tail."""
_TAILS: dict[Distribution, float] = {"ggx": 1.0, "beckmann": 0.0}


def tail_of(kind: Distribution) -> float:
    """Tail of a distribution: 0 Beckmann's, 1 GGX."""
    return float(_TAILS.get(kind, kind))


def density(half: FloatArray, alpha_x: float, alpha_y: float, kind: Distribution = "ggx") -> FloatArray:
    """D [1/sr] at (…, 3) half vectors in the frame of the brushing; 0 below the surface.

    ∫ D cosθ dω = 1 over the upper hemisphere.
    """
    x, y, z = np.moveaxis(np.asarray(half, dtype=np.float64), -1, 0)
    up = np.maximum(z, 1e-12)
    shape = slope_density(((x / alpha_x) ** 2 + (y / alpha_y) ** 2) / up**2, Material(tail=tail_of(kind)))
    return np.where(z > 0.0, shape / (np.pi * alpha_x * alpha_y * up**4), 0.0)


def smith_lambda(
    direction: FloatArray, alpha_x: float, alpha_y: float, kind: Distribution = "ggx"
) -> FloatArray:
    """Smith's Λ at (…, 3) unit vectors above the surface, in the frame of the brushing."""
    x, y, z = np.moveaxis(np.asarray(direction, dtype=np.float64), -1, 0)
    return hidden_lambda(np.hypot(alpha_x * x, alpha_y * y) / np.maximum(z, 1e-12), tail_of(kind))


def masking(
    to_light: FloatArray, to_camera: FloatArray, alpha_x: float, alpha_y: float, kind: Distribution = "ggx"
) -> FloatArray:
    """Share of flakes both lit and seen, 1/(1 + Λi + Λo) (height-correlated; Heitz 2014, Eq. 99)."""
    lit = smith_lambda(to_light, alpha_x, alpha_y, kind)
    return np.asarray(1.0 / (1.0 + lit + smith_lambda(to_camera, alpha_x, alpha_y, kind)))


def normals_by_share(
    share: FloatArray, azimuth: FloatArray, alpha_x: float, alpha_y: float, kind: Distribution
) -> FloatArray:
    """(…, 3) normals at quantiles of ∫ D cosθ dω over the inclination; ``azimuth`` in radians.

    Equal steps in share and azimuth carry equal weight, also where the lobe is anisotropic.
    """
    tail, rarer = tail_of(kind), -np.log1p(-share)
    slope = np.sqrt(rarer if tail < SHORTEST_TAIL else np.expm1(tail * rarer) / tail)
    x, y = alpha_x * slope * np.cos(azimuth), alpha_y * slope * np.sin(azimuth)
    return np.stack([x, y, np.ones_like(x)], axis=-1) / np.sqrt(1.0 + x**2 + y**2)[..., None]
