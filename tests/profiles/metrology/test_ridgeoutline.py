"""The blurred outline against numerical convolution, and what it was made of."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from anisoscope.profiles.metrology.ridgeoutline import SIGMA_OF_LIMIT, Outline, best_fit

SPEC = importlib.util.spec_from_file_location("shared_effects", Path(__file__).with_name("shared_effects.py"))
effects = importlib.util.module_from_spec(SPEC)
sys.modules[SPEC.name] = effects
SPEC.loader.exec_module(effects)
Case, largest_radius, outline = effects.Case, effects.largest_radius, effects.outline


def about_the_wall(case, level=0.0):
    """Heights of a case about a wall at x = 0 every half pixel, blurred by a sum over a fine grid."""
    x, z, height = outline(case)
    fine = np.arange(-3.0 * case.pitch, 3.0 * case.pitch, 0.01)
    heights = np.minimum(np.interp(fine, x, z, period=case.pitch), z.max() - level)
    if case.blur:
        t = np.arange(-6.0 * case.blur, 6.0 * case.blur + 0.005, 0.01)
        weights = np.exp(-0.5 * (t / case.blur) ** 2)
        heights = np.convolve(heights, weights / weights.sum(), mode="same")
    at = np.arange(-0.4 * case.pitch, 0.4 * case.pitch, 0.5)
    return at, np.interp(at, fine, heights), height


def outline_of(case, level=0.0):
    at, heights, height = about_the_wall(case, level)
    fall, u = np.tan(np.radians(case.angle)), np.full(at.size, 0.01)
    behind = np.interp(0.3 * case.pitch, at, heights) + 0.3 * fall * case.pitch
    return Outline(at, heights, u, fall, behind, case.pitch, (0.0, 4.0), case.blur), height


@pytest.mark.parametrize("blur", [0.0, 1.0, 2.5])
@pytest.mark.parametrize(("crest", "foot"), [(0.0, 0.0), (0.4, 0.0), (0.3, 0.3)])
def test_blur_is_taken_off(blur, crest, foot):
    case = Case(wall=72.0, blur=blur)
    case.crest, case.foot = largest_radius(case, crest), largest_radius(case, foot)
    given, height = outline_of(case)
    fit = best_fit(given, 1.0)
    wall, full, loss, radius, _, filled, below, _ = fit.shape(fit.found)
    assert fit.outline.level == (False, False)
    assert wall == pytest.approx(72.0, abs=0.3)
    assert full * (1.0 - loss - filled) == pytest.approx(height, abs=0.1)
    assert radius == pytest.approx(case.crest, abs=0.03 * case.crest + 0.5)
    assert below == pytest.approx(case.foot, abs=0.03 * case.foot + 0.5)
    assert np.abs(given.at(given.x, fit.found) - given.height).max() < 0.06


def test_a_level_crest_under_blur():
    given, _ = outline_of(Case(wall=72.0, blur=1.0), level=1.5)
    fit = best_fit(given, 1.0)
    assert fit.outline.level == (True, False)
    assert fit.found[2] == pytest.approx(1.5, abs=0.02)


def test_the_width_of_an_unknown_blur():
    given, _ = outline_of(Case(wall=76.0, blur=1.3))
    fit = given.fitted(1.0, free=(False, False, True))
    assert fit.found[-1] == pytest.approx(1.3, abs=0.02)
    assert fit.shape(fit.found)[0] == pytest.approx(76.0, abs=0.2)


def test_other_heights_to_first_order():
    case = Case(wall=70.0, blur=1.0, crest=4.0)
    fit = best_fit(outline_of(case)[0], 1.0)
    given, _ = outline_of(Case(wall=70.3, blur=1.0, crest=4.0))
    moved = fit.shape(fit.moved(given.x, given.height))
    assert moved[0] == pytest.approx(70.3, abs=0.1)
    assert fit.misfit()[0] < 0.5


def test_half_of_the_height_at_the_period_limit():
    assert np.exp(-2.0 * (np.pi * SIGMA_OF_LIMIT) ** 2) == pytest.approx(0.5)
