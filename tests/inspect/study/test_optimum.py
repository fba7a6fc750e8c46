"""The search finds the highest top, whatever the landscape, and says how flat it is."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.parameters.workers import Workers
from anisoscope.study import box
from anisoscope.study import optimum as search
from anisoscope.study.box import Box, TabledScoring, tabled
from anisoscope.study.objective import Part, Scored, Scoring, Tolerances, score
from anisoscope.study.optimum import optimum


def test_one_parameter_against_brute_force():
    scoring = Scoring(pairs_deg=((0.0, 90.0), (90.0, 180.0)), tilts_deg=(-10.0, 0.0, 10.0), bounces=1)
    found = optimum(Part(), {"ridge_angle": (2.0, 25.0)}, scoring, Workers())

    def scores(angles):
        return [score(Part(ridge_angle=float(angle)), scoring).score for angle in angles]

    angles = np.linspace(2.0, 25.0, 93)
    top = angles[int(np.argmax(scores(angles)))]
    angles = np.clip(np.linspace(top - 0.5, top + 0.5, 21), 2.0, 25.0)
    brute = scores(angles)
    assert found.part.ridge_angle == pytest.approx(angles[int(np.argmax(brute))], abs=0.03)
    assert found.scored.score >= max(brute) * (1.0 - 1e-9)


def test_kept_interval_is_where_one_percent_is_lost():
    found = optimum(Part(), {"ridge_angle": (2.0, 25.0)}, Scoring(bounces=1), Workers())
    low, high = found.slices[0].kept
    for end in (low, high):
        assert score(Part(ridge_angle=end), Scoring(bounces=1)).score == pytest.approx(
            0.99 * found.scored.score, rel=3e-3
        )


def test_two_parameters_against_a_fine_grid_of_the_worst_contrast():
    scoring = Scoring("log_ratio", tilts_deg=(-10.0, 0.0, 10.0), over="worst", bounces=1)
    bounds = {"ridge_angle": (3.0, 20.0), "alpha_across": (0.05, 0.2)}
    found = optimum(Part(), bounds, scoring, Workers())
    fine = [
        score(Part(ridge_angle=float(a), alpha_across=float(b)), scoring).score
        for a in np.linspace(3.0, 20.0, 14)
        for b in np.geomspace(0.05, 0.2, 14)
    ]
    assert found.scored.score >= max(fine) * (1.0 - 1e-6)


def synthetic(parts, scoring):
    return np.array([hills(part, scoring).score for part in parts])


def hills(part, scoring):
    """A high narrow hill beside a broad low one, and a parameter that hardly matters."""
    narrow = np.exp(-(((part.ridge_angle - 17.3) / 0.6) ** 2))
    broad = 0.9 * np.exp(-(((part.ridge_angle - 7.0) / 4.0) ** 2))
    value = max(narrow, broad) * (1.0 + 1e-4 * np.log(part.alpha_across))
    return Scored(float(value), float(value), 0.0)


def test_a_narrow_higher_hill_is_not_missed(monkeypatch):
    monkeypatch.setattr(box, "scores", synthetic)
    monkeypatch.setattr(search, "score", hills)
    bounds = {"ridge_angle": (2.0, 25.0), "alpha_across": (0.05, 0.2)}
    found = optimum(Part(), bounds, Scoring(bounces=1), Workers())
    assert found.part.ridge_angle == pytest.approx(17.3, abs=1e-2)
    angle, roughness = found.slices
    assert not angle.flat
    assert angle.at_bound is None
    assert roughness.flat
    # 1 % of a Gaussian hill of width w is lost at w·√(−ln 0.99)
    assert np.subtract(*angle.kept[::-1]) == pytest.approx(2 * 0.6 * np.sqrt(-np.log(0.99)), rel=0.05)


def test_a_bound_is_called_one():
    found = optimum(Part(), {"ridge_angle": (8.0, 20.0)}, Scoring(bounces=1), Workers())
    assert found.part.ridge_angle == pytest.approx(8.0)
    assert found.slices[0].at_bound == "lower"


def test_parts_that_cannot_be_made_are_left_out():
    bounds = {"ridge_angle": (3.0, 20.0), "pitch": (5.0, 200.0)}
    found = optimum(Part(edge_radius=20.0), bounds, Scoring(bounces=1), Workers())
    assert np.isnan(found.landscape.scores).any()
    assert found.part.pitch == pytest.approx(200.0)
    with pytest.raises(UsageError, match="no part within these bounds can be made"):
        optimum(
            Part(edge_radius=400.0),
            {"ridge_angle": (15.0, 20.0), "pitch": (5.0, 10.0)},
            Scoring(bounces=1),
            Workers(),
        )


def test_robust_search_repeats_and_does_not_depend_on_who_computes():
    scoring = Scoring(tolerances=Tolerances(ridge_angle=0.5, seating=0.5), samples=8, bounces=1)
    bounds = {"ridge_angle": (3.0, 12.0)}
    one, two = (optimum(Part(), bounds, scoring, workers) for workers in (Workers(), Workers(2)))
    assert one.part == two.part
    # the albedo of a lobe comes from arrays or from the compiled kernel: equal to 1e-11
    for mine, other in zip(one.slices, two.slices, strict=True):
        assert (mine.name, mine.values) == (other.name, other.values)
        assert mine.scores == pytest.approx(other.scores, rel=1e-9)
    assert one.slices[0].sampling_sd > 0.0
    assert one.scored.score < one.nominal.score


@pytest.mark.soak
def test_more_spread_moves_the_robust_optimum_to_a_flatter_place():
    """At log-ratio contrast the steep flank at small angles is punished by an error of the angle."""
    bounds = {"ridge_angle": (3.0, 20.0)}
    nominal = optimum(Part(), bounds, Scoring(bounces=1), Workers())
    robust = optimum(
        Part(), bounds, Scoring(tolerances=Tolerances(ridge_angle=2.0), samples=16, bounces=1), Workers()
    )
    again = score(nominal.part, Scoring(tolerances=Tolerances(ridge_angle=2.0), samples=16, bounces=1))
    assert robust.scored.score > again.score


@pytest.mark.parametrize(
    ("bounds", "match"),
    [
        ({}, "nothing to vary"),
        ({"colour": (0.0, 1.0)}, "cannot be varied"),
        ({"ridge_angle": (20.0, 5.0)}, "must rise"),
        ({"ridge_angle": (5.0, 60.0)}, "must rise, within"),
        ({"pitch": (20.0, 200.0)}, "no effect on ideal ridges"),
        ({"alpha_along": (float("nan"), 0.2)}, "must rise"),
    ],
)
def test_senseless_bounds_are_refused(bounds, match):
    with pytest.raises(UsageError, match=match):
        optimum(Part(), bounds, Scoring(bounces=1), Workers())


def test_light_that_reflects_often_comes_from_a_table_while_searching():
    asked, box_of_angles = Scoring(bounces="all"), Box(Part(), ("ridge_angle",), (3.0,), (20.0,))
    searched = tabled(box_of_angles, asked)
    assert isinstance(searched, TabledScoring)
    assert searched.table.shape == (6, 2)
    for angle in (3.0, 7.3, 20.0):
        part = Part(ridge_angle=angle)
        exact, twice = (score(part, one).score for one in (asked, Scoring(bounces=2)))
        found = score(part, searched).score
        assert found == pytest.approx(exact, rel=5e-4)
        assert abs(found - exact) < 0.4 * abs(
            twice - exact
        )  # the table holds nearly all of what two leave out
    assert tabled(box_of_angles, Scoring(bounces=2)) == Scoring(bounces=2)


def test_where_parts_of_the_box_cannot_be_made_there_is_no_table():
    asked = Scoring(bounces=3)
    searched = tabled(Box(Part(edge_radius=30.0), ("pitch",), (2.0,), (400.0,)), asked)
    assert searched.table is None
    part = Part(edge_radius=30.0, pitch=400.0)
    assert score(part, searched) == score(part, asked)
