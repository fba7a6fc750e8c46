"""Sampling of the phase, interpolation of heights, missing points."""

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light.wave.correlation import angular_map
from anisoscope.sim.light.wave.surface import (
    MAX_SHARE,
    WaveSurface,
    on_plateaus,
    sampling_of,
    slope_limit_deg,
)
from anisoscope.sim.light.wave.windows import Extent, Window

WINDOW = Window(Extent("rect", 0.5 / 16))


@pytest.mark.parametrize(("pixel", "slope"), [(0.25, 26.6), (0.5, 14.0), (1.0, 7.1)])
def test_slopes_that_pixels_resolve(pixel, slope):
    assert slope_limit_deg(pixel, 0.5) == pytest.approx(slope, abs=0.05)
    for factor, over in ((0.98, 0.0), (1.02, 1.0)):
        rise = factor * np.tan(np.radians(slope_limit_deg(pixel, 0.5))) * pixel
        found = sampling_of(WaveSurface.of(np.arange(200) * rise, pixel), 0.5)
        assert found.share == pytest.approx(over, abs=0.02)


def test_a_coarse_map_is_refused_with_the_worst_place_and_what_to_do():
    x = np.arange(300) * 0.5
    line = 3.0 * np.sin(2 * np.pi * x / 50.0)
    heights = np.tile(line, (700, 1))
    heights[600:, 100:] += 0.4 * (x[100:] - x[100])  # the steepest stretch lies in the second block of rows
    found = sampling_of(WaveSurface.of(HeightMap(heights, 0.5, 0.5)), 0.5)
    row, col = found.worst_pixel
    assert row >= 600
    assert abs(heights[row, col + 1] - heights[row, col]) == pytest.approx(found.worst_change_um, rel=1e-4)
    over = np.abs(np.diff(heights, axis=1)) > 0.125
    assert found.share == pytest.approx(np.count_nonzero(over) / heights.size, rel=0.03)
    with pytest.raises(HeightMapError) as error:
        found.check()
    text = str(error.value)
    for words in (
        f"{found.share:.1%}",
        f"row {row}, column {col}",
        "125 nm",
        "14.0°",
        "smaller pixels",
        "geometric",
    ):
        assert words in text
    assert "\n" not in text


def test_steps_between_levels_are_no_doubt():
    rng = np.random.default_rng(3)
    steps = np.kron(rng.choice([0.0, 0.3, 5.0], (40, 40)), np.ones((8, 8)))
    sampling_of(WaveSurface.of(steps, 0.25), 0.5).check()
    noise = WaveSurface.of(0.1 * rng.normal(size=(200, 200)), 0.25)
    assert sampling_of(noise, 0.5).share > 0.2


def test_heights_are_interpolated_never_the_wave():
    """A smooth map of which a third is over the limit: finer heights repair its spectrum, a finer wave does not."""
    pixel, fine = 0.5, 8
    x = (np.arange(2048 * fine) + 0.5) * pixel / fine

    def heights(at):
        return 1.3 * np.sin(2 * np.pi * at / 31.0) + 0.7 * np.sin(2 * np.pi * at / 47.0 + 1.0)

    true = angular_map(WaveSurface.of(heights(x), pixel / fine), 0.5, WINDOW)
    coarse_x = (np.arange(2048) + 0.5) * pixel
    coarse = WaveSurface.of(heights(coarse_x), pixel)
    assert 0.1 < sampling_of(coarse, 0.5).share < 0.6
    repaired = angular_map(coarse.interpolated(fine), 0.5, WINDOW)
    raw = angular_map(coarse, 0.5, WINDOW)
    wave = np.exp(-4j * np.pi / 0.5 * heights(coarse_x))
    between = np.interp(x, coarse_x, wave.real) + 1j * np.interp(x, coarse_x, wave.imag)
    spectrum = np.abs(np.fft.fftshift(np.fft.fft(between, 2 * x.size))) ** 2
    f = np.fft.fftshift(np.fft.fftfreq(2 * x.size, pixel / fine))
    inside = np.abs(f) < 1.5
    expected = true.at(0.25 * f[inside])
    blurred = uniform_filter1d(spectrum, int(0.5 / 16 / 0.5 / (f[1] - f[0])))[inside]

    def off(found):
        reference = expected / expected.sum()
        return np.linalg.norm(found / found.sum() - reference) / np.linalg.norm(reference)

    assert off(repaired.at(0.25 * f[inside])) < 0.012
    assert off(raw.at(0.25 * f[inside])) > 0.1
    assert off(blurred) > 0.1


def test_missing_points_are_counted_and_refused():
    heights = np.zeros((20, 30))
    heights[3, 4:9] = np.nan
    with pytest.raises(HeightMapError, match=r"5 of 600 pixels \(0.83%\).*fill.*crop") as error:
        WaveSurface.of(HeightMap(heights, 1.0, 1.0))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: WaveSurface.of(np.zeros((4, 4))), "pixel size"),
        (lambda: WaveSurface.of(np.zeros((2, 2, 2)), 1.0), "profile or a map"),
        (lambda: WaveSurface.of(np.zeros((64, 64)), 1.0).interpolated(0), "1 times or more"),
        (lambda: WaveSurface.of(np.zeros((64, 64)), 1.0).interpolated(1000), "crop"),
    ],
)
def test_heights_that_are_none_are_refused(wrong, words):
    with pytest.raises(HeightMapError, match=words):
        wrong()


def test_steps_stay_where_they_are():
    steps = WaveSurface.of(np.repeat([0.0, 0.1, 0.0], 20), 0.25, cells=True)
    assert steps.interpolated(4) is steps


def random_levels(levels, seed=0, shape=(40, 50)):
    return np.asarray(levels)[np.random.default_rng(seed).integers(len(levels), size=shape)]


X = np.arange(200)
SAW = np.broadcast_to(0.4 * (X % 20) / 20.0, (30, 200))
WAVY = np.broadcast_to(0.3 * np.sin(2.0 * np.pi * X / 20.0), (30, 200))


@pytest.mark.parametrize(
    ("heights", "stepped"),
    [
        (random_levels(np.arange(16) * 0.0172), True),
        (random_levels([0.0, 0.5]), True),
        (random_levels(np.arange(4) * 0.1) + 0.001 * random_levels([0.0, 1.0, 2.0], 1), True),
        (random_levels(np.arange(60) * 0.02), False),
        (np.random.default_rng(2).normal(0.0, 0.2, (40, 50)), False),
        (SAW, False),
        (WAVY, False),
        (np.zeros((8, 8)), False),
    ],
)
def test_plateaus_are_found_by_their_heights(heights, stepped):
    found = on_plateaus(WaveSurface.of(heights, 0.5), 0.55)
    assert found.cells == stepped
    if stepped:
        assert sampling_of(found, 0.55).share == 0.0
        assert sampling_of(WaveSurface.of(heights, 0.5), 0.4).share > (0.0 if np.ptp(heights) < 0.1 else 0.2)


def test_declared_plateaus_may_be_noisy_and_slopes_are_judged_within_them():
    rng = np.random.default_rng(3)
    heights = random_levels(np.arange(4) * 0.13) + rng.normal(0.0, 0.008, (40, 50))
    plain = WaveSurface.of(heights, 0.5)
    assert not on_plateaus(plain, 0.55).cells
    found = on_plateaus(plain, 0.55, steps=4)
    assert found.cells
    assert np.allclose(np.array(found.edges_um) + heights.mean(), [0.065, 0.195, 0.325], atol=0.005)
    assert sampling_of(found, 0.55).share == 0.0
    deep = WaveSurface.of(10.0 * heights, 0.5)  # two heights of one plateau differ by more than the limit
    assert sampling_of(on_plateaus(deep, 0.55, steps=4), 0.55).share > MAX_SHARE


@pytest.mark.parametrize("steps", [1, 3, 7, 33])
def test_plateaus_that_are_noise_are_refused(steps):
    heights = np.random.default_rng(4).normal(0.0, 0.2, (40, 50))
    with pytest.raises(HeightMapError, match="plateaus") as refused:
        on_plateaus(WaveSurface.of(heights, 0.5), 0.55, steps)
    assert "\n" not in str(refused.value)
