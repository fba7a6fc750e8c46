"""The mixture of step widths against the reference figures, its optimality, and its own Monte Carlo."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.design.lobe import LobeTask, design_axis, design_lobe, gaussian
from anisoscope.sim.light.wave.claims import lobe
from anisoscope.sim.light.wave.sampling import steps_profile

TASK = LobeTask(0.04)


def test_a_lobe_of_0_04_is_missed_by_what_the_reference_says():
    found = design_axis(TASK)
    assert found.rel_l2 <= 0.044
    assert found.one_width == pytest.approx(0.065, abs=0.003)
    assert found.intrinsic == pytest.approx(0.04, abs=0.002)
    assert found.probabilities.sum() == pytest.approx(1.0, abs=1e-12)
    assert found.probabilities.min() >= 0.0
    assert found.widths_um.min() >= 2.0
    assert found.feasible


def test_the_achieved_lobe_is_the_closed_form_of_the_widths_that_are_drawn():
    found = design_axis(TASK)
    expected = lobe(2.0 * found.h / 0.5, found.widths_um, found.probabilities, 16.0)
    np.testing.assert_allclose(found.achieved, expected, rtol=1e-6, atol=1e-8)
    assert np.linalg.norm(found.unreachable) / np.linalg.norm(found.target) == pytest.approx(
        found.rel_l2, rel=1e-3
    )


def test_no_other_mixture_comes_closer():
    found, rng = design_axis(TASK), np.random.default_rng(3)
    target = gaussian(found.h, 0.04)
    for _ in range(30):
        other = found.probabilities * np.exp(0.3 * rng.normal(size=found.probabilities.size))
        curve = lobe(2.0 * found.h / 0.5, found.widths_um, other, 16.0)
        scale = (curve @ target) / (curve @ curve)
        assert np.linalg.norm(scale * curve - target) / np.linalg.norm(target) >= found.rel_l2 - 1e-9


def test_surfaces_drawn_from_the_design_reflect_it():
    found, rng = design_axis(TASK), np.random.default_rng(5)
    pixel, count = 0.25, 4096
    f = 2.0 * found.h[::20] / 0.5
    x = (np.arange(count) + 0.5) * pixel
    turn = np.exp(-2j * np.pi * np.outer(f, x)) * np.sinc(f * pixel)[:, None] * pixel
    waves = [1.0 - 16.0 * steps_profile(found.widths, (0.0, 0.125), count, pixel, rng) for _ in range(300)]
    seen = np.mean(np.abs(turn @ np.transpose(waves)) ** 2, axis=1) / (count * pixel)
    expected = lobe(f, found.widths_um, found.probabilities)
    assert np.linalg.norm(seen - expected) / np.linalg.norm(expected) < 4.0 / np.sqrt(300.0)
    assert abs(seen.sum() / expected.sum() - 1.0) < 0.1


def test_a_lobe_too_wide_for_the_features_says_so_and_what_would_do():
    found = design_axis(replace(TASK, sigma=0.06))
    assert found.rel_l2 == pytest.approx(0.214, abs=0.005)
    assert not found.feasible
    with pytest.raises(
        ModelError, match=r"out of reach: 21\.\d %.*features of 2 µm reach σ = 0\.04\d.*1\.4 µm"
    ):
        found.check()
    finer = design_axis(replace(TASK, sigma=0.06, min_width_um=1.25))
    finer.check()


def test_a_lobe_narrower_than_the_source_is_told_apart_from_one_too_wide():
    with pytest.raises(ModelError, match="larger --coherence"):
        design_axis(replace(TASK, sigma=0.004)).check()


def test_an_anisotropic_lobe_misses_what_both_axes_miss_together():
    found = design_lobe(TASK, replace(TASK, sigma=0.02))
    wanted = np.outer(found.y.target, found.x.target)
    off = np.outer(found.y.achieved, found.x.achieved) - wanted
    assert found.rel_l2 == pytest.approx(np.linalg.norm(off) / np.linalg.norm(wanted), rel=1e-9)
    found.check()


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"sigma": 0.0}, "between 0 and 1"),
        ({"sigma": float("nan")}, "between 0 and 1"),
        ({"max_width_um": 2.0}, "leave no choice"),
        ({"wavelength_um": 0.0}, "100 to 20000 nm"),
        ({"coherence_um": 0.0}, "positive coherence"),
    ],
)
def test_tasks_that_are_none_are_refused(change, match):
    with pytest.raises(ModelError, match=match):
        replace(TASK, **change)
