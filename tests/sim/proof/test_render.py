"""Proofs with what photographs show, pictures from readings, and the comparison of models."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.colour.observer import white_point
from anisoscope.sim.light.colour.spaces import linear_srgb
from anisoscope.sim.light.ink.model import brdf
from anisoscope.sim.light.ink.shading import Light, picture
from anisoscope.sim.proof.comparison import compare, rmse, ssim, synthetic_readings, two_lights
from anisoscope.sim.proof.measured import Measured, deviation, measured_picture
from anisoscope.sim.proof.render import Extras, adaptation, direction, proof_picture, to_screen
from anisoscope.sim.proof.scene import Scene, surface

NOTHING = np.zeros((1, 1, 3))


def test_without_extras_it_is_the_picture_of_the_inks(inks, d65):
    where = surface(Scene("cylinder", 20, 10), 32, 32)
    cover, lights = np.full((1, 1, 3), 0.3), [Light(direction(120, 50), np.pi, d65)]
    np.testing.assert_array_equal(
        proof_picture(where, inks, lights, cover), picture(where, inks, lights, coverage=cover)
    )


def test_a_bare_sheet_reflects_its_share_alike_in_all_models(inks, d65):
    where = surface(Scene("plane"), 8, 8)
    lights = [Light((0.0, 0.6, 0.8), np.pi, d65)]
    half = np.full((1, 1, 3), 1.0 / 6.0)
    white = linear_srgb(white_point(d65))
    for model in ("goniochromatic", "schlick"):
        shown, inked = (
            proof_picture(where, inks, lights, half, model=model, substrate=share) for share in (0.4, 0.0)
        )
        np.testing.assert_allclose((shown - inked)[4, 4], 0.5 * 0.4 * 0.8 * white, rtol=1e-5)


def test_single_scattering_head_on_is_albedo_over_eight(inks):
    lamp = standard("a")
    where = surface(Scene("plane"), 8, 8)
    found = proof_picture(
        where, inks, [Light((0, 0, 1), np.pi, lamp)], NOTHING, extras=Extras(scattering=0.4)
    )
    # π · ϖ/(4π·(1 + 1)), in the colour of the light
    np.testing.assert_allclose(found[4, 4], 0.4 / 8 * linear_srgb(white_point(lamp)), rtol=1e-5)


def test_the_broad_highlight_sends_back_its_share(inks, d65):
    """∫ f cosθo dω for light from above is the share itself; the eye stays, plane and light turn by reciprocity."""
    tilt = np.radians(np.arange(0.5, 90))
    total = 0.0
    for angle in tilt:
        where = surface(Scene("plane", yaw_deg=float(np.degrees(angle))), 3, 3)
        normal = tuple(where.normal[1, 1].tolist())
        seen = proof_picture(where, inks, [Light(normal, np.pi, d65)], NOTHING, extras=Extras(phong=0.1))[
            1, 1
        ]
        total += seen[1] / np.pi * np.cos(angle) * 2 * np.pi * np.sin(angle) * np.radians(1.0)
    white = linear_srgb(white_point(d65))[1]
    # the modified Phong lobe along the normal: (s + 2)/(2π) ∫ cos^s θ cosθ dω = 1
    assert total / white == pytest.approx(0.1, rel=2e-3)


def test_light_from_behind_reaches_the_shadow_only(inks, d65):
    where = surface(Scene("sphere"), 48, 48)
    lights = [Light(direction(180, 10), np.pi, d65)]
    cover = np.full((1, 1, 3), 1 / 3)
    plain = proof_picture(where, inks, lights, cover)
    more = proof_picture(where, inks, lights, cover, extras=Extras(behind=0.2)) - plain
    lit = where.normal @ np.array(lights[0].to_light, dtype=np.float32)
    assert np.abs(more[lit > 0.01]).max() == 0.0
    assert more[(lit < -0.1) & (where.normal[..., 2] > 0.1)].max(axis=-1).min() > 0.0


@pytest.mark.parametrize(
    "wrong", [{"phong": -0.1}, {"scattering": 1.5}, {"behind": float("nan")}, {"shininess": -1.0}]
)
def test_extras_that_cannot_be(wrong):
    with pytest.raises(ModelError):
        Extras(**wrong)


def test_the_white_of_the_light_becomes_white_where_it_is_adapted():
    lamp = standard("a")
    white = linear_srgb(white_point(lamp))
    assert to_screen(white, 1.0, adaptation(lamp)).tolist() == [255, 255, 255]
    assert to_screen(white).tolist() != [255, 255, 255]
    assert to_screen([0.25, 0.25, 0.25], 0.5).tolist() == to_screen([0.125] * 3).tolist()


def test_projected_deviation_is_that_of_vectors(rng):
    vectors = rng.normal(size=(50, 3))
    vectors[:, 2] = np.abs(vectors[:, 2])
    normal = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    light, eye = np.array(direction(40, 60)), np.array([0.0, 0.0, 1.0])
    found = deviation(normal, light, eye)
    mirrored = 2 * (normal @ light)[:, None] * normal - light
    apart = eye - mirrored
    apart -= np.sum(apart * normal, axis=1, keepdims=True) * normal
    np.testing.assert_allclose(found[:, 1], np.linalg.norm(apart, axis=1), atol=1e-12)
    np.testing.assert_allclose(found[:, 0], np.sqrt(1 - (normal @ light) ** 2), atol=1e-12)


def test_a_picture_from_dense_readings_is_that_of_the_model(inks):
    """In the plane of incidence, where readings are meant to be exact."""
    ink = inks[1]
    light, seen = (
        part.ravel() for part in np.meshgrid(np.arange(0, 89.0), np.arange(-88, 88.1, 1.0), indexing="ij")
    )
    to_light, to_eye = (
        np.stack([s * np.sin(np.radians(a)), 0 * a, np.cos(np.radians(a))], -1)
        for s, a in ((-1, light), (1, seen))
    )
    measured = Measured(light, seen, ink.nm, brdf(ink, to_light, to_eye))
    where = surface(Scene("cylinder", aspect=2.0), 3, 201)
    lights = (Light(direction(180, 70), np.pi, standard("d65")),)
    (got, known), expected = measured_picture(where, measured, lights), picture(where, [ink], lights)
    assert known.all()
    # mirror-symmetric about the deviation vector only up to the shift term: the paper's assumption
    assert np.abs(got - expected).max() < 0.04 * expected.max()


def test_readings_that_make_no_picture(inks):
    nm = inks[0].nm
    few = np.array([20.0, 30.0])
    with pytest.raises(ModelError, match="4 places"):
        Measured(few, few, nm, np.ones((2, nm.size)))
    many = np.linspace(20, 60, 5)
    with pytest.raises(ModelError, match="finite"):
        Measured(many, many, nm, np.full((5, nm.size), np.nan))


def test_similarity_and_error_of_known_pictures(rng):
    one, mask = rng.random((64, 64, 3)), np.ones((64, 64), dtype=bool)
    assert (rmse(one, one, mask), ssim(one, one, mask)) == (0.0, pytest.approx(1.0))
    assert rmse(one, one + 0.1, mask) == pytest.approx(0.1)
    # constant pictures: SSIM is its brightness term (2ab + c1)/(a² + b² + c1), c1 = 0.01²
    a, b = np.full((64, 64, 3), 0.5), np.full((64, 64, 3), 0.25)
    assert ssim(a, b, mask) == pytest.approx((2 * 0.125 + 1e-4) / (0.25 + 0.0625 + 1e-4), rel=1e-6)
    half = mask.copy()
    half[:, 32:] = False
    assert rmse(np.where(half[..., None], one, 0.0), one, half) == 0.0


def test_our_model_stands_nearer_to_made_up_readings_than_the_standard_ones(inks):
    for ink, rng in zip(inks, np.random.default_rng(3).spawn(3), strict=True):
        found = compare(synthetic_readings(ink, rng), ink, size=128, repeats=1)
        ours, *standards = found.rows
        assert ours.model == "goniochromatic"
        for other in standards:
            assert ours.rmse < other.rmse
            assert ours.ssim > other.ssim
        assert 0.0 < ours.frame_s < np.inf
        assert np.mean(found.reference[found.mask].max(axis=-1) > 1.0 - 1e-9) == pytest.approx(
            0.005, abs=0.002
        )


def test_the_ordering_turns_where_the_readings_come_from_the_standard_model(inks):
    """The comparison favours nobody."""
    ink = inks[1]
    made = synthetic_readings(ink, np.random.default_rng(0), noise=0.0, angle_error_deg=0.0, retro=0.0)
    to_light, to_eye = (
        np.stack([s * np.sin(np.radians(a)), 0 * a, np.cos(np.radians(a))], axis=-1)
        for s, a in ((-1, made.theta_i_deg), (1, made.theta_o_deg))
    )
    found = compare(replace(made, value=brdf(ink, to_light, to_eye, "schlick")), ink, size=96, repeats=0,
                    models=("goniochromatic", "schlick"))  # fmt: skip
    assert found.rows[1].rmse < found.rows[0].rmse
    assert np.isnan(found.rows[0].frame_s)


def test_what_lies_beyond_the_readings_takes_no_part(inks):
    """Readings of a light at 40° to 50° are those of a ring of the sphere about each light's middle."""
    made = synthetic_readings(inks[0], np.random.default_rng(0))
    few = (made.theta_i_deg >= 40.0) & (made.theta_i_deg <= 50.0)
    part = replace(
        made, theta_i_deg=made.theta_i_deg[few], theta_o_deg=made.theta_o_deg[few], value=made.value[few]
    )
    all_of_it, ring = (
        compare(one, inks[0], size=96, repeats=0, models=("goniochromatic",)) for one in (made, part)
    )
    assert ring.measured_share == pytest.approx(
        ring.mask.sum() / all_of_it.mask.sum() * all_of_it.measured_share
    )
    assert ring.measured_share < 0.3
    assert 0.6 < all_of_it.measured_share < 0.8
    normal = surface(Scene("sphere"), 96, 96).normal
    for light in two_lights(standard("d65")):
        cosine = normal @ np.array(light.to_light)
        slanted = np.degrees(np.arccos(cosine[ring.mask & (cosine > 0.0)]))
        assert 25.0 < slanted.min() < slanted.max() < 65.0  # a step beyond the readings


def test_small_pictures_and_dark_readings_are_refused(inks, d65):
    made = synthetic_readings(inks[0], np.random.default_rng(0))
    with pytest.raises(ModelError, match="32 pixels"):
        compare(made, inks[0], size=16)
    with pytest.raises(ModelError, match="no light"):
        compare(replace(made, value=0.0 * made.value), inks[0], size=32)
    assert two_lights(d65)[0].irradiance == 2 * two_lights(d65)[1].irradiance
