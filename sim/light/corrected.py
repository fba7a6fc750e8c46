"""The corrected ridge model: rough plastic on facet, wall and crest, with exact visibility of the ridge profile.

Visible shares come from `ridge_profile`; light that reflects more than once is added by `bounces`. It comes from the
sharp groove: L = L_direct(true profile) + [L_all − L_direct](groove with facet and wall shortened as the crest is). The
two are added, because the groove's share of indirect light is not that of a profile with another crest.
"""

from functools import lru_cache

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light.bounces import interreflection
from anisoscope.sim.light.material import facet_brdf, oren_nayar
from anisoscope.sim.light.ridge_profile import (
    Outline,
    outline_of,
    ridge_outline,
    sharp_groove,
    visible_shares,
)

CHORDS_PER_ALPHA = 0.8  # of a rounded crest, over the narrowest lobe
NARROWEST_CHORD = 0.005


def radiance(
    to_light: FloatArray,
    to_camera: FloatArray,
    design: RidgeDesign,
    material: Material,
    bounces: int | None = 1,
    matte_deg: float | None = None,
) -> FloatArray:
    """Radiance [1/sr] of the ridged surface per unit irradiance perpendicular to the beam.

    Direct light: L = Σ_j A_j V_j f_j cos_i,j cos_o,j / (A_macro · ω_o·n) over the facet, the wall, with height loss the
    plateau, and the normals of a rounded crest; A_j the true area, V_j the share both lit and seen.

    Args:
        to_light: (P, 3) unit vectors in the sample frame, above the horizon.
        to_camera: (P, 3) unit vectors in the sample frame, above the horizon.
        design: the ridges.
        material: the plastic.
        bounces: largest number of reflections that is counted: 1 is direct light, None counts all
            (`indirect_radiance`).
        matte_deg: roughness of facets that are matte (`oren_nayar`), of which only the albedo is the plastic's; None:
            they are the plastic. What reflects more than once takes the plastic as it is.

    Returns:
        (P,) radiances.

    Raises:
        ModelError: fewer than one reflection.
    """
    direct = _direct_radiance(to_light, to_camera, outline_for(design, material), material, matte_deg)
    if bounces == 1:
        return direct
    return direct + indirect_radiance(to_light, to_camera, design, material, bounces)


def outline_for(design: RidgeDesign, material: Material) -> Outline:
    """The outline of ridges, arcs in chords that are fine enough for the lobe of the plastic."""
    if design.edge_radius_um == design.foot_radius_um == 0.0:
        return _outline(design)
    return _outline(design, max(material.narrowest_alpha / CHORDS_PER_ALPHA, NARROWEST_CHORD))


_outline = lru_cache(maxsize=8)(ridge_outline)  # fits ask for one design again and again


def indirect_radiance(
    to_light: FloatArray,
    to_camera: FloatArray,
    design: RidgeDesign,
    material: Material,
    bounces: int | None = None,
) -> FloatArray:
    """Light of ridges that reflects two to ``bounces`` times, as `radiance` adds it; arguments as there.

    Crests may be cut (``height_loss``) or rounded (``edge_radius_um``): facet and wall of the groove are then shorter.
    It is also what reflections add to the direct light of a map of such ridges.
    """
    return interreflection(to_light, to_camera, sharp_groove(design), material, bounces)


def radiance_of_profile(
    to_light: FloatArray,
    to_camera: FloatArray,
    profile_um: tuple[FloatArray, FloatArray],
    design: RidgeDesign,
    material: Material,
    bounces: int | None = None,
) -> FloatArray:
    """Radiance [1/sr] of ridges of any profile, whose groove is nearly that of a design.

    Args:
        to_light: (P, 3) unit vectors in the sample frame, above the horizon.
        to_camera: (P, 3) unit vectors in the sample frame, above the horizon.
        profile_um: x and z, both (K + 1,), of one period; x does not fall, the last point is the first one shifted by
            the period. Every segment is a facet.
        design: ridges whose groove reflects as this one does, with the height that is lost or the radius of the crest.
        material: the plastic.
        bounces: largest number of reflections; None counts all.

    Returns:
        (P,) radiances.

    Raises:
        ModelError: fewer than one reflection.
    """
    direct = _direct_radiance(to_light, to_camera, outline_of(*profile_um), material)
    return direct + indirect_radiance(to_light, to_camera, design, material, bounces)


def _direct_radiance(
    to_light: FloatArray,
    to_camera: FloatArray,
    outline: Outline,
    material: Material,
    matte_deg: float | None = None,
) -> FloatArray:
    """(P,) radiance [1/sr] of light that reflects once."""
    x, z = outline.x_um, outline.z_um
    flat, up = outline.normal[:, 1, None], -outline.normal[:, 0, None]

    def local(directions: FloatArray) -> FloatArray:
        ux, uy, uz = directions.T
        return np.stack(np.broadcast_arrays(uy, -flat * ux - up * uz, flat * uz - up * ux), axis=-1)

    light, camera = local(to_light), local(to_camera)  # (N, P, 3): along, across, normal
    e_along, e_across, e_normal = np.eye(3)
    if matte_deg is None:
        brdf = facet_brdf(light, camera, e_along, e_across, e_normal, material)
    else:
        brdf = oren_nayar(light, camera, e_normal, material.albedo, matte_deg)
    cosines = np.maximum(light[..., 2], 0.0) * np.maximum(camera[..., 2], 0.0)
    weight = brdf * cosines * outline.length_um[:, None]
    light_tangent, camera_tangent = to_light[:, 0] / to_light[:, 2], to_camera[:, 0] / to_camera[:, 2]
    lit, seen = np.split(visible_shares(x, z, np.concatenate([light_tangent, camera_tangent])), 2)
    same_side = ((light_tangent >= 0.0) == (camera_tangent >= 0.0))[:, None]
    share = np.where(same_side, np.minimum(lit, seen), np.maximum(0.0, lit + seen - 1.0))
    total = np.sum(weight * share.T[outline.segment], axis=0)
    return np.asarray(total / ((x[-1] - x[0]) * to_camera[:, 2]))
