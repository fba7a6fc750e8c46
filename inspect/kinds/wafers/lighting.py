"""The predictor of a recipe's wafer under its lamp and lens, and what is uncertain of these."""

from dataclasses import replace

import numpy as np

from anisoscope.kinds.wafers.etched import EtchedPredictor, WaferLight, tile_of
from anisoscope.kinds.wafers.recipe import WaferRecipe, read_tile
from anisoscope.prediction.profile_likelihood import FARTHEST
from anisoscope.prediction.recipe_models import line_spectrum
from anisoscope.profiles.etching import Etched
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.surface import LightPart

AROUND_DEG = 3.0
"""Tilts of seat, arm and lamp about those of the poses that are looked at: uncertainties, and causes of a deviation."""


def wafer_light(part: LightPart) -> WaferLight:
    """Lamp and lens of a recipe, for a wafer."""
    return WaferLight(
        part.wavelength_nm, part.bandwidth_nm, part.lamp_half_angle_deg, part.aperture_half_angle_deg
    )


def recipe_wafer(
    recipe: WaferRecipe, light_angle_deg: float, reach: float = 0.0
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
    tile, surface = recipe_tile(recipe)
    light, reflectance = wafer_light(recipe.light), recipe.material.reflectance
    reach = max(reach, needed_reach(recipe, light_angle_deg))
    return EtchedPredictor.of(tile, light, reflectance, reach), surface


def recipe_tile(recipe: WaferRecipe) -> tuple[Etched, HeightMap]:
    """The tile of a recipe's wafer, and its height map; errors as of `recipe_wafer`."""
    table = recipe.surface
    assert table.height_map is not None
    surface = read_tile(table.height_map, table.pixel_um, table.role)
    return tile_of(surface, table.pitch_um, str(table.height_map)), surface


def needed_reach(recipe: WaferRecipe, light_angle_deg: float) -> float:
    """Largest frequency in cycles per µm that directions near the recipe's poses need, in any state of the inputs."""
    assert recipe.light is not None
    stated, lamp, light = recipe.uncertainty, recipe.light, wafer_light(recipe.light)
    turned = np.sqrt(2.0) * stated.seating_tilt_deg + 0.5 * (stated.light_angle_deg + stated.tilt_deg)
    cones = light.lamp_half_angle_deg * (1.0 + FARTHEST * lamp.u_lamp_share)
    cones += light.aperture_half_angle_deg * (1.0 + FARTHEST * lamp.u_aperture_share)
    tilt = max(abs(angle) for angle in recipe.poses.tilts_deg)
    steepest = tilt + abs(light_angle_deg) + cones + max(AROUND_DEG, FARTHEST * turned)
    middle = max(light.wavelength_nm - FARTHEST * lamp.u_wavelength_nm, 0.5 * light.wavelength_nm)
    lines = line_spectrum(middle, light.bandwidth_nm * (1.0 + FARTHEST * lamp.u_bandwidth_share))
    return float(2.0 * np.sin(np.radians(min(steepest, 90.0))) / (0.98 * min(lines.wavelengths_um)))


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
