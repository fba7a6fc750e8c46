"""Tolerances against dots whose masks were really widened, and the published formula of the spike."""

import numpy as np
import pytest

from anisoscope.sim.design.depths import Depths, edge_length, lobe_change, mean_phase_of, tolerances

GRID = 0.25


@pytest.fixture(scope="module")
def tiles():
    """(2, 256, 256) levels of two passes, steps of 2 µm."""
    cells = np.random.default_rng(0).integers(0, 4, (2, 32, 32))
    return np.repeat(np.repeat(cells, 8, axis=1), 8, axis=2)


def widened(mask, pixels):
    """A mask grown by some pixels on all sides, going on at its edges with itself."""
    found = mask.copy()
    for down in range(-pixels, pixels + 1):
        for over in range(-pixels, pixels + 1):
            found |= np.roll(mask, (down, over), axis=(0, 1))
    return found


def test_the_mean_phase_of_widened_masks_is_that_of_their_edges(tiles):
    share, edges = edge_length(tiles, 2, GRID)
    assert share == pytest.approx([0.5, 0.5], abs=0.03)
    assert edges == pytest.approx([0.5, 0.5], rel=0.1)  # half of the edges of 2 µm squares: 2/a · 1/2
    fine = np.repeat(np.repeat(tiles, 5, axis=1), 5, axis=2)
    bias_um, pixel = 0.1, GRID / 5
    for bit in (0, 1):
        grown = np.mean(
            [widened((tile >> bit & 1).astype(bool), round(0.5 * bias_um / pixel)).mean() for tile in fine]
        )
        assert grown - share[bit] == pytest.approx(0.5 * bias_um * edges[bit], rel=0.05)


def test_over_etch_moves_the_zero_and_width_bias_takes_it_away(tiles):
    depths = Depths((125.0,), (450.0, 550.0))
    rows = tolerances(depths, tiles, GRID, wavelength_nm=500.0, coherence_um=16.0, width_um=2.0)
    deep = {row.over_etch_nm: row for row in rows if row.width_bias_nm == 0.0}
    wide = {row.width_bias_nm: row for row in rows if row.width_bias_nm > 0.0}
    assert deep[0.0].tau < 1e-12
    assert deep[10.0].tau == pytest.approx(abs(np.cos(2.0 * np.pi * 135.0 / 500.0)), rel=1e-9)
    assert deep[10.0].spike_over_lobe == pytest.approx(deep[10.0].tau ** 2 / (1 - deep[10.0].tau ** 2) * 64.0)
    band = np.linspace(420.0, 640.0, 441)
    assert mean_phase_of(np.array([135.0]), np.array([0.5]), band).min() < 1e-2
    assert mean_phase_of(np.array([125.0]), np.array([0.55]), band).min() == pytest.approx(0.1, rel=1e-3)
    assert wide[200.0].tau == pytest.approx(0.2 * edge_length(tiles, 1, GRID)[1][0], rel=1e-6)


def test_equal_shares_give_the_product_of_cosines():
    nm = np.array([420.0, 555.0])
    passes = np.array([107.3, 157.5])
    expected = Depths(tuple(passes), (400.0, 700.0)).tau(nm)
    np.testing.assert_allclose(mean_phase_of(passes, np.array([0.5, 0.5]), nm), expected, atol=1e-12)


def test_the_lobe_changes_by_the_square_of_the_bias():
    small, large = (lobe_change(2.0, bias, 16.0) for bias in (0.05, 0.1))
    assert lobe_change(2.0, 0.0, 16.0) == 0.0
    assert 2.0 < large / small < 5.0
    assert large < 0.02
