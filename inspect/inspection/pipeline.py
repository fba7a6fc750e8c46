"""From the frames of an inspection to its record: linearise, register, measure, decide, diagnose, whatever the kind."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from anisoscope.base.errors import CameraError, MeasurementError
from anisoscope.base.progress import Advance, silent
from anisoscope.imaging.frames import AcquiredFrames
from anisoscope.imaging.views import as_photographed, resuming_error, views_of
from anisoscope.inspection.job import Job
from anisoscope.inspection.manifest import JobFile
from anisoscope.inspection.record_builder import make_record
from anisoscope.kinds.kind import AnyKind, Expected, Explanation, Reference, Sitting
from anisoscope.recipe.base import RecipeBase
from anisoscope.record.schema import Record
from anisoscope.record.verdict import Verdict
from anisoscope.report.inspection_page import Pictures

Judged = tuple[Record, Pictures]


@dataclass(frozen=True, eq=False)
class Case:
    """A part that was judged, as a diagnosis needs it; measurement and verdict are those of its kind."""

    kind: AnyKind
    sitting: Sitting
    recipe: RecipeBase
    expected: Any
    measured: Any
    decided: Any
    reference: Reference | None


Diagnose = Callable[[Case, Advance], Explanation]


def diagnose_by_kind(case: Case, advance: Advance, *, cached: bool = False) -> Explanation:
    """The diagnosis that the kind of part makes."""
    found: Explanation = case.kind.diagnose(
        case.sitting,
        case.recipe,
        case.expected,
        case.measured,
        case.decided,
        case.reference,
        advance,
        cached=cached,
    )
    return found


def utc_now() -> datetime:
    """The time, UTC."""
    return datetime.now(UTC)


def judge(
    made: JobFile,
    job: Job,
    expected: Expected,
    taken: AcquiredFrames,
    advance: Advance = silent,
    *,
    final: bool = True,
    diagnose: Diagnose = diagnose_by_kind,
    now: Callable[[], datetime] = utc_now,
) -> Judged:
    """Measure and decide; what makes the measurement unfit becomes an INVALID record.

    Args:
        made: how the inspection began.
        job: its recipe, rig and white reference.
        expected: the prediction.
        taken: its frames.
        advance: progress of what is being explained, where that takes long.
        final: what is INCONCLUSIVE is explained as well; it will not be measured again.
        diagnose: explains the verdict.
        now: the time of the record.

    Returns:
        The record, without the list of the folder's files, and the pictures of the report.
    """
    kind, recipe, reference = job.kind, job.recipe, job.reference
    if made.refused is not None:
        record = make_record(made, job, expected, taken, now(), (made.refused,))
        return record, Pictures(surface=expected.surface)
    try:
        sitting, measured, change = measure_frames(made, job, expected, taken)
        decided = kind.decide(sitting, recipe, expected, measured, reference)
    except (MeasurementError, CameraError) as error:
        record = make_record(made, job, expected, taken, now(), (str(error),))
        return record, Pictures(raw=as_photographed(taken), surface=expected.surface)
    unfit = resuming_error(change, recipe.limits.drift) or kind.drift_error(measured, recipe)
    explanation = Explanation()
    if not unfit and (final or decided.verdict is not Verdict.INCONCLUSIVE):
        case = Case(kind, sitting, recipe, expected, measured, decided, reference)
        explanation = diagnose(case, advance)
    record = make_record(
        made,
        job,
        expected,
        taken,
        now(),
        (unfit,) if unfit else decided.reasons,
        verdict=Verdict.INVALID if unfit else decided.verdict,
        views=sitting.views.poses,
        results=kind.results(sitting, recipe, expected, measured, decided, reference),
        explanation=explanation,
        drift=measured.drift,
    )
    return record, kind.pictures(recipe, expected, measured, decided)


def measure_frames(
    made: JobFile, job: Job, expected: Expected, taken: AcquiredFrames
) -> tuple[Sitting, Any, float]:
    """What an inspection's frames show, through all gates.

    Returns:
        The photographs, what was measured, and by how much the first pose had changed on resuming.

    Raises:
        MeasurementError, CameraError: INVALID, with the reason.
    """
    job.calibrations.check_valid(datetime.fromisoformat(made.created_at))
    job.kind.check_filters(taken.filters, taken.camera, job.white.filters)
    views = views_of(job.viewing(), expected.poses, taken)
    sitting = Sitting(views, taken, job.calibrations, job.rig)
    measured, change = job.kind.measure(sitting, job.recipe, expected)
    return sitting, measured, change
