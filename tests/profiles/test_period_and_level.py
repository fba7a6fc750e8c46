import os
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.heightmap import HeightMap, sampled
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.profiles.level import level
from anisoscope.profiles.period import find_period, take_over_period

DEFAULT = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "heightmaps"
DATA = Path(os.environ.get("ANISOSCOPE_TEST_DATA", DEFAULT))


def measured(pitch, angle=10.0, seed=0, tilt=(0.0, 0.0), shape=(1000, 1000)):
    """A rough, tilted part with noise, 2 % missing points, a hole and spikes."""
    rng = np.random.default_rng(seed)
    surface = ridges(RidgeDesign(pitch, angle), shape, 1.0, phase=float(rng.random()))
    surface = add_facet_roughness(surface, 0.06, 0.1, 6.0, rng)
    rows, cols = np.indices(shape)
    z = surface.height_um + 0.05 * rng.standard_normal(shape) + tilt[0] * cols + tilt[1] * rows
    z[rng.random(shape) < 0.02] = np.nan
    z[shape[0] // 10 : shape[0] // 7, shape[1] // 2 : shape[1] // 2 + 100] = np.nan
    z[rng.random(shape) < 0.0005] += 40.0
    return surface.with_height(z)


def oblique(direction, pitch=97.3, slope=(0.02, -0.01)):
    y, x = np.indices((500, 700)) * np.array([1.7, 1.1])[:, None, None]
    angle = np.radians(direction)
    z = RidgeDesign(pitch, 10.0).profile(x * np.cos(angle) + y * np.sin(angle)) + slope[0] * x + slope[1] * y
    return HeightMap(z, 1.1, 1.7)


@pytest.mark.parametrize("pitch", [50.0, pytest.param(100.0, marks=pytest.mark.soak), 150.0])
@pytest.mark.parametrize("angle", [5.0, 10.0])
def test_pitch_direction_and_tilt_of_a_measured_part(pitch, angle):
    slope = np.tan(np.radians([0.3, -0.2]))
    surface = measured(pitch, angle, tilt=slope)
    period = find_period(surface)
    assert period.is_periodic
    assert period.pitch_um == pytest.approx(pitch, abs=0.05)
    assert period.direction_deg == pytest.approx(0.0, abs=0.02)
    levelled = level(surface, period)
    assert levelled.tilt_x_deg == pytest.approx(0.3, abs=0.005)
    assert levelled.tilt_y_deg == pytest.approx(-0.2, abs=0.005)
    assert np.nanmean(levelled.map.height_um) == pytest.approx(0.0, abs=1e-9)
    assert np.array_equal(np.isnan(levelled.map.height_um), np.isnan(surface.height_um))


def test_a_plane_fit_would_tilt_the_sawtooth():
    surface = ridges(RidgeDesign(100.0, 10.0), (1000, 1001), 1.0)
    periodic = level(surface)
    assert abs(periodic.tilt_x_deg) < 0.002
    assert abs(np.degrees(np.polyfit(np.arange(1001), surface.height_um[0], 1)[0])) > 0.05


@pytest.mark.parametrize("direction", [3.0, 30.0, -45.0, 88.0, 90.0, -70.0])
def test_any_direction_on_pixels_that_are_not_square(direction):
    surface = oblique(direction)
    period = find_period(surface)
    assert period.pitch_um == pytest.approx(97.3, abs=0.01)
    assert period.direction_deg == pytest.approx(direction, abs=0.01)
    levelled = level(surface, period)
    assert (levelled.tilt_x, levelled.tilt_y) == pytest.approx((0.02, -0.01), abs=8e-5)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("lay", [8.0, 60.0, 700.0])
def test_random_surfaces_have_no_period(seed, lay):
    fy, fx = np.fft.fftfreq(400)[:, None], np.fft.fftfreq(400)[None, :]
    noise = np.fft.fft2(np.random.default_rng(seed).standard_normal((400, 400)))
    z = np.fft.ifft2(noise * np.exp(-0.5 * np.pi**2 * ((15 * fx) ** 2 + (lay * fy) ** 2))).real
    period = find_period(HeightMap(z, 1.0, 1.0))
    assert not period.is_periodic
    assert np.isnan(period.pitch_um)


def test_a_map_without_ridges_is_levelled_by_a_plane_and_says_so():
    rng = np.random.default_rng(0)
    y, x = np.indices((90, 80))
    z = 0.01 * rng.standard_normal((90, 80)) + 0.03 * x - 0.01 * y
    z[4, 5] = np.nan
    levelled = level(HeightMap(z, 1.0, 2.0))
    assert (levelled.tilt_x, levelled.tilt_y) == pytest.approx((0.03, -0.005), abs=1e-4)
    assert "least-squares plane" in levelled.map.origin["levelling"]["method"]


def test_flat_tiny_and_empty_maps():
    assert not find_period(HeightMap(np.zeros((50, 50)), 1.0, 1.0)).is_periodic
    assert not find_period(HeightMap(np.eye(3), 1.0, 1.0)).is_periodic
    assert level(HeightMap(np.zeros((2, 2)), 1.0, 1.0)).tilt_x == 0.0
    with pytest.raises(HeightMapError):
        find_period(HeightMap(np.full((50, 50), np.nan), 1.0, 1.0))


@pytest.mark.realdata
@pytest.mark.parametrize(("name", "pitch"), [("opengps_ski.x3p", 690.0), ("opengps_rubber.x3p", None)])
def test_real_surfaces(name, pitch):
    if not (DATA / name).exists():
        pytest.skip(f"{DATA / name} is not there")
    period = find_period(read_height_map(DATA / name))
    assert period.is_periodic == (pitch is not None)
    if pitch is not None:
        assert period.pitch_um == pytest.approx(pitch, abs=4.0)
        assert 50.0 < abs(period.direction_deg) < 70.0


@pytest.mark.parametrize("most", [7, 1000, 60_000])
def test_a_sample_is_every_nth_of_the_chosen_points(most):
    chosen = np.random.default_rng(0).random((3, 100_000)) < 0.7
    places = np.flatnonzero(chosen)
    assert_array_equal(sampled(chosen, most), places[:: max(1, places.size // most)])
    assert sampled(np.zeros((10, 10), dtype=bool), most).size == 0


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_the_period_of_a_turned_map_is_taken_over(quarters):
    source = oblique(30.0)
    turned, searched = (
        HeightMap(np.rot90(source.height_um, quarters), *(1.1, 1.7) if quarters % 2 == 0 else (1.7, 1.1))
        for _ in range(2)
    )
    take_over_period(turned, source, quarters)
    known, found = find_period(turned), find_period(searched)
    assert known.pitch_um == pytest.approx(found.pitch_um, rel=1e-4)
    assert known.direction_deg == pytest.approx(found.direction_deg, abs=0.02)


@pytest.mark.parametrize("start", [0.2, 0.3, 0.4])
@pytest.mark.parametrize(("pitch_um", "angle_deg"), [(40.0, 20.0), (60.0, 10.0), (75.0, 5.0), (100.0, 10.0)])
def test_a_gap_of_three_pitches_does_not_double_the_pitch(pitch_um, angle_deg, start):
    x = np.arange(round(10.0 * pitch_um), dtype=float)
    phase = x / pitch_um % 1.0
    height = np.tan(np.radians(angle_deg)) * pitch_um * np.where(phase < 0.97, phase, 32.3 * (1.0 - phase))
    noise = 0.05 * np.random.default_rng(1).standard_normal((64, x.size))
    made = height + noise
    made[:, int(start * x.size) : int((start + 0.3) * x.size)] = np.nan
    found = find_period(HeightMap(made, 1.0, 1.0))
    assert found.pitch_um == pytest.approx(pitch_um, rel=0.002)
    assert found.score > 0.95
