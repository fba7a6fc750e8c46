"""Walls and crests of small fields of ridges: one profile of all fields of a direction, and its light.

A field of two ridges shows too little of its walls to fit a profile to it alone. Each field has a place of its own.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import STEEPEST_DRAFT_DEG, RidgeDesign
from anisoscope.prediction.ridge_edges import RidgeEdges, across_um, step_um, with_other_tops
from anisoscope.prediction.wall_fit import (
    FEWEST_PLACES,
    LARGEST_RADIUS,
    LEAST_SIGMA,
    MISFIT,
    PLACE_SIGMA,
    WINDOW_PIXELS,
    WINDOW_SHARE,
    WallFit,
    binned_heights,
    fitted_wall,
    with_wall,
)
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light import corrected
from anisoscope.sim.light.relief import Relief, radiance_maps

MARGIN, LEAST_DEEP, CLEAR_PIXELS = 5, 0.4, 2.5
"""Points next to borders of fields that are left out; share of the points that must be left; points about walls whose
slopes do not count as roughness."""
TOP, LEAST_LOSS, MOST_LOSS, OF_LOSS = 0.99, 0.02, 0.9, (0.85, 0.93, 1.0, 1.1)
"""Quantile of the heights of fields, height losses from which on a level top is tried, and up to which, and shares of
the loss by the quantile that are tried."""
PASSES, STARTS, STEPPED, OTHER_PITCH, PLACED = 6, (1.0, 1.15, 1.3), 0.03, 0.5, 3
"""Passes in which the pitch is found, from the one by the height of the ridges and from greater ones, unless facets are
steps apart within a share of the height; by how much it may differ from that; passes of places and profile."""
IN_STEP = 0.6
"""How far walls of a field are in step, as a share of what is usual."""
MOVED = (1.0, 31), (0.1, 13), (0.015, 7)
"""Reach in pixels, and number, of the places tried for a field; each pass starts from the last."""
ALPHA_OF_MAD = 1.4826 * 2.0**0.5


@dataclass(frozen=True, eq=False)
class FieldEdges:
    """Profile of the ridges of fields that hold few of them, from all fields of one direction together.

    Attributes:
        edges: the profile; its relief is the map.
        sampled: the map with the profile closest to its points in these fields, each at its own place.
        inside: (rows − 1, cols − 1) facets of the fields, away from their borders.
        clear: the same, those that are some points away from walls.
    """

    edges: RidgeEdges
    sampled: Relief
    inside: npt.NDArray[np.bool_]
    clear: npt.NDArray[np.bool_]

    def unexplained(self, to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
        """(P,) direct light in 1/sr, of facets about walls, that the map shows and the profile does not."""
        about = self.inside & ~self.clear
        shown, drawn = (
            np.array([float(np.nansum(each[about], dtype=float)) for each in maps])
            for maps in self._maps(to_light, to_camera, material)
        )
        return np.asarray((shown - drawn) / np.count_nonzero(self.inside))

    def _maps(
        self, to_light: FloatArray, to_camera: FloatArray, material: Material
    ) -> list[Iterator[npt.NDArray[np.float32]]]:
        rough = self.edges.rougher(material)
        return [
            radiance_maps(self.edges.relief, to_light, to_camera, material),
            radiance_maps(self.sampled, to_light, to_camera, rough),
        ]

    def light(self, to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
        """(P,) direct light of the fields in 1/sr: that of their facets, and what the points of the map miss."""
        rough = self.edges.rougher(material)
        whole = corrected.radiance(to_light, to_camera, self.edges.design, rough)
        shown, missed = (
            np.array([float(np.nanmean(each[self.inside], dtype=float)) for each in maps])
            for maps in self._maps(to_light, to_camera, material)
        )
        return np.asarray(shown + whole - missed)


def field_edges(relief: Relief, labels: npt.NDArray[np.int32], plain: RidgeDesign) -> FieldEdges | None:
    """Fit one profile to the ridges of many fields of one direction, each at a place of its own.

    Walls are where the surface rises along the azimuth toward which it falls elsewhere. Their common distance is the
    pitch, and what is left of their places the place of the ridges of a field. The heights of all fields about their
    walls are then fitted together, as in `ridge_edges`.

    Args:
        relief: the map; its facets fall toward ``turn_deg``.
        labels: (rows, cols) number of the field of every point, 0 beyond these fields.
        plain: pitch and ridge angle, roughly.

    Returns:
        The profile; None where the fields show no walls, or walls of another shape.
    """
    surface, azimuth = relief.surface, relief.turn_deg
    across, pixel = across_um(surface, azimuth, slice(None)), step_um(surface, azimuth)
    deep = _deep_labels(labels)
    numbers = np.where(deep[1:, 1:] == deep[:-1, :-1], deep[:-1, :-1], 0)
    cos, sin = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    fall_x, fall_y = _falls(surface)
    fall = cos * fall_x + sin * fall_y
    rising = (numbers > 0) & (fall < 0.0)  # false where missing
    middle = 0.5 * (across[1:, 1:] + across[:-1, :-1])
    known = (deep > 0) & np.isfinite(surface.height_um)
    walls, facets = (
        (middle[rising], -fall[rising], numbers[rising]),
        (across[known], surface.height_um[known], deep[known]),
    )
    pitch, places = _wall_places(walls, facets, plain, pixel, int(labels.max()))
    if not np.isfinite(places).any() or abs(pitch / plain.pitch_um - 1.0) > OTHER_PITCH:
        return None
    plain = replace(plain, pitch_um=pitch, wall=plain.ridge_angle_deg)
    here = known & np.isfinite(places[deep])
    height, field, at = surface.height_um[here], deep[here], across[here]
    fit = _fitted_fields(at, height, field, places, plain, pixel)
    if fit is None:
        return None
    fits, points, drawn_design, places = fit
    best = min(fits, key=lambda one: one.square)
    levels = _levels(height - drawn_design.profile(at - places[field]), field, len(places))
    sampled = surface.height_um.copy()
    known = np.isfinite(places[labels]) & (labels > 0) & np.isfinite(sampled)
    field = labels[known]
    sampled[known] = levels[field] + drawn_design.profile(across[known] - places[field])
    drawn = surface.with_height(sampled)
    inside = (numbers > 0) & np.isfinite(places[numbers])
    left_x, left_y = (a - b for a, b in zip((fall_x, fall_y), _falls(drawn), strict=True))
    with np.errstate(invalid="ignore"):  # beyond the fields
        off = np.abs((middle - places[numbers] + 0.5 * pitch) % pitch - 0.5 * pitch)
    smooth = inside & (off > CLEAR_PIXELS * pixel)
    along, along_x = cos * left_y - sin * left_x, cos * left_x + sin * left_y
    along, along_x = (np.abs(one[smooth & np.isfinite(one)]) for one in (along, along_x))
    if not along.size:
        return None
    resolved = float(ALPHA_OF_MAD * np.median(along)), float(ALPHA_OF_MAD * np.median(along_x))
    edges = RidgeEdges(relief, best.design, azimuth, float(best.mean[0]), resolved, best.steps)
    return FieldEdges(with_other_tops(edges, fits, points), replace(relief, surface=drawn), inside, smooth)


def _fitted_fields(
    at: FloatArray,
    height: FloatArray,
    field: npt.NDArray[np.int32],
    places: FloatArray,
    plain: RidgeDesign,
    pixel: float,
) -> tuple[list[WallFit], int, RidgeDesign, FloatArray] | None:
    """One profile of all fields for every top tried, number of points, profile closest to them, places of the fields.

    Args:
        at: (n,) places of points across the ridges in µm.
        height: (n,) their heights in µm.
        field: (n,) their fields.
        places: (fields + 1,) places of a wall of every field in µm.
        plain: pitch and ridge angle.
        pixel: distance of points across the ridges in µm.
    """
    half = max(WINDOW_PIXELS * pixel, WINDOW_SHARE * plain.pitch_um)
    for _ in range(PLACED):  # walls next to borders mislead the places of fields of two ridges
        offset = at - places[field]
        levels = _levels(height - plain.profile(offset), field, len(places))
        ridge = np.floor(offset / plain.pitch_um + 0.5)
        offset = offset - ridge * plain.pitch_um
        near = np.abs(offset) <= half
        heights = height - levels[field]
        points = binned_heights(offset[near], heights[near], (ridge + 1e3 * field)[near], pixel, half)
        if points[0].size < FEWEST_PLACES:
            return None
        loss = float(np.clip(1.0 - np.quantile(heights, TOP) / plain.height_um, 0.0, MOST_LOSS))
        losses = (0.0,) if loss < LEAST_LOSS else (0.0, *(loss * np.array(OF_LOSS)))
        tops = [replace(plain, height_loss=float(one)) for one in losses]
        fits = [fitted_wall(*points, one, pixel) for one in tops]
        best = min(fits, key=lambda one: one.square)
        shift, design = _closest(*points, best, (0.5 * pixel, pixel))
        if design.height_loss > 0.0:  # the loss itself, and not only the nearest of those tried
            top = replace(plain, height_loss=design.height_loss)
            fits.append(fitted_wall(*points, top, pixel))
            best = min(fits, key=lambda one: one.square)
        moved = _moved(offset[near] - shift, heights[near], field[near], design, pixel, len(places))
        places = places + shift + moved
        if best.misfit <= MISFIT * best.top.height_um:
            return fits, points[0].size, design, places
    return None


def _closest(
    place: FloatArray, height: FloatArray, sigma: FloatArray, fit: WallFit, radii_um: tuple[float, ...]
) -> tuple[float, RidgeDesign]:
    """Place and profile with the least misfit to the heights, whatever is known before, with a top of the same form.

    Args:
        place: (n,) places about the wall in µm.
        height: (n,) heights in µm.
        sigma: (n,) their standard deviations.
        fit: the profile from which the search starts.
        radii_um: other radii from which it starts.
    """
    from scipy import optimize  # noqa: PLC0415 - slow to import

    level = fit.top.height_loss > 0.0

    def profile(x: FloatArray) -> RidgeDesign:
        top = replace(fit.top, height_loss=float(x[2])) if level else fit.top
        return with_wall(top, x[1], 0.0 if level else x[2])

    def left(x: FloatArray) -> FloatArray:
        off = height - profile(x).profile(place - x[0])
        return np.asarray((off - np.median(off)) / sigma)

    most = MOST_LOSS if level else LARGEST_RADIUS * fit.top.pitch_um
    low, high = [-np.inf, 0.0, LEAST_LOSS if level else 0.0], [np.inf, STEEPEST_DRAFT_DEG, most]
    ends = (fit.top.height_loss,) if level else (fit.mean[2], *radii_um)
    scale = [1.0, 5.0, LEAST_LOSS if level else 1.0]
    found = [
        optimize.least_squares(
            left, np.clip([*fit.mean[:2], end], low, high), bounds=(low, high), loss="soft_l1", x_scale=scale
        )
        for end in ends
    ]
    best = min(found, key=lambda one: float(one.cost)).x
    return float(best[0]), profile(best)


def _deep_labels(labels: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """The labels away from borders between regions, as far as regions are wide enough."""
    import cv2  # noqa: PLC0415 - slow to import

    found = labels.copy()
    for margin in (MARGIN, 1):
        kernel = np.ones((2 * margin + 1,) * 2, np.uint8)
        floats = labels.astype(np.float32)
        found = np.where(cv2.erode(floats, kernel) == cv2.dilate(floats, kernel), labels, 0)
        if np.count_nonzero(found) > LEAST_DEEP * np.count_nonzero(labels):
            break
    return _largest_pieces(found)


def _largest_pieces(labels: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """The labels without what is not connected to the largest piece: corners of other fields of the class."""
    from scipy import ndimage  # noqa: PLC0415 - slow to import

    found = np.zeros_like(labels)
    for number, box in enumerate(ndimage.find_objects(labels), start=1):
        if box is not None:
            pieces = ndimage.label(labels[box] == number)[0]
            largest = int(np.bincount(pieces.ravel())[1:].argmax()) + 1
            found[box][pieces == largest] = number
    return found


def _falls(surface: HeightMap) -> tuple[FloatArray, FloatArray]:
    """(rows − 1, cols − 1) slopes of facets toward +x and +y, positive where they fall."""
    z = surface.height_um
    fall_x = 0.5 * (z[:-1, :-1] - z[:-1, 1:] + z[1:, :-1] - z[1:, 1:]) / surface.pixel_x_um
    fall_y = 0.5 * (z[:-1, :-1] - z[1:, :-1] + z[:-1, 1:] - z[1:, 1:]) / surface.pixel_y_um
    return fall_x, fall_y


def _wall_places(
    walls: tuple[FloatArray, FloatArray, npt.NDArray[np.int32]],
    facets: tuple[FloatArray, FloatArray, npt.NDArray[np.int32]],
    plain: RidgeDesign,
    pixel: float,
    fields: int,
) -> tuple[float, FloatArray]:
    """Pitch in µm, and (fields + 1,) place of a wall of every field; NaN where none is seen.

    The pitch is the fall from one facet to the line of the next, over the slope: crests and walls do not matter. Ridges
    that lost height have a greater pitch than their height says: the one whose facets are steps apart is taken.

    A field whose walls are far less in step than those of others is left out: a corner of another field may be in it.

    Args:
        walls: places across the ridges, weights and fields of what rises.
        facets: places, heights and fields of all points.
        plain: pitch and ridge angle, roughly.
        pixel: distance of points across the ridges.
        fields: greatest number of a field.
    """
    place, weight, field = walls
    at, height, of = facets
    slope = float(np.tan(np.radians(plain.ridge_angle_deg)))
    level = height + slope * at
    total = np.bincount(field, weight, fields + 1)
    least, best = np.inf, (plain.pitch_um, np.full(fields + 1, np.nan))
    for start in STARTS:
        pitch, left, found = start * plain.pitch_um, np.inf, np.full(fields + 1, np.nan)
        for _ in range(PASSES):
            turn = 2.0 * np.pi * place / pitch
            real, imaginary = (
                np.bincount(field, weight * part(turn), fields + 1) for part in (np.cos, np.sin)
            )
            together = np.hypot(real, imaginary) / np.maximum(total, 1e-300)
            usual = float(np.median(together[total > 0.0])) if total.any() else 0.0
            seen = (total > 0.0) & (together > max(IN_STEP * usual, 1e-9))
            found = np.where(seen, pitch * np.arctan2(imaginary, real) / (2.0 * np.pi), np.nan)
            with np.errstate(invalid="ignore"):  # fields without walls
                number, rest = np.divmod((at - found[of]) / pitch, 1.0)
                past = rest * pitch - max(pitch - plain.pitch_um, 0.0)  # the level top
                clear = np.minimum(past, (1.0 - rest) * pitch) > CLEAR_PIXELS * pixel
            here = of[clear]
            count = np.maximum(np.bincount(here, minlength=fields + 1), 1)
            along, up = (
                one[clear] - (np.bincount(here, one[clear], fields + 1) / count)[here]
                for one in (number, level)
            )
            if not along.any():  # one facet a field
                break
            pitch = float(along @ up / (along @ along)) / slope
            left = float(np.std(up - pitch * slope * along))
        if left < least or start == STARTS[0]:
            least, best = left, (pitch, found)
        if least < STEPPED * plain.height_um:
            break
    return best


def _moved(
    offset: FloatArray,
    height: FloatArray,
    field: npt.NDArray[np.int32],
    design: RidgeDesign,
    pixel: float,
    count: int,
) -> FloatArray:
    """(count,) by how much the walls of single fields lie farther along in µm, up to a pixel: posterior means."""
    points = np.maximum(np.bincount(field, minlength=count), 1)
    sigma = pixel * np.hypot(LEAST_SIGMA, PLACE_SIGMA)
    found = np.zeros(count)
    for reach, places in MOVED:
        tried = pixel * np.linspace(-reach, reach, places)
        squares = np.empty((places, count))
        for number, one in enumerate(tried):
            left = height - design.profile(offset - found[field] - one)
            left -= (np.bincount(field, left, count) / points)[field]
            squares[number] = np.bincount(field, 2.0 * (np.sqrt(1.0 + (left / sigma) ** 2) - 1.0), count)
        weight = np.exp(-0.5 * (squares - squares.min(axis=0)))
        found += tried @ weight / weight.sum(axis=0)
    return found


def _levels(height: FloatArray, field: npt.NDArray[np.int32], count: int) -> FloatArray:
    """(count,) median heights of fields, NaN of those without points."""
    order = np.argsort(field, kind="stable")
    parts = np.split(height[order], np.searchsorted(field[order], np.arange(1, count)))
    return np.array([np.median(one) if one.size else np.nan for one in parts])
