"""The predictive test: its level and power for any number of golden parts, judged by parts of another model."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import chi2, kstest

from anisoscope.base.covariance import root
from anisoscope.base.errors import MeasurementError
from anisoscope.base.significance import log_basis
from anisoscope.decision.consistency import contrast_scatter, from_prediction
from anisoscope.decision.predictive import (
    Direction,
    PredictiveTest,
    Scatter,
    _levels,
    _null_of,
    birge_ratio,
    detectable,
    predictive_test,
    separations,
    suggested_scatter,
)
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import Component, expectation
from anisoscope.prediction.part_scatter import named_defects, part_scatter
from anisoscope.prediction.second_order import Response
from anisoscope.recipe.surface import DefectsPart, DesignPart
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, seating_rotation

M = 3
LINEAR = Scatter(
    Response(("a", "b"), 0.02 * np.random.default_rng(1).normal(size=(M, 2)), np.zeros((M, 2, 2))),
    np.array([1.0, 1.0]),
    np.array([1.0, 0.5]),
    0.005**2 * np.eye(M),
    {"step": np.array([0.03, 0.0, -0.02])},
)
NOISE = 0.003
MEAN = Material(0.06, 0.1, 0.2)
LOBES = {
    "Beckmann": {},
    "Student": {"tail": 0.5},
    "GGX": {"tail": 1.0},
    "two scales": {"second_lobe": (0.15, 2.5)},
}


def recipe(tilts=(0.0, -10.0, 10.0), reflections=2, **material):
    return RidgeRecipe.model_validate(
        {
            "schema": 1,
            "product": "plate",
            "poses": {"angles_deg": [0, 90, 180], "tilts_deg": list(tilts)},
            "acquisition": {"exposure_s": 0.01},
            "region": {"size_mm": [2.0, 2.0]},
            "surface": {
                "pitch_um": 100.0,
                "design": {"ridge_angle_deg": 10.0},
                "reflections": reflections,
            },
            "material": {
                "alpha_along": 0.06,
                "alpha_across": 0.1,
                "albedo": 0.2,
                **({"u_tail": 0.0, "u_alpha_share": 0.1} | material),
            },
            "area": None,
        }
    )


@pytest.fixture(scope="module")
def tilted():
    """Scatter of ridges at nine poses, and the recipe."""
    rules = recipe()
    return contrast_scatter(part_scatter(rules, 10.0), NOISE), rules


def made(count, rules, rng, rig=(0.0, 0.0), turned=0.0, lost=0.0, rougher=1.0, lobe=LOBES["Beckmann"]):
    """(count, P − 1) contrasts of parts of one rig, each from its own exact model: no surrogate, no propagation."""
    basis, poses = log_basis(len(rules.poses.poses())), rules.poses.poses()
    found = []
    for _ in range(count):
        z = rng.normal(size=6)
        material = Material(
            0.06 * (1 + rig[0] + 0.05 * z[0]),
            0.1 * rougher * (1 + rig[1] + 0.05 * z[1]),
            0.2 * (1 + 0.03 * z[2]),
            **lobe,
        )
        seat = seating_rotation(0.1 * z[3], 0.1 * z[4])
        light, camera = (side @ seat for side in directions(poses, Convention(10.0)))
        design = RidgeDesign(100.0, 10.0 + 0.1 * z[5] + turned, height_loss=lost)
        found.append(np.log(corrected.radiance(light, camera, design, material, bounces=2)))
    logs = np.array(found)
    return (logs + NOISE * rng.normal(size=logs.shape)) @ basis.T


def p_values(scatter, rules, rng, count, sets, parts, lobe=LOBES["Beckmann"], **defect):
    found = []
    for _ in range(sets):
        rig = 0.1 * rng.normal(size=2)
        golden = made(count, rules, rng, rig, lobe=lobe)
        found += [
            predictive_test(scatter, golden, value, 0.01).p_value
            for value in made(parts, rules, rng, rig, lobe=lobe, **defect)
        ]
    return np.array(found)


def p_predicted(rules, rng, parts, lobe=LOBES["Beckmann"], off=0.09, without=None, **defect):
    """p values against the prediction, every part of a plastic of its own, roughness off by a tenth."""
    expected, basis = expectation(rules, 10.0), log_basis(len(rules.poses.poses()))
    if without is not None:
        left = tuple(one for one in expected.components if without not in one.source)
        expected = replace(expected, components=left)
    noise = Component("noise", "measurement", np.full(len(expected.radiance), NOISE), shared=False)
    grid = Grid((0.0, 0.0), 0.025, (4, 4))
    found = []
    for _ in range(parts):
        (contrasts,) = made(1, rules, rng, off * rng.normal(size=2), lobe=lobe, **defect)
        logs = np.linalg.pinv(basis) @ contrasts
        part = Measured(np.exp(logs), (noise,), (), np.ones((len(logs), 1, 1)), 0.0 * logs, grid, None)
        found.append(from_prediction(expected, part)[2])
    return np.array(found)


@pytest.mark.parametrize("count", [1, 3])
def test_few_golden_parts_keep_the_level_and_find_lost_height(tilted, count):
    scatter, rules = tilted
    rng = np.random.default_rng(count)
    good = p_values(scatter, rules, rng, count, sets=8, parts=3)
    assert np.mean(good < 0.1) <= 0.34  # 24 parts, those of one set alike: 3.3 standard deviations of .072
    assert np.mean(good < 0.01) <= 0.13  # three parts, where a quarter of one is due
    bad = p_values(scatter, rules, rng, count, sets=2, parts=2, lost=0.1)
    assert np.all(bad < 0.01)


@pytest.mark.statistics
@pytest.mark.parametrize("count", [1, 2, 3, 5, 10, 25])
@pytest.mark.parametrize("tilts", [(0.0,), (0.0, -10.0, 10.0)])
def test_level_and_power_over_many_golden_sets(count, tilts):
    rules = recipe(tilts)
    scatter = contrast_scatter(part_scatter(rules, 10.0), NOISE)
    rng = np.random.default_rng(count)
    good = p_values(scatter, rules, rng, count, sets=60, parts=30)
    # parts of one golden set are alike, most of all of one part: rates have standard deviations up to .006 and .02
    assert np.mean(good < 0.01) <= 0.032
    assert np.mean(good < 0.1) >= 0.02  # .07 to .12
    bad = p_values(scatter, rules, rng, count, sets=20, parts=5, lost=0.1)
    assert np.mean(bad < 0.01) >= 0.97


@pytest.mark.statistics
@pytest.mark.parametrize("lobe", LOBES)
@pytest.mark.parametrize("tilts", [(0.0,), (0.0, -10.0, 10.0)])
def test_good_parts_of_a_plastic_with_an_unmeasured_lobe_keep_the_level(lobe, tilts):
    """Whatever the lobe: against the prediction, and against one golden part and three.

    Parts of one golden set count together: the rate of 30 sets of one part has a standard error of 2 %.
    """
    rules = recipe(tilts, u_tail=None)
    rng = np.random.default_rng(4)
    assert np.mean(p_predicted(rules, rng, 60, LOBES[lobe]) < 0.01) <= 0.05
    scatter = contrast_scatter(part_scatter(rules, 10.0), NOISE)
    for count, most in ((1, 0.07), (3, 0.05)):
        good = p_values(scatter, rules, rng, count, sets=30, parts=15, lobe=LOBES[lobe])
        assert np.mean(good < 0.01) <= most


@pytest.mark.statistics
@pytest.mark.parametrize(("tilts", "mean"), [((0.0,), 0.4), ((0.0, -10.0, 10.0), 0.7)])
def test_p_values_of_good_parts_of_a_known_plastic_are_uniform(tilts, mean):
    """Where reflections are as modelled; what is stated for errors of their model makes p of tilted poses larger."""
    rules = recipe(tilts, u_tail=0.0, u_alpha_share=0.05, u_albedo=0.006, u_index=0.0)
    stated = rules.surface.model_copy(
        update={"design": DesignPart(ridge_angle_deg=10.0, u_ridge_angle_deg=0.1, edge_radius_um=0.0)}
    )
    rig = rules.uncertainty.model_copy(update={"light_angle_deg": 0.0})
    rules = rules.model_copy(update={"surface": stated, "uncertainty": rig})
    found = p_predicted(rules, np.random.default_rng(3), 200, off=0.0, without="of the reflections")
    assert kstest(found, "uniform").pvalue > 0.0027  # three standard deviations
    larger = p_predicted(rules, np.random.default_rng(3), 60, off=0.0)
    assert np.mean(larger) > mean


@pytest.mark.statistics
def test_a_lobe_that_is_said_to_be_known_and_is_not_fails_good_parts():
    rng = np.random.default_rng(4)
    assert np.mean(p_predicted(recipe((0.0,)), rng, 40, LOBES["GGX"]) < 0.01) > 0.5
    unmeasured = recipe((0.0,), u_tail=None)
    assert np.mean(p_predicted(unmeasured, rng, 20, LOBES["GGX"], lost=0.1) < 0.01) > 0.9


@pytest.mark.parametrize("lobe", ["Beckmann", "GGX"])
def test_one_golden_part_serves_where_the_lobe_is_unmeasured(lobe):
    rules = recipe((0.0,), u_tail=None)
    scatter = contrast_scatter(part_scatter(rules, 10.0), NOISE)
    assert len(scatter.lobes) == 3
    rng = np.random.default_rng(1)
    good = p_values(scatter, rules, rng, 1, sets=3, parts=2, lobe=LOBES[lobe])
    assert np.all(good > 0.003)
    bad = p_values(scatter, rules, rng, 1, sets=2, parts=1, lobe=LOBES[lobe], lost=0.2)
    assert np.all(bad < 0.01)


def test_many_golden_parts_of_a_linear_model_give_the_mahalanobis_distance():
    rng = np.random.default_rng(5)
    exact = replace(LINEAR, defects={})
    golden = exact.drawn(np.zeros((1, 2)), 3000, rng)[0]
    value = golden.mean(axis=0) + np.array([0.03, -0.01, 0.02])
    found = predictive_test(exact, golden, value, 0.01)
    slope = exact.response.slope * exact.own
    covariance = slope @ slope.T + exact.errors
    d = np.array([0.03, -0.01, 0.02])
    assert found.t2 == pytest.approx(d @ np.linalg.solve(covariance, d), rel=0.1)
    assert np.log(found.p_value) == pytest.approx(np.log(chi2.sf(found.t2, M)), rel=0.25)
    assert found.p_direction is None


def test_the_direction_of_a_defect_separates_by_its_own_distance():
    rng = np.random.default_rng(2)
    golden = LINEAR.drawn(np.zeros((1, 2)), 200, rng)[0]
    shift = LINEAR.defects["step"]
    found = predictive_test(LINEAR, golden, golden.mean(axis=0) + shift, 0.01)
    (direction,) = found.directions
    assert direction.score == pytest.approx(direction.separation)  # a part with exactly this defect
    assert direction.separation**2 == pytest.approx(found.t2)
    twice = replace(LINEAR, defects={"step": 2.0 * shift})
    (double,) = predictive_test(twice, golden, golden.mean(axis=0), 0.01).directions
    assert double.separation == pytest.approx(2.0 * direction.separation)
    assert double.detectable == pytest.approx(0.5 * direction.detectable)
    assert double.score == pytest.approx(0.0, abs=1e-9)


def test_a_directed_test_finds_small_turns_that_the_distance_alone_misses(tilted):
    scatter, rules = tilted
    rng = np.random.default_rng(8)
    golden = made(6, rules, rng)
    found = [predictive_test(scatter, golden, value, 0.01) for value in made(8, rules, rng, turned=1.0)]
    directed = np.mean([one.p_direction < 0.01 for one in found])
    assert directed > np.mean([one.p_distance < 0.01 for one in found])


def test_a_defect_that_is_found_anyway_leaves_its_level_to_others(tilted):
    scatter, _ = tilted
    levels = _levels(scatter, 3, 3, 0.01)
    shares = dict(zip(scatter.defects, levels.shares, strict=True))
    assert sum(shares.values()) + levels.of_distance == pytest.approx(1.0)
    assert shares["height loss 10%"] == pytest.approx(
        0.7 * 0.2 / len(shares), abs=1e-3
    )  # what all have alike
    assert shares["roughness across the ridges +20%"] > 0.7 * 2.0 / len(shares)
    even = _null_of(scatter, 3, 3).score_limits(0.5 * 0.01 / len(shares) * np.ones(len(shares)))
    found = separations(scatter, 3, 0.01)
    before = ndtr((np.array([one.separation for one in found]) - even) / levels.spreads)
    assert sum(one.power for one in found) > before.sum() + 0.2
    assert all(one.power > old - 0.03 for one, old in zip(found, before, strict=True))


def test_p_values_of_good_parts_of_a_golden_set_are_uniform(tilted):
    """Both tests together, by parts of the stated scatter itself; the level is used up."""
    scatter, _ = tilted
    rng = np.random.default_rng(12)
    parts = scatter.drawn(scatter.shared(60, rng), 3 + 10, rng)
    found = np.array(
        [predictive_test(scatter, one[:3], value, 0.01).p_value for one in parts for value in one[3:]]
    )
    # Of 60 golden sets of ten parts each, parts of one set alike: the statistic is .042 ± .015 (standard deviation)
    assert kstest(found, "uniform").statistic < 0.1
    assert np.mean(found < 0.05) == pytest.approx(0.05, abs=0.036)  # 3 of .012
    assert np.mean(found < 0.01) < 0.032  # 3 of .0057 above .015


def test_the_named_defect_is_the_least_probable_one_not_the_largest_score():
    likely = Direction("likely", 4.0, 0.02, 5.0, 0.9, 0.8)
    rare = replace(likely, defect="rare", score=3.5, p_value=0.002)
    test = PredictiveTest(20.0, 3, 0.002, 0.001, 0.002, (likely, rare), None)
    assert test.strongest is rare
    assert replace(test, p_value=0.0008).strongest is None  # the distance decides


def test_more_golden_parts_show_smaller_defects(tilted):
    scatter, _ = tilted
    one, three, many = (detectable(scatter, count, 0.01, size=0.25) for count in (1, 3, 25))
    assert all(one[name] > three[name] > many[name] for name in one)
    stated, alike = detectable(scatter, 25, 0.01), detectable(scatter, 25, 0.01, batches=1)
    assert all(many[name] < stated[name] < alike[name] for name in one)
    names = {"ridge angle +0.5°", "roughness across the ridges +20%", "height loss 10%", "edges worn to 5 µm"}
    assert set(one) >= names


@pytest.mark.parametrize(("count", "batches"), [(3, 2), (5, 2), (25, 2), (25, 5), (10, 1)])
def test_the_level_holds_for_golden_parts_of_few_batches(count, batches):
    """Half of the variance is between batches, and the part is of another one; one part in a hundred is due."""
    rng, spread = np.random.default_rng(count + batches), root(LINEAR.covariance)
    of = np.arange(count) % batches
    found = []
    for _ in range(250):
        shared, own = (np.sqrt(0.5) * rng.standard_normal((count + 12, M)) for _ in range(2))
        golden = (shared[of] + own[:count]) @ spread
        parts = (shared[batches:][:12] + own[-12:]) @ spread
        found.append([predictive_test(LINEAR, golden, one, 0.01, batches).p_value for one in parts])
    of_sets = np.mean(np.array(found) < 0.01, axis=1)
    u = np.std(of_sets) / np.sqrt(len(of_sets))
    assert of_sets.mean() < 0.02 + 2.0 * u
    assert of_sets.mean() > (0.003 - 2.0 * u if batches > 1 else 0.0)


def test_worn_edges_are_a_direction_of_their_own(tilted):
    """The change by wear is that of the exact model, and its directed test finds it."""
    scatter, rules = tilted
    sides = directions(rules.poses.poses(), Convention(10.0))
    good, worn = (
        np.log(corrected.radiance(*sides, RidgeDesign(100.0, 10.0, edge_radius_um=radius), MEAN, bounces=2))
        for radius in (0.0, 5.0)
    )
    change = log_basis(len(good)) @ (worn - good)
    np.testing.assert_allclose(scatter.defects["edges worn to 5 µm"], change, atol=2e-3)
    rng = np.random.default_rng(6)
    golden = made(5, rules, rng)
    found = predictive_test(scatter, golden, golden.mean(axis=0) + change, 0.01)
    assert found.strongest.defect == "edges worn to 5 µm"
    small = recipe().model_copy(update={"defects": DefectsPart(wear_um=None)})
    assert not any("worn" in one.name for one in named_defects(small))


def test_scatter_between_golden_parts_is_estimated():
    rng = np.random.default_rng(3)
    wider = replace(LINEAR, own=LINEAR.own * np.array([3.0, 1.0]))
    golden = wider.drawn(np.zeros((1, 2)), 60, rng)[0]
    first, _second = suggested_scatter(LINEAR, golden)
    assert first.low < 3.0 < first.high
    assert birge_ratio(golden, LINEAR.covariance) > 3.0
    assert birge_ratio(LINEAR.drawn(np.zeros((1, 2)), 60, rng)[0], LINEAR.covariance) == pytest.approx(
        1.0, abs=0.3
    )
    with pytest.raises(MeasurementError, match="at least 3"):
        suggested_scatter(LINEAR, golden[:2])


def test_nothing_to_compare_with_is_one_clear_line():
    with pytest.raises(MeasurementError, match="no golden part"):
        predictive_test(LINEAR, np.empty((0, M)), np.zeros(M), 0.01)
    exact = replace(LINEAR, errors=np.zeros((M, M)))
    with pytest.raises(MeasurementError, match="without any uncertainty or scatter"):
        predictive_test(exact, np.zeros((1, M)), np.zeros(M), 0.01)


@pytest.mark.parametrize(
    ("count", "t2", "p_value", "score", "detectable"),
    [
        (1, 11.953549276558588, 3.842049694876e-4, 3.4441295212842262, 0.7535573305629669),
        (3, 25.103951199837272, 3.603699965635e-6, 4.9313408801821925, 0.6278333248109451),
        (10, 29.586962172556298, 1.602515414180e-6, 5.3862183139992705, 0.5557746529677825),
    ],
)
def test_a_stated_scatter_worth_30_parts_decides_as_the_version_that_had_it(
    count, t2, p_value, score, detectable
):
    """Numbers of that version, by which records of it are computed again."""
    golden = 0.005 * np.random.default_rng(count).normal(size=(count, M))
    part = np.array([0.02, 0.01, -0.015])
    found = predictive_test(replace(LINEAR, prior_parts=30), golden, part, 0.01)
    of_defect = found.directions[0]
    assert found.t2 == pytest.approx(t2, rel=1e-9)
    assert found.p_value == pytest.approx(p_value, rel=1e-9)
    assert (of_defect.score, of_defect.detectable) == pytest.approx((score, detectable), rel=1e-9)
    covariance = (30.0 * LINEAR.covariance + (count - 1.0) * np.cov(golden.T, ddof=1)) if count > 1 else None
    if covariance is not None:
        off = part - golden.mean(axis=0)
        whole = covariance / (29.0 + count) * (1.0 + 1.0 / count)
        assert found.t2 == pytest.approx(off @ np.linalg.solve(whole, off), rel=1e-9)
