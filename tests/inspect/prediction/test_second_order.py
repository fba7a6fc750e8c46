"""Responses against the model itself; distances from them against closed forms and simulated parts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from anisoscope.base.significance import log_basis
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import expectation
from anisoscope.prediction.profile_likelihood import nearest
from anisoscope.prediction.second_order import Response
from anisoscope.prediction.sensitivity import SECOND_ORDER
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, seating_rotation


@pytest.fixture
def rng():
    """Every test draws for itself."""
    return np.random.default_rng(2)


def straight(values, inputs, rng):
    return Response(
        tuple("abcdef"[:inputs]), rng.normal(size=(values, inputs)), np.zeros((values, inputs, inputs))
    )


def bent(values, inputs, size, rng):
    bend = size * rng.normal(size=(values, inputs, inputs))
    return replace(straight(values, inputs, rng), bend=bend + bend.transpose(0, 2, 1))


def test_the_response_is_the_model_to_second_order(make_recipe, rng):
    recipe = make_recipe(
        poses={"angles_deg": [0.0, 90.0, 180.0], "tilts_deg": [0.0, -10.0]},
        surface={"design": {"u_ridge_angle_deg": 0.2}},
    )
    found = expectation(recipe, 10.0)
    part, rig = recipe.material, recipe.uncertainty
    assert found.response.sources[:2] == ("roughness along the ridges", "roughness across the ridges")
    errors, sizes = [], []
    for z in rng.standard_normal((6, 8)):
        plastic = replace(
            part.material(),
            alpha_along=part.alpha_along * (1.0 + part.u_alpha_share * z[0]),
            alpha_across=part.alpha_across * (1.0 + part.u_alpha_share * z[1]),
            albedo=part.albedo + part.u_albedo * z[2],
            index=part.index + part.u_index * z[3],
        )
        seat = seating_rotation(*(rig.seating_tilt_deg * z[5:7]))
        to_light, to_camera = directions(found.poses, Convention(10.0 + rig.light_angle_deg * z[4]))
        exact = corrected.radiance(
            to_light @ seat, to_camera @ seat, RidgeDesign(100.0, 10.0 + 0.2 * z[7]), plastic, bounces=None
        )
        change = np.log(exact / found.radiance)
        errors.append(change - found.response.change(z))
        sizes.append(change - z @ found.response.slope.T)
    assert np.std(errors) < 0.25 * np.std(sizes)
    assert np.abs(errors).max() < 0.004


def test_components_of_second_order_are_what_the_response_adds(make_recipe):
    found = expectation(make_recipe(), 10.0)
    response = found.response
    drawn = response.draw(np.zeros((3, 3)), 200_000, np.random.default_rng(1))
    stated = sum(c.covariance() for c in found.components if c not in found.alone)
    np.testing.assert_allclose(np.cov(drawn.T), stated, rtol=0.03, atol=3e-5)
    assert any(c.source.endswith(SECOND_ORDER) for c in found.components)
    assert [c.source for c in found.alone] == ["amplitude of the reflections", "model of the reflections"]


def test_a_straight_response_gives_the_mahalanobis_distance(rng):
    response = straight(5, 3, rng)
    alone = 0.1 * np.eye(5) + 0.05
    d = rng.normal(size=(4, 5))
    total = response.slope @ response.slope.T + alone
    expected = np.einsum("ni,ij,nj->n", d, np.linalg.inv(total), d)
    np.testing.assert_allclose(nearest(response, d, np.broadcast_to(alone, (4, 5, 5))), expected, rtol=1e-9)


def test_distances_from_a_bent_response_keep_their_level_where_a_covariance_does_not(rng):
    response, alone = bent(6, 3, 0.05, rng), 1e-3 * np.eye(6)
    d = response.draw(alone, 4000, np.random.default_rng(3))
    found = nearest(response, d, np.broadcast_to(alone, (4000, 6, 6)))
    spread = np.cov(d.T)
    gaussian = np.einsum("ni,ij,nj->n", d - d.mean(axis=0), np.linalg.inv(spread), d - d.mean(axis=0))
    assert np.mean(chi2.sf(found, 6) < 0.01) == pytest.approx(0.01, abs=0.006)
    assert np.mean(chi2.sf(gaussian, 6) < 0.01) > 0.02


def test_a_deviation_on_the_curve_is_as_far_as_its_inputs(rng):
    response = bent(6, 2, 0.1, rng)
    z = np.array([1.5, -1.0])
    alone = 1e-6 * np.eye(6)
    found = nearest(response, response.change(z)[None], alone[None])[0]
    assert found <= np.sum(z**2) + 1e-6
    assert found == pytest.approx(np.sum(z**2), rel=0.01)


def test_combinations_of_values_respond_alike(rng):
    response, basis = bent(4, 2, 0.3, rng), log_basis(4)
    z = rng.normal(size=(5, 2))
    np.testing.assert_allclose(response.within(basis).change(z), response.change(z) @ basis.T)
    np.testing.assert_allclose(
        response.tangent(z[0]) @ np.array([1e-6, 2e-6]),
        response.change(z[0] + [1e-6, 2e-6]) - response.change(z[0]),
        rtol=1e-3,
        atol=1e-10,
    )


def test_an_input_at_the_end_of_what_is_possible_is_straight(make_recipe):
    material = {"albedo": 0.001, "u_albedo": 0.02}
    found = expectation(make_recipe(material=material), 10.0)
    k = found.response.sources.index("albedo of the plastic")
    assert not found.response.bend[:, k].any()
    part = next(c for c in found.components if c.source == "albedo of the plastic")
    np.testing.assert_array_equal(found.response.slope[:, k], part.relative)
