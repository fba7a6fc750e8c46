"""The height map of a plate: checked against its plan, and what every field of it should show."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.kinds.plates.recipe import PlateRecipe
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.prediction.region_prediction import FieldGrid, predict_fields
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.metrology.regions import field_leans
from anisoscope.profiles.plates import FLAT, Plan
from anisoscope.sim.light.relief import MAX_MISSING_SHARE

HEIGHT_MAP = "height_map"
"""Role of its file in an inspection."""
WRONG_DEG, FLAT_LEAN = 30.0, 0.25
"""Difference of the direction of a field from the plan, and length of the mean fall of a flat field."""
WRONG_SHARE = 0.2
"""Share of the fields from which on a height map is not that of the plan."""
SIZE_SHARE = 0.01


def fields_by_map(
    surface: HeightMap, recipe: PlateRecipe, plan: Plan, poses: tuple[Pose, ...], convention: Convention
) -> FloatArray:
    """(P, rows, cols) radiance of every field of a plate by its height map, as of `plate_surface`."""
    azimuths = tuple(plan.azimuths_deg[letter] for letter in plan.letters)
    design = recipe.surface.ridge_design()
    ridges = tuple(plan.design_of(letter, design) for letter in plan.letters)
    grid = FieldGrid(plan.classes(), azimuths, ridges, recipe.interior)
    return predict_fields(
        surface, grid, recipe.material.material(), poses, convention, recipe.surface.bounces
    )


def plate_surface(recipe: PlateRecipe, plan: Plan) -> HeightMap:
    """The height map of a plate, level, checked against the plan.

    Raises:
        HeightMapError: it cannot be read, has another size than the plan, other directions, or too many gaps.
    """
    part = recipe.surface
    assert part.height_map is not None
    path = part.height_map
    surface = read_height_map(path, pixel_um=part.pixel_um, role=part.role)
    if surface.missing_share > MAX_MISSING_SHARE:
        raise HeightMapError(
            f"{path}: {surface.missing_share:.1%} of the heights are missing (limit {MAX_MISSING_SHARE:.0%}): measure "
            "the plate again, or fill the gaps in the instrument's software"
        )
    size = (surface.shape[1] * surface.pixel_x_um / 1000.0, surface.shape[0] * surface.pixel_y_um / 1000.0)
    off = [abs(one / due - 1.0) for one, due in zip(size, plan.size_mm, strict=True)]
    if max(off) > SIZE_SHARE:
        raise HeightMapError(
            f"{path}: the map is {size[0]:.4g} mm × {size[1]:.4g} mm large, the plan {plan.size_mm[0]:.4g} mm × "
            f"{plan.size_mm[1]:.4g} mm: crop the map to the fields, or correct plan.module_mm"
        )
    surface = _level(surface, plan)
    _check_directions(surface, plan, path)
    return surface


def _level(surface: HeightMap, plan: Plan) -> HeightMap:
    """The map less the plane through the mean heights of its fields, which are alike whatever their direction."""
    rows, cols = plan.shape
    means = np.array(
        [
            [np.nanmean(part) for part in np.array_split(band, cols, axis=1)]
            for band in np.array_split(surface.height_um, rows)
        ]
    )
    y, x = np.indices(plan.shape)
    design = np.stack([np.ones(means.size), y.ravel(), x.ravel()], axis=1)
    used = np.isfinite(means.ravel())
    plane = np.linalg.lstsq(design[used], means.ravel()[used], rcond=None)[0]
    tall, wide = surface.shape
    rise_y, rise_x = plane[1] * rows / tall, plane[2] * cols / wide
    tilt = rise_y * np.arange(tall)[:, None] + rise_x * np.arange(wide)[None, :]
    height = surface.height_um - tilt
    return surface.with_height(height - np.nanmean(height))


def _check_directions(surface: HeightMap, plan: Plan, path: Path) -> None:
    """Check that the fields of a map lean as the plan says."""
    leans = field_leans(surface, *plan.shape)
    wrong = _wrong_fields(leans, plan)
    count, total = int(wrong.sum()), wrong.size
    if count <= WRONG_SHARE * total:
        return
    row, col = (int(n) for n in np.argwhere(wrong)[0])
    lean = complex(leans[row, col])
    seen = "flat" if abs(lean) < FLAT_LEAN else f"toward {np.degrees(np.angle(lean)):.0f}°"
    letter = plan.rows[row][col]
    due = "flat" if letter == FLAT else f"toward {plan.azimuths_deg[letter]:g}°"
    positions = {
        f"turned by {90 * quarters}°": int(_wrong_fields(leans, plan.turned(quarters)).sum())
        for quarters in (1, 2, 3)
        if plan.turned(quarters).shape == plan.shape
    }
    mirrored = {letter: 180.0 - one for letter, one in plan.azimuths_deg.items()}
    positions["mirrored"] = int(
        _wrong_fields(leans, Plan(tuple(one[::-1] for one in plan.rows), mirrored, plan.module_mm)).sum()
    )
    fits = [name for name, others in positions.items() if others <= WRONG_SHARE * total]
    how = f"the map is that of the plan {fits[0]}" if fits else "is it the map of another plate?"
    raise HeightMapError(
        f"{path}: {count} of {total} fields of the map do not lean as the plan says (row {row + 1}, column {col + 1}: "
        f"{seen}, planned {due}): {how}"
    )


def _wrong_fields(leans: npt.NDArray[np.complexfloating], plan: Plan) -> npt.NDArray[np.bool_]:
    """(rows, cols) fields of other directions than the plan's."""
    flat = np.array([[letter == FLAT for letter in row] for row in plan.rows])
    due = np.array([[plan.azimuths_deg.get(letter, 0.0) for letter in row] for row in plan.rows])
    apart = np.abs(np.degrees(np.angle(leans * np.exp(-1j * np.radians(due)))))
    return np.asarray(
        np.where(flat, np.abs(leans) >= FLAT_LEAN, (apart > WRONG_DEG) | (np.abs(leans) < FLAT_LEAN))
    )
