"""How the normals of an ink's flakes are distributed, and how flakes hide one another.

The paper's distribution (Pranovich 2024, Eq. 3) is Trowbridge-Reitz, alias GGX; Beckmann's is the other choice. Both
may be anisotropic, as brushing makes them. Forms and Smith's Λ: Walter 2007; Heitz 2014, Eqs. 71, 72, 85 and 86.
"""

from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray

Distribution = Literal["ggx", "beckmann"]
DISTRIBUTIONS: tuple[Distribution, ...] = ("ggx", "beckmann")


def density(half: FloatArray, alpha_x: float, alpha_y: float, kind: Distribution = "ggx") -> FloatArray:
    """D [1/sr] at (…, 3) half vectors in the frame of the brushing; 0 below the surface.

    ∫ D cosθ dω = 1 over the upper hemisphere.
    """
    x, y, z = np.moveaxis(np.asarray(half, dtype=np.float64), -1, 0)
    spread = (x / alpha_x) ** 2 + (y / alpha_y) ** 2
    up = np.maximum(z, 1e-12)
    peak = 1.0 / (np.pi * alpha_x * alpha_y)
    shape = 1.0 / (spread + up**2) ** 2 if kind == "ggx" else np.exp(-spread / up**2) / up**4
    return np.where(z > 0.0, peak * shape, 0.0)


def smith_lambda(
    direction: FloatArray, alpha_x: float, alpha_y: float, kind: Distribution = "ggx"
) -> FloatArray:
    """Smith's Λ at (…, 3) unit vectors above the surface, in the frame of the brushing."""
    x, y, z = np.moveaxis(np.asarray(direction, dtype=np.float64), -1, 0)
    slant = np.hypot(alpha_x * x, alpha_y * y) / np.maximum(z, 1e-12)
    if kind == "ggx":
        return np.asarray(0.5 * (np.sqrt(1.0 + slant**2) - 1.0))
    from scipy.special import erfc  # noqa: PLC0415 - loads in half a second

    a = 1.0 / np.maximum(slant, 1e-6)
    return np.asarray(np.maximum(0.5 * (np.exp(-(a**2)) / (a * np.sqrt(np.pi)) - erfc(a)), 0.0))


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
    slope = np.sqrt(share / (1.0 - share)) if kind == "ggx" else np.sqrt(-np.log1p(-share))
    x, y = alpha_x * slope * np.cos(azimuth), alpha_y * slope * np.sin(azimuth)
    return np.stack([x, y, np.ones_like(x)], axis=-1) / np.sqrt(1.0 + x**2 + y**2)[..., None]
