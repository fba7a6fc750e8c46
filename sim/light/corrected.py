"""The corrected ridge model: rough plastic on facet and wall, with exact visibility of the ridge profile.

Visible shares come from `ridge_profile`; light that reflects more than once is added by `bounces`.
"""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.sim.light.bounces import interreflection
from anisoscope.sim.light.material import Material, facet_brdf
from anisoscope.sim.light.ridge_profile import ridge_polyline, visible_shares


def radiance(
    to_light: FloatArray,
    to_camera: FloatArray,
    design: RidgeDesign,
    material: Material,
    bounces: int | None = 1,
) -> FloatArray:
    """Radiance [1/sr] of the ridged surface per unit irradiance perpendicular to the beam.

    Direct light: L = Σ_j A_j V_j f_j cos_i,j cos_o,j / (A_macro · ω_o·n) over the facet, the wall and, with
    height loss, the plateau; A_j the true area, V_j the share both lit and seen.

    Args:
        to_light: (P, 3) unit vectors in the sample frame, above the horizon.
        to_camera: (P, 3) unit vectors in the sample frame, above the horizon.
        design: the ridges.
        material: the plastic.
        bounces: largest number of reflections that is counted: 1 is direct light, None counts all
            (`bounces.interreflection`).

    Returns:
        (P,) radiances.

    Raises:
        ModelError: fewer than one reflection.
    """
    indirect = interreflection(to_light, to_camera, design, material, bounces)
    return _direct_radiance(to_light, to_camera, design, material) + indirect


def _direct_radiance(
    to_light: FloatArray, to_camera: FloatArray, design: RidgeDesign, material: Material
) -> FloatArray:
    """(P,) radiance [1/sr] of light that reflects once."""
    x, z = ridge_polyline(design)
    dx, dz = np.diff(x), np.diff(z)
    length = np.hypot(dx, dz)
    along = np.array([0.0, 1.0, 0.0])
    brdf, cosines = [], []
    for run, rise, size in zip(dx, dz, length, strict=True):
        normal, across = np.array([[-rise, 0.0, run], [-run, 0.0, -rise]]) / size  # normal × along
        brdf.append(facet_brdf(to_light, to_camera, along, across, normal, material))
        cosines.append(np.maximum(to_light @ normal, 0.0) * np.maximum(to_camera @ normal, 0.0))
    weight = np.stack(brdf) * np.stack(cosines) * length[:, None]
    light_tangent, camera_tangent = to_light[:, 0] / to_light[:, 2], to_camera[:, 0] / to_camera[:, 2]
    lit, seen = visible_shares(x, z, light_tangent), visible_shares(x, z, camera_tangent)
    same_side = ((light_tangent >= 0.0) == (camera_tangent >= 0.0))[:, None]
    share = np.where(same_side, np.minimum(lit, seen), np.maximum(0.0, lit + seen - 1.0))
    return np.asarray(np.sum(weight * share.T, axis=0) / (design.pitch_um * to_camera[:, 2]))
