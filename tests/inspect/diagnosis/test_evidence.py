"""What golden parts teach a diagnosis: its covariance, its chances, and how far signatures can be believed."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.covariance import root
from anisoscope.diagnosis.causes import Cause
from anisoscope.diagnosis.evidence import (
    SHARE_FLOOR,
    Evidence,
    Inputs,
    against,
    background_of_parts,
)
from anisoscope.diagnosis.likelihood import fit_extent
from anisoscope.diagnosis.ranking import BELIEVABLE, NOTHING, OTHER, diagnose
from anisoscope.diagnosis.signatures import Signature, Signatures
from anisoscope.parameters.geometry import Pose
from anisoscope.prediction.second_order import Response
from anisoscope.profiles.defect_injection import DEFECTS

POSES = tuple(Pose(45.0 * k) for k in range(6))
P = len(POSES)
SCALE = 0.02


def spread(rng, size):
    """A covariance of full rank with a few large directions."""
    shared = size * rng.normal(size=(P, 2))
    return shared @ shared.T + (0.1 * size) ** 2 * np.eye(P)


def line(slope):
    cause = Cause("a", "a", "", "shape", "", (-1.0, 0.0, 1.0), lambda surface, state, _: (surface, state))
    extents = np.linspace(-1.0, 1.0, 5)
    return Signature(cause, extents, np.outer(extents, slope), np.zeros(5))


def known(*found):
    return Signatures(POSES, np.full(P, 0.05), 0.0, found, ())


def test_budget_and_golden_parts_are_weighed_by_how_many_they_are():
    rng = np.random.default_rng(1)
    stated = spread(rng, 0.05)
    for count in (P, 200):
        golden = 0.03 * rng.normal(size=(count, P))
        found = against(Evidence(np.zeros(P), stated), golden, SCALE)
        scatter = np.cov(golden, rowvar=False) + SCALE**2
        wanted = (P * stated + (count - 1) * scatter) / (P + count - 1) * (1.0 + 1.0 / count)
        np.testing.assert_allclose(found.good, wanted, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(found.deviation, -golden.mean(axis=0))


def test_where_golden_parts_scatter_as_stated_a_cause_keeps_its_own_covariance():
    """What changes the stated covariance at an extent changes the learnt one alike."""
    rng = np.random.default_rng(2)
    parts, there = spread(rng, 0.05), spread(rng, 0.08)
    golden = rng.normal(size=(4000, P)) @ root(parts)
    found = against(Evidence(np.zeros(P), parts + 0.01**2), golden, 0.01)
    np.testing.assert_allclose(found.learnt.applied(there), there, atol=0.12 * np.abs(there).max())


def test_good_parts_are_explained_by_nothing_as_often_as_the_level_says():
    """Parts that scatter five times as stated: the budget alone calls most of them unexplained."""
    rng = np.random.default_rng(3)
    stated, true = spread(rng, 0.01), spread(rng, 0.05)
    half, offset = root(true), 0.3 * rng.normal(size=P)
    slope = 0.1 * rng.normal(size=P)
    low = {"golden": 0, "budget": 0}
    for _ in range(150):
        golden = offset + rng.normal(size=(15, P)) @ half
        part = Evidence(offset + half @ rng.normal(size=P), stated)
        low["golden"] += diagnose(known(), against(part, golden, 0.0)).unexplained_p < 0.1
        low["budget"] += diagnose(known(line(slope)), part).unexplained_p < 0.1
    assert 0.01 <= low["golden"] / 150 <= 0.25
    assert low["budget"] / 150 > 0.9


def test_an_error_of_the_model_is_no_cause_against_golden_parts():
    rng = np.random.default_rng(4)
    stated, slope = spread(rng, 0.02), 0.3 * rng.normal(size=P)
    model_error = np.array([0.3, -0.2, 0.0, 0.1, 0.0, 0.25])
    golden = model_error + rng.normal(size=(20, P)) @ root(stated)
    real = Evidence(model_error + 0.6 * slope, stated)
    assert diagnose(known(line(slope)), real).unexplained_p < 1e-6
    told = diagnose(known(line(slope)), against(real, golden, SCALE))
    assert told.causes[0].cause == "a"
    assert told.unexplained_p > 0.05
    assert abs(told.causes[0].severity - 0.6) < 3.0 * told.causes[0].u
    fine = diagnose(known(line(slope)), against(Evidence(golden.mean(axis=0), stated), golden, SCALE))
    assert fine.causes[0].cause == NOTHING


def test_changes_are_believed_as_far_as_the_model_fits_good_parts():
    rng = np.random.default_rng(5)
    stated, slope = 1e-4 * np.eye(P), np.full(P, 0.5)
    for error in (0.0, 0.3):
        golden = error * np.array([1.0, -1.0, 0.0, 0.0, 0.0, 0.0]) + 0.01 * rng.normal(size=(50, P))
        found = against(Evidence(slope, stated), golden, 0.0)
        average = error / np.sqrt(3.0)
        np.testing.assert_allclose(found.learnt.misfit[:2], np.hypot(error, average), atol=0.01)
        np.testing.assert_allclose(found.learnt.misfit[2:], average, atol=0.01)
        if error == 0.0:
            sure = fit_extent(line(slope), found).u
    assert fit_extent(line(slope), found).u > 1.05 * sure


def test_a_scale_is_not_taken_for_misfit():
    golden = 0.4 + 0.01 * np.random.default_rng(6).normal(size=(20, P))
    found = against(Evidence(np.zeros(P), 1e-4 * np.eye(P)), golden, SCALE)
    assert found.learnt.misfit.max() < 0.02


def test_a_position_far_beyond_its_stated_uncertainty_ranks_behind_a_defect_that_explains_as_well():
    rng = np.random.default_rng(11)
    slope, stated = 0.3 * rng.normal(size=P), 0.01**2 * np.eye(P)
    defect = line(slope)
    seat = replace(
        defect, cause=replace(defect.cause, name="seat", group="rig", sources=("seating tilt about x",))
    )
    response = Response(("seating tilt about x",), 0.01 * slope[:, None], np.zeros((P, 1, 1)))
    inputs = Inputs(response, {"seating tilt about x": 0.01}, stated, np.ones(1))
    part = Evidence(0.5 * slope, stated, inputs=inputs)  # 50 standard uncertainties of the seat
    found = diagnose(known(seat, defect), part)
    assert [one.cause for one in found.causes[:2]] == ["a", "seat"]
    assert {one.cause for one in found.ties} == {"a", "seat"}  # the poses cannot tell them apart
    assert found.causes[0].weight > 0.95
    near = diagnose(known(seat, defect), replace(part, deviation=0.01 * slope))
    weights = {one.cause: one.weight for one in near.causes}
    assert weights["seat"] == pytest.approx(weights["a"], rel=1.5)


def test_where_no_cause_explains_the_part_none_has_a_large_weight():
    rng = np.random.default_rng(12)
    slope, stated = 0.3 * rng.normal(size=P), 0.01**2 * np.eye(P)
    explained = diagnose(known(line(slope)), Evidence(0.5 * slope, stated))
    weights = {one.cause: one.weight for one in explained.causes}
    assert 0.0 < weights[OTHER] < 0.01
    strange = diagnose(known(line(slope)), Evidence(0.5 * slope + 0.2 * rng.normal(size=P), stated))
    weights = {one.cause: one.weight for one in strange.causes}
    assert weights[OTHER] > 0.99
    assert strange.unexplained_p < 1e-6
    assert sum(weights.values()) == pytest.approx(1.0)


def named(name, slope, **more):
    one = line(slope)
    return replace(one, cause=replace(one.cause, name=name, title=name, **more))


def weights_of(found):
    return {one.cause: one.weight for one in found.causes}


def test_causes_have_no_larger_weight_than_what_the_best_leaves_permits():
    """A part 3 % off the best cause, and far from good: the cause is first, and none of them is believed."""
    rng = np.random.default_rng(13)
    slope, stated = 0.3 * rng.normal(size=P), 0.01**2 * np.eye(P)
    found = diagnose(known(line(slope)), Evidence(0.5 * slope + 0.03 * rng.normal(size=P), stated))
    assert found.causes[0].cause == "a"
    assert found.unexplained_p < BELIEVABLE
    assert 1.0 - weights_of(found)[OTHER] == pytest.approx(found.unexplained_p / BELIEVABLE)


@pytest.mark.parametrize("golden", [False, True])
def test_two_causes_are_named_together_where_one_does_not_explain(golden):
    rng = np.random.default_rng(14)
    slopes, stated = 0.3 * rng.normal(size=(4, P)), 0.01**2 * np.eye(P)
    causes = [named(name, slope) for name, slope in zip("abcd", slopes, strict=True)]
    part = Evidence(0.5 * slopes[1] - 0.4 * slopes[3] + 0.01 * rng.normal(size=P), stated)
    if golden:
        part = against(part, 0.01 * rng.normal(size=(8, P)), 0.0)
    found = diagnose(known(*causes), part)
    best = found.causes[0]
    assert best.cause in {"b+d", "d+b"}
    assert found.unexplained_p > BELIEVABLE
    sizes = {one.cause: one for one in best.components}
    for name, truth in (("b", 0.5), ("d", -0.4)):
        assert abs(sizes[name].severity - truth) < 4.0 * sizes[name].u
        low, high = sizes[name].interval
        assert low < truth < high
        assert (high - low) / (4.0 * sizes[name].u) == pytest.approx(1.0, abs=0.2)
    assert sum(weights_of(found).values()) == pytest.approx(1.0)


def test_one_cause_that_explains_is_not_joined_by_another():
    rng = np.random.default_rng(15)
    slopes, stated = 0.3 * rng.normal(size=(3, P)), 0.01**2 * np.eye(P)
    causes = [named(name, slope) for name, slope in zip("abc", slopes, strict=True)]
    found = diagnose(known(*causes), Evidence(0.5 * slopes[0] + 0.01 * rng.normal(size=P), stated))
    assert found.causes[0].cause == "a"
    assert not any(one.components for one in found.causes)


def test_cells_that_deviate_on_a_guessed_texture_are_no_reason_against_a_cause():
    """Crests that were not filled are rough: a tenth of the cells deviates, which smooth ones would not explain."""
    rng = np.random.default_rng(16)
    slope, other, stated = 0.3 * rng.normal(size=P), 0.3 * rng.normal(size=P), 0.01**2 * np.eye(P)
    marks = replace(named("marks", other), share=np.array([0.3, 0.15, 0.0, 0.15, 0.3]))
    part = Evidence(0.5 * slope, stated, 0.1, 0.002, 0.005, 0.004)
    for guessed in (0.0, 1.0):
        found = diagnose(known(named("caps", slope, guessed=guessed), marks), part)
        best = next(one for one in found.causes if one.cause == "caps")
        if guessed:
            assert found.causes[0] is best
            assert found.unexplained_p > 0.05
        else:
            assert best.chi2 > 100.0
    quiet = replace(part, share=0.004)
    one, other = (diagnose(known(named("caps", slope, guessed=g)), quiet).causes[0].chi2 for g in (0.0, 1.0))
    assert other == pytest.approx(one, abs=0.1)


def test_the_pitch_in_the_pictures_decides_about_a_wrong_pitch():
    rng = np.random.default_rng(17)
    slope, stated = 0.3 * rng.normal(size=P), 0.01**2 * np.eye(P)
    causes = known(named("pitch", slope, defect=DEFECTS["pitch"]), named("b", slope))
    part = Evidence(0.5 * slope, stated)
    assert {one.cause for one in diagnose(causes, part).ties} == {"pitch", "b"}
    agreeing = diagnose(causes, replace(part, pitch=(0.01, 0.02)))
    assert [one.cause for one in agreeing.ties] == ["b"]
    wrong = diagnose(causes, replace(part, pitch=(0.49, 0.02)))
    assert [one.cause for one in wrong.ties] == ["pitch"]
    assert wrong.causes[0].u < 0.02


def test_the_background_of_marks_is_that_of_the_golden_parts_as_far_as_they_show_it(rng):
    mean, u = background_of_parts([0.01])
    assert (mean, u) == (0.01, pytest.approx(np.sqrt(2.0) * SHARE_FLOOR))
    many = 0.01 + 0.001 * rng.standard_normal(4000)
    mean, u = background_of_parts(many)
    assert (mean, u) == (pytest.approx(0.01, abs=1e-4), pytest.approx(0.001, rel=0.05))
