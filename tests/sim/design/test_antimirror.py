"""Anti-mirrors: every block has a zero mean, dots reflect the closed form, no feature is below the smallest."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.design.antimirror import AntiMirror
from anisoscope.sim.light.wave.claims import anti_mirror

FIG_7 = [
    AntiMirror((2, 2), (2.0, 2.0)),
    AntiMirror((4, 2), (2.0, 2.0), 4),
    AntiMirror((1, 4), (3.0, 3.0)),
    AntiMirror((2, 2), (2.0, 4.0), 4),
    AntiMirror((2, 4), (2.0, 3.0), crossed=True),
]
GRID, SIDE = 0.5, 224


def spectrum(labels, f):
    """Mean of |a(ω)|² at (F,) frequencies along x and y, of labels that are quarter waves apart."""
    wave = np.exp(-0.5j * np.pi * 2.0 * labels)
    x = (np.arange(labels.shape[0]) + 0.5) * GRID
    turn = np.exp(-2j * np.pi * np.outer(f, x)) * (GRID * np.sinc(f * GRID))[:, None]
    return np.abs(turn @ wave @ turn.T) ** 2 / (labels.shape[0] * GRID) ** 2


@pytest.mark.parametrize("model", FIG_7, ids=str)
def test_dots_have_every_level_equally_often_and_no_fine_features(model):
    labels = model.labels((SIDE, SIDE), GRID, folded=True, rng=np.random.default_rng(1))
    assert labels.shape == (SIDE, SIDE)
    levels = 2 if model.crossed else model.levels
    shares = np.bincount(labels.ravel(), minlength=levels) / labels.size
    np.testing.assert_allclose(shares, 1.0 / levels, atol=0.01)
    for axis, width in ((1, model.widths_um[0]), (0, model.widths_um[1])):
        turns = np.flatnonzero((np.diff(labels.astype(int), axis=axis) != 0).any(axis=1 - axis)) + 1
        assert np.diff(turns, prepend=0, append=SIDE).min() * GRID >= width


@pytest.mark.parametrize("model", [FIG_7[0], FIG_7[2], FIG_7[4]], ids=str)
def test_dots_reflect_the_closed_form(model):
    rng, f = np.random.default_rng(2), np.linspace(-0.4, 0.4, 41)
    seen = np.mean([spectrum(model.labels((48, 48), GRID, True, rng), f) for _ in range(400)], axis=0)
    # dots of 24 µm hold whole blocks of all of these: the closed form without a source is theirs
    expected = model.density(f, f, np.inf)
    assert np.linalg.norm(seen - expected) / np.linalg.norm(expected) < (0.15 if model.crossed else 0.09)
    assert seen[20, 20] < 1e-6 * seen.max()


def test_the_hole_of_a_crossed_surface_is_a_cross():
    f = np.linspace(-0.3, 0.3, 61)
    blocks = AntiMirror((2, 2), (2.0, 2.0)).density(f, f, np.inf)
    cross = AntiMirror((2, 2), (2.0, 2.0), crossed=True).density(f, f, np.inf)
    assert cross[30].max() < 1e-9
    assert blocks[30].max() > 0.3 * blocks.max()


def test_the_source_fills_the_hole_as_the_reference_says():
    for many, floor in ((2, 0.024), (3, 0.045), (4, 0.074), (8, 0.23)):
        f = np.linspace(0.0, 0.5, 401)
        line = anti_mirror(f, many, 2.0, 16.0)
        assert line[0] / line.max() == pytest.approx(floor, rel=0.09)
    assert FIG_7[0].floor(0.5, 16.0) > FIG_7[0].floor(0.5, 64.0)


def test_holes_and_rings_have_the_widths_of_their_arrangement():
    model = AntiMirror((4, 1), (2.0, 3.0), 4)
    assert model.hole(0.5) == (pytest.approx(0.5 / 16.0), float("inf"))
    assert model.ring(0.5) == (pytest.approx(0.125), pytest.approx(0.5 / 6.0))


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (((2, 2), (1.0, 2.0)), "narrower than the smallest feature"),
        (((3, 1), (2.0, 2.0)), "multiple of 2"),
        (((3, 2), (2.0, 2.0), 2, True), "multiples of 2"),
        (((0, 2), (2.0, 2.0)), "one step or more"),
    ],
)
def test_what_cannot_be_is_refused(arguments, match):
    with pytest.raises(ModelError, match=match):
        AntiMirror(*arguments)


def test_steps_off_the_grid_and_dots_without_a_block_are_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(ModelError, match="finer --grid"):
        AntiMirror((2, 2), (2.1, 2.0)).labels((64, 64), 0.25, True, rng)
    with pytest.raises(ModelError, match="larger --dot"):
        AntiMirror((4, 4), (8.0, 8.0)).labels((64, 64), 0.25, True, rng)
