"""A press that errs: overlaps of stripes and discs whose areas are known."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.proof.halftone import Press, pressed

STRIPES = np.tile(np.repeat(np.uint8([1, 2, 0]), 8), (24, 10))
"""Two inks in stripes of 8 dots, then bare paper as wide."""


def test_without_errors_every_dot_is_that_of_its_ink():
    found = pressed(STRIPES, 2, Press(((0.0, 0.0), (0.0, 0.0))))
    assert found.sets == ((0,), (1,))
    np.testing.assert_array_equal(found.shares, STRIPES[..., None] == np.arange(1, 3))


@pytest.mark.parametrize("shift", [0.25, 1.5, 3.0])
def test_a_screen_out_of_register_overlaps_by_its_shift(shift):
    found = pressed(STRIPES, 2, Press(((shift, 0.0), (0.0, 0.0))))
    assert found.sets == ((0,), (1,), (0, 1))
    inner = found.shares[:, 24:-24].mean(axis=(0, 1))
    np.testing.assert_allclose(inner, np.array([8.0 - shift, 8.0 - shift, shift]) / 24.0, atol=1e-6)


def test_y_is_upward():
    one = np.zeros((9, 9), dtype=np.uint8)
    one[4, 4] = 1
    found = pressed(one, 1, Press(((2.0, 1.0),)))
    np.testing.assert_array_equal(np.argwhere(found.shares[..., 0] > 0.0), [[3, 6]])


def test_stripes_that_spread_overlap_on_both_sides():
    """Each edge moves outward by the gain: 1 dot is covered twice where two inks meet."""
    found = pressed(STRIPES, 2, Press(((0.0, 0.0), (0.0, 0.0)), gain=0.5))
    inner = found.shares[:, 24:-24].mean(axis=(0, 1))
    np.testing.assert_allclose(inner, np.array([8.0, 8.0, 1.0]) / 24.0, atol=1e-6)


def test_a_disc_grows_as_a_disc():
    y, x = np.mgrid[:81, :81] - 40
    disc = (np.hypot(x, y) <= 20.0).astype(np.uint8)
    grown = pressed(disc, 1, Press(((0.0, 0.0),), gain=5.0)).shares.sum()
    assert np.pi * 25.0**2 < grown < np.pi * 25.5**2  # corners of dots reach half a dot beyond their middle


def test_what_a_press_cannot_be_is_refused():
    for shifts, gain in ((((99.0, 0.0),), 0.0), (((0.0, 0.0),), -1.0), (((np.nan, 0.0),), 0.0)):
        with pytest.raises(ModelError):
            Press(shifts, gain)
    with pytest.raises(ModelError, match="2 inks need as many shifts"):
        pressed(STRIPES, 2, Press(((0.0, 0.0),)))
