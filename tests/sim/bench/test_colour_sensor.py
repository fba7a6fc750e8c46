"""Photon transfer after EMVA 1288 behind every colour filter, and filters where their name says."""

import numpy as np
import pytest

from anisoscope.base.errors import RigFileError
from anisoscope.rig.bayer import FILTERS, channel_of_pixels
from anisoscope.sim.bench.benchfile import SensorPart
from anisoscope.sim.bench.camera import SimulatedCamera
from anisoscope.sim.bench.sensor import Mosaic

SHAPE = (128, 160)


@pytest.fixture
def tile(make_bench):
    """``tile(sensor={...})`` is a lit bench with a white tile."""

    def make(sensor=None, optics=None):
        bench = make_bench(
            sample={"kind": "white-tile", "reflectance": 0.9},
            sensor={"rows": SHAPE[0], "cols": SHAPE[1], "filters": "rggb"} | (sensor or {}),
            optics={"vignetting": 0.0, "stray_radiance": 0.0} | (optics or {}),
        )
        bench.light_on = True
        return bench

    return make


def transfer(bench, exposures_s):
    """Mean above black and temporal variance of two frames, (exposures, 3) each, in counts."""
    seen = channel_of_pixels(bench.file.sensor.filters, SHAPE)
    means, variances = [], []
    for exposure_s in exposures_s:
        one, two = (bench.photograph(exposure_s, 1.0).astype(float) for _ in range(2))
        means.append([0.5 * (one + two)[seen == k].mean() - 64.0 for k in range(3)])
        variances.append([np.var((one - two)[seen == k]) / 2.0 for k in range(3)])
    return np.array(means), np.array(variances)


def test_photon_transfer_holds_behind_every_filter(tile):
    """Gain is the slope of variance over mean, the same behind each filter; sensitivity is not."""
    bench = tile({"gain_e_per_dn": 4.0, "bit_depth": 16, "dark_current_e_s": 0.0})
    exposures_s = np.linspace(0.0005, 0.012, 10)
    means, variances = transfer(bench, exposures_s)
    strengths = bench.file.vision().strengths()
    for channel in range(3):
        slope, _ = np.polyfit(means[:, channel], variances[:, channel], 1)
        assert 1.0 / slope == pytest.approx(4.0, rel=0.04)
        # linear up to the full well, and as bright as the lamp behind that filter
        responsivity = means[:, channel] * 4.0 / exposures_s
        radiance = 0.9 / np.pi * np.cos(np.radians(10.0))
        np.testing.assert_allclose(responsivity, 6.0e6 * radiance * strengths[channel], rtol=5e-3)


def test_read_noise_and_dark_are_the_same_behind_every_filter(tile):
    bench = tile({"read_noise_e": 12.0})
    bench.light_on = False
    means, variances = transfer(bench, [0.001] * 6)
    np.testing.assert_allclose(means, 0.0, atol=0.1)
    np.testing.assert_allclose(7.5 * np.sqrt(variances.mean(axis=0) - 1.0 / 12.0), 12.0, rtol=0.04)


@pytest.mark.parametrize("filters", [name for name in FILTERS if name != "mono"])
def test_every_pixel_sees_its_own_channel(filters):
    part = SensorPart(rows=66, cols=65, filters=filters)
    mosaic = Mosaic(part, np.array([0.8, 1.0, 0.4]))
    channels = np.random.default_rng(2).random((3, 66, 65)).astype(np.float32)
    seen, picked = channel_of_pixels(filters, (66, 65)), mosaic.pick(channels)
    for k, strength in enumerate((0.8, 1.0, 0.4)):
        np.testing.assert_array_equal(picked[seen == k], channels[k][seen == k])
        assert np.all(mosaic.passed[seen == k] == strength)
    np.testing.assert_array_equal(mosaic.pick(channels[:1]), channels[0])


@pytest.mark.parametrize(("spectrum", "strongest"), [("led-white", 1), ("a", 0), ("${here}/blue.csv", 2)])
def test_the_lamp_says_which_filter_passes_most(tile, tmp_path, spectrum, strongest):
    (tmp_path / "blue.csv").write_text("wavelength_nm,power\n400,0\n440,1\n480,1\n520,0\n700,0\n")
    bench = tile(optics={"spectrum": spectrum})
    means, _ = transfer(bench, [0.004])
    assert int(np.argmax(means[0])) == strongest
    np.testing.assert_allclose(means[0] / means[0].max(), bench.file.vision().strengths(), rtol=0.02)


def test_sensitivities_of_a_file_are_those_of_the_sensor(tile, tmp_path):
    """Twice as sensitive in green: half of the light in the others."""
    (tmp_path / "mine.csv").write_text("wavelength_nm,red,green,blue\n400,0.3,0.6,0.3\n700,0.3,0.6,0.3\n")
    bench = tile({"sensitivities": "mine.csv"})
    np.testing.assert_allclose(bench.file.vision().strengths(), [0.5, 1.0, 0.5])
    means, _ = transfer(bench, [0.004])
    np.testing.assert_allclose(means[0] / means[0, 1], [0.5, 1.0, 0.5], rtol=0.01)


def test_a_mono_camera_is_as_it_was_and_a_colour_camera_says_what_it_is(tile):
    assert SimulatedCamera(tile({"filters": "mono"})).info.filters == "mono"
    assert SimulatedCamera(tile({"filters": "gbrg"})).info.filters == "gbrg"
    pictures = [tile({"filters": "mono"}, {"spectrum": lamp}).photograph(0.004, 1.0) for lamp in ("a", "d65")]
    np.testing.assert_array_equal(*pictures)


def test_a_filter_that_passes_nothing_of_the_lamp_is_told(tile, tmp_path):
    (tmp_path / "blue.csv").write_text("wavelength_nm,power\n400,0\n440,1\n490,0\n700,0\n")
    (tmp_path / "mine.csv").write_text(
        "wavelength_nm,red,green,blue\n400,0,1,1\n499,0,1,1\n500,1,1,1\n700,1,1,1\n"
    )
    words = (
        r"sensor\.sensitivities, optics\.spectrum: the red channel of mine sees nothing of the light of blue"
    )
    with pytest.raises(RigFileError, match=words):
        tile({"sensitivities": "mine.csv"}, {"spectrum": "blue.csv"})


@pytest.mark.parametrize(
    ("sensor", "optics", "words"),
    [
        ({}, {"spectrum": "sun"}, r"optics\.spectrum: no illuminant is named 'sun'"),
        ({}, {"spectrum": "none.csv"}, r"optics\.spectrum: cannot read .*none\.csv"),
        ({"sensitivities": "none.csv"}, {}, r"sensor\.sensitivities: cannot read .*none\.csv"),
        ({"filters": "rgbw"}, {}, r"sensor\.filters: .*'mono'.*not \"rgbw\""),
    ],
)
def test_what_cannot_be_seen_is_told_with_its_key(tile, sensor, optics, words):
    with pytest.raises(RigFileError, match=words):
        tile(sensor, optics)
