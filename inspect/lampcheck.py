"""Does the lamp that a recipe predicts with stand on the rig? Compared as far as the rig file tells."""

from pathlib import Path

from anisoscope.errors import RigFileError
from anisoscope.recipe import Recipe
from anisoscope.rig.rigfile import RigFile

APART = 3.0
"""Standard uncertainties of the recipe by which the two may differ."""


def check_lamp(recipe: Recipe, rig: RigFile, path: Path) -> None:
    """Compare the recipe's lamp and lens with those of the rig file; what either leaves out is not compared.

    Args:
        recipe: with ``[light]`` or without.
        rig: the rig.
        path: of the rig file, for the message.

    Raises:
        RigFileError: they differ by more than the recipe's uncertainties explain.
    """
    told = recipe.light
    if told is None:
        return
    pairs = (
        ("light.wavelength_nm", "nm", rig.light.wavelength_nm, told.wavelength_nm, told.u_wavelength_nm),
        (
            "light.bandwidth_nm",
            "nm",
            rig.light.bandwidth_nm,
            told.bandwidth_nm,
            told.u_bandwidth_share * told.bandwidth_nm,
        ),
        (
            "light.half_angle_deg",
            "°",
            rig.light.half_angle_deg,
            told.lamp_half_angle_deg,
            told.u_lamp_share * told.lamp_half_angle_deg,
        ),
        (
            "camera.half_angle_deg",
            "°",
            rig.camera.half_angle_deg,
            told.aperture_half_angle_deg,
            told.u_aperture_share * told.aperture_half_angle_deg,
        ),
    )
    for key, unit, has, meant, u in pairs:
        if has is not None and abs(has - meant) > APART * u + 1e-9 * abs(meant):
            space = "" if unit == "°" else " "
            raise RigFileError(
                f"{path}: {key} is {has:g}{space}{unit}, the recipe predicts for {meant:g} ± {u:g}{space}{unit} "
                "([light]): use the rig that the recipe is made for, or correct the one that is wrong"
            )
