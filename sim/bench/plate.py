"""A plate of fields with ridges of several directions on the virtual rig.

Every field shows ridges that the path tracer has rendered in the frame of the ridges, turned to the direction of the
field. Ten states of each class, with their own ridge angle, roughness and height loss, are rendered; a field is a
mixture of them with their mean and covariance, to first order a state of its own; none is higher than full ridges.
Between the fields nothing is exchanged: no shadow and no reflection crosses a border. Where a field stands off its
place the flat land shows. Nothing of this is shared with the prediction.
"""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.base.toml_file import NotNegative, Part, Positive, Share
from anisoscope.parameters.ridges import RidgeDesign, Wall
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.profiles.plates import FLAT, Plan

if TYPE_CHECKING:
    from anisoscope.sim.pathtracer.plastic import Plastic

Image = npt.NDArray[np.float32]

FieldDefect = Literal["missing", "merged", "direction", "worn", "filled"]
RidgeAngle = Annotated[float, Field(gt=0.0, lt=45.0)]
PIXEL_UM = 1.0
STATES = 10
"""States of the ridges of a class that are rendered; every field is a mixture of its own about their mean."""
PATHS = 16384
REFLECTIONS = 5
POSES_REMEMBERED = 4


class FieldDefectPart(Part):
    """A field with a defect; ``row`` counts from 0 at the top, ``col`` from 0 on the left.

    ``missing``: flat; ``merged``: half of it has the direction of another class; ``direction``: all of it; ``worn``:
    crests rounded to a fifth of the pitch; ``filled``: crests cut by 60 % of the height.
    """

    row: Annotated[int, Field(ge=0)]
    col: Annotated[int, Field(ge=0)]
    defect: FieldDefect


class PlatePart(Part):
    """A plate: its plan, its ridges, how much fields differ (standard deviations), and defects.

    ``ridge_angles_deg`` gives the ridge angles of classes that differ. ``edge_radius_um`` is the radius of all crests,
    of which a worn plate has a large one, and ``foot_radius_um`` that of all feet. ``draft_deg`` is that of the walls,
    perpendicular to the facets if not given. ``misplaced_um`` is the standard deviation of the place of a field along x
    and y. ``states`` are the states of the ridges of a class, among which its fields are drawn.
    """

    plan: Annotated[tuple[str, ...], Field(min_length=1)]
    facet_azimuths_deg: dict[str, float]
    module_mm: Positive
    pitch_um: Positive = 50.0
    ridge_angle_deg: RidgeAngle = 10.0
    ridge_angles_deg: Annotated[dict[str, RidgeAngle], Field(default_factory=dict)]
    draft_deg: NotNegative | None = None
    edge_radius_um: NotNegative = 0.0
    foot_radius_um: NotNegative = 0.0
    height_loss: Share = 0.0
    angle_scatter_deg: NotNegative = 0.1
    alpha_scatter_share: Share = 0.03
    height_loss_scatter: Share = 0.01
    misplaced_um: NotNegative = 1.0
    resolved_alpha: NotNegative = 0.03
    correlation_um: Positive = 8.0
    states: Annotated[int, Field(ge=1)] = STATES
    defects: tuple[FieldDefectPart, ...] = ()

    def fields(self) -> Plan:
        """The plan.

        Raises:
            HeightMapError: it is none.
        """
        return Plan(self.plan, self.facet_azimuths_deg, self.module_mm, self.ridge_angles_deg)

    def design(self) -> RidgeDesign:
        """The ridges of the plate, without scatter.

        Raises:
            HeightMapError: they are none.
        """
        wall: Wall = "perpendicular" if self.draft_deg is None else self.draft_deg
        crest, foot = self.edge_radius_um, self.foot_radius_um
        return RidgeDesign(
            self.pitch_um, self.ridge_angle_deg, wall, edge_radius_um=crest, foot_radius_um=foot
        )

    @model_validator(mode="after")
    def _is_a_plate(self) -> Self:
        try:
            found = self.fields()
            found.check_ridges(self.pitch_um)
            for letter in found.letters:
                found.design_of(letter, self.design())
        except HeightMapError as problem:
            raise ValueError(str(problem)) from None
        rows, cols = found.shape
        for one in self.defects:
            if one.row >= rows or one.col >= cols:
                raise ValueError(f"defects: the plan has no field in row {one.row}, column {one.col}")
        return self


@dataclass(frozen=True)
class _State:
    """State of the ridges of a field; None for a flat one."""

    design: RidgeDesign | None
    alpha_share: float
    number: int


Tiles = Callable[[_State, float], Image]
"""Picture of a field by its state and azimuth."""


class PlateSample:
    """A plate as a sample of the bench (`anisoscope.sim.bench.bench.Sample`); grey.

    Args:
        part: the plate.
        plastic: what it is made of.
        rng: states and places of the fields.
        reflections: whether light is followed beyond its first reflection.
    """

    def __init__(
        self, part: PlatePart, plastic: "Plastic", rng: np.random.Generator, *, reflections: bool = True
    ) -> None:
        self._part, self._plastic, self._plan = part, plastic, part.fields()
        self._reflections = REFLECTIONS if reflections else 1
        self._seed = int(rng.integers(2**31))
        designs = [self._plan.design_of(letter, part.design()) for letter in self._plan.letters]
        self._states = [[self._drawn(one, rng, number) for number in range(part.states)] for one in designs]
        rows, cols = self._plan.shape
        self._mixtures = _mixtures(rng, self._losses)
        self._moved_um = part.misplaced_um * rng.standard_normal((rows, cols, 2))
        self._defects = {(one.row, one.col): one.defect for one in part.defects}
        self._tiles: dict[tuple[object, ...], Image] = {}
        self._heights: dict[tuple[object, ...], Image] = {}

    def lot_mate(self, rng: np.random.Generator, defects: tuple[FieldDefectPart, ...]) -> "PlateSample":
        """Another plate of the same plastic and seat: its fields have the same states at other places."""
        found = copy(self)
        rows, cols = self._plan.shape
        found._mixtures = _mixtures(rng, self._losses)  # noqa: SLF001 - of its own class
        found._moved_um = self._part.misplaced_um * rng.standard_normal((rows, cols, 2))  # noqa: SLF001
        found._defects = {(one.row, one.col): one.defect for one in defects}  # noqa: SLF001
        found.__dict__.pop("_shown", None)
        return found

    @property
    def pixel_um(self) -> tuple[float, float]:
        """Size (y, x) of a point of the picture."""
        return PIXEL_UM, PIXEL_UM

    @property
    def _losses(self) -> FloatArray:
        """(rows, cols, states) height loss of the states of every field; 0 for flat ones."""
        of_class = [[one.design.height_loss if one.design else 0.0 for one in each] for each in self._states]
        return np.array([*of_class, [0.0] * self._part.states])[self._plan.classes()]

    def _drawn(self, design: RidgeDesign, rng: np.random.Generator, number: int) -> _State:
        part = self._part
        angle = design.ridge_angle_deg + part.angle_scatter_deg * float(rng.standard_normal())
        loss = part.height_loss + part.height_loss_scatter * abs(float(rng.standard_normal()))
        share = 1.0 + part.alpha_scatter_share * float(rng.standard_normal())
        lost = 0.0 if part.edge_radius_um > 0.0 else min(loss, 0.9)
        return _State(replace(design, ridge_angle_deg=angle, height_loss=lost), share, number)

    def radiance(self, to_light: FloatArray, to_camera: FloatArray) -> Image:
        """(1, rows, cols) radiance; row index rises with +y."""
        return self._shown(tuple(float(one) for side in (to_light, to_camera) for one in np.round(side, 9)))

    @cached_property
    def _shown(self) -> Callable[[tuple[float, ...]], Image]:
        @lru_cache(maxsize=POSES_REMEMBERED)
        def shown(seen: tuple[float, ...]) -> Image:
            found = self._picture(np.array(seen[:3]), np.array(seen[3:]))[None]
            found.flags.writeable = False
            return found

        return shown

    def height_map(self) -> HeightMap:
        """Height map of the plate as it is made, with texture and misplaced fields; row index rises with +y."""
        side = round(1000.0 * self._plan.module_mm / PIXEL_UM)
        flat = 0.5 * RidgeDesign(self._part.pitch_um, self._part.ridge_angle_deg).height_um

        def tile(state: _State, azimuth_deg: float) -> Image:
            key = state, azimuth_deg
            if key not in self._heights:
                self._heights[key] = made(state, azimuth_deg)
            return self._heights[key]

        def made(state: _State, azimuth_deg: float) -> Image:
            found = _turned(self._surface(state, azimuth_deg, side).height_um[:-1, :-1], azimuth_deg, side)
            return found + np.float32(flat) if state.design is None else found

        return HeightMap(self._assembled(tile, side).astype(np.float64), PIXEL_UM, PIXEL_UM, {})

    def _picture(self, to_light: FloatArray, to_camera: FloatArray) -> Image:
        side = round(1000.0 * self._plan.module_mm / PIXEL_UM)
        pose = (*to_light.tolist(), *to_camera.tolist())
        if len({key[0] for key in self._tiles} | {pose}) > POSES_REMEMBERED:
            self._tiles.clear()

        def tile(state: _State, azimuth_deg: float) -> Image:
            key = pose, state, azimuth_deg
            if key not in self._tiles:
                self._tiles[key] = self._tile(state, azimuth_deg, side, to_light, to_camera)
            return self._tiles[key]

        return self._assembled(tile, side)

    def _assembled(self, tile: Tiles, side: int) -> Image:
        """Fields at their places; what a field leaves free is flat land."""
        rows, cols = self._plan.shape
        classes = self._plan.classes()
        flat = tile(_State(None, 1.0, 0), 0.0)
        picture = np.tile(flat, (rows, cols))
        for row in range(rows):
            for col in range(cols):
                if classes[row, col] < 0:
                    continue
                shown = self._field(row, col, classes, tile)
                right, up = (round(float(one) / PIXEL_UM) for one in self._moved_um[row, col])
                y0, x0 = (rows - 1 - row) * side + up, col * side + right
                y1, x1 = max(y0, 0), max(x0, 0)
                y2, x2 = min(y0 + side, rows * side), min(x0 + side, cols * side)
                picture[y1:y2, x1:x2] = shown[y1 - y0 : y2 - y0, x1 - x0 : x2 - x0]
        return picture

    def _field(self, row: int, col: int, classes: npt.NDArray[np.int64], tile: Tiles) -> Image:
        """Picture of one field, with its defect."""
        number = int(classes[row, col])
        azimuths = [self._plan.azimuths_deg[letter] for letter in self._plan.letters]
        defect, weights = self._defects.get((row, col)), self._mixtures[row, col]
        design = self._states[number][int(np.argmax(weights))].design
        assert design is not None

        def mixed(azimuth_deg: float) -> Image:
            found = weights[0] * tile(self._states[number][0], azimuth_deg)
            for weight, state in zip(weights[1:], self._states[number][1:], strict=True):
                found += weight * tile(state, azimuth_deg)
            return np.asarray(found, dtype=np.float32)

        if defect == "missing":
            return tile(_State(None, 1.0, 0), 0.0)
        if defect == "worn":
            worn = replace(design, height_loss=0.0, edge_radius_um=0.2 * design.pitch_um, foot_radius_um=0.0)
            return tile(_State(worn, 1.0, self._part.states), azimuths[number])
        if defect == "filled":
            cut = replace(design, height_loss=0.6, edge_radius_um=0.0)
            return tile(_State(cut, 1.0, self._part.states + 1), azimuths[number])
        other = azimuths[(number + 1) % len(azimuths)]
        if len(azimuths) == 1:
            other = azimuths[0] + 90.0
        if defect == "direction":
            return mixed(other)
        if defect == "merged":
            both = mixed(azimuths[number])
            half = both.shape[1] // 2
            both[:, half:] = mixed(other)[:, half:]
            return both
        return mixed(azimuths[number])

    def _surface(self, state: _State, azimuth_deg: float, side: int) -> HeightMap:
        """Height map of the ridges of a field in their own frame, larger than the field."""
        part, reach = self._part, int(np.ceil(side * 1.5)) + 2
        rng = np.random.default_rng((self._seed, state.number, int(1000 * azimuth_deg) % 360000))
        whole = max(1, int(np.ceil(reach * PIXEL_UM / part.pitch_um)))
        shape = (reach + 1, round(whole * part.pitch_um / PIXEL_UM) + 1)
        surface = ridges(state.design or RidgeDesign(part.pitch_um, 1e-3), shape, PIXEL_UM)
        if part.resolved_alpha > 0.0:
            alpha = part.resolved_alpha * state.alpha_share
            surface = add_facet_roughness(
                surface, alpha_along=alpha, alpha_across=alpha, correlation_um=part.correlation_um, rng=rng
            )
        return surface

    def _tile(
        self, state: _State, azimuth_deg: float, side: int, to_light: FloatArray, to_camera: FloatArray
    ) -> Image:
        """(side, side) picture of ridges in the direction of a field: rendered in their own frame, then turned."""
        from anisoscope.sim.pathtracer.tracer import PathTracer  # noqa: PLC0415 - numba when first needed

        turn = np.radians(azimuth_deg)
        cos, sin = float(np.cos(turn)), float(np.sin(turn))
        into = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        tracer = PathTracer(
            self._surface(state, azimuth_deg, side),
            self._plastic,
            pitch_um=self._part.pitch_um,
            reflections=self._reflections,
            paths=PATHS,
            seed=self._seed,
        )
        return _turned(tracer.radiance(into @ to_light, into @ to_camera), azimuth_deg, side)


def _mixtures(rng: np.random.Generator, losses: FloatArray) -> npt.NDArray[np.float32]:
    """(rows, cols, states) weights of the states that fields are made of: their sum is 1.

    What is linear in the states, such as the ridge angle, has their mean and covariance: fields scatter normally.
    Fields that would be higher than the full height are drawn again: a mould makes no such ridges.

    Args:
        rng: of the weights.
        losses: (rows, cols, states) height loss of the states.
    """
    count = losses.shape[-1]
    found, bad = np.empty(losses.shape), np.ones(losses.shape[:-1], dtype=bool)
    while bad.any():
        drawn = rng.standard_normal((int(bad.sum()), count))
        drawn -= drawn.mean(axis=-1, keepdims=True)
        found[bad] = 1.0 / count + drawn / np.sqrt(max(count - 1.0, 1.0))
        bad[bad] = (found[bad] * losses[bad]).sum(axis=-1) < 0.0
    return np.asarray(found, dtype=np.float32)


def _turned(values: FloatArray | Image, azimuth_deg: float, side: int) -> Image:
    """(side, side) of the values of ridges in their own frame, turned to an azimuth about the middle of a field."""
    turn = np.radians(azimuth_deg)
    cos, sin = float(np.cos(turn)), float(np.sin(turn))
    place = (np.arange(side) + 0.5) * PIXEL_UM - 0.5 * side * PIXEL_UM
    x, y = place[None, :], place[:, None]
    across, along = cos * x + sin * y + 0.5 * side * PIXEL_UM, -sin * x + cos * y
    columns = np.floor(across / PIXEL_UM + 1e-6).astype(np.int64) % values.shape[1]
    rows = np.floor(along / PIXEL_UM + 1e-6).astype(np.int64) % values.shape[0]
    return np.asarray(values[rows, columns], dtype=np.float32)


__all__ = ["FLAT", "FieldDefectPart", "PlatePart", "PlateSample"]
