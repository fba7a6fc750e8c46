"""From the frames of an inspection to its record: linearise, register, measure, decide, diagnose, whatever the kind."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CameraError, MeasurementError
from anisoscope.base.progress import Advance, silent
from anisoscope.imaging.frames import AcquiredFrames, Shot
from anisoscope.imaging.quality_gates import unwatched
from anisoscope.imaging.registration.placement import View
from anisoscope.imaging.views import Views, as_photographed, resuming_error, views_of
from anisoscope.inspection.job import Job
from anisoscope.inspection.kept_measurement import CHANGE, Kept
from anisoscope.inspection.manifest import Manifest
from anisoscope.kinds.kind import AnyKind, Expected, Explanation, Results, Sitting
from anisoscope.kinds.parts import Redeciding, Reference, reporting
from anisoscope.recipe.base import RecipeBase
from anisoscope.record.schema import (
    CalibrationUse,
    FrameRecord,
    InputFile,
    PoseRecord,
    Record,
    RigMonitorRecord,
)
from anisoscope.record.verdict import Verdict
from anisoscope.report.inspection_page import Pictures
from anisoscope.rig.camera import UNCALIBRATED

Judged = tuple[Record, Callable[[], Pictures], Kept | None]
"""A record, what makes the pictures of its report, which the verdict does not wait for, and the numbers
of its measurement that are stored, if any."""


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
    manifest: Manifest,
    job: Job,
    expected: Expected,
    frames: AcquiredFrames,
    advance: Advance = silent,
    *,
    final: bool = True,
    diagnose: Diagnose = diagnose_by_kind,
    now: Callable[[], datetime] = utc_now,
) -> Judged:
    """Measure, decide and diagnose; a measurement that fails a quality gate becomes an INVALID record.

    Args:
        manifest: how the inspection began.
        job: its recipe, rig and white reference.
        expected: the prediction.
        frames: of the inspection.
        advance: progress of the diagnosis, where that takes long.
        final: diagnose an INCONCLUSIVE part as well; it will not be measured again.
        diagnose: explains the verdict.
        now: the time of the record.

    Returns:
        The record, without the list of the folder's files, what makes the pictures of the report, and what is kept.
    """
    kind, recipe, reference = job.kind, job.recipe, job.reference
    if manifest.refused is not None:
        record = make_record(manifest, job, expected, frames, now(), (manifest.refused,))
        return record, lambda: Pictures(raw=as_photographed(frames), surface=expected.surface), None
    views, fault = None, None
    try:
        views = _photographed(manifest.began, job, expected, frames)
        fault = views.monitor and views.monitor.fault
        sitting, measured, change = _measured(views, job, expected, frames)
        decided = kind.decide(sitting, recipe, expected, measured, reference)
    except (MeasurementError, CameraError) as error:
        record = make_record(manifest, job, expected, frames, now(), (fault or str(error),), views=views)
        return record, lambda: Pictures(raw=as_photographed(frames), surface=expected.surface), None
    resumed, drifted = resuming_error(change, recipe.limits.drift), kind.drift_error(measured, recipe)
    invalid_reason = resumed or fault or drifted  # what could be measured is kept
    explanation = Explanation()
    if not invalid_reason and (final or decided.verdict is not Verdict.INCONCLUSIVE):
        case = Case(kind, sitting, recipe, expected, measured, decided, reference)
        explanation = diagnose(case, advance)
    verdict, reasons = decided.verdict, decided.reasons
    if invalid_reason:
        verdict, reasons = Verdict.INVALID, (invalid_reason,)
    elif explanation.reason and explanation.diagnosis is not None:
        verdict, reasons = explanation.diagnosis.verdict or verdict, (explanation.reason, *reasons)
    record = make_record(
        manifest,
        job,
        expected,
        frames,
        now(),
        reasons,
        verdict=verdict,
        views=views,
        results=kind.results(sitting, recipe, expected, measured, decided, reference),
        explanation=explanation,
        drift=measured.drift,
    )
    kept = None
    if isinstance(kind, Redeciding):
        numbers = kind.kept(job.calibrations.applied_to(recipe), measured)
        kept = None if numbers is None else {**numbers, CHANGE: change}
    return record, lambda: reporting(kind).pictures(recipe, expected, measured, decided), kept


def measure_frames(
    when: datetime, job: Job, expected: Expected, frames: AcquiredFrames
) -> tuple[Sitting, Any, float]:
    """Measurement of an inspection's frames, through all quality gates.

    Args:
        when: the inspection began; calibrations must be valid then.
        job: its recipe, rig and white reference.
        expected: the prediction.
        frames: of the inspection.

    Returns:
        The photographs, the measurement, and the change of the first pose on resuming.

    Raises:
        MeasurementError, CameraError: INVALID, with the reason.
    """
    views = _photographed(when, job, expected, frames)
    if views.monitor is not None and views.monitor.fault is not None:
        raise MeasurementError(views.monitor.fault)
    return _measured(views, job, expected, frames)


def _photographed(when: datetime, job: Job, expected: Expected, frames: AcquiredFrames) -> Views:
    job.calibrations.check_valid(when)
    job.kind.check_valid(job.recipe, when)
    job.kind.check_filters(frames.filters, frames.camera, job.white.filters)
    return views_of(job.viewing(), expected.poses, frames)


def _measured(
    views: Views, job: Job, expected: Expected, frames: AcquiredFrames
) -> tuple[Sitting, Any, float]:
    sitting = Sitting(views, frames, job.calibrations, job.rig)
    measured, change = job.kind.measure(sitting, job.recipe, expected)
    return sitting, measured, change


def make_record(
    manifest: Manifest,
    job: Job,
    expected: Expected,
    frames: AcquiredFrames,
    created_at: datetime,
    reasons: tuple[str, ...],
    *,
    verdict: Verdict = Verdict.INVALID,
    views: Views | None = None,
    results: Results | None = None,
    explanation: Explanation | None = None,
    drift: float | None = None,
) -> Record:
    """The record of an inspection; without ``results`` it is one that could not be judged."""
    explanation = explanation or Explanation()
    calibrated = frames.linear or "linearity" in job.calibrations.records
    seen, monitor = (views.poses, views.monitor) if views is not None else ((), None)
    notes: tuple[str, ...] = () if calibrated else (UNCALIBRATED,)
    notes += () if views is None else views.frame_notes
    details = job.kind.without_results()
    if results is not None:
        notes += (*unwatched(seen), *results.notes)
        details = results.details.model_copy(update=dict(explanation.details))
    if monitor is not None:
        notes += monitor.notes
    record = Record(
        kind=job.kind.name,
        software=f"anisoscope {version('anisoscope')}",
        created_at=created_at.isoformat(timespec="seconds"),
        serial=job.serial,
        particulars=manifest.particulars,
        product=job.recipe.product,
        verdict=verdict.value,
        reasons=reasons,
        model=expected.model,
        optics=expected.optics,
        convention=vars(expected.convention),
        poses=() if results is None else pose_records(seen, results.measured, results.predicted),
        d2=results and results.d2,
        dof=results and results.dof,
        p_value=results and results.p_value,
        budget=() if results is None else results.budget,
        drift=drift,
        rig_monitor=None
        if monitor is None
        else RigMonitorRecord.model_validate(monitor, from_attributes=True),
        conformance_probability=results and results.conformance_probability,
        diagnosis=explanation.diagnosis,
        details=details,
        notes=(*notes, *explanation.notes),
        white_reference={
            "taken_at": job.white.taken_at,
            "reflectance": job.white.reflectance,
            "camera": job.white.camera,
            "sha256": job.white.sha256,
        },
        calibrations=_calibrations(manifest, job),
        rounds=manifest.plan.rounds if manifest.plan is not None else 1,
        recipe=job.recipe.model_dump(mode="json", by_alias=True),
        rig=job.rig.model_dump(mode="json", by_alias=True),
        camera=frames.camera,
        stage=frames.stage,
        origin="rig" if manifest.origin == "rig" else "imported",
        reuse=manifest.reuse,
        judged_anew=manifest.judged_anew,
        inputs=tuple(InputFile(name=copy.name, sha256=copy.sha256) for copy in manifest.inputs),
        frames=tuple(_frame_record(shot) for shot in frames.shots),
    )
    return record.model_copy(update={"conclusion": reporting(job.kind).conclude(record)})


def pose_records(
    views: Sequence[View], measured: FloatArray, predicted: FloatArray
) -> tuple[PoseRecord, ...]:
    """The poses with their (P,) measured and predicted radiances in 1/sr, and where the markers stood."""
    return tuple(
        PoseRecord(
            stage_deg=view.stage_deg,
            tilt_deg=view.tilt_deg,
            measured=value,
            predicted=prediction,
            marker_angle_deg=view.placement.angle_deg,
            pixel_um=view.placement.pixel_um,
            residual_px=view.placement.residual_px,
            markers=view.placement.markers,
            dropped=view.placement.dropped,
        )
        for view, value, prediction in zip(views, measured, predicted, strict=True)
    )


def _calibrations(manifest: Manifest, job: Job) -> tuple[CalibrationUse, ...]:
    """The calibrations that have records, with the copies in the folder."""
    copies = {copy.role: copy for copy in manifest.inputs}
    return tuple(
        CalibrationUse(
            name=copies[role].name,
            sha256=copies[role].sha256,
            kind=kind,
            id=one.id,
            taken_at=one.taken_at.isoformat(),
            valid_until=one.valid_until.isoformat(),
        )
        for kind, one in job.calibrations.records.items()
        for role in (f"{kind} record",)
        if role in copies
    )


def _frame_record(shot: Shot) -> FrameRecord:
    frame = shot.frame
    return FrameRecord(
        name=shot.name,
        sha256=shot.sha256,
        kind=frame.kind,
        again=shot.again,
        tilt_deg=frame.tilt_deg,
        stage_deg=frame.stage_deg,
        commanded_deg=shot.pose.stage_deg,
        exposure_s=frame.exposure_s,
        gain=frame.gain,
        captured_at=frame.captured_at,
        linear_mm=dict(shot.linear_mm),
        pixels=frame.pixels,
    )
