"""Pictures by gradients: the gradient itself, a picture that comes out, and what is refused."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.design.gradient import PictureTask, _Line, design_picture, judged
from anisoscope.sim.light.colour.illuminant import standard

LEVELS = tuple((np.arange(16) * 0.55 / 32.0).tolist())


def spot(side=16):
    y, x = np.mgrid[-1.0 : 1.0 : side * 1j, -1.0 : 1.0 : side * 1j]
    return np.exp(-6.0 * ((x - 0.4) ** 2 + (y - 0.3) ** 2))[..., None]


def task(**more):
    return PictureTask(spot(), LEVELS, **({"cells": 64, "coherence_um": 12.0} | more))


def test_gradient_is_that_of_differences():
    line, rng = _Line(task(), 0.55), np.random.default_rng(1)
    height = rng.uniform(0.0, 0.25, (64, 64)).astype(np.float32)
    by_light = rng.normal(size=(16, 16)).astype(np.float32)
    _, wave, spectrum = line.light(height)
    found = line.gradient(by_light, wave, spectrum)
    for place in ((3, 5), (40, 17)):
        ends = []
        for sign in (1.0, -1.0):
            moved = height.copy()
            moved[place] += sign * 0.01
            ends.append(float(np.sum(by_light.astype(np.float64) * line.light(moved)[0])))
        assert found[place] == pytest.approx((ends[0] - ends[1]) / 0.02, rel=0.03, abs=1e-6)


def test_a_spot_without_symmetry_comes_out():
    """Judged by the correlation engine, which shares nothing with the search but the heights."""
    found = design_picture(task(), np.random.default_rng(2), 60)
    plain = judged(found)
    assert plain.ssim > 0.85
    assert found.history[-1] < 0.3 * found.history[0]
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
        (lambda: task(coherence_um=20.0), "two coherence lengths"),
        (lambda: PictureTask(spot(), LEVELS, standard("d65")), "in colour"),
        (lambda: PictureTask(0.0 * spot(), LEVELS), "some above 0"),
        (lambda: design_picture(task(), np.random.default_rng(1), 3), "10 steps"),
    ],
)
def test_what_cannot_be_designed_is_refused(wrong, words):
    with pytest.raises(ModelError, match=words):
        wrong()
