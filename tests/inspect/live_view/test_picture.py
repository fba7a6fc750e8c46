from dataclasses import replace

import cv2
import numpy as np
import pytest

from anisoscope.live_view.picture import GREEN, RED, as_jpeg, as_png, draw, eight_bits, to_show, words
from anisoscope.live_view.view import View
from anisoscope.rig.bayer import channel_of_pixels
from anisoscope.rig.camera import CameraInfo

INFO = CameraInfo("test", "1", rows=200, cols=300, bit_depth=12, black_level=64.0)


def view(ridge_deg=None, saturated=0.0):
    return View(0.3, saturated, 1.0, ridge_deg, 50.0, (1.0,))


def near(picture, color, tolerance=25):
    return (np.abs(picture.astype(int) - color).max(axis=2) <= tolerance).nonzero()


def test_black_is_black_and_full_scale_is_white():
    counts = np.array([[0, 64, 4095]], dtype=np.uint16)
    assert eight_bits(counts, INFO).tolist() == [[0, 0, 255]]


@pytest.mark.parametrize(("ridge_deg", "slope"), [(0.0, None), (45.0, 1.0), (-45.0, -1.0), (60.0, 0.57735)])
def test_the_line_runs_along_the_ridges(ridge_deg, slope):
    """Counter-clockwise from upright: at +45° the line leans to the left, so rows grow with columns."""
    picture = draw(np.full((600, 800), 300, np.uint16), INFO, view(ridge_deg), 1.0)
    rows, cols = near(picture[150:], GREEN)
    assert len(rows) > 100
    if slope is None:
        assert np.ptp(cols) <= 4
    else:
        assert np.polyfit(cols, rows, 1)[0] == pytest.approx(slope, abs=0.05)


def test_no_direction_no_line():
    picture = draw(np.full((600, 800), 300, np.uint16), INFO, view(None), 1.0)
    assert len(near(picture, GREEN)[0]) == 0


def test_one_saturated_pixel_is_seen_in_a_small_picture():
    counts = np.full((3000, 4000), 500, np.uint16)
    counts[1500, 2001] = 4095
    picture = draw(counts, INFO, view(), 0.5)
    assert picture.shape[1] == 960
    rows, cols = near(picture[200:], RED)
    assert len(rows) >= 1
    assert np.mean(cols) == pytest.approx(2001 * 960 / 4000, abs=2)


@pytest.mark.parametrize("filters", ["rggb", "gbrg"])
def test_a_colour_camera_shows_colours(filters):
    levels = np.array(
        [64 + 4031, 64 + 4031 // 4, 64], np.uint16
    )  # saturated red, half as bright green, no blue
    counts = levels[channel_of_pixels(filters, (200, 300))]
    info = replace(INFO, filters=filters)
    shown = to_show(counts, info)
    assert shown.shape == (200, 300, 3)
    np.testing.assert_allclose(shown[50, 50], [0, 127.5, 255], atol=1)  # blue, green, red
    assert draw(counts, info, view(), 1.0).shape == (200, 300, 3)
    assert to_show(counts, INFO).shape == (200, 300)


def test_words_say_when_nothing_can_be_said():
    assert words(view(None), float("nan"))[:2] == ["ridges undefined", "focus too dark"]
    assert words(view(-12.34, 0.005), 0.756) == ["ridges -12.3 deg", "focus 76 % of best", "saturated 0.50 %"]


def test_files_decode_to_the_picture(rng):
    picture = cv2.GaussianBlur(rng.integers(0, 255, (60, 80, 3)).astype(np.uint8), (0, 0), 4.0)
    png = cv2.imdecode(np.frombuffer(as_png(picture), np.uint8), cv2.IMREAD_COLOR)
    assert np.array_equal(png, picture)
    jpeg = cv2.imdecode(np.frombuffer(as_jpeg(picture), np.uint8), cv2.IMREAD_COLOR)
    assert np.abs(jpeg.astype(int) - picture).mean() < 4.0
