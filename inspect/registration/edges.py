"""Aligning the turned pictures without markers, by the edges of what lies under the camera.

Every picture is turned back about the rotation axis by what the stage says; what is left is a small shift and turn,
found by the directions of edges (`edgefit`). Ridges repeat, so that the ridges of a picture fit as well one pitch
further: they are damped in the search, and outline and single marks say which place is meant. Where they do not say so
clearly, or anything else is unclear, the pictures are refused.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.errors import RegistrationError
from anisoscope.registration.edgefit import (
    COARSE_PX,
    FINE_PX,
    Fit,
    all_shifts,
    clearest,
    directions,
    refined,
    shifted,
)
from anisoscope.registration.placement import Grid, Placement, resample

FloatArray = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

MAX_SIDE = 1024
MAX_SHIFT_PX = 5.0
MAX_TURN_DEG = 0.2
UNKNOWN_AXIS_SHARE = 0.3
MAX_SECOND_PEAK = 0.7
MIN_PEAK, MIN_SCORE = 0.12, 0.5
MAX_RESIDUAL_PX = 0.4
_MARGIN = 8.0
_ADVICE = "describe a [fixture] with markers in the rig file"


@dataclass(frozen=True)
class Seen:
    """A picture to be aligned.

    Attributes:
        image: (rows, cols) linear picture; NaN where a pixel has no value.
        stage_deg: angle of the sample by the stage.
        tilt_deg: tilt of the camera.
    """

    image: Image
    stage_deg: float
    tilt_deg: float = 0.0


def place_by_edges(
    pictures: Sequence[Seen], pixel_um: float, axis_px: tuple[float, float] | None = None
) -> list[Placement]:
    """Where the sample stands in every picture, seen from the first one.

    Args:
        pictures: at least one; the first is the reference.
        pixel_um: size of a pixel on the sample.
        axis_px: (column, row) of the rotation axis, calibrated; without it, it is estimated from the pictures.

    Returns:
        One a picture; the sample's origin is the rotation axis.

    Raises:
        RegistrationError: there is too little structure, the pictures fit in several places, or they fit elsewhere than
            stage and axis say.
    """
    shape = pictures[0].image.shape
    start = axis_px or ((shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0)
    found = _placed(pictures, pixel_um, start, UNKNOWN_AXIS_SHARE * min(shape))
    if axis_px is None:
        # once more about the axis that they show, so that all sides of the part weigh alike
        about = _about_the_axis(found)[0].axis_px
        found = _about_the_axis(_placed(pictures, pixel_um, about, 2.0 * MAX_SHIFT_PX))
    for seen, place in zip(pictures[1:], found[1:], strict=True):
        _check(seen, place, found[0])
    return found


def _placed(
    pictures: Sequence[Seen], pixel_um: float, axis_px: tuple[float, float], reach_px: float
) -> list[Placement]:
    """Where the sample stands in every picture, whose shift from where it should stand is within reach."""
    nominal = [_nominal(seen, pixel_um, axis_px) for seen in pictures]
    grid = _raster(pictures[0].image.shape, axis_px, pixel_um)
    scale = grid.pixel_mm * 1000.0 / pixel_um
    first = _turned_back(pictures[0].image, nominal[0], grid, scale)
    found = [nominal[0]]
    for seen, place in zip(pictures[1:], nominal[1:], strict=True):
        other = _turned_back(seen.image, place, grid, scale)
        fit = _aligned(first, other, reach_px / scale, f"at {seen.stage_deg:g}°")
        found.append(_moved(place, fit.warp, grid, fit.u_px * scale))
    return found


def _nominal(seen: Seen, pixel_um: float, axis_px: tuple[float, float]) -> Placement:
    """Where the sample stands if stage, axis and tilt are right."""
    factor = 1000.0 / pixel_um * np.exp(1j * np.radians(seen.stage_deg))
    squeeze = float(np.cos(np.radians(seen.tilt_deg)))
    matrix = np.array(
        [
            [factor.real, -factor.imag, axis_px[0]],
            [-squeeze * factor.imag, -squeeze * factor.real, axis_px[1]],
        ]
    )
    return Placement(matrix, seen.stage_deg % 360.0, pixel_um, axis_px, 0.0, 0)


def _raster(shape: tuple[int, ...], axis_px: tuple[float, float], pixel_um: float) -> Grid:
    """A square about the axis, as large as the circle that every turned picture shows."""
    radius = min(*axis_px, shape[1] - 1 - axis_px[0], shape[0] - 1 - axis_px[1])
    side = 2.0 * max(radius, 8.0)
    points = min(int(side), MAX_SIDE) // 4 * 4
    return Grid((0.0, 0.0), side / points * pixel_um / 1000.0, (points, points))


def _turned_back(image: Image, place: Placement, grid: Grid, scale: float) -> Image:
    """The picture on the raster, its noise alike in light and dark; NaN where it has no value."""
    calm = np.sqrt(np.maximum(image, 0.0, dtype=np.float32))
    if scale > 1.0:
        calm = np.asarray(cv2.GaussianBlur(calm, (0, 0), 0.35 * scale), dtype=np.float32)
    return resample(calm, place, grid)


def _window(side: int, margin: float, soft: float) -> Image:
    """1 within a circle, falling over ``soft`` points to 0 at the distance ``margin`` inside the inscribed one."""
    at = np.arange(side, dtype=np.float32) - (side - 1) / 2.0
    inside = np.clip((side / 2.0 - margin - np.hypot(at[:, None], at)) / soft, 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * inside), dtype=np.float32)


def _aligned(first: Image, other: Image, reach: float, name: str) -> Fit:
    """How the other picture, turned back, lies on the first one.

    Args:
        first: (side, side) picture.
        other: likewise.
        reach: largest shift, in points.
        name: of the other picture, for messages.
    """
    side = first.shape[0]
    window = _window(side, _MARGIN, 0.15 * side)
    fine = [directions(picture, FINE_PX) for picture in (first, other)]
    surface = all_shifts(fine[0], fine[1], window)
    shift, peak, second = clearest(surface)
    if peak < MIN_PEAK:
        raise RegistrationError(
            f"{name} the picture shows too little structure in common with the first one (correlation {peak:.2f}, at "
            f"least {MIN_PEAK:g} needed): is it the same part, in focus, lit, and inside the picture? else {_ADVICE}"
        )
    if second > MAX_SECOND_PEAK:
        raise RegistrationError(
            f"{name} the picture fits in several places about as well (second peak {second:.0%} of the first, "
            f"limit {MAX_SECOND_PEAK:.0%}): ridges look alike after every pitch, or the part slipped; show the part's "
            f"outline, or {_ADVICE}"
        )
    if float(np.hypot(*shift)) > reach:
        raise RegistrationError(
            f"{name} the edges fit only {np.hypot(*shift) / side:.0%} of the picture away from where the stage says: "
            f"did the part slip? else {_ADVICE}"
        )
    window = _window(side, _MARGIN + float(np.hypot(*shift)), _MARGIN)
    coarse = [directions(picture, COARSE_PX) for picture in (first, other)]
    fit = refined(fine[0], fine[1], refined(coarse[0], coarse[1], shifted(shift), window).warp, window)
    if fit.score < MIN_SCORE:
        raise RegistrationError(
            f"{name} the edges are not surely those of the first picture (correlation {fit.score:.2f}, at least "
            f"{MIN_SCORE:g} needed): is it the same part, in focus and lit? else {_ADVICE}"
        )
    return fit


def _moved(nominal: Placement, warp: FloatArray, grid: Grid, residual_px: float) -> Placement:
    """The placement under which the picture fits the first one."""
    to_mm = grid.to_mm()
    motion = to_mm @ np.vstack([warp, [0.0, 0.0, 1.0]]) @ np.linalg.inv(to_mm)
    matrix = nominal.matrix @ motion
    turn = float(np.degrees(np.arctan2(motion[1, 0], motion[0, 0])))
    axis = (float(matrix[0, 2]), float(matrix[1, 2]))
    return Placement(matrix, (nominal.angle_deg + turn) % 360.0, nominal.pixel_um, axis, residual_px, 0)


def _about_the_axis(places: list[Placement]) -> list[Placement]:
    """The same placements with the origin in the point that moves least: the rotation axis."""
    turned = [place for place in places[1:] if np.abs(place.matrix - places[0].matrix)[:, :2].max() > 1e-3]
    if not turned:
        return places
    design = np.concatenate([place.matrix[:, :2] - places[0].matrix[:, :2] for place in turned])
    wanted = np.concatenate([places[0].matrix[:, 2] - place.matrix[:, 2] for place in turned])
    origin = np.linalg.lstsq(design, wanted, rcond=None)[0]
    found = []
    for place in places:
        matrix = place.matrix.copy()
        matrix[:, 2] += matrix[:, :2] @ origin
        axis = (float(matrix[0, 2]), float(matrix[1, 2]))
        found.append(Placement(matrix, place.angle_deg, place.pixel_um, axis, place.residual_px, 0))
    return found


def _check(seen: Seen, place: Placement, first: Placement) -> None:
    """Does the picture stand where stage and axis say?"""
    off = float(np.hypot(*np.subtract(place.axis_px, first.axis_px)))
    turn = (place.angle_deg - seen.stage_deg + 180.0) % 360.0 - 180.0
    if off > MAX_SHIFT_PX or abs(turn) > MAX_TURN_DEG:
        raise RegistrationError(
            f"at {seen.stage_deg:g}° the edges place the part {off:.1f} px and {turn:+.2f}° from where the rotation "
            f"axis and the stage say (limits {MAX_SHIFT_PX:g} px, {MAX_TURN_DEG:g}°): did the part slip, or is the "
            "rotation axis not where it was calibrated?"
        )
    if place.residual_px > MAX_RESIDUAL_PX:
        raise RegistrationError(
            f"at {seen.stage_deg:g}° parts of the picture leave {place.residual_px:.2f} px of doubt (limit "
            f"{MAX_RESIDUAL_PX:g} px): check focus and tilt, or {_ADVICE}"
        )
