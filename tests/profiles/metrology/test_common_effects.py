"""What all ridges of a map share: effects that no scatter between ridges shows."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.metrology.ridges import measure_ridges

ROWS, COLS = 360, 700


def correlated(rng, length, shape):
    """Heights of standard deviation 1 whose correlation is exp(−τ²/length²), in pixels."""
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :]
    gain = np.sqrt(np.pi) * length * np.exp(-0.5 * np.pi**2 * length**2 * (fx**2 + fy**2))
    return np.fft.irfft2(np.fft.rfft2(rng.standard_normal(shape)) * gain, s=shape)


def drawn(rng, angle=10.0, wall=78.0, pitch=70.0, foot=0.0, length=5.0, slope=0.07, noise=0.02):
    """Ridges along y with a foot of this radius, rough and noisy; heights (ROWS, COLS) in µm of a pixel of 1 µm.

    Returns them with their true height from foot to crest and the true α at a lag of one pixel.
    """
    a, b = np.tan(np.radians([angle, wall]))
    run = pitch / (1.0 + a / b)  # of the facet
    x = np.mod(np.arange(COLS) + pitch * rng.random(), pitch)
    z = np.where(x < run, a * (run - x), b * (x - run))
    lowest = 0.0
    if foot:
        half = 0.5 * np.radians(180.0 - angle - wall)
        reach = foot / np.tan(half)
        centre_x = run + reach * np.cos(np.radians(wall)) - foot * np.sin(np.radians(wall))
        centre_z = reach * np.sin(np.radians(wall)) + foot * np.cos(np.radians(wall))
        on = (x > run - reach * np.cos(np.radians(angle))) & (x < run + reach * np.cos(np.radians(wall)))
        z[on] = centre_z - np.sqrt(foot**2 - (x[on] - centre_x) ** 2)
        lowest = centre_z - foot
    sigma = slope * length / np.sqrt(2.0)
    heights = z + sigma * correlated(rng, length, (ROWS, COLS)) + noise * rng.standard_normal((ROWS, COLS))
    alpha = 2.0 * sigma * np.sqrt(-np.expm1(-1.0 / length**2))
    return heights, a * run - lowest, alpha


def within(quantity, truth, times=2.5):
    """Whether a value holds the truth within its uncertainty, or a bound holds it."""
    if quantity.value is None:
        return quantity.at_most is None or truth <= quantity.at_most
    return abs(quantity.value - truth) <= times * quantity.u


def remarks(found, words):
    return any(words in one for one in found.remarks())


@pytest.mark.parametrize("step_um", [0.02, 0.1])
def test_lines_that_drift_are_taken_off_alpha(step_um):
    rng = np.random.default_rng(1)
    z, _, alpha = drawn(rng)
    found = measure_ridges(HeightMap(z + step_um * np.cumsum(rng.standard_normal(ROWS))[:, None], 1.0, 1.0))
    assert within(found.alpha_along, alpha)
    assert within(found.alpha_across, alpha)
    assert found.line_drift_um == pytest.approx(step_um, rel=0.2)
    assert remarks(found, "lines of the scan")


def test_steps_along_the_ridges_are_told():
    rng = np.random.default_rng(2)
    z, _, alpha = drawn(rng)
    found = measure_ridges(HeightMap(z + 0.05 * rng.standard_normal(COLS), 1.0, 1.0))
    assert found.lay_um == pytest.approx(0.05 * np.sqrt(2.0), rel=0.3)
    assert remarks(found, "along the ridges")
    assert within(found.alpha_along, alpha)


@pytest.mark.parametrize("step_um", [0.1, 1.0])
def test_rounded_heights_widen_alpha_or_withhold_it(step_um):
    z, _, alpha = drawn(np.random.default_rng(3))
    found = measure_ridges(HeightMap(step_um * np.rint(z / step_um), 1.0, 1.0))
    assert within(found.alpha_along, alpha)
    assert within(found.alpha_across, alpha)
    assert found.height_step_um in (0.0, pytest.approx(step_um))
    if step_um == 1.0:
        assert found.alpha_along.value is None
        assert remarks(found, "rounded")


@pytest.mark.parametrize("length", [1.0, 1.6, 2.4])
@pytest.mark.parametrize("noise", [0.005, 0.05])
def test_roughness_of_less_than_three_pixels_is_no_noise(length, noise):
    z, _, alpha = drawn(np.random.default_rng(4), length=length, noise=noise)
    found = measure_ridges(HeightMap(z, 1.0, 1.0))
    assert within(found.alpha_along, alpha)
    assert within(found.alpha_across, alpha)
    assert remarks(found, "three pixels") or found.alpha_along.u < 0.02 * alpha


@pytest.mark.parametrize("radius", [4.0, 6.0])
def test_a_rounded_foot_has_a_radius_and_takes_from_the_height(radius):
    z, height, _ = drawn(np.random.default_rng(5), foot=radius, wall=70.0)
    found = measure_ridges(HeightMap(z, 1.0, 1.0))
    assert within(found.height_um, height)
    assert within(found.foot_radius_um, radius)
    assert found.foot_loss.value > 3.0 * found.foot_loss.u
    turned = measure_ridges(HeightMap(-z, 1.0, 1.0))  # what was the foot is the crest
    assert turned.edge_radius_um.known == found.foot_radius_um.known
    for seen, other in ((turned.edge_radius_um, found.foot_radius_um), (turned.height_loss, found.foot_loss)):
        assert (seen.value or seen.at_most) == pytest.approx(other.value or other.at_most, rel=1e-3)
    assert turned.height_um.value == pytest.approx(found.height_um.value, rel=1e-3)


def test_ridges_that_change_along_their_length_are_told():
    rng = np.random.default_rng(6)
    z, state = drawn(rng)[0], np.random.default_rng(7)
    steep = drawn(np.random.default_rng(6), angle=12.0)[0]
    z[ROWS // 2 :] = steep[ROWS // 2 :]
    found = measure_ridges(HeightMap(z, 1.0, 1.0))
    assert found.varies_along
    assert remarks(found, "not the same along")
    ends = [one.angle_deg.value for one in (found.segments[0], found.segments[-1])]
    assert ends == pytest.approx([10.0, 12.0], abs=0.1)
    same = measure_ridges(HeightMap(drawn(state)[0], 1.0, 1.0))
    assert not same.varies_along
    assert same.remarks() == ()


@pytest.mark.parametrize("tilt_deg", [0.0, 3.0])
def test_the_pitch_on_a_tilted_surface(tilt_deg):
    z, _, _ = drawn(np.random.default_rng(8))
    slope = np.tan(np.radians(tilt_deg))
    found = measure_ridges(HeightMap(z + slope * np.arange(COLS) + 0.01 * np.arange(ROWS)[:, None], 1.0, 1.0))
    expected = 70.0 * np.sqrt(1.0 + slope**2 / (1.0 + 0.01**2))
    assert found.surface_pitch_um.value == pytest.approx(expected, abs=3.0 * found.surface_pitch_um.u)
    plain = replace(found.surface_pitch_um, value=found.pitch_um.value)
    assert plain.value == pytest.approx(70.0, abs=3.0 * found.pitch_um.u)
