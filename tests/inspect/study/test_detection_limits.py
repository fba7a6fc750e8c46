"""What limits the detection study: model errors in the budget of predictions, and defects that are not known before."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from anisoscope.base.covariance import root
from anisoscope.base.significance import log_basis
from anisoscope.decision.consistency import contrast_scatter
from anisoscope.decision.predictive import _levels, _null_of, predictive_test, separations
from anisoscope.prediction.expectation import expectation
from anisoscope.prediction.part_scatter import part_scatter
from detection_study.chunk import FRAME_NOISE, LAMP_NOISE, MEASURED_SOURCES
from detection_study.judge import calibration_of, covariance_of_measurement, from_prediction
from detection_study.product import LIGHT_DEG, Size, recipe_of
from detection_study.statistics import area_under_curve, ideal_scores, uniformity

pytestmark = pytest.mark.statistics

MODEL = ("model of the reflections", "amplitude of the reflections", "family of the lobe")
PARTS, GOLDEN, SETS = 3000, 25, 100
ROUGHNESS = "roughness across the ridges"
STATES = {
    "ridge angle +0.5°": ("ridge angle of the design", 5.0),
    "ridge angle −0.5°": ("ridge angle of the design", -5.0),
    f"{ROUGHNESS} +20%": (ROUGHNESS, 4.0),
}
"""Defects as states of an input, in its scatter between good parts."""


def judged(name):
    """Recipe of the calibrated plastic, its prediction, and the components of one measurement, (S, P)."""
    recipe = recipe_of(name, Size(), calibration_of("same", 1).file)
    expected, rig = expectation(recipe, LIGHT_DEG), recipe.uncertainty
    own = np.zeros((len(MEASURED_SOURCES), len(expected.poses)))
    for source, u in {
        "noise of camera and photons": FRAME_NOISE,
        "flicker of the lamp": LAMP_NOISE,
        "flat field": rig.flat_share,
        "linearity of the camera": rig.linearity_share,
        "stray light": rig.stray_radiance / expected.radiance,
        "stage angle": rig.stage_deg * np.abs(expected.per_degree),
    }.items():
        own[MEASURED_SOURCES.index(source)] = u
    return recipe, expected, own


@pytest.mark.parametrize(
    ("name", "share", "least", "most"),
    [("standard", 0.16, 0.04, 0.12), ("tilted", 0.56, 0.45, 0.65), ("suggested", 0.24, 0.13, 0.26)],
)
def test_p_is_uniform_where_the_errors_of_the_model_are_drawn_as_well(name, share, least, most):
    _, expected, own = judged(name)
    rng, basis = np.random.default_rng(5), log_basis(len(expected.poses))
    measurement = covariance_of_measurement(own[None])[0]
    of_model = sum(one.covariance() for one in expected.alone if one.source in MODEL)
    rest = sum(one.covariance() for one in expected.alone if one.source not in MODEL) + measurement
    stated = basis @ (sum(one.covariance() for one in expected.components) + measurement) @ basis.T
    of_distance = np.trace(np.linalg.solve(stated, basis @ of_model @ basis.T)) / len(basis)
    assert of_distance == pytest.approx(share, abs=0.02)

    inputs = rng.standard_normal((PARTS, len(expected.response.sources)))
    shown = np.log(expected.radiance) + expected.response.change(inputs)
    shown = shown + rng.standard_normal((PARTS, len(rest))) @ root(rest)
    errors = rng.standard_normal((PARTS, len(rest))) @ root(of_model)
    every = np.broadcast_to(own, (PARTS, *own.shape))
    drawn, exact = (from_prediction(expected, parts, every) for parts in (shown + errors, shown))
    assert uniformity(drawn)[0] < 0.035
    assert 0.005 < np.mean(drawn < 0.01) < 0.017
    assert least < uniformity(exact)[0] < most  # as in the study, whose worlds have smaller errors
    assert np.mean(exact < 0.01) < 0.01


def scatter_and_noise(name):
    """Scatter of good parts with the errors of one measurement, those left out that all parts of a rig share."""
    recipe, _, own = judged(name)
    basis = log_basis(own.shape[1])
    single = np.delete(
        own, [MEASURED_SOURCES.index(s) for s in ("stray light", "linearity of the camera")], 0
    )
    usual = contrast_scatter(part_scatter(recipe, LIGHT_DEG), 1.0)
    return replace(usual, errors=basis @ np.diag((single**2).sum(axis=0)) @ basis.T)


@pytest.mark.parametrize(
    ("name", "defect", "alike", "by_need"),
    [
        ("tilted", "ridge angle +0.5°", 0.37, 0.51),
        ("tilted", "ridge angle −0.5°", 0.38, 0.53),
        ("suggested", "ridge angle +0.5°", 0.40, 0.52),
        ("suggested", "ridge angle −0.5°", 0.41, 0.54),
        ("standard", "edges worn to 5 µm", 0.44, 0.57),
    ],
)
def test_what_is_found_by_sharing_the_level_by_need(name, defect, alike, by_need):
    """Three golden parts at 1 %: powers with equal shares of half the level, and as decided."""
    scatter = scatter_and_noise(name)
    found = next(one for one in separations(scatter, 3, 0.01) if one.defect == defect)
    assert found.power == pytest.approx(by_need, abs=0.03)
    equal = np.full(len(scatter.defects), 0.5 * 0.01 / len(scatter.defects))
    of = list(scatter.defects).index(defect)
    limit, spread = _null_of(scatter, 3, 3).score_limits(equal)[of], _levels(scatter, 3, 3, 0.01).spreads[of]
    assert ndtr((found.separation - limit) / spread) == pytest.approx(alike, abs=0.03)


@pytest.mark.parametrize("name", ["tilted", "suggested"])
@pytest.mark.parametrize("defect", STATES)
@pytest.mark.parametrize("golden", [3, 25])
def test_as_many_are_found_as_the_power_says(name, defect, golden):
    """Parts drawn in the state of the defect, which scatter by three times as much where they are rougher."""
    scatter, rng = scatter_and_noise(name), np.random.default_rng(7)
    nominal = np.zeros((1, len(scatter.own)))
    sets = scatter.drawn(np.repeat(nominal, SETS, axis=0), golden, rng)
    source, extent = STATES[defect]
    parts = scatter.drawn(extent * (np.array([scatter.response.sources]) == source), PARTS // 2, rng)[0]
    found = [predictive_test(scatter, sets[k % SETS], part, 0.01).p_value for k, part in enumerate(parts)]
    stated = {one.defect: one.power for one in separations(scatter, golden, 0.01)}
    assert np.mean(np.array(found) < 0.01) == pytest.approx(stated[defect], abs=0.12)


@pytest.mark.parametrize(
    ("defects", "expected_areas"),
    [
        (("ridge angle +0.5°", "ridge angle −0.5°"), (0.992, 0.982, 0.970, 0.967)),
        ((f"{ROUGHNESS} +20%",), (0.997, 0.996, 0.980, 0.977)),
    ],
    ids=["angle", "roughness"],
)
def test_what_a_test_loses_that_is_not_given_the_defect(defects, expected_areas):
    """Areas under the curve: ideal, the defect's own direction, the best of all directions, and both tests."""
    scatter, rng = scatter_and_noise("tilted"), np.random.default_rng(6)
    nominal = np.zeros((1, len(scatter.own)))
    sets = scatter.drawn(np.repeat(nominal, SETS, axis=0), GOLDEN, rng)

    def scores(parts, name):
        found = [predictive_test(scatter, sets[k % SETS], part, 0.01) for k, part in enumerate(parts)]
        of = [{one.defect: one.score for one in test.directions} for test in found]
        return np.array(
            [
                [one[name] for one in of],
                [-test.p_direction for test in found],
                [-test.p_value for test in found],
            ]
        )

    areas = []
    for name in defects:
        source, extent = STATES[name]
        state = nominal.copy()
        state[0, scatter.response.sources.index(source)] = extent
        good, bad = (scatter.drawn(one, PARTS // 2, rng)[0] for one in (nominal, state))
        ideal = area_under_curve(*ideal_scores(bad, good, np.ones(len(bad), dtype=int)))
        ours = zip(scores(bad, name), scores(good, name), strict=True)
        areas.append([ideal.value, *(area_under_curve(*pair).value for pair in ours)])
    assert np.mean(areas, axis=0) == pytest.approx(expected_areas, abs=0.008)
