"""Prediction of height maps with ridges of several directions: every region in the frame of its own ridges.

The sample frame is that of the class of regions that takes the largest area; of several about equal ones that from
which the others lie clockwise, so that the answer does not depend on how the map lies on its grid. Light that goes
from one field into the next is left out, and so are the points next to borders where regions hold four ridges.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.base.json_fields import as_json
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.parameters.material import Material
from anisoscope.parameters.optics import POINT_LIKE, Optics
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.field_edges import FieldEdges, field_edges
from anisoscope.prediction.height_map_uncertainty import edge_contributions, pixel_bias
from anisoscope.prediction.monte_carlo import MonteCarlo
from anisoscope.prediction.predict import Reflect, Roughness, predict_design, predict_height_map
from anisoscope.prediction.predicted import Predicted
from anisoscope.prediction.propagation import SEATING
from anisoscope.prediction.reflections import groove_of_design
from anisoscope.prediction.relief_preparation import Levelling, turned_clockwise
from anisoscope.prediction.ridge_edges import (
    LARGEST_ANGLE_DEG,
    LEAST_ANGLE_DEG,
    SeveralDirectionsError,
)
from anisoscope.prediction.sensitivity import Budget, Contribution
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.level import level
from anisoscope.profiles.period import Period, find_period
from anisoscope.sim.light import corrected
from anisoscope.sim.light.census import Facets
from anisoscope.sim.light.contrasts import contrasts
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.optics import through
from anisoscope.sim.light.relief import MAX_MISSING_SHARE, Relief, radiance_maps
from anisoscope.sim.light.unresolved import resolve

if TYPE_CHECKING:
    from anisoscope.profiles.metrology.regions import DirectionRegions

TRIED = 6
"""Regions of a class in which ridges are searched."""
PREDICTED = 2
"""Regions of a class that are predicted, the largest ones; their mean stands for the class."""
LEAST_RIDGES = 4.0
"""Ridges of a square region from which on it is predicted alone."""
ALIKE = 0.1
"""Relative difference up to which the areas of two classes count as equal."""
LEVEL = -1
WINDOW_PITCHES, LINED, LEVEL_SHARE, OTHER_DEG = 0.35, 0.5, 0.5, 30.0
"""Window of the structure tensor in pitches; its coherence, and its slope over that of the facets, below which land is
level; and the angle to the line of the class of a field beyond which a facet has another one."""


@dataclass(frozen=True)
class ClassPrediction:
    """Prediction of the regions of one direction.

    Attributes:
        direction_deg: of the ridges on the map, counter-clockwise from +y.
        facet_azimuth_on_map_deg: toward which the facets lean on the map, counter-clockwise from +x.
        facet_azimuth_deg: toward which the facets lean in the sample frame, from its x axis.
        regions: number of regions.
        predicted_regions: of them, those whose ridges were fitted, the largest ones; 0: no region holds four ridges,
            and all were predicted facet by facet.
        share: of the area of all regions.
        radiance: (P,) in 1/sr.
        u: (P,) standard uncertainties, or None.
    """

    direction_deg: float
    facet_azimuth_on_map_deg: float
    facet_azimuth_deg: float
    regions: int
    predicted_regions: int
    share: float
    radiance: FloatArray
    u: FloatArray | None


def predict_map(
    surface: HeightMap,
    material: Material,
    poses: tuple[Pose, ...],
    convention: Convention,
    pitch_um: float | None = None,
    *,
    max_missing_share: float = MAX_MISSING_SHARE,
    inputs: InputUncertainty | None = None,
    monte_carlo: MonteCarlo | None = None,
    on_progress: Advance = silent,
    **options: Any,  # noqa: ANN401 - those of predict_height_map
) -> Predicted:
    """Prediction of a height map: as a whole, or region by region where its ridges have several directions.

    Arguments are those of `predict.predict_height_map`. By regions, the radiance is the mean over their area, and the
    notes hold ``regions``, one `ClassPrediction` a direction.

    Raises:
        HeightMapError: as for `predict.predict_height_map`; or regions hold too few ridges, or are to be drawn in a
            Monte Carlo.
    """

    def one(
        part: HeightMap, frame: Convention, missing: float, sources: InputUncertainty | None
    ) -> Predicted:
        return predict_height_map(
            part,
            material,
            poses,
            frame,
            pitch_um,
            max_missing_share=missing,
            inputs=sources,
            monte_carlo=monte_carlo,
            on_progress=on_progress,
            **options,
        )

    regions = None if find_period(surface).is_periodic else _regions(surface)
    if regions is None or len(regions.azimuths_deg) < 2:
        try:
            return one(surface, convention, max_missing_share, inputs)
        except SeveralDirectionsError:
            regions = _regions(surface) if regions is None else regions
            if len(regions.azimuths_deg) < 2:
                raise
    if surface.missing_share > max_missing_share:
        raise HeightMapError(
            f"{surface.missing_share:.1%} of the heights of this map are missing (limit {max_missing_share:.0%}): "
            "measure it again, or fill the gaps in the instrument's software"
        )
    if monte_carlo is not None:
        raise HeightMapError(
            "ridges of several directions are predicted without Monte Carlo: leave it out, or crop the map to one "
            "direction"
        )
    first = _first_class(regions)
    found, budgets = [], []
    facets = _Facets(surface, regions, material, poses, inputs, **options)
    for number in range(len(regions.azimuths_deg)):
        on_progress("regions", number, len(regions.azimuths_deg))
        turn = _within(regions.azimuths_deg[number] - regions.azimuths_deg[first])
        frame = replace(convention, facet_azimuth_deg=convention.facet_azimuth_deg + turn)
        chosen = _with_ridges(regions, number)
        if chosen:
            whole = one(chosen[0], frame, 1.0, inputs)
            others = [one(part, frame, 1.0, None).radiance for part in chosen[1:]]
            radiance = np.mean([whole.radiance, *others], axis=0)
            azimuth = float(whole.notes["facet_azimuth_on_map_deg"])
        else:
            whole = facets.predicted(number, frame)
            radiance, azimuth = whole.radiance, regions.azimuths_deg[number]
        found.append(
            ClassPrediction(
                _direction(azimuth),
                azimuth,
                turn,
                len(regions.of_class(number)),
                len(chosen),
                float(regions.areas[number] / regions.areas.sum()),
                radiance,
                whole.u_radiance,
            )
        )
        budgets.append((whole, turn, radiance))
    return _combined(found, budgets, poses, convention)


@dataclass(frozen=True, eq=False)
class FieldGrid:
    """Square fields on a height map, each of one class of direction.

    Attributes:
        classes: (rows, cols) class of every field, -1 for flat ones; first row at the top of the map.
        azimuths_deg: (C,) toward which the facets of the classes lean on the map.
        ridges: (C,) ideal ridges of the classes, for light that reflects more than once.
        interior: share of the side of a field over which it is averaged.
    """

    classes: npt.NDArray[np.int64]
    azimuths_deg: tuple[float, ...]
    ridges: tuple[RidgeDesign, ...]
    interior: float


def predict_fields(
    surface: HeightMap,
    fields: FieldGrid,
    material: Material,
    poses: tuple[Pose, ...],
    convention: Convention,
    bounces: int | None = None,
) -> FloatArray:
    """(P, rows, cols) radiance of fields of a height map, facet by facet, with the lobe turned as the surface lies.

    The lobe of a facet has the frame of the class of its field; where slopes lie more than 30° off, as in a field of a
    wrong direction, that of the nearest class; on level land, whose roughness has no direction of its own, that of the
    first class. Shadows are those of the whole map; light that reflects more than once is that of the ideal ridges of
    these classes, and none on level land.

    Args:
        surface: the map, which the fields fill.
        fields: its fields.
        material: the plastic, as far as the map does not resolve it.
        poses: P poses.
        convention: how angles are counted; ``facet_azimuth_deg`` turns the map.
        bounces: largest number of reflections; None follows all.
    """
    frames = _frames(surface, fields)
    size = len(poses), *(n - 1 for n in surface.shape)
    direct, indirect = np.zeros(size, dtype=np.float32), np.zeros((len(poses), *fields.classes.shape))
    for number, azimuth in enumerate(fields.azimuths_deg):
        mine = np.isin(frames, (number, LEVEL)) if number == 0 else frames == number
        if not mine.any():
            continue
        groove = groove_of_design(fields.ridges[number], bounces)
        frame = replace(convention, facet_azimuth_deg=convention.facet_azimuth_deg + azimuth)
        # facets about edges across x are finer than those about others
        quarters = round(azimuth / 90.0)
        rest = azimuth - 90.0 * quarters
        relief = Relief(turned_clockwise(surface, quarters), None, 1.0, "symmetric", _direction(rest), rest)

        to_light, to_camera = directions(poses, frame)
        for pose, one in enumerate(radiance_maps(relief, to_light, to_camera, material)):
            direct[pose][mine] = np.rot90(one, -quarters)[mine]
        if groove is not None:
            share = _field_means((frames == number).astype(np.float32), fields)
            indirect += groove.light(to_light, to_camera, material)[:, None, None] * share
    return np.array([_field_means(one, fields) for one in direct]) + indirect


def _frames(surface: HeightMap, fields: FieldGrid) -> npt.NDArray[np.int16]:
    """(rows − 1, cols − 1) class whose frame every facet has: that of its field, unless the surface lies otherwise.

    A facet whose slopes lie along another line than those of its class, as in a field of a wrong direction, has the
    frame of the class whose line is nearest. Level land is `LEVEL`, and so are the borders, which are not used.
    """
    from anisoscope.profiles.metrology.regions import local_directions  # noqa: PLC0415 - OpenCV, for few maps

    turns = np.exp(-2j * np.radians(fields.azimuths_deg))
    width_um = WINDOW_PITCHES * fields.ridges[0].pitch_um
    steep = [np.tan(np.radians(one.ridge_angle_deg)) for one in fields.ridges]
    found = np.full([n - 1 for n in surface.shape], LEVEL, dtype=np.int16)
    for row, col, inner in _interiors(fields, (found.shape[0], found.shape[1])):
        lines, slopes = local_directions(surface.with_height(surface.height_um[inner]), width_um)
        number = int(fields.classes[row, col])
        of_class = (lines[..., None] * turns).real
        certain = np.abs(lines)
        found[inner] = number
        if number >= 0:
            off = of_class[..., number] < np.cos(np.radians(2.0 * OTHER_DEG)) * certain
            found[inner][off] = of_class[off].argmax(axis=-1)
            certain = np.where(slopes < LEVEL_SHARE * steep[number], certain, 1.0)
        found[inner][certain < LINED] = LEVEL
    return found


def _interiors(fields: FieldGrid, shape: tuple[int, int]) -> Iterator[tuple[int, int, tuple[slice, slice]]]:
    """Row and column of every field, and the points of a map of a shape that its middle takes."""
    (tall, wide), (rows, cols) = shape, fields.classes.shape
    margin = 0.5 * (1.0 - fields.interior)
    for row in range(rows):
        low, high = (round((rows - 1 - row + part) * tall / rows) for part in (margin, 1.0 - margin))
        for col in range(cols):
            left, right = (round((col + part) * wide / cols) for part in (margin, 1.0 - margin))
            yield row, col, (slice(low, high), slice(left, right))


def _field_means(values: npt.NDArray[np.floating], fields: FieldGrid) -> FloatArray:
    """(rows, cols) means of the middles of the fields of a map of facets, first row at the top."""
    found = np.empty(fields.classes.shape)
    for row, col, inner in _interiors(fields, (values.shape[0], values.shape[1])):
        found[row, col] = float(np.nanmean(values[inner], dtype=float))
    return found


def _regions(surface: HeightMap) -> "DirectionRegions":
    from anisoscope.profiles.metrology.regions import direction_regions  # noqa: PLC0415 - OpenCV, for few maps

    return direction_regions(surface)


def _with_ridges(regions: "DirectionRegions", number: int) -> list[HeightMap]:
    """Maps of the largest regions of a class that hold four ridges."""
    found: list[HeightMap] = []
    for region in regions.of_class(number)[:TRIED]:
        part = regions.part(region)
        if not np.isfinite(part.height_um).any():
            continue
        period, area = find_period(part), region.points * part.pixel_x_um * part.pixel_y_um
        if period.is_periodic and np.sqrt(area) >= LEAST_RIDGES * period.pitch_um:
            found.append(part)
        if len(found) == PREDICTED:
            break
    return found


@dataclass(frozen=True, eq=False)
class _Facets:
    """Prediction of regions of few ridges, facet by facet: each with the lobe of its class, shadows of the whole map.

    What the points of the map do to walls and crests is made good for by the profile of all regions of the class
    together (`anisoscope.prediction.field_edges.field_edges`). Light that is reflected more than once is that of the
    groove of this profile, else of the median ridge angle; uncertainties are those of ideal ridges, of the profile, and
    of walls that the map does not show.
    """

    surface: HeightMap
    regions: "DirectionRegions"
    material: Material
    poses: tuple[Pose, ...]
    inputs: InputUncertainty | None
    levelling: Levelling = "auto"
    bounces: int | None = None
    optics: Optics = POINT_LIKE
    facets: Facets = "symmetric"
    roughness: Roughness = "lobe"
    reflect: Reflect = "groove"

    @cached_property
    def _level(self) -> HeightMap:
        if self.levelling == "plane":
            return level(self.surface, Period(float("nan"), float("nan"), 0.0, False)).map
        return self.surface

    def predicted(self, number: int, frame: Convention) -> Predicted:
        """Radiances of the regions of a class."""
        azimuth = self.regions.azimuths_deg[number]
        # facets about edges across x are finer than those about others
        quarters = round(azimuth / 90.0)
        rest = azimuth - 90.0 * quarters
        lying = turned_clockwise(self._level, quarters)
        relief = Relief(lying, None, 1.0, self.facets, _direction(rest), rest)
        points = np.isin(self.regions.labels, [one.number for one in self.regions.of_class(number)])
        mask = np.rot90(points, quarters)[:-1, :-1]
        design = self._design(lying, mask, rest)
        fields = np.rot90(np.where(points, self.regions.labels, 0), quarters)
        edges = field_edges(relief, np.ascontiguousarray(fields, dtype=np.int32), design)
        lobe = self.material
        if self.roughness == "plastic":
            part = turned_clockwise(self.regions.part(self.regions.of_class(number)[0]), quarters)
            lobe = resolve(replace(relief, surface=part)).lobe(lobe)

        def direct(to_light: FloatArray, to_camera: FloatArray, plastic: Material) -> FloatArray:
            if edges is not None:
                return edges.light(to_light, to_camera, plastic)
            maps = radiance_maps(relief, to_light, to_camera, plastic)
            return np.array([float(np.nanmean(one[mask], dtype=float)) for one in maps])

        sides = directions(self.poses, frame)
        radiance = through(direct, self.optics)(*sides, lobe)
        design = design if edges is None else edges.edges.design
        ideal = predict_design(
            design, lobe, self.poses, frame, "corrected", self.bounces, self.inputs, optics=self.optics
        )
        groove = groove_of_design(design, self.bounces)
        indirect = np.zeros_like(radiance)
        if groove is not None:
            indirect = through(groove.light, self.optics)(*sides, lobe)
            radiance = radiance + indirect
        notes = {"bounces": ideal.notes["bounces"], "reflections_from": "groove"}
        found = Predicted("relief", frame, self.poses, radiance, contrasts(self.poses, radiance), notes=notes)
        if ideal.budget is None or self.inputs is None:
            return found
        gain = radiance / np.where(ideal.radiance > 0.0, ideal.radiance, 1.0)
        own = self.inputs.height_map_share * radiance
        contributions = (
            *(scaled(one, gain) for one in ideal.budget.contributions),
            *self._walls(edges, sides, lobe, (radiance, indirect), design, max(relief.pixels_um)),
            Contribution("whatever else is wrong with the map", own, "independent"),
        )
        return replace(found, budget=Budget(radiance, contributions, gain * ideal.budget.per_degree))

    @staticmethod
    def _walls(
        edges: FieldEdges | None,
        sides: tuple[FloatArray, FloatArray],
        lobe: Material,
        light: tuple[FloatArray, FloatArray],
        design: RidgeDesign,
        pixel_um: float,
    ) -> Iterator[Contribution]:
        """What the points of the map leave open of walls: any draft of a wall narrower than a pixel, rectangular.

        Without a profile the facets may have the light of ideal ridges of either wall instead of theirs. What the
        points about walls show and the profile does not may be of the part, as predicted, or come of their places.
        """
        radiance, indirect = light
        yield pixel_bias(pixel_um, design.pitch_um, radiance, indirect)
        drafts = [replace(design, wall=one) for one in ("vertical", "perpendicular")]
        if edges is not None:
            yield from edge_contributions(edges.edges, sides, lobe, radiance, indirect)
            left = np.abs(edges.unexplained(*sides, lobe)) / np.sqrt(3.0)
            yield Contribution("light of the points at walls", left, "independent", rectangular=True)
            if design.wall_width_um >= pixel_um:
                return
            drafts.append(design)
        ideal = [corrected.radiance(*sides, one, lobe) for one in drafts]
        shown = radiance - indirect if edges is None else ideal.pop()
        off = np.max([np.abs(one - shown) for one in ideal], axis=0) / np.sqrt(3.0)
        yield Contribution("walls that the map does not show", off, "independent", rectangular=True)

    @staticmethod
    def _design(surface: HeightMap, mask: npt.NDArray[np.bool_], azimuth_deg: float) -> RidgeDesign:
        """Ideal ridges of the median slope, and of a pitch by the heights of the regions.

        Raises:
            HeightMapError: the facets are flat or too steep.
        """
        height, (px, py) = surface.height_um, (surface.pixel_x_um, surface.pixel_y_um)
        fall_x = (height[:-1, :-1] - height[:-1, 1:])[mask] / px
        fall_y = (height[:-1, :-1] - height[1:, :-1])[mask] / py
        turn = np.radians(azimuth_deg)
        slope = float(np.nanmedian(np.cos(turn) * fall_x + np.sin(turn) * fall_y))
        angle = float(np.degrees(np.arctan(slope)))
        if not LEAST_ANGLE_DEG <= angle <= LARGEST_ANGLE_DEG:
            raise HeightMapError(
                f"the facets of some ridges of the height map stand at {angle:.2f}°, between "
                f"{LEAST_ANGLE_DEG:g}° and {LARGEST_ANGLE_DEG:g}° are needed: is the map level?"
            )
        low, high = np.nanquantile(height[:-1, :-1][mask], [0.01, 0.99])
        pitch = float(high - low) / 0.98 / (np.sin(np.radians(angle)) * np.cos(np.radians(angle)))
        return RidgeDesign(max(pitch, 2.0 * max(px, py)), angle)


def _first_class(regions: "DirectionRegions") -> int:
    """The class whose frame is the sample's."""
    areas, azimuths = regions.areas, np.array(regions.azimuths_deg)

    def rank(number: int) -> tuple[float, ...]:
        others = np.delete(azimuths, number) - azimuths[number]
        return tuple(sorted(round(_within(float(one)), 0) for one in others))

    large = [n for n in range(len(azimuths)) if areas[n] >= (1.0 - ALIKE) * areas.max()]
    return min(large, key=rank)


def _combined(
    found: list[ClassPrediction],
    budgets: list[tuple[Predicted, float, FloatArray]],
    poses: tuple[Pose, ...],
    convention: Convention,
) -> Predicted:
    shares = np.array([one.share for one in found])
    radiance = np.asarray(shares @ np.array([one.radiance for one in found]))
    first = budgets[int(np.argmin([abs(turn) for _, turn, _ in budgets]))][0]
    notes = {key: value for key, value in first.notes.items() if key not in _OF_ONE_FRAME}
    notes["regions"] = [as_json(one) for one in found]
    budget = None
    if all(one.budget is not None for one, _, _ in budgets):
        budget = _budget(shares, budgets, radiance)
    return Predicted(
        "relief", convention, poses, radiance, contrasts(poses, radiance), notes=notes, budget=budget
    )


_OF_ONE_FRAME = ("ridge_direction_deg", "facet_azimuth_on_map_deg", "warning", "pitch_um", "missing_share")


def _budget(
    shares: FloatArray, budgets: list[tuple[Predicted, float, FloatArray]], radiance: FloatArray
) -> Budget:
    """Budget of the mean over the regions.

    One error of an input moves all regions together; errors in each pose by what the regions have in common (stage,
    model) add up as well; what scatters from region to region adds in squares.
    """
    merged: dict[str, list[tuple[float, Contribution]]] = {}
    per_degree = np.zeros_like(radiance)
    for share, (one, turn, mean) in zip(shares, budgets, strict=True):
        assert one.budget is not None
        gain = mean / np.where(one.radiance > 0.0, one.radiance, 1.0)
        per_degree += share * gain * one.budget.per_degree
        for part in in_plate_frame(one.budget.contributions, turn):
            merged.setdefault(part.source, []).append((float(share), scaled(part, gain)))
    contributions = tuple(_merged(parts) for parts in merged.values())
    return Budget(radiance, contributions, per_degree)


def scaled(part: Contribution, gain: FloatArray) -> Contribution:
    """A contribution to radiances that are (P,) times as large."""
    matrix = None if part.matrix is None else part.matrix * np.outer(gain, gain)
    curved = None if part.curvature is None else gain * part.curvature
    return replace(part, absolute=gain * part.absolute, matrix=matrix, curvature=curved)


def in_plate_frame(contributions: tuple[Contribution, ...], turn_deg: float) -> tuple[Contribution, ...]:
    """The contributions of ridges that lean toward ``turn_deg``, with the seating about the axes of the plate."""
    by_name = {one.source: one for one in contributions}
    if not all(name in by_name for name in SEATING):
        return contributions
    cos, sin = float(np.cos(np.radians(turn_deg))), float(np.sin(np.radians(turn_deg)))
    x, y = (by_name[name] for name in SEATING)
    turned = {
        x.source: replace(x, absolute=cos * x.absolute - sin * y.absolute),
        y.source: replace(y, absolute=sin * x.absolute + cos * y.absolute),
    }
    return tuple(turned.get(one.source, one) for one in contributions)


def _merged(parts: list[tuple[float, Contribution]]) -> Contribution:
    one = parts[0][1]
    if one.correlation == "partial":
        matrix = np.sum([share**2 * part.covariance() for share, part in parts], axis=0)
        return replace(one, absolute=np.sqrt(np.diag(matrix)), matrix=matrix)
    signed = one.correlation == "shared"
    total = np.sum([share * (p.absolute if signed else np.abs(p.absolute)) for share, p in parts], axis=0)
    curves = [share * np.abs(p.curvature) for share, p in parts if p.curvature is not None]
    return replace(one, absolute=total, curvature=np.sum(curves, axis=0) if curves else None)


def _direction(azimuth_deg: float) -> float:
    return 90.0 - (90.0 - azimuth_deg) % 180.0


def _within(angle_deg: float) -> float:
    """Within (−180, 180]."""
    return 180.0 - (180.0 - angle_deg) % 360.0
