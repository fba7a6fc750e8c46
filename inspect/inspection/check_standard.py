"""Check standard: a retained part whose contrasts must be reproduced within the uncertainty."""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.base.printable import check_printable
from anisoscope.base.progress import Advance, silent
from anisoscope.base.significance import chi2_tail, log_basis, mahalanobis
from anisoscope.calibration.record import (
    CalibrationRecord,
    CameraRecord,
    Value,
    dated,
    days_of,
    read_calibration,
    record_path,
    write_calibration,
)
from anisoscope.imaging.linearisation import check_size
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.inspection.frames import read_frames
from anisoscope.inspection.job import Job, prepare
from anisoscope.inspection.manifest import begin
from anisoscope.inspection.pipeline import measure_frames
from anisoscope.record.schema import Particulars, sha256_of
from anisoscope.rig.acquisition.runner import Progress, Rig, open_rig, run_plan

ALPHA = 0.0027
LIMIT = 0.02
SERIAL = "check-standard"


@dataclass(frozen=True)
class Standard:
    """Taught values of the check standard.

    Attributes:
        serial: which part it is.
        taught_at: UTC time.
        contrasts: (m,) ln L of every pose but the first, minus that of the first.
        covariance: (m, m) of them, from the measurement alone.
        recipe_sha256: the recipe it was taught with.
    """

    serial: str
    taught_at: str
    contrasts: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    recipe_sha256: str


def teach_check(
    rig_path: Path,
    recipe_path: Path,
    out: Path,
    *,
    serial: str = SERIAL,
    valid_days: float | None = None,
    operator: str | None = None,
    on_progress: Advance = silent,
) -> CalibrationRecord:
    """Photograph the check standard and keep its contrasts; do so when the rig was just calibrated.

    Args:
        rig_path: rig file.
        recipe_path: recipe that says how the standard is photographed.
        out: record to write (JSON).
        serial: which part it is.
        valid_days: how long this check holds.
        operator: who takes it.
        on_progress: called with what is being done, steps done and steps in all.

    Raises:
        RecipeError, RigFileError, RigError: recipe or rig.
        MeasurementError: the standard cannot be measured, or another calibration does not hold.
        RecordError: the file cannot be written.
    """
    days_of("check", valid_days)
    contrasts, covariance, content = _measure(rig_path, recipe_path, serial, operator, on_progress)
    found = content | {
        "values": {f"contrast_{n + 1}": Value(value=float(v)) for n, v in enumerate(contrasts)},
        "remarks": (f"{serial} was taught",),
    }
    record = dated("check", found, valid_days=valid_days)
    standard = Standard(
        serial,
        record.taken_at.isoformat(timespec="seconds"),
        tuple(float(v) for v in contrasts),
        tuple(tuple(float(v) for v in row) for row in covariance),
        sha256_of(recipe_path),
    )
    record = record.model_copy(update={"details": {"taught": vars(standard), "d2": None}})
    write_calibration(record, record_path(out))
    return record


def run_check(
    rig_path: Path,
    recipe_path: Path,
    out: Path,
    *,
    limit: float = LIMIT,
    valid_days: float | None = None,
    operator: str | None = None,
    on_progress: Advance = silent,
) -> CalibrationRecord:
    """Photograph the check standard and compare it with what it was taught.

    In limits is what deviates by at most ``limit`` in every ln ratio and is no less probable than 0.27 %, by D² with
    the uncertainty of both measurements.

    Args:
        rig_path: rig file.
        recipe_path: the recipe with which it was taught.
        out: the record of the last check or teaching; it is replaced by that of this check.
        limit: largest deviation of an ln ratio.
        valid_days: how long this check holds.
        operator: who takes it.
        on_progress: called with what is being done, steps done and steps in all.

    Raises:
        UsageError: a limit of 0 or less, or another recipe.
        CalibrationError: nothing was taught.
        RecipeError, RigFileError, RigError, MeasurementError, RecordError: as for `teach_check`.
    """
    if not limit > 0.0:
        raise UsageError(f"the limit of the check must be more than 0, not {limit:g}")
    days_of("check", valid_days)
    standard = standard_of(read_calibration(out, "check"), out)
    if sha256_of(recipe_path) != standard.recipe_sha256:
        raise UsageError(
            f"the check standard was taught with another recipe than {recipe_path}: give that one, or teach it anew "
            "with `anisoscope calibrate check --teach`"
        )
    contrasts, covariance, content = _measure(rig_path, recipe_path, standard.serial, operator, on_progress)
    found = content | _compared(contrasts, covariance, standard, limit)
    record = dated("check", found, valid_days=valid_days)
    write_calibration(record, record_path(out))
    return record


def standard_of(record: CalibrationRecord, path: Path) -> Standard:
    """Taught values from a record of the check standard.

    Raises:
        CalibrationError: it holds nothing of the kind.
    """
    try:
        taught = record.details["taught"]
        return Standard(
            str(taught["serial"]),
            str(taught["taught_at"]),
            tuple(float(v) for v in taught["contrasts"]),
            tuple(tuple(float(v) for v in row) for row in taught["covariance"]),
            str(taught["recipe_sha256"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(
            f"{path} holds no check standard: teach one with `anisoscope calibrate check --teach`"
        ) from error


def _compared(
    contrasts: FloatArray, covariance: FloatArray, standard: Standard, limit: float
) -> dict[str, Any]:
    """Comparison of the measured contrasts with those of the standard, as the calibration record holds it."""
    off, both = contrasts - np.array(standard.contrasts), covariance + np.array(standard.covariance)
    d2, dof = mahalanobis(off, both)
    p_value, largest = float(chi2_tail(d2, dof)), float(np.abs(off).max())
    remarks = []
    if largest > limit:
        remarks.append(f"the check standard deviates by {largest:.3f} in an ln ratio (limit {limit:g})")
    if p_value < ALPHA:
        remarks.append(f"the check standard deviates significantly: D² = {d2:.1f}, p = {p_value:.2g}")
    u = np.sqrt(np.diag(both))
    values = {f"deviation_{n + 1}": Value(value=float(off[n]), u=float(u[n])) for n in range(len(off))}
    return {
        "values": values | {"d2": Value(value=d2), "p_value": Value(value=p_value)},
        "residuals": tuple(float(value) for value in off),
        "details": {"taught": vars(standard), "d2": d2, "dof": dof, "limit": limit, "alpha": ALPHA},
        "in_limits": not remarks,
        "remarks": tuple(remarks),
    }


def _measure(
    rig_path: Path, recipe_path: Path, serial: str, operator: str | None, advance: Advance
) -> tuple[FloatArray, FloatArray, dict[str, Any]]:
    """Contrasts of the standard now, their covariance from the measurement, and fields of the record."""

    def report_progress(now: Progress) -> None:
        advance(now.text, now.done, now.total)

    check_printable({"operator": operator})
    job = prepare(recipe_path, rig_path, serial, without="check")
    plan = job.plan()
    assert job.surface_recipe
    expected = job.kind.predict(job.recipe, job.rig, cached=False)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        with open_rig(job.rig) as rig:
            _check_camera(rig, job)
            info, stage = rig.camera.info, rig.stage.name
            here = rig_path.resolve().parent
            manifest = begin(folder, job, Particulars(), plan=plan, frames=plan.frame_count, rig_folder=here)
            run_plan(plan, rig, folder, on_progress=report_progress)
        advance("measurement", 0, 1)
        _, measured, _ = measure_frames(manifest.began, job, expected, read_frames(folder, manifest))
    content = {
        "rig": job.rig.name,
        "camera": CameraRecord(
            model=info.model, serial=info.serial, rows=info.rows, cols=info.cols, bit_depth=info.bit_depth
        ),
        "stage": stage,
        "exposure_s": plan.exposure_s,
        "gain": plan.gain,
        "frames": plan.frame_count,
        "operator": operator,
    }
    contrasts, covariance = _contrasts(measured)
    return contrasts, covariance, content


def _check_camera(rig: Rig, job: Job) -> None:
    info = rig.camera.info
    if job.white.camera != info.serial:
        raise CalibrationError(
            f"the flat was taken with camera {job.white.camera}, this is {info.serial}: "
            "take a new one with `anisoscope calibrate flat`"
        )
    check_size(job.white, (info.rows, info.cols))
    job.calibrations.check_camera(info.serial, (info.rows, info.cols))


def _contrasts(measured: Measured) -> tuple[FloatArray, FloatArray]:
    basis = log_basis(len(measured.radiance))
    covariance = np.sum([component.covariance() for component in measured.components], axis=0)
    return basis @ np.log(measured.radiance), np.asarray(basis @ covariance @ basis.T)
