"""Detection study: rates of false alarms and misses of thousands of parts on virtual rigs, in several worlds.

The same world renders with the predictor's own lobe and reflections. All others are rendered by a path tracer that
shares nothing with the prediction: with its lobe or with others, with bent parts or a near lamp, or all of these with a
slightly non-linear camera (`other`). Claims rest on them. Every rig has a set of golden parts, and all its parts meet
it. `detection_study.judge` has the references and verdicts.
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
from anisoscope.base.significance import log_basis
from anisoscope.diagnosis.cell_levels import SMEAR_PX
from anisoscope.diagnosis.evidence import (
    Evidence,
    against,
    background_of,
    background_of_parts,
    covariance_of,
    inputs_of,
)
from anisoscope.diagnosis.ranking import diagnose
from anisoscope.diagnosis.signature_cache import cached_signatures
from anisoscope.diagnosis.signatures import Signatures, signatures
from anisoscope.imaging.defect_regions import MarkForm
from anisoscope.imaging.deviation_map import CellScatter
from anisoscope.parameters.workers import Workers
from anisoscope.prediction.expectation import Component
from anisoscope.sim.light.contrasts import consecutive_pairs
from anisoscope.study.statistics import Rate, rate
from anisoscope.study.sweep import sweep
from detection_study.chunk import MEASURED_SOURCES, Bounces, ChunkTask, Columns, inspect_chunk
from detection_study.judge import (
    LOTS,
    RULES,
    SHARED_SOURCES,
    Compared,
    Judge,
    Rows,
    calibration_of,
    covariance_of_measurement,
    golden_of,
    judge_of,
    own_defect,
)
from detection_study.mitsuba import judged
from detection_study.product import (
    ALBEDO_SPREAD,
    ALPHA_SPREAD,
    BEND_MM,
    BURRS_ON_GOOD,
    BY_NAME,
    CLASSES,
    FRAMES,
    GOLDEN,
    GOOD,
    LED_DISTANCE_MM,
    LIGHT_DEG,
    MARKER_ERROR_PX,
    NONLINEARITY,
    OF_BATCH,
    OF_INTEREST,
    PITCH_UM,
    RIDGE_ANGLE_DEG,
    RIDGE_ANGLE_SPREAD_DEG,
    UNIFORM,
    WORLDS,
    RecipeName,
    Size,
    World,
    recipe_of,
    rendered_as,
)
from detection_study.sheets import bounces_of, prepare_sheet, sheet_tasks
from detection_study.statistics import nearest_curves
from detection_study.surrogate import SurrogateTask, bases_of, curves_of, prepare_surrogate

Results = dict[str, Any]
Curves = Mapping[str, tuple[FloatArray, FloatArray]]
"""(E, P) changes of ln L of the poses of a recipe along every cause in one world, and (E,) −2 ln of their priors."""

COVERAGE = 1.959964
DIAGNOSED_WITH = RULES["golden-3x2"]
"""Golden parts of the diagnosis."""
DIAGNOSED = 20
"""Parts of a class that are diagnosed, at most."""
FOUND = ("plastic", "design", "golden-1x1", "golden-3x2", "golden-10x2", "golden-25x5", "plastic-3x2")
"""References by which bad parts are judged."""
DECIDED = ("plastic", "design", "golden-3x2", "golden-10x2", "golden-25x5")
"""References of which the defects are counted that parts exclude."""
MOST = 100
"""Parts of a kind of which they are counted, at most."""


@dataclass(eq=False)
class Counts:
    """Outcomes of parts of one kind, with their rigs."""

    rigs: list[int] = field(default_factory=list)
    failed: list[bool] = field(default_factory=list)
    decided: list[int] = field(default_factory=list)
    passed: list[bool] = field(default_factory=list)
    excluded: list[bool] = field(default_factory=list)

    def add(self, one: Compared | None, rig: int, own: str | None, *, decide: bool) -> None:
        """Count a part: whether it fails, and if asked whether it passes and excludes the defect that it has."""
        if one is None:
            return
        self.rigs.append(rig)
        self.failed.append(one.fails)
        if decide:
            self.decided.append(rig)
            self.passed.append(one.passes)
            if own is not None:
                self.excluded.append(one.excludes(own))

    @property
    def rates(self) -> Results:
        """Of FAIL, of PASS, and of parts that exclude their own defect."""
        rigs, decided = np.array(self.rigs, dtype=int), np.array(self.decided, dtype=int)
        return {
            "fail": _rate(rate(np.array(self.failed, dtype=bool), rigs)),
            "pass": _rate(rate(np.array(self.passed, dtype=bool), decided)),
            "excluded": _rate(rate(np.array(self.excluded, dtype=bool), decided[: len(self.excluded)])),
        }


def by_rules(judge: Judge, kind: str) -> Results:
    """Rates of the outcomes of a kind of parts by every reference."""
    found, rows = {}, judge.numbers(kind)
    for name, rule in RULES.items():
        if kind != GOOD and name not in FOUND:
            continue
        asked = set(rows[:: -(-len(rows) // MOST)].tolist() if name in DECIDED and len(rows) else [])
        asked = asked if kind in (GOOD, *OF_INTEREST) else set()
        counts = Counts()
        for number, row in enumerate(rows):
            own = own_defect(judge, kind, int(row)) if kind in OF_INTEREST else None
            rig = int(judge.columns["rig"][row])
            counts.add(judge.against(rule, int(row), number), rig, own, decide=int(row) in asked)
        found[name] = counts.rates
    return found


def by_lots(judge: Judge) -> dict[str, Results]:
    """The same of the parts of lots, by kind: good ones with bad ones of one class in turn, bad ones of all."""
    counted = {kind: {name: Counts() for name in LOTS} for kind in (GOOD, *UNIFORM)}
    for rig in np.unique(judge.columns["rig"][judge.numbers(GOOD, of_lot=True)]):
        own = {
            kind: (rows := judge.numbers(kind, of_lot=True))[judge.columns["rig"][rows] == rig]
            for kind in counted
        }
        for name, (size, bad) in LOTS.items():
            for kind in UNIFORM if bad else (GOOD,):
                lot = np.concatenate([own[GOOD][: size - bad], own[kind][:bad] if bad else own[kind][:0]])
                shown = kind == GOOD or kind == UNIFORM[int(rig) % len(UNIFORM)]
                for place in range(0 if shown else size - bad, size):
                    of = GOOD if place < size - bad else kind
                    row = int(lot[place])
                    defect = own_defect(judge, of, row) if of in OF_INTEREST else None
                    one = judge.in_lot("calibrated", row, np.delete(lot, place))
                    counted[of][name].add(one, int(rig), defect, decide=of in (GOOD, *OF_INTEREST))
    return {kind: {name: one.rates for name, one in by.items()} for kind, by in counted.items()}


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
        diagnosed: whether causes are looked for, and nothing else.
        folder: of the study's cache.
    """
    valid = columns["valid"].astype(bool)
    columns = {key: values[valid] for key, values in columns.items()}
    judge = judge_of(world, columns, name, size, seed)
    if diagnosed:
        chosen = list(judge.chosen)
        curves = {
            cause: (curve[:, chosen], cost) for cause, (curve, cost) in curves_of(world, folder).items()
        }
        known = signatures_of(rendered_as(world), name, size, seed)
        classes = [
            {"name": kind.name, "title": kind.title}
            | {"diagnosis": _diagnosis(kind.name, judge, name, known)}
            | {"separable": _separable(kind.name, judge, curves)}
            for kind in CLASSES
        ]
        return {"classes": classes}
    lots = by_lots(judge)
    kinds = [GOOD, *BY_NAME]
    outcomes = {kind: by_rules(judge, kind) | lots.get(kind, {}) for kind in kinds}
    calibration = calibration_of(world, seed)
    return {
        "invalid": int(np.count_nonzero(~valid)),
        "residual": calibration.residual_over_noise,
        "good": outcomes[GOOD],
        "area_over_limit": _over_limit(judge, name, GOOD),
        "coverage": _coverage(judge),
        "classes": [
            {"name": kind.name, "title": kind.title, "by": outcomes[kind.name]}
            | {"area_over_limit": _over_limit(judge, name, kind.name)}
            for kind in CLASSES
        ],
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
    limit, rows = judge.area_recipe.area, judge.numbers(kind)
    assert limit is not None
    share = judge.columns[f"areas/{name}/share"][rows]
    seen = np.isfinite(share)
    return _rate(rate(share[seen] > limit.max_share, judge.columns["rig"][rows][seen]))


def _coverage(judge: Judge) -> Results:
    """Coverage of 95 % intervals of the contrasts of good parts."""
    rows = judge.numbers(GOOD)
    rigs = judge.columns["rig"][rows]
    first, second = np.array(consecutive_pairs(judge.area_recipe.poses.poses())).T
    own = covariance_of_measurement(judge.own[rows])
    errors = judge.columns["error"][rows][:, list(judge.chosen)]
    seen = np.isfinite(errors[:, 0])
    found: Results = {"measured": _held(errors[seen], own[seen], first, second, rigs[seen])}
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


def _off_good_parts(judge: Judge) -> FloatArray:
    """(N, m) contrasts of all parts from the mean of the good parts of their rig."""
    values, rigs = judge.contrasts, judge.columns["rig"]
    usual = np.isin(judge.columns["kind"], (GOOD, GOLDEN))
    off = np.array(values)
    for rig in np.unique(rigs):
        off[rigs == rig] -= values[usual & (rigs == rig)].mean(axis=0)
    return off


def _separable(kind: str, judge: Judge, curves: Curves) -> Results:
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
    right = near == names.index(BY_NAME[kind].cause)
    return _rate(rate(right, judge.columns["rig"][judge.numbers(kind)]))


def evidence(judge: Judge, name: RecipeName, row: int, golden: Sequence[int]) -> Evidence:
    """Evidence for the diagnosis of one part with the calibrated plastic, as in ``inspect``.

    Args:
        judge: recipe and parts.
        name: of the recipe.
        row: of the part.
        golden: rows of the golden parts, whose mean is the reference.
    """
    recipe, expected = judge.area_recipe, judge.expected["calibrated"]
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
    shares = judge.columns[f"areas/{name}/share"][list(golden)]
    if np.isfinite(share) and np.isfinite(shares).any():
        mean, u = background_of_parts(shares[np.isfinite(shares)].tolist())
        found = replace(found, background=mean, u_background=u, share_floor=0.0)
    return against(found, off[list(golden)], scale)


def true_extents(kind: str, columns: Columns, rows: Rows, size: Size) -> FloatArray:
    """Extents as they truly are: the scatter of good parts adds to some; ridges may be missing in part."""
    if kind.startswith("ridge-angle"):
        return np.asarray(columns["ridge_angle_deg"][rows] - RIDGE_ANGLE_DEG)
    if kind == "roughness":
        return np.asarray(np.exp(columns["across"][rows]) - 1.0)
    if kind == "missing-ridges":  # of the area that is cut out, half a pitch wider on both sides
        return np.asarray(columns["spoiled"][rows] * (size.ridges + 1) / size.ridges)
    return np.asarray(columns["extent"][rows], dtype=np.float64)


def _diagnosis(kind: str, judge: Judge, name: RecipeName, known: Signatures) -> Results:
    """Causes of parts compared with three golden ones, and the interval of the true one."""
    cause, rows, all_rigs = BY_NAME[kind].cause, judge.numbers(kind)[:DIAGNOSED], judge.columns["rig"]
    truth = true_extents(kind, judge.columns, rows, Size())
    smear = SMEAR_PX * Size().pixel_um / PITCH_UM
    first, tied, held = [], [], []
    rig: list[int] = []
    for number, row in enumerate(rows):
        mates = judge.golden.get(int(all_rigs[row]), np.zeros(0, dtype=int))
        drawn = golden_of(judge.columns["batch"][mates], DIAGNOSED_WITH, int(all_rigs[row]), number)
        if drawn is None:  # too many golden parts of this rig were INVALID
            continue
        rig.append(int(all_rigs[row]))
        covariance, limit, cells = (
            judge.columns[f"areas/{name}/{key}"][row] for key in ("covariance", "limit", "cells")
        )
        scatter = None if np.isnan(limit) else CellScatter(covariance, float(np.expm1(limit)))
        own = known.by_scatter(scatter, smear, int(cells))
        found = diagnose(own, evidence(judge, name, int(row), mates[drawn].tolist()))
        first.append(found.causes[0].cause == cause)
        tied.append(cause in {one.cause for one in found.ties})
        right = next((one for one in found.causes if one.cause == cause), None)
        if right is not None and right.interval is not None:
            low, high = right.interval
            held.append(
                not (low is not None and truth[number] < low)
                and not (high is not None and truth[number] > high)
            )
    of = np.array(rig, dtype=int)
    return {
        "first": _rate(rate(np.array(first, dtype=bool), of)),
        "tied": _rate(rate(np.array(tied, dtype=bool), of)),
        "interval": _rate(rate(np.array(held, dtype=bool))),
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
        diagnosed: whether the causes of bad parts are looked for, and nothing else.
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
            f"frames of {sensor.cols} × {sensor.rows} pixels of {size.pixel_um:g} µm, {FRAMES} a pose. "
            f"Placement: as the markers would give it, with an error of {MARKER_ERROR_PX:g} px."
        ),
        (
            f"Good parts scatter (1 σ): ridge angle {RIDGE_ANGLE_SPREAD_DEG:g}°, both roughnesses {ALPHA_SPREAD:.0%}, "
            f"albedo {ALBEDO_SPREAD:.0%}, {OF_BATCH:.0%} of the variance between batches; seating 0.1° about both "
            f"axes; burrs on up to {BURRS_ON_GOOD:.1%} of the area."
        ),
        (
            f"The lamp of the worlds lamp and other is {LED_DISTANCE_MM:g} mm away, parts of curved and other have a "
            f"radius of {BEND_MM:g} mm, the camera of other is {NONLINEARITY:.1%} non-linear at full well."
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
