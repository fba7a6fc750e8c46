"""What a record tells beside the verdict: causes, both comparisons, the fit over tilts, golden parts, and notes."""

from typing import Any

import numpy as np

from anisoscope.comparing import Predict, compare
from anisoscope.decision import Decision
from anisoscope.expectation import Expectation, expectation
from anisoscope.explaining import explain
from anisoscope.golden import GoldenSet
from anisoscope.job import Job
from anisoscope.mapmatching import match_map
from anisoscope.measurement import Measured
from anisoscope.progress import Advance
from anisoscope.record import GoldenRecord
from anisoscope.shapefit import fit_shape
from anisoscope.significance import log_basis


def insight(
    job: Job,
    expected: Expectation,
    measured: Measured,
    decision: Decision,
    advance: Advance,
    predict: Predict = expectation,
) -> dict[str, Any]:
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
    diagnosis, unexplained = explain(recipe, expected, measured, decision, advance, known_good(job))
    comparisons, reading, lost = compare(recipe, expected, measured, predict)
    shape, unfitted = fit_shape(recipe, expected, measured)
    placed, unplaced = match_map(recipe, expected, measured)
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
        mean=tuple(float(value) for value in contrasts.mean(axis=0)),
        contrasts=tuple(tuple(float(value) for value in row) for row in contrasts),
        measured=tuple(float(value) for value in mine),
    )
