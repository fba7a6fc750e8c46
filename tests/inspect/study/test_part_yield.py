"""Yield of a lot: rates, risks and contrasts from the verdicts of its parts."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.parameters.workers import Workers
from anisoscope.quality.detection_probability import hit_miss
from anisoscope.study import part_yield as yields
from anisoscope.study.lot import Judged, Lot, Shift, Spread
from anisoscope.study.part_yield import detection_trials, part_yield

LIGHT_DEG = 10.0
TABLE = {
    "schema": 1,
    "product": "plate",
    "acquisition": {"exposure_s": 0.01},
    "region": {"size_mm": [2.0, 2.0]},
    "surface": {"pitch_um": 100.0, "design": {"ridge_angle_deg": 10.0, "edge_radius_um": 0.0}},
    "material": {"alpha_along": 0.06, "alpha_across": 0.1, "albedo": 0.2, "u_tail": 0.0},
    "poses": {"angles_deg": [0, 90, 180], "tilts_deg": [0, 10]},
}


def recipe(**tables):
    return RidgeRecipe.model_validate(TABLE | tables)


def test_rates_and_risks_are_counted(monkeypatch):
    """Of each rig 3 PASS, 1 INCONCLUSIVE, 2 FAIL; the true contrasts of the first, the fourth and the last are off."""
    true = np.array([[0.5, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, -0.5], [0, 0, 0, 0], [9, 9, 9, 9]])
    one = Judged(
        np.array([0, 0, 0, 1, 2, 2]),
        np.array([False, False, False, False, False, True]),
        np.array([[0.1] * 4, [0.3] * 4] * 3),
        true,
        np.full((6, 4), 0.05),
    )
    monkeypatch.setattr(yields, "sweep", lambda *_, **__: [one, one])
    judged = recipe(decision={"tolerance": 0.3})
    found = part_yield(Lot(judged, LIGHT_DEG, Spread(), parts=12, rigs=2), Workers())
    assert {name: (rate.count, rate.of) for name, rate in found.verdicts.items()} == {
        "PASS": (6, 12),
        "INCONCLUSIVE": (2, 12),
        "FAIL": (4, 12),
    }
    assert (found.conforming.count, found.conforming.of) == (6, 12)
    assert (found.producer_risk.count, found.producer_risk.of) == (2, 6)
    assert (found.consumer_risk.count, found.consumer_risk.of) == (2, 6)
    assert found.significant.count == 2
    first = found.contrasts[0]
    assert (first.from_deg, first.to_deg, first.tilt_deg, first.tolerance) == (0.0, 90.0, 0.0, 0.3)
    assert first.mean - first.predicted == pytest.approx(0.2)
    assert first.u == pytest.approx(0.05)
    assert first.outside.count == 4


def test_without_tolerances_there_are_no_risks():
    lot = Lot(recipe(), LIGHT_DEG, Spread(ridge_angle=0.1), parts=4, rigs=2)
    found = part_yield(lot, Workers(), seed=4)
    assert found == part_yield(lot, Workers(), seed=4)
    assert found.conforming is found.producer_risk is found.consumer_risk is None
    assert sum(rate.count for rate in found.verdicts.values()) == 4
    assert found.contrasts[0].outside is None


@pytest.mark.statistics
@pytest.mark.parametrize(("golden", "least", "most"), [(0, 0.03, 0.07), (3, 0.005, 0.06)])
def test_good_parts_are_significant_as_often_as_the_level_says(golden, least, most):
    """Against golden parts less often: distance and directions share the level by Bonferroni's bound."""
    one = recipe(decision={"alpha": 0.05})
    lot = Lot(one, LIGHT_DEG, Spread.of(one), parts=2000, rigs=400, golden=golden)
    found = part_yield(lot, Workers(None))
    assert least < found.significant.value < most


def test_larger_defects_are_found_and_small_ones_are_not():
    """Against the prediction, without a search of the range: sizes, their number, and good parts."""
    lot = Lot(recipe(), LIGHT_DEG, Spread(), parts=40, rigs=2)
    found = detection_trials(lot, "height_loss", 0.1, Workers(), seed=3)
    assert (len(found.size), np.count_nonzero(found.size == 0.0)) == (50, 10)
    assert found.size.max() == pytest.approx(0.1)
    assert not found.hit[found.size < 0.008].any()
    assert found.hit[found.size > 0.08].all()


@pytest.mark.parametrize(
    ("defect", "largest", "word"),
    [("scratches", None, "show in the picture only"), ("alpha", -1.0, "largest size must be")],
)
def test_a_defect_that_is_not_simulated_is_refused(defect, largest, word):
    with pytest.raises(UsageError, match=word):
        detection_trials(Lot(recipe(), LIGHT_DEG, Spread(), parts=40, rigs=2), defect, largest, Workers())


@pytest.mark.parametrize(
    "count",
    [pytest.param(2000, marks=pytest.mark.statistics), pytest.param(20_000, marks=pytest.mark.soak)],
)
def test_a90_is_found_in_nine_of_ten_of_many_parts(count):
    """The curve of 400 parts against a count of many at its a50 and a90; three golden parts on every rig."""
    one = recipe()
    lot = Lot(one, LIGHT_DEG, Spread.of(one), parts=400, rigs=2, golden=3)
    curve = hit_miss(detection_trials(lot, "height_loss", None, Workers(None)))
    for limit in curve.sizes:
        many = replace(lot, shift=Shift(height_loss=limit.size), parts=count, rigs=count)
        share = part_yield(many, Workers(None), seed=99).verdicts["FAIL"].value
        print(f"{limit.size:.4f}: {limit.probability:.0%} by the curve, {share:.1%} of {count}")  # noqa: T201
        assert share == pytest.approx(limit.probability, abs=0.1)
