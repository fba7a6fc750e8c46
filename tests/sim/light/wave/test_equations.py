"""Closed forms, energy, and the printed equations of Levin et al. 2013 that fail."""

import numpy as np
import pytest

from anisoscope.parameters.light import LightSpectrum
from anisoscope.sim.light.wave import claims, quadratic
from anisoscope.sim.light.wave.correlation import angular_map
from anisoscope.sim.light.wave.halfvectors import half_vector
from anisoscope.sim.light.wave.reflectance import brdf, radiance, radiance_scale
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Extent, Window, coherence_length_um

WINDOW = Window(Extent("rect", 0.5 / 16))


@pytest.mark.parametrize("incidence_deg", [0.0, 15.0, 30.0, 45.0, 60.0])
@pytest.mark.parametrize("dimensions", [1, 2])
def test_a_flat_mirror_sends_back_what_it_receives(incidence_deg, dimensions):
    """Energy of the BRDF times cosine over the whole lobe; 1/λ of Eq. 23 for a profile would give 1/λ of it."""
    wavelength, size = 0.5, 40.0
    light = np.array([np.sin(np.radians(incidence_deg)), 0.0, np.cos(np.radians(incidence_deg))])
    reach = 0.16 if dimensions == 1 else 0.3
    edges = np.linspace(-reach, reach, 2001 if dimensions == 1 else 241)
    step = edges[1] - edges[0]
    total, printed = 0.0, 0.0
    for vx in edges - light[0]:
        slant = np.sqrt(max(0.0, 1.0 - vx**2))
        if slant < 1e-3:
            continue
        half = half_vector(light, np.array([vx, 0.0, slant]))
        # the wave over a square dot is a product of two sincs; along y it is narrow and sums to 1/size·size
        lobe = size * np.sinc(size * half.frequency(wavelength)[0]) ** 2
        if dimensions == 1:
            brdf_cosine = radiance_scale(half, wavelength, 1) * lobe / light[2] * half.camera_z
            total += brdf_cosine * step / half.camera_z
            printed += brdf_cosine / wavelength * step / half.camera_z
        else:
            fy = 2.0 * 0.5 * edges / wavelength
            along = np.sum(size * np.sinc(size * fy) ** 2) * step
            total += radiance_scale(half, wavelength) * lobe * along / light[2] * step
    leak = 2.0 / (np.pi**2 * size * reach / wavelength) / 2.0  # of sinc² beyond the reach, one axis
    assert total + leak * (1.0 if dimensions == 1 else 2.0) == pytest.approx(1.0, abs=2e-3)
    if dimensions == 1:
        assert printed > 1.9


@pytest.mark.parametrize("incidence_deg", [0.0, 20.0, 40.0, 60.0])
def test_a_flat_mirror_shows_the_source(incidence_deg):
    """Under a wide source the radiance is that of the source: 1 over its solid angle, whatever the incidence."""
    turn = np.radians(incidence_deg)
    light, camera = (np.array([s * np.sin(turn), 0.0, np.cos(turn)]) for s in (1.0, -1.0))
    size = 0.2
    surface = WaveSurface.of(np.zeros((160, 160)), 0.5)
    found = radiance(surface, light, camera, Window(Extent("rect", size)))[0]
    solid_angle = size**2 / np.cos(turn)  # a square in direction cosines
    assert found * solid_angle == pytest.approx(
        1.0, abs=0.06
    )  # the edge of the dot takes 2·(Δc/π²Δd) an axis
    wide = radiance(WaveSurface.of(np.zeros((480, 480)), 0.5), light, camera, Window(Extent("rect", size)))[0]
    assert abs(wide * solid_angle - 1.0) < 0.4 * abs(found * solid_angle - 1.0)


def test_a_tilted_mirror_shines_where_its_normal_points(direction):
    """Eq. 11 as printed returns R(−h): the carrier's sign is +."""
    slope = 0.05
    surface = WaveSurface.of(slope * 0.25 * np.arange(400), 0.25)
    toward, away = direction(-2.0 * slope), direction(2.0 * slope)  # the normal is (−s, 1)
    up = direction(0.0)
    right = radiance(surface, toward, up, WINDOW)[0]
    printed = radiance(surface, away, up, WINDOW)[0]  # exp(−ik2h_x x) in the window is h → −h
    assert right > 1000.0 * printed
    spread = angular_map(surface, 0.5, WINDOW)
    peak = spread.frequency_x[int(np.argmax(spread.density[0]))]
    assert peak == pytest.approx(-2.0 * slope / 0.5, abs=0.5 / 16)


def test_eq_12_over_the_dot_only_loses_light():
    """x0 must run over all places; the window's tails reach beyond the dot."""
    heights = np.repeat(np.random.default_rng(1).choice([0.0, 0.125], 56), 8)  # a dot of 112 µm
    pixel, coherence, wavelength = 0.25, 16.0, 0.5
    x = np.arange(heights.size) * pixel
    ratios = []
    places = np.arange(-8 * heights.size, 9 * heights.size) * pixel
    kernel = np.sinc((places[:, None] - x) / coherence)
    for h in np.linspace(-0.35, 0.35, 9):
        wave = np.exp(-2j * np.pi * 2.0 / wavelength * heights) * np.exp(
            -2j * np.pi * 2.0 * h / wavelength * x
        )
        power = np.abs(kernel @ wave) ** 2
        inside = (places >= 0.0) & (places <= x[-1])
        total = float(power.sum()) * pixel**3 / coherence / (heights.size * pixel)
        half = half_vector(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]))
        half = type(half)(h, 0.0, 1.0, 1.0, 1.0)
        whole = quadratic.density(WaveSurface.of(heights, pixel), half, wavelength, WINDOW)
        assert total == pytest.approx(whole, rel=0.02)
        ratios.append(float(power[inside].sum() / power.sum()))
    assert min(ratios) < 0.89  # weak directions lose much
    assert max(ratios) < 0.999  # and all of them something


def test_eq_18_needs_the_modulus_and_twice_the_depth():
    """Steps of λ/4 cancel; the printed exponent sees half of the way and the printed sum may be negative."""
    levels, wavelength = (0.0, 0.125), 0.5
    assert abs(claims.mean_phase(levels, wavelength)) < 1e-12
    printed = np.mean(np.exp(-2j * np.pi / wavelength * np.array(levels)))
    assert abs(printed) > 0.7
    spread = angular_map(
        WaveSurface.of(np.tile(np.repeat(levels, 8), 100), 0.25, cells=True), wavelength, WINDOW
    )
    assert spread.at(np.array([0.0]))[0] < 1e-3 * spread.density.max()
    below = np.mean(
        np.exp(-4j * np.pi / 0.4 * np.array([0.0, 0.1]))
    )  # real and negative part: no bound at all
    assert below.real <= 1e-9
    assert np.mean(np.exp(-4j * np.pi / 0.4 * np.array([0.1, 0.1]))).real == pytest.approx(-1.0)


@pytest.mark.parametrize(
    ("passes_nm", "largest"),
    [
        ((127.3,), 0.416),
        ((107.3, 157.5), 0.0901),
        ((103.3, 127.9, 166.5), 0.0192),
        ((101.8, 116.1, 142.3, 170.0), 0.0041),
    ],
)
def test_depth_sets_over_visible_light(passes_nm, largest):
    """Sets of 2, 4, 8 and 16 levels: each is far better than the one before."""
    levels = [0.0]
    for depth in passes_nm:
        levels += [level + 1e-3 * depth for level in levels]
    worst = max(abs(claims.mean_phase(levels, wavelength)) for wavelength in np.linspace(0.4, 0.7, 301))
    assert 0.97 * largest < worst < largest


def test_dirichlet_kernel_against_the_printed_sinc():
    """Eq. 17 and 56 with sinc are off by 14.7 % of the peak at m = 2; the sum itself is the Dirichlet kernel."""
    f, width = np.linspace(-0.5, 0.5, 4001) / 2.0, 2.0
    for count, gap in ((2, 0.147), (4, None)):
        centres = (np.arange(count) - 0.5 * (count - 1)) * width
        exact = np.abs(np.exp(-2j * np.pi * np.outer(f, centres)).mean(axis=1)) ** 2
        np.testing.assert_allclose(claims.dirichlet2(f, count, width), exact, atol=1e-12)
        printed = np.sinc(count * f * width) ** 2
        envelope = np.sinc(f * width) ** 2
        true, wrong = (1.0 - exact) * envelope, (1.0 - printed) * envelope
        if gap is not None:
            assert np.max(np.abs(true - wrong)) / true.max() == pytest.approx(gap, abs=0.01)
    assert np.all(claims.dirichlet2(np.array([0.5, 1.0, -1.5]), 4, 2.0) == 1.0)  # the hole comes again


def test_first_zero_of_the_lobe_and_sizes_of_coherence(direction):
    """a0 = 2 µm, λ = 0.5 µm: v_x = 0.25; 0.4° is 71.6 µm, 1.8° is 15.9 µm."""
    lobe = claims.lobe(np.array([0.0, 2.0 * 0.125 / 0.5]), np.array([2.0]), np.array([1.0]))
    assert lobe[1] / lobe[0] < 1e-20
    assert coherence_length_um(0.5, np.radians(0.4)) == pytest.approx(71.6, abs=0.05)
    assert coherence_length_um(0.5, np.radians(1.8)) == pytest.approx(15.9, abs=0.05)
    assert pytest.approx(115.5, abs=0.05) == 25400.0 / 220.0


def test_a_spectrum_is_the_weighted_mean_of_its_lines(rough_steps, direction):
    surface = WaveSurface.of(rough_steps, 0.25)
    light, camera = direction(0.1), direction(0.02)
    lines = [
        radiance(surface, light, camera, WINDOW, LightSpectrum((w,), (1.0,)), check=False)[0]
        for w in (0.5, 0.6)
    ]
    both = radiance(surface, light, camera, WINDOW, LightSpectrum((0.5, 0.6), (3.0, 1.0)), check=False)[0]
    assert both == pytest.approx(0.75 * lines[0] + 0.25 * lines[1], rel=1e-12)
    led = LightSpectrum.led(550.0, 40.0)
    assert np.dot(led.wavelengths_um, led.weights) == pytest.approx(0.55)
    assert brdf(surface, light, camera, WINDOW, LightSpectrum((0.9,)))[0] > 0.0
