"""Closed forms, calibration of the false alarms, and precedence."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from anisoscope.base.covariance import root
from anisoscope.base.errors import MeasurementError
from anisoscope.decision.decision import contrast_gradient, decide, guarded
from anisoscope.imaging.deviation_map import cell_map, judge_area
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.parameters.geometry import Convention
from anisoscope.prediction.expectation import Component, Expectation
from anisoscope.record.verdict import Verdict
from anisoscope.sim.light.contrasts import contrasts
from anisoscope.sim.light.geometry import pose_grid

KINDS = ("log_ratio", "michelson", "difference")
TABLE = np.array([0.30, 0.05, 0.04])
PASS, FAIL, UNDECIDED = Verdict.PASS, Verdict.FAIL, Verdict.INCONCLUSIVE


def component(relative, kind="measurement", *, shared=False):
    return Component("x", kind, np.asarray(relative, float), shared=shared)


def expected(radiance=TABLE, components=(), tilts=(0.0,)):
    poses = pose_grid((0.0, 90.0, 180.0), tilts)
    return Expectation(
        "corrected", poses, np.asarray(radiance), tuple(components), np.zeros(len(poses)), None, Convention()
    )


def measured(radiance, components=(), cells=None, cell_noise=0.0):
    radiance = np.asarray(radiance, float)
    cells = radiance[:, None, None] * np.ones((1, 40, 40)) if cells is None else cells
    noise = np.full(radiance.size, cell_noise)
    return Measured(radiance, tuple(components), (), cells, noise, Grid((0, 0), 0.025, (40, 40)), None)


@pytest.mark.parametrize(
    ("deviation", "u", "verdict"),
    [
        (0.0, 0.125, PASS),
        (0.25, 0.125, PASS),
        (-0.25, 0.125, PASS),
        (0.2501, 0.125, UNDECIDED),
        (0.5, 0.125, UNDECIDED),
        (-0.7499, 0.125, UNDECIDED),
        (0.75, 0.125, FAIL),
        (-0.75, 0.125, FAIL),
        (0.0, 0.3, UNDECIDED),
        (0.5, 0.0, PASS),
        (0.5001, 0.0, FAIL),
    ],
)
def test_guarded_decision_at_and_beside_its_limits(deviation, u, verdict):
    """Tolerance 0.5, coverage 2: PASS up to 0.5 − 2u, FAIL from 0.5 + 2u, both limits included."""
    assert guarded(deviation, u, 0.5, 2.0)[:2] == (verdict, 2.0 * u)


@pytest.mark.parametrize("deviation", [-0.3, 0.0, 0.21, 0.9])
@pytest.mark.parametrize("u", [0.01, 0.1, 0.5])
def test_conformance_is_the_share_of_the_distribution_within_the_tolerance(deviation, u):
    expected_share = norm(deviation, u).cdf(0.25) - norm(deviation, u).cdf(-0.25)
    assert guarded(deviation, u, 0.25, 1.645)[2] == pytest.approx(expected_share, abs=1e-12)


def test_conformance_without_uncertainty_is_certain():
    assert guarded(0.2, 0.0, 0.25, 1.645)[2] == 1.0
    assert guarded(0.3, 0.0, 0.25, 1.645)[2] == 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_gradient_is_the_derivative(kind):
    poses = pose_grid((0.0, 90.0, 180.0), (0.0, 10.0))
    radiance = np.array([0.3, 0.05, 0.04, 0.2, 0.07, 0.1])
    step = 1e-5

    def value(log_radiance):
        return np.array([getattr(c, kind) for c in contrasts(poses, np.exp(log_radiance))])

    found = contrast_gradient(poses, radiance, kind)
    for pose, unit in enumerate(np.eye(6)):
        difference = (value(np.log(radiance) + step * unit) - value(np.log(radiance) - step * unit)) / (
            2 * step
        )
        np.testing.assert_allclose(found[:, pose], difference, atol=1e-8)


COMPONENTS = (
    component([0.01, 0.02, 0.015]),
    component([0.03, -0.02, 0.01], "prediction", shared=True),
    component([0.02, 0.02, 0.03], "prediction", shared=True),
)


@pytest.mark.parametrize("parts", [100, pytest.param(1000, marks=pytest.mark.statistics)])
@pytest.mark.parametrize("kind", KINDS)
def test_false_alarms_are_as_many_as_stated(make_recipe, rng, kind, parts):
    """Deviations drawn from the stated covariance: p values are uniform."""
    recipe = make_recipe(decision={"contrast": kind, "tolerance": None, "alpha": 0.05}, area=None)
    covariance = 0.04 * sum(c.covariance() for c in COMPONENTS)
    scaled = [replace(c, relative=0.2 * c.relative) for c in COMPONENTS]
    prediction = expected(components=scaled[1:])
    draws = rng.standard_normal((parts, 3)) @ root(covariance)
    found = [decide(prediction, measured(TABLE * np.exp(d), scaled[:1]), recipe) for d in draws]
    p = np.array([f.p_value for f in found])
    for level in (0.01, 0.05, 0.2, 0.5):
        assert np.mean(p < level) == pytest.approx(level, abs=4 * np.sqrt(level * (1 - level) / p.size))
    assert np.mean([f.verdict == FAIL for f in found]) == pytest.approx(np.mean(p < 0.05))
    assert found[0].dof == 2


def test_uncertainties_of_contrasts_are_those_of_the_radiances(make_recipe):
    found = decide(
        expected(components=COMPONENTS[1:]), measured(TABLE, COMPONENTS[:1]), make_recipe(area=None)
    )
    gradient = np.array([[1, -1, 0], [0, 1, -1]])
    covariance = gradient @ sum(c.covariance() for c in COMPONENTS) @ gradient.T
    np.testing.assert_allclose([pair.u for pair in found.contrasts], np.sqrt(np.diag(covariance)))
    squares = np.sum([np.square(row.contributions) for row in found.budget], axis=0)
    np.testing.assert_allclose(squares, np.diag(covariance))
    largest = [max(row.contributions) for row in found.budget]
    assert largest == sorted(largest, reverse=True)


def test_an_error_that_all_poses_share_alike_does_not_touch_ratios(make_recipe):
    common = component([0.1, 0.1, 0.1], shared=True)
    own = component([0.01, 0.01, 0.01])
    with_it, without = (
        decide(expected(), measured(TABLE * 1.01, parts), make_recipe(area=None))
        for parts in ((common, own), (own,))
    )
    assert [p.u for p in with_it.contrasts] == pytest.approx([p.u for p in without.contrasts])
    assert with_it.d2 == pytest.approx(0.0, abs=1e-12)


def test_pairs_are_counted_over_all_tilts(make_recipe):
    recipe = make_recipe(
        poses={"tilts_deg": [0.0, 10.0]}, decision={"tolerance": [0.1, 0.2, 0.3, 0.4]}, area=None
    )
    radiance = np.tile(TABLE, 2)
    found = decide(
        expected(radiance, tilts=(0.0, 10.0)), measured(radiance, [component(np.full(6, 0.01))]), recipe
    )
    assert found.dof == 5
    assert [(p.from_deg, p.tilt_deg, p.tolerance) for p in found.contrasts] == [
        (0.0, 0.0, 0.1),
        (90.0, 0.0, 0.2),
        (0.0, 10.0, 0.3),
        (90.0, 10.0, 0.4),
    ]


OWN = component([0.02, 0.02, 0.02])
OFF, CLOSE, SOME = 1.0, 0.25, 0.15  # ln units; tolerance 0.25, guard 0.0465, significant from about 0.09


def judge(make_recipe, off=0.0, cells=None, **decision):
    recipe = make_recipe(decision=decision)
    return decide(expected(), measured(TABLE * np.exp([off, 0.0, 0.0]), [OWN], cells), recipe)


def deviating_cells(share):
    cells = TABLE[:, None, None] * np.ones((1, 40, 40))
    count = round(share * 40)
    cells[0, :count, :] *= 2.0  # fewer than half of every line along the ridges
    return cells


@pytest.mark.parametrize(
    ("off", "share", "rule", "verdict"),
    [
        (0.0, 0.0, {}, PASS),
        (OFF, 0.0, {}, FAIL),
        (-OFF, 0.0, {}, FAIL),
        (CLOSE, 0.0, {}, UNDECIDED),
        (SOME, 0.0, {}, PASS),
        (SOME, 0.0, {"deviation": "fail"}, FAIL),
        (CLOSE, 0.0, {"deviation": "fail"}, FAIL),
        (SOME, 0.0, {"tolerance": None}, FAIL),
        (0.0, 0.0, {"tolerance": None}, PASS),
        (0.0, 0.25, {}, FAIL),
        (CLOSE, 0.25, {}, FAIL),
        (0.0, 0.25, {"tolerance": None}, FAIL),
    ],
)
def test_fail_beats_inconclusive_beats_pass(make_recipe, off, share, rule, verdict):
    found = judge(make_recipe, off, deviating_cells(share), **rule)
    assert found.verdict == verdict
    assert found.reasons


def test_a_significant_deviation_within_the_tolerance_is_a_warning(make_recipe):
    found = judge(make_recipe, SOME)
    assert found.verdict == PASS
    assert found.reasons[0].startswith("warning: significant deviation")
    assert not judge(make_recipe, 0.0).reasons[0].startswith("warning")


def test_reasons_speak_of_what_decided(make_recipe):
    assert all("0° / 90°, tilt 0°" in reason for reason in judge(make_recipe, OFF).reasons)
    area, mark = judge(make_recipe, 0.0, deviating_cells(0.25)).reasons
    assert area.startswith("25.0% of the area")
    assert re.fullmatch(r"a mark is \d+ µm long \(limit 200 µm\), at x .* mm, y .* mm", mark)


@pytest.mark.parametrize("share", [0.0, 0.025, 0.1, 0.45])
def test_area_share_is_that_of_the_spoiled_cells(make_recipe, share):
    found = judge(make_recipe, 0.0, deviating_cells(share))
    assert found.area.share == pytest.approx(share)
    assert found.deviating.mean() == pytest.approx(share)
    assert found.area.cells == 1600


def test_the_limit_of_golden_parts_finds_what_a_part_that_is_spoiled_all_over_hides(make_recipe, rng):
    cells = TABLE[:, None, None] * np.exp(0.02 * rng.standard_normal((3, 40, 40)))
    good = cell_map(measured(TABLE, cells=cells), make_recipe())
    cells[1] *= np.where(rng.random((40, 40)) < 0.3, np.exp(rng.uniform(0.0, 0.5, (40, 40))), 1.0)
    seen = measured(TABLE, cells=cells)
    own = cell_map(seen, make_recipe())
    assert own.limit > good.limit
    assert own.by(()).deviating().mean() < own.by((good.limit,)).deviating().mean()
    assert own.by((9.0,)).limit == own.limit  # never wider
    stored = replace(own, covariance=None)  # by an earlier version, whose scores were others
    assert stored.by((good.limit,)).limit == own.limit


def test_a_whole_flank_that_is_alike_is_no_area_defect(make_recipe):
    cells = TABLE[:, None, None] * np.ones((1, 40, 40))
    cells[0] *= np.exp(np.sin(0.5 * np.pi * np.arange(40) + 0.3))[None, :]
    assert judge(make_recipe, 0.0, cells).area.share == 0.0


def marked_cells(rng):
    """Cells with marks of every size about the limit."""
    cells = TABLE[:, None, None] * np.exp(0.03 * rng.standard_normal((3, 40, 40)))
    cells[1] *= np.exp(np.where(rng.random((40, 40)) < 0.2, rng.uniform(0.0, 0.8, (40, 40)), 0.0))
    return cells


def test_noise_of_cells_near_the_limit_makes_the_area_uncertain(make_recipe, rng):
    cells = marked_cells(rng)
    calm, noisy = (
        decide(expected(), measured(TABLE, [OWN], cells, cell_noise=noise), make_recipe()).area
        for noise in (0.0, 0.03)
    )
    assert calm.share == noisy.share > 0.0
    assert noisy.u > calm.u


def test_the_share_of_deviating_cells_scatters_by_its_uncertainty(make_recipe, rng):
    """Cells near the limit change sides each by its own noise, not all of them together."""
    noise, recipe, true = 0.02, make_recipe(), marked_cells(rng)
    found = [
        judge_area(one, cell_map(one, recipe), recipe.area, 1.645)[0]
        for one in (
            measured(TABLE, cells=true * np.exp(noise * rng.standard_normal(true.shape)), cell_noise=noise)
            for _ in range(60)
        )
    ]
    shares = np.array([one.share for one in found])
    stated = np.mean([one.u for one in found])
    assert 0.5 < stated / shares.std(ddof=1) < 2.0


def test_cells_too_noisy_to_tell_anything_are_invalid(make_recipe):
    cells = TABLE[:, None, None] * np.ones((3, 40, 40))
    with pytest.raises(MeasurementError, match="frames_per_pose"):
        decide(expected(), measured(TABLE, [OWN], cells, cell_noise=0.1), make_recipe())


@pytest.mark.parametrize(("verdict", "code"), [(PASS, 0), (FAIL, 1), (UNDECIDED, 2), (Verdict.INVALID, 3)])
def test_exit_codes(verdict, code):
    assert verdict.exit_code == code
