"""Verdicts on the parts of the study, by the functions that decide in inspections.

References, by what is known of the plastic ("plastic": a usual lobe with the doubt of one never measured; "calibrated":
on a flat coupon of the same world) and by the parts that are compared with:

- `plastic`, `design`: the prediction, of a plastic never measured and of a calibrated one.
- `golden-NxB`: N golden parts of the rig, from B batches; `plastic-3x2` the same with a plastic never measured.
- lots: the other parts of the lot that are alike, and the prediction, at half of the level each.

The verdict is by the means of all poses: FAIL where they deviate, PASS where every named defect of its smallest
interesting size is excluded, else INCONCLUSIVE. It is put together here from the parts of `decision.decide`, because
limits against the prediction take most of the time and most parts leave the first defect open (a test compares both).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.significance import chi2_tail, log_basis
from anisoscope.decision.consistency import distances, scatter_of
from anisoscope.decision.exclusion import Exclusion
from anisoscope.decision.lot_reference import alike
from anisoscope.decision.predictive import Scatter, predictive_test
from anisoscope.decision.surface_exclusion import (
    CONTRADICTED,
    excluded_by_parts,
    excluded_by_prediction,
)
from anisoscope.fit.lobe import POSE_NOISE, Scan, coupon, coupon_poses, fit_lobe
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.inspection.material_calibration import residual_test
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.parameters.geometry import Convention
from anisoscope.prediction.expectation import Component, Expectation, expectation
from anisoscope.prediction.part_scatter import PartScatter, named_defects, part_scatter
from anisoscope.prediction.propagation import TAIL
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.material_file import CovariancePart, LobePart, MaterialFile, ValidityPart
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.pathtracer.tracer import PathTracer
from detection_study.chunk import MEASURED_SOURCES, Columns
from detection_study.lobes import lobes_of, plastic_of
from detection_study.product import (
    CHOSEN,
    GOLDEN,
    LIGHT_DEG,
    WHOLE,
    WORLDS,
    RecipeName,
    Size,
    World,
    recipe_of,
    rendered_as,
)

Known = Literal["plastic", "calibrated"]
Rows = npt.NDArray[np.int_]
LEVEL = 0.01
SHARED_SOURCES = ("stray light",)
_SEED = 3


@dataclass(frozen=True)
class Rule:
    """A reference: what is known of the plastic, and how many golden parts there are of how many batches."""

    known: Known
    count: int = 0
    batches: int = 0


RULES = {
    "plastic": Rule("plastic"),
    "design": Rule("calibrated"),
    **{
        f"golden-{count}x{batches}": Rule("calibrated", count, batches)
        for count, batches in (
            (1, 1), (3, 1), (5, 1), (10, 1), (25, 1), (3, 2), (5, 2), (10, 2), (25, 2), (25, 5)
        )
    },
    "plastic-3x2": Rule("plastic", 3, 2),
}  # fmt: skip
LOTS = {"lot-5-0": (5, 0), "lot-5-1": (5, 1), "lot-10-0": (10, 0), "lot-10-1": (10, 1), "lot-10-2": (10, 2)}
"""Parts of a lot, and how many of them are bad."""


@dataclass(frozen=True)
class Calibration:
    """A plastic calibrated on a coupon of one world, as ``calibrate material`` does.

    Attributes:
        file: values and covariance.
        residual_over_noise: 1 where the family of lobes fits.
    """

    file: MaterialFile
    residual_over_noise: float


@lru_cache(maxsize=8)
def calibration_of(world: World, seed: int) -> Calibration:
    """Scan a flat coupon in the poses of ``calibrate material``, each with `POSE_NOISE`, and fit its lobe."""
    world = rendered_as(world)
    specimen, poses, convention = coupon(), coupon_poses(), Convention(LIGHT_DEG)
    material = lobes_of(world).smooth
    to_light, to_camera = directions(poses, convention)
    if WORLDS[world].traced:
        flat = HeightMap(np.zeros((3, 3)), 10.0, 10.0, {})
        tracer = PathTracer(flat, plastic_of(world, material), reflections=1)
        pairs = zip(to_light, to_camera, strict=True)
        radiance = np.array([float(tracer.direct(*pair).mean(dtype=np.float64)) for pair in pairs])
    else:
        radiance = specimen.direct(to_light, to_camera, specimen.design, material)
    rng = np.random.default_rng([seed, 23])
    noisy = radiance * np.exp(POSE_NOISE * rng.standard_normal(len(poses)))
    found = fit_lobe(Scan(poses, convention, noisy, np.zeros(len(poses))), specimen, WHOLE)
    file = MaterialFile(
        id=f"material-{world}",
        name=f"plastic of the world {world}",
        material=LobePart(**vars(found.material)),
        covariance=CovariancePart(
            parameters=found.information.lobe,
            matrix=tuple(map(tuple, found.information.material_covariance.tolist())),
        ),
        validity=ValidityPart(half_angle_deg=found.half_angle_deg),
        test=residual_test(found),
    )
    return Calibration(file, found.residual_over_noise)


@dataclass(frozen=True, eq=False)
class Judge:
    """One recipe in one world with what it predicts, and the parts as it sees them.

    Attributes:
        recipes: by what is known of the plastic, without a limit of the area.
        area_recipe: that of the calibrated plastic with it.
        expected: predictions, likewise.
        parts: scatter of good parts, likewise.
        columns: of all parts.
        chosen: its poses among those that were photographed.
        errors: root mean squares over the parts of the components of a measurement.
    """

    recipes: Mapping[Known, RidgeRecipe]
    area_recipe: RidgeRecipe
    expected: Mapping[Known, Expectation]
    parts: Mapping[Known, PartScatter]
    columns: Columns
    chosen: tuple[int, ...]
    errors: tuple[Component, ...]
    _limits: dict[tuple[Known, int | None, str], Exclusion] = field(default_factory=dict)

    @cached_property
    def log_radiance(self) -> FloatArray:
        """(N, P) of all parts."""
        return np.asarray(self.columns["log_radiance"][:, list(self.chosen)])

    @cached_property
    def contrasts(self) -> FloatArray:
        """(N, P − 1) in the basis of `log_basis`."""
        return np.asarray(self.log_radiance @ log_basis(len(self.chosen)).T)

    @cached_property
    def own(self) -> FloatArray:
        """(N, S, P) relative components of the measurement of all parts."""
        return np.asarray(self.columns["own"][:, :, list(self.chosen)])

    @cached_property
    def from_prediction(self) -> dict[Known, FloatArray]:
        """(N,) p values of judged parts against the predictions, those of lots with a calibrated plastic only."""
        judged = self.columns["kind"] != GOLDEN
        found = {known: np.ones(len(self.log_radiance)) for known in self.expected}
        for known, expected in self.expected.items():
            rows = np.flatnonzero(judged & ~self.columns["lot"] if known == "plastic" else judged)
            found[known][rows] = from_prediction(expected, self.log_radiance[rows], self.own[rows])
        return found

    @cached_property
    def golden(self) -> dict[int, Rows]:
        """Rows of the golden parts by rig."""
        rows = self.numbers(GOLDEN)
        rigs = self.columns["rig"][rows]
        return {int(rig): rows[rigs == rig] for rig in np.unique(rigs)}

    @cached_property
    def scatters(self) -> dict[Known, Scatter]:
        """Scatter of the contrasts of good parts with the errors of one inspection."""
        return {known: scatter_of(parts, self.measured(0)) for known, parts in self.parts.items()}

    @cached_property
    def hardest(self) -> dict[Known, tuple[str, ...]]:
        """The named defects, that of which the prediction leaves most open first."""
        return {
            known: tuple(sorted(parts.changes, key=lambda name: -self.limit(known, None, name).limit))
            for known, parts in self.parts.items()
        }

    def numbers(self, kind: str, *, of_lot: bool = False) -> Rows:
        """Rows of a kind of parts."""
        return np.flatnonzero((self.columns["kind"] == kind) & (self.columns["lot"] == of_lot))

    def measured(self, row: int) -> Measured:
        """A part as it was measured, with the usual errors."""
        count = len(self.chosen)
        nowhere = Grid((0.0, 0.0), 1.0, (1, 1))
        radiance = np.exp(self.log_radiance[row])
        return Measured(radiance, self.errors, (), np.ones((count, 1, 1)), np.zeros(count), nowhere, None)

    def limit(self, known: Known, row: int | None, defect: str) -> Exclusion:
        """Limit of one defect against the prediction, of a part or (None) of one exactly as predicted."""
        if (known, row, defect) not in self._limits:
            expected, parts = self.expected[known], self.parts[known]
            radiance = expected.radiance if row is None else np.exp(self.log_radiance[row])
            alone = replace(parts, changes={defect: parts.changes[defect]})
            (found,) = excluded_by_prediction(expected, radiance, self.errors, alone, self.recipes[known])
            self._limits[known, row, defect] = found
        return self._limits[known, row, defect]

    def against(self, rule: Rule, row: int, number: int) -> "Compared | None":
        """A part against the reference of a rule; None where its rig has too few golden parts.

        Args:
            rule: the rule.
            row: of the part.
            number: of the part, which chooses the golden parts.
        """
        if not rule.count:
            return Compared(self, rule.known, row, float(self.from_prediction[rule.known][row]))
        rig = int(self.columns["rig"][row])
        mates = self.golden.get(rig, np.zeros(0, dtype=int))
        chosen = golden_of(self.columns["batch"][mates], rule, rig, number)
        if chosen is None:
            return None
        golden = self.contrasts[mates[chosen]]
        test = predictive_test(self.scatters[rule.known], golden, self.contrasts[row], LEVEL, rule.batches)
        return Compared(self, rule.known, row, test.p_value, golden, test.size, rule.batches)

    def in_lot(self, known: Known, row: int, others: Rows) -> "Compared":
        """A part of a lot against the others, as `golden` sets of a lot are: by those alike, or the prediction."""
        scatter = self.scatters[known]
        near, _ = alike(self.contrasts[[*others, row]], scatter.covariance)
        golden = self.contrasts[others[near[:-1]]]
        test = predictive_test(scatter, golden, self.contrasts[row], LEVEL)
        p_value = min(2.0 * min(test.p_value, float(self.from_prediction[known][row])), 1.0)
        return Compared(self, known, row, p_value, golden, test.size, len(golden), of_lot=True)


@dataclass(frozen=True, eq=False)
class Compared:
    """A part compared with a reference; arguments as of `excluded_by_parts`."""

    judge: Judge
    known: Known
    row: int
    p_value: float
    golden: FloatArray | None = None
    size: float = 1.0
    batches: int = 0
    of_lot: bool = False

    @property
    def fails(self) -> bool:
        """Whether the means deviate."""
        return self.p_value < LEVEL

    @cached_property
    def _by_parts(self) -> dict[str, Exclusion]:
        assert self.golden is not None
        judge, known = self.judge, self.known
        measured = judge.measured(self.row)
        found = excluded_by_parts(
            judge.parts[known], measured, judge.recipes[known], self.golden, self.size, self.batches
        )
        return {one.defect.name: one for one in found}

    def excludes(self, defect: str) -> bool:
        """Whether the part excludes a defect of its smallest interesting size; a part that fails excludes nothing."""
        judge, known = self.judge, self.known
        if self.fails:
            return False
        if self.golden is not None:
            own = self._by_parts[defect]
            contradicted = judge.from_prediction[known][self.row] < CONTRADICTED
            planned = judge.limit(known, None, defect)
            if self.of_lot or contradicted or own.limit - own.best <= planned.limit:
                return own.excluded
        return judge.limit(known, self.row, defect).excluded

    @cached_property
    def passes(self) -> bool:
        """Whether the means do not deviate, and exclude every defect."""
        return not self.fails and all(self.excludes(name) for name in self.judge.hardest[self.known])


def own_defect(judge: Judge, kind: str, row: int) -> str:
    """Name of the defect that a part of a class of exactly the smallest interesting size has."""
    names = [one.name for one in named_defects(judge.area_recipe)]
    place = {"height-loss": 2, "roughness": 4, "wear": 5}
    return names[place.get(kind, 0 if judge.columns["extent"][row] > 0.0 else 1)]


def judge_of(world: World, columns: Columns, name: RecipeName, size: Size, seed: int) -> Judge:
    """The judge of a recipe in a world; parts with an INVALID measurement must be left out before."""
    calibrated = recipe_of(name, size, calibration_of(world, seed).file)
    both: dict[Known, RidgeRecipe] = {"plastic": recipe_of(name, size), "calibrated": calibrated}
    recipes = {known: recipe.model_copy(update={"area": None}) for known, recipe in both.items()}
    chosen = CHOSEN[name]
    rms = np.sqrt(np.mean(columns["own"][:, :, list(chosen)] ** 2, axis=0))
    errors = tuple(
        Component(source, "measurement", one, source in SHARED_SOURCES)
        for source, one in zip(MEASURED_SOURCES, rms, strict=True)
    )
    parts = {}
    for known, recipe in recipes.items():
        found = part_scatter(recipe, LIGHT_DEG)
        assert found is not None
        parts[known] = found
    expected = {known: expectation(recipe, LIGHT_DEG) for known, recipe in recipes.items()}
    return Judge(recipes, calibrated, expected, parts, columns, chosen, errors)


def covariance_of_measurement(own: FloatArray) -> FloatArray:
    """(N, P, P) covariances from the (N, S, P) components of the measurements."""
    shared = np.array([source in SHARED_SOURCES for source in MEASURED_SOURCES])
    alone = np.sum(own[:, ~shared] ** 2, axis=1)
    together = np.einsum("nsi,nsj->nij", own[:, shared], own[:, shared])
    return np.asarray(together + alone[:, :, None] * np.eye(own.shape[2]))


def from_prediction(expected: Expectation, log_radiance: FloatArray, own: FloatArray) -> FloatArray:
    """(N,) p values of parts as `consistency.from_prediction` gives them one by one."""
    basis = log_basis(len(expected.poses))
    known = [c for c in expected.alone if expected.lobes is None or c.source != TAIL]
    alone = covariance_of_measurement(own) + np.sum([c.covariance() for c in known], axis=0)
    off = (log_radiance - np.log(expected.radiance)) @ basis.T
    return chi2_tail(distances(expected, off, basis @ alone @ basis.T), len(basis))


def golden_of(batches: Rows, rule: Rule, rig: int, number: int) -> Rows | None:
    """Places of the golden parts of a rule with which a part of a rig is compared, drawn for each part.

    Args:
        batches: of the golden parts of the rig.
        rule: how many of how many batches, from each as many as from the others but for one.
        rig: number of the rig.
        number: of the part.
    """
    rng = np.random.default_rng([_SEED, rig, number])
    wanted = [rule.count // rule.batches + (k < rule.count % rule.batches) for k in range(rule.batches)]
    pools = [np.flatnonzero(batches == one) for one in np.unique(batches)]
    large = [pool for pool in pools if len(pool) >= wanted[0]]
    if len(large) < rule.batches:
        return None
    taken = rng.permutation(len(large))[: rule.batches]
    return np.concatenate([rng.permutation(large[k])[:n] for k, n in zip(taken, wanted, strict=True)])
