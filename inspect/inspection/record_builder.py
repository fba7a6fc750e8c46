"""From a finished inspection to its record, whatever the kind of part."""

from collections.abc import Sequence
from datetime import datetime
from importlib.metadata import version

from anisoscope.base.arrays import FloatArray
from anisoscope.imaging.frames import AcquiredFrames, Shot
from anisoscope.imaging.registration.placement import View
from anisoscope.inspection.job import Job
from anisoscope.inspection.manifest import JobFile
from anisoscope.kinds.kind import Expected, Explanation, Results
from anisoscope.record.schema import CalibrationUse, FrameRecord, InputFile, PoseRecord, Record
from anisoscope.record.verdict import Verdict
from anisoscope.rig.camera import UNCALIBRATED


def make_record(
    made: JobFile,
    job: Job,
    expected: Expected,
    taken: AcquiredFrames,
    created_at: datetime,
    reasons: tuple[str, ...],
    *,
    verdict: Verdict = Verdict.INVALID,
    views: Sequence[View] = (),
    results: Results | None = None,
    explanation: Explanation | None = None,
    drift: float | None = None,
) -> Record:
    """The record of an inspection; without ``results`` it is one that could not be judged."""
    explanation = explanation or Explanation()
    calibrated = taken.linear or "linearity" in job.calibrations.records
    notes: tuple[str, ...] = () if calibrated else (UNCALIBRATED,)
    details = job.kind.without_results()
    if results is not None:
        notes += results.notes
        details = results.details.model_copy(update=dict(explanation.details))
    return Record(
        kind=job.kind.name,
        software=f"anisoscope {version('anisoscope')}",
        created_at=created_at.isoformat(timespec="seconds"),
        serial=job.serial,
        particulars=made.particulars,
        product=job.recipe.product,
        verdict=verdict.value,
        reasons=reasons,
        model=expected.model,
        optics=expected.optics,
        convention=vars(expected.convention),
        poses=() if results is None else pose_records(views, results.measured, results.predicted),
        d2=results and results.d2,
        dof=results and results.dof,
        p_value=results and results.p_value,
        budget=() if results is None else results.budget,
        drift=drift,
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
        calibrations=_calibrations(made, job),
        rounds=made.plan.rounds if made.plan is not None else 1,
        recipe=job.recipe.model_dump(mode="json", by_alias=True),
        rig=job.rig.model_dump(mode="json", by_alias=True),
        camera=taken.camera,
        stage=taken.stage,
        inputs=tuple(InputFile(name=copy.name, sha256=copy.sha256) for copy in made.inputs),
        frames=tuple(_frame_record(shot) for shot in taken.shots),
    )


def pose_records(
    views: Sequence[View], measured: FloatArray, predicted: FloatArray
) -> tuple[PoseRecord, ...]:
    """The poses with their (P,) measured and predicted radiances in 1/sr, and where the markers stood."""
    return tuple(
        PoseRecord(
            stage_deg=view.stage_deg,
            tilt_deg=view.tilt_deg,
            measured=seen,
            predicted=wanted,
            marker_angle_deg=view.placement.angle_deg,
            pixel_um=view.placement.pixel_um,
            residual_px=view.placement.residual_px,
            markers=view.placement.markers,
            dropped=view.placement.dropped,
        )
        for view, seen, wanted in zip(views, measured, predicted, strict=True)
    )


def _calibrations(made: JobFile, job: Job) -> tuple[CalibrationUse, ...]:
    """The calibrations that have records, with the copies in the folder."""
    copies = {copy.role: copy for copy in made.inputs}
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
    )
