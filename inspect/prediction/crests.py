"""Radius and form of the crests of ridges: what they change of ln L, by rays.

A radius of 0.5 µm changes L of 10° ridges by 1 % at 180°, where little other light goes, and its form by more: one of a
few chords may stand in the mirror direction. Where the radius is unmeasured the crests are predicted sharp, which is
one end of what they may be.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.inputs import USUAL_EDGE_SHARE
from anisoscope.parameters.material import Material
from anisoscope.parameters.optics import POINT_LIKE, Optics
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.reflections import added, groove_of_design
from anisoscope.prediction.sensitivity import DARK, Model
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.optics import through
from anisoscope.sim.light.ridge_profile import ridge_polyline

EDGE_RADIUS, EDGE_FORM = "edge radius", "form of the edge"
UNMEASURED_UM = 1.0
"""Largest radius of a crest that was not measured; as likely as any smaller one."""
MOST_OF_WALL = 0.25
"""The same of fine ridges, as a share of the length of their walls."""
CHORDS = range(1, 7)
"""Numbers of chords that stand for crests of any form."""


@dataclass(frozen=True, eq=False)
class CrestEdges:
    """What the crests of a design change of ln L of P poses.

    Attributes:
        per_um: (P,) change per µm of radius.
        u_um: standard uncertainty of the radius.
        scatter_um: standard deviation of the radius between parts.
        form: (P,) what chords change in place of an arc: rms over `CHORDS`.
    """

    per_um: FloatArray
    u_um: float
    scatter_um: float
    form: FloatArray


def model_of_crests(
    design: RidgeDesign, bounces: int | None, optics: Optics, chords: int | None = None
) -> Model:
    """Predictor of a design by rays, with two reflections at most.

    ``chords``: so many equal chords in place of the arc of its crests.
    """
    groove = groove_of_design(design, 1 if bounces == 1 else 2)

    def direct(to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
        if chords is None:
            return corrected.radiance(to_light, to_camera, design, material, bounces=1)
        profile = ridge_polyline(design, chords)
        return corrected.radiance_of_profile(to_light, to_camera, profile, design, material, bounces=1)

    return through(added(direct, None if groove is None else groove.light), optics)


def edges_of_design(
    design: RidgeDesign,
    material: Material,
    poses: tuple[Pose, ...],
    convention: Convention,
    optics: Optics = POINT_LIKE,
    bounces: int | None = None,
    u_share: float = USUAL_EDGE_SHARE,
    form: Literal["any", "arc"] = "any",
    scatter_share: float = 0.0,
) -> CrestEdges | None:
    """Changes of ln L by the crests of a design; without a radius they are unmeasured.

    Args:
        design: the ridges.
        material: the plastic.
        poses: P poses.
        convention: how the angles are counted.
        optics: lamp and lens.
        bounces: 1 for direct light.
        u_share: relative standard uncertainty of a stated radius.
        form: whether the crests are arcs.
        scatter_share: relative standard deviation of the radius between parts.

    Returns:
        None on flat parts, and where height is lost, so that there is no crest.
    """
    if design.full_height_um == 0.0 or design.height_loss > 0.0:
        return None
    sides = directions(poses, convention)

    def logarithm(radius_um: float, chords: int | None = None) -> FloatArray:
        model = model_of_crests(replace(design, edge_radius_um=radius_um), bounces, optics, chords)
        return np.asarray(np.log(np.maximum(model(*sides, material), DARK)))

    if design.edge_radius_um == 0.0:
        reach = min(UNMEASURED_UM, MOST_OF_WALL * design.wall_length_um)
        low, high, typical = 0.0, reach, 0.5 * reach
        u_um = reach / np.sqrt(3.0)  # about the sharp end of a rectangle
        if design.foot_radius_um + reach > design.arcs_um:  # a foot that leaves no wall: as above a sharp one
            design = replace(design, foot_radius_um=0.0)
    else:
        typical = design.edge_radius_um
        step = u_share or 0.1
        low, high, u_um = typical * (1.0 - step), typical * (1.0 + step), u_share * typical
        try:
            replace(design, edge_radius_um=high)
        except HeightMapError:  # more leaves no facet: the slope is that of less
            high = typical
    per_um = (logarithm(high) - logarithm(low)) / (high - low)
    change = np.zeros_like(per_um)
    if form == "any":
        arc = logarithm(typical)
        change = np.sqrt(np.mean([(logarithm(typical, chords) - arc) ** 2 for chords in CHORDS], axis=0))
    return CrestEdges(per_um, float(u_um), scatter_share * typical, change)
