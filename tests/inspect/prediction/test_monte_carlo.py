"""First-order uncertainty against drawing everything at once (JCGM 101)."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.contrast_uncertainty import KINDS, contrast_covariance
from anisoscope.prediction.monte_carlo import MonteCarlo, disagreement, draw
from anisoscope.prediction.predict import predict_design, predict_height_map
from anisoscope.prediction.sensitivity import Contribution, State, fixed
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.light.geometry import pose_grid

POSES = pose_grid((0.0, 90.0, 180.0))
DESIGN = RidgeDesign(100.0, 10.0)
SMALL = InputUncertainty(
    alpha_share=0.02,
    albedo=0.005,
    index=0.005,
    stage_deg=0.3,
    stage_zero_deg=0.2,
    tilt_deg=0.1,
    tilt_zero_deg=0.1,
    seating_tilt_deg=0.05,
    ridge_angle_deg=0.1,
    light_field_deg=0.5,
)
QUICK = InputUncertainty(  # without those that cost a table of the interface for every draw
    alpha_share=0.0,
    albedo=0.01,
    index=0.0,
    stage_deg=0.3,
    stage_zero_deg=0.2,
    tilt_deg=0.1,
    tilt_zero_deg=0.1,
    seating_tilt_deg=0.1,
)


@pytest.fixture(scope="module")
def surface():
    rng = np.random.default_rng(3)
    return add_facet_roughness(ridges(DESIGN, (21, 501), (2.0, 1.0), 0.3), 0.02, 0.02, 8.0, rng)


def whitened(found):
    """Covariance of the draws in units of the first-order one: identity, where both agree."""
    values, vectors = np.linalg.eigh(found.budget.covariance())
    root = vectors / np.sqrt(values)
    return root.T @ found.drawn.covariance() @ root


def agrees(found, limit):
    return np.abs(whitened(found) - np.eye(len(found.poses))).max() <= limit


def test_the_covariance_of_a_design_is_that_of_the_draws():
    found = predict_design(
        DESIGN, Material(), POSES, Convention(), inputs=QUICK, monte_carlo=MonteCarlo(1200), bounces=1
    )
    assert agrees(found, 0.15)  # the largest of six has .055 ± .02
    for kind in KINDS:
        stated = contrast_covariance(POSES, found.radiance, found.budget.covariance(), kind)
        np.testing.assert_allclose(
            np.sqrt(np.diag(found.contrast_covariance(kind))), np.sqrt(np.diag(stated)), rtol=0.08
        )


def test_so_it_is_with_every_input_uncertain():
    found = predict_design(DESIGN, Material(), POSES, Convention(), inputs=SMALL, monte_carlo=MonteCarlo(50))
    assert agrees(found, 5.0 * np.sqrt(2.0) * found.drawn.u_error_share)
    assert np.abs(disagreement(found.budget, found.drawn)).max() < 4.0 * found.drawn.u_error_share


def test_the_covariance_of_a_height_map_is_that_of_the_draws(surface):
    inputs = InputUncertainty(
        alpha_share=0.0,
        index=0.0,
        seating_tilt_deg=0.05,
        stage_deg=0.3,
        height_scale_share=0.005,
        ridges_seen=9,
    )
    found = predict_height_map(
        surface, Material(), POSES, Convention(), inputs=inputs, monte_carlo=MonteCarlo(300), bounces=1
    )
    assert agrees(found, 0.3)
    assert np.abs(disagreement(found.budget, found.drawn)).max() < 4.0 * found.drawn.u_error_share


def test_a_smooth_part_seated_badly_breaks_the_first_order():
    smooth = Material(0.03, 0.03)
    poses = pose_grid((0.0, 180.0))
    mirror = RidgeDesign(100.0, 5.0)  # the facets throw the light into the camera: top of the lobe
    inputs = InputUncertainty(alpha_share=0.0, index=0.0, light_angle_deg=0.0, seating_tilt_deg=1.5)
    found = predict_design(
        mirror, smooth, poses, Convention(), inputs=inputs, monte_carlo=MonteCarlo(400), bounces=1
    )
    assert found.budget.not_linear()[0]
    assert disagreement(found.budget, found.drawn)[0] > 0.5
    assert found.drawn.radiance[:, 0].mean() < 0.8 * found.radiance[0]
    fine = predict_design(
        mirror, smooth, poses, Convention(), inputs=InputUncertainty(seating_tilt_deg=0.02), bounces=1
    )
    assert not fine.budget.not_linear().any()


def test_draws_are_those_of_their_seed():
    first, again, other = (
        predict_design(
            DESIGN, Material(), POSES, Convention(), inputs=QUICK, monte_carlo=MonteCarlo(10, seed)
        ).drawn.radiance
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert np.all(first != other)


def none():
    return InputUncertainty(
        alpha_share=0, albedo=0, index=0, light_angle_deg=0, stage_deg=0, stage_zero_deg=0, tilt_deg=0,
        tilt_zero_deg=0, seating_tilt_deg=0, height_map_share=0,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("correlation", "rectangular"),
    [("shared", True), ("independent", False), ("independent", True), ("partial", False)],
)
def test_additional_contributions_are_drawn_with_their_covariance(correlation, rectangular):
    u = np.array([0.01, -0.02, 0.03])
    matrix = np.array([[4.0, 1.0, 0.0], [1.0, 9.0, -2.0], [0.0, -2.0, 1.0]]) * 1e-4
    part = Contribution("x", u, correlation, matrix if correlation == "partial" else None, None, rectangular)
    state = State(Material(), 10.0)
    drawn = draw(
        fixed(lambda i, o, m: np.ones(len(i))),
        state,
        POSES,
        Convention(),
        none(),
        1500,
        np.random.default_rng(1),
        additional=[part],
    )
    np.testing.assert_allclose(drawn.covariance(), part.covariance(), rtol=0.1, atol=4e-5)


def test_dark_poses_leave_finite_numbers():
    dark = fixed(lambda i, o, m: np.maximum(i[:, 0], 0.0))
    drawn = draw(dark, State(Material(), 10.0), POSES, Convention(), QUICK, 200, np.random.default_rng(2))
    assert np.isfinite(drawn.covariance()).all()
    assert drawn.radiance.min() == 0.0
    assert np.isinf(np.diag(drawn.contrast_covariance("log_ratio"))).all()
    assert np.isfinite(drawn.contrast_covariance("difference")).all()


def test_too_few_draws_are_refused():
    with pytest.raises(ModelError, match="at least 10"):
        predict_design(DESIGN, Material(), POSES, Convention(), inputs=QUICK, monte_carlo=MonteCarlo(9))
