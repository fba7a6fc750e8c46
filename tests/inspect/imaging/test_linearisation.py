"""Synthetic frames made of whole counts, so that radiance comes back without a remainder."""

import dataclasses

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError
from anisoscope.imaging.linearisation import WhiteReference, hot_pixels, linearise, stack, upper_quantile
from anisoscope.rig.frame import Frame

SHAPE = (40, 60)
WHITE = 0.3


def frame(counts, *, exposure_s=1.0, gain=1.0, bits=16, kind="sample"):
    return Frame(
        np.asarray(counts).astype(np.uint16), kind, bits, 64.0, exposure_s, gain, 0.0, 0.0, 0.0, "", "X"
    )


def white(signal):
    return WhiteReference(np.asarray(signal, dtype=np.float32), WHITE, "X", "", 0.99, "")


@pytest.fixture
def scene(rng):
    """Vignetting from 5 to 20, dark level, and radiance in thousandths of the tile's."""
    shade = np.rint(20 - 15 * np.linspace(0, 1, SHAPE[1]) ** 2)[None, :] + np.zeros((SHAPE[0], 1))
    return shade, rng.integers(60, 70, SHAPE).astype(float), rng.integers(50, 3000, SHAPE).astype(float)


@pytest.mark.parametrize(("exposure_s", "gain"), [(1.0, 1.0), (0.25, 1.0), (0.5, 2.0)])
def test_radiance_comes_back_whatever_shading_exposure_and_gain(scene, exposure_s, gain):
    shade, dark, thousandths = scene
    factor = exposure_s * gain
    thousandths = np.rint(thousandths * factor) / factor
    sample = stack([frame(dark + shade * thousandths * factor, exposure_s=exposure_s, gain=gain)] * 2)
    off = stack([frame(dark, exposure_s=exposure_s, gain=gain, kind="dark")] * 2)
    image = linearise(sample, off, white(1000.0 * shade), 65535)
    known = ~image.saturated
    np.testing.assert_allclose(image.value[known], (WHITE * thousandths / 1000.0)[known], rtol=1e-6)
    assert not image.noise[known].any()


def test_a_stuck_column_has_no_value_and_does_not_count_as_saturated():
    counts, dark = np.full(SHAPE, 500), np.full(SHAPE, 60)
    counts[:, 7] = dark[:, 7] = 4095
    image = linearise(
        stack([frame(counts, bits=12)] * 2),
        stack([frame(dark, bits=12)] * 2),
        white(np.full(SHAPE, 1000.0)),
        4095,
    )
    assert not image.saturated.any()
    assert np.unique(np.argwhere(~image.usable)[:, 1]).tolist() == [7]


def test_saturated_pixels_have_no_value_even_if_only_one_frame_saturates():
    counts = np.full(SHAPE, 500)
    burnt = counts.copy()
    burnt[3, 4] = np.ceil(0.98 * 4095)
    image = linearise(
        stack([frame(counts, bits=12), frame(burnt, bits=12)]),
        stack([frame(np.full(SHAPE, 60))] * 2),
        white(np.full(SHAPE, 1000.0)),
        4095,
    )
    assert np.argwhere(image.saturated).tolist() == [[3, 4]]
    assert np.argwhere(~image.usable).tolist() == [[3, 4]]
    assert np.array_equal(np.isnan(image.noise), ~image.usable)


def test_hot_pixels_and_unlit_corners_have_neither_value_nor_noise(rng):
    dark = rng.normal(64.0, 0.8, (4, *SHAPE))
    dark[:, 7, 9] += 40.0
    flat = np.full(SHAPE, 1000.0)
    flat[:3, :3] = 2.0
    sample = stack(frame(np.rint(d + rng.poisson(0.4 * flat))) for d in dark)
    off = stack(frame(np.rint(d), kind="dark") for d in dark)
    assert np.argwhere(hot_pixels(off)).tolist() == [[7, 9]]
    image = linearise(sample, off, white(flat), 65535)
    expected = np.zeros(SHAPE, bool)
    expected[7, 9] = expected[:3, :3] = True
    assert np.array_equal(~image.usable, expected)
    assert np.nanmax(image.noise) < 0.1 * WHITE


def test_the_noise_estimate_is_the_true_error(rng):
    """Poisson light, read noise, few frames: the estimate's rms is the rms deviation from the truth."""
    shade, level, read, count = np.linspace(800.0, 1600.0, SHAPE[1])[None, :] + np.zeros(SHAPE), 0.12, 5.0, 4

    def take(electrons, kind):
        return [
            frame(np.rint(64 + rng.poisson(electrons) + read * rng.standard_normal(SHAPE)), kind=kind)
            for _ in range(count)
        ]

    image = linearise(
        stack(take(shade * level / WHITE, "sample")),
        stack(take(np.zeros(SHAPE), "dark")),
        white(shade),
        65535,
    )
    error = (image.value - level).astype(float)
    assert np.sqrt(np.mean(image.noise.astype(float) ** 2)) == pytest.approx(error.std(), rel=0.05)
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(error.size)


def test_the_mean_of_a_stack_and_its_spread(rng):
    cube = rng.integers(0, 4000, (5, *SHAPE))
    found = stack(frame(c) for c in cube)
    np.testing.assert_allclose(found.mean, cube.mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(found.noise, cube.std(axis=0, ddof=1), rtol=1e-5)


@pytest.mark.parametrize(
    "change", [{"exposure_s": 2.0}, {"gain": 2.0}, {"counts": np.zeros((4, 4), np.uint16)}]
)
def test_frames_of_one_pose_must_be_alike(change):
    one = frame(np.zeros(SHAPE))
    with pytest.raises(CalibrationError, match="differ in size, exposure or gain"):
        stack([one, dataclasses.replace(one, **change)])


def test_no_frames_are_no_stack():
    with pytest.raises(CalibrationError, match="no frames"):
        stack([])


@pytest.mark.parametrize(
    ("dark", "flat", "message"),
    [
        ({"exposure_s": 2.0}, SHAPE, "exposure or gain"),
        ({"gain": 2.0}, SHAPE, "exposure or gain"),
        ({"counts": np.zeros((4, 4), np.uint16)}, SHAPE, "differ in size"),
        ({}, (60, 40), "the flat has 40 × 60 pixels, the frames 60 × 40"),
    ],
)
def test_dark_frames_and_flat_must_fit_the_frames(dark, flat, message):
    one = frame(np.full(SHAPE, 500))
    with pytest.raises(CalibrationError, match=message):
        linearise(stack([one]), stack([dataclasses.replace(one, **dark)]), white(np.ones(flat)), 65535)


@pytest.mark.parametrize("share", [0.002, 0.4])
def test_signal_share_is_that_of_the_brightest_parts(share):
    sample, dark = (stack([frame(np.full(SHAPE, c))]) for c in (64 + share * 60000, 64))
    image = linearise(sample, dark, white(np.ones(SHAPE)), 60000)
    assert image.signal_share == pytest.approx(share, abs=1e-5)


@pytest.mark.parametrize("share", [0.5, 0.9, 0.99, 0.995, 1.0])
def test_an_upper_quantile_is_that_of_numpy(rng, share):
    for values in (
        rng.normal(size=(300, 400)),
        np.sort(rng.exponential(size=5000)),
        np.ones(7),
        rng.normal(size=3),
    ):
        wanted = np.quantile(values.astype(np.float32), share)
        assert upper_quantile(values.astype(np.float32), share) == pytest.approx(wanted, rel=1e-6)


def test_the_noise_of_a_window_is_part_of_the_noise(rng):
    frames, darks = ([frame(rng.integers(50 * k, 60 * k, (90, 70))) for _ in range(3)] for k in (20, 1))
    flat = WhiteReference(np.full((90, 70), 1e5, np.float32), 0.3, "X", "", 0.99, "0")
    image = linearise(stack(frames), stack(darks), flat, 4095)
    window = slice(13, 50), slice(7, 69)
    assert np.ptp(image.noise) > 0.0
    np.testing.assert_array_equal(image.noise_in(window), image.noise[window])


@pytest.mark.parametrize("count", [3, 300])
def test_the_mean_of_frames_is_rounded_once(rng, count):
    cube = rng.integers(0, 2**16, (count, 12, 9)).astype(np.uint16)
    found = stack([frame(counts) for counts in cube]).mean
    np.testing.assert_array_equal(found, cube.mean(axis=0, dtype=np.float64).astype(np.float32))
