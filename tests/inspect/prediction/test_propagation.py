"""First-order propagation against closed forms, and what it costs."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.monte_carlo import draw
from anisoscope.prediction.propagation import TAIL, propagate
from anisoscope.prediction.sensitivity import Shape, State, fixed
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid

POSES = pose_grid((0.0, 90.0, 180.0))
EXACT = InputUncertainty(
    **dict.fromkeys(("alpha_share", "albedo", "index", "light_angle_deg", "stage_deg"), 0.0)
)
EXACT = replace(
    EXACT, stage_zero_deg=0.0, tilt_deg=0.0, tilt_zero_deg=0.0, seating_tilt_deg=0.0, height_map_share=0.0
)
NOMINAL = State(Material(), 10.0)


def of(model, inputs, poses=POSES, **kwargs):
    return propagate(fixed(model), NOMINAL, poses, Convention(), inputs, **kwargs)


def part(budget, source):
    (found,) = (c for c in budget.contributions if c.source == source)
    return found


@pytest.mark.parametrize(
    ("field", "u", "source", "model", "relative"),
    [
        (
            "alpha_share",
            0.04,
            "roughness along the ridges",
            lambda i, o, m: m.alpha_along**2 + 0 * i[:, 0],
            0.08,
        ),
        (
            "alpha_share",
            0.04,
            "roughness across the ridges",
            lambda i, o, m: m.alpha_across**-1 + 0 * i[:, 0],
            -0.04,
        ),
        ("albedo", 0.02, "albedo of the plastic", lambda i, o, m: 3 * m.albedo + 0 * i[:, 0], 0.1),
        ("index", 0.03, "refractive index", lambda i, o, m: m.index**3 + 0 * i[:, 0], 0.06),
        (
            "light_angle_deg",
            0.2,
            "light angle",
            lambda i, o, m: np.sum(i * o, axis=1),
            -np.radians(0.2) * np.tan(np.radians(10)),
        ),
        (
            "tilt_zero_deg",
            0.2,
            "zero of the tilt",
            lambda i, o, m: np.exp(-50 * o[:, 1]),
            [50 * np.radians(0.2), 0.0, -50 * np.radians(0.2)],
        ),
        (
            "stage_zero_deg",
            0.3,
            "zero of the stage",
            lambda i, o, m: np.exp(i[:, 1]),
            [-np.sin(np.radians(10)) * np.radians(0.3), 0.0, np.sin(np.radians(10)) * np.radians(0.3)],
        ),
        ("seating_tilt_deg", 0.3, "seating tilt about y", lambda i, o, m: np.exp(o[:, 0]), -np.radians(0.3)),
        ("seating_tilt_deg", 0.3, "seating tilt about x", lambda i, o, m: np.exp(o[:, 1]), np.radians(0.3)),
    ],
)
def test_sensitivities_are_the_derivatives(field, u, source, model, relative):
    budget = of(model, replace(EXACT, **{field: u}))
    found = part(budget, source)
    np.testing.assert_allclose(
        budget.relative(found.absolute), np.broadcast_to(relative, 3), rtol=2e-3, atol=1e-9
    )
    assert found.correlation == "shared"
    np.testing.assert_allclose(found.covariance(), np.outer(found.absolute, found.absolute))


def test_an_error_of_each_pose_is_independent_and_a_shared_zero_is_not():
    model = lambda i, o, m: np.exp(i[:, 1])  # noqa: E731
    own = part(of(model, replace(EXACT, stage_deg=0.3)), "stage angle of each pose").covariance()
    zero = part(of(model, replace(EXACT, stage_zero_deg=0.3)), "zero of the stage").covariance()
    np.testing.assert_allclose(np.diag(own), np.diag(zero))
    assert np.count_nonzero(own - np.diag(np.diag(own))) == 0
    assert zero[0, 2] == pytest.approx(-zero[0, 0])


def test_covariances_of_all_sources_add_up():
    inputs = replace(EXACT, alpha_share=0.05, albedo=0.01, stage_deg=0.5, tilt_deg=0.2, tilt_zero_deg=0.1)
    budget = of(corrected_of, inputs)
    total = np.sum([c.covariance() for c in budget.contributions], axis=0)
    np.testing.assert_allclose(budget.covariance(), total)
    np.testing.assert_allclose(budget.u() ** 2, np.diag(total))
    assert np.linalg.eigvalsh(total).min() > 0.0


def corrected_of(to_light, to_camera, material):
    from anisoscope.parameters.ridges import RidgeDesign

    return corrected.radiance(to_light, to_camera, RidgeDesign(100.0, 10.0), material)


def test_angles_share_one_call_and_exact_inputs_cost_none():
    calls = []

    def model(to_light, to_camera, material):
        calls.append((material, len(to_light)))
        return to_light[:, 2] * material.albedo

    of(model, replace(EXACT, light_angle_deg=0.1, seating_tilt_deg=0.1, stage_deg=0.1, tilt_deg=0.1))
    assert [count for _, count in calls] == [3 * 11]
    calls.clear()
    of(model, InputUncertainty())
    assert len(calls) == 1 + 2 * 4


def test_dark_poses_are_told_in_radiance_and_marked():
    def model(to_light, to_camera, material):  # black at 180°, where the light comes from −x
        return np.maximum(to_light[:, 0], 0.0) * material.albedo

    budget = of(model, InputUncertainty(stage_zero_deg=0.05))
    assert budget.dark.tolist() == [False, True, True]
    for contribution in budget.contributions:
        assert np.isfinite(contribution.absolute).all()
        assert np.isfinite(budget.relative(contribution.absolute)).all()
    zero = part(budget, "zero of the stage").absolute
    assert zero[1] == pytest.approx(-0.5 * np.sin(np.radians(10.0)) * np.radians(0.05) * 0.2, rel=1e-3)
    assert np.isfinite(budget.covariance()).all()


def test_the_mean_over_the_field_is_shifted_by_the_second_derivative():
    def model(to_light, to_camera, material):
        angle = np.degrees(np.arccos(np.clip(np.sum(to_light * to_camera, axis=1), -1, 1)))
        return 1.0 + 0.01 * (angle - 10.0) ** 2

    shift = part(of(model, replace(EXACT, light_field_deg=3.0)), "light angle over the field").absolute
    np.testing.assert_allclose(shift, 0.01 * 3.0**2 / 3.0, rtol=1e-9)


def test_a_stand_in_lends_its_relative_sensitivity():
    model = lambda i, o, m: m.albedo + 0 * i[:, 0]  # noqa: E731
    meant = np.array([1.0, 2.0, 4.0])
    found = part(of(model, replace(EXACT, albedo=0.02), radiance=meant), "albedo of the plastic")
    np.testing.assert_allclose(found.absolute, 0.1 * meant, rtol=1e-3)


def test_the_top_of_a_lobe_is_known_as_not_linear():
    def model(to_light, to_camera, material):
        return np.exp(-((to_camera[:, 1] / 0.02) ** 2))

    assert of(model, replace(EXACT, seating_tilt_deg=1.0)).not_linear().all()
    flank = lambda i, o, m: 1.0 + o[:, 1]  # noqa: E731
    assert not of(flank, replace(EXACT, seating_tilt_deg=1.0)).not_linear().any()


def test_a_height_that_can_only_be_lost_is_known_as_not_linear():
    def surface(shape):
        return lambda i, o, m: np.full(len(i), 1.0 - shape.height_loss)

    state = replace(NOMINAL, shape=Shape(10.0, 0.0))
    budget = propagate(surface, state, POSES, Convention(), replace(EXACT, height_loss=0.02))
    np.testing.assert_allclose(part(budget, "height loss of the design").absolute, -0.02, rtol=5e-3)
    assert budget.not_linear().all()
    inside = propagate(
        surface, replace(state, shape=Shape(10.0, 0.1)), POSES, Convention(), replace(EXACT, height_loss=0.02)
    )
    assert not inside.not_linear().any()


def test_a_pose_at_the_horizon_is_refused_in_one_line():
    grazing = pose_grid((0.0,), (89.9,))
    directions(grazing, Convention())  # itself still above the horizon
    with pytest.raises(ModelError, match="horizon") as caught:
        of(lambda i, o, m: i[:, 2], replace(EXACT, seating_tilt_deg=0.1), grazing)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "change", [{"albedo": -0.1}, {"index": float("nan")}, {"tilt_deg": float("inf")}, {"ridges_seen": 0}]
)
def test_impossible_uncertainties_are_refused(change):
    with pytest.raises(ModelError):
        InputUncertainty(**change)


def test_a_lobe_that_nobody_measured_is_uncertain_where_its_tail_shows():
    """The change between Beckmann's lobe and one whose tail is one standard uncertainty."""
    design = RidgeDesign(100.0, 10.0)

    def model(to_light, to_camera, material):
        return corrected.radiance(to_light, to_camera, design, material)

    inputs = replace(EXACT, tail=0.5)
    found = part(of(model, inputs), TAIL)
    bare, tailed = (model(*directions(POSES, Convention()), Material(tail=tail)) for tail in (0.0, 0.5))
    np.testing.assert_allclose(found.absolute, bare * np.log(tailed / bare), rtol=1e-6)
    drawn = draw(fixed(model), NOMINAL, POSES, Convention(), inputs, 64, np.random.default_rng(1))
    ratio = drawn.u() / np.abs(found.absolute)  # half of the draws have no tail: it cannot be negative
    assert np.all((ratio > 0.3) & (ratio < 1.2))
