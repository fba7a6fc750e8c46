"""The equations of the paper, by other ways of computing them."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.light.ink import tio2
from anisoscope.sim.light.ink.angles import cos_half_sum, goniometer, half_vector, shift
from anisoscope.sim.light.ink.distributions import density, masking, smith_lambda
from anisoscope.sim.light.ink.model import MODELS, brdf, brdf_at_angles


def test_half_sum_equals_that_of_the_angles(rng):
    """Eq. 6 to 1e-12, the angles from cross products, so that no arc cosine loses digits."""
    vectors = rng.standard_normal((2, 5000, 3))
    vectors[..., 2] = np.abs(vectors[..., 2])
    vectors /= np.linalg.norm(vectors, axis=-1, keepdims=True)
    angle = np.arctan2(np.hypot(vectors[..., 0], vectors[..., 1]), vectors[..., 2])
    found = cos_half_sum(vectors[0, :, 2], vectors[1, :, 2])
    np.testing.assert_allclose(found, np.cos(0.5 * (angle[0] + angle[1])), atol=1e-12)


def test_rounding_beyond_one_is_no_nan():
    beyond = np.nextafter(1.0, 2.0)
    assert shift(np.array([beyond, 1 + 1e-9]), np.array([beyond, 1.0])) == pytest.approx(0.0)
    assert shift(np.array(-1e-17), np.array(0.0)) == pytest.approx(1.0)


def test_eq_5_by_hand(make_ink):
    """Eq. 5 with angles in plain trigonometry."""
    ink = make_ink()
    for i, o in ((20.0, 35.0), (60.0, 60.0), (70.0, -30.0), (0.0, 0.0)):
        half = np.radians((i - o) / 2)
        x = 1 - np.cos(np.radians((i + abs(o)) / 2))
        bottom = 4 * np.pi * ((0.19**2 - 1) * np.cos(half) ** 2 + 1) ** 2
        expected = 0.19**2 * np.array(ink.rho) * np.exp(np.array(ink.c) * x) / bottom
        np.testing.assert_allclose(brdf_at_angles(ink, i, o), expected, rtol=1e-10)


def test_eq_7_is_eq_5_in_the_mirror_direction(make_ink):
    ink = make_ink()
    theta = np.arange(0.0, 81.0, 5.0)
    light, camera = goniometer(theta, theta)
    np.testing.assert_allclose(camera, light * [-1, -1, 1], atol=1e-15)
    x = 1 - np.cos(np.radians(theta))[:, None]
    expected = np.array(ink.rho) * np.exp(np.array(ink.c) * x) / (4 * np.pi * 0.19**2)
    np.testing.assert_allclose(brdf_at_angles(ink, theta, theta), expected, rtol=1e-11)


def test_eq_7_read_literally_is_17_to_526_times_too_small(make_ink):
    """With ω_i = ω_o the half vector is the light itself."""
    ink = make_ink()
    light, camera = goniometer(np.array([20.0, 65.0]), np.array([20.0, 65.0]))
    ratio = brdf(ink, light, camera) / brdf(ink, light, light)
    np.testing.assert_allclose(ratio.min(axis=1), [17.0, 525.9], rtol=1e-3)
    np.testing.assert_allclose(ratio.max(axis=1), [17.0, 525.9], rtol=1e-3)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("kind", ["ggx", "beckmann"])
def test_all_models_are_reciprocal(make_ink, upward, model, kind):
    ink = make_ink(distribution=kind, alpha_y=0.31, brush_deg=25.0)
    light, camera = upward(300), upward(300)
    np.testing.assert_allclose(brdf(ink, light, camera, model), brdf(ink, camera, light, model), rtol=1e-9)


@pytest.mark.parametrize("kind", ["ggx", "beckmann"])
@pytest.mark.parametrize("alphas", [(0.19, 0.19), (0.3, 0.15)])
def test_distributions_have_unit_projected_area(hemisphere, kind, alphas):
    directions, solid = hemisphere(200, 240)
    assert np.sum(density(directions, *alphas, kind) * directions[:, 2] * solid) == pytest.approx(
        1.0, rel=1e-5
    )


@pytest.mark.parametrize("kind", ["ggx", "beckmann"])
def test_smith_masking_keeps_the_visible_area(hemisphere, kind):
    """∫ G1(ω, h) (ω·h)₊ D(h) dω_h = cosθ (Heitz 2014, Eq. 14)."""
    normals, solid = hemisphere(200, 240)
    for theta in (30.0, 70.0, 85.0):
        direction = np.array([np.sin(np.radians(theta)), 0.0, np.cos(np.radians(theta))])
        seen = np.maximum(normals @ direction, 0.0) * density(normals, 0.3, 0.2, kind)
        g1 = 1 / (1 + smith_lambda(direction, 0.3, 0.2, kind))
        assert g1 * np.sum(seen * solid) == pytest.approx(direction[2], rel=2e-3)


def test_the_papers_distribution_is_ggx(rng):
    """Eq. 3 and the form of Walter 2007 (Eq. 33) are the same function."""
    theta, alpha = rng.uniform(0, 1.5, 200), 0.19
    half = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=1)
    walter = alpha**2 / (np.pi * np.cos(theta) ** 4 * (alpha**2 + np.tan(theta) ** 2) ** 2)
    printed = alpha**2 / (np.pi * ((alpha**2 - 1) * np.cos(theta) ** 2 + 1) ** 2)
    np.testing.assert_allclose(density(half, alpha, alpha), walter, rtol=1e-9)
    np.testing.assert_allclose(density(half, alpha, alpha), printed, rtol=1e-9)


def test_brushing_turns_with_its_direction(make_ink, upward):
    light, camera = upward(50), upward(50)
    turn = np.radians(40.0)
    matrix = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    straight = brdf(make_ink(alpha_y=0.3), light, camera)
    turned = brdf(make_ink(alpha_y=0.3, brush_deg=40.0), light @ matrix.T, camera @ matrix.T)
    np.testing.assert_allclose(turned, straight, rtol=1e-9)
    quarter = brdf(make_ink(alpha=0.3, alpha_y=0.19, brush_deg=90.0), light, camera)
    np.testing.assert_allclose(quarter, brdf(make_ink(alpha=0.19, alpha_y=0.3), light, camera), rtol=1e-9)


def test_head_on_all_but_tio2_agree_and_tio2_has_its_index(make_ink):
    """At normal incidence Schlick's term is ρ, the Fresnel term ((n − 1)² + k²)/((n + 1)² + k²)."""
    ink = make_ink()
    ours = brdf_at_angles(ink, 0.0, 0.0)
    np.testing.assert_allclose(brdf_at_angles(ink, 0.0, 0.0, "schlick"), ours, rtol=1e-12)
    for source in tio2.source_names():
        n = tio2.index(ink.nm, source)
        expected = ours * ((n.real - 1) ** 2 + n.imag**2) / ((n.real + 1) ** 2 + n.imag**2)
        found = brdf_at_angles(ink, 0.0, 0.0, "tio2", tio2_source=source)
        np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_fresnel_of_a_dielectric_and_at_brewsters_angle():
    n = np.array([2.4 + 0j])
    brewster = np.cos(np.arctan(2.4))
    inside = np.sqrt(1 - (1 - brewster**2) / 2.4**2)
    s = ((brewster - 2.4 * inside) / (brewster + 2.4 * inside)) ** 2
    assert tio2.fresnel(np.array(brewster), n)[0] == pytest.approx(0.5 * s)
    assert tio2.fresnel(np.array(0.0), n)[0] == pytest.approx(1.0)


def test_torrance_sparrow_by_hand(make_ink):
    """Eq. 2 with G from the angles of the plane of incidence."""
    ink = make_ink()
    i, o = np.radians([50.0, 20.0])
    light, camera = goniometer(np.array(50.0), np.array(20.0))
    cos_d = light @ half_vector(light, camera)
    lambdas = [(np.sqrt(1 + (0.19 * np.tan(angle)) ** 2) - 1) / 2 for angle in (i, o)]
    cos_h = np.cos((i - o) / 2)
    d = 0.19**2 / (np.pi * ((0.19**2 - 1) * cos_h**2 + 1) ** 2)
    rho = np.array(ink.rho)
    f = rho + (1 - rho) * (1 - cos_d) ** 5
    expected = f * d / (1 + sum(lambdas)) / (4 * np.cos(i) * np.cos(o))
    np.testing.assert_allclose(brdf(ink, light, camera, "schlick"), expected, rtol=1e-10)
    assert masking(light, camera, 0.19, 0.19) == pytest.approx(1 / (1 + sum(lambdas)))


def test_below_the_horizon_nothing(make_ink):
    down = np.array([[0.6, 0.0, -0.8]])
    assert np.all(brdf(make_ink(), down, np.array([0.0, 0.0, 1.0])) == 0.0)
    assert np.all(brdf(make_ink(), np.array([0.0, 0.0, 1.0]), down, "tio2") == 0.0)


@pytest.mark.parametrize("model", MODELS)
def test_opposite_directions_have_no_half_vector_and_no_light(make_ink, model):
    up = np.array([0.0, 0.0, 1.0])
    assert np.all(half_vector(up, -up) == 0.0)
    assert np.all(brdf(make_ink(), up, -up, model) == 0.0)


def test_unknown_names_are_refused(make_ink):
    with pytest.raises(ModelError, match="goniochromatic"):
        brdf_at_angles(make_ink(), 0.0, 0.0, "phong")
    with pytest.raises(ModelError, match="siefke"):
        tio2.index(np.array([500.0]), "kischkat")
    with pytest.raises(ModelError, match="380 to 780"):
        tio2.index(np.array([350.0]))
