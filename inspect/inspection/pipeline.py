"""From the frames of an inspection to its record: linearise, register, measure, decide."""

from datetime import datetime

from anisoscope.base.errors import CameraError, MeasurementError
from anisoscope.base.progress import Advance, silent
from anisoscope.decision.decision import decide
from anisoscope.decision.design_vs_map import Predict
from anisoscope.imaging.defect_regions import deviation_map
from anisoscope.imaging.deviation_map import cell_log_ratios
from anisoscope.imaging.frames import AcquiredFrames
from anisoscope.imaging.pose_radiance import Measured, drift_complaint, mean_of, measure, region_grid
from anisoscope.imaging.quality_gates import check_views
from anisoscope.imaging.registration.placement import View, resample
from anisoscope.imaging.views import as_photographed, most_changed, resuming_error, views_of
from anisoscope.inspection.analysis import insight, known_good
from anisoscope.inspection.job import Job
from anisoscope.inspection.manifest import JobFile
from anisoscope.inspection.record_builder import make_record, results
from anisoscope.kinds.prints.expectation import PrintExpectation
from anisoscope.kinds.prints.pipeline import judge_print
from anisoscope.prediction.expectation import Expectation, expectation
from anisoscope.record.schema import Record
from anisoscope.record.verdict import Verdict
from anisoscope.report.inspection_page import Pictures


def judge(
    made: JobFile,
    job: Job,
    expected: Expectation | PrintExpectation,
    taken: AcquiredFrames,
    advance: Advance = silent,
    *,
    final: bool = True,
    predict: Predict = expectation,
) -> tuple[Record, Pictures]:
    """Measure and decide; what makes the measurement unfit becomes an INVALID record.

    Args:
        made: how the inspection began.
        job: its recipe, rig and white reference.
        expected: the prediction.
        taken: its frames.
        advance: told what is being explained, where that takes long.
        final: what is INCONCLUSIVE is explained as well; it will not be measured again.
        predict: predicts the surface that does not decide, where the recipe has two.

    Returns:
        The record, without the list of the folder's files, and the pictures of the report.
    """
    if made.refused is not None:
        record = make_record(made, job, expected, taken, verdict=Verdict.INVALID, reasons=(made.refused,))
        return record, Pictures(surface=expected.surface)
    if isinstance(expected, PrintExpectation):
        return judge_print(made, job, expected, taken, advance, final=final)
    try:
        views, measured, change = measure_frames(made, job, expected, taken)
        decision = decide(expected, measured, job.ridged, known_good(job))
    except (MeasurementError, CameraError) as error:
        record = make_record(made, job, expected, taken, verdict=Verdict.INVALID, reasons=(str(error),))
        return record, Pictures(raw=as_photographed(taken), surface=expected.surface)
    unfit = resuming_error(change, job.recipe.limits.drift) or drift_complaint(measured, job.ridged)
    explained = not unfit and (final or decision.verdict is not Verdict.INCONCLUSIVE)
    cells = decision.cells
    pictures = Pictures(
        aligned=measured.aligned,
        size_mm=measured.grid.size_mm,
        ratios=cell_log_ratios(measured, expected.poses) if cells is None else cells.ratios,
        deviating=decision.deviating,
        deviation=None if cells is None else deviation_map(cells),
        surface=expected.surface,
    )
    found = results(expected, views, measured, decision)
    if explained:
        found |= insight(job, expected, measured, decision, advance, predict)
    record = make_record(
        made,
        job,
        expected,
        taken,
        verdict=Verdict.INVALID if unfit else decision.verdict,
        reasons=(unfit,) if unfit else decision.reasons,
        **found,
    )
    return record, pictures


def measure_frames(
    made: JobFile, job: Job, expected: Expectation, taken: AcquiredFrames
) -> tuple[list[View], Measured, float]:
    """The pose radiances of an inspection's frames, through all gates.

    Returns:
        The poses as seen, what was measured, and by how much the first pose had changed on resuming.

    Raises:
        MeasurementError, CameraError: INVALID, with the reason.
    """
    job.calibrations.check_valid(datetime.fromisoformat(made.created_at))
    recipe, pixel_um = job.ridged, job.rig.camera.pixel_um
    views = views_of(job.viewing(job.kind.guides), expected.poses, taken)
    grid, _ = region_grid(recipe, pixel_um)
    closing, change = most_changed(
        views, recipe, pixel_um, lambda view: mean_of(resample(view.image.value, view.placement, grid))
    )
    for view in views.poses:
        job.calibrations.check_place(view.stage_deg, view.placement)
    check_views(views.poses, recipe)
    calibrated = job.calibrations.applied_to(recipe)
    measured = measure(views.poses, closing, calibrated, expected, pixel_um)
    job.kind.check_part(views.poses, measured, recipe)
    return views.poses, measured, change
