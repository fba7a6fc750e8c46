"""Quality gates on the pictures: tilt, sharpness, stationary dirt, and the edges of the part.

Light, saturation, registration and drift are checked where they are measured (`pose_radiance`, `rig_monitor`); these
gates compare pictures. Every error message says what to do. A gate that could not see what it watches
returns a note for the record.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError, MeasurementError, RegistrationError
from anisoscope.imaging.pose_radiance import CELLS_PER_PITCH, Measured
from anisoscope.imaging.registration.placement import Grid, View, angle_between
from anisoscope.imaging.ridge_waves import check_ridges
from anisoscope.recipe.base import RecipeBase
from anisoscope.recipe.surface import MOST_DEVIATION, SurfaceRecipe

Image = npt.NDArray[np.float32]

TILT_DEG = 1.0
MIN_SQUEEZE_SHARE = 0.002
BLUR_GROWTH, BLUR_ADDED_PX = 1.5, 0.7
BLUR_PITCHES = 0.25
STILL_CELLS, LEAST_CELLS = 8.0, 64
UNLIKE, LIKE = 1.6, 1.4  # factors in brightness: what is beyond the part, and what is the part
THINNEST = 2.0  # cells
SOLID_PART, MOST_LIKE = (
    0.6,
    0.1,
)  # over this part of its depth so few cells of what an edge cuts off look like the part


def check_views(views: list[View], recipe: SurfaceRecipe | None = None) -> None:
    """Gates that use the markers; without a recipe the pictures need not resolve a pitch.

    Raises:
        RegistrationError: the tilt of the arm differs from the commanded one.
        MeasurementError: a picture is out of focus.
    """
    for view in views:
        check_tilt(view)
        check_sharpness(view, views[0], recipe)


def check_tilt(view: View) -> None:
    """Compare the foreshortening of the plate with the tilt of the arm."""
    place = view.placement
    cos = float(np.cos(np.radians(view.tilt_deg)))
    near, far = (np.cos(np.radians(abs(view.tilt_deg) + turn)) for turn in (-TILT_DEG, TILT_DEG))
    share = max(abs(float(near) - cos), abs(float(far) - cos)) / cos
    if abs(place.squeeze - 1.0) <= max(share, MIN_SQUEEZE_SHARE) + 4.0 * place.u_squeeze:
        return
    observed = float(np.degrees(np.arccos(min(place.squeeze * cos, 1.0))))
    words = f"the markers say {observed:.1f}°"
    if place.squeeze * cos > 1.0:
        words = f"in the markers columns are foreshortened instead of rows, by {1.0 - 1.0 / (place.squeeze * cos):.2%}"
    raise RegistrationError(
        f"at {view.stage_deg:g}° the arm stands at {view.tilt_deg:.1f}° tilt, {words} (limit ±{TILT_DEG:g}°): check "
        "tilt axis and geometry.tilt_deg in the rig file, and that the fixture lies flat"
    )


def check_sharpness(view: View, first: View, recipe: SurfaceRecipe | None = None) -> None:
    """Compare the sharpness of the markers' edges with the first pose, and with the cells of the contrast map."""
    blur, usual = view.placement.blur_px, first.placement.blur_px
    if blur is None or usual is None:
        return
    blur_um = blur * view.placement.pixel_um
    limit_um = np.inf if recipe is None else BLUR_PITCHES * recipe.surface.pitch_um
    if recipe is not None and recipe.area is not None and blur_um > limit_um:
        raise MeasurementError(
            f"at {view.stage_deg:g}° the picture is out of focus: the markers' edges are smeared by {blur_um:.1f} µm "
            f"(limit {limit_um:g} µm, a quarter of a pitch): focus again, and clean the lens"
        )
    added = float(np.sqrt(abs(blur**2 - usual**2)))
    if max(blur, usual) > BLUR_GROWTH * min(blur, usual) and added > BLUR_ADDED_PX:
        worse, better = (view, first) if blur > usual else (first, view)
        raise MeasurementError(
            f"at {worse.stage_deg:g}° the picture is less sharp than at {better.stage_deg:g}° (edges of the markers "
            f"{max(blur, usual):.2f} px instead of {min(blur, usual):.2f} px): focus again, and check that the fixture "
            "lies flat and the stage does not wobble"
        )


def unwatched(views: Sequence[View]) -> tuple[str, ...]:
    """Notes on what the gates that use the markers could not see, whatever the kind of part."""
    places = [view.placement for view in views]
    blind = {
        "tilt": any(view.tilt_deg and not view.placement.markers for view in views),
        "sharpness": any(place.blur_px is None for place in places),
    }
    names = [name for name, is_blind in blind.items() if is_blind]
    return (f"not watched: {', '.join(names)} (no markers in the pictures)",) if names else ()


def check_part(views: list[View], measured: Measured, recipe: SurfaceRecipe) -> tuple[str, ...]:
    """Gates of the aligned pictures of ridges.

    Returns:
        Notes on what could not be seen.

    Raises:
        MeasurementError: the region reaches beyond the part; the ridges are not those of the recipe, or run elsewhere.
        CalibrationError: a deviation is stationary in the picture while the part turns.
    """
    notes = check_edges(measured.cells, measured.grid, recipe)
    notes += check_ridges(measured.aligned, [view.stage_deg for view in views], measured.grid, recipe)
    return notes + check_dirt(views, measured, 0.5 * MOST_DEVIATION)


@dataclass(frozen=True)
class Overhang:
    """A corner of the region beyond the part: (x, y) of the corner in sample millimetres, and how far in µm."""

    at_mm: tuple[float, float]
    beyond_um: float


def overhangs(cells: FloatArray, grid: Grid) -> tuple[Overhang, ...]:
    """Corners of the region that lie beyond the part.

    What is not the part is brighter or darker than it in every pose, up to a straight edge that cuts the corner off or
    runs along a side. Means of a whole pitch across the ridges show it; cells that look like the part, each compared
    with the median of the cells at its place in the pitch, contradict it.

    Args:
        cells: (P, rows, cols) mean radiance of cells, four in a pitch.
        grid: raster of the aligned pictures.

    Returns:
        The corners; none where there are too few cells to say.
    """
    if min(cells.shape[1:]) < CELLS_PER_PITCH:
        return ()
    cell_um = 1000.0 * grid.pixel_mm * grid.shape[1] / cells.shape[2]
    found = []
    for down in (1, -1):
        for across in (1, -1):
            beyond = _cut_off(cells[:, ::down, ::across])
            if beyond > 0.0:
                row, col = (0 if down > 0 else grid.shape[0] - 1), (0 if across > 0 else grid.shape[1] - 1)
                x, y, _ = grid.to_mm() @ [col, row, 1.0]
                found.append(Overhang((float(x), float(y)), beyond * cell_um))
    return tuple(found)


def _cut_off(cells: FloatArray) -> float:
    """Distance in cells from the corner at (P, 0, 0) to the edge of the part; 0 where the part covers the corner."""
    ends = np.pad(np.cumsum(cells, axis=2), ((0, 0), (0, 0), (1, 0)))
    pitches = ends[:, :, CELLS_PER_PITCH:] - ends[:, :, :-CELLS_PER_PITCH]
    unlike = np.all(np.abs(_off_median(pitches)) > np.log(UNLIKE), axis=0)
    # a pitch counts up to where half of it is the part
    across = np.cumprod(unlike, axis=1).sum(axis=1)
    across = np.where(across > 0, across + CELLS_PER_PITCH // 2 - 1, 0)
    down = np.cumprod(unlike, axis=0).sum(axis=0)
    like = np.empty(cells.shape[1:], dtype=bool)
    for phase in range(CELLS_PER_PITCH):
        own = np.s_[:, :, phase::CELLS_PER_PITCH]
        like[own[1:]] = np.all(np.abs(_off_median(cells[own])) < np.log(LIKE), axis=0)
    row, col = np.indices(like.shape) + 0.5
    legs = float(across[:2].min()), float(down[0])
    beyond = 0.0
    if min(legs) >= THINNEST and max(legs) >= CELLS_PER_PITCH:
        beyond = legs[0] * legs[1] / float(np.hypot(*legs))
        if _is_part(like, row / legs[1] + col / legs[0]):
            beyond = 0.0
    # a strip along a whole side, whatever the next side shows
    for depth, along in ((float(np.median(across)), col), (float(np.median(down)), row)):
        if depth >= THINNEST and not _is_part(like, along / depth):
            beyond = max(beyond, depth)
    return beyond


def _is_part(like: npt.NDArray[np.bool_], depth: FloatArray) -> bool:
    """Whether more than a few cells near the border look like the part; the depth is 1 at the supposed edge."""
    inner = depth < SOLID_PART
    return not inner.any() or bool(like[inner].mean() > MOST_LIKE)


def _off_median(values: FloatArray) -> FloatArray:
    """Ln ratio of every value of a pose to the median of the pose."""
    logs = np.log(np.maximum(values, 1e-6))
    return np.asarray(logs - np.median(logs, axis=(1, 2), keepdims=True))


def check_edges(cells: FloatArray, grid: Grid, recipe: RecipeBase) -> tuple[str, ...]:
    """Check that no corner of the region is beyond the part; cells as for `overhangs`, notes as of `check_part`."""
    found = beyond_part(cells, grid, recipe)
    if found is not None:
        raise MeasurementError(found)
    if min(cells.shape[1:]) < CELLS_PER_PITCH:
        return ("not watched: whether the region lies on the part (it is narrower than a pitch)",)
    return ()


def beyond_part(cells: FloatArray, grid: Grid, recipe: RecipeBase) -> str | None:
    """Corners of the region that are beyond the part by more than the recipe allows; None if none is.

    Args:
        cells: as for `overhangs`.
        grid: of the region.
        recipe: with the limit.
    """
    limit_um = recipe.limits.beyond_part_um
    beyond = [one for one in overhangs(cells, grid) if one.beyond_um > limit_um]
    if not beyond:
        return None
    count = f"at {len(beyond)} corners" if len(beyond) > 1 else "at a corner"
    places = ", ".join(
        f"{one.beyond_um:.0f} µm at x {one.at_mm[0]:+.2f} mm, y {one.at_mm[1]:+.2f} mm" for one in beyond
    )
    return (
        f"the region reaches beyond the part {count}: {places} (limit {limit_um:g} µm, "
        "limits.beyond_part_um): make region.size_mm smaller, correct region.center_mm, or seat the part properly; is "
        "the part whole there?"
    )


def check_dirt(views: list[View], measured: Measured, threshold: float) -> tuple[str, ...]:
    """Detect stationary dirt: deviations at fixed pixels while the part turns.

    Cells are compared with their flank in every pose. Dirt on lens, sensor or white tile makes the same cells of the
    *picture* deviate in every pose, whereas a mark on the part moves. A large mark about the axis lies over itself when
    it is turned: cells that deviate wherever the part has turned them are the part's. The number expected by chance
    follows from the number of deviating cells in each pose. Notes as of `check_part`.
    """
    turned = [
        i for i, v in enumerate(views) if i == 0 or abs(angle_between(views[0].stage_deg, v.stage_deg)) > 1.0
    ]
    if len(turned) < 2 or measured.cells.shape[1] * measured.cells.shape[2] < LEAST_CELLS:
        few = "one stage angle" if len(turned) < 2 else f"fewer than {LEAST_CELLS} cells"
        return (f"not watched: dirt on lens and white tile ({few})",)
    maps = [_off_flank(measured.cells[i]) for i in turned]
    first, shape = maps[0], maps[0].shape
    fixed, chance = np.abs(first) > threshold, float(np.mean(np.abs(first) > threshold))
    known, moved = np.ones(shape, dtype=bool), np.zeros(shape, dtype=bool)
    turning = np.ones(shape, dtype=bool)
    for i, other in zip(turned[1:], maps[1:], strict=True):
        at = _same_pixels(views[0], views[i], measured.grid, shape)
        observed = _looked_up(other, at)
        moved |= np.hypot(*np.moveaxis(at - _cell_indices(shape)[..., :2], -1, 0)) > STILL_CELLS
        known &= np.isfinite(observed)
        fixed &= np.sign(first) * observed > threshold
        turning &= np.abs(other) > threshold
        chance *= 0.5 * float(np.mean(np.abs(other) > threshold))
    counted = known & moved & ~turning
    fixed &= counted
    expected = chance * float(counted.sum())
    if fixed.sum() > expected + 6.0 * np.sqrt(expected) + 3.0:
        column, row = _place_of(fixed, views[0], measured.grid)
        raise CalibrationError(
            f"something stays at column {column:.0f}, row {row:.0f} of the picture while the part turns "
            f"({int(fixed.sum())} cells): clean lens and camera, then the white tile, and take a new flat with "
            "`anisoscope calibrate flat`"
        )
    return ()


def _looked_up(cells: FloatArray, at: Image) -> Image:
    """The nearest cell of every place; NaN outside."""
    return np.asarray(
        cv2.remap(
            cells.astype(np.float32),
            at[..., 0],
            at[..., 1],
            cv2.INTER_NEAREST,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=(float("nan"),),
        )
    )


def _off_flank(cells: FloatArray) -> FloatArray:
    """Ln ratio of every cell to the median along its flank."""
    logs = np.log(np.maximum(cells, 1e-6))
    return np.asarray(logs - np.median(logs, axis=0))


def _cells_to_pixels(view: View, grid: Grid, cols: int) -> FloatArray:
    """(3, 3) map from (column, row, 1) of cells, ``cols`` in a row, to (column, row, 1) of the picture."""
    side = grid.shape[1] / cols
    centres = np.array([[side, 0.0, (side - 1.0) / 2.0], [0.0, side, (side - 1.0) / 2.0], [0.0, 0.0, 1.0]])
    return np.asarray(view.placement.homography @ grid.to_mm() @ centres)


def _same_pixels(first: View, other: View, grid: Grid, shape: tuple[int, ...]) -> Image:
    """(rows, cols, 2) column and row of the other view's cell on the same pixels as each cell of the first."""
    to_first, to_other = (_cells_to_pixels(view, grid, shape[1]) for view in (first, other))
    at = _cell_indices(shape) @ (np.linalg.inv(to_other) @ to_first).T
    return np.asarray(at[..., :2] / at[..., 2:], dtype=np.float32)


def _cell_indices(shape: tuple[int, ...]) -> FloatArray:
    """(rows, cols, 3) column, row, 1 of every cell."""
    row, column = np.indices(shape).astype(np.float64)
    return np.stack([column, row, np.ones(shape)], axis=-1)


def _place_of(cells: npt.NDArray[np.bool_], view: View, grid: Grid) -> tuple[float, float]:
    """Column and row in the picture of the median cell of a set."""
    row, column = (float(np.median(index)) for index in np.nonzero(cells))
    observed = _cells_to_pixels(view, grid, cells.shape[1]) @ [column, row, 1.0]
    return float(observed[0] / observed[2]), float(observed[1] / observed[2])
