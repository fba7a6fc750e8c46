"""The ridge BRDF exactly as published: Luongo et al. 2017, Eq. 2, 3, 6 and 10.

Kept for fidelity. Its known errors, each shown by a test: shadow and mask of the same strip are counted
twice, the facet-area factor is missing so that a white surface reflects more than it receives, and the
"subsurface" term is a second glossy lobe. Predictions of Michelson contrasts and log ratios need the
corrected model.
"""

from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light.material import distribution, fresnel

ShadowFrame = Literal["pitch-normal", "half-vector"]


def _g1(direction: FloatArray, axis: FloatArray, ridge_angle_rad: float) -> FloatArray:
    """Eq. 2 and 10; ``axis`` is the pitch normal (Appendix A) or, literally by Eq. 6, the half vector."""
    projected = direction * np.array([1.0, 0.0, 1.0])
    length = np.linalg.norm(projected, axis=-1)
    dot = np.sum(projected * axis, axis=-1)
    cos_p = np.clip(dot / np.maximum(length, 1e-12), -1.0, 1.0)
    with np.errstate(divide="ignore"):
        tan_p = np.sqrt(1.0 - cos_p**2) / np.abs(cos_p)
    visible = 1.0 - np.minimum(1.0, np.abs(np.tan(ridge_angle_rad) * tan_p))
    return np.where(dot / projected[..., 2] > 0, visible, 0.0)


def ridge_brdf(
    to_light: FloatArray,
    to_camera: FloatArray,
    design: RidgeDesign,
    material: Material,
    shadow_frame: ShadowFrame = "pitch-normal",
) -> FloatArray:
    """BRDF f = f_r + f_ss [1/sr] of the ridged macro surface (Luongo 2017, Eq. 6).

    Args:
        to_light: (…, 3) unit vectors in the sample frame.
        to_camera: (…, 3) unit vectors in the sample frame.
        design: the ridges; only the ridge angle enters.
        material: α_u, α_v, albedo and index; ``internal_reflection`` does not enter.
        shadow_frame: the axis from which θ_p of Eq. 2 is counted.

    Returns:
        (…) values.

    Raises:
        ModelError: the lobe is not Beckmann's.
    """
    if not material.is_beckmann:
        raise ModelError(
            "the printed model has Beckmann's lobe: take the corrected model for one with a tail"
        )
    theta = np.radians(design.ridge_angle_deg)
    normal = np.array([np.sin(theta), 0.0, np.cos(theta)])
    along = np.array([0.0, 1.0, 0.0])
    across = np.cross(normal, along)
    half = to_light + to_camera
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    axis = np.broadcast_to(normal, half.shape) if shadow_frame == "pitch-normal" else half
    shadowing = _g1(to_light, axis, theta) * _g1(to_camera, axis, theta)
    mirror = fresnel(np.sum(to_light * half, axis=-1), material.index)
    glossy = shadowing * distribution(half, along, across, normal, material)
    glossy = glossy / (4.0 * np.abs(to_light[..., 2]) * np.abs(to_camera[..., 2]))
    return np.asarray(glossy * (mirror + material.albedo / np.pi * (1.0 - mirror) ** 2), dtype=np.float64)


def radiance(
    to_light: FloatArray, to_camera: FloatArray, design: RidgeDesign, material: Material
) -> FloatArray:
    """f·(ω_i·n) [1/sr]: what the camera sees per unit irradiance perpendicular to the beam, without the scale k."""
    return ridge_brdf(to_light, to_camera, design, material) * to_light[..., 2]
