"""Doubts counted on parts, and the intervals that rest on them, against parts that are drawn with known doubts."""

import numpy as np
import pytest

from anisoscope.diagnosis.causes import Cause
from anisoscope.diagnosis.evidence import Evidence, background_of
from anisoscope.diagnosis.signatures import Signature, Signatures
from anisoscope.study.detection import evaluation as detection_evaluation
from anisoscope.study.detection.evaluation import (
    Doubt,
    Part,
    background_of_good,
    doubt_of,
    doubting,
    holds,
    intervals_held,
)
from anisoscope.study.detection.product import Size

DIRECTION = np.array([1.0, 0.4, -0.6, 0.2, 0.0])
EXTENTS = np.linspace(0.0, 2.0, 9)
COVARIANCE = 0.02**2 * np.eye(5) + 0.05**2
TRUE = Doubt(change=0.1, share=0.15, background=0.01, u_background=0.002)
U_SHARE = 0.001


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.fixture(scope="module")
def marks():
    """A defect that changes ln L and the share of deviating cells, both as its extent, as real ones are doubted."""
    cause = Cause(
        "marks", "marks", "", "area", "", tuple(EXTENTS), lambda surface, state, _: (surface, state), 0.3
    )
    return Signature(cause, EXTENTS, EXTENTS[:, None] * DIRECTION, 0.05 * EXTENTS)


def drawn(marks, count, rng, doubt=TRUE):
    """Parts whose changes and shares scatter about what the signature says."""
    parts = []
    root = np.linalg.cholesky(COVARIANCE)
    for truth in 1.0 + 0.1 * rng.standard_normal(count):
        change, share = marks.at(truth)
        shown = change * (1.0 + doubt.change * rng.standard_normal(5)) + root @ rng.standard_normal(5)
        cells = doubt.background + doubt.u_background * rng.standard_normal()
        cells += share * (1.0 + doubt.share * rng.standard_normal()) + U_SHARE * rng.standard_normal()
        seen = Evidence(shown, COVARIANCE, float(cells), U_SHARE, *background_of(0.03))
        parts.append(Part(seen, float(truth)))
    return parts


def test_doubts_are_found_from_the_parts(marks, rng):
    found = doubt_of(marks, drawn(marks, 250, rng), TRUE.background, TRUE.u_background)
    assert found.change == pytest.approx(TRUE.change, rel=0.15)
    assert found.share == pytest.approx(TRUE.share, rel=0.15)


def test_parts_that_are_as_the_signature_says_leave_next_to_no_doubt(marks, rng):
    sure = Doubt(0.0, 0.0, TRUE.background, TRUE.u_background)
    found = doubt_of(marks, drawn(marks, 250, rng, sure), TRUE.background, TRUE.u_background)
    assert max(found.change, found.share) < 0.03


def test_with_the_doubts_that_there_are_intervals_hold_the_truth_as_often_as_they_say(marks, rng):
    """With those of real parts they hold it nearly always, with none too rarely."""
    parts = drawn(marks, 300, rng)

    def held(doubt):
        return np.mean([holds(*doubting(marks, part, doubt)) for part in parts])

    assert 0.92 <= held(TRUE) <= 0.98
    assert np.mean([holds(marks, part) for part in parts]) > 0.985
    assert held(Doubt(0.0, 0.0, TRUE.background, 0.0)) < 0.6


def test_the_background_is_what_good_parts_show_beyond_what_is_measured_badly(rng):
    share = 0.01 + np.hypot(0.002, 0.001) * rng.standard_normal(4000)
    good = {"tilted/share": share, "tilted/u_share": np.full(4000, 0.001)}
    halves = [background_of_good(good, "tilted", first) for first in (0, 1)]
    assert halves[0] != halves[1]
    for mean, spread in halves:
        assert (mean, spread) == pytest.approx((0.01, 0.002), rel=0.1)
    good["tilted/u_share"] = np.full(4000, 0.005)
    assert background_of_good(good, "tilted", 0)[1] == 0.0


def test_a_cause_that_was_not_looked_for_has_no_intervals(monkeypatch):
    nothing = Signatures((), np.zeros(3), 0.0, (), ())
    monkeypatch.setattr(detection_evaluation, "signatures_of", lambda *_, **__: nothing)
    seen = {"burrs": {"extent": np.zeros(4)}, "good": {}}
    assert intervals_held("burrs", seen, "standard", Size()) is None
