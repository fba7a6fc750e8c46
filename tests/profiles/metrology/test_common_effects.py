"""What all ridges of a map share: effects that no scatter between ridges shows."""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.metrology.ridges import measure_ridges

SPEC = importlib.util.spec_from_file_location("shared_effects", Path(__file__).with_name("shared_effects.py"))
effects = importlib.util.module_from_spec(SPEC)
sys.modules[SPEC.name] = effects
SPEC.loader.exec_module(effects)
Case, draw, usual, within = effects.Case, effects.draw, effects.usual, effects.within

OF_SIGMA = np.pi * np.sqrt(2.0 / np.log(2.0))
"""Lateral period limit over σ: exp(−2π²σ²/D²) = 1/2."""


def measured(case, period_limit_um=None):
    heights, truth = draw(case)
    return measure_ridges(HeightMap(heights, 1.0, 1.0), period_limit_um), truth


def remarks(found, words):
    return any(words in one for one in found.remarks())


@pytest.mark.parametrize("step_um", [0.02, 0.1])
def test_lines_that_drift_are_taken_off_alpha(step_um):
    found, truth = measured(Case(1, row_step=step_um))
    assert within(found.alpha_along, truth["alpha_along"], 2.5)
    assert within(found.alpha_across, truth["alpha_across"], 2.5)
    assert found.line_drift_um == pytest.approx(step_um, rel=0.2)
    assert remarks(found, "lines of the scan")


def test_steps_along_the_ridges_are_told():
    found, truth = measured(Case(2, column_step=0.07))
    assert found.lay_um == pytest.approx(0.07, rel=0.3)
    assert remarks(found, "along the ridges")
    assert within(found.alpha_along, truth["alpha_along"], 2.5)


@pytest.mark.parametrize("step_um", [0.1, 1.4])
def test_rounded_heights_widen_alpha_or_withhold_it(step_um):
    found, truth = measured(Case(3, rounded=step_um))
    for name in ("alpha_along", "alpha_across", "ridge_angle_deg", "height_um", "wall_angle_deg"):
        assert within(getattr(found, name), truth[name], 2.5)
    assert found.height_step_um in (0.0, pytest.approx(step_um))
    if step_um > 1.0:
        assert found.alpha_along.value is None
        assert remarks(found, "rounded")


def test_facets_of_two_heights_have_a_pitch_and_no_angle():
    found, truth = measured(replace(usual(2), rounded=12.0))
    assert found.pitch_um.value == pytest.approx(truth["pitch_um"], abs=3.0 * found.pitch_um.u)
    assert found.stated().ridge_angle_deg.value is None
    assert remarks(found, "rounded to steps of 12 µm")


@pytest.mark.parametrize(("length", "noise"), [(1.0, 0.005), (1.6, 0.05), (2.4, 0.05)])
def test_roughness_of_less_than_three_pixels_is_no_noise(length, noise):
    found, truth = measured(Case(4, length=length, noise=noise))
    assert within(found.alpha_along, truth["alpha_along"], 2.5)
    assert within(found.alpha_across, truth["alpha_across"], 2.5)
    assert remarks(found, "three pixels") or found.alpha_along.u < 0.02 * truth["alpha_along"]


def test_a_rounded_foot_has_a_radius_and_takes_from_the_height():
    heights, truth = draw(Case(5, wall=70.0, foot=6.0))
    found = measure_ridges(HeightMap(heights, 1.0, 1.0))
    assert within(found.height_um, truth["height_um"], 2.5)
    assert within(found.foot_radius_um, 6.0, 2.5)
    assert found.foot_loss.value > 3.0 * found.foot_loss.u
    turned = measure_ridges(HeightMap(-heights, 1.0, 1.0))  # what was the foot is the crest
    assert turned.edge_radius_um.value == pytest.approx(found.foot_radius_um.value, rel=0.02)
    assert turned.height_loss.value == pytest.approx(found.foot_loss.value, rel=0.02)
    assert turned.height_um.value == pytest.approx(found.height_um.value, rel=5e-3)


@pytest.mark.parametrize("end", ["crest", "foot"])
def test_a_radius_of_more_than_ten_pixels_is_measured(end):
    found, truth = measured(Case(9, pitch=90.0, angle=14.0, wall=70.0, **{end: 15.0}))
    for name in ("edge_radius_um", "foot_radius_um", "wall_angle_deg", "height_um"):
        assert within(getattr(found, name), truth[name], 2.5)
    radius = found.edge_radius_um if end == "crest" else found.foot_radius_um
    assert radius.u < 1.0
    assert found.wall_angle_deg.u < 4.0


@pytest.mark.parametrize("blur", [1.0, 2.0])
def test_blur_is_taken_off_where_the_period_limit_is_given_and_else_told(blur):
    heights, truth = draw(Case(10, direction=17.0, wall=76.0, blur=blur))
    surface = HeightMap(heights, 1.0, 1.0)
    names = ("wall_angle_deg", "height_um", "edge_radius_um", "foot_radius_um", "alpha_along", "alpha_across")
    given, without = measure_ridges(surface, OF_SIGMA * blur), measure_ridges(surface)
    for name in names:
        assert within(getattr(given, name), truth[name], 2.5), name
        assert within(getattr(without, name), truth[name], 2.5), name
    assert given.alpha_along.u < without.alpha_along.u
    assert given.period_limit_um == pytest.approx(OF_SIGMA * blur)
    assert not remarks(given, "period limit")
    assert without.seen_limit_um == pytest.approx(OF_SIGMA * blur, rel=0.2)
    assert remarks(without, "period limit")


def test_a_period_limit_that_leaves_no_ridges_is_refused():
    heights, _ = draw(Case(10))
    with pytest.raises(HeightMapError, match="half of the pitch"):
        measure_ridges(HeightMap(heights, 1.0, 1.0), 40.0)
    with pytest.raises(UsageError, match="at least 0"):
        measure_ridges(HeightMap(heights, 1.0, 1.0), -1.0)


def test_ridges_that_change_along_their_length_are_told():
    z, steep = draw(Case(6))[0], draw(Case(6, angle=12.0))[0]
    z[len(z) // 2 :] = steep[len(z) // 2 :]
    found = measure_ridges(HeightMap(z, 1.0, 1.0))
    assert found.varies_along
    assert remarks(found, "not the same along")
    ends = [one.angle_deg.value for one in (found.segments[0], found.segments[-1])]
    assert ends == pytest.approx([10.0, 12.0], abs=0.1)
    same, _ = measured(Case(7))
    assert not same.varies_along
    assert same.remarks() == ()


@pytest.mark.parametrize("tilt", [0.0, 3.0])
def test_the_pitch_on_a_tilted_surface(tilt):
    found, truth = measured(Case(8, tilt=tilt))
    assert found.surface_pitch_um.value == pytest.approx(70.0, abs=3.0 * found.surface_pitch_um.u)
    assert found.pitch_um.value == pytest.approx(truth["pitch_um"], abs=3.0 * found.pitch_um.u)
