"""Walls and crests that fall between the points of a height map: their profile, fitted to the map, and its light.

A wall is a pixel or two wide. Which points fall on it changes the light that a map seems to reflect, and the groove in
which light is reflected between facet and wall. So the profile of the ridges, with its wall and its crest, is fitted to
the points next to the walls; then

    L = L(map) + [L(profile) − L(profile at the points of the map)],

where the last two have the roughness of lobe and map together. What the points of the map do to crests and walls, and
what is missing there, is the same in the first and the last term and drops out, wherever the ridges run on the grid.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.sensitivity import ALPHA_RANGE
from anisoscope.prediction.wall_fit import (
    DEEP,
    FEWEST_PLACES,
    MISFIT,
    WINDOW_PIXELS,
    WINDOW_SHARE,
    WallFit,
    binned_heights,
    fitted_wall,
    with_wall,
)
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.metrology.ridgemeasurement import RidgeMeasurement
from anisoscope.profiles.period import MIN_SCORE, Period
from anisoscope.sim.light import corrected
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.relief import radiance as relief_radiance

LEAST_ANGLE_DEG, LARGEST_ANGLE_DEG = 0.2, 44.0
MANY_PITCHES = 6.0  # in which ridges are found wherever they run
MEASURABLE_POINTS = 16  # of a map, along and across

MOST_POINTS = 200_000
BAND_ROWS = 160
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
        design = with_wall(self.design, self.design.wall + draft, self.design.edge_radius_um + radius)
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
        height = self.design.profile(across_um(surface, self.azimuth_deg, rows) - self.crest_um)
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

    Pitch, ridge angle, direction and the radius of the foot are those measured. Place of the wall, its draft and the
    radius of the crest follow from the median heights about the wall, as far as these show them; for the rest the wall
    is perpendicular within 6° and the radius 0.75 ± 0.75 µm. A level top is taken from the measurement, where it fits
    better than a round one.

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
    foot = found.foot_radius_um.value or 0.0
    tops = [
        RidgeDesign(pitch, angle, angle, one, foot_radius_um=foot)
        for one in ((0.0,) if loss is None else (0.0, loss))
    ]
    direction = found.direction_deg.value
    assert direction is not None
    turned = np.cos(np.radians(found.lean_deg - direction)) < 0.0
    azimuth = _snapped(relief, direction + (180.0 if turned else 0.0))
    wall = next((one.position_um for one in found.ridges), None)
    if wall is None:
        return None
    pixel = step_um(relief.surface, azimuth)
    place, height, sigma = _about_the_wall(relief.surface, azimuth, pitch, wall, pixel)
    if place.size < FEWEST_PLACES:
        return None
    fits = [fitted_wall(place, height, sigma, one, pixel) for one in tops]
    best = min(fits, key=lambda one: one.square)
    if best.misfit > MISFIT * best.top.height_um:
        return None
    resolved = found.alpha_along.value or 0.0, found.alpha_across.value or 0.0
    edges = RidgeEdges(relief, best.design, azimuth, wall + float(best.mean[0]), resolved, best.steps)
    return with_other_tops(edges, fits, place.size)


def with_other_tops(edges: RidgeEdges, fits: list[WallFit], points: int) -> RidgeEdges:
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


def step_um(surface: HeightMap, azimuth_deg: float) -> float:
    """Distance across the ridges of neighbouring points, the smaller of row and column."""
    cos, sin = abs(np.cos(np.radians(azimuth_deg))), abs(np.sin(np.radians(azimuth_deg)))
    return float(min(surface.pixel_x_um / max(cos, 1e-9), surface.pixel_y_um / max(sin, 1e-9)))


def across_um(surface: HeightMap, azimuth_deg: float, rows: slice | npt.NDArray[np.intp]) -> FloatArray:
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
    offset = across_um(surface, azimuth_deg, chosen) - wall
    ridge = np.floor(offset / pitch + 0.5)
    offset = offset - ridge * pitch
    half = max(WINDOW_PIXELS * pixel, WINDOW_SHARE * pitch)
    height = surface.height_um[chosen]
    use = (np.abs(offset) <= half) & np.isfinite(height)
    return binned_heights(offset[use], height[use], ridge[use], pixel, half)
