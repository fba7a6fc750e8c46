"""Pictures by gradients: the gradient itself, a picture that comes out, and what is refused."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from anisoscope.base.errors import ModelError
from anisoscope.sim.design.gradient import (
    DARKEST,
    DISPLAY,
    LARGE,
    LIKENESS,
    SIMILAR,
    PictureTask,
    _Line,
    _Wanted,
    design_picture,
    judged,
)
from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.colour.spaces import SRGB_TO_XYZ, SRGB_WHITE, XYZ_TO_SRGB, ciede2000, lab

LEVELS = tuple((np.arange(16) * 0.55 / 32.0).tolist())


def spot(side=16):
    y, x = np.mgrid[-1.0 : 1.0 : side * 1j, -1.0 : 1.0 : side * 1j]
    return np.exp(-6.0 * ((x - 0.4) ** 2 + (y - 0.3) ** 2))[..., None]


def task(**more):
    return PictureTask(spot(), LEVELS, **({"cells": 64, "coherence_um": 12.0} | more))


@pytest.mark.parametrize("colour", [False, True])
def test_gradient_is_that_of_differences(colour):
    """Of the error of a whole picture, by one height: two wavelengths in colour, through CIELAB."""
    lamp = standard("d65") if colour else None
    wanted_picture = (
        np.concatenate([spot(), 0.3 * spot() + 0.1, 0.5 - 0.4 * spot()], axis=2) if colour else spot()
    )
    asked = PictureTask(wanted_picture, LEVELS, lamp, cells=64, coherence_um=12.0)
    lines, wanted = [_Line(asked, um) for um in ((0.48, 0.6) if colour else (0.55,))], _Wanted(asked)
    weights = np.array([[0.3, 0.4, 1.0], [1.0, 0.9, 0.1]]) if colour else np.ones((1, 1))
    height = np.random.default_rng(1).uniform(0.0, 0.25, (64, 64))

    def light(heights):
        done = [line.light(line.wave(heights)) for line in lines]
        return np.einsum("bij,bc->ijc", np.stack([one[0] for one in done]).astype(np.float64), weights), done

    first, done = light(height)
    scale = wanted.scale(first)
    _, by_light = wanted.error(first, scale)
    found = sum(
        line.gradient((by_light @ weight).astype(np.float32), line.wave(height), one[1])
        for line, weight, one in zip(lines, weights, done, strict=True)
    )
    # the derivative of the error by the light holds for all light; that of the light by a height is the line's
    for place in ((3, 5), (40, 17)):
        ends = []
        for sign in (1.0, -1.0):
            moved = height.copy()
            moved[place] += sign * 0.01
            ends.append(float(np.sum(by_light * light(moved)[0])))
        assert found[place] == pytest.approx((ends[0] - ends[1]) / 0.02, rel=0.03, abs=1e-7)


def test_error_in_colour_is_near_de2000_and_its_derivative_that_of_differences():
    rng = np.random.default_rng(3)
    picture = rng.uniform(0.05, 1.0, (16, 16, 3))
    wanted = _Wanted(PictureTask(picture, LEVELS, standard("d65"), cells=64, coherence_um=12.0))
    other = wanted.light * rng.uniform(0.93, 1.07, wanted.light.shape)
    due = ciede2000(lab(other, SRGB_WHITE), lab(wanted.light, SRGB_WHITE))
    found, by_light = wanted.error(other, 1.0)
    assert found == pytest.approx(np.sqrt(np.mean(due**2)), rel=0.25)
    assert wanted.error(wanted.light, 1.0)[0] < 1e-6
    step = rng.normal(size=other.shape) * 1e-6
    ends = [_objective(wanted, other + sign * step) for sign in (1.0, -1.0)]
    assert float(np.sum(by_light * step)) == pytest.approx(0.5 * (ends[0] - ends[1]), rel=1e-3)


def _objective(wanted, light):
    """What is minimised: Charbonnier's function of the differences of every point, and squares over the contrast."""
    off = lab(light, SRGB_WHITE) - wanted.lab
    parts = np.einsum("ijkl,ijl->ijk", wanted.turn, off)
    large = LARGE**2 * (np.sqrt(1.0 + np.sum(parts**2, axis=-1) / LARGE**2) - 1.0)
    return float(np.mean(large + 0.5 * SIMILAR * wanted.calm * (off**2 @ LIKENESS)))


def test_least_squares_of_what_a_display_shows_have_the_derivative_of_differences():
    rng = np.random.default_rng(3)
    picture = rng.uniform(0.05, 1.0, (16, 16, 3))
    asked = PictureTask(picture, LEVELS, standard("d65"), cells=64, coherence_um=12.0, displayed=True)
    wanted, scale = _Wanted(asked), 1.3
    light = (picture * rng.uniform(0.5, 1.5, picture.shape)) @ SRGB_TO_XYZ.T
    aim = (picture / picture.max()) ** DISPLAY

    def off(light):
        return (scale * (light @ XYZ_TO_SRGB.T) + DARKEST) ** DISPLAY - aim

    error, by_light = wanted.error(light, scale)
    assert error == pytest.approx(np.sqrt(np.mean(off(light) ** 2)))
    step = rng.normal(size=light.shape) * 1e-6
    ends = [np.sum(off(light + sign * step) ** 2) for sign in (1.0, -1.0)]
    assert float(np.sum(by_light * step)) == pytest.approx(0.25 * (ends[0] - ends[1]) / 16**2, rel=1e-3)
    # the scale is that of least squares in what is shown, not in light
    assert wanted.scale(2.0 * wanted.light) == pytest.approx(0.5)


def test_a_blurred_surface_repeats():
    asked = task(blur_um=0.2)
    height = np.random.default_rng(1).uniform(size=(64, 64))
    sharp = np.kron(height, np.ones((asked.points, asked.points)))
    blurred = gaussian_filter(sharp, 0.2 * asked.points / asked.cell_um, mode="wrap", truncate=8.0)
    np.testing.assert_allclose(asked.surface(height), blurred, atol=1e-5)


@pytest.mark.parametrize("blur_um", [0.0, 0.3])
def test_a_spot_without_symmetry_comes_out(blur_um):
    """Judged by the correlation engine, which shares nothing with the search but the heights."""
    found = design_picture(task(blur_um=blur_um), np.random.default_rng(2), 60)
    plain = judged(found)
    assert plain.ssim > 0.85
    assert found.history[-1] < 0.35 * found.history[0]
    row, col = np.unravel_index(int(plain.srgb[..., 0].argmax()), (16, 16))
    assert (row, col) == pytest.approx((9.75, 10.5), abs=1.5)
    assert 0.0 < plain.light_share < 1.0
    deep = judged(found, 1.3)
    assert deep.ssim < plain.ssim
    assert set(np.unique(found.height_um)) <= set(LEVELS)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: task(reach=0.3), r"diffract 550 nm to \|h\| = 0.275"),
        (lambda: task(coherence_um=40.0), "hold the coherence length"),
        (lambda: PictureTask(spot(), LEVELS, standard("d65")), "in colour"),
        (lambda: PictureTask(0.0 * spot(), LEVELS), "some above 0"),
        (lambda: design_picture(task(), np.random.default_rng(1), 3), "10 steps"),
    ],
)
def test_what_cannot_be_designed_is_refused(wrong, words):
    with pytest.raises(ModelError, match=words):
        wrong()
