"""Direct light from ridges whose crests are rounded: the corrected model on a polyline.

A ball of the edge radius rolls inside the material along the profile, and material beyond its reach is missing: melt
does not fill the sharp bottom of a groove of the tool, where the crest of the part forms; the feet of the part are
copied from cut edges and stay sharp. Height loss cuts that profile at its height. Visibility of every segment is
exact (`sim.light.corrected`). With a radius of 0 this is the corrected model.
"""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.sim.light.material import Material, facet_brdf
from anisoscope.sim.light.ridge_profile import ridge_polyline, visible_shares

ARC_SEGMENTS = 24
TABLES_PER_E_FOLD = 8  # interface tables; between two of them the radiance is interpolated


@dataclass(frozen=True)
class _Tabulated(Material):
    """A plastic whose rough interface is that of another mean roughness."""

    interface_alpha: float = 0.1

    @property
    def alpha_mean(self) -> float:
        return self.interface_alpha


def rounded_polyline(design: RidgeDesign, edge_radius_um: float) -> tuple[FloatArray, FloatArray]:
    """One period of the profile, foot to foot: wall, crest arc, facet; truncated by the lost height.

    Args:
        design: the ridges.
        edge_radius_um: radius of the crest.

    Returns:
        x, z in µm, both (K + 1,), x not falling; the last point is the first one shifted by the pitch.

    Raises:
        ModelError: a negative radius, or one so large that no facet is left.
    """
    if not (edge_radius_um >= 0.0 and np.isfinite(edge_radius_um)):
        raise ModelError(f"the edge radius must be 0 µm or more, not {edge_radius_um:g}")
    if edge_radius_um == 0.0 or design.full_height_um == 0.0:
        return ridge_polyline(design)
    x, z = _rounded_crest(design, edge_radius_um)
    return _cut(x, z, design.height_um)


def _rounded_crest(design: RidgeDesign, radius: float) -> tuple[FloatArray, FloatArray]:
    """Foot at x = −wall width, crest at x = 0, next foot at the facet width."""
    angle = np.radians(design.ridge_angle_deg)
    down = np.array([np.cos(angle), -np.sin(angle)])  # along the facet, from the crest
    inward = np.array([-np.sin(angle), -np.cos(angle)])
    foot = np.array([-design.wall_width_um, -design.full_height_um])
    wall = float(np.hypot(*foot))
    length = design.facet_width_um / np.cos(angle)
    corner = float(np.arccos(np.clip(down @ foot / wall, -1.0, 1.0)))  # inner angle at the crest
    reach = radius / np.tan(0.5 * corner)  # distance of the tangent points from the crest
    at_foot = reach > wall  # the ball no longer touches the wall, only its foot
    if at_foot:
        along, deep = float(foot @ down), float(foot @ inward)
        reach = along + np.sqrt(radius**2 - (radius - deep) ** 2)
    if reach >= length:
        raise ModelError(
            f"an edge radius of {radius:g} µm leaves no facet at a pitch of {design.pitch_um:g} µm and a ridge angle "
            f"of {design.ridge_angle_deg:g}°"
        )
    centre = reach * down + radius * inward
    touch = foot if at_foot else foot / wall * reach
    from_centre, to_centre = touch - centre, reach * down - centre
    first, last = np.arctan2(from_centre[1], from_centre[0]), np.arctan2(to_centre[1], to_centre[0])
    turn = np.linspace(first, last, ARC_SEGMENTS + 1)
    # vertices outside the arc by half the sagitta keep the area beneath it
    stretch = 1.0 + (turn[1] - turn[0]) ** 2 / 12.0
    factor = np.r_[1.0, np.full(ARC_SEGMENTS - 1, stretch), 1.0]
    arc = centre + radius * factor[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    end = foot + np.array([design.pitch_um, 0.0])
    points = np.vstack([foot, arc[1:] if at_foot else arc, end])
    points[:, 0] = np.maximum.accumulate(points[:, 0])
    return points[:, 0], points[:, 1] + design.full_height_um


def _cut(x: FloatArray, z: FloatArray, height: float) -> tuple[FloatArray, FloatArray]:
    """The profile cut by a plane at a height; it rises to one crest and falls."""
    if z.max() <= height:
        return x, z
    above = np.flatnonzero(z > height)
    left, right = above[0], above[-1]

    def crossing(i: int, j: int) -> float:
        return float(x[i] + (x[j] - x[i]) * (height - z[i]) / (z[j] - z[i]))

    ends = [crossing(left - 1, left), crossing(right + 1, right)]
    return (
        np.concatenate([x[:left], ends, x[right + 1 :]]),
        np.concatenate([z[:left], [height, height], z[right + 1 :]]),
    )


@dataclass(frozen=True, eq=False)
class _Lighting:
    """Orientation of S segments of a profile to P poses; directions (S, P, 3) are along, across and normal."""

    to_light: FloatArray
    to_camera: FloatArray
    weight: FloatArray

    def radiance(self, material: Material) -> FloatArray:
        """(P,) in 1/sr."""
        along, across, normal = np.eye(3)
        brdf = facet_brdf(self.to_light, self.to_camera, along, across, normal, material)
        return np.asarray((brdf * self.weight).sum(axis=0))


def _lighting(to_light: FloatArray, to_camera: FloatArray, x: FloatArray, z: FloatArray) -> _Lighting:
    size = np.hypot(np.diff(x), np.diff(z))
    nonzero = size > 0.0
    size = size[nonzero, None]
    flat, up = np.diff(x)[nonzero, None] / size, np.diff(z)[nonzero, None] / size

    def local(directions: FloatArray) -> FloatArray:
        ux, uy, uz = directions.T
        parts = np.broadcast_arrays(uy, flat * ux + up * uz, flat * uz - up * ux)
        return np.stack(parts, axis=-1)

    light, camera = local(to_light), local(to_camera)
    light_tangent, camera_tangent = to_light[:, 0] / to_light[:, 2], to_camera[:, 0] / to_camera[:, 2]
    lit = np.stack([visible_shares(x, z, t)[nonzero] for t in light_tangent], axis=-1)
    visible = np.stack([visible_shares(x, z, t)[nonzero] for t in camera_tangent], axis=-1)
    same = (light_tangent >= 0) == (camera_tangent >= 0)
    share = np.where(same, np.minimum(lit, visible), np.maximum(0.0, lit + visible - 1.0))
    cosines = np.maximum(light[..., 2], 0.0) * np.maximum(camera[..., 2], 0.0)
    return _Lighting(light, camera, share * cosines * size / ((x[-1] - x[0]) * to_camera[:, 2]))


def ridge_radiance(
    to_light: FloatArray,
    to_camera: FloatArray,
    design: RidgeDesign,
    edge_radius_um: float,
    material: Material,
) -> FloatArray:
    """Direct radiance [1/sr] per unit irradiance perpendicular to the beam, (P,).

    The transmittance of the rough interface is tabulated for few mean roughnesses: radiances of the two next to
    the one asked for are interpolated in its logarithm. That makes thousands of materials cheap, and the radiance
    a continuous function of the roughness; the error is below 10⁻⁴ of the radiance.

    Args:
        to_light: (P, 3) unit vectors in the sample frame, above the horizon.
        to_camera: (P, 3) unit vectors in the sample frame, above the horizon.
        design: the ridges.
        edge_radius_um: radius of the crest; 0 is sharp.
        material: the plastic.

    Raises:
        ModelError: a radius that leaves no facet.
    """
    lighting = _lighting(to_light, to_camera, *rounded_polyline(design, edge_radius_um))
    place = np.log(material.alpha_mean) * TABLES_PER_E_FOLD
    low = float(np.floor(place))
    total = np.zeros(len(to_light))
    for number, weight in ((low, 1.0 - (place - low)), (low + 1.0, place - low)):
        plastic = _Tabulated(
            material.alpha_along,
            material.alpha_across,
            material.albedo,
            material.index,
            material.internal_reflection,
            material.tail,
            material.second_lobe,
            interface_alpha=float(np.exp(number / TABLES_PER_E_FOLD)),
        )
        if weight > 0.0:
            total += weight * lighting.radiance(plastic)
    return total
