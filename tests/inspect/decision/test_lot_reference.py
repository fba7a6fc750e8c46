"""Parts of a lot of unknown quality: which of them are alike."""

import numpy as np
import pytest

from anisoscope.decision.lot_reference import LEAST_PARTS, alike

COVARIANCE = np.array([[4.0, 1.5, 0.0], [1.5, 2.0, 0.3], [0.0, 0.3, 1.0]])
ROOT = np.linalg.cholesky(COVARIANCE)


def lot(rng, good, bad=0, off=12.0):
    """Contrasts of good parts and, last, of bad ones, each ``off`` standard deviations away."""
    directions = rng.normal(size=(bad, 3))
    directions *= off / np.linalg.norm(directions, axis=1, keepdims=True)
    inner = np.vstack([rng.normal(size=(good, 3)), rng.normal(size=(bad, 3)) + directions])
    return inner @ ROOT.T + [0.3, -2.0, 5.0]


@pytest.mark.parametrize("parts", [LEAST_PARTS, 5, 10, 25])
def test_a_lot_of_good_parts_stays_whole(parts):
    rng = np.random.default_rng(parts)
    lost = sum(int(np.count_nonzero(~alike(lot(rng, parts), COVARIANCE)[0])) for _ in range(200))
    assert lost / (200 * parts) < 0.02


@pytest.mark.parametrize(("good", "bad"), [(2, 1), (4, 1), (8, 2), (6, 4)])
def test_bad_parts_of_a_lot_are_left_out(good, bad):
    rng = np.random.default_rng(7)
    right = 0
    for _ in range(100):
        kept, distances = alike(lot(rng, good, bad), COVARIANCE)
        assert distances.shape == kept.shape == (good + bad,)
        right += bool(kept[:good].all() and not kept[good:].any())
    assert right >= 90


@pytest.mark.parametrize("size", [0.25, 9.0])
def test_parts_that_scatter_more_than_stated_show_it_themselves(size):
    """Of a lot of ten, 4 σ of its own scatter away: three times as wide as stated no good part is left out."""
    rng = np.random.default_rng(8)
    lost = found = 0
    for _ in range(100):
        parts = np.sqrt(size) * lot(rng, 9, 1, 14.0)
        kept, _ = alike(parts, COVARIANCE, sized=False)
        lost += int(np.count_nonzero(~kept[:9]))
        found += int(not kept[9])
    assert lost <= 27
    assert found >= 95


def test_half_of_a_lot_is_kept_at_least():
    """Parts that all differ by far more than stated: the nearer half is kept, and no part twice."""
    rng = np.random.default_rng(3)
    kept, _ = alike(100.0 * rng.normal(size=(9, 3)), COVARIANCE)
    assert kept.sum() >= 5


def test_the_order_of_the_parts_does_not_matter():
    rng = np.random.default_rng(4)
    parts = lot(rng, 7, 2)
    order = rng.permutation(len(parts))
    kept, distances = alike(parts, COVARIANCE)
    again, moved = alike(parts[order], COVARIANCE)
    np.testing.assert_array_equal(again, kept[order])
    np.testing.assert_allclose(moved, distances[order])
