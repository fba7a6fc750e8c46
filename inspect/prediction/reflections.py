"""Interreflection in predictions: indirect light of the groove between two ridges, added to direct light.

L = L_direct(surface) + [L_all − L_direct](groove), where the groove is the sharp one of the design, or that of the
ridge angle fitted to a height map. It is added, not multiplied: a worn or rounded crest takes direct light away on
which the reflections between facet and wall do not depend. Pixels of a map hold no wall, so that paths followed on the
map are in another groove than that of the part; they are followed where no groove can be fitted.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.material import SHORTEST_TAIL, Material
from anisoscope.parameters.optics import Optics
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.ridge_edges import (
    LARGEST_ANGLE_DEG,
    LEAST_ANGLE_DEG,
    RidgeEdges,
    measured_ridges,
)
from anisoscope.prediction.sensitivity import ALPHA_RANGE, DARK, Contribution, Model, Shape, Surface
from anisoscope.sim.light.bounces import NODES, interreflection
from anisoscope.sim.light.optics import through
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.relief_paths import interreflection as followed_paths
from anisoscope.sim.light.ridge_profile import sharp_groove

AMPLITUDE_U = 0.1
"""Relative standard uncertainty of the amplitude of all reflections together, the same in all poses."""
OF_RADIANCE, OF_INDIRECT = 0.005, 0.05
"""Model error of a pose, independent of the others: shares of the radiance and of its indirect part."""
AMPLITUDE = "amplitude of the reflections"
MODEL_ERROR = "model of the reflections"
UNIT_PITCH_UM = 100.0  # radiance does not depend on the size of a groove
STAND_IN_NODES, STAND_IN_NODES_OF_TAIL = 4, 3
"""Off by less than 0.1 % of the indirect part; the panels about a lobe with a tail are narrower."""
STRAIGHT_SHARE = 0.6  # of the columns of a map that a facet takes at least
STRAIGHT_SLOPE = 0.05
WALL_MARGIN_DEG = 1.0


@lru_cache(maxsize=512)
def _indirect(
    to_light: bytes,
    to_camera: bytes,
    design: RidgeDesign,
    material: Material,
    bounces: int | None,
    nodes: int,
) -> FloatArray:
    light, camera = (np.frombuffer(side, dtype=np.float64).reshape(-1, 3) for side in (to_light, to_camera))
    found = interreflection(light, camera, design, material, bounces, nodes)
    found.flags.writeable = False
    return found


@dataclass(frozen=True)
class Groove:
    """Groove between two ridges, facet and wall, whose indirect light is added to direct light.

    Attributes:
        design: the ridges that form it.
        bounces: largest number of reflections; None follows all.
        lean_deg: azimuth toward which the facets lean in the frame of the surface.
        resolved: roughness along and across that a map resolves, and the lobe of its material therefore lacks; in the
            groove it is added in quadrature.
        nodes: of the quadrature of two reflections, as for `bounces.interreflection`.
    """

    design: RidgeDesign
    bounces: int | None = None
    lean_deg: float = 0.0
    resolved: tuple[float, float] = (0.0, 0.0)
    nodes: int = NODES

    def light(self, to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
        """(P,) radiance in 1/sr of light that reflects twice and more, for (P, 3) unit vectors; cached."""
        turn = np.radians(self.lean_deg)
        back = np.array(
            [[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
        )
        if self.lean_deg == 0.0:
            back = np.eye(3)
        sides = (
            np.ascontiguousarray(side @ back, dtype=np.float64).tobytes() for side in (to_light, to_camera)
        )
        whole = replace(
            material,
            alpha_along=min(float(np.hypot(material.alpha_along, self.resolved[0])), ALPHA_RANGE[1]),
            alpha_across=min(float(np.hypot(material.alpha_across, self.resolved[1])), ALPHA_RANGE[1]),
        )
        return _indirect(
            *sides,
            _unit(sharp_groove(self.design)),
            whole,
            self.bounces,
            self.nodes,
        )

    def turned(self, ridge_angle_deg: float) -> "Groove":
        """The groove of another ridge angle."""
        return replace(self, design=replace(self.design, ridge_angle_deg=ridge_angle_deg))

    def turned_by(self, delta_deg: float) -> "Groove":
        """The groove of facets that are steeper by some degrees, as far as there is a model of it."""
        angle_deg = self.design.ridge_angle_deg + delta_deg
        return self.turned(float(np.clip(angle_deg, LEAST_ANGLE_DEG, LARGEST_ANGLE_DEG)))

    def rougher(self, along: float, across: float) -> "Groove":
        """The groove whose facets have more roughness that the map resolves, added in quadrature."""
        resolved = np.hypot(self.resolved[0], along), np.hypot(self.resolved[1], across)
        return replace(self, resolved=(float(resolved[0]), float(resolved[1])))

    def shortened(self, height_loss: float) -> "Groove":
        """The groove whose facet and wall end below a crest that is cut."""
        return replace(self, design=replace(self.design, height_loss=height_loss))

    def worn(self, radius_um: float, pitch_um: float) -> "Groove":
        """The groove whose crests, a pitch apart, are worn to a radius; crests that are rounder stay as they are."""
        radius_um *= self.design.pitch_um / pitch_um
        return replace(
            self, design=replace(self.design, edge_radius_um=max(self.design.edge_radius_um, radius_um))
        )


def _unit(design: RidgeDesign) -> RidgeDesign:
    """Ridges of one pitch, to which light of a groove without rounded crests is the same."""
    foot_um = design.foot_radius_um * UNIT_PITCH_UM / design.pitch_um
    return replace(design, pitch_um=UNIT_PITCH_UM, foot_radius_um=foot_um)


def groove_of_design(design: RidgeDesign, bounces: int | None) -> Groove | None:
    """The groove of ideal ridges; None for direct light alone."""
    return None if bounces == 1 else Groove(design, bounces)


def fitted_groove(relief: Relief, bounces: int | None = None, edges: RidgeEdges | None = None) -> Groove:
    """The groove of the ridges of a height map: that of the profile fitted to it.

    Where none is fitted, facets have the measured or the median slope, and the wall is perpendicular unless it is
    seen to stand upright.

    Args:
        relief: the map, prepared.
        bounces: largest number of reflections; None follows all.
        edges: profile of walls and crests that was fitted to the map.

    Raises:
        HeightMapError: no ridges with straight facets.
    """
    if edges is not None:
        return Groove(edges.design, bounces, edges.lean_deg, edges.resolved)
    measured = measured_ridges(relief)
    steepest, resolved, angle, lean = None, (0.0, 0.0), None, 0.0
    if measured is not None and measured.second_direction_deg is not None:
        raise HeightMapError("no groove can be fitted: the map has ridges of two directions")
    if measured is not None:
        angle, lean = measured.ridge_angle_deg.value, measured.lean_deg - relief.turn_deg
        steepest = measured.wall_angle_deg.value or measured.wall_angle_deg.at_least
        resolved = measured.alpha_along.value or 0.0, measured.alpha_across.value or 0.0
    if angle is None:
        angle, lean = _median_facet(relief)
    if not LEAST_ANGLE_DEG <= angle <= LARGEST_ANGLE_DEG:
        raise HeightMapError(
            f"no groove can be fitted: facets of {angle:.2f}°, between {LEAST_ANGLE_DEG:g}° and "
            f"{LARGEST_ANGLE_DEG:g}° are needed"
        )
    upright = steepest is not None and steepest > 90.0 - angle + WALL_MARGIN_DEG
    design = RidgeDesign(UNIT_PITCH_UM, float(angle), "vertical" if upright else "perpendicular")
    return Groove(design, bounces, 0.0 if np.cos(np.radians(lean)) > 0.0 else 180.0, resolved)


def _median_facet(relief: Relief) -> tuple[float, float]:
    """Angle of the facets of a map of few ridges, from the median slope of its mean profile, and where they lean."""
    surface = relief.surface
    known = np.isfinite(surface.height_um)
    count = known.sum(axis=0)
    profile = np.where(known, surface.height_um, 0.0).sum(axis=0) / np.maximum(count, 1)
    slope = np.diff(np.where(count > 0, profile, np.nan)) / surface.pixel_x_um
    slope = slope[np.isfinite(slope)]
    middle = float(np.median(slope)) if slope.size else 0.0
    straight = float(np.mean(np.abs(slope - middle) < STRAIGHT_SLOPE)) if slope.size else 0.0
    if straight < STRAIGHT_SHARE:
        raise HeightMapError(
            f"no groove can be fitted: {straight:.0%} of the map's columns have the slope of a facet, "
            f"{STRAIGHT_SHARE:.0%} are needed"
        )
    return float(np.degrees(np.arctan(abs(middle)))), 0.0 if middle <= 0.0 else 180.0


def added(direct: Model, indirect: Model | None) -> Model:
    """Predictor of direct and indirect light."""
    if indirect is None:
        return direct

    def predict(to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
        return np.asarray(direct(to_light, to_camera, material) + indirect(to_light, to_camera, material))

    return predict


def _twice(groove: Groove, material: Material) -> Groove:
    nodes = STAND_IN_NODES if material.tail < SHORTEST_TAIL else STAND_IN_NODES_OF_TAIL
    return replace(groove, bounces=2, nodes=nodes)


@dataclass(frozen=True, eq=False)
class StandIn:
    """Cheap indirect light near given directions: two reflections, times the nominal ratio of all to two.

    Attributes:
        groove: the nominal groove.
        to_light: (P, 3) nominal unit vectors.
        to_camera: (P, 3) nominal unit vectors.
        material: the nominal material.
    """

    groove: Groove
    to_light: FloatArray
    to_camera: FloatArray
    material: Material

    @cached_property
    def _ratio(self) -> tuple[FloatArray, FloatArray]:
        """(P,) ratio of all to two reflections, and (P,) light of all where two do not reach the camera."""
        sides = self.to_light, self.to_camera, self.material
        two, found = _twice(self.groove, self.material).light(*sides), self.groove.light(*sides)
        lit = two > DARK
        return np.where(lit, found, 1.0) / np.where(lit, two, 1.0), np.where(lit, 0.0, found)

    def of(self, groove: Groove) -> Model:
        """Predictor of a groove of similar shape."""

        def predict(to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
            ratio, rest = self._ratio
            nominal, looked = (
                np.hstack(sides) for sides in ((self.to_light, self.to_camera), (to_light, to_camera))
            )
            nearest = np.argmin(((looked[:, None] - nominal) ** 2).sum(axis=-1), axis=1)
            twice = _twice(groove, material).light(to_light, to_camera, material)
            return np.asarray(twice * ratio[nearest] + rest[nearest])

        return predict


@dataclass(frozen=True, eq=False)
class Followed:
    """Indirect light of a map in which no groove can be fitted, by paths followed on it.

    Attributes:
        relief: the map.
        bounces: largest number of reflections; None follows all.
        reason: why there is no groove.
    """

    relief: Relief
    bounces: int | None
    reason: str

    def light(
        self, to_light: FloatArray, to_camera: FloatArray, material: Material, progress: Advance = silent
    ) -> FloatArray:
        """(P,) radiance in 1/sr of light that reflects twice and more, for (P, 3) unit vectors."""
        return followed_paths(
            self.relief, to_light, to_camera, material, self.bounces, progress=progress
        ).radiance


def reflections_of_map(
    relief: Relief, bounces: int | None, edges: RidgeEdges | None = None
) -> Groove | Followed | None:
    """Where the indirect light of a map comes from; None for direct light alone. Arguments as for `fitted_groove`."""
    if bounces == 1:
        return None
    try:
        return fitted_groove(relief, bounces, edges)
    except HeightMapError as problem:
        return Followed(relief, bounces, str(problem))


def sampled_with(
    direct: Surface,
    source: Groove | Followed | None,
    nominal: tuple[FloatArray, FloatArray, Material],
    optics: Optics,
    groove_of: Callable[[Shape], Groove],
) -> Surface:
    """Cheap predictor of a shape for sensitivities: direct light, and the light of the groove of that shape.

    Paths that are followed on a map are left out: their light changes in proportion to direct light.

    Args:
        direct: predictor of direct light.
        source: where indirect light comes from.
        nominal: (P, 3) directions to the light and to the camera, and the material.
        optics: lamp and lens.
        groove_of: the groove of a shape.
    """
    if not isinstance(source, Groove):
        return direct
    stand_in = StandIn(source, *nominal)
    return lambda shape: added(direct(shape), through(stand_in.of(groove_of(shape)), optics))


def reflections_note(source: Groove | Followed | None) -> dict[str, Any]:
    """Notes on the reflections of a prediction."""
    if source is None:
        return {"bounces": 1}
    note: dict[str, Any] = {"bounces": "all" if source.bounces is None else source.bounces}
    if isinstance(source, Followed):
        return note | {"reflections_from": "paths on the height map", "reflections_reason": source.reason}
    angle, wall = source.design.ridge_angle_deg, source.design.wall
    return note | {"reflections_from": "groove", "groove_angle_deg": angle, "groove_wall": wall}


def reflections_contributions(
    radiance: FloatArray, indirect: FloatArray, amplitude_share: float = AMPLITUDE_U
) -> tuple[Contribution, Contribution]:
    """Uncertainty of the reflections: of their amplitude, shared by the poses, and of their model, in each pose.

    Args:
        radiance: (P,) all light in 1/sr.
        indirect: (P,) of it what reflects twice and more.
        amplitude_share: relative standard uncertainty of the amplitude.
    """
    own = np.hypot(OF_RADIANCE * radiance, OF_INDIRECT * indirect)
    return (
        Contribution(AMPLITUDE, amplitude_share * indirect),
        Contribution(MODEL_ERROR, own, "independent"),
    )
