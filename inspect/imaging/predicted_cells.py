"""Predicted radiance of every cell of the region: what a part should look like in each pose.

The model predicts means over whole pitches. Within a pitch the radiance follows the flanks: rays on the height map, or
on the ideal design, averaged along the ridges. Its phase is that of the ridges in the photographs. The mean of the
region is the prediction that decides; light that reflects more than once is spread evenly.
"""

from functools import lru_cache

import cv2
import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import AnisoscopeError
from anisoscope.imaging.height_map_place import (
    POINTS_A_PITCH,
    reduced_map,
    render,
)
from anisoscope.imaging.phase_map import BINS, crest_of, phases_of, profile_over
from anisoscope.imaging.pose_radiance import CELLS_PER_PITCH, Measured
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import Expectation
from anisoscope.prediction.part_scatter import with_design
from anisoscope.prediction.recipe_models import lobe_on
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import ridges
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.sim.light.relief import Relief

POINTS_OF_A_DESIGN = 50  # a pitch
PITCHES_OF_A_DESIGN = 4


def even_cells(expected: Expectation, measured: Measured) -> FloatArray:
    """(P, cell rows, cell cols) predicted radiances in 1/sr, the same in all cells of a pose."""
    return np.broadcast_to(expected.radiance[:, None, None], measured.cells.shape)


def pitch_means(cells: FloatArray) -> FloatArray:
    """(P, rows, cols) radiances of cells, each averaged with those around it across one pitch; the region's ends join.

    Predictions are of means over whole pitches: within one, the pattern of the flanks is no deviation.
    """
    before, cols = CELLS_PER_PITCH // 2, cells.shape[2]
    wide = np.pad(cells, ((0, 0), (0, 0), (before, CELLS_PER_PITCH - 1 - before)), mode="wrap")
    return np.asarray(np.mean([wide[:, :, k : k + cols] for k in range(CELLS_PER_PITCH)], axis=0))


def predicted_cells(
    recipe: SurfaceRecipe, expected: Expectation, measured: Measured
) -> tuple[FloatArray, str]:
    """Predicted radiances of the cells of a ridged part, and what they are in words.

    Args:
        recipe: the recipe.
        expected: the prediction.
        measured: the measurement; its photographs give the phase of the ridges.

    Returns:
        (P, cell rows, cell cols) in 1/sr, as `Measured.cells`, and a caption.
    """
    try:
        profiles, source = _profiles(recipe, expected, measured)
    except AnisoscopeError as problem:
        return even_cells(expected, measured), f"the predicted mean of each pose: {problem}"
    # what the rays on the surface lack is even over the region, and never makes a cell darker than black
    lacking = expected.radiance - profiles.mean(axis=(1, 2))
    shown = np.maximum(profiles + lacking[:, None, None], 0.0)
    shown *= (expected.radiance / np.maximum(shown.mean(axis=(1, 2)), 1e-300))[:, None, None]
    caption = (
        f"the radiance that {source} predicts for cells of a quarter of a pitch, averaged along the ridges and put at "
        "the ridges of the photographs; the mean of each pose is the prediction that decides"
    )
    return shown, caption


def _profiles(recipe: SurfaceRecipe, expected: Expectation, measured: Measured) -> tuple[FloatArray, str]:
    """(P, cell rows, cell cols) radiances by rays, at the ridges of the photographs, and the name of the surface."""
    pitch_um, pixel_um = recipe.surface.pitch_um, measured.grid.pixel_mm * 1000.0
    factor = max(1, int(pitch_um / pixel_um / POINTS_A_PITCH))
    design = with_design(recipe).surface.ridge_design()
    wall = design.wall_width_um / design.pitch_um
    surface, source = _surface(recipe, expected)
    rendered = render(
        surface,
        expected.poses,
        lobe_on(Relief(surface, direction_deg=expected.turn_deg), recipe),
        expected.convention,
        pixel_um * factor,
        pitch_um,
        expected.turn_deg,
    )
    columns = (np.arange(rendered[0].shape[1]) + 0.5) * pixel_um * factor / pitch_um
    place = np.broadcast_to(columns, rendered[0].shape)
    place = place - crest_of(rendered, place, wall)
    seen = phases_of(measured, pitch_um, wall).place
    rows, cols = measured.cells.shape[1:]
    at = (np.arange(BINS) + 0.5) / BINS
    cells = [
        cv2.resize(
            np.interp(seen, at, profile_over(place, one.astype(np.float64)), period=1.0),
            (cols, rows),
            interpolation=cv2.INTER_AREA,
        )
        for one in rendered
    ]
    return np.stack(cells), source


def _surface(recipe: SurfaceRecipe, expected: Expectation) -> tuple[HeightMap, str]:
    if expected.surface is not None:
        return reduced_map(expected.surface, recipe.surface.pitch_um), "the height map"
    pixel_um = recipe.surface.pitch_um / POINTS_OF_A_DESIGN
    return _ideal(recipe.surface.ridge_design(), pixel_um), "the ideal design"


@lru_cache(maxsize=2)
def _ideal(design: RidgeDesign, pixel_um: float) -> HeightMap:
    points = PITCHES_OF_A_DESIGN * POINTS_OF_A_DESIGN + 1
    return ridges(design, (points, points), pixel_um)
