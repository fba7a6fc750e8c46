"""By what a recipe is predicted: rays or waves, as its surface needs, and the reason, which goes into the record.

Nothing that is measured has a say, so that all parts of a recipe are predicted alike.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, ModelError, RecipeError
from anisoscope.prediction.etched import EtchedPredictor, WaferLight, line_spectrum, tile_of
from anisoscope.prediction.height_map_uncertainty import best_band, relief_model
from anisoscope.prediction.optics_selection import (
    Rig,
    Wanted,
    by_rays_instead,
    error_note,
    optics_for,
    optics_note,
    wave_model,
)
from anisoscope.prediction.profile_likelihood import FARTHEST
from anisoscope.prediction.relief_preparation import AXIS_TOLERANCE_DEG, prepare_relief
from anisoscope.prediction.sensitivity import Model, Shape, Surface, fixed
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.recipe.surface import LightPart, SurfaceRecipe
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import Convention, Pose, directions
from anisoscope.sim.light.material import Material
from anisoscope.sim.light.optics import POINT_LIKE, Optics, through
from anisoscope.sim.light.wave.choice import NUMERICAL_ERROR, OpticsChoice

SHOWN_UM = 64.0
"""Side of the part of a wafer that is drawn."""

AROUND_DEG = 3.0
"""Tilts of seat, arm and lamp about those of the poses that are looked at: uncertainties, and causes of a deviation."""


@dataclass(frozen=True, eq=False)
class Models:
    """What a recipe is predicted by.

    Attributes:
        model: the predictor.
        sampled: a cheaper one of the same surface, for sensitivities; of a design also of other ridge angles.
        surface: what is drawn of the height map, levelled; None for a design.
        name: "relief", "corrected" or "wave".
        optics: asked, model, reason, stated_error and the like, as `withoptics.optics_note` and `error_note` tell it.
        neglected_per_sr: what rays neglect where waves were right, in 1/sr; None where they are right themselves.
        numerical: relative error of the waves; 0 of rays.
    """

    model: Model
    sampled: Surface
    surface: HeightMap | None
    name: str
    optics: dict[str, Any]
    neglected_per_sr: float | None = None
    numerical: float = 0.0


def wafer_light(part: LightPart) -> WaferLight:
    """Lamp and lens of a recipe, for a wafer."""
    return WaferLight(
        part.wavelength_nm, part.bandwidth_nm, part.lamp_half_angle_deg, part.aperture_half_angle_deg
    )


def recipe_wafer(
    recipe: SurfaceRecipe, light_angle_deg: float, reach: float = 0.0
) -> tuple[EtchedPredictor, HeightMap]:
    """The predictor of a recipe's wafer, and its height map.

    Args:
        recipe: the recipe.
        light_angle_deg: of the rig.
        reach: frequencies in cycles per µm that are needed beyond those of the recipe (`needed_reach`).

    Raises:
        HeightMapError: the height map cannot be read, or is no surface of level steps.
        RecipeError: it is not the tile that repeats.
    """
    assert recipe.light is not None
    surface = _read(recipe)
    tile = tile_of(surface, recipe.surface.pitch_um, str(recipe.surface.height_map))
    assert recipe.material.reflectance is not None
    light, reflectance = wafer_light(recipe.light), recipe.material.reflectance
    reach = max(reach, needed_reach(recipe, light_angle_deg))
    return EtchedPredictor.of(tile, light, reflectance, reach), surface


def needed_reach(recipe: SurfaceRecipe, light_angle_deg: float) -> float:
    """Largest frequency in cycles per µm that directions near the recipe's poses need, in any state of the inputs."""
    assert recipe.light is not None
    told, lamp, light = recipe.uncertainty, recipe.light, wafer_light(recipe.light)
    turned = np.sqrt(2.0) * told.seating_tilt_deg + 0.5 * (told.light_angle_deg + told.tilt_deg)
    cones = light.lamp_half_angle_deg * (1.0 + FARTHEST * lamp.u_lamp_share)
    cones += light.aperture_half_angle_deg * (1.0 + FARTHEST * lamp.u_aperture_share)
    tilt = max(abs(angle) for angle in recipe.poses.tilts_deg)
    steepest = tilt + abs(light_angle_deg) + cones + max(AROUND_DEG, FARTHEST * turned)
    middle = max(light.wavelength_nm - FARTHEST * lamp.u_wavelength_nm, 0.5 * light.wavelength_nm)
    lines = line_spectrum(middle, light.bandwidth_nm * (1.0 + FARTHEST * lamp.u_bandwidth_share))
    return float(2.0 * np.sin(np.radians(min(steepest, 90.0))) / (0.98 * min(lines.wavelengths_um)))


def models_of(recipe: SurfaceRecipe, poses: tuple[Pose, ...], convention: Convention) -> Models:
    """Choose the optics of a recipe with one surface, and make its predictors.

    Raises:
        HeightMapError: the height map cannot be read or used, or waves are asked for by name and it is too coarse.
        RecipeError: waves are asked for by name and cannot be had, or a wafer's map is not its tile.
    """
    rig = _rig(recipe, poses, convention)
    if recipe.is_wafer:
        return _of_wafer(recipe, rig)
    if recipe.surface.design is not None:
        design = recipe.surface.ridge_design()

        def ideal(shape: Shape) -> Model:
            ridges = replace(design, ridge_angle_deg=shape.ridge_angle_deg)

            def predict(to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
                return corrected.radiance(to_light, to_camera, ridges, material)

            return through(predict, rig.optics)

        seen = ideal(Shape(design.ridge_angle_deg))
        return _chosen(recipe, design, rig, lambda: (seen, ideal, None, "corrected"))
    surface = _read(recipe)

    def by_rays() -> tuple[Model, Surface, HeightMap | None, str]:
        relief, period = prepare_relief(surface, recipe.surface.pitch_um)
        if abs(period.direction_deg) > AXIS_TOLERANCE_DEG:
            raise HeightMapError(
                f"{recipe.surface.height_map}: the ridges run {period.direction_deg:+.1f}° from the map's y axis "
                f"(limit {AXIS_TOLERANCE_DEG:g}°): turn the part on the profilometer and measure again, or turn the "
                "map there"
            )
        sampled = fixed(relief_model(best_band(relief), rig.optics))
        return relief_model(relief, rig.optics), sampled, relief.surface, "relief"

    return _chosen(recipe, surface, rig, by_rays)


def _read(recipe: SurfaceRecipe) -> HeightMap:
    table = recipe.surface
    assert table.height_map is not None
    return read_height_map(table.height_map, pixel_um=table.pixel_um, role=table.role)


def _rig(recipe: SurfaceRecipe, poses: tuple[Pose, ...], convention: Convention) -> Rig:
    part = recipe.light
    optics = POINT_LIKE
    if part is not None:
        optics = Optics(part.lamp_half_angle_deg, part.aperture_half_angle_deg)
    return Rig(recipe.material.material(), poses, convention, optics)


def _wanted(recipe: SurfaceRecipe) -> Wanted:
    part = recipe.light
    if part is None:
        return Wanted(recipe.surface.optics)
    return Wanted(recipe.surface.optics, line_spectrum(part.wavelength_nm, part.bandwidth_nm))


def _chosen(
    recipe: SurfaceRecipe,
    surface: HeightMap | RidgeDesign,
    rig: Rig,
    by_rays: Callable[[], tuple[Model, Surface, HeightMap | None, str]],
) -> Models:
    """Rays or waves for plastic; rays with a stated error where waves would be right and cannot be had."""
    wanted = _wanted(recipe)
    choice = optics_for(surface, rig, wanted)
    model, sampled, drawn, name = by_rays()
    asked = wanted.model
    wave = asked == "wave" or (asked == "auto" and choice is not None and choice.model == "wave")
    if wave:
        try:
            stepped = choice is not None and choice.stepped
            found = wave_model(surface, rig, wanted, stepped, recipe.surface.pitch_um)
            found(*directions(rig.poses, rig.convention), rig.material)
        except (HeightMapError, ModelError) as problem:
            if asked == "wave" or choice is None:
                raise RecipeError(f'surface.optics: waves cannot be had: {problem}; or take "auto"') from None
            choice = by_rays_instead(choice, problem)
        else:
            turned = _turned(surface, found, rig, wanted)
            return Models(
                found, turned, drawn, "wave", _notes(choice, rig, wanted), numerical=NUMERICAL_ERROR
            )
    elif choice is not None and choice.model == "wave":
        choice = by_rays_instead(choice, "rays are asked for")
    else:
        return Models(model, sampled, drawn, name, _notes(choice, rig, wanted))
    notes = _notes(choice, rig, wanted)
    return Models(model, sampled, drawn, name, notes, neglected_per_sr=notes["stated_error_per_sr"])


def _turned(surface: HeightMap | RidgeDesign, found: Model, rig: Rig, wanted: Wanted) -> Surface:
    """The waves of a surface as it is, and of a design of other ridge angles."""

    def shaped(shape: Shape) -> Model:
        if not isinstance(surface, RidgeDesign) or shape.ridge_angle_deg == surface.ridge_angle_deg:
            return found
        return wave_model(replace(surface, ridge_angle_deg=shape.ridge_angle_deg), rig, wanted, stepped=False)

    return shaped


def _of_wafer(recipe: SurfaceRecipe, rig: Rig) -> Models:
    found, surface = recipe_wafer(recipe, rig.convention.light_angle_deg)
    wanted = _wanted(recipe)
    notes = _notes(optics_for(surface, rig, wanted), rig, wanted)
    notes |= {
        "model": "wave",
        "stated_error": NUMERICAL_ERROR,
        "reason": f"{notes['reason']} (a mirror with steps: diffraction orders of the tile)",
    }
    points = int(SHOWN_UM / surface.pixel_x_um)
    drawn = surface.with_height(surface.height_um[:points, :points])
    return Models(found, fixed(found), drawn, "wave", notes, numerical=NUMERICAL_ERROR)


def _notes(choice: OpticsChoice | None, rig: Rig, wanted: Wanted) -> dict[str, Any]:
    return optics_note(choice, wanted) | error_note(choice, rig, wanted)


def light_steps(part: LightPart) -> tuple[tuple[str, str, float], ...]:
    """Name, field of `WaferLight` and standard uncertainty of everything that is uncertain of lamp and lens."""
    light = wafer_light(part)
    steps = (
        ("wavelength of the lamp", "wavelength_nm", part.u_wavelength_nm),
        ("bandwidth of the lamp", "bandwidth_nm", part.u_bandwidth_share * light.bandwidth_nm),
        ("size of the lamp", "lamp_half_angle_deg", part.u_lamp_share * light.lamp_half_angle_deg),
        (
            "aperture of the lens",
            "aperture_half_angle_deg",
            part.u_aperture_share * light.aperture_half_angle_deg,
        ),
    )
    return tuple(step for step in steps if step[2] > 0.0)


def moved_light(part: LightPart, light: WaferLight) -> tuple[tuple[str, WaferLight, WaferLight], ...]:
    """Name, and lamp and lens one standard uncertainty below and above, of everything that is uncertain of them."""
    return tuple(
        (
            name,
            replace(light, **{field: getattr(light, field) - u}),
            replace(light, **{field: getattr(light, field) + u}),
        )
        for name, field, u in light_steps(part)
    )
