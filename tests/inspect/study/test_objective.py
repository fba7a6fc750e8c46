"""Scores: closed forms of contrasts and their noise, and samples that can be repeated."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm, qmc

from anisoscope.base.errors import UsageError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.predict import predict_design
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid, seating_rotation
from anisoscope.study.objective import (
    Noise,
    Part,
    Scoring,
    Tolerances,
    contrast_slopes,
    contrast_values,
    errors_sample,
    score,
    scores,
)


@pytest.mark.parametrize("kind", ["difference", "michelson", "log_ratio"])
def test_nominal_score_is_the_predicted_contrast(kind):
    part = Part(ridge_angle=7.0, alpha_across=0.12)
    poses = pose_grid((0.0, 90.0, 180.0), (-10.0, 0.0))
    predicted = predict_design(RidgeDesign(100.0, 7.0), Material(0.06, 0.12), poses, Convention(), bounces=1)
    each = [abs(getattr(contrast, kind)) for contrast in predicted.contrasts]
    asked = Scoring(kind, (-10.0, 0.0), pairs_deg=((0.0, 90.0), (90.0, 180.0)), bounces=1)
    assert score(part, asked).score == pytest.approx(np.mean(each), rel=1e-3)
    assert score(part, replace(asked, over="worst")).score == pytest.approx(min(each), rel=1e-3)


@pytest.mark.parametrize("bounces", [2, "all"])
def test_with_reflections_the_score_is_that_of_the_prediction(bounces):
    poses, count = pose_grid((0.0, 90.0), (0.0,)), None if bounces == "all" else bounces
    predicted = predict_design(RidgeDesign(100.0, 7.0), Material(), poses, Convention(), bounces=count)
    part, asked = Part(ridge_angle=7.0), Scoring("log_ratio", bounces=bounces)
    found = score(part, asked).score
    assert found == pytest.approx(abs(predicted.contrasts[0].log_ratio), rel=1e-3)
    assert abs(found / score(part, replace(asked, bounces=1)).score - 1.0) > 0.005


@pytest.mark.parametrize("kind", ["difference", "michelson", "log_ratio"])
def test_slopes_are_derivatives(kind):
    first, second, step = np.array([0.3]), np.array([0.1]), 1e-6
    by_first, by_second = contrast_slopes(first, second, kind)
    for slope, up, down in (
        (by_first, (first + step, second), (first - step, second)),
        (by_second, (first, second + step), (first, second - step)),
    ):
        numeric = (contrast_values(*up, kind) - contrast_values(*down, kind)) / (2 * step)
        assert slope == pytest.approx(numeric, rel=1e-6)


def test_noise_of_one_difference_is_that_of_two_photographs():
    noisy = Scoring(noise=Noise(floor=0.01), bounces=1)
    assert score(Part(), noisy).sd == pytest.approx(0.01 * np.sqrt(2.0))


def test_photographs_shared_by_two_pairs_are_counted_as_shared():
    """|L0 - L90| + |L90 - L180| with L90 largest is 2·L90 - L0 - L180: six variances, and half of that sum."""
    part = Part(ridge_angle=2.0, alpha_along=0.3)
    asked = Scoring(pairs_deg=((0.0, 90.0), (90.0, 180.0)), noise=Noise(floor=0.01), bounces=1)
    first = contrast_sign(part, (0.0, 90.0))
    second = contrast_sign(part, (90.0, 180.0))
    expected = np.sqrt(6.0) if first * second < 0 else np.sqrt(2.0)
    assert score(part, asked).sd == pytest.approx(0.5 * 0.01 * expected)


def contrast_sign(part, pair):
    poses = pose_grid(pair)
    predicted = predict_design(
        RidgeDesign(part.pitch, part.ridge_angle),
        Material(part.alpha_along, part.alpha_across),
        poses,
        Convention(),
    )
    return np.sign(predicted.contrasts[0].difference)


def test_log_ratio_noise_is_relative():
    noisy = Scoring("log_ratio", noise=Noise(share=0.01), bounces=1)
    assert score(Part(), noisy).sd == pytest.approx(0.01 * np.sqrt(2.0))


def test_signal_to_noise_is_contrast_over_noise():
    noise = Noise(floor=0.01)
    plain = score(Part(), Scoring(noise=noise, bounces=1))
    assert score(Part(), Scoring(noise=noise, score="snr", bounces=1)).score == pytest.approx(
        plain.mean / plain.sd
    )


def test_without_spread_robust_is_nominal():
    nominal, robust = (
        score(Part(), Scoring(bounces=1)),
        score(Part(), Scoring(tolerances=Tolerances(), bounces=1)),
    )
    assert robust == nominal


def test_small_tolerances_give_the_linear_standard_deviation():
    sd = 0.02
    low, high = (score(Part(ridge_angle=8.0 + d), Scoring(bounces=1)).mean for d in (-0.05, 0.05))
    robust = score(
        Part(ridge_angle=8.0), Scoring(tolerances=Tolerances(ridge_angle=sd), samples=256, bounces=1)
    )
    assert robust.sd == pytest.approx(abs(high - low) / 0.1 * sd, rel=0.02)
    assert robust.score == pytest.approx(robust.mean - 2.0 * robust.sd)


def test_low_quantile_of_a_monotonic_effect_is_the_contrast_there():
    asked = Scoring(tolerances=Tolerances(ridge_angle=0.1), quantile=0.1, samples=256, bounces=1)
    expected = score(
        Part(ridge_angle=9.0 + 0.1 * 1.2816), Scoring(bounces=1)
    ).score  # contrast falls with the angle there
    assert score(Part(ridge_angle=9.0), asked).score == pytest.approx(expected, rel=0.005)


@pytest.mark.parametrize(
    "name", ["ridge_angle", "alpha", "height_loss", "edge_radius", "seating", "stage", "light"]
)
def test_every_tolerance_spreads_the_contrast(name):
    part = Part(ridge_angle=8.0, edge_radius=5.0, height_loss=0.1)
    asked = Scoring(tilts_deg=(-5.0,), tolerances=Tolerances(**{name: 0.05}), samples=16, bounces=1)
    assert score(part, asked).sd > 0.0


@pytest.mark.parametrize("radius", [0.0, 4.0])
def test_parts_of_a_sample_are_those_that_are_predicted_one_by_one(radius):
    """Ridge angle, roughness, height loss and directions of every part, by the corrected model of a single design."""
    tolerances = Tolerances(ridge_angle=0.4, alpha=0.1, height_loss=0.03, seating=0.5, stage=0.3, light=0.2)
    asked = Scoring(
        "log_ratio",
        (-10.0, 10.0),
        pairs_deg=((0.0, 90.0), (90.0, 180.0)),
        tolerances=tolerances,
        samples=8,
        bounces=1,
    )
    part, errors = Part(ridge_angle=8.0, edge_radius=radius), errors_sample(tolerances, 6, 8, 1)
    contrasts = []
    for number in range(8):
        one = {name: float(values[number, 0]) for name, values in errors.items()}
        poses = [
            Pose(pose.stage_deg + turn, pose.tilt_deg)
            for pose, turn in zip(asked.poses, errors["stage"][number], strict=True)
        ]
        ways = directions(tuple(poses), Convention(10.0 + one["light"]))
        seat = seating_rotation(*errors["seating"][number])
        along, across = np.array([0.06, 0.10]) * np.exp(errors["alpha"][number])
        design = RidgeDesign(
            100.0, 8.0 + one["ridge_angle"], height_loss=abs(one["height_loss"]), edge_radius_um=radius
        )
        radiance = corrected.radiance(*(way @ seat for way in ways), design, Material(along, across))
        log = np.abs(np.diff(np.log(radiance).reshape(2, 3), axis=1))
        contrasts.append(log.mean())
    mean, sd = np.mean(contrasts), np.std(contrasts, ddof=1)
    found = score(part, asked)
    assert (found.mean, found.sd) == (pytest.approx(mean, rel=2e-3), pytest.approx(sd, rel=2e-3))
    assert scores((Part(), part, Part(edge_radius=900.0, ridge_angle=5.0)), asked) == pytest.approx(
        [score(Part(), asked).score, found.score, -np.inf]
    )


def test_sample_has_unit_spread_and_can_be_repeated():
    tolerances = Tolerances(ridge_angle=0.5, seating=2.0, stage=1.0)
    sample = errors_sample(tolerances, 3, 256, 4)
    assert {name: values.shape for name, values in sample.items()} == {
        "ridge_angle": (256, 1),
        "seating": (256, 2),
        "stage": (256, 3),
    }
    for name, values in sample.items():
        assert values.std(axis=0) == pytest.approx(getattr(tolerances, name), rel=0.05)
        assert values.mean(axis=0) == pytest.approx(0.0, abs=0.05 * getattr(tolerances, name))
        assert (values == errors_sample(tolerances, 3, 256, 4)[name]).all()
    assert errors_sample(Tolerances(), 3, 16, 1) == {}


def test_cached_sample_is_the_computed_one(tmp_path, monkeypatch):
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path))
    tolerances = Tolerances(ridge_angle=0.5, seating=2.0)
    points = qmc.Sobol(3, rng=np.random.default_rng(7)).random(16)
    computed, cached = (errors_sample(tolerances, 2, 16, 7) for _ in range(2))
    assert len(list(tmp_path.glob("sobol-points/*.entry"))) == 1
    for sample in (computed, cached):
        assert np.hstack([sample["ridge_angle"] / 0.5, sample["seating"] / 2.0]) == pytest.approx(
            norm.ppf(points)
        )
    other = errors_sample(tolerances, 2, 16, 8)
    assert not np.allclose(other["seating"], cached["seating"])


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"samples": 60}, "power of two"),
        ({"quantile": 0.9}, "quantile"),
        ({"z": -1.0}, "z must"),
        ({"score": "snr"}, "needs noise"),
    ],
)
def test_senseless_scoring_is_refused(wrong, match):
    with pytest.raises(UsageError, match=match):
        Scoring(**wrong)
    with pytest.raises(UsageError, match="tolerance of stage"):
        Tolerances(stage=-1.0)
    with pytest.raises(UsageError, match="noise"):
        Noise(floor=-1.0)
