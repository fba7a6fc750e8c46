"""Walls and crests that fall between the points of a height map: their profile, fitted to the map, and its light.

A wall is a pixel or two wide. Which points fall on it changes the light that a map seems to reflect, and the groove in
which light is reflected between facet and wall. So the profile of the ridges, with its wall and its crest, is fitted to
the points next to the walls; then

    L = L(map) + [L(profile) − L(profile at the points of the map)],

where the last two have the roughness of lobe and map together. What the points of the map do to crests and walls, and
what is missing there, is the same in the first and the last term and drops out, wherever the ridges run on the grid.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.prediction.sensitivity import ALPHA_RANGE
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import STEEPEST_DRAFT_DEG, RidgeDesign
from anisoscope.profiles.metrology.ridgemeasurement import RidgeMeasurement
from anisoscope.profiles.period import MIN_SCORE, Period
from anisoscope.sim.light import corrected
from anisoscope.sim.light.material import Material
from anisoscope.sim.light.relief import Relief, radiance_maps
from anisoscope.sim.light.relief import radiance as relief_radiance

LEAST_ANGLE_DEG, LARGEST_ANGLE_DEG = 0.2, 44.0
MANY_PITCHES = 6.0  # in which ridges are found wherever they run
MEASURABLE_POINTS = 16  # of a map, along and across

DRAFT_U_DEG = 6.0
"""Of a wall of which the map shows nothing, about the perpendicular one: walls stand within 0° and 20°."""
RADIUS_UM, RADIUS_U_UM = 0.75, 0.75
"""Of a crest of which the map shows nothing."""
LARGEST_RADIUS = 0.2  # of the pitch

WINDOW_PIXELS, WINDOW_SHARE = 6.0, 0.06  # points of the fit on either side of the wall; of the pitch at least
BINS_A_PIXEL = 8
MOST_POINTS = 200_000
FEWEST_PLACES = 4
PLACES, GRID, ZOOMS = 31, 11, 8  # of the grid of places, of drafts and radii; how often it is narrowed
DEEP, SETTLED = (
    14.0,
    0.5,
)  # of the posterior: −2 ln of what is left out; share of the grid that is not narrowed further
STEEP_DEG, MOST_DRAFT_DEG = 25.0, 35.0
LEAST_SIGMA, PLACE_SIGMA = 0.005, 0.03  # of a pixel: of heights in a bin, and of its place
MISFIT = 0.08  # of the height of the ridges: rms of the heights about the fitted profile
BAND_ROWS = 160
MARGIN, LEAST_DEEP, CLEAR_PIXELS = 5, 0.4, 2.5
"""Points next to borders of fields that are left out; share of the points that must be left; points about walls whose
slopes do not count as roughness."""
TOP, LEAST_LOSS, MOST_LOSS, OF_LOSS = 0.99, 0.02, 0.9, (0.85, 0.93, 1.0, 1.1)
"""Quantile of the heights of fields, height losses from which on a level top is tried, and up to which, and shares of
the loss by the quantile that are tried."""
PASSES, STARTS, STEPPED, OTHER_PITCH, PLACED = 6, (1.0, 1.15, 1.3), 0.03, 0.5, 3
IN_STEP = 0.6
"""Passes in which the pitch is found, from the one by the height of the ridges and from greater ones, unless facets are
steps apart within a share of the height; by how much it may differ from that; passes of places and profile;
and how far walls of a field are in step, as a share of what is usual."""
MOVED = (1.0, 31), (0.1, 13), (0.015, 7)
"""Reach in pixels, and number, of the places tried for a field; each pass starts from the last."""
ALPHA_OF_MAD = 1.4826 * 2.0**0.5
PLAIN_ROWS = 3


class SeveralDirectionsError(HeightMapError):
    """Ridges of several directions on one map, which no single frame of a lobe fits."""


@dataclass(frozen=True, eq=False)
class RidgeEdges:
    """Profile of the ridges of a map, with its uncertainty.

    Attributes:
        relief: the map, prepared.
        design: pitch, ridge angle, wall and crest.
        azimuth_deg: toward which the facets fall, on the map.
        crest_um: place of a crest from the first point of the map, in that direction.
        resolved: roughness along and across that the map resolves.
        steps: (3, 3) principal standard deviations of place [µm], draft [°] and edge radius [µm], one a row.
        others: profiles with other tops, level or round, which the points allow too, each with its probability.
    """

    relief: Relief
    design: RidgeDesign
    azimuth_deg: float
    crest_um: float
    resolved: tuple[float, float]
    steps: FloatArray
    others: tuple[tuple["RidgeEdges", float], ...] = ()

    @property
    def lean_deg(self) -> float:
        """Azimuth toward which the facets lean in the sample frame: 0, or 180 on a map that is not placed by them."""
        return 0.0 if np.cos(np.radians(self.azimuth_deg - self.relief.turn_deg)) > 0.0 else 180.0

    def stepped(self, number: int, sign: float) -> "RidgeEdges":
        """The profile one principal standard deviation away."""
        place, draft, radius = sign * self.steps[number]
        assert not isinstance(self.design.wall, str)
        design = _design(self.design, self.design.wall + draft, self.design.edge_radius_um + radius)
        return replace(self, design=design, crest_um=self.crest_um + float(place))

    def rougher(self, material: Material) -> Material:
        """The plastic with the roughness of lobe and map together."""
        return replace(
            material,
            alpha_along=min(float(np.hypot(material.alpha_along, self.resolved[0])), ALPHA_RANGE[1]),
            alpha_across=min(float(np.hypot(material.alpha_across, self.resolved[1])), ALPHA_RANGE[1]),
        )

    def light(self, to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
        """(P,) direct light in 1/sr that the points of the map miss (or, below 0, add), for (P, 3) unit vectors."""
        rough, turn = self.rougher(material), self._turn
        whole = corrected.radiance(to_light @ turn, to_camera @ turn, self.design, rough)
        return np.asarray(whole - relief_radiance(self.sampled, to_light, to_camera, rough))

    def indirect(
        self, to_light: FloatArray, to_camera: FloatArray, material: Material, bounces: int | None
    ) -> FloatArray:
        """(P,) light in 1/sr that reflects twice and more between the fitted facet and wall."""
        turn, rough = self._turn, self.rougher(material)
        return corrected.indirect_radiance(to_light @ turn, to_camera @ turn, self.design, rough, bounces)

    def uncertainty(
        self, to_light: FloatArray, to_camera: FloatArray, material: Material, indirect: FloatArray | None
    ) -> FloatArray:
        """(3, P) changes of the radiance in 1/sr by one principal standard deviation of the profile each.

        A fourth row is the root mean square change by other tops, where the points of the map allow any.

        Args:
            to_light: (P, 3) unit vectors.
            to_camera: (P, 3) unit vectors.
            material: the plastic, with the roughness that the map does not resolve.
            indirect: (P,) light in 1/sr that reflects twice and more; None for direct light alone.
        """
        sides = to_light, to_camera, material

        def light(edges: RidgeEdges) -> FloatArray:
            direct = edges.light(*sides)
            return direct if indirect is None else direct + edges.indirect(*sides, 2)

        nominal = light(self)
        found = []
        for number in range(len(self.steps)):
            up, down = (light(self.stepped(number, sign)) - nominal for sign in (1.0, -1.0))
            found.append(np.where(np.abs(up) > np.abs(down), up, -down))
        if self.others:
            squares = [share * (light(one) - nominal) ** 2 for one, share in self.others]
            found.append(np.sqrt(np.sum(squares, axis=0)))
        return np.array(found)

    @property
    def _turn(self) -> FloatArray:
        return np.diag([-1.0, -1.0, 1.0]) if self.lean_deg else np.eye(3)

    @cached_property
    def sampled(self) -> Relief:
        """The profile at the points of the map, missing where these are; on a band of rows that stands for all."""
        surface = self.relief.surface
        along_grid = abs(self.azimuth_deg - 90.0 * round(self.azimuth_deg / 90.0)) < 1e-9
        known = np.isfinite(surface.height_um)
        rows = slice(0, PLAIN_ROWS) if along_grid and known.all() else _band(known)
        height = self.design.profile(_across(surface, self.azimuth_deg, rows) - self.crest_um)
        height[~known[rows]] = np.nan
        return replace(self.relief, surface=surface.with_height(height), max_missing_share=1.0)


@lru_cache(maxsize=4)
def measured_ridges(relief: Relief) -> RidgeMeasurement | None:
    """The ridges of a map; None where it holds too little of them."""
    if min(relief.surface.shape) < MEASURABLE_POINTS:
        return None
    from anisoscope.profiles.metrology.ridges import measure_ridges  # noqa: PLC0415 - numba when first needed

    try:
        with np.errstate(divide="ignore", invalid="ignore"):  # maps without noise have no limit of outliers
            return measure_ridges(relief.surface)
    except HeightMapError:
        return None


def check_one_direction(relief: Relief, period: Period, material: Material) -> None:
    """Refuse maps with ridges of several directions where the lobe is wider across the ridges than along them.

    A lobe that is as wide along as across has no direction.

    Raises:
        SeveralDirectionsError: ridges of two directions; or a pitch is given, and many pitches of the map show no
            ridges.
    """
    if material.alpha_along == material.alpha_across:
        return
    surface, cure = (
        relief.surface,
        "crop the map to ridges of one direction, or give alpha_along = alpha_across",
    )
    if period.score >= MIN_SCORE:
        found = measured_ridges(relief)
        second = None if found is None else found.second_direction_deg
        if second is not None:
            assert found is not None
            assert found.direction_deg.value is not None
            apart = abs((second - found.direction_deg.value + 90.0) % 180.0 - 90.0)
            raise SeveralDirectionsError(
                f"the height map has ridges of two directions, {apart:.0f}° apart: {cure}"
            )
        return
    if period.is_periodic and min(surface.extent_um) >= MANY_PITCHES * period.pitch_um:
        raise SeveralDirectionsError(
            f"the height map shows no ridges of one direction {period.pitch_um:g} µm apart, along which a lobe of "
            f"alpha_along {material.alpha_along:g} and alpha_across {material.alpha_across:g} could lie: {cure}"
        )
    from anisoscope.profiles.metrology.ridges import directions_of_parts  # noqa: PLC0415 - numba when first needed

    parts = directions_of_parts(surface)
    if len(parts) > 1:
        named = ", ".join(f"{one:.0f}°" for one in parts)
        raise SeveralDirectionsError(f"the height map has ridges of several directions, {named}: {cure}")


@lru_cache(maxsize=4)
def ridge_edges(relief: Relief) -> RidgeEdges | None:
    """Fit the profile of the ridges of a map to the points next to its walls.

    Pitch, ridge angle and direction are those measured. Place of the wall, its draft and the radius of the crest follow
    from the median heights about the wall, as far as these show them; for the rest the wall is perpendicular within 6°
    and the radius 0.75 ± 0.75 µm. A level top is taken from the measurement, where it fits better than a round one.

    Args:
        relief: the map, prepared.

    Returns:
        The profile; None where there are no ridges with straight facets, or their walls have another shape.
    """
    found = measured_ridges(relief)
    if found is None or not found.straight or found.second_direction_deg is not None:
        return None
    pitch, angle = found.pitch_um.value, found.ridge_angle_deg.value
    if pitch is None or angle is None or not LEAST_ANGLE_DEG <= angle <= LARGEST_ANGLE_DEG:
        return None
    loss = found.height_loss.value if found.plateau else None
    tops = [RidgeDesign(pitch, angle, angle, one) for one in ((0.0,) if loss is None else (0.0, loss))]
    direction = found.direction_deg.value
    assert direction is not None
    turned = np.cos(np.radians(found.lean_deg - direction)) < 0.0
    azimuth = _snapped(relief, direction + (180.0 if turned else 0.0))
    wall = next((one.position_um for one in found.ridges), None)
    if wall is None:
        return None
    pixel = _step_um(relief.surface, azimuth)
    place, height, sigma = _about_the_wall(relief.surface, azimuth, pitch, wall, pixel)
    if place.size < FEWEST_PLACES:
        return None
    fits = [_Fit(one, *_fitted(place, height, sigma, one, pixel)) for one in tops]
    best = min(fits, key=lambda one: one.square)
    if best.misfit > MISFIT * best.top.height_um:
        return None
    resolved = found.alpha_along.value or 0.0, found.alpha_across.value or 0.0
    edges = RidgeEdges(relief, best.design, azimuth, wall + float(best.mean[0]), resolved, best.steps)
    return _with_others(edges, fits, place.size)


@dataclass(frozen=True, eq=False)
class _Fit:
    """What `_fitted` gives for ridges with one top."""

    top: RidgeDesign
    mean: FloatArray
    steps: FloatArray
    misfit: float
    square: float

    @property
    def design(self) -> RidgeDesign:
        return _design(self.top, self.mean[1], self.mean[2])


def _with_others(edges: RidgeEdges, fits: list[_Fit], points: int) -> RidgeEdges:
    """The best profile with those of other tops that the points do not rule out."""
    best = min(fits, key=lambda one: one.square)
    birge = max(1.0, best.square / max(points - 3, 1))
    apart = [(one.square - best.square) / birge for one in fits]
    weights = [np.exp(-0.5 * one) if one < DEEP else 0.0 for one in apart]
    others = [
        (
            replace(edges, design=one.design, crest_um=edges.crest_um + float(one.mean[0] - best.mean[0])),
            share,
        )
        for one, share in zip(fits, np.array(weights) / sum(weights), strict=True)
        if one is not best and share > 0.0
    ]
    return replace(edges, others=tuple(others))


def _snapped(relief: Relief, azimuth_deg: float) -> float:
    """The direction itself, but that of the grid where nothing but rounding parts them over the map."""
    quarter = 90.0 * round(azimuth_deg / 90.0)
    reach = max(relief.surface.extent_um)
    off = abs(np.radians(azimuth_deg - quarter)) * reach
    return quarter if off < 0.02 * min(relief.pixels_um) else azimuth_deg


def _design(design: RidgeDesign, draft_deg: float, radius_um: float) -> RidgeDesign:
    """The ridges with another wall and crest, within what ridges can have."""
    draft = float(np.clip(draft_deg, 0.0, STEEPEST_DRAFT_DEG))
    radius = float(np.clip(radius_um, 0.0, LARGEST_RADIUS * design.pitch_um))
    return replace(design, wall=draft, edge_radius_um=radius if design.height_loss == 0.0 else 0.0)


def _step_um(surface: HeightMap, azimuth_deg: float) -> float:
    """Distance across the ridges of neighbouring points, the smaller of row and column."""
    cos, sin = abs(np.cos(np.radians(azimuth_deg))), abs(np.sin(np.radians(azimuth_deg)))
    return float(min(surface.pixel_x_um / max(cos, 1e-9), surface.pixel_y_um / max(sin, 1e-9)))


def _across(surface: HeightMap, azimuth_deg: float, rows: slice | npt.NDArray[np.intp]) -> FloatArray:
    """(rows, cols) place in µm along an azimuth from the first point."""
    angle = np.radians(azimuth_deg)
    y = np.arange(surface.shape[0])[rows] * surface.pixel_y_um
    along_x = np.cos(angle) * np.arange(surface.shape[1]) * surface.pixel_x_um
    return np.asarray(np.add.outer(np.sin(angle) * y, along_x))


def _band(known: npt.NDArray[np.bool_]) -> slice:
    """Neighbouring rows in which about as many heights are missing as in the whole map."""
    count = min(len(known), BAND_ROWS)
    total = np.concatenate([[0], np.cumsum(known.sum(axis=1))])
    share = (total[count:] - total[:-count]) / (count * known.shape[1])
    start = int(np.argmin(np.abs(share - known.mean())))
    return slice(start, start + count)


def _about_the_wall(
    surface: HeightMap, azimuth_deg: float, pitch: float, wall: float, pixel: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n,) places about the wall in µm, median heights of all ridges there, and their standard deviations."""
    rows, cols = surface.shape
    step = max(1, -(-rows * cols // MOST_POINTS))
    chosen = np.arange(0, rows, step)
    offset = _across(surface, azimuth_deg, chosen) - wall
    ridge = np.floor(offset / pitch + 0.5)
    offset = offset - ridge * pitch
    half = max(WINDOW_PIXELS * pixel, WINDOW_SHARE * pitch)
    height = surface.height_um[chosen]
    use = (np.abs(offset) <= half) & np.isfinite(height)
    return _binned(offset[use], height[use], ridge[use], pixel, half)


def _binned(
    offset: FloatArray, height: FloatArray, ridge: FloatArray, pixel: float, half: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """As `_about_the_wall`, of (N,) points with the number of the ridge on which each lies."""
    index = np.floor((offset + half) * BINS_A_PIXEL / pixel).astype(np.intp)
    order = np.lexsort((height, index))
    offset, height, ridge, index = offset[order], height[order], ridge[order], index[order]
    starts = np.flatnonzero(np.diff(index, prepend=-1))
    counts = np.diff(np.append(starts, index.size))
    place = np.add.reduceat(offset, starts) / counts
    low, middle, high = (height[starts + (counts * share).astype(np.intp)] for share in (0.25, 0.5, 0.75))
    even = counts % 2 == 0
    before = height[starts + np.maximum(counts // 2 - 1, 0)]
    median = np.where(even, 0.5 * (middle + before), middle)
    ridges = np.unique(ridge).size
    scatter = (high - low) / 1.349 / np.sqrt(np.minimum(counts, ridges))
    usual = float(np.median(scatter))
    median = np.asarray(median)
    slope = np.gradient(median, place) if place.size > 1 else np.zeros(1)
    if (
        place.size * pixel < BINS_A_PIXEL * half
    ):  # few places, some of which differ by no more than they are known
        ends = (np.interp(place + side * 0.5 * pixel, place, median) for side in (1.0, -1.0))
        slope = np.maximum(np.abs(slope), np.abs(np.subtract(*ends)) / pixel)
    sigma = np.sqrt(
        np.maximum(scatter, usual) ** 2 + pixel**2 * (LEAST_SIGMA**2 + (PLACE_SIGMA * slope) ** 2)
    )
    return place, median, np.asarray(sigma)


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
    across, pixel = _across(surface, azimuth, slice(None)), _step_um(surface, azimuth)
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
    return FieldEdges(_with_others(edges, fits, points), replace(relief, surface=drawn), inside, smooth)


def _fitted_fields(
    at: FloatArray,
    height: FloatArray,
    field: npt.NDArray[np.int32],
    places: FloatArray,
    plain: RidgeDesign,
    pixel: float,
) -> tuple[list[_Fit], int, RidgeDesign, FloatArray] | None:
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
        points = _binned(offset[near], heights[near], (ridge + 1e3 * field)[near], pixel, half)
        if points[0].size < FEWEST_PLACES:
            return None
        loss = float(np.clip(1.0 - np.quantile(heights, TOP) / plain.height_um, 0.0, MOST_LOSS))
        losses = (0.0,) if loss < LEAST_LOSS else (0.0, *(loss * np.array(OF_LOSS)))
        tops = [replace(plain, height_loss=float(one)) for one in losses]
        fits = [_Fit(one, *_fitted(*points, one, pixel)) for one in tops]
        best = min(fits, key=lambda one: one.square)
        shift, design = _closest(*points, best, (0.5 * pixel, pixel))
        if design.height_loss > 0.0:  # the loss itself, and not only the nearest of those tried
            top = replace(plain, height_loss=design.height_loss)
            fits.append(_Fit(top, *_fitted(*points, top, pixel)))
            best = min(fits, key=lambda one: one.square)
        moved = _moved(offset[near] - shift, heights[near], field[near], design, pixel, len(places))
        places = places + shift + moved
        if best.misfit <= MISFIT * best.top.height_um:
            return fits, points[0].size, design, places
    return None


def _closest(
    place: FloatArray, height: FloatArray, sigma: FloatArray, fit: _Fit, radii_um: tuple[float, ...]
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
        return _design(top, x[1], 0.0 if level else x[2])

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


def _fitted(
    place: FloatArray, height: FloatArray, sigma: FloatArray, plain: RidgeDesign, pixel: float
) -> tuple[FloatArray, FloatArray, float, float]:
    """(3,) mean of place, draft and radius; (3, 3) their principal standard deviations; of the best misfit in µm, χ².

    The posterior is summed over a grid of all three, which is narrowed until it holds little else: a wall on which one
    point or none falls has a posterior with edges, of which a least-squares fit knows nothing.
    """
    reach = max(2.0 * pixel, plain.wall_width_um)
    largest = min(
        LARGEST_RADIUS * plain.pitch_um, 0.5 * WINDOW_PIXELS * pixel + 0.5 * WINDOW_SHARE * plain.pitch_um
    )
    least = np.array([-reach, 0.0, 0.0])
    most = np.array(
        [reach, STEEPEST_DRAFT_DEG if plain.ridge_angle_deg > STEEP_DEG else MOST_DRAFT_DEG, largest]
    )
    grids = _axes(least, most)
    grids[2] = largest * np.linspace(0.0, 1.0, GRID) ** 2
    narrowed = 0
    while True:
        square, misfit = _squares(place, height, sigma, plain, grids)
        at = np.unravel_index(int(square.argmin()), square.shape)
        birge = max(1.0, float(misfit[at]) / max(place.size - 3, 1))
        depth = (square - square.min()) / birge
        ends, settled = [], True
        for axis, grid in enumerate(grids):
            profile = depth.min(axis=tuple(other for other in range(3) if other != axis))
            inside = np.flatnonzero(profile < DEEP)
            low, high = max(inside[0] - 1, 0), min(inside[-1] + 1, grid.size - 1)
            settled &= bool(high - low >= SETTLED * (grid.size - 1))
            ends.append((grid[low], grid[high]))
        narrowed += 1
        if settled or narrowed == ZOOMS:
            break
        grids = _axes(*(np.array(side) for side in zip(*ends, strict=True)))
    widths = [np.gradient(grid) for grid in grids]
    weight = np.exp(-0.5 * depth) * widths[0][:, None, None] * widths[1][:, None] * widths[2]
    weight /= weight.sum()
    points = np.stack(np.meshgrid(*grids, indexing="ij"), axis=-1).reshape(-1, 3)
    mean = weight.ravel() @ points
    covariance = (points - mean).T @ ((points - mean) * weight.reshape(-1, 1))
    scale = np.array([pixel, DRAFT_U_DEG, RADIUS_U_UM])
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    steps = (vectors * np.sqrt(np.maximum(values, 0.0))).T * scale
    best = [float(grid[index]) for grid, index in zip(grids, at, strict=True)]
    left = height - _design(plain, best[1], best[2]).profile(place - best[0])
    return mean, np.asarray(steps), float(np.std(left)), float(misfit.min())


def _axes(least: FloatArray, most: FloatArray) -> list[FloatArray]:
    """Grid of place, draft and radius between two corners."""
    return [np.linspace(a, b, n) for a, b, n in zip(least, most, (PLACES, GRID, GRID), strict=True)]


def _squares(
    place: FloatArray, height: FloatArray, sigma: FloatArray, plain: RidgeDesign, grids: list[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """(places, drafts, radii) sums of squares with what is known before, and those of the heights alone.

    Large misfits count linearly (pseudo-Huber), and the level of the heights is free.
    """
    places, drafts, radii = grids
    heights = np.empty((places.size, drafts.size, radii.size))
    offset = place - places[:, None]
    for j, draft in enumerate(drafts):
        for k, radius in enumerate(radii):
            left = height - _design(plain, draft, radius).profile(offset)
            left = (left - np.median(left, axis=1, keepdims=True)) / sigma
            heights[:, j, k] = np.sum(2.0 * (np.sqrt(1.0 + left**2) - 1.0), axis=1)
    before = ((drafts - plain.ridge_angle_deg) / DRAFT_U_DEG)[:, None] ** 2 + (
        (radii - RADIUS_UM) / RADIUS_U_UM
    ) ** 2
    return heights + before, heights
