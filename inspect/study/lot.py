"""Parts of a lot, drawn from tolerances, predicted, measured without pictures and judged by the rule of a recipe.

Parts are drawn in groups, a group a rig. What a rig and its plastic share, and what the prediction may be off by, is
drawn once a rig as the budget states it; what differs between parts and between inspections, for every part. A part is
predicted by the recipe's own optics: its ln L is that of the recipe plus its difference from the nominal part; with a
height map both are those of the design like it. Errors of these optics beyond the budget are in no verdict.
"""

import json
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import cast

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.decision.consistency import OF_THE_RIG
from anisoscope.decision.decision import decide, pair_values
from anisoscope.decision.reference_parts import GoldenPart, GoldenSet
from anisoscope.diagnosis.separability import planned_components
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.kinds.registry import kind_of
from anisoscope.parameters.detection import LotSize
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.prediction.cache import cached_expectation, prediction_key
from anisoscope.prediction.crest_edges import crest_edges, edge_radius_model
from anisoscope.prediction.crests import EDGE_RADIUS
from anisoscope.prediction.expectation import (
    PLASTIC,
    Component,
    Expectation,
    nominal_shape,
    recipe_uncertainty,
)
from anisoscope.prediction.input_doubt import SCATTER
from anisoscope.prediction.part_scatter import PartScatter, part_scatter, scatter_of_inputs, with_design
from anisoscope.prediction.propagation import PLASTIC_AND_SEAT, RIDGE_ANGLE, TAIL
from anisoscope.prediction.recipe_models import models_of
from anisoscope.prediction.second_order import INDEX_RANGE
from anisoscope.prediction.sensitivity import (
    ALPHA_RANGE,
    DARK,
    SECOND_ORDER,
    SHAPE_RANGE,
    Shape,
    State,
    Surface,
    evaluate,
)
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.record.verdict import Verdict
from anisoscope.sim.light.contrasts import consecutive_pairs
from anisoscope.sim.light.geometry import directions

VERDICTS = (Verdict.PASS, Verdict.INCONCLUSIVE, Verdict.FAIL)
LEAST_RIGS = 2
_LARGEST_LOSS = 0.99
_RADII, _FARTHEST = 9, 4.0
"""Radii of the crests that are predicted, and how many standard deviations they reach."""
_IN_STATES = {*PLASTIC_AND_SEAT, RIDGE_ANGLE, EDGE_RADIUS, TAIL}
"""Sources of the budget that are drawn as states of the part; of the others their components are."""
_SETTINGS = 4


@dataclass(frozen=True)
class Spread:
    """Standard deviations between the parts of a lot.

    Attributes:
        ridge_angle: of the ridge angle in degrees.
        alpha: of the roughness along and, independently, across, as a share of it.
        albedo: of the albedo, as a share of it.
        height_loss: of the height that is missing at the crests, as a share of the height; its size counts.
        edge_radius: of the radius of the crests in µm; its size counts.
        seating: of the tilt of the seated part about its x and its y axis, in degrees.
    """

    ridge_angle: float = 0.0
    alpha: float = 0.0
    albedo: float = 0.0
    height_loss: float = 0.0
    edge_radius: float = 0.0
    seating: float = 0.0

    def __post_init__(self) -> None:
        for one in fields(self):
            if not 0.0 <= getattr(self, one.name) < float("inf"):
                raise UsageError(
                    f"the standard deviation of {one.name} must be 0 or more, not {getattr(self, one.name):g}"
                )

    @classmethod
    def of(cls, recipe: SurfaceRecipe) -> "Spread":
        """That of good parts, as [scatter] of the recipe states it."""
        own, edges = scatter_of_inputs(recipe), recipe.surface.design
        radius = 0.0 if edges is None else edges.edge_radius_um or 0.0
        return cls(
            own.ridge_angle_deg,
            own.alpha_share,
            recipe.stated_scatter.albedo_share,
            0.0,
            recipe.stated_scatter.edge_radius_share * radius,
            own.seating_tilt_deg,
        )


@dataclass(frozen=True)
class Shift:
    """How far the mean of a lot is from the nominal part, in the units of `Spread`."""

    ridge_angle: float = 0.0
    alpha: float = 0.0
    albedo: float = 0.0
    height_loss: float = 0.0
    edge_radius: float = 0.0

    def __post_init__(self) -> None:
        for one in fields(self):
            if not np.isfinite(getattr(self, one.name)):
                raise UsageError(f"the shift of {one.name} must be a finite number")


@dataclass(frozen=True)
class Lot:
    """A lot of parts and how it is inspected.

    Attributes:
        recipe: with a design, or with a height map that has ridges.
        light_angle_deg: the rig's angle between light and camera.
        spread: between the parts.
        shift: of their mean.
        parts: number of parts.
        rigs: on which they are inspected, as many parts on each.
        golden: golden parts of every rig, which scatter as the recipe states; 0 compares with the prediction.
        u_pose: relative standard uncertainty of a pose by the noise of camera and lamp.

    Raises:
        UsageError: fewer than two rigs, fewer parts than rigs, or a number that means nothing.
    """

    recipe: SurfaceRecipe
    light_angle_deg: float
    spread: Spread
    shift: Shift = field(default_factory=Shift)
    parts: int = 1000
    rigs: int = 25
    golden: int = 0
    u_pose: float = 0.003

    def __post_init__(self) -> None:
        if self.rigs < LEAST_RIGS or self.parts < self.rigs:
            raise UsageError(
                f"a lot is inspected on {LEAST_RIGS} rigs or more, one part each at least, not {self.parts} parts on "
                f"{self.rigs}"
            )
        if self.golden < 0:
            raise UsageError(f"the number of golden parts is 0 or more, not {self.golden}")
        if not 0.0 <= self.u_pose < 1.0:
            raise UsageError(f"the uncertainty of a pose by camera and lamp is a share, not {self.u_pose:g}")

    def on_rig(self, number: int) -> int:
        """Parts on a rig."""
        return self.parts // self.rigs + (number < self.parts % self.rigs)


def lot_of(
    path: Path,
    light_angle_deg: float,
    size: LotSize,
    spread: Spread | None = None,
    shift: Shift | None = None,
) -> Lot:
    """Lot of a recipe file; arguments as for `Lot`, and no spread is that of good parts in the recipe.

    Raises:
        RecipeError: the file is missing or wrong.
        UsageError: a kind of part whose recipes state no scatter, and as for `Lot`.
    """
    kind = kind_of(path)
    if not getattr(getattr(kind, "reference_set", None), "predictive", False):
        raise UsageError(
            f"{path}: a lot is drawn where a recipe states how good parts differ ([scatter]), not for {kind.one}"
        )
    recipe = cast("SurfaceRecipe", kind.read_recipe(path))
    usual = Spread.of(recipe) if spread is None else spread
    return Lot(
        recipe,
        light_angle_deg,
        usual,
        shift or Shift(),
        size.parts,
        size.rigs,
        size.golden_parts,
        size.u_pose,
    )


@dataclass(frozen=True, eq=False)
class Judged:
    """N judged parts of a rig.

    Attributes:
        verdict: (N,) places in `VERDICTS`.
        significant: (N,) whether all contrasts together deviate significantly.
        deviation: (N, C) measured contrasts less the predicted ones.
        true: (N, C) the same of the parts themselves, seated and turned exactly; NaN without tolerances.
        u: (N, C) standard uncertainties of the deviations.
    """

    verdict: npt.NDArray[np.int_]
    significant: npt.NDArray[np.bool_]
    deviation: FloatArray
    true: FloatArray
    u: FloatArray


@dataclass(frozen=True, eq=False)
class Setting:
    """What all parts of a lot share.

    Attributes:
        expected: the prediction that they are compared with.
        recipe: the rule that judges them; pictures are judged by none.
        surface: predictor of a part's shape.
        nominal: state of the nominal part.
        usual: (P,) ln L of the nominal part by that predictor.
        common: standard uncertainties of what the parts of a rig share.
        follows_tail: whether the predictor knows every tail of the lobe; otherwise ln L is shifted by it.
        crests: radii of the crests.
        model: components of the prediction that are drawn once a rig.
        errors: components of a measurement.
        scatter: of good parts, or None where neither golden parts nor defects to exclude need it.
    """

    expected: Expectation
    recipe: SurfaceRecipe
    surface: Surface
    nominal: State
    usual: FloatArray
    common: InputUncertainty
    follows_tail: bool
    crests: "_Crests"
    model: tuple[Component, ...]
    errors: tuple[Component, ...]
    scatter: PartScatter | None


_settings: OrderedDict[str, Setting] = OrderedDict()


def setting_of(lot: Lot) -> Setting:
    """Predictions of a lot; the last few stay in memory.

    Raises:
        UsageError: golden parts where good parts have no known scatter.
        HeightMapError: the height map cannot be read or has no ridges, or a radius of the crests leaves no facet.
        RecipeError: as for a prediction.
    """
    recipe = lot.recipe.deciding()
    lot = replace(lot, recipe=recipe.model_copy(update={"area": None}))
    given = {
        "recipe": lot.recipe.model_dump(mode="json"),
        "map": prediction_key(recipe, lot.light_angle_deg, PLASTIC)["map"],
        "crests": [lot.spread.edge_radius, lot.shift.edge_radius],
        "others": [lot.light_angle_deg, lot.u_pose, lot.golden > 0],
    }
    key = json.dumps(given, sort_keys=True)
    if key not in _settings:
        _settings[key] = _computed(lot)
        while len(_settings) > _SETTINGS:
            _settings.popitem(last=False)
    return _settings[key]


def _computed(lot: Lot) -> Setting:
    recipe = lot.recipe
    expected = cached_expectation(recipe, lot.light_angle_deg)
    ideal, poses, convention = with_design(recipe), expected.poses, expected.convention
    models = models_of(ideal, poses, convention)
    nominal = State(ideal.material.material(), lot.light_angle_deg, shape=nominal_shape(ideal))
    wanted = lot.golden or recipe.decision.unexcluded == "inconclusive"
    scatter = part_scatter(recipe, lot.light_angle_deg) if wanted else None
    if lot.golden and scatter is None:
        raise UsageError(
            "good parts of this recipe have no known scatter, because a pose is dark in some state of them: leave the "
            "golden parts out, or the pose"
        )
    noise = np.full(len(poses), lot.u_pose)
    return Setting(
        expected,
        recipe,
        models.sampled,
        nominal,
        np.log(evaluate(models.sampled, [nominal], poses, convention)[0]),
        _common(recipe),
        recipe.material.calibrated is None and models.rays is None,
        _crests(lot, ideal, expected),
        tuple(
            one
            for one in expected.components
            if one.source.removeprefix(SCATTER) not in _IN_STATES and not one.source.endswith(SECOND_ORDER)
        ),
        (
            Component("noise of camera and photons", "measurement", noise, shared=False),
            *planned_components(recipe, expected),
        ),
        scatter,
    )


def _common(recipe: SurfaceRecipe) -> InputUncertainty:
    """What all parts of a rig share: the uncertainties of a part's plastic hold its scatter, which is drawn apart."""
    stated, own = recipe_uncertainty(recipe), scatter_of_inputs(recipe)
    return replace(
        stated,
        alpha_share=float(np.sqrt(max(stated.alpha_share**2 - own.alpha_share**2, 0.0))),
        albedo=float(np.sqrt(max(stated.albedo**2 - own.albedo**2, 0.0))),
    )


@dataclass(frozen=True, eq=False)
class _Crests:
    """Radii of the crests of a lot.

    Attributes:
        mean_um: mean radius, nominal and shift.
        u_um: standard uncertainty of that mean; where the radius is unmeasured, the largest one.
        unmeasured: any radius from 0 to ``u_um`` more is as likely.
        radii_um: (R,) radii, ascending.
        change: (R, P) change of ln L by them.
    """

    mean_um: float
    u_um: float
    unmeasured: bool
    radii_um: FloatArray
    change: FloatArray

    def drawn(self, rng: np.random.Generator) -> float:
        """Mean radius on one rig."""
        return self.mean_um + self.u_um * float(rng.uniform() if self.unmeasured else rng.standard_normal())

    def of(self, radius_um: FloatArray) -> FloatArray:
        """(N, P) change of ln L by (N,) radii, between the known ones."""
        return np.column_stack([np.interp(radius_um, self.radii_um, one) for one in self.change.T])


def _crests(lot: Lot, ideal: SurfaceRecipe, expected: Expectation) -> _Crests:
    design, material = ideal.surface.design, ideal.material.material()
    assert design is not None
    edges = crest_edges(ideal, material, expected.convention)
    start, unmeasured = design.edge_radius_um or 0.0, design.edge_radius_um is None
    mean, u = start + lot.shift.edge_radius, 0.0 if edges is None else edges.u_um
    u *= float(np.sqrt(3.0)) if unmeasured else 1.0
    reach = _FARTHEST * max(lot.spread.edge_radius, Spread.of(lot.recipe).edge_radius)
    reach += u if unmeasured else _FARTHEST * u
    radii = np.unique([start, *np.abs(np.linspace(mean - reach, mean + reach, _RADII))])
    sides = directions(expected.poses, expected.convention)
    light = [edge_radius_model(ideal, float(one), expected.convention)(*sides, material) for one in radii]
    change = np.log(np.maximum(np.array(light), DARK))
    return _Crests(mean, u, unmeasured, radii, change - change[np.searchsorted(radii, start)])


@dataclass(frozen=True, eq=False)
class _Rig:
    """A rig with its plastic, as drawn.

    Attributes:
        usual: state of its mean part.
        radius_um: mean radius of the crests.
        offset: (P,) error of the prediction in ln L.
        error: (P,) error in ln L that all measurements share.
    """

    usual: State
    radius_um: float
    offset: FloatArray
    error: FloatArray


def _drawn_rig(setting: Setting, rng: np.random.Generator) -> _Rig:
    common, plastic, lobes = setting.common, setting.nominal.material, setting.expected.lobes
    offset, tail = _errors(setting.model, 1, rng)[0], plastic.tail
    if lobes is not None:
        ends = float(lobes.tails[0]), float(lobes.tails[-1])
        tail = rng.uniform(*ends) if np.isinf(lobes.u) else lobes.nominal + lobes.u * rng.standard_normal()
        tail = float(np.clip(tail, *ends))
        if not setting.follows_tail:
            offset, tail = offset + lobes.at(tail)[0], plastic.tail
    along, across, albedo, index, light = rng.standard_normal(5)
    material = replace(
        plastic,
        alpha_along=float(np.clip(plastic.alpha_along * (1.0 + common.alpha_share * along), *ALPHA_RANGE)),
        alpha_across=float(np.clip(plastic.alpha_across * (1.0 + common.alpha_share * across), *ALPHA_RANGE)),
        albedo=float(np.clip(plastic.albedo + common.albedo * albedo, 0.0, 1.0)),
        index=float(np.clip(plastic.index + common.index * index, *INDEX_RANGE)),
        tail=tail,
    )
    angle = setting.nominal.light_angle_deg + common.light_angle_deg * float(light)
    usual = replace(setting.nominal, material=material, light_angle_deg=angle)
    shared = tuple(one for one in setting.errors if one.source in OF_THE_RIG)
    return _Rig(usual, setting.crests.drawn(rng), offset, _errors(shared, 1, rng)[0])


def _errors(components: Sequence[Component], count: int, rng: np.random.Generator) -> FloatArray:
    """(N, P) errors of ln L with the covariance of components."""
    total = np.zeros((count, len(components[0].relative)))
    for one in components:
        z = rng.standard_normal((count, 1 if one.shared else len(one.relative)))
        total += z * one.relative
    return total


@dataclass(frozen=True, eq=False)
class Light:
    """ln L of N parts.

    Attributes:
        true: (N, P) of the parts, seated and turned exactly; NaN where no tolerance asks for it.
        measured: (N, P).
    """

    true: FloatArray
    measured: FloatArray


def drawn_parts(
    setting: Setting, rig: _Rig, count: int, spread: Spread, shift: Shift, rng: np.random.Generator
) -> Light:
    """Parts of a rig with a spread about a shifted mean, predicted in their states and measured with errors."""
    z = rng.standard_normal((count, 8))
    usual, shape = rig.usual.material, rig.usual.shape
    states = []
    for one in z:
        material = replace(
            usual,
            alpha_along=_rough(usual.alpha_along, shift.alpha, spread.alpha * float(one[0])),
            alpha_across=_rough(usual.alpha_across, shift.alpha, spread.alpha * float(one[1])),
            albedo=float(np.clip(usual.albedo * (1.0 + shift.albedo + spread.albedo * one[2]), 0.0, 1.0)),
        )
        angle = shape.ridge_angle_deg + shift.ridge_angle + spread.ridge_angle * float(one[3])
        loss = min(abs(float(shift.height_loss + spread.height_loss * one[4])), _LARGEST_LOSS)
        own = Shape(float(np.clip(angle, *SHAPE_RANGE["ridge_angle_deg"])), loss)
        seat = spread.seating * one[5:7]
        seating = float(seat[0]), float(seat[1])
        states.append(replace(rig.usual, material=material, shape=own, seating_deg=seating))
    if setting.recipe.tolerances() is not None:  # in one call a part: its groove is the same
        angle = setting.nominal.light_angle_deg
        states += [replace(one, light_angle_deg=angle, seating_deg=(0.0, 0.0)) for one in states]
    poses, convention = setting.expected.poses, setting.expected.convention
    radiance = evaluate(setting.surface, states, poses, convention)
    change = np.log(np.maximum(radiance, DARK)) - setting.usual
    crests = setting.crests.of(np.abs(rig.radius_um + spread.edge_radius * z[:, 7]))
    change = change.reshape(-1, count, len(poses)) + crests + rig.offset + np.log(setting.expected.radiance)
    single = tuple(one for one in setting.errors if one.source not in OF_THE_RIG)
    measured = change[0] + rig.error + _errors(single, count, rng)
    return Light(change[1] if len(change) > 1 else np.full_like(measured, np.nan), measured)


def _rough(usual: float, shift: float, off: float) -> float:
    return float(np.clip(usual * (1.0 + shift) * np.exp(off), *ALPHA_RANGE))


def measured_as(setting: Setting, log_radiance: FloatArray) -> Measured:
    """(P,) ln L as a measurement without pictures."""
    none = np.empty((len(log_radiance), 0, 0))
    grid = Grid((0.0, 0.0), 1.0, (0, 0))
    return Measured(
        np.exp(log_radiance), setting.errors, (), none, np.zeros(len(log_radiance)), grid, drift=None
    )


def judged_on_rig(task: tuple[Lot, int], rng: np.random.Generator) -> Judged:
    """Draw one rig of a lot and judge its parts.

    Args:
        task: the lot, and the number of the rig.
        rng: of that rig.
    """
    lot, number = task
    setting = setting_of(lot)
    rig, expected = _drawn_rig(setting, rng), setting.expected
    golden = None
    if lot.golden:
        own = drawn_parts(setting, rig, lot.golden, Spread.of(lot.recipe), Shift(), rng)
        golden = golden_set(setting, own.measured)
    light = drawn_parts(setting, rig, lot.on_rig(number), lot.spread, lot.shift, rng)
    decided = [
        decide(
            expected,
            measured_as(setting, one),
            setting.recipe,
            golden,
            setting.scatter,
            exclude=setting.recipe.decision.unexcluded == "inconclusive",
        )
        for one in light.measured
    ]
    pairs, kind = consecutive_pairs(expected.poses), setting.recipe.decision.contrast
    true = np.array([pair_values(pairs, np.exp(one), kind) for one in light.true])
    true = true - pair_values(pairs, expected.radiance, kind)
    rule = setting.recipe.decision
    return Judged(
        np.array([VERDICTS.index(one.verdict) for one in decided]),
        np.array([one.p_value < rule.alpha for one in decided]),
        np.array([[pair.deviation for pair in one.contrasts] for one in decided]),
        true,
        np.array([[pair.u for pair in one.contrasts] for one in decided]),
    )


def golden_set(setting: Setting, log_radiance: FloatArray) -> GoldenSet:
    """(G, P) ln L of good parts as the golden parts of a rig."""
    poses = tuple((pose.stage_deg, pose.tilt_deg) for pose in setting.expected.poses)
    parts = tuple(
        GoldenPart(
            serial=f"golden {number}",
            inspected_at="",
            lot=str(number),
            log_radiance=tuple(one.tolist()),
            area_share=None,
            verdict="PASS",
        )
        for number, one in enumerate(log_radiance, 1)
    )
    return GoldenSet(product=setting.recipe.product, recipe_key="", poses=poses, parts=parts)
