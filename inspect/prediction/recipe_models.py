"""Predictors of a recipe: ray or wave optics as its surface needs, with the reason, which enters the record.

The choice is independent of the measurement, so that all parts of a recipe share a prediction.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, ModelError, RecipeError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.light import LightSpectrum
from anisoscope.parameters.material import Material
from anisoscope.parameters.optics import POINT_LIKE, Optics
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.height_map_uncertainty import best_band, relief_model
from anisoscope.prediction.optics_selection import (
    OpticsRequest,
    Rig,
    by_rays_instead,
    design_by_rays,
    error_note,
    optics_for,
    optics_note,
    wave_model,
)
from anisoscope.prediction.reflections import (
    Followed,
    Groove,
    added,
    groove_of_design,
    reflections_note,
    reflections_of_map,
    sampled_with,
)
from anisoscope.prediction.relief_preparation import prepare_relief
from anisoscope.prediction.ridge_edges import RidgeEdges, check_one_direction, ridge_edges
from anisoscope.prediction.sensitivity import Model, Shape, Surface, fixed
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.optics import through
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.unresolved import Resolved, resolve
from anisoscope.sim.light.wave.choice import NUMERICAL_ERROR, OpticsChoice


@dataclass(frozen=True, eq=False)
class Models:
    """Predictors of a recipe.

    Attributes:
        model: the predictor.
        sampled: a cheaper one of the same surface, for sensitivities; of a design also of other ridge angles.
        rays: the same by rays, for lobes that waves do not know; None where it is ``sampled``.
        surface: the levelled height map for the drawings; None for a design.
        name: "relief", "corrected" or "wave".
        optics: asked, model, reason, stated_error and the like, from `optics_selection.optics_note` and `error_note`.
        neglected_per_sr: error of rays where waves apply, in 1/sr; None where rays are adequate.
        numerical: relative error of the waves; 0 of rays.
        indirect: the part of the predictor that reflects twice and more, always by rays; None for direct light alone.
        turn_deg: azimuth on ``surface`` of the sample frame's x axis.
        edges: profile of walls and crests fitted to a height map; None where there is none.
    """

    model: Model
    sampled: Surface
    surface: HeightMap | None
    name: str
    optics: dict[str, Any]
    neglected_per_sr: float | None = None
    numerical: float = 0.0
    indirect: Model | None = None
    turn_deg: float = 0.0
    rays: Surface | None = None
    edges: RidgeEdges | None = None


def models_of(recipe: SurfaceRecipe, poses: tuple[Pose, ...], convention: Convention) -> Models:
    """Choose the optics of a plastic surface, and make its predictors.

    Raises:
        HeightMapError: the height map cannot be read or used, or is too coarse for waves requested by name.
        RecipeError: waves are requested by name and unavailable.
    """
    rig = rig_of(recipe, poses, convention)
    if recipe.surface.design is not None:
        design = recipe.surface.ridge_design()

        ideal = design_by_rays(design, rig)
        predictor = ideal(Shape(design.ridge_angle_deg))
        direct = _chosen(recipe, design, rig, lambda: (predictor, ideal, None, "corrected"))
        return with_reflections(direct, groove_of_design(design, recipe.surface.bounces), rig)
    surface = read_surface(recipe)

    relief, period = prepare_relief(surface, recipe.surface.pitch_um)
    check_one_direction(relief, period, rig.material)
    if recipe.surface.roughness == "plastic":
        resolved = resolve(relief)
        found = _of_map(in_lobes(recipe), surface, relief, replace(rig, material=resolved.lobe(rig.material)))
        return _of_plastic(found, resolved)
    return _of_map(recipe, surface, relief, rig)


def in_lobes(recipe: SurfaceRecipe) -> SurfaceRecipe:
    """The recipe by rays, whose material is the lobe of the facets."""
    surface = recipe.surface.model_copy(update={"roughness": "lobe", "optics": "geometric"})
    return recipe.model_copy(update={"surface": surface})


def _of_plastic(models: Models, resolved: Resolved) -> Models:
    """Predictors that take the roughness of the whole plastic, from those that take the lobe's."""

    def whole(model: Model) -> Model:
        def predict(to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
            return model(to_light, to_camera, resolved.lobe(material))

        return predict

    indirect = None if models.indirect is None else whole(models.indirect)
    notes = {"resolved_alpha_along": resolved.along, "resolved_alpha_across": resolved.across}
    return replace(
        models,
        model=whole(models.model),
        sampled=lambda shape: whole(models.sampled(shape)),
        indirect=indirect,
        optics=models.optics | notes,
        edges=None if models.edges is None else replace(models.edges, resolved=(0.0, 0.0)),
    )


def lobe_on(relief: Relief, recipe: SurfaceRecipe) -> Material:
    """The material of a recipe as the lobe of the facets of a height map."""
    material = recipe.material.material()
    return resolve(relief).lobe(material) if recipe.surface.roughness == "plastic" else material


def _of_map(recipe: SurfaceRecipe, surface: HeightMap, relief: Relief, rig: Rig) -> Models:
    """Predictors of a height map whose facets have the material's lobe."""
    edges = ridge_edges(relief) if recipe.surface.walls == "fitted" else None

    def by_rays() -> tuple[Model, Surface, HeightMap | None, str]:
        sampled = fixed(relief_model(best_band(relief), rig.optics))
        return relief_model(relief, rig.optics, edges=edges), sampled, relief.surface, "relief"

    direct = replace(_chosen(recipe, surface, rig, by_rays), turn_deg=relief.turn_deg, edges=edges)
    if recipe.surface.bounces == 1:
        return direct
    return with_reflections(direct, reflections_of_map(relief, recipe.surface.bounces, edges), rig)


def with_reflections(direct: Models, source: Groove | Followed | None, rig: Rig) -> Models:
    """Predictors with the light that reflects twice and more, added to direct light.

    The ridge angle of a design is also that of its groove.
    """
    optics = direct.optics | reflections_note(source)
    if source is None:
        return replace(direct, optics=optics)
    indirect = through(source.light, rig.optics)
    model = added(direct.model, indirect)

    def groove_of(shape: Shape) -> Groove:
        assert isinstance(source, Groove)
        return source if direct.surface is not None else source.turned(shape.ridge_angle_deg)

    nominal = *directions(rig.poses, rig.convention), rig.material

    def cheap(surface: Surface) -> Surface:
        return sampled_with(surface, source, nominal, rig.optics, groove_of)

    rays = None if direct.rays is None else cheap(direct.rays)
    return replace(
        direct, model=model, sampled=cheap(direct.sampled), optics=optics, indirect=indirect, rays=rays
    )


def read_surface(recipe: SurfaceRecipe) -> HeightMap:
    """The height map that a recipe names.

    Raises:
        HeightMapError: it cannot be read.
    """
    table = recipe.surface
    assert table.height_map is not None
    return read_height_map(table.height_map, pixel_um=table.pixel_um, role=table.role)


@lru_cache(maxsize=256)
def line_spectrum(wavelength_nm: float, bandwidth_nm: float) -> LightSpectrum:
    """Spectrum of a lamp; a single line for a width of 0."""
    if bandwidth_nm == 0.0:
        return LightSpectrum((1e-3 * wavelength_nm,))
    return LightSpectrum.led(wavelength_nm, bandwidth_nm, count=3)


def rig_of(recipe: SurfaceRecipe, poses: tuple[Pose, ...], convention: Convention) -> Rig:
    """Material, poses, and sizes of lamp and lens, on which the choice of optics depends."""
    part = recipe.light
    optics = POINT_LIKE
    if part is not None:
        optics = Optics(part.lamp_half_angle_deg, part.aperture_half_angle_deg)
    return Rig(recipe.material.material(), poses, convention, optics)


def optics_request_of(recipe: SurfaceRecipe) -> OpticsRequest:
    """Requested optics of a recipe, with its lamp."""
    part = recipe.light
    if part is None:
        return OpticsRequest(recipe.surface.optics)
    return OpticsRequest(recipe.surface.optics, line_spectrum(part.wavelength_nm, part.bandwidth_nm))


def _chosen(
    recipe: SurfaceRecipe,
    surface: HeightMap | RidgeDesign,
    rig: Rig,
    by_rays: Callable[[], tuple[Model, Surface, HeightMap | None, str]],
) -> Models:
    """Rays or waves for plastic; rays with a stated error where waves apply but are unavailable."""
    request = optics_request_of(recipe)
    choice = optics_for(surface, rig, request)
    model, sampled, drawn, name = by_rays()
    requested = request.model
    wave = requested == "wave" or (requested == "auto" and choice is not None and choice.model == "wave")
    if wave:
        try:
            found = wave_model(surface, rig, request, recipe.surface.pitch_um)
            found(*directions(rig.poses, rig.convention), rig.material)
        except (HeightMapError, ModelError) as problem:
            if requested == "wave" or choice is None:
                raise RecipeError(f'surface.optics: waves cannot be had: {problem}; or take "auto"') from None
            choice = by_rays_instead(choice, problem)
        else:
            turned = _turned(surface, found, rig, request)
            notes = optics_notes(choice, rig, request)
            return Models(found, turned, drawn, "wave", notes, numerical=NUMERICAL_ERROR, rays=sampled)
    elif choice is not None and choice.model == "wave":
        choice = by_rays_instead(choice, "rays are asked for")
    else:
        return Models(model, sampled, drawn, name, optics_notes(choice, rig, request))
    notes = optics_notes(choice, rig, request)
    return Models(model, sampled, drawn, name, notes, neglected_per_sr=notes["stated_error_per_sr"])


def _turned(surface: HeightMap | RidgeDesign, found: Model, rig: Rig, request: OpticsRequest) -> Surface:
    """Wave predictors of the surface, and of a design with other ridge angles."""

    def shaped(shape: Shape) -> Model:
        if not isinstance(surface, RidgeDesign) or shape.ridge_angle_deg == surface.ridge_angle_deg:
            return found
        return wave_model(replace(surface, ridge_angle_deg=shape.ridge_angle_deg), rig, request)

    return shaped


def optics_notes(choice: OpticsChoice | None, rig: Rig, request: OpticsRequest) -> dict[str, Any]:
    """Notes of a record on the choice of optics."""
    return optics_note(choice, request) | error_note(choice, rig, request)
