"""The largest region that all pictures show: inside them, between the markers, and as bright as the middle."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from anisoscope.errors import MeasurementError
from anisoscope.prints.recipe import AnyRecipe, PrintRecipe
from anisoscope.registration.placement import Grid, Placement, resample
from anisoscope.rig.fixture import Fixture

FloatArray = npt.NDArray[np.float64]

UNLIKE = 2.0  # factor in brightness from which on a stretch along the border is not the part
POINTS_A_PITCH = 4
CELL_MM = 0.1
QUIET = 1.25  # markers need white around them


def largest_region(
    pictures: Sequence[FloatArray], places: Sequence[Placement], fixture: Fixture, recipe: AnyRecipe
) -> float:
    """Side of the largest square about the recipe's middle of the region, whole pitches or cells of the map, in mm.

    Args:
        pictures: one a pose, proportional to radiance.
        places: where the part stands in them.
        fixture: the markers.
        recipe: pitch or cell, middle and direction of the region.

    Raises:
        MeasurementError: not even two pitches or cells fit.
    """
    pitch_mm = step_mm(recipe)
    turn = recipe.poses.facet_azimuth_deg
    best = 0
    most = int(_reach(fixture, recipe) / pitch_mm)
    reference = [_middle(picture, place, recipe) for picture, place in zip(pictures, places, strict=True)]
    for count in range(2, most + 1):
        grid = _grid(recipe, count, turn)
        if not _clear_of_markers(fixture, recipe, count * pitch_mm):
            best -= isinstance(
                recipe, PrintRecipe
            )  # its edge may lie here as well, and colours would show it
            break
        if not all(
            _shows(picture, place, grid, middle)
            for picture, place, middle in zip(pictures, places, reference, strict=True)
        ):
            best -= 1  # the part ends here: keep a pitch away from its edge
            break
        best = count
    if best < 2:
        raise MeasurementError(
            f"around region.center_mm not even two {_steps(recipe)} of the part show in all poses: centre the part, or "
            "correct region.center_mm in the recipe"
        )
    return round(best * pitch_mm, 6)


def step_mm(recipe: AnyRecipe) -> float:
    """By what a region grows: a pitch, or a cell of the map of a print."""
    if isinstance(recipe, PrintRecipe):
        return CELL_MM if recipe.area is None else recipe.area.cell_mm
    return recipe.surface.pitch_um / 1000.0


def _steps(recipe: AnyRecipe) -> str:
    return "cells" if isinstance(recipe, PrintRecipe) else "pitches"


def _reach(fixture: Fixture, recipe: AnyRecipe) -> float:
    """Side beyond which no square can lie between the markers."""
    x, y = recipe.region.center_mm
    return 2.0 * max(float(np.hypot(one.x_mm - x, one.y_mm - y)) for one in fixture.markers)


def _grid(recipe: AnyRecipe, count: int, turn_deg: float) -> Grid:
    points = count * POINTS_A_PITCH
    step = step_mm(recipe) / POINTS_A_PITCH
    return Grid(recipe.region.center_mm, step, (points, points), turn_deg)


def _clear_of_markers(fixture: Fixture, recipe: AnyRecipe, side_mm: float) -> bool:
    """Does a square keep off all markers and their white rims?"""
    turn = np.radians(recipe.poses.facet_azimuth_deg)
    reach = 0.5 * side_mm + 0.5 * QUIET * fixture.marker_mm * (abs(np.cos(turn)) + abs(np.sin(turn)))
    for marker in fixture.markers:
        x, y = np.subtract((marker.x_mm, marker.y_mm), recipe.region.center_mm)
        u, v = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
        if max(abs(u), abs(v)) < reach:
            return False
    return True


def _middle(picture: FloatArray, place: Placement, recipe: AnyRecipe) -> float:
    middle = resample(picture.astype(np.float32), place, _grid(recipe, 2, recipe.poses.facet_azimuth_deg))
    return float(np.nanmean(middle)) if np.isfinite(middle).any() else 0.0


def _shows(picture: FloatArray, place: Placement, grid: Grid, middle: float) -> bool:
    """Is all of the square in the picture, and are its border stretches about as bright as its middle?"""
    seen = resample(picture.astype(np.float32), place, grid).astype(np.float64)
    if middle <= 0.0 or not np.isfinite(seen).all():
        return False
    n = seen.shape[0] // POINTS_A_PITCH
    blocks = seen.reshape(n, POINTS_A_PITCH, n, POINTS_A_PITCH).mean(axis=(1, 3))
    border = np.concatenate([blocks[0], blocks[-1], blocks[1:-1, 0], blocks[1:-1, -1]])
    return bool(np.all((border > middle / UNLIKE) & (border < middle * UNLIKE)))
