"""Which pixel sees which colour, and pictures of a mosaic for the eye."""

import cv2
import numpy as np
import pytest

from anisoscope.base.errors import CameraError
from anisoscope.rig.bayer import FILTERS, channel_of_pixels, demosaicked, grey_of
from anisoscope.rig.camera import CameraInfo

MOSAICS = [filters for filters in FILTERS if filters != "mono"]


def test_a_mosaic_is_named_by_its_first_two_rows():
    letters = np.array(["r", "g", "b"])
    for filters in MOSAICS:
        shown = letters[channel_of_pixels(filters, (5, 7))]
        assert "".join(shown[:2, :2].ravel()) == filters
        np.testing.assert_array_equal(shown[2:], shown[:3])
        np.testing.assert_array_equal(shown[:, 2:], shown[:, :5])
        assert np.count_nonzero(channel_of_pixels(filters, (4, 4)) == 1) == 8  # half of all pixels are green


def test_without_filters_all_pixels_are_alike():
    assert not channel_of_pixels("mono", (3, 4)).any()
    counts = np.arange(12, dtype=np.uint16).reshape(3, 4)
    assert grey_of(counts, "mono") is counts
    np.testing.assert_array_equal(demosaicked(counts, "mono"), np.stack([counts] * 3, axis=-1))


@pytest.mark.parametrize("filters", MOSAICS)
def test_a_colour_that_changes_slowly_comes_back(filters):
    rows, cols = np.mgrid[:32, :40]
    planes = np.stack([1000 + 4 * cols, 2000 + 6 * rows, 600 + 2 * cols + 2 * rows], axis=-1).astype(
        np.uint16
    )
    seen = np.take_along_axis(planes, channel_of_pixels(filters, (32, 40))[..., None].astype(int), axis=2)[
        ..., 0
    ]
    found = demosaicked(seen, filters)
    np.testing.assert_allclose(found[2:-2, 2:-2], planes[2:-2, 2:-2], atol=2)


@pytest.mark.parametrize("filters", ["mono", *MOSAICS])
def test_what_lies_in_a_grey_picture_stays_at_its_place(filters):
    """A spot of even colour and a slope, up to the edges: neither moves, in counts or in radiance."""
    rows, cols = np.mgrid[:31, :40].astype(np.float32)
    spot = 4000.0 * np.exp(-((rows - 13.3) ** 2 + (cols - 22.6) ** 2) / 30.0)
    for kind in (np.uint16, np.float32):
        found = grey_of(spot.astype(kind), filters)
        assert found.dtype == kind
        total = found.sum(dtype=float)
        assert (found * rows).sum(dtype=float) / total == pytest.approx(13.3, abs=0.01)
        assert (found * cols).sum(dtype=float) / total == pytest.approx(22.6, abs=0.01)
    slope = 100.0 + 3.0 * rows + 5.0 * cols
    np.testing.assert_allclose(grey_of(slope, filters)[1:-1, 1:-1], slope[1:-1, 1:-1], rtol=1e-6)


@pytest.mark.parametrize("filters", MOSAICS)
def test_a_grey_picture_has_no_mosaic_in_it(filters):
    counts = np.array([3000, 1600, 400], np.uint16)[channel_of_pixels(filters, (10, 12))]
    np.testing.assert_array_equal(grey_of(counts, filters), (3000 + 2 * 1600 + 400) // 4)
    full = np.full((4, 4), 65535, np.uint16)
    np.testing.assert_array_equal(grey_of(full, filters), full)


def test_opencv_calls_the_mosaics_by_the_same_names():
    red_first = np.zeros((8, 8), np.uint16)
    red_first[::2, ::2] = 1000
    assert cv2.cvtColor(red_first, cv2.COLOR_BayerRGGB2RGB)[4, 4].tolist() == [1000, 0, 0]
    assert demosaicked(red_first, "rggb")[4, 4].tolist() == [1000, 0, 0]


def test_filters_that_nobody_knows_are_refused():
    with pytest.raises(
        CameraError, match=r"new camera: no colour filters are named 'rgbg'; known: mono, rggb"
    ):
        CameraInfo("new camera", "1", 4, 4, 12, 0.0, filters="rgbg")
