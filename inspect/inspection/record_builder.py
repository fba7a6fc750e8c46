"""From a finished inspection to its record."""

from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, cast

from anisoscope.decision.decision import Decision
from anisoscope.imaging.defect_regions import Region
from anisoscope.imaging.frames import AcquiredFrames, Shot
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import View
from anisoscope.inspection.job import Job, Role
from anisoscope.inspection.manifest import JobFile
from anisoscope.kinds.prints.expectation import PrintExpectation
from anisoscope.prediction.expectation import Expectation
from anisoscope.record.schema import (
    AreaRecord,
    BudgetRecord,
    CalibrationUse,
    ContrastRecord,
    FrameRecord,
    InputFile,
    PoseRecord,
    Record,
    RegionRecord,
    TiltContrastRecord,
)
from anisoscope.rig.camera import UNCALIBRATED


def results(
    job: Job, expected: Expectation, views: list[View], measured: Measured, decision: Decision
) -> dict[str, Any]:
    """The part of a record that a verdict rests on."""
    area = decision.area
    kind = job.ridged.decision.contrast
    return {
        "poses": tuple(
            PoseRecord(
                stage_deg=view.stage_deg,
                tilt_deg=view.tilt_deg,
                measured=float(seen),
                predicted=float(predicted),
                marker_angle_deg=view.placement.angle_deg,
                pixel_um=view.placement.pixel_um,
                residual_px=view.placement.residual_px,
                markers=view.placement.markers,
                dropped=view.placement.dropped,
            )
            for view, seen, predicted in zip(views, measured.radiance, expected.radiance, strict=True)
        ),
        "contrasts": tuple(
            ContrastRecord(
                from_deg=pair.from_deg,
                to_deg=pair.to_deg,
                tilt_deg=pair.tilt_deg,
                kind=kind,
                measured=pair.measured,
                predicted=pair.predicted,
                u=pair.u,
                tolerance=pair.tolerance,
                guard=pair.guard,
                conformance_probability=pair.conformance,
                verdict=pair.verdict.value,
                p_value=pair.p_value,
                tolerance_ratio=pair.tolerance_ratio,
            )
            for pair in decision.pairs
        ),
        "between_tilts": tuple(
            TiltContrastRecord(
                stage_deg=one.stage_deg,
                from_tilt_deg=one.from_tilt_deg,
                to_tilt_deg=one.to_tilt_deg,
                kind=kind,
                measured=one.measured,
                predicted=one.predicted,
                u_measured=one.u_measured,
                u_predicted=one.u_predicted,
                u=one.u,
                p_value=one.p_value,
            )
            for one in decision.between_tilts
        ),
        "d2": decision.d2,
        "dof": decision.dof,
        "p_value": decision.p_value,
        "conformance_probability": decision.conformance,
        "regions": tuple(_region_record(region) for region in decision.regions),
        "area": area
        and AreaRecord(
            share=area.share,
            u=area.u,
            max_share=area.max_share,
            cells=area.cells,
            verdict=area.verdict.value,
            learnt=area.learnt,
            p_value=area.p_value,
        ),
        "budget": tuple(
            BudgetRecord(source=row.source, kind=row.kind, contributions=row.contributions)
            for row in decision.budget
        ),
        "drift": measured.drift,
    }


def _region_record(region: Region) -> RegionRecord:
    return RegionRecord(
        x=region.x_mm,
        y=region.y_mm,
        width=region.width_mm,
        length=region.length_mm,
        area_share=region.area_share,
        cells=region.cells,
        kind=region.kind,
        deviation=region.deviation,
        p_value=region.p_value,
    )


def make_record(
    made: JobFile,
    job: Job,
    expected: Expectation | PrintExpectation,
    taken: AcquiredFrames,
    *,
    verdict: str,
    reasons: tuple[str, ...],
    **results: Any,  # noqa: ANN401
) -> Record:
    """The record of an inspection; without ``results`` it is one that could not be judged."""
    nothing: dict[str, Any] = dict.fromkeys(("d2", "dof", "p_value", "area", "drift"))
    nothing |= {"poses": (), "contrasts": (), "budget": ()}
    calibrated = taken.linear or "linearity" in job.calibrations.records
    results["notes"] = (*(() if calibrated else (UNCALIBRATED,)), *results.get("notes", ()))
    return Record.model_validate(
        {
            "software": f"anisoscope {version('anisoscope')}",
            "created_at": datetime.now(UTC).isoformat(timespec="seconds"),
            "serial": job.serial,
            "particulars": made.particulars,
            "product": job.recipe.product,
            "verdict": verdict,
            "reasons": reasons,
            "model": expected.model,
            "optics": expected.optics,
            "convention": vars(expected.convention),
            "white_reference": {
                "taken_at": job.white.taken_at,
                "reflectance": job.white.reflectance,
                "camera": job.white.camera,
                "sha256": job.white.sha256,
            },
            "calibrations": _calibrations(made, job),
            "rounds": made.plan.rounds if made.plan is not None else 1,
            "recipe": job.recipe.model_dump(mode="json", by_alias=True),
            "rig": job.rig.model_dump(mode="json", by_alias=True),
            "camera": taken.camera,
            "stage": taken.stage,
            "inputs": tuple(InputFile(name=copy.name, sha256=copy.sha256) for copy in made.inputs),
            "frames": tuple(_frame_record(shot) for shot in taken.shots),
            **nothing,
            **results,
        }
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
