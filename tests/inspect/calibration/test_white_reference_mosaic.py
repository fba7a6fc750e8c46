"""The flat of a camera with colour filters: every pixel has the scale of its own filter, and white is no mottle."""

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError
from anisoscope.calibration.white_reference import (
    inspect_tile,
    make_reference,
    read_reference,
    usual_of_filters,
    write_reference,
)
from anisoscope.imaging.linearisation import Stack
from anisoscope.rig.bayer import channel_of_pixels

SHAPE = (64, 96)
LEVELS = np.array([900.0, 2400.0, 700.0], dtype=np.float32)


def level(counts):
    """Frames of one brightness a pixel."""
    mean = np.broadcast_to(np.asarray(counts, dtype=np.float32), SHAPE).copy()
    return Stack(mean, 4, np.ones(SHAPE, dtype=np.float32), np.zeros(SHAPE, dtype=bool), 0.01, 1.0)


def made(flat, dark):
    """A reference of such frames."""
    return make_reference(
        flat, dark, reflectance=0.99, light_cosine=1.0, camera="C", full_scale=4095, filters="rggb"
    )


def test_every_filter_has_its_own_scale(tmp_path):
    counts = LEVELS[channel_of_pixels("rggb", SHAPE)]
    write_reference(tmp_path / "flat.tif", made(level(64.0 + counts), level(64.0)))
    white = read_reference(tmp_path / "flat.tif")
    assert white.filters == "rggb"
    assert white.signal * 0.01 == pytest.approx(counts, rel=1e-6)
    assert white.signal * white.radiance_per_signal == pytest.approx(np.full(SHAPE, 0.99 / np.pi), rel=1e-6)


def test_a_hot_pixel_takes_the_level_of_its_own_filter():
    counts = LEVELS[channel_of_pixels("rggb", SHAPE)]
    dark = np.full(SHAPE, 64.0)
    dark[10, 10] = 3000.0  # behind a red filter
    dark[21, 31] = 3000.0  # behind a blue one
    signal = made(level(64.0 + counts), level(dark))["signal"] * 0.01
    assert signal == pytest.approx(counts, rel=1e-6)


def test_the_dimmest_channel_has_to_be_bright_enough():
    counts = np.array([900.0, 2400.0, 150.0])[channel_of_pixels("rggb", SHAPE)]
    with pytest.raises(CalibrationError, match=r"reaches only 3\.7% of full scale"):
        made(level(64.0 + counts), level(64.0))


def test_white_is_not_mottled_by_its_filters():
    rng = np.random.default_rng(2)
    counts = LEVELS[channel_of_pixels("rggb", SHAPE)] * (1.0 + 0.003 * rng.standard_normal(SHAPE))
    signal = counts.astype(np.float32)
    assert inspect_tile(signal, 0.003, "rggb").remarks == ()
    assert "mottled" in " ".join(inspect_tile(signal, 0.003).remarks)
    assert np.unique(usual_of_filters(signal, "rggb")).size == 3
