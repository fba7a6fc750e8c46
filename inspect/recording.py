"""From a finished inspection to its record."""

from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from anisoscope.decision import Decision
from anisoscope.job import Job
from anisoscope.measurement import Measured, View
from anisoscope.record import (
    AreaRecord,
    BudgetRecord,
    ContrastRecord,
    FrameRecord,
    PoseRecord,
    Record,
    sha256_of,
)
from anisoscope.rig.acquisition.runner import FrameRecord as FrameFile


@dataclass(frozen=True, eq=False)
class Taken:
    """The frames of one inspection and the devices that took them."""

    frames: tuple[FrameFile, ...]
    camera: str
    stage: str
    full_scale: int


def results(job: Job, views: list[View], measured: Measured, decision: Decision) -> dict[str, Any]:
    """The part of a record that a verdict rests on."""
    area = decision.area
    kind = job.recipe.decision.contrast
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
            )
            for view, seen, predicted in zip(views, measured.radiance, job.expected.radiance, strict=True)
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
            )
            for pair in decision.pairs
        ),
        "d2": decision.d2,
        "dof": decision.dof,
        "p_value": decision.p_value,
        "area": area
        and AreaRecord(
            share=area.share, u=area.u, max_share=area.max_share, cells=area.cells, verdict=area.verdict.value
        ),
        "budget": tuple(
            BudgetRecord(source=row.source, kind=row.kind, contributions=row.contributions)
            for row in decision.budget
        ),
        "drift": measured.drift,
    }


def make_record(
    job: Job,
    taken: Taken,
    folder: Path,
    *,
    verdict: str,
    reasons: tuple[str, ...],
    **results: Any,  # noqa: ANN401
) -> Record:
    """The record of an inspection; without ``results`` it is one that could not be judged."""
    nothing: dict[str, Any] = dict.fromkeys(("d2", "dof", "p_value", "area", "drift"))
    nothing |= {"poses": (), "contrasts": (), "budget": ()}
    return Record.model_validate(
        {
            "software": f"anisoscope {version('anisoscope')}",
            "created_at": datetime.now(UTC).isoformat(timespec="seconds"),
            "serial": job.serial,
            "product": job.recipe.product,
            "verdict": verdict,
            "reasons": reasons,
            "model": job.expected.model,
            "convention": vars(job.expected.convention),
            "white_reference": {
                "taken_at": job.white.taken_at,
                "reflectance": job.white.reflectance,
                "camera": job.white.camera,
                "sha256": job.white.sha256,
            },
            "recipe": job.recipe.model_dump(mode="json", by_alias=True),
            "rig": job.rig.model_dump(mode="json", by_alias=True),
            "camera": taken.camera,
            "stage": taken.stage,
            "inputs": job.inputs,
            "frames": tuple(_frame_record(file, folder) for file in taken.frames),
            **nothing,
            **results,
        }
    )


def _frame_record(file: FrameFile, folder: Path) -> FrameRecord:
    frame = file.frame
    return FrameRecord(
        name=str(file.path.relative_to(folder)),
        sha256=sha256_of(file.path),
        kind=frame.kind,
        stage_deg=frame.stage_deg,
        commanded_deg=frame.commanded_deg,
        exposure_s=frame.exposure_s,
        gain=frame.gain,
        captured_at=frame.captured_at,
    )
