"""Detection study: rates of false alarms and misses of thousands of parts on the virtual rig, in several worlds.

The same world renders with the predictor's own lobe and direct light. All others are rendered by a path tracer that
shares nothing with the prediction: with other lobes, reflections, a slightly non-linear camera or a near lamp, or all
of these (`other`). Claims rest on them.

For shape defects that the means rarely detect, the study evaluates remedies: other poses, or smaller uncertainties. A
class shifts ln L by δ. The D² of δ alone is its distance from the set of good parts (its Fisher information, along the
curves of the uncertain inputs). D² of the parts is a noncentral χ² with this noncentrality, so that the area under the
ROC curve follows without simulating a part.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cache import Cache
from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.base.significance import log_basis
from anisoscope.diagnosis.separability import planned_covariance
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.prediction.expectation import Expectation, expectation
from anisoscope.prediction.profile_likelihood import nearest
from anisoscope.prediction.second_order import Response
from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions
from anisoscope.study.detection.chunk import ChunkTask, Columns, inspect_chunk
from anisoscope.study.detection.evaluation import signatures_of
from anisoscope.study.detection.lobes import lobes_of
from anisoscope.study.detection.product import (
    BY_NAME,
    CLASSES,
    GOOD,
    LED_DISTANCE_MM,
    LIGHT_DEG,
    MARKER_ERROR_PX,
    NONLINEARITY,
    PITCH_UM,
    RECIPES,
    RIDGE_ANGLE_DEG,
    WHOLE,
    WORLDS,
    RecipeName,
    Size,
    World,
    expected_of,
    recipe_of,
)
from anisoscope.study.detection.results import results_of
from anisoscope.study.detection.sheets import bounces_of, prepare_sheet, sheet_tasks
from anisoscope.study.sweep import Workers, sweep

SHAPES = ("ridge-angle", "roughness")
POWER = 0.99
BETTER = 3.0
POSES: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "standard poses": ((0.0, 90.0, 180.0), (0.0,)),
    "tilted poses": ((0.0, 90.0, 180.0), (0.0, -10.0, 10.0)),
    "tilts to ±20°": ((0.0, 90.0, 180.0), (0.0, -20.0, -10.0, 10.0, 20.0)),
    "every 45° upright": (tuple(np.arange(0.0, 360.0, 45.0)), (0.0,)),
    "every 45°, tilts to ±10°": (tuple(np.arange(0.0, 360.0, 45.0)), (0.0, -10.0, 10.0)),
}
MATERIAL = ("roughness", "albedo", "refractive")
PLACE = ("seating", "light angle")
RIG = "measurement"
CALIBRATIONS: dict[str, tuple[str, ...]] = {
    "as it is": (),
    "material known 3× better": MATERIAL,
    "seating and lamp 3× better": PLACE,
    "flat field, linearity, drift, stage 3× better": (RIG,),
    "material, seating and lamp 3× better": (*MATERIAL, *PLACE),
    "all of these 3× better": (*MATERIAL, *PLACE, RIG),
}


def outlook() -> dict[str, list[dict[str, Any]]]:
    """By class: poses, calibration, σ of the shift and area under the curve of D², in the order of `POSES`."""
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in SHAPES}
    for poses, (angles, tilts) in POSES.items():
        recipe = _recipe(angles, tilts)
        expected = expectation(recipe, LIGHT_DEG)
        shifts = {name: _shifts(name, expected) for name in SHAPES}
        for calibration, better in CALIBRATIONS.items():
            good = _good(recipe, expected, better)
            for name in SHAPES:
                sigmas = [_sigmas(shift, good) for shift in shifts[name]]
                areas = [area_of(sigma, len(expected.poses) - 1) for sigma in sigmas]
                row = {"poses": poses, "calibration": calibration}
                found[name].append({**row, "sigmas": float(np.mean(sigmas)), "auc": float(np.mean(areas))})
    return found


def _recipe(angles: tuple[float, ...], tilts: tuple[float, ...]) -> RidgeRecipe:
    table = recipe_of("standard", Size(), stated=True).model_dump()
    table["schema"] = 1
    table.pop("schema_version", None)
    table["poses"] |= {"angles_deg": angles, "tilts_deg": tilts}
    return RidgeRecipe.model_validate(table)


def _shifts(name: str, expected: Expectation) -> list[FloatArray]:
    """(P,) changes of ln L of a class, of both its signs where it has two."""
    kind = BY_NAME[name]
    seen = directions(expected.poses, expected.convention)
    found = []
    for sign in (-1.0, 1.0) if kind.signed else (1.0,):
        angle, material = RIDGE_ANGLE_DEG, WHOLE
        if name == "ridge-angle":
            angle += sign * kind.extent
        else:
            material = replace(WHOLE, alpha_across=WHOLE.alpha_across * (1.0 + kind.extent))
        bad = corrected.radiance(*seen, RidgeDesign(PITCH_UM, angle), material)
        found.append(np.asarray(np.log(bad / expected.radiance)))
    return found


def _good(recipe: RidgeRecipe, expected: Expectation, better: tuple[str, ...]) -> tuple[Response, FloatArray]:
    """Scatter of good parts with some sources reduced by `BETTER`, in the basis of ln ratios.

    Returns:
        Response to the inputs, the ridge angle of good parts among them, and (P − 1, P − 1) covariance of the rest.
    """
    inputs = expected.response
    assert inputs is not None
    basis = log_basis(len(expected.poses))
    scale = np.array([1.0 / BETTER if better and name.startswith(better) else 1.0 for name in inputs.sources])
    response = Response(inputs.sources, inputs.slope * scale, inputs.bend * np.outer(scale, scale))
    predicted = np.sum([c.covariance() for c in expected.components], axis=0)
    alone = planned_covariance(recipe, expected) - predicted
    alone = basis @ alone @ basis.T * (BETTER**-2.0 if RIG in better else 1.0)
    return response.within(basis), np.asarray(alone)


def _sigmas(shift: FloatArray, good: tuple[Response, FloatArray]) -> float:
    """Distance of a shifted part from the set of good parts, in σ."""
    response, alone = good
    off = log_basis(len(shift)) @ shift
    return float(np.sqrt(nearest(response, off[None], alone[None])[0]))


def area_of(sigmas: float, contrasts: int) -> float:
    """Probability that D² of a part shifted by some σ exceeds that of a good one."""
    from scipy.stats import chi2, ncx2  # noqa: PLC0415 - 1 s

    levels = (np.arange(2000) + 0.5) / 2000
    return float(np.mean(ncx2.sf(chi2.ppf(levels, contrasts), contrasts, max(sigmas, 1e-6) ** 2)))


LEAST_PARTS = 20


@dataclass(frozen=True)
class Plan:
    """Plan of a study.

    Attributes:
        worlds: rendered worlds.
        recipes: applied to every part; all poses of the tilted recipe are photographed.
        parts: number of good parts.
        defective: number of parts of every class of defects.
        seed: of everything random.
        size: of parts and frames.
        folder: of cached sheets and chunks, without a limit of size; None is the user's cache.
    """

    worlds: tuple[World, ...]
    recipes: tuple[RecipeName, ...]
    parts: int
    defective: int
    seed: int = 1
    size: Size = field(default_factory=Size)
    folder: Path | None = None

    def __post_init__(self) -> None:
        if self.parts < 2 * LEAST_PARTS or self.defective < 1:
            raise UsageError(
                f"a study needs at least {2 * LEAST_PARTS} good parts and 1 of every class, not {self.parts} and "
                f"{self.defective}"
            )

    @property
    def counts(self) -> dict[str, int]:
        """Parts of every class."""
        return {GOOD: self.parts, **{kind.name: self.defective for kind in CLASSES}}


def collect(plan: Plan, workers: Workers, advance: Advance = silent) -> dict[World, dict[str, Columns]]:
    """Simulate all parts that are not cached, and return their columns, by world and class.

    Raises:
        RecordError: the plan's folder cannot be written.
        SweepError: a process failed.
    """
    for name in RECIPES:
        advance(f"signatures of the {name} recipe", 0, 1)
        signatures_of(name, plan.size)
        if "same" in plan.worlds:
            signatures_of(name, plan.size, stated=True)
    sheets = sheet_tasks(plan.worlds, plan.size, plan.seed, plan.folder)
    sweep(prepare_sheet, sheets, workers, advance=advance, doing="surfaces")
    bounces = {world: _bounces(plan, world, workers, advance) for world in plan.worlds}
    tasks = chunk_tasks(plan, bounces)
    chunks = dict(
        zip(tasks, sweep(inspect_chunk, tasks, workers, advance=advance, doing="parts"), strict=True)
    )
    found: dict[World, dict[str, Columns]] = {world: {} for world in plan.worlds}
    for world in plan.worlds:
        for kind, count in plan.counts.items():
            own = [task for task in tasks if (task.world, task.kind) == (world, kind)]
            own.sort(key=lambda task: task.number)
            found[world][kind] = _joined([chunks[task] for task in own], count)
    return found


def _bounces(plan: Plan, world: World, workers: Workers, advance: Advance) -> dict[str, tuple[float, ...]]:
    kinds = [GOOD, *(kind.name for kind in CLASSES)]
    if not WORLDS[world].reflections:
        return dict.fromkeys(kinds, ())

    def traced() -> dict[str, tuple[float, ...]]:
        values = sweep(
            bounces_of, [(world, kind) for kind in kinds], workers, advance=advance, doing="reflections"
        )
        return {kind: tuple(float(one) for one in value) for kind, value in zip(kinds, values, strict=True)}

    return (
        Cache(plan.folder)
        .entry("detection-reflections", [world, *kinds], bounces_of.__module__)
        .result(
            traced,
            lambda found: json.dumps(found).encode(),
            lambda content: {kind: tuple(values) for kind, values in json.loads(content).items()},
        )
    )


def chunk_tasks(plan: Plan, bounces: dict[World, dict[str, tuple[float, ...]]]) -> list[ChunkTask]:
    """All chunks, in an order in which a study that is cut off has the same share of every class."""
    tasks: list[tuple[float, ChunkTask]] = []
    for world in plan.worlds:
        for kind, count in plan.counts.items():
            chunks = -(-count // plan.size.chunk)
            tasks += [
                (
                    (number + 0.5) / chunks,
                    ChunkTask(world, kind, number, plan.size, plan.seed, plan.folder, bounces[world][kind]),
                )
                for number in range(chunks)
            ]
    return [task for _, task in sorted(tasks, key=lambda pair: pair[0])]


def _joined(chunks: Sequence[Columns], count: int) -> Columns:
    names = [name for name in chunks[0] if all(name in chunk for chunk in chunks)]
    return {name: np.concatenate([chunk[name] for chunk in chunks])[:count] for name in names}


def plan_table(plan: Plan) -> dict[str, Any]:
    """The plan as JSON."""
    found = asdict(plan)
    del found["folder"]
    sensor = plan.size.sensor
    return {**found, "frame": [sensor.rows, sensor.cols]}


def study_results(plan: Plan, workers: Workers, advance: Advance = silent) -> dict[str, Any]:
    """Run the study and return all results as plain numbers.

    Raises:
        RecordError: the folder cannot be written.
        SweepError: a process failed.
    """
    seen = collect(plan, workers, advance)
    found: dict[str, Any] = {"plan": plan_table(plan), "worlds": {}}
    steps = [(world, name) for world in plan.worlds for name in plan.recipes]
    tasks = [(world, seen[world], name, plan.size) for world, name in steps]
    evaluated = sweep(_evaluated, tasks, workers, advance=advance, doing="evaluation")
    for (world, name), results in zip(steps, evaluated, strict=True):
        found["worlds"].setdefault(world, {})[name] = results
    found["other_world"] = _of_other_world(plan, workers, advance)
    found["outlook"] = outlook()
    found["notes"] = notes_of(plan)
    clean: dict[str, Any] = without_nan(found)
    return clean


def _evaluated(task: tuple[World, dict[str, Columns], RecipeName, Size]) -> dict[str, Any]:
    return results_of(*task)


def _of_other_world(plan: Plan, workers: Workers, advance: Advance) -> dict[str, Any] | None:
    if "other" not in plan.worlds:
        return None
    lobes = lobes_of("other")
    reflected = _bounces(plan, "other", workers, advance)
    share = np.array(reflected[GOOD]) / expected_of("tilted", plan.size).radiance
    return {
        "ggx": asdict(lobes.smooth),
        "misfit_rms": lobes.misfit,
        "reflections_share": [float(value) for value in share],
        "nonlinearity": NONLINEARITY,
        "led_distance_mm": LED_DISTANCE_MM,
    }


def notes_of(plan: Plan) -> list[str]:
    """Notes on how the parts are simulated."""
    size, sensor = plan.size, plan.size.sensor
    return [
        (
            f"Parts of {size.ridges} ridges, pitch {PITCH_UM:g} µm, {size.pitches * PITCH_UM / 1000.0:g} mm long; "
            f"frames of {sensor.cols} × {sensor.rows} pixels of {size.pixel_um:g} µm, 2 a pose, of which the window "
            f"that holds the part is read out; every {size.chunk} parts share a camera "
            "with its own flat and dark frames, every part meets a rig of its own, drawn from the recipe's "
            "uncertainties. Placement: as the markers would give it, with an error of "
            f"{MARKER_ERROR_PX:g} px."
        ),
        (
            "Good parts scatter (1 σ): ridge angle 0.1°, both roughnesses 5 %, albedo 3 %, seating 0.1° about both "
            "axes; burrs on up to 0.2 % of the area."
        ),
        (
            "Surfaces are cut from rendered sheets; what is alike all along the ridges is put in by the exact ratio of "
            "smooth profiles. Intervals of rates of the contrast map take parts as independent; parts from one sheet "
            "share some of their surface."
        ),
    ]


def without_nan(value: Any) -> Any:  # noqa: ANN401 - any JSON
    """The same with None for a number that is not finite."""
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
