"""What another recipe would have said of past inspections: verdicts before and after, escapes, false rejects.

Every inspection is judged anew from what was kept of its measurement, where only prediction or decision changed; from
its frames where the region, the poses or another condition of the measurement changed. No folder is written to.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from anisoscope.base.errors import AnisoscopeError, CameraError, MeasurementError, RecordError, UsageError
from anisoscope.base.json_fields import in_json, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.decision.reference_parts import golden_path
from anisoscope.history.comparing import record_of
from anisoscope.history.rows import Row
from anisoscope.imaging.views import resuming_error
from anisoscope.inspection.frames import read_frames
from anisoscope.inspection.kept_measurement import CHANGE, read_kept
from anisoscope.inspection.manifest import reopen
from anisoscope.inspection.pipeline import Case, judge
from anisoscope.kinds.kind import AnyKind, Expected, Explanation
from anisoscope.kinds.parts import Redeciding, Reference, References, read_reference
from anisoscope.kinds.registry import kind_of
from anisoscope.parameters.workers import Workers
from anisoscope.recipe.base import RecipeBase
from anisoscope.record.schema import Record
from anisoscope.record.verdict import Verdict
from anisoscope.report.peers import LotMate
from anisoscope.study.statistics import Rate, rate
from anisoscope.study.sweep import again_after_a_kill

VERDICTS = ("PASS", "FAIL", "INCONCLUSIVE", "INVALID")
GOOD, BAD = frozenset({"accept"}), frozenset({"reject", "rework"})
"""Dispositions that say what a part really was."""


@dataclass(frozen=True)
class Task:
    """One inspection to be judged by a recipe; the row of the history says which.

    Attributes:
        row: of the history.
        recipe: its file.
        sha256: of the file.
        mates: other parts of the lot, with which it may be compared.
    """

    row: Row
    recipe: Path
    sha256: str
    mates: tuple[LotMate, ...] = ()


@dataclass(frozen=True)
class Rejudged:
    """An inspection judged by another recipe.

    Attributes:
        id: in the history.
        serial: of the part.
        folder: of the inspection.
        before: its verdict.
        after: the verdict by the other recipe; None where it could not be judged.
        reasons: of the new verdict, or why there is none.
        judged_from: "kept" numbers, or "frames".
        frames_because: why the frames were needed.
        disposition: the last decision of a reviewer, or None.
    """

    id: int
    serial: str
    folder: str
    before: str
    after: str | None
    reasons: tuple[str, ...]
    judged_from: Literal["kept", "frames"] | None = None
    frames_because: str | None = None
    disposition: str | None = None

    @property
    def flip(self) -> str | None:
        """The change of the verdict, such as "PASS → FAIL", or None."""
        return None if self.after in {None, self.before} else f"{self.before} → {self.after}"


@dataclass(frozen=True)
class Risks:
    """Parts whose true state a reviewer decided, against verdicts.

    Attributes:
        escapes: of the bad parts (reject, rework) those that PASS.
        false_rejects: of the good parts (accept) those that FAIL.
        cost: of both over these parts, where costs are given and a reviewer has decided about one of them.
    """

    escapes: Rate
    false_rejects: Rate
    cost: float | None


@dataclass(frozen=True)
class Costs:
    """Cost of one bad part that passes, and of one good part that fails, in any currency."""

    escape: float
    false_reject: float


@dataclass(frozen=True)
class WhatIf:
    """Inspections of the past under another recipe.

    Attributes:
        recipe: its file.
        product: its product.
        inspections: one a row of the history.
        flips: number of inspections by their change.
        before, after: risks by the verdicts then and now.
    """

    recipe: str
    product: str
    inspections: tuple[Rejudged, ...] = field(metadata=json_field(by=len))
    flips: Mapping[str, int]
    before: Risks
    after: Risks

    @property
    @in_json()
    def flipped(self) -> tuple[Rejudged, ...]:
        """Those whose verdict changed."""
        return tuple(one for one in self.inspections if one.flip is not None)

    @property
    @in_json("not_judged")
    def unjudged(self) -> tuple[Rejudged, ...]:
        """Those that could not be judged."""
        return tuple(one for one in self.inspections if one.after is None)

    @property
    @in_json()
    def from_kept(self) -> int:
        """Number of inspections judged without their frames."""
        return self.count("kept")

    @property
    @in_json()
    def from_frames(self) -> int:
        """Number of inspections judged from their frames."""
        return self.count("frames")

    def count(self, judged_from: str) -> int:
        """How many were judged from "kept" numbers, or "frames"."""
        return sum(one.judged_from == judged_from for one in self.inspections)


def what_if(
    recipe: Path,
    rows: Sequence[Row],
    dispositions: Mapping[int, str],
    workers: Workers,
    costs: Costs | None = None,
    advance: Advance = silent,
) -> WhatIf:
    """Judge inspections by another recipe.

    Args:
        recipe: its file; golden parts are those next to it.
        rows: of the history.
        dispositions: the last decision of a reviewer by the id of the row.
        workers: processes or cluster; the result does not depend on them. Those of a cluster need to see the folders.
        costs: what wrong verdicts cost.
        advance: progress.

    Raises:
        UsageError: there are no inspections.
        RecipeError, HeightMapError, CalibrationError: the recipe, or its golden parts.
        SweepError: the cluster is gone.
    """
    if not rows:
        raise UsageError("no inspection is selected")
    recipe = recipe.resolve()
    sha256 = hashlib.sha256(bounded_bytes(recipe)).hexdigest() if recipe.is_file() else ""
    plan = _plan(recipe, sha256)  # errors of the recipe come before any process
    lots: dict[str | None, list[LotMate]] = {}
    for row in sorted(rows, key=lambda one: one.id):
        if row.lot is not None:
            lots.setdefault(row.lot, []).append(LotMate.of(row))
    tasks = [Task(row, recipe, sha256, tuple(lots.get(row.lot, ()))) for row in rows]
    found = again_after_a_kill(rejudged, tasks, workers, advance)
    judged = tuple(replace(one, disposition=dispositions.get(one.id)) for one in found)
    flips: dict[str, int] = {}
    for one in judged:
        if one.flip is not None:
            flips[one.flip] = flips.get(one.flip, 0) + 1
    known = [one for one in judged if one.after is not None]
    return WhatIf(
        str(recipe),
        plan.recipe.product,
        judged,
        dict(sorted(flips.items())),
        _risks([(one.disposition, one.before) for one in known], costs),
        _risks([(one.disposition, str(one.after)) for one in known], costs),
    )


def _risks(parts: Sequence[tuple[str | None, str]], costs: Costs | None) -> Risks:
    escapes = rate(np.array([verdict == "PASS" for decided, verdict in parts if decided in BAD], dtype=bool))
    rejects = rate(np.array([verdict == "FAIL" for decided, verdict in parts if decided in GOOD], dtype=bool))
    known = costs is not None and escapes.of + rejects.of > 0
    cost = (
        None
        if costs is None or not known
        else escapes.count * costs.escape + rejects.count * costs.false_reject
    )
    return Risks(escapes, rejects, cost)


@dataclass(frozen=True, eq=False)
class _Plan:
    kind: AnyKind
    recipe: RecipeBase
    reference: Reference | None


@lru_cache(maxsize=2)
def _plan(path: Path, _sha256: str) -> _Plan:
    """A recipe with its golden parts, read once a process."""
    kind = kind_of(path)
    recipe = kind.read_recipe(path)
    return _Plan(kind, recipe, read_reference(kind, golden_path(path), recipe))


_expected: dict[tuple[Path, str, str], Expected] = {}


def _prediction(task: Task, plan: _Plan, record: Record) -> Expected:
    """What the other recipe predicts on the rig of an inspection; computed once a process."""
    seen = {name: record.rig.get(name) for name in ("light", "camera", "geometry")}
    key = (task.recipe, task.sha256, json.dumps(seen, sort_keys=True))
    if key not in _expected:
        rig = reopen(Path(task.row.folder))[1].rig
        _expected[key] = plan.kind.predict(plan.recipe, rig, cached=True)
    return _expected[key]


def rejudged(task: Task) -> Rejudged:
    """One inspection by another recipe; what cannot be judged says why."""
    row = task.row
    start = Rejudged(row.id, row.serial, row.folder, row.verdict, None, ())
    try:
        plan, record = _plan(task.recipe, task.sha256), record_of(row)
        plan = _with_lot(plan, task)
        if record.kind != plan.kind.name:
            raise RecordError(f"it is {record.kind}, the recipe is of {plan.kind.name}")
        why = _needs_frames(plan, record.recipe)
        kept = None if why is not None else read_kept(Path(row.folder), record)
        if kept is None:
            why = why or "its measurement was not kept (an earlier version, or INVALID)"
            return replace(_from_frames(start, task, plan, record), frames_because=why)
        return _from_kept(start, kept, plan, _prediction(task, plan, record), record)
    except AnisoscopeError as error:
        return replace(start, reasons=(" ".join(str(error).split()),))


def _with_lot(plan: _Plan, task: Task) -> _Plan:
    """With the other parts of the lot where the recipe compares parts with them: all that are known by now."""
    recipe = plan.recipe
    compares = isinstance(plan.kind, References) and plan.kind.compares_with_lot(recipe)
    if plan.reference is not None or not compares or not task.mates:
        return plan
    job = replace(reopen(Path(task.row.folder))[1], kind=plan.kind, recipe=recipe)
    return replace(plan, reference=job.lot_parts(task.row.lot, task.mates))


def _needs_frames(plan: _Plan, recorded: Mapping[str, Any]) -> str | None:
    if not isinstance(plan.kind, Redeciding):
        return f"of {plan.kind.one} only the frames are kept"
    return plan.kind.needs_frames(recorded, plan.recipe)


def _from_kept(
    start: Rejudged, kept: Mapping[str, Any], plan: _Plan, expected: Expected, record: Record
) -> Rejudged:
    kind, recipe = plan.kind, plan.recipe
    assert isinstance(kind, Redeciding)  # else its frames are needed
    try:
        measured, decided = kind.decide_again(kept, recipe, expected, plan.reference)
    except (MeasurementError, CameraError) as error:
        return replace(start, after=Verdict.INVALID.value, reasons=(str(error),), judged_from="kept")
    invalid = resuming_error(float(kept[CHANGE]), recipe.limits.drift) or kind.drift_error(measured, recipe)
    if invalid:
        return replace(start, after=Verdict.INVALID.value, reasons=(invalid,), judged_from="kept")
    monitor = record.rig_monitor
    found = kind.taken_back(
        recipe,
        expected,
        measured,
        decided,
        light_watched=monitor is not None and monitor.light_watched,
    )
    verdict, reasons = decided.verdict, decided.reasons
    if found is not None:
        verdict, reasons = found[0].verdict or verdict, (found[1], *reasons)
    return replace(start, after=verdict.value, reasons=reasons, judged_from="kept")


def _taken_back(case: Case, advance: Advance) -> Explanation:
    """Diagnosis of a FAIL that a fault of the rig takes back; other causes are not read."""
    del advance
    monitor = case.sitting.views.monitor
    if not isinstance(case.kind, Redeciding):
        return Explanation()
    found = case.kind.taken_back(
        case.recipe,
        case.expected,
        case.measured,
        case.decided,
        light_watched=monitor is not None and monitor.light_watched,
    )
    return Explanation() if found is None else Explanation(found[0], reason=found[1])


def _from_frames(start: Rejudged, task: Task, plan: _Plan, record: Record) -> Rejudged:
    folder = Path(task.row.folder)
    _check_poses(plan.recipe, record)
    manifest, job = reopen(folder)
    job = replace(job, recipe=plan.recipe, reference=plan.reference)
    frames = read_frames(folder, manifest)
    now, *_ = judge(manifest, job, _prediction(task, plan, record), frames, diagnose=_taken_back)
    return replace(start, after=now.verdict, reasons=now.reasons, judged_from="frames")


def _check_poses(recipe: RecipeBase, record: Record) -> None:
    there = {(frame.commanded_deg % 360.0, frame.tilt_deg or 0.0) for frame in record.frames}
    for pose in recipe.poses.poses():
        if record.frames and not any(
            abs((pose.stage_deg - stage + 180.0) % 360.0 - 180.0) < 0.5 and abs(pose.tilt_deg - tilt) < 0.5
            for stage, tilt in there
        ):
            raise RecordError(f"it was not photographed at {pose.stage_deg:g}°, tilt {pose.tilt_deg:g}°")
