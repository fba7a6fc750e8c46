"""The picture in which the markers of a mosaic are searched."""

import numpy as np
import pytest

from anisoscope.imaging.views import luminance
from anisoscope.rig.bayer import FILTERS, channel_of_pixels

LEVELS = np.array([0.1, 0.5, 0.3], dtype=np.float32)


@pytest.mark.parametrize("filters", [name for name in FILTERS if name != "mono"])
def test_colours_even_out(filters):
    picture = LEVELS[channel_of_pixels(filters, (12, 14))]
    assert luminance(picture) == pytest.approx(np.full((12, 14), (0.1 + 2.0 * 0.5 + 0.3) / 4.0), rel=1e-6)


def test_edges_stay_where_they_are():
    picture = np.zeros((9, 20), dtype=np.float32)
    picture[:, 10:] = 1.0
    found = luminance(picture)
    assert found.sum() == pytest.approx(picture.sum())
    assert found[4, 9] + found[4, 10] == pytest.approx(1.0)


def test_pixels_without_a_value_stay_so():
    picture = np.ones((9, 9), dtype=np.float32)
    picture[4, 4] = np.nan
    assert np.isnan(luminance(picture)).sum() == 9
