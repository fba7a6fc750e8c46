"""Etched steps: passes found from heights, passes too deep, and edges that move by parts of a pixel."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.etching import Etched
from anisoscope.profiles.heightmap import HeightMap

PIXEL_UM = 0.25


def blocks(levels, seed=0, cells=12, side=4):
    """(48, 48) random numbers of levels in squares of four pixels."""
    cells = np.random.default_rng(seed).integers(0, levels, (cells, cells))
    return np.kron(cells, np.ones((side, side), dtype=int)).astype(np.uint8)


def etched(passes_um, seed=0, side=4):
    return Etched(blocks(2 ** len(passes_um), seed, side=side), passes_um, PIXEL_UM)


@pytest.mark.parametrize("passes_um", [(0.13,), (0.1073, 0.1575), (0.1033, 0.1279, 0.1665)])
def test_passes_are_found_in_the_heights_that_they_left(passes_um):
    made = etched(passes_um)
    heights = np.array(made.levels_um)[made.labels] + 7.0  # heights count from anywhere
    found = Etched.of(HeightMap(heights, PIXEL_UM, PIXEL_UM))
    assert found.passes_um == pytest.approx(passes_um, abs=1e-9)
    assert np.allclose(np.array(found.levels_um)[found.labels] + 7.0, heights, atol=1e-9)


@pytest.mark.parametrize(
    ("height", "pixel", "match"),
    [
        (np.random.default_rng(0).random((32, 32)), 0.25, "no surface of 1 to 8 etch passes"),
        (np.zeros((8, 8)), 0.25, "no surface of 1 to 8 etch passes"),
        (np.where(np.eye(8) > 0, np.nan, 0.0), 0.25, "needs all of its heights"),
        (np.kron([[0.0, 0.1]], np.ones((4, 4))), 0.5, "square pixels"),
    ],
)
def test_what_is_no_etched_surface_is_refused(height, pixel, match):
    with pytest.raises(HeightMapError, match=match):
        Etched.of(HeightMap(height, pixel, 0.25))


def test_passes_etch_deeper_by_a_length_and_by_a_share():
    made = etched((0.1, 0.15))
    assert made.over_etched(0.01).passes_um == pytest.approx((0.11, 0.16))
    assert made.over_etched(share=0.1).passes_um == pytest.approx((0.11, 0.165))
    with pytest.raises(HeightMapError, match="do not etch"):
        made.over_etched(-0.2)


@pytest.mark.parametrize("wider_um", [0.0, 0.05, 0.2, -0.1, 0.25, 0.65, -0.35])
@pytest.mark.parametrize("passes_um", [(0.13,), (0.1, 0.15)])
def test_edges_move_by_parts_of_a_pixel_exactly_as_on_a_grid_ten_times_as_fine(wider_um, passes_um):
    made = etched(passes_um).widened(wider_um)
    found = made.shares()
    times = 10
    fine = np.kron(made.labels, np.ones((times, times), dtype=np.uint8))
    steps = round(0.5 * wider_um / (PIXEL_UM / times))
    assert steps * PIXEL_UM / times == pytest.approx(0.5 * wider_um)
    moved = np.zeros_like(fine)
    for bit in range(len(passes_um)):
        mask = (fine >> bit) & 1 == 1
        for _ in range(abs(steps)):  # one fine pixel to all eight sides
            near = [np.roll(mask, (dy, dx), (0, 1)) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
            mask = np.any(near, axis=0) if steps > 0 else np.all(near, axis=0)
        moved |= mask.astype(np.uint8) << bit
    rows, cols = made.labels.shape
    for number in range(2 ** len(passes_um)):
        wanted = (moved == number).reshape(rows, times, cols, times).mean(axis=(1, 3))
        assert found.get(number, np.zeros((rows, cols))) == pytest.approx(wanted, abs=1e-5)


def test_a_bias_below_the_grid_adds_area_in_proportion_to_the_edges():
    """Convex and concave corners cancel but for the squares at the corners, which are of second order."""
    made = etched((0.13,), seed=3, side=8)
    mask = made.labels.astype(bool)
    turns = sum(int(np.count_nonzero(mask != np.roll(mask, 1, axis))) for axis in (0, 1))
    edges_um = turns * PIXEL_UM
    area_um2 = mask.size * PIXEL_UM**2
    for wider_um in (0.004, 0.02):
        grown = made.widened(wider_um).shares()[1].mean(dtype=float) - mask.mean()
        assert grown == pytest.approx(0.5 * wider_um * edges_um / area_um2, rel=0.02)


def test_twice_widened_is_widened_by_the_sum():
    made = etched((0.13,))
    twice, once = made.widened(0.03).widened(0.04), replace(made, wider_um=0.07)
    assert np.array_equal(twice.shares()[1], once.shares()[1])
