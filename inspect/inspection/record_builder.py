"""From a finished inspection to its record."""

from datetime import UTC, datetime
from importlib.metadata import version
from typing import Unpack, cast

from anisoscope.decision.decision import Decision
from anisoscope.imaging.frames import AcquiredFrames, Shot
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import View
from anisoscope.imaging.views import pose_records
from anisoscope.inspection.job import Job, Role
from anisoscope.inspection.manifest import JobFile
from anisoscope.kinds.prints.expectation import PrintExpectation
from anisoscope.prediction.expectation import Expectation
from anisoscope.record.schema import CalibrationUse, FrameRecord, InputFile, Record, Results
from anisoscope.record.verdict import Verdict
from anisoscope.rig.camera import UNCALIBRATED

_NOTHING: Results = {
    "poses": (),
    "contrasts": (),
    "d2": None,
    "dof": None,
    "p_value": None,
    "area": None,
    "budget": (),
    "drift": None,
}
"""Of an inspection that could not be judged."""


def results(expected: Expectation, views: list[View], measured: Measured, decision: Decision) -> Results:
    """The part of a record that a verdict rests on."""
    return {
        "poses": pose_records(views, measured.radiance, expected.radiance),
        "contrasts": decision.contrasts,
        "between_tilts": decision.between_tilts,
        "d2": decision.d2,
        "dof": decision.dof,
        "p_value": decision.p_value,
        "conformance_probability": decision.conformance_probability,
        "regions": decision.regions,
        "area": decision.area,
        "budget": decision.budget,
        "drift": measured.drift,
    }


def make_record(
    made: JobFile,
    job: Job,
    expected: Expectation | PrintExpectation,
    taken: AcquiredFrames,
    *,
    verdict: Verdict,
    reasons: tuple[str, ...],
    **results: Unpack[Results],
) -> Record:
    """The record of an inspection; without ``results`` it is one that could not be judged."""
    calibrated = taken.linear or "linearity" in job.calibrations.records
    notes = (*(() if calibrated else (UNCALIBRATED,)), *results.get("notes", ()))
    found: Results = {**_NOTHING, **results, "notes": notes}
    return Record(
        software=f"anisoscope {version('anisoscope')}",
        created_at=datetime.now(UTC).isoformat(timespec="seconds"),
        serial=job.serial,
        particulars=made.particulars,
        product=job.recipe.product,
        verdict=verdict.value,
        reasons=reasons,
        model=expected.model,
        optics=expected.optics,
        convention=vars(expected.convention),
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
        **found,
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
        for role in (cast("Role", f"{kind} record"),)
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
