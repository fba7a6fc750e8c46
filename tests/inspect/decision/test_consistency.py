"""The chance of a good part's distance: uniform for parts that are drawn as the budget says, golden or predicted."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2

from anisoscope.base.covariance import root
from anisoscope.base.errors import MeasurementError
from anisoscope.base.significance import calibrated, log_basis, mahalanobis
from anisoscope.decision.consistency import from_prediction, nearest_lobe
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import LONGEST_TAIL
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import Component, Expectation, expectation
from anisoscope.prediction.lobe_doubt import LobeDoubt
from anisoscope.prediction.second_order import Response
from anisoscope.recipe.material_file import MaterialFile, material_at
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid, seating_rotation

POSES = pose_grid((0.0, 90.0, 180.0), (0.0, 10.0))
RADIANCE = np.array([0.3, 0.05, 0.04, 0.2, 0.07, 0.1])
SLOPE = 0.05 * np.random.default_rng(6).normal(size=(6, 2))
BEND = np.zeros((6, 2, 2))
BEND[:, 0, 0] = 0.03 * np.random.default_rng(7).normal(size=6)
RESPONSE = Response(("a", "b"), SLOPE, BEND)
OWN = Component("own", "measurement", np.full(6, 0.004), shared=False)
NOISE = Component("z", "measurement", np.zeros(6), shared=True)


@pytest.fixture
def rng():
    """Every test draws for itself."""
    return np.random.default_rng(6)


def expected(response=RESPONSE):
    linear = tuple(Component(name, "prediction", SLOPE[:, k], shared=True) for k, name in enumerate("ab"))
    return Expectation("corrected", POSES, RADIANCE, linear, np.zeros(6), None, Convention(), response)


def measured(change, components=(OWN,)):
    grid = Grid((0.0, 0.0), 0.025, (4, 4))
    return Measured(RADIANCE * np.exp(change), components, (), np.ones((6, 1, 1)), np.zeros(6), grid, None)


def good_parts(count, rng):
    return RESPONSE.draw(OWN.covariance(), count, rng)


def test_good_parts_are_flagged_as_often_as_the_level_says(rng):
    p = np.array([from_prediction(expected(), measured(change))[2] for change in good_parts(120, rng)])
    assert np.mean(p < 0.1) == pytest.approx(0.1, abs=0.09)  # 3.3 standard deviations
    normal = [from_prediction(expected(None), measured(change))[2] for change in good_parts(120, rng)]
    assert np.mean(np.array(normal) < 0.01) > 0.05  # the curve told is what makes the difference


def test_without_a_response_the_distance_is_that_of_the_covariance(rng):
    change = 0.02 * rng.normal(size=6)
    basis = log_basis(6)
    total = SLOPE @ SLOPE.T + OWN.covariance()
    d2, dof, p = from_prediction(expected(None), measured(change))
    assert (d2, dof) == (pytest.approx(mahalanobis(basis @ change, basis @ total @ basis.T)[0]), 5)
    assert p == pytest.approx(chi2.sf(d2, 5))


def test_poses_without_any_error_of_their_own_are_weighed_too():
    d2, dof, _ = from_prediction(expected(), measured(SLOPE[:, 0], (NOISE,)))
    assert dof == 2
    assert d2 == pytest.approx(1.0, abs=0.05)
    nothing = Expectation("corrected", POSES, RADIANCE, (), np.zeros(6), None, Convention())
    with pytest.raises(MeasurementError, match="no source of uncertainty"):
        from_prediction(nothing, measured(np.zeros(6), ()))


def test_calibrated_chances_rise_and_have_no_floor(rng):
    drawn = np.sort(rng.random(10000) ** 1.5)
    p = np.array([1e-250, 1e-12, 1e-4, 0.01, 0.1, 0.9, 1.0])
    found = calibrated(p, drawn)
    assert (np.diff(found) > 0.0).all()
    np.testing.assert_allclose(found[2:6], p[2:6] ** (1.0 / 1.5), rtol=0.15)
    assert found[-1] == 1.0


def calibrated_recipe(make_recipe, tail=0.7, u_tail=0.0, **scatter):
    """A recipe of a calibrated plastic in direct light; an exact tail is fast: others cost tables."""
    lobe = ("ln_alpha_along", "ln_alpha_across", "ln_albedo")
    u = np.array([0.007, 0.009, 0.009])
    if u_tail:
        lobe, u = (*lobe, "tail"), np.array([0.014, 0.017, 0.016, u_tail])
    file = MaterialFile.model_validate(
        {
            "id": "plastic",
            "name": "plastic",
            "material": {"alpha_along": 0.06, "alpha_across": 0.1, "albedo": 0.2, "tail": tail},
            "covariance": {"parameters": lobe, "matrix": np.diag(u**2).tolist()},
            "validity": {"half_angle_deg": (0.0, 40.0)},
        }
    )
    recipe = make_recipe(
        surface={"reflections": "direct"},
        poses={"angles_deg": [0.0, 90.0, 180.0], "tilts_deg": [0.0, -10.0, 10.0]},
        uncertainty={"seating_tilt_deg": 0.1},
        scatter=scatter,
    )
    known = {"u_alpha_share": 0.0, "u_albedo": 0.0, "u_tail": 0.0, "calibrated": file}
    plastic = {**dict(file.material), **known}
    return recipe.model_copy(update={"material": recipe.material.model_copy(update=plastic)})


def plastic_part(recipe, rng):
    """(P,) ln L of a part whose plastic, seating and ridges scatter, on a rig of its own, by the exact model."""
    normal, part, file = rng.standard_normal, recipe.stated_scatter, recipe.material.calibrated
    covariance = file.covariance.array()
    count = len(covariance)
    mean = file.values() + root(covariance) @ normal(count)
    while not 0.0 <= mean[3:].sum() <= LONGEST_TAIL:  # no lobe has such a tail
        mean = file.values() + root(covariance) @ normal(count)
    spread = np.array([part.alpha_share, part.alpha_share, part.albedo_share, 0.0])[:count]
    moved = mean + spread * normal(count)
    index = {"index": recipe.material.index + recipe.material.u_index * normal()}
    plastic = material_at(
        recipe.material.model_copy(update=index).material(), file.covariance.parameters, moved
    )
    light = 10.0 + recipe.uncertainty.light_angle_deg * normal()
    seat = seating_rotation(*(recipe.scattered_seating_deg * normal(2)))
    design = RidgeDesign(100.0, 10.0 + recipe.scattered_ridge_angle_deg * normal())
    to_light, to_camera = directions(recipe.poses.poses(), Convention(light))
    return np.log(corrected.radiance(to_light @ seat, to_camera @ seat, design, plastic))


@pytest.mark.parametrize(
    ("parts", "most"), [(25, 0.13), pytest.param(3000, 0.0155, marks=pytest.mark.statistics)]
)
def test_good_parts_of_a_calibrated_plastic_are_flagged_as_seldom_as_the_level_says(make_recipe, parts, most):
    """The covariance of the file is of the plastic's mean: without [scatter] a large share of good parts fails."""
    recipe, rng = calibrated_recipe(make_recipe), np.random.default_rng(9)
    found, narrow = (
        expectation(one, 10.0) for one in (recipe, calibrated_recipe(make_recipe, in_prediction=False))
    )
    noise = Component("noise", "measurement", np.full(9, 0.003), shared=False)
    grid = Grid((0.0, 0.0), 0.025, (4, 4))
    flagged = np.zeros((parts, 2), bool)
    for row in flagged:
        seen = np.exp(plastic_part(recipe, rng) + noise.relative * rng.standard_normal(9))
        one = Measured(seen, (noise,), (), np.ones((9, 1, 1)), np.zeros(9), grid, None)
        row[:] = [from_prediction(budget, one)[2] < 0.01 for budget in (found, narrow)]
    good, false = flagged.mean(axis=0)
    assert good < most
    assert false > 0.15
    if parts > 1000:
        assert good > 0.004


@pytest.mark.statistics
@pytest.mark.parametrize(("tail", "u"), [(0.0, 0.05), (0.05, 0.05), (0.5, 0.03), (0.7, 0.027), (1.0, 0.03)])
def test_the_level_holds_whatever_the_calibrated_tail(make_recipe, tail, u):
    """Near a tail of 0, where ln L is steepest and bent most, a line along the tail flags 4 to 8 % of good parts."""
    recipe, rng = calibrated_recipe(make_recipe, tail, u), np.random.default_rng(9)
    found = expectation(recipe, 10.0)
    noise = Component("noise", "measurement", np.full(9, 0.003), shared=False)
    grid = Grid((0.0, 0.0), 0.025, (4, 4))
    flagged = 0
    for _ in range(800):
        seen = np.exp(plastic_part(recipe, rng) + noise.relative * rng.standard_normal(9))
        one = Measured(seen, (noise,), (), np.ones((9, 1, 1)), np.zeros(9), grid, None)
        flagged += from_prediction(found, one)[2] < 0.01
    assert (
        0.001 <= flagged / 800 <= 0.03
    )  # none of 800 has a chance of 3e-4, and .03 is 5.7 standard deviations


def test_the_nearest_lobe_is_that_of_a_search_over_the_tail_and_all_inputs(rng):
    """Scipy's simplex from many tails; the response to the inputs changes with the tail."""
    tails = np.array([0.0, 0.25, 0.5, 1.0])
    shifts = 0.1 * np.sin(3.0 * np.outer(tails / (1.0 + tails), rng.normal(size=6)))
    responses = tuple(Response(("a", "b"), SLOPE * (1.0 + 0.5 * tail), BEND * (1.0 - tail)) for tail in tails)
    covariance = np.diag(np.full(6, 0.02**2))
    for u in (np.inf, 0.3):
        lobes = LobeDoubt(tails, shifts, responses, 0.2, u)
        deviations = 0.05 * rng.normal(size=(2, 6))
        together = nearest_lobe(lobes, deviations, np.broadcast_to(covariance, (2, 6, 6)))
        assert nearest_lobe(lobes, deviations[:0], np.zeros((0, 6, 6))).shape == (0,)
        for deviation, found in zip(deviations, together, strict=True):

            def distance(at, lobes=lobes, deviation=deviation):
                tail = float(np.clip(at[0], 0.0, 1.0))
                shift, response = lobes.at(tail)
                rest = (deviation - shift - response.change(at[1:])) / 0.02
                return rest @ rest + at[1:] @ at[1:] + ((tail - 0.2) / lobes.u) ** 2

            options = {"xatol": 1e-8, "fatol": 1e-10, "maxiter": 4000}
            least = min(
                minimize(distance, [start, 0.0, 0.0], method="Nelder-Mead", options=options).fun
                for start in np.linspace(0.05, 0.95, 4)
            )
            assert found == pytest.approx(least, rel=2e-4, abs=2e-4)
