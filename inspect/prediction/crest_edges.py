"""Crests of the design of a recipe (`prediction.crests`)."""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.prediction.crests import CrestEdges, edges_of_design, model_of_crests
from anisoscope.prediction.recipe_models import rig_of
from anisoscope.prediction.sensitivity import DARK, Model
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.sim.light.geometry import directions


def edge_radius_model(recipe: SurfaceRecipe, edge_radius_um: float, convention: Convention) -> Model:
    """Predictor of a recipe's design whose crests have another radius: by rays, with two reflections at most.

    Args:
        recipe: of the design.
        edge_radius_um: the radius.
        convention: how the angles are counted.

    Raises:
        HeightMapError: the radius leaves no facet.
    """
    rig = rig_of(recipe, recipe.poses.poses(), convention)
    return model_of_crests(recipe.surface.ridge_design(edge_radius_um), recipe.surface.bounces, rig.optics)


def crest_edges(recipe: SurfaceRecipe, material: Material, convention: Convention) -> CrestEdges | None:
    """Changes of ln L by the crests of a recipe's design.

    Args:
        recipe: of the design.
        material: the plastic.
        convention: how the angles are counted.

    Returns:
        None where there is no design, where its crests are known to be sharp, and on flat parts.
    """
    part, poses = recipe.surface.design, recipe.poses.poses()
    if part is None or part.edge_radius_um == 0.0:
        return None
    return edges_of_design(
        recipe.surface.ridge_design(),
        material,
        poses,
        convention,
        rig_of(recipe, poses, convention).optics,
        recipe.surface.bounces,
        part.u_edge_radius_share,
        part.edge_form,
        recipe.stated_scatter.edge_radius_share,
    )


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
