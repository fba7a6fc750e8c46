"""Means that a prediction can be compared with."""

import numpy as np
import pytest

from anisoscope.imaging.predicted_cells import pitch_means
from anisoscope.kinds.wafers.kind import tile_means


def test_means_over_a_pitch_do_not_show_the_flanks():
    assert pitch_means(np.tile([1.0, 2.0, 3.0, 2.0], (1, 6, 5))) == pytest.approx(np.full((1, 6, 20), 2.0))


def test_means_of_tiles_do_not_show_their_grain():
    grain = np.random.default_rng(1).random((1, 4, 4))
    tiles = np.array([[[1.0, 2.0, 1.0], [1.0, 1.0, 3.0]]])
    cells = np.kron(tiles, grain)
    assert tile_means(cells) == pytest.approx(grain.mean() * tiles)
