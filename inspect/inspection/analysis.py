"""What a record tells beside the verdict: causes, both comparisons, the fit over tilts, golden parts, and notes."""

import numpy as np

from anisoscope.base.progress import Advance
from anisoscope.base.significance import log_basis
from anisoscope.decision.decision import Decision
from anisoscope.decision.design_vs_map import Predict, compare
from anisoscope.decision.reference_parts import GoldenSet
from anisoscope.diagnosis.part_diagnosis import explain
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.inspection.job import Job
from anisoscope.prediction.expectation import Expectation, expectation
from anisoscope.record.schema import GoldenRecord, Results


def insight(
    job: Job,
    expected: Expectation,
    measured: Measured,
    decision: Decision,
    advance: Advance,
    predict: Predict = expectation,
) -> Results:
    """Fields of the record that explain a verdict and never change it.

    Args:
        job: recipe, rig and golden parts.
        expected: the prediction that decided.
        measured: the measurement.
        decision: the verdict.
        advance: told what is being explained, where that takes long.
        predict: predicts the surface that does not decide, where the recipe has two.
    """
    recipe = job.ridged
    diagnosis, unexplained = explain(
        recipe, expected, measured, decision, advance, known_good(job), job.kind.causes
    )
    comparisons, reading, lost = compare(recipe, expected, measured, predict)
    shape, unfitted = job.kind.fit_shape(recipe, expected, measured)
    placed, unplaced = job.kind.match_map(recipe, expected, measured)
    lacking = job.golden and job.golden.lacking
    return {
        "diagnosis": diagnosis,
        "comparisons": comparisons,
        "reading": reading,
        "shape": shape,
        "map_place": placed,
        "golden": _golden(known_good(job), measured),
        "notes": tuple(note for note in (lacking, unexplained, lost, unfitted, unplaced) if note),
    }


def known_good(job: Job) -> GoldenSet | None:
    """The golden parts that decide what deviates: None as long as there are too few of them."""
    return job.golden if job.golden is not None and job.golden.lacking is None else None


def _golden(golden: GoldenSet | None, measured: Measured) -> GoldenRecord | None:
    if golden is None:
        return None
    contrasts = golden.contrasts()
    mine = log_basis(len(measured.radiance)) @ np.log(measured.radiance)
    return GoldenRecord(
        parts=len(golden.parts),
        mean=tuple(contrasts.mean(axis=0)),
        contrasts=tuple(tuple(row) for row in contrasts),
        measured=tuple(mine),
    )
