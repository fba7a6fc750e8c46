"""Radius and form of the crests of a design: what they change of ln L, by rays.

A radius of 0.5 µm changes L of 10° ridges by 1 % at 180°, where little other light goes, and its form by more: one of a
few chords may stand in the mirror direction. Where the radius is unmeasured the crests are predicted sharp, which is
one end of what they may be.
"""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.prediction.recipe_models import rig_of
from anisoscope.prediction.reflections import added, groove_of_design
from anisoscope.prediction.sensitivity import DARK, Model
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.optics import through
from anisoscope.sim.light.ridge_profile import chord_polyline

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


def edge_radius_model(
    recipe: SurfaceRecipe, edge_radius_um: float, convention: Convention, chords: int | None = None
) -> Model:
    """Predictor of a design whose crests have another radius: by rays, with two reflections at most.

    Args:
        recipe: of the design.
        edge_radius_um: the radius.
        convention: how the angles are counted.
        chords: so many equal chords of the arc in its place; None: the arc.

    Raises:
        HeightMapError: the radius leaves no facet.
    """
    design = recipe.surface.ridge_design(edge_radius_um)
    groove = groove_of_design(design, 1 if recipe.surface.bounces == 1 else 2)

    def direct(to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
        if chords is None:
            return corrected.radiance(to_light, to_camera, design, material, bounces=1)
        profile = chord_polyline(design, chords)
        return corrected.radiance_of_profile(to_light, to_camera, profile, design, material, bounces=1)

    rig = rig_of(recipe, recipe.poses.poses(), convention)
    return through(added(direct, None if groove is None else groove.light), rig.optics)


def crest_edges(recipe: SurfaceRecipe, material: Material, convention: Convention) -> CrestEdges | None:
    """Changes of ln L by the crests of a design.

    Args:
        recipe: of the design.
        material: the plastic.
        convention: how the angles are counted.

    Returns:
        None where there is no design, where its crests are known to be sharp, and on flat parts.
    """
    part = recipe.surface.design
    if part is None or part.edge_radius_um == 0.0:
        return None
    sharp, sides = recipe.surface.ridge_design(0.0), directions(recipe.poses.poses(), convention)
    if sharp.full_height_um == 0.0:
        return None

    def logarithm(radius_um: float, chords: int | None = None) -> FloatArray:
        model = edge_radius_model(recipe, radius_um, convention, chords)
        return np.asarray(np.log(np.maximum(model(*sides, material), DARK)))

    if part.edge_radius_um is None:
        reach = min(UNMEASURED_UM, MOST_OF_WALL * sharp.wall_length_um)
        low, high, typical, u_um = (
            0.0,
            reach,
            0.5 * reach,
            reach / np.sqrt(3.0),
        )  # about the sharp end of a rectangle
    else:
        typical, share = part.edge_radius_um, part.u_edge_radius_share
        step = share or 0.1
        low, high, u_um = typical * (1.0 - step), typical * (1.0 + step), share * typical
    per_um = (logarithm(high) - logarithm(low)) / (high - low)
    form = np.zeros_like(per_um)
    if part.edge_form == "any":
        arc = logarithm(typical)
        form = np.sqrt(np.mean([(logarithm(typical, chords) - arc) ** 2 for chords in CHORDS], axis=0))
    return CrestEdges(per_um, float(u_um), recipe.stated_scatter.edge_radius_share * typical, form)


def worn_edges(
    recipe: SurfaceRecipe,
    material: Material,
    poses: tuple[Pose, ...],
    convention: Convention,
    radius_um: float,
) -> FloatArray | None:
    """(P,) change of ln L of a design whose crests are worn to a radius; None where it is none, or leaves no facet."""
    design = recipe.surface.design
    if design is None or radius_um <= (design.edge_radius_um or 0.0):
        return None
    sides = directions(poses, convention)
    try:
        good, worn = (
            edge_radius_model(recipe, edge, convention)(*sides, material)
            for edge in (design.edge_radius_um or 0.0, radius_um)
        )
    except HeightMapError:  # the radius leaves no facet
        return None
    return np.asarray(np.log(np.maximum(worn, DARK) / np.maximum(good, DARK)))
