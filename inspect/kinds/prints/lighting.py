"""Lamp spectrum and sensitivities of a rig, from which the colours of a print are computed, and their files."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from anisoscope.base.errors import CalibrationError, RecipeError, RigFileError, UsageError
from anisoscope.kinds.prints.expectation import PrintExpectation, expect_print
from anisoscope.kinds.prints.measurement import MIN_PIXELS
from anisoscope.kinds.prints.recipe import PrintRecipe, ink_file
from anisoscope.rig.bayer import FILTERS
from anisoscope.rig.rigfile import RigFile
from anisoscope.sim.light.colour.illuminant import Illuminant
from anisoscope.sim.light.colour.vision import Sensitivities
from anisoscope.sim.materials.spectra import find_illuminant, find_sensitivities

SIMULATED = "simulated"
SYNTHETIC = "synthetic"
MOSAICS = tuple(name for name in FILTERS if name != "mono")


def check_print_rig(rig: RigFile, path: Path) -> None:
    """Check that a rig file states the lamp spectrum and sensitivities, and that both can be read.

    Raises:
        RigFileError: it does not.
    """
    if rig.light.spectrum is None:
        raise RigFileError(
            f'{path}: a print needs the spectrum of the lamp: set light.spectrum, such as "led-white", "d65" or a file '
            "wavelength_nm,power"
        )
    if rig.camera.sensitivities is None and rig.camera.driver != SIMULATED:
        raise RigFileError(
            f"{path}: a print needs the sensitivities of the camera: set camera.sensitivities to a file "
            'wavelength_nm,red,green,blue (or to "synthetic", made-up ones)'
        )
    try:
        lamp_and_sensitivities(rig)
    except UsageError as problem:
        raise RigFileError(f"{path}: {problem}") from None


def lamp_and_sensitivities(rig: RigFile) -> tuple[Illuminant, Sensitivities]:
    """Spectrum of a rig's lamp, and sensitivities of its colour camera; synthetic ones for a simulated camera.

    Raises:
        UsageError: a file cannot be used.
    """
    assert rig.light.spectrum is not None  # checked before
    return find_illuminant(rig.light.spectrum), find_sensitivities(
        rig.camera.sensitivities or SYNTHETIC, MOSAICS[0]
    )


def print_files(recipe: PrintRecipe, rig: RigFile) -> dict[str, Path]:
    """Input files of the colours of a print, by role; inks of the package too, so that the folder holds copies."""
    found = {"ink": ink_file(recipe.print.ink)}
    for number, name in enumerate(recipe.print.wrong_inks, start=1):
        found[f"wrong ink {number}"] = ink_file(name)
    if rig.light.spectrum is not None and rig.light.spectrum.lower().endswith(".csv"):
        found["lamp spectrum"] = Path(rig.light.spectrum)
    if rig.camera.sensitivities is not None and rig.camera.sensitivities.lower().endswith(".csv"):
        found["sensitivities"] = Path(rig.camera.sensitivities)
    return found


def from_copies(recipe: PrintRecipe, rig: RigFile, paths: Mapping[str, Path]) -> tuple[PrintRecipe, RigFile]:
    """Recipe and rig with the copies of their files in an inspection folder, by role."""
    inks = tuple(
        str(paths.get(f"wrong ink {number}", name))
        for number, name in enumerate(recipe.print.wrong_inks, start=1)
    )
    part = recipe.print.model_copy(
        update={"ink": str(paths.get("ink", recipe.print.ink)), "wrong_inks": inks}
    )
    spectrum = paths.get("lamp spectrum")
    light = rig.light if spectrum is None else rig.light.model_copy(update={"spectrum": str(spectrum)})
    curves = paths.get("sensitivities")
    camera = rig.camera if curves is None else rig.camera.model_copy(update={"sensitivities": str(curves)})
    return (
        recipe.model_copy(update={"print": part}),
        rig.model_copy(update={"light": light, "camera": camera}),
    )


def check_filters(filters: str, camera: str, of_flat: str) -> None:
    """Check that the camera has colour filters, and that its flat was recorded through the same ones.

    Raises:
        CalibrationError: it has no colour filters, or the flat is one through others.
    """
    if filters not in MOSAICS:
        raise CalibrationError(
            f"a print needs a camera with colour filters; {camera} has {filters!r}: use a colour camera in a colour "
            'format, such as camera.options.pixel_format = "BayerRG12" (a folder of frames says it in the column '
            "filters)"
        )
    if of_flat != filters:
        raise CalibrationError(
            f"the flat was taken through filters {of_flat!r}, the frames through {filters!r}: take a new flat with "
            "`anisoscope calibrate flat`"
        )


def expectation_of_print(recipe: PrintRecipe, rig: RigFile) -> PrintExpectation:
    """Predict a print on a rig.

    Raises:
        RecipeError: cells of the map with too few pixels of a colour, and as for `expect_print`.
        InkFileError, ModelError: as for `expect_print`.
        RigFileError: the lamp stands nearer than the region is wide.
    """
    # every other row and column of a mosaic has a red pixel
    least_mm = 2.0 * np.sqrt(MIN_PIXELS) * 1e-3 * rig.camera.pixel_um
    if recipe.area is not None and recipe.area.cell_mm < (1.0 - 1e-9) * least_mm:
        raise RecipeError(
            f"area.cell_mm: a cell of {recipe.area.cell_mm:g} mm holds fewer than {MIN_PIXELS} red pixels, each "
            f"{rig.camera.pixel_um:g} µm wide: make cells {least_mm:.2g} mm or larger, better twice that"
        )
    found = expect_print(recipe, rig.light.angle_deg, *lamp_and_sensitivities(rig))
    rig.light.check_distance(recipe.region.size_mm)
    return replace(found, lamp_distance_mm=rig.light.distance_mm)
