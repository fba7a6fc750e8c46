"""Known parameters come back from synthetic data, with uncertainties that are true, and nothing else comes back."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.experiment.experiment import Setup, absolute_contrasts
from anisoscope.fit.fitting import fit
from anisoscope.fit.identifiability import information
from anisoscope.fit.parameters import GEOMETRY, PARAMETERS, USUAL, checked_values, parse_free
from anisoscope.fit.problem import Problem, Readings, Scene, interface_alpha
from anisoscope.fit.table import experiment_problem
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light import corrected
from anisoscope.sim.light.contrasts import consecutive_pairs
from anisoscope.sim.light.geometry import directions, pose_grid, seating_rotation

TILTED = pose_grid((0.0, 90.0, 180.0, 270.0), (-15.0, 0.0, 15.0))
ROUND = pose_grid(tuple(np.arange(0.0, 360.0, 45.0)), (-20.0, -10.0, 0.0, 10.0, 20.0))
TRUTH = {"ridge_angle_deg": 8.0, "alpha_along": 0.05, "alpha_across": 0.12, "k": 300.0}
CONVENTION = Convention()


def scene(poses, **keywords):
    """Direct light unless said otherwise: what is tested of the search is the same, and is quick."""
    light = {"bounces": 1} | keywords
    return Scene(*directions(poses, CONVENTION), poses=poses, convention=CONVENTION, **light)


def readings(kind, poses, value, covariance, known=True):
    """Readings of all poses, or of all consecutive pairs."""
    if kind == "exposure":
        first = second = np.arange(len(poses))
    else:
        first, second = (np.array(index) for index in zip(*consecutive_pairs(poses), strict=True))
    labels = tuple(str(n) for n in range(len(first)))
    return Readings(kind, first, second, value, covariance, known, labels, "as made")


def made(poses, truth, free, *, kind="exposure", noise=0.01, rng=None, known=True, start=None, **keywords):
    """A problem with exposures of known relative noise, as they are or as contrasts with their covariance."""
    place, values = scene(poses, **keywords), checked_values(truth)
    exposure = values["k"] * place.radiance(values, interface_alpha(values))
    u = noise * exposure
    if rng is not None:
        exposure = exposure + u * rng.standard_normal(exposure.size)
    blank = readings(kind, poses, np.zeros(0), np.zeros((0, 0)))
    value = blank.predicted(exposure, 1.0)
    slopes = blank.by_log_radiance(exposure, 1.0) / exposure
    covariance = slopes @ np.diag(u**2) @ slopes.T
    given = checked_values({n: v for n, v in truth.items() if n not in free} | (start or {}))
    return Problem(place, readings(kind, poses, value, covariance, known), given, free)


def estimates(found):
    return {one.name: one for one in found.estimates}


@pytest.mark.parametrize("kind", ["exposure", "difference", "michelson", "log_ratio"])
def test_exact_data_give_back_what_made_them(kind):
    truth = TRUTH | {"ridge_angle_deg": 14.0 if kind == "difference" else 5.0}
    free = tuple(n for n in USUAL if n != "k" or kind in ("exposure", "difference"))
    found = fit(made(ROUND, truth, free, kind=kind), starts=1)
    for name, one in estimates(found).items():
        assert one.value == pytest.approx(truth[name], rel=1e-4), name
    assert found.chi2 < 1e-3


def test_height_loss_and_seating_come_back_too():
    truth = TRUTH | {"height_loss": 0.2, "seating_x_deg": 0.6, "seating_y_deg": -0.8}
    found = fit(made(ROUND, truth, GEOMETRY, noise=0.002), starts=1)
    for name, one in estimates(found).items():
        assert one.value == pytest.approx(truth[name], rel=1e-3, abs=1e-3), name


def test_the_model_that_is_fitted_is_the_corrected_one():
    """With the interface table rounded to its grid, and the part turned by its seating."""
    values = checked_values(
        TRUTH | {"height_loss": 0.1, "seating_x_deg": 1.0, "albedo": 0.6, "alpha_along": 0.0505}
    )
    place = scene(ROUND)
    seat = seating_rotation(1.0, 0.0)
    design = RidgeDesign(50.0, 8.0, height_loss=0.1)
    exact = corrected.radiance(
        place.to_light @ seat, place.to_camera @ seat, design, Material(0.0505, 0.12, 0.6)
    )
    np.testing.assert_allclose(place.radiance(values, interface_alpha(values)), exact, rtol=5e-5)


def fitted_tables(kind, tables):
    """Fits of tables with noise of their own."""
    rng = np.random.default_rng(11)
    free = USUAL if kind == "exposure" else ("alpha_along", "alpha_across")
    near = {
        n: v
        for n, v in {"ridge_angle_deg": 8.5, "alpha_along": 0.055, "alpha_across": 0.11}.items()
        if n in free
    }
    return [
        fit(made(TILTED, TRUTH, free, kind=kind, noise=0.02, rng=rng, start=near), starts=0)
        for _ in range(tables)
    ]


def test_a_few_noisy_tables_are_fitted_within_their_uncertainties():
    trials = fitted_tables("log_ratio", 8)
    pulls = np.array([[(e.value - TRUTH[e.name]) / e.u for e in trial.estimates] for trial in trials])
    assert np.all(np.abs(pulls.mean(axis=0)) < 1.2)  # 3.4 standard errors of a mean of 8
    assert np.abs(pulls).max() < 4.0
    assert np.mean([trial.chi2 / trial.dof for trial in trials]) == pytest.approx(1.0, abs=0.6)


@pytest.mark.statistics
@pytest.mark.parametrize("kind", ["exposure", "log_ratio"])
def test_bias_and_coverage(kind):
    """Over 60 noisy tables: no bias, 2 u covers about 95 %, chi-square about 1 a degree of freedom."""
    trials = fitted_tables(kind, 60)
    pulls = np.array([[(e.value - TRUTH[e.name]) / e.u for e in trial.estimates] for trial in trials])
    assert np.all(np.abs(pulls.mean(axis=0)) < 0.4)  # 3 standard errors of a mean of 60
    assert np.all((pulls.std(axis=0) > 0.72) & (pulls.std(axis=0) < 1.28))
    assert np.mean(np.abs(pulls) < 2.0) >= 0.89  # 3.2 standard errors of 120 pulls below .954
    inside = [[e.low95 <= TRUTH[e.name] <= e.high95 for e in trial.estimates] for trial in trials]
    assert np.mean(inside) >= 0.885
    assert np.mean([trial.chi2 / trial.dof for trial in trials]) == pytest.approx(
        1.0, abs=0.21
    )  # 7 degrees of freedom
    assert 0.3 < np.mean([trial.p_value for trial in trials]) < 0.7


def test_contrasts_that_share_a_photograph_need_their_covariance():
    """Taken as independent, differences give another uncertainty than the exposures they come from."""
    free = ("alpha_along", "alpha_across")
    full = made(TILTED, TRUTH, free, kind="difference", noise=0.02)
    bare = Readings(**{**vars(full.readings), "covariance": np.diag(np.diag(full.readings.covariance))})
    wrong = Problem(full.scene, bare, full.values, free)
    ratio = [a.u / b.u for a, b in zip(fit(full).estimates, fit(wrong).estimates, strict=True)]
    assert max(abs(np.log(ratio))) > 0.1


def test_unknown_noise_is_estimated_from_the_residuals(rng):
    known = fit(made(ROUND, TRUTH, USUAL, noise=0.02, rng=np.random.default_rng(3)), starts=1)
    same = made(ROUND, TRUTH, USUAL, noise=0.02, rng=np.random.default_rng(3))
    shape = Readings(
        **{**vars(same.readings), "covariance": 9.0 * same.readings.covariance, "noise_known": False}
    )
    found = fit(Problem(same.scene, shape, same.values, USUAL), starts=1)
    scale = np.sqrt(known.chi2 / known.dof)
    for one, other in zip(found.estimates, known.estimates, strict=True):
        assert one.value == pytest.approx(other.value, rel=1e-6)
        assert one.u == pytest.approx(scale * other.u, rel=1e-3)
    assert found.p_value is None
    assert np.mean(found.z**2) == pytest.approx(found.dof / len(found.z), rel=1e-9)


def test_the_same_data_give_the_same_fit():
    made_so = [made(TILTED, TRUTH, USUAL, noise=0.02, rng=np.random.default_rng(5)) for _ in range(2)]
    one, other = (fit(problem, starts=2) for problem in made_so)
    assert one.values == other.values
    np.testing.assert_array_equal(one.covariance, other.covariance)


def test_a_wrong_model_shows_in_the_p_value():
    problem = made(ROUND, TRUTH | {"height_loss": 0.3}, USUAL, noise=0.01)
    wrong = Problem(problem.scene, problem.readings, checked_values({}), USUAL)
    assert fit(wrong, starts=1).p_value < 1e-6


def test_all_reflections_of_a_smooth_dark_part_are_in_the_fit():
    """Direct light alone explains them by other ridges."""
    truth = TRUTH | {"ridge_angle_deg": 10.0, "alpha_along": 0.08, "alpha_across": 0.08, "albedo": 0.1}
    poses = pose_grid((0.0, 90.0, 180.0), (-15.0, 0.0, 15.0))
    several = made(poses, truth, USUAL, bounces=None)
    found = estimates(fit(several, starts=1))
    assert all(one.value == pytest.approx(truth[name], rel=1e-3) for name, one in found.items())
    once = Problem(scene(poses), several.readings, several.values, USUAL)
    assert fit(once, starts=1).chi2 > 10.0


def test_further_reflections_anchored_where_they_are_wanted_are_all_of_them():
    poses, values = scene(TILTED, bounces=None), checked_values(TRUTH)
    anchored = poses.anchored(values, 0.08)
    # where two reflections do not reach the camera, three add 1e-4
    np.testing.assert_allclose(anchored.radiance(values, 0.08), poses.radiance(values, 0.08), rtol=2e-4)
    near = values | {"alpha_across": 1.05 * values["alpha_across"]}
    np.testing.assert_allclose(anchored.radiance(near, 0.08), poses.radiance(near, 0.08), rtol=1e-3)


def test_a_fit_of_nothing_is_a_comparison():
    problem = made(TILTED, TRUTH, ())
    found = fit(problem)
    assert (found.estimates, found.dof) == ((), len(TILTED))
    assert found.chi2 == pytest.approx(0.0, abs=1e-9)


# what the data do not say


@pytest.mark.parametrize("name", ["index", "albedo"])
def test_index_and_albedo_of_the_printed_model_are_refused_with_k(name):
    with pytest.raises(UsageError, match=rf"--free {name} is refused.*scale k \(correlation -1\.0"):
        fit(made(TILTED, TRUTH, (*USUAL, name), model="printed"))


@pytest.mark.soak
def test_index_or_albedo_alone_can_be_had_from_the_corrected_model_but_not_both_beside_k():
    """Two amplitudes, glossy and diffuse, against the three unknowns k, albedo and index."""
    truth = TRUTH | {"albedo": 0.3}
    found = estimates(fit(made(TILTED, truth, (*USUAL, "albedo")), starts=1))
    assert found["albedo"].value == pytest.approx(0.3, rel=1e-3)
    found = estimates(fit(made(TILTED, TRUTH | {"index": 1.6}, (*USUAL, "index")), starts=1))
    assert found["index"].value == pytest.approx(1.6, rel=1e-3)
    with pytest.raises(UsageError, match=r"albedo cannot be identified .*correlation -[01]"):
        fit(made(TILTED, truth, (*USUAL, "albedo", "index")))
    free = ("ridge_angle_deg", "alpha_along", "alpha_across", "albedo", "index")
    found = estimates(fit(made(TILTED, truth, free), starts=1))  # k known: two amplitudes, two unknowns
    assert found["albedo"].value == pytest.approx(0.3, rel=1e-3)
    assert found["index"].value == pytest.approx(1.5, rel=1e-3)


def test_ratios_give_only_one_combination_of_index_and_albedo():
    with pytest.raises(UsageError, match="cannot be identified"):
        fit(made(TILTED, TRUTH, ("alpha_along", "alpha_across", "albedo", "index"), kind="log_ratio"))


def test_few_poses_determine_too_little_and_more_would_help():
    flat = pose_grid((0.0, 90.0, 180.0, 270.0))
    found = fit(made(flat, TRUTH, USUAL))
    assert all(one.value is None and one.u is None for one in found.estimates)
    assert np.isnan(found.correlation).all()
    assert {name for name, _ in found.lacking[0].parts} >= {"alpha_across", "alpha_along"}
    assert found.advice is not None
    assert found.advice.startswith("stage angles")
    more = fit(made(ROUND, TRUTH, USUAL), starts=1)
    assert all(one.value is not None for one in more.estimates)


def test_ridge_angle_and_seating_about_y_are_told_apart_badly():
    """The lobes only see the slope of the facets; what else turns with the seating is dim."""
    usual = fit(made(TILTED, TRUTH, USUAL), starts=1)
    both = fit(made(TILTED, TRUTH, (*USUAL, "seating_y_deg")), starts=1)
    weighed = information(both.problem, both.values, both.problem.readings.covariance)
    row, column = (weighed.names.index(n) for n in ("ridge_angle_deg", "seating_y_deg"))
    assert abs(weighed.correlation[row, column]) > 0.99
    u_both = weighed.uncertainty[row] * PARAMETERS["ridge_angle_deg"].limit
    assert u_both > 5.0 * estimates(usual)["ridge_angle_deg"].u


def test_a_determined_parameter_is_reported_beside_undetermined_ones():
    found = fit(made(TILTED, TRUTH, ("alpha_along", "k", "seating_y_deg", "ridge_angle_deg"), noise=0.4))
    known = estimates(found)
    assert known["ridge_angle_deg"].value is None
    assert known["alpha_along"].value == pytest.approx(0.05, rel=0.5)
    row = found.problem.free.index("ridge_angle_deg")
    assert np.isnan(found.covariance[row]).all()
    assert np.isfinite(np.delete(np.delete(found.covariance, row, 0), row, 1)).any()


def test_a_value_at_its_bound_is_marked():
    """A part without height loss would often be fitted best by a negative one."""
    rng = np.random.default_rng(2)
    free = ("alpha_along", "k", "height_loss")
    found = [estimates(fit(made(TILTED, TRUTH, free, noise=0.02, rng=rng), starts=0)) for _ in range(8)]
    losses = [one["height_loss"] for one in found]
    assert {one.at_bound for one in losses} == {True, False}
    for one in losses:
        assert one.at_bound == (one.value < 1e-5)
        assert one.low95 >= 0.0


def test_two_minima_are_both_told():
    """At stage angle 0 the lobe is as far from the mirror direction on either side of the ridge angle of 5°."""
    poses = pose_grid((0.0, 180.0))
    truth = TRUTH | {"ridge_angle_deg": 10.0, "alpha_along": 0.06, "alpha_across": 0.06, "k": 1.0}
    found = fit(made(poses[:1] * 3, truth, ("ridge_angle_deg",)))
    angles = sorted([found.values["ridge_angle_deg"], *(r["ridge_angle_deg"] for r in found.rivals)])
    assert angles == pytest.approx([0.0, 10.0], abs=0.5)


# refusals


@pytest.mark.parametrize(
    ("keywords", "free", "words"),
    [
        ({"kind": "log_ratio"}, USUAL, "k cancels"),
        ({"model": "printed"}, (*USUAL, "height_loss"), "knows no height loss"),
        ({"kind": "michelson", "model": "printed"}, ("alpha_along",), "far off"),
        ({"ridge_angles_deg": np.full(len(TILTED), 5.0)}, USUAL, "stand in the table"),
    ],
)
def test_what_makes_no_sense_is_refused(keywords, free, words):
    with pytest.raises(UsageError, match=words):
        made(TILTED, TRUTH, free, **keywords)


@pytest.mark.parametrize(
    ("known", "words"), [(True, "3 values cannot determine 4"), (False, "their own scatter")]
)
def test_too_few_values_are_refused(known, words):
    with pytest.raises(UsageError, match=words):
        made(pose_grid((0.0, 90.0, 180.0)), TRUTH, USUAL, known=known)


def test_contrasts_of_the_wrong_sign_are_refused():
    problem = made(TILTED, TRUTH, USUAL)
    turned = Readings(**{**vars(problem.readings), "value": -problem.readings.value})
    with pytest.raises(UsageError, match="no positive scale k"):
        fit(Problem(problem.scene, turned, problem.values, USUAL))


def test_names_of_parameters():
    assert parse_free("k, ridge-angle,alpha_along") == ("ridge_angle_deg", "alpha_along", "k")
    assert parse_free("all") == GEOMETRY
    assert parse_free("none") == ()
    with pytest.raises(UsageError, match=r"--free knows ridge_angle, .* not 'pitch'"):
        parse_free("k,pitch")
    with pytest.raises(UsageError, match=r"albedo: 1\.5 lies outside 0 to 1"):
        checked_values({"albedo": 1.5})


@pytest.mark.parametrize("model", ["printed", "corrected"])
def test_the_published_experiment_gives_back_its_plastic(model, rng):
    material = Material(0.05, 0.13)
    clean = 40.0 * absolute_contrasts(Setup(model, material))
    measured = clean * (1.0 + 1e-3 * rng.standard_normal(clean.shape))
    measured[2, 1] = np.nan
    free = ("alpha_along", "alpha_across", "k")
    found = fit(
        experiment_problem(measured, CONVENTION, {"model": model}, checked_values({}), free), starts=1
    )
    assert found.dof == 38 - 3
    truth = {"alpha_along": 0.05, "alpha_across": 0.13, "k": 40.0}
    for name, one in estimates(found).items():
        assert one.value == pytest.approx(truth[name], rel=0.01)
        assert abs(one.value - truth[name]) < 4.0 * one.u
    everything = (*free, "albedo", "index")
    with pytest.raises(UsageError, match="refused"):
        fit(
            experiment_problem(measured, CONVENTION, {"model": "printed"}, checked_values({}), everything),
            starts=0,
        )


def test_index_is_interpolated_without_loss():
    """Against tables of the interface made for the very index."""
    values = checked_values(TRUTH | {"index": 1.633, "albedo": 0.5})
    place = scene(TILTED)
    problem = made(TILTED, TRUTH, ("k", "index"))
    interface = interface_alpha(values)
    exact = values["k"] * place.radiance(values, interface)
    np.testing.assert_allclose(problem.predicted(values, interface), exact, rtol=2e-5)


def test_the_tail_of_the_lobe_comes_back_where_it_is_free():
    truth = TRUTH | {"tail": 0.7}
    found = fit(made(ROUND, truth, (*USUAL, "tail"), noise=0.003), starts=1)
    for name, one in estimates(found).items():
        assert one.value == pytest.approx(truth[name], rel=1e-3), name
    with pytest.raises(UsageError, match="Beckmann"):
        made(ROUND, TRUTH, ("tail",), model="printed")
