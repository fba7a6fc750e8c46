import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.proof.halftone import SEED, SIZE, thresholds, void_and_cluster


def test_the_mask_of_the_package_holds_every_threshold_once():
    found = thresholds()
    assert found.shape == (SIZE, SIZE)
    np.testing.assert_array_equal(
        np.sort(found.ravel()), ((np.arange(SIZE**2) + 0.5) / SIZE**2).astype(np.float32)
    )


def test_it_is_what_the_generating_command_makes(tmp_path):
    from anisoscope.sim.proof.halftone import main

    assert SEED == 1993
    written = np.load(main(tmp_path))
    np.testing.assert_array_equal(
        ((written.astype(float) + 0.5) / written.size).astype(np.float32), thresholds()
    )


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.8])
def test_dots_have_little_power_at_low_frequencies_on_the_torus(share):
    dots = (thresholds() < share).astype(float)
    power = np.abs(np.fft.fft2(dots - dots.mean())) ** 2 / dots.size / (share * (1 - share))
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(SIZE), np.fft.fftfreq(SIZE)))
    # white noise has power 1 at all frequencies
    low = (frequency > 0) & (frequency < 0.3 * min(np.sqrt(min(share, 1 - share)), 0.5))
    assert power[low].mean() < 0.05
    assert power[frequency > 0.3].mean() > 0.8


def test_first_dots_are_far_from_each_other():
    ranks = void_and_cluster(32, np.random.default_rng(0))
    assert sorted(ranks.ravel()) == list(range(1024))
    places = np.argwhere(ranks < 64)
    apart = np.abs(places[:, None] - places[None])
    apart = np.hypot(*np.moveaxis(np.minimum(apart, 32 - apart), -1, 0))
    np.fill_diagonal(apart, np.inf)
    assert apart.min() >= 2.5  # 4 between the dots of a square grid


@pytest.mark.parametrize(("size", "sigma"), [(4, 1.5), (32, 0.1), (32, 9.0)])
def test_masks_that_cannot_be_made(size, sigma):
    with pytest.raises(ModelError):
        void_and_cluster(size, np.random.default_rng(0), sigma)
