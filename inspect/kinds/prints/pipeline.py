"""From the frames of a print to its record: linearise, register, measure by colour, fit, decide, explain."""

from datetime import datetime

import numpy as np

from anisoscope.base.errors import AnisoscopeError, CameraError, MeasurementError
from anisoscope.base.progress import Advance, silent
from anisoscope.diagnosis.part_diagnosis import diagnosis_record
from anisoscope.imaging.frames import AcquiredFrames
from anisoscope.imaging.pose_radiance import check_light, check_view
from anisoscope.imaging.quality_gates import check_views
from anisoscope.imaging.registration.placement import View
from anisoscope.imaging.views import as_photographed, most_changed, resuming_error, views_of
from anisoscope.inspection.job import Job
from anisoscope.inspection.manifest import JobFile
from anisoscope.inspection.record_builder import make_record
from anisoscope.kinds.prints.causes import explain_print
from anisoscope.kinds.prints.decision import PrintDecision, decide_print
from anisoscope.kinds.prints.expectation import PrintExpectation
from anisoscope.kinds.prints.lighting import check_filters, lamp_and_sensitivities
from anisoscope.kinds.prints.measurement import MeasuredPrint, measure_print, region_mean
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.record_builder import nothing_wrong, print_results
from anisoscope.kinds.prints.reference_prints import GoldenPrints
from anisoscope.kinds.prints.report_sections import PrintPictures
from anisoscope.kinds.prints.stationary_artifacts import check_print_dirt
from anisoscope.record.schema import DiagnosisRecord, Record, Results
from anisoscope.record.verdict import Verdict
from anisoscope.report.inspection_page import Pictures


def judge_print(
    made: JobFile,
    job: Job,
    expected: PrintExpectation,
    taken: AcquiredFrames,
    advance: Advance = silent,
    *,
    final: bool = True,
) -> tuple[Record, Pictures]:
    """Measure and decide; arguments and returned values as of `anisoscope.inspection.pipeline.judge`."""
    assert isinstance(job.recipe, PrintRecipe)
    recipe = job.calibrations.applied_to(job.recipe)
    try:
        views, measured, change = _measured(made, job, recipe, expected, taken)
        decision = decide_print(expected, measured, recipe, _known_good(job))
    except (MeasurementError, CameraError) as error:
        record = make_record(made, job, expected, taken, verdict=Verdict.INVALID, reasons=(str(error),))
        return record, Pictures(raw=as_photographed(taken))
    unfit = resuming_error(change, recipe.limits.drift) or _drift_complaint(measured, recipe)
    undecided = decision.verdict is Verdict.INCONCLUSIVE
    lacking = job.golden_prints and job.golden_prints.lacking
    names = (lamp_and_sensitivities(job.rig)[1].name, taken.filters)
    explained: Results = {"notes": (lacking,) if lacking else ()}
    if not unfit and (final or not undecided):
        advance("causes", 0, 1)
        told = _explained(recipe, expected, measured, decision)
        explained |= told | {"notes": explained["notes"] + told.get("notes", ())}
    record = make_record(
        made,
        job,
        expected,
        taken,
        verdict=Verdict.INVALID if unfit else decision.verdict,
        reasons=(unfit,) if unfit else decision.reasons,
        **print_results(recipe, expected, views, measured, decision, names) | explained,
    )
    return record, Pictures(print=_pictures(expected, measured, decision))


def _known_good(job: Job) -> GoldenPrints | None:
    """The golden prints that decide what deviates: None as long as there are too few of them."""
    golden = job.golden_prints
    return golden if golden is not None and golden.lacking is None else None


def _measured(
    made: JobFile, job: Job, recipe: PrintRecipe, expected: PrintExpectation, taken: AcquiredFrames
) -> tuple[list[View], MeasuredPrint, float]:
    """Channels of the poses through all gates; views, measurement, and the change on resuming.

    Raises:
        MeasurementError, CameraError: INVALID, with the reason.
    """
    job.calibrations.check_valid(datetime.fromisoformat(made.created_at))
    check_filters(taken.filters, taken.camera, job.white.filters)
    views = views_of(job.viewing(), expected.poses, taken)
    closing, change = most_changed(
        views, recipe, job.rig.camera.pixel_um, lambda view: region_mean(view, recipe, taken.filters)
    )
    for view in [*views.poses, *([closing] if closing else [])]:
        check_light(view.stage_deg, view.image, recipe)
        # a tilted arm looks from elsewhere: within a tilt only must the centre stay where it is
        alike = next(first for first in views.poses if first.tilt_deg == view.tilt_deg)
        check_view(view, alike, recipe, job.rig.camera.pixel_um)
        job.calibrations.check_place(view.stage_deg, view.placement)
    check_views(views.poses)
    measured = measure_print(views.poses, closing, recipe, taken.filters)
    check_print_dirt(views.poses, recipe, taken.filters, expected.eye, measured.channels)
    return views.poses, measured, change


def _drift_complaint(measured: MeasuredPrint, recipe: PrintRecipe) -> str | None:
    drift, limit = measured.drift, recipe.limits.drift
    if drift is None or abs(drift) <= limit:
        return None
    return (
        f"at the end the first pose is {abs(drift):.1%} {'brighter' if drift > 0 else 'darker'} than at the start "
        f"(limit {limit:.1%}): let the lamp warm up, and check that the print lies tight"
    )


def _explained(
    recipe: PrintRecipe, expected: PrintExpectation, measured: MeasuredPrint, decision: PrintDecision
) -> Results:
    """The causes, or a note where they cannot be told; they never change the verdict."""
    alpha = recipe.decision.alpha
    if nothing_wrong(decision, alpha):
        return {"diagnosis": DiagnosisRecord(says="nothing: the print is as it should be")}
    try:
        found = explain_print(recipe, expected, measured, decision)
    except (AnisoscopeError, ArithmeticError, ValueError, np.linalg.LinAlgError) as problem:
        note = f"no diagnosis: {problem}"
        return {"diagnosis": DiagnosisRecord(says="not possible"), "notes": (note,)}
    return {"diagnosis": diagnosis_record(found, alpha, "print")}


def _pictures(expected: PrintExpectation, measured: MeasuredPrint, decision: PrintDecision) -> PrintPictures:
    """What the report shows of a print: cells in the colours of the eye, and the maps."""
    eye, found = expected.eye, decision.map
    cells = np.moveaxis(measured.cells, 1, -1)
    return PrintPictures(
        seen=tuple(eye.srgb(one) for one in cells),
        measured=eye.srgb(measured.channels),
        predicted=eye.srgb(np.stack([one.wanted for one in decision.colours])),
        size_mm=measured.grid.size_mm,
        center_mm=measured.grid.center_mm,
        local=None if found is None else found.local,
        total=None if found is None else found.total,
        lean_deg=None if found is None else found.lean_deg,
        deviating=None if found is None else found.deviating,
    )
