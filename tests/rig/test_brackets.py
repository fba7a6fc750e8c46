"""Brackets against a linear sensor whose scene is known: nothing is bent, nothing leaks, the noise is as told."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError
from anisoscope.rig.brackets import SensorNoise, merge_brackets
from anisoscope.rig.frame import Frame

NOISE = SensorNoise(counts_per_electron=0.25, read_noise_counts=2.0)
EXPOSURES = (0.001, 0.004, 0.016, 0.064, 0.256)
OFFSET = 64.0


def expose(rate, time_s, rng, kind="sample", dark_rate=40.0, offset=OFFSET):
    """A 12-bit frame of a linear sensor; `rate` and `dark_rate` in counts per second."""
    mean = np.maximum(rate, 0.0) * time_s + dark_rate * time_s
    electrons = rng.poisson(mean / NOISE.counts_per_electron)
    analogue = electrons * NOISE.counts_per_electron + rng.normal(offset, NOISE.read_noise_counts, mean.shape)
    counts = np.clip(np.rint(analogue), 0, 4095).astype(np.uint16)
    return Frame(counts, kind, 12, OFFSET, time_s, 1.0, 0.0, 0.0, 0.0, "", "model")


def bracket(rate, rng, exposures=EXPOSURES, frames=1, darks=16):
    lit = [expose(rate, t, rng) for t in exposures for _ in range(frames)]
    dark = [expose(np.zeros_like(rate), t, rng, "dark") for t in exposures for _ in range(darks)]
    return lit, dark


def steps(*rates, pixels=6000):
    return np.repeat(np.array(rates)[:, None], pixels, axis=1)


def test_four_decades_are_recovered_within_the_noise():
    rates = 10.0 ** np.arange(2.0, 6.01, 0.25)
    merged = merge_brackets(*bracket(steps(*rates), np.random.default_rng(1)), NOISE)
    assert merged.usable.all()
    error = merged.rate - steps(*rates)
    standard = np.sqrt(merged.variance.mean(axis=1) / merged.variance.shape[1])
    assert np.all(np.abs(error.mean(axis=1)) < 5.0 * standard)
    # relative: a tenth of a per cent where there is light, with 6000 pixels
    assert np.all(np.abs(error.mean(axis=1))[rates > 1e3] < 1e-3 * rates[rates > 1e3])


def test_the_noise_is_not_worse_than_predicted_and_not_better():
    rates = 10.0 ** np.arange(1.0, 6.01, 0.5)
    merged = merge_brackets(*bracket(steps(*rates), np.random.default_rng(2), darks=32), NOISE)
    scatter = merged.rate.astype(float).var(axis=1)
    predicted = merged.variance.astype(float).mean(axis=1)
    np.testing.assert_allclose(scatter, predicted, rtol=0.1)


@pytest.mark.parametrize("darks", [1, 4])
def test_the_noise_of_the_dark_frames_counts(darks):
    rate = steps(0.0, 30.0)
    merged = merge_brackets(*bracket(rate, np.random.default_rng(12), (0.064,), darks=darks), NOISE)
    scatter, predicted = merged.rate.astype(float).var(axis=1), merged.variance.astype(float).mean(axis=1)
    np.testing.assert_allclose(scatter, predicted, rtol=0.1)


def test_more_exposures_are_better_than_the_best_single_one():
    rate = steps(2000.0)
    lit, dark = bracket(rate, np.random.default_rng(3))
    merged = merge_brackets(lit, dark, NOISE)
    single = merge_brackets(lit[-1:], dark, NOISE)
    assert merged.rate.std() < single.rate.std()
    np.testing.assert_allclose(single.rate.mean(), 2000.0, rtol=1e-3)


def test_frames_of_one_exposure_are_averaged():
    rate = steps(5000.0)
    one = merge_brackets(*bracket(rate, np.random.default_rng(4), (0.064,)), NOISE)
    four = merge_brackets(*bracket(rate, np.random.default_rng(4), (0.064,), frames=4), NOISE)
    assert four.rate.var() / one.rate.var() == pytest.approx(0.25, rel=0.1)
    assert four.variance.mean() / one.variance.mean() == pytest.approx(0.25, rel=0.15)


@pytest.mark.parametrize("level", [0.90, 0.96, 0.975, 0.98, 0.985, 0.99, 1.0, 1.05, 1.5])
def test_clipped_pixels_do_not_leak(level):
    """A scene whose longest exposure lies at the clipping limit: noise decides there, reading by reading."""
    time_s = EXPOSURES[2]
    rate = steps((level * 4095 - OFFSET) / time_s)
    merged = merge_brackets(*bracket(rate, np.random.default_rng(5), EXPOSURES[:3]), NOISE)
    error = (merged.rate - rate).astype(float)
    standard = np.sqrt(merged.variance.astype(float).mean() / error.size)
    assert abs(error.mean()) < 4.0 * standard
    assert error.var() < 1.1 * merged.variance.mean()


def test_the_test_above_would_see_a_leak():
    """The same scene merged without care: readings below the limit count, whatever their fellows say."""
    time_s, level = EXPOSURES[2], 0.98
    rate = steps((level * 4095 - OFFSET) / time_s)
    lit, dark = bracket(rate, np.random.default_rng(5), EXPOSURES[:3])
    long, offset = lit[2].counts.astype(float), np.mean([d.counts for d in dark[32:]], axis=0)
    kept = np.where(long < 0.98 * 4095, (long - offset) / time_s, np.nan)
    naive = np.nanmean(kept)
    assert naive < rate.mean() - 40.0 * np.nanstd(kept) / np.sqrt(kept.size)


def test_what_is_clipped_everywhere_is_not_measured():
    rate = np.full((4, 5), 1e4)
    rate[1, 2] = 1e9
    merged = merge_brackets(*bracket(rate, np.random.default_rng(6)), NOISE)
    np.testing.assert_array_equal(merged.usable, rate < 1e9)
    assert np.isnan(merged.rate[1, 2])
    assert np.isnan(merged.variance[1, 2])
    assert np.isfinite(merged.rate[merged.usable]).all()
    assert merged.saturated_share == (0.05, 0.05, 0.05, 0.05, 0.05)
    assert merged.rate.dtype == merged.variance.dtype == np.float32


def test_the_share_of_clipped_pixels_by_exposure():
    rate = np.repeat([1e3, 1e5], 10).reshape(4, 5)
    merged = merge_brackets(*bracket(rate, np.random.default_rng(6)), NOISE)
    assert merged.exposures_s == EXPOSURES
    assert merged.saturated_share == (0.0, 0.0, 0.0, 0.5, 0.5)


def test_black_is_measured_as_black_and_said_to_be_lost():
    rate = steps(0.0, 1e3)
    merged = merge_brackets(*bracket(rate, np.random.default_rng(7)), NOISE)
    assert merged.usable.all()
    standard = np.sqrt(merged.variance[0].mean() / rate.shape[1])
    assert abs(merged.rate[0].mean()) < 5.0 * standard
    assert merged.lost_in_dark[0].mean() > 0.95
    assert not merged.lost_in_dark[1].any()


def test_a_dark_level_that_is_wrong_in_short_exposures_does_not_count():
    """Near-dark readings are left out where a longer exposure has light: their offset is not amplified."""
    rate = steps(200.0)
    lit, dark = bracket(rate, np.random.default_rng(8))
    for number in range(3):  # 3 counts are 3000, 750 and 188 counts/s
        lit[number] = replace(lit[number], counts=(lit[number].counts + 3).astype(np.uint16))
    merged = merge_brackets(lit, dark, NOISE)
    assert merged.rate.mean() == pytest.approx(200.0, rel=4e-3)


def test_dark_current_and_offset_are_those_of_the_exposure():
    rng = np.random.default_rng(9)
    rate = steps(1000.0)
    lit = [expose(rate, t, rng, dark_rate=2000.0) for t in (0.01, 0.3)]
    dark = [expose(0 * rate, t, rng, "dark", dark_rate=2000.0) for t in (0.01, 0.3) for _ in range(16)]
    assert merge_brackets(lit, dark, NOISE).rate.mean() == pytest.approx(1000.0, rel=2e-3)


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (lambda lit, dark: ([], dark), "needs frames"),
        (lambda lit, dark: (lit, dark[1:]), "exposure of 0.001 s has no dark frames"),
        (lambda lit, dark: (lit, [replace(d, gain=2.0) for d in dark]), "differ in gain"),
        (lambda lit, dark: ([replace(lit[0], counts=lit[0].counts[:2]), *lit[1:]], dark), "differ in size"),
        (lambda lit, dark: ([*lit, replace(lit[0], commanded_deg=90.0)], dark), "differ in angle"),
        (lambda lit, dark: ([*lit, replace(lit[0], tilt_deg=20.0)], dark), "differ in tilt"),
        (lambda lit, dark: ([*lit, replace(lit[0], kind="flat")], dark), "differ in kind"),
        (lambda lit, dark: (dark, dark), "differ in kind"),
        (lambda lit, dark: ([*lit, replace(lit[0], bit_depth=16)], dark), "differ in bit depth"),
        (lambda lit, dark: ([*lit, replace(lit[0], filters="rggb")], dark), "differ in colour filters"),
    ],
)
def test_frames_that_do_not_belong_together(spoil, expected):
    lit, dark = bracket(np.full((4, 5), 1e4), np.random.default_rng(0), darks=1)
    with pytest.raises(CalibrationError, match=expected):
        merge_brackets(*spoil(lit, dark), NOISE)
