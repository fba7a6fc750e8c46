"""Photon transfer after EMVA 1288: what was set comes back from the frames alone."""

import numpy as np
import pytest
from scipy.stats import poisson

from anisoscope.sim.bench.benchfile import SensorPart
from anisoscope.sim.bench.sensor import MANY, Sensor

QUANTISATION = 1.0 / 12.0


def sensor(seed=1, **fields):
    values = {"rows": 256, "cols": 256, "hot_pixel_share": 0.0} | fields
    return Sensor(SensorPart(**values), np.random.default_rng(seed))


def frames(device, electrons, count, exposure_s=0.0, gain=1.0):
    signal = np.full((device.part.rows, device.part.cols), float(electrons))
    return np.stack([device.expose(signal, exposure_s, gain) for _ in range(count)]).astype(float)


def temporal_variance(pair):
    """Variance in time of one pixel, counts²; the fixed pattern cancels in the difference of two frames."""
    return np.var(pair[0] - pair[1]) / 2.0


@pytest.mark.parametrize("gain", [1.0, 3.0])
@pytest.mark.parametrize("electrons_per_count", [2.0, 7.5])
def test_gain_is_the_slope_of_variance_over_mean(gain, electrons_per_count):
    device = sensor(gain_e_per_dn=electrons_per_count, bit_depth=16)
    pairs = [frames(device, level, 2, gain=gain) for level in np.linspace(0.0, 20_000.0, 12)]
    slope, _ = np.polyfit([p.mean() for p in pairs], [temporal_variance(p) for p in pairs], 1)
    assert slope == pytest.approx(gain / electrons_per_count, rel=0.02)


@pytest.mark.parametrize("noise", [3.0, 6.0, 12.0])
def test_read_noise_is_what_remains_in_the_dark(noise):
    # amplified, so that the noise spans several counts and 1/12 is what rounding adds
    pairs = [frames(sensor(seed, read_noise_e=noise), 0.0, 2, gain=4.0) for seed in range(4)]
    found = 7.5 / 4.0 * np.sqrt(np.mean([temporal_variance(pair) for pair in pairs]) - QUANTISATION)
    assert found == pytest.approx(noise, rel=0.02)


@pytest.mark.parametrize("level", [0.4, 20.0, 0.9 * MANY, 1.1 * MANY])
def test_light_arrives_as_poisson_says(level):
    """Shares of pixels up to three standard deviations about the mean."""
    device = sensor(
        prnu=0.0, dsnu_e=0.0, dark_current_e_s=0.0, read_noise_e=0.0, gain_e_per_dn=1.0, bit_depth=16
    )
    found = frames(device, level, 4).ravel() - device.part.black_level
    edges = np.floor(level + np.sqrt(level) * np.array([-2.0, -1.0, 0.0, 1.0, 2.0, 3.0]))
    shares, expected = [np.mean(found <= edge) for edge in edges], poisson.cdf(edges, level)
    noise = np.sqrt(expected * (1.0 - expected) / found.size)
    assert np.all(np.abs(shares - expected) <= 4.5 * noise + (0.004 if level > MANY else 0.0))
    assert np.mean(found) == pytest.approx(level, abs=4.5 * np.sqrt(level / found.size))
    assert np.var(found) == pytest.approx(level + (QUANTISATION if level > MANY else 0.0), rel=0.015)
    centred = found - np.mean(found)
    assert np.mean(centred**3) == pytest.approx(level, abs=4.5 * np.sqrt(15.0 * level**3 / found.size) + 0.5)


def test_bright_and_dark_pixels_of_one_frame_have_their_own_noise():
    device = sensor(prnu=0.0, dsnu_e=0.0, read_noise_e=0.0, gain_e_per_dn=1.0, bit_depth=16)
    signal = np.full((256, 256), 50.0)
    signal[:, 128:] = 9000.0
    one, other = (device.expose(signal, 0.0, 1.0).astype(float) for _ in range(2))
    for half, level in ((np.s_[:, :128], 50.0), (np.s_[:, 128:], 9000.0)):
        assert np.mean(one[half]) - 64.0 == pytest.approx(level, abs=4.5 * np.sqrt(level / 2**15))
        assert np.var(one[half] - other[half]) / 2.0 == pytest.approx(level, rel=0.04)


def test_dark_current_is_the_slope_of_the_dark_level_over_time():
    device = sensor(dark_current_e_s=40.0)
    times = np.array([0.0, 5.0, 10.0, 20.0])
    levels = [7.5 * frames(device, 0.0, 4, exposure_s=t).mean() for t in times]
    slope, offset = np.polyfit(times, levels, 1)
    assert slope == pytest.approx(40.0, rel=0.01)
    assert offset / 7.5 == pytest.approx(64.0, abs=0.05)


def test_prnu_and_dsnu_are_the_spatial_spread_of_mean_frames():
    """EMVA 1288, 8.2: the variance of the mean frame, less what time leaves in it."""
    device, count, level = sensor(prnu=0.006, dsnu_e=5.0), 48, 15_000.0
    dark, bright = frames(device, 0.0, count), frames(device, level, count)
    spread = [s.mean(axis=0).var() - s.var(axis=0, ddof=1).mean() / count for s in (dark, bright)]
    assert 7.5 * np.sqrt(spread[0]) == pytest.approx(5.0, rel=0.02)
    assert 7.5 * np.sqrt(spread[1] - spread[0]) / level == pytest.approx(0.006, rel=0.02)


def test_full_well_ends_the_signal_and_its_shot_noise():
    device = sensor(full_well_e=12_000.0, prnu=0.0, dsnu_e=0.0)
    full = frames(device, 40_000.0, 2)
    assert 7.5 * (full.mean() - 64.0) == pytest.approx(12_000.0, rel=0.001)
    assert temporal_variance(full) == pytest.approx((6.0 / 7.5) ** 2 + QUANTISATION, rel=0.05)


@pytest.mark.parametrize("bits", [8, 10, 12])
def test_counts_end_at_full_scale_and_at_zero(bits):
    device = sensor(bit_depth=bits, black_level=0.0, read_noise_e=30.0)
    assert device.full_scale == 2**bits - 1
    assert frames(device, 1e6, 1, gain=4.0).min() == device.full_scale
    assert frames(device, 0.0, 1).min() == 0.0


def test_response_is_linear_up_to_the_full_well():
    device = sensor(dark_current_e_s=0.0)
    levels = np.linspace(1_000.0, 25_000.0, 7)
    counts = np.array([frames(device, level, 4).mean() for level in levels]) - 64.0
    # the mean over the picture carries PRNU/√N of the level, and shot noise/√N
    np.testing.assert_allclose(counts * 7.5 / levels, 1.0, atol=5 * 0.004 / 256 + 5e-4)


@pytest.mark.parametrize("bend", [0.05, -0.05])
def test_a_bent_response_misses_its_share_at_full_well(bend):
    device = sensor(nonlinearity=bend, prnu=0.0, dark_current_e_s=0.0, bit_depth=16, full_well_e=20_000.0)
    levels = np.array([2_000.0, 10_000.0, 40_000.0])
    electrons = np.array([7.5 * (frames(device, level, 2).mean() - 64.0) for level in levels])
    collected = np.minimum(levels, 20_000.0)
    np.testing.assert_allclose(electrons, collected * (1.0 - bend * collected / 20_000.0), rtol=2e-3)


def test_hot_pixels_are_as_many_as_set_and_grow_with_time():
    device = sensor(hot_pixel_share=0.01)
    short, long = (frames(device, 0.0, 1, exposure_s=t)[0] for t in (0.01, 0.2))
    hot = long > 500.0
    expected = 0.01 * hot.size
    assert abs(hot.sum() - expected) < 5 * np.sqrt(expected)
    assert (long[hot].mean() - 64.0) / (short[hot].mean() - 64.0) == pytest.approx(20.0, rel=0.05)


def test_the_fixed_pattern_is_the_seeds_and_time_noise_is_not_repeated():
    first, same, other = sensor(3), sensor(3), sensor(4)
    one = frames(first, 5_000.0, 2)
    assert np.array_equal(one, frames(same, 5_000.0, 2))
    assert not np.array_equal(one[0], one[1])
    assert not np.array_equal(one, frames(other, 5_000.0, 2))
