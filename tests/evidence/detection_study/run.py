"""Detection study: rates of false alarms and misses of thousands of parts on virtual rigs, in several worlds.

The same world renders with the predictor's own lobe and reflections. All others are rendered by a path tracer that
shares nothing with the prediction: with its lobe or with others, with a slightly non-linear camera or a near lamp, or
all of these (`other`). Claims rest on them. Every rig has a set of golden parts, and all its parts meet it.

Judges by what is known of the plastic and the number n of golden parts:

- `plastic-0`: against the prediction; of the plastic a usual lobe is stated, with the doubt of one never measured.
- `calibrated-0`: against the prediction with the plastic calibrated on a flat coupon of the same world; `[scatter]` is
  left to golden parts.
- `spread-0`: the same with `[scatter]` in the budget, as in inspections.
- `plastic-3`, `calibrated-1`, `-3`, `-10`, `-25`: against n golden parts of the rig, by the predictive test.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cache import Cache
from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.base.significance import chi2_tail, log_basis
from anisoscope.decision.consistency import OF_THE_RIG, contrast_scatter, distances
from anisoscope.decision.predictive import Scatter, predictive_test
from anisoscope.diagnosis.cell_levels import SMEAR_PX
from anisoscope.diagnosis.evidence import (
    Evidence,
    against,
    background_of,
    background_of_parts,
    covariance_of,
    inputs_of,
)
from anisoscope.diagnosis.ranking import NOTHING, diagnose
from anisoscope.diagnosis.signature_cache import cached_signatures
from anisoscope.diagnosis.signatures import Signatures, signatures
from anisoscope.fit.lobe import POSE_NOISE, Scan, coupon, coupon_poses, fit_lobe
from anisoscope.imaging.defect_regions import MarkForm
from anisoscope.inspection.material_calibration import residual_test
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.parameters.geometry import Convention
from anisoscope.prediction.expectation import Component, Expectation, expectation
from anisoscope.prediction.part_scatter import part_scatter
from anisoscope.prediction.propagation import TAIL
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.material_file import (
    CovariancePart,
    LobePart,
    MaterialFile,
    ValidityPart,
)
from anisoscope.sim.light.contrasts import consecutive_pairs
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.pathtracer.tracer import PathTracer
from anisoscope.study.statistics import Rate, rate
from anisoscope.study.sweep import Workers, sweep
from detection_study.chunk import MEASURED_SOURCES, Bounces, ChunkTask, Columns, inspect_chunk
from detection_study.lobes import lobes_of, plastic_of
from detection_study.mitsuba import judged
from detection_study.product import (
    ALBEDO_SPREAD,
    ALPHA_SPREAD,
    BURRS_ON_GOOD,
    BY_NAME,
    CHOSEN,
    CLASSES,
    FRAMES,
    GOLDEN,
    GOOD,
    LED_DISTANCE_MM,
    LIGHT_DEG,
    MARKER_ERROR_PX,
    NONLINEARITY,
    PITCH_UM,
    RIDGE_ANGLE_DEG,
    RIDGE_ANGLE_SPREAD_DEG,
    WHOLE,
    WORLDS,
    RecipeName,
    Size,
    World,
    recipe_of,
    rendered_as,
)
from detection_study.sheets import bounces_of, prepare_sheet, sheet_tasks
from detection_study.statistics import Area, area_under_curve, ideal_scores, nearest_curves, uniformity
from detection_study.surrogate import SurrogateTask, bases_of, curves_of, prepare_surrogate

Results = dict[str, Any]
Curves = Mapping[str, tuple[FloatArray, FloatArray]]
"""(E, P) changes of ln L of the poses of a recipe along every cause in one world, and (E,) −2 ln of their priors."""

COVERAGE = 1.959964
LEVEL = 0.01
RULES = (
    "plastic-0",
    "calibrated-0",
    "spread-0",
    "plastic-3",
    "calibrated-1",
    "calibrated-3",
    "calibrated-10",
    "calibrated-25",
)
DIAGNOSED_WITH = 3
"""Golden parts of the diagnosis."""
DIAGNOSED = 20
"""Parts of a class that are diagnosed, at most."""
SHARED_SOURCES = ("stray light",)
_SEED = 3


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


def without_scatter(recipe: RidgeRecipe) -> RidgeRecipe:
    """The recipe of a calibrated plastic whose prediction leaves out how parts scatter."""
    scatter = recipe.stated_scatter.model_copy(update={"in_prediction": False})
    return recipe.model_copy(update={"scatter": scatter})


@dataclass(frozen=True, eq=False)
class Judge:
    """One recipe in one world with what it predicts, and the parts as it sees them.

    Attributes:
        recipe: with the calibrated plastic.
        expected: prediction by what is known of the plastic: "plastic", "calibrated", "spread".
        scatters: of good parts, by "plastic" and "calibrated".
        columns: of all parts.
        chosen: its poses among those that were photographed.
    """

    recipe: RidgeRecipe
    expected: dict[str, Expectation]
    scatters: dict[str, Scatter]
    columns: Columns
    chosen: tuple[int, ...]

    @property
    def log_radiance(self) -> FloatArray:
        """(N, P) of all parts."""
        return np.asarray(self.columns["log_radiance"][:, list(self.chosen)])

    @property
    def own(self) -> FloatArray:
        """(N, S, P) relative components of the measurement of all parts."""
        return np.asarray(self.columns["own"][:, :, list(self.chosen)])

    def numbers(self, kind: str) -> npt.NDArray[np.int_]:
        """Rows of a kind of parts."""
        return np.flatnonzero(self.columns["kind"] == kind)


def judge_of(world: World, columns: Columns, name: RecipeName, size: Size, seed: int) -> Judge:
    """The judge of a recipe in a world; parts with an INVALID measurement must be left out before."""
    file = calibration_of(world, seed).file
    recipe, plain = recipe_of(name, size, file), recipe_of(name, size)
    recipes = {"plastic": plain, "calibrated": without_scatter(recipe), "spread": recipe}
    chosen = CHOSEN[name]
    own = columns["own"][:, :, list(chosen)]
    single = [k for k, source in enumerate(MEASURED_SOURCES) if source not in OF_THE_RIG]
    errors = np.sqrt(np.mean(np.sum(own[:, single] ** 2, axis=1), axis=0))
    scatters = {}
    for known, one in (("plastic", plain), ("calibrated", recipe)):
        parts = part_scatter(one, LIGHT_DEG)
        assert parts is not None
        usual = contrast_scatter(parts, 1.0)
        basis = log_basis(len(chosen))
        scatters[known] = replace(usual, errors=np.asarray(basis @ np.diag(errors**2) @ basis.T))
    expected = {known: expectation(one, LIGHT_DEG) for known, one in recipes.items()}
    return Judge(recipe, expected, scatters, columns, chosen)


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


def golden_of(rig: int, part: int, count: int, of: int) -> npt.NDArray[np.int_]:
    """Numbers of the ``count`` golden parts of ``of`` with which a part of a rig is compared: in turn, all of them."""
    order = np.random.default_rng([_SEED, rig]).permutation(of)
    first = part % max(of // count, 1) * count
    return order[first : first + count]


def p_values(rule: str, judge: Judge, kind: str) -> FloatArray:
    """(N,) p values of the means of all parts of a kind by a rule."""
    known, count = rule.split("-")
    rows = judge.numbers(kind)
    if count == "0":
        return from_prediction(judge.expected[known], judge.log_radiance[rows], judge.own[rows])
    basis = log_basis(len(judge.chosen))
    values = judge.log_radiance @ basis.T
    rigs, golden = judge.columns["rig"], judge.numbers(GOLDEN)
    found = []
    for number, row in enumerate(rows):
        mates = golden[rigs[golden] == rigs[row]]
        chosen = mates[golden_of(int(rigs[row]), number, int(count), len(mates))]
        found.append(predictive_test(judge.scatters[known], values[chosen], values[row], LEVEL).p_value)
    return np.array(found)


def results_of(
    world: World,
    columns: Columns,
    name: RecipeName,
    size: Size,
    seed: int,
    *,
    diagnosed: bool,
    folder: Path | None = None,
) -> Results:
    """Results of one recipe in one world.

    Args:
        world: the world.
        columns: of all parts.
        name: of the recipe.
        size: of the study.
        seed: of the study.
        diagnosed: whether causes are looked for.
        folder: of the study's cache.
    """
    valid = columns["valid"].astype(bool)
    columns = {key: values[valid] for key, values in columns.items()}
    judge = judge_of(world, columns, name, size, seed)
    kinds = (GOOD, *BY_NAME)
    p = {rule: {kind: p_values(rule, judge, kind) for kind in kinds} for rule in RULES}
    rigs = {kind: columns["rig"][judge.numbers(kind)] for kind in kinds}
    known = None
    if diagnosed:
        chosen = list(judge.chosen)
        curves = {
            cause: (curve[:, chosen], cost) for cause, (curve, cost) in curves_of(world, folder).items()
        }
        known = signatures_of(rendered_as(world), name, size, seed), curves
    return {
        "invalid": int(np.count_nonzero(~valid)),
        "calibration": {
            "residual_over_noise": calibration_of(world, seed).residual_over_noise,
            "family": "second lobe" if judge.recipe.material.second_lobe else "tail",
        },
        "false_alarms": {rule: _rate(rate(p[rule][GOOD] < LEVEL, rigs[GOOD])) for rule in RULES},
        "uniform": {rule: uniformity(p[rule][GOOD])[0] for rule in RULES},
        "area_over_limit": _over_limit(judge, name, GOOD),
        "coverage": _coverage(judge, rigs[GOOD]),
        "classes": [_class(kind.name, judge, name, p, rigs, known) for kind in CLASSES],
    }


@lru_cache(maxsize=8)
def signatures_of(world: World, name: RecipeName, size: Size, seed: int) -> Signatures:
    """Signatures with the calibrated plastic, in the poses of a recipe, whose area counts in their own pairs."""
    recipe = recipe_of(name, size, calibration_of(world, seed).file)
    return (
        cached_signatures(recipe, LIGHT_DEG)
        if size.causes is None
        else signatures(recipe, LIGHT_DEG, names=size.causes)
    )


def _rate(found: Rate) -> Results:
    return {"rate": found.value, "count": found.count, "of": found.of, "interval": [found.low, found.high]}


def _over_limit(judge: Judge, name: RecipeName, kind: str) -> Results:
    """Parts whose area deviates by more than the recipe's limit, of those that were photographed."""
    assert judge.recipe.area is not None
    rows = judge.numbers(kind)
    share = judge.columns[f"areas/{name}/share"][rows]
    seen = np.isfinite(share)
    return _rate(rate(share[seen] > judge.recipe.area.max_share, judge.columns["rig"][rows][seen]))


def _coverage(judge: Judge, rigs: npt.NDArray[np.int_]) -> Results:
    """Coverage of 95 % intervals of the contrasts of good parts."""
    rows = judge.numbers(GOOD)
    first, second = np.array(consecutive_pairs(judge.recipe.poses.poses())).T
    own = covariance_of_measurement(judge.own[rows])
    errors = judge.columns["error"][rows][:, list(judge.chosen)]
    seen = np.isfinite(errors[:, 0])
    found = {"measured": _held(errors[seen], own[seen], first, second, rigs[seen])}
    for known, expected in judge.expected.items():
        stated = own + np.sum([one.covariance() for one in expected.components], axis=0)
        off = judge.log_radiance[rows] - np.log(expected.radiance)
        found[known] = _held(off, stated, first, second, rigs)
    return found


def _held(
    off: FloatArray,
    covariance: FloatArray,
    first: npt.NDArray[np.int_],
    second: npt.NDArray[np.int_],
    rigs: npt.NDArray[np.int_],
) -> Results:
    variance = (
        covariance[:, first, first] + covariance[:, second, second] - 2.0 * covariance[:, first, second]
    )
    held = np.abs(off[:, first] - off[:, second]) <= COVERAGE * np.sqrt(variance)
    return _rate(rate(held.ravel(), np.repeat(rigs, len(first))))


def _class(
    kind: str,
    judge: Judge,
    name: RecipeName,
    p: dict[str, dict[str, FloatArray]],
    rigs: dict[str, npt.NDArray[np.int_]],
    known: tuple[Signatures, Curves] | None,
) -> Results:
    area = _over_limit(judge, name, kind)
    last = RULES[-1]
    scores = {side: -np.log10(np.maximum(p[last][side], 1e-300)) for side in (kind, GOOD)}
    unseen = Area(float("nan"), float("nan"))
    some = len(scores[kind]) > 0
    ours = area_under_curve(scores[kind], scores[GOOD]) if some else unseen
    best = area_under_curve(*_ideal(judge, kind)) if some else unseen
    return {
        "name": kind,
        "title": BY_NAME[kind].title,
        "parts": len(p[last][kind]),
        "power": {rule: _rate(rate(p[rule][kind] < LEVEL, rigs[kind])) for rule in RULES},
        "area_over_limit": area,
        "auc": {"value": ours.value, "u": ours.u},
        "ideal": {"value": best.value, "u": best.u},
        "diagnosis": None
        if known is None
        else {
            **_diagnosis(kind, judge, name, known[0], rigs[kind]),
            "separable": _separable(kind, judge, known[1], rigs[kind]),
        },
    }


def _off_good_parts(judge: Judge) -> FloatArray:
    """(N, m) contrasts of all parts from the mean of the good parts of their rig."""
    basis = log_basis(len(judge.chosen))
    values, rigs = judge.log_radiance @ basis.T, judge.columns["rig"]
    usual = np.isin(judge.columns["kind"], (GOOD, GOLDEN))
    off = np.array(values)
    for rig in np.unique(rigs):
        off[rigs == rig] -= values[usual & (rigs == rig)].mean(axis=0)
    return off


def _separable(kind: str, judge: Judge, curves: Curves, rigs: npt.NDArray[np.int_]) -> Results:
    """Parts of which the ideal observer names the right cause: no diagnosis by these poses can be right more often.

    It knows the mean and the scatter of good parts of the rig, and how every cause changes the poses in this world.
    """
    basis, off = log_basis(len(judge.chosen)), _off_good_parts(judge)
    if BY_NAME[kind].local:
        return _rate(rate(np.zeros(0, dtype=bool)))
    usual = np.isin(judge.columns["kind"], (GOOD, GOLDEN))
    names = list(curves)
    near = nearest_curves(
        off[judge.numbers(kind)],
        np.cov(off[usual], rowvar=False),
        [curve @ basis.T for curve, _ in curves.values()],
        [cost for _, cost in curves.values()],
    )
    return _rate(rate(near == names.index(BY_NAME[kind].cause), rigs))


def _ideal(judge: Judge, kind: str) -> tuple[FloatArray, FloatArray]:
    """Scores of the ideal observer of the means: he knows what good parts of every rig show on average."""
    off, bad = _off_good_parts(judge), judge.numbers(kind)
    signs = np.sign(judge.columns["extent"][bad]).astype(int)
    return ideal_scores(off[bad], off[judge.numbers(GOOD)], signs)


def evidence(judge: Judge, name: RecipeName, row: int, golden: Sequence[int] | None) -> Evidence:
    """Evidence for the diagnosis of one part with the calibrated plastic, as in ``inspect``.

    Args:
        judge: recipe and parts.
        name: of the recipe.
        row: of the part.
        golden: rows of the golden parts, whose mean is the reference; None: the prediction is.
    """
    recipe, expected = judge.recipe, judge.expected["spread"]
    components = tuple(
        Component(source, "measurement", relative, source in SHARED_SOURCES)
        for source, relative in zip(MEASURED_SOURCES, judge.own[row], strict=True)
    )
    off = judge.log_radiance - np.log(expected.radiance)
    scale = recipe.uncertainty.scale_share
    covariance = covariance_of(expected.components + components, scale, off.shape[1])
    assert recipe.area is not None
    share, u_share = (float(judge.columns[f"areas/{name}/{key}"][row]) for key in ("share", "u_share"))
    inputs = inputs_of(recipe, expected, components)
    mean, u = background_of(recipe.area.max_share)
    found = Evidence(off[row], covariance, inputs=inputs)
    if np.isfinite(share):
        found = replace(found, share=share, u_share=u_share, background=mean, u_background=u)
        marks = {key.name: judge.columns[f"areas/{name}/{key.name}"][row].item() for key in fields(MarkForm)}
        found = replace(found, form=MarkForm(**marks) if marks["groups"] else None)
    if golden is None:
        return found
    shares = judge.columns[f"areas/{name}/share"][list(golden)]
    if np.isfinite(share) and np.isfinite(shares).any():
        mean, u = background_of_parts(shares[np.isfinite(shares)].tolist())
        found = replace(found, background=mean, u_background=u, share_floor=0.0)
    return against(found, off[list(golden)], scale)


def true_extents(kind: str, columns: Columns, rows: npt.NDArray[np.int_], size: Size) -> FloatArray:
    """Extents as they truly are: the scatter of good parts adds to some; ridges may be missing in part."""
    if kind == "ridge-angle":
        return np.asarray(columns["ridge_angle_deg"][rows] - RIDGE_ANGLE_DEG)
    if kind == "roughness":
        return np.asarray(np.exp(columns["across"][rows]) - 1.0)
    if kind == "missing-ridges":  # of the area that is cut out, half a pitch wider on both sides
        return np.asarray(columns["spoiled"][rows] * (size.ridges + 1) / size.ridges)
    return np.asarray(columns["extent"][rows], dtype=np.float64)


def _diagnosis(
    kind: str, judge: Judge, name: RecipeName, known: Signatures, rigs: npt.NDArray[np.int_]
) -> Results:
    """Causes of parts compared with three golden ones, and the interval of the true one."""
    cause, rows = BY_NAME[kind].cause, judge.numbers(kind)[:DIAGNOSED]
    golden, all_rigs = judge.numbers(GOLDEN), judge.columns["rig"]
    truth = true_extents(kind, judge.columns, rows, Size())
    smear = SMEAR_PX * Size().pixel_um / PITCH_UM
    first, tied, wrong, held = [], [], [], []
    names: list[str] = []
    for number, row in enumerate(rows):
        mates = golden[all_rigs[golden] == all_rigs[row]]
        chosen = mates[golden_of(int(all_rigs[row]), number, DIAGNOSED_WITH, len(mates))]
        thresholds = judge.columns[f"areas/{name}/thresholds"][row]
        cells = int(judge.columns[f"areas/{name}/cells"][row])
        own = known.by_thresholds(None if np.isnan(thresholds).any() else thresholds.tolist(), smear, cells)
        found = diagnose(own, evidence(judge, name, int(row), [int(one) for one in chosen]))
        ties = {one.cause for one in found.ties}
        names.append(found.causes[0].cause)
        first.append(names[-1] == cause)
        tied.append(cause in ties)
        wrong.append(not ties & {cause, NOTHING} and found.unexplained_p >= LEVEL)
        right = next((one for one in found.causes if one.cause == cause), None)
        if right is not None and right.interval is not None:
            low, high = right.interval
            held.append(
                not (low is not None and truth[number] < low)
                and not (high is not None and truth[number] > high)
            )
    most, counts = np.unique(names, return_counts=True)
    rig = rigs[: len(rows)]
    return {
        "first": _rate(rate(np.array(first), rig)),
        "tied": _rate(rate(np.array(tied), rig)),
        "wrong": _rate(rate(np.array(wrong), rig)),
        "interval": _rate(rate(np.array(held, dtype=bool))),
        "named": [[str(most[k]), int(counts[k])] for k in np.argsort(-counts)[:3]],
    }


LEAST_RIGS = 2
PICTURED: tuple[World, ...] = ("same", "reflections", "ggx", "two-scale")
"""Worlds in which some parts are photographed; local defects hardly depend on camera and lamp."""


@dataclass(frozen=True)
class Plan:
    """Plan of a study.

    Attributes:
        worlds: rendered worlds.
        recipes: applied to every part; the poses of all recipes are photographed.
        rigs: number of rigs, each with its golden and judged parts.
        pictured: number of them whose parts are photographed; of the others the means of the poses are computed.
        seed: of everything random.
        diagnosed: whether the causes of bad parts are looked for; signatures take half a minute a world.
        size: of parts and frames.
        folder: of cached sheets and rigs, without a limit of size; None is the user's cache.
    """

    worlds: tuple[World, ...]
    recipes: tuple[RecipeName, ...]
    rigs: int
    pictured: int
    seed: int = 1
    diagnosed: bool = False
    size: Size = field(default_factory=Size)
    folder: Path | None = None

    def __post_init__(self) -> None:
        if self.rigs < LEAST_RIGS:
            raise UsageError(f"a study needs at least {LEAST_RIGS} rigs, not {self.rigs}")


def collect(plan: Plan, workers: Workers, advance: Advance = silent) -> dict[World, Columns]:
    """Simulate all rigs that are not cached, and return the columns of their parts by world.

    Raises:
        RecordError: the plan's folder cannot be written.
        SweepError: a process failed.
    """
    lit = tuple(dict.fromkeys(rendered_as(world) for world in plan.worlds))
    kinds = [kind.name for kind in CLASSES if not kind.local]
    for step in ([GOOD], kinds):  # a defect is the change of a good part
        fits = [
            SurrogateTask(world, kind, extent, plan.folder)
            for world in lit
            for kind in step
            for extent in bases_of(kind)
        ]
        sweep(prepare_surrogate, fits, workers, advance=advance, doing="polynomials")
    pictured = tuple(world for world in plan.worlds if world in PICTURED and plan.pictured > 0)
    missing = [
        task
        for number in range(plan.pictured)
        for world in pictured
        if (task := _task(plan, world, number, ())).entry.read() is None
    ]
    if missing:  # kept rigs need no surfaces
        sheets = sheet_tasks(pictured, plan.size, plan.seed, plan.folder)
        sweep(prepare_sheet, sheets, workers, advance=advance, doing="surfaces")
    bounces = {world: _bounces(plan, world, workers, advance) if missing else () for world in pictured}
    tasks = [
        _task(plan, world, number, bounces.get(world, ()))
        for number in range(plan.rigs)
        for world in plan.worlds
    ]
    rigs = dict(zip(tasks, sweep(inspect_chunk, tasks, workers, advance=advance, doing="rigs"), strict=True))
    return {world: _joined([rigs[task] for task in tasks if task.world == world]) for world in plan.worlds}


def _task(plan: Plan, world: World, number: int, bounces: Bounces) -> ChunkTask:
    pictured = world in PICTURED and number < plan.pictured
    return ChunkTask(world, number, plan.size, plan.seed, plan.folder, bounces if pictured else (), pictured)


def _bounces(plan: Plan, world: World, workers: Workers, advance: Advance) -> Bounces:
    if not WORLDS[world].traced:
        return ()
    kinds = [GOOD, *(kind.name for kind in CLASSES if kind.local)]

    def traced() -> dict[str, tuple[float, ...]]:
        values = sweep(
            bounces_of, [(world, kind) for kind in kinds], workers, advance=advance, doing="reflections"
        )
        return {kind: tuple(float(one) for one in value) for kind, value in zip(kinds, values, strict=True)}

    found = (
        Cache(plan.folder)
        .entry("detection-reflections", [world, *kinds], bounces_of.__module__)
        .result(
            traced,
            lambda found: json.dumps(found).encode(),
            lambda content: {kind: tuple(values) for kind, values in json.loads(content).items()},
        )
    )
    return tuple(found.items())


def _joined(rigs: Sequence[Columns]) -> Columns:
    return {name: np.concatenate([rig[name] for rig in rigs]) for name in rigs[0]}


def plan_table(plan: Plan) -> dict[str, Any]:
    """The plan as JSON."""
    found = asdict(plan)
    del found["folder"]
    sensor = plan.size.sensor
    photographed = [world for world in plan.worlds if world in PICTURED]
    return {**found, "photographed": photographed, "frame": [sensor.rows, sensor.cols]}


def study_results(
    plan: Plan, workers: Workers, advance: Advance = silent, rendered: Path | None = None
) -> dict[str, Any]:
    """Run the study and return all results as plain numbers.

    Args:
        plan: worlds, recipes, rigs.
        workers: processes.
        advance: progress.
        rendered: archive of the parts that Mitsuba rendered, judged too; None leaves them out.

    Raises:
        RecordError: the folder cannot be written.
        SweepError: a process failed.
        UsageError: the archive cannot be read.
    """
    seen = collect(plan, workers, advance) if plan.worlds else {}
    found: dict[str, Any] = {"plan": plan_table(plan), "worlds": {}}
    steps = [(world, seen[world], plan) for world in plan.worlds]
    evaluated = sweep(_evaluated, steps, workers, advance=advance, doing="evaluation")
    found["worlds"] = dict(zip(plan.worlds, evaluated, strict=True))
    found["rendered"] = [] if rendered is None else judged(rendered, advance)
    found["notes"] = notes_of(plan)
    clean: dict[str, Any] = without_nan(found)
    return clean


def _evaluated(task: tuple[World, Columns, Plan]) -> dict[str, Any]:
    world, columns, plan = task
    given = [plan.rigs, plan.pictured, plan.seed, plan.diagnosed, asdict(plan.size)]

    def results(name: RecipeName) -> Results:
        return results_of(
            world, columns, name, plan.size, plan.seed, diagnosed=plan.diagnosed, folder=plan.folder
        )

    return {
        name: Cache(plan.folder)
        .entry("detection-results", [world, name, *given], __name__)
        .result(partial(results, name), lambda found: json.dumps(found).encode(), json.loads)
        for name in plan.recipes
    }


def notes_of(plan: Plan) -> list[str]:
    """Notes on how the parts are simulated."""
    size, sensor = plan.size, plan.size.sensor
    return [
        (
            f"Parts of {size.ridges} ridges, pitch {PITCH_UM:g} µm, {size.pitches * PITCH_UM / 1000.0:g} mm long; "
            f"frames of {sensor.cols} × {sensor.rows} pixels of {size.pixel_um:g} µm, {FRAMES} a pose, of which the "
            "window that holds the part is read out. A rig (light, zero of the tilt, stray light, linearity, camera "
            f"with flat and dark frames) is drawn for every set of {size.golden} golden parts; all parts of the set "
            f"meet it. Placement: as the markers would give it, with an error of {MARKER_ERROR_PX:g} px."
        ),
        (
            f"Good parts scatter (1 σ): ridge angle {RIDGE_ANGLE_SPREAD_DEG:g}°, both roughnesses {ALPHA_SPREAD:.0%}, "
            f"albedo {ALBEDO_SPREAD:.0%}, seating 0.1° about both axes; burrs on up to {BURRS_ON_GOOD:.1%} of the area."
        ),
        (
            f"The camera of the worlds camera and other is {NONLINEARITY:.1%} non-linear at full well; the lamp of the "
            f"worlds lamp and other stands {LED_DISTANCE_MM:g} mm away."
        ),
    ]


def without_nan(value: Any) -> Any:
    """The same with None for a number that is not finite."""
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
