"""Which optics: rays and waves are both computed for a table of surfaces, and the choice must be right."""

import numpy as np
import pytest

from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light.wave.choice import choose_optics, effective_coherence_um, structure_of
from anisoscope.sim.light.wave.correlation import angular_map
from anisoscope.sim.light.wave.surface import MAX_SHARE, WaveSurface
from anisoscope.sim.light.wave.windows import Extent, Window
from anisoscope.study.papers.levin import slope_density

COUNT, PIXEL, WAVELENGTH = 16384, 0.125, 0.55
X = np.arange(COUNT) * PIXEL
SHARP = Window(Extent("rect", 0.06), Extent("rect", 0.04))
LED = Window(Extent("disc", 0.0175), Extent("disc", 0.0175))
PLASTIC = Window(slope_variance=np.diag([0.1**2 / 2, 0.06**2 / 2]))
SMOOTHER = Window(Extent("disc", 0.0175), slope_variance=np.diag([0.03**2 / 2, 0.03**2 / 2]))


def ridges(pitch, angle):
    """Vertical walls: they send nothing anywhere, in either optics."""
    return RidgeDesign(pitch, angle, "vertical").profile(X)


def sinusoid(pitch, slope):
    return slope * pitch / (2 * np.pi) * np.sin(2 * np.pi * X / pitch)


def fine_ridges(pitch):
    """Fig. 2: the same slopes at every pitch."""
    return 0.1 * np.abs(X % pitch - 0.5 * pitch)


def rough(slope, correlation, seed):
    f = np.fft.rfftfreq(COUNT, PIXEL)
    noise = np.fft.rfft(np.random.default_rng(seed).normal(size=COUNT))
    field = np.fft.irfft(noise * np.exp(-0.5 * (np.pi * f * correlation) ** 2), COUNT)
    return field * slope / np.std(np.diff(field) / PIXEL)


def steps(width, levels, seed=1):
    drawn = np.random.default_rng(seed).choice(levels, COUNT)
    return drawn[(X // width).astype(int)]


TABLE = [
    ("ridges 50 µm, plastic", ridges(50.0, 10.0), PLASTIC, "geometric"),
    ("ridges 100 µm, plastic", ridges(100.0, 10.0), PLASTIC, "geometric"),
    ("ridges 150 µm, plastic", ridges(150.0, 15.0), PLASTIC, "geometric"),
    ("ridges 100 µm, smoother plastic", ridges(100.0, 10.0), SMOOTHER, "geometric"),
    ("ridges 100 µm with a rough face", ridges(100.0, 10.0) + rough(0.02, 20.0, 2), PLASTIC, "geometric"),
    ("ridges 100 µm of metal under an LED", ridges(100.0, 10.0), LED, "wave"),
    ("ridges 300 µm, wide source", ridges(300.0, 8.0), SHARP, "geometric"),
    ("fine ridges 2 µm", fine_ridges(2.0), SHARP, "wave"),
    ("fine ridges 8 µm", fine_ridges(8.0), SHARP, "wave"),
    ("fine ridges 32 µm", fine_ridges(32.0), SHARP, "wave"),
    ("fine ridges 600 µm", fine_ridges(600.0), SHARP, "geometric"),
    ("sinusoid 5 µm", sinusoid(5.0, 0.1), SHARP, "wave"),
    ("sinusoid 20 µm", sinusoid(20.0, 0.1), SHARP, "wave"),
    ("sinusoid 200 µm", sinusoid(200.0, 0.1), SHARP, "geometric"),
    ("sinusoid 400 µm", sinusoid(400.0, 0.15), SHARP, "geometric"),
    ("rough, 60 µm", rough(0.05, 60.0, 3), SHARP, "geometric"),
    ("rough, 2 µm, shallow", rough(0.03, 2.0, 4), SHARP, "wave"),
    ("stepped grating 8 µm", np.where(X % 16.0 < 8.0, 0.1375, 0.0), SHARP, "wave"),
    ("binary dots 12 µm", steps(12.0, [0.0, 0.1375]), SHARP, "wave"),
    ("four levels 6 µm", steps(6.0, [0.0, 0.07, 0.14, 0.2]), LED, "wave"),
    ("blaze 10 µm", ridges(10.0, 3.0), SHARP, "wave"),
    ("blaze 500 µm", ridges(500.0, 5.0), SHARP, "geometric"),
]


def misplaced(heights, window):
    """Share of the light that rays send elsewhere than waves do."""
    surface = WaveSurface.of(heights, PIXEL)
    spread = angular_map(surface, WAVELENGTH, window)
    rays = slope_density(heights, PIXEL, spread.frequency_x, WAVELENGTH, window)
    jumps = float(np.mean(np.abs(np.diff(heights)) / PIXEL > 1.0))
    return (
        0.5 * float(np.abs(spread.density[0] - rays * (1.0 - jumps)).sum()) * np.diff(spread.frequency_x)[0]
    )


@pytest.mark.parametrize(("name", "heights", "window", "expected"), TABLE, ids=[row[0] for row in TABLE])
def test_the_choice_is_right(name, heights, window, expected):
    choice = choose_optics(WaveSurface.of(heights, PIXEL), window)
    assert choice.model == expected, choice.reason
    error = misplaced(heights, window)
    if expected == "geometric":
        assert error < choice.stated_error
    else:
        assert error > 0.03
    for number in (choice.f_um, choice.coherence_um):
        assert f"{number:.3g} µm" in choice.reason
    assert "\n" not in choice.reason


@pytest.mark.parametrize("ratio", [32.0, 48.0, 64.0])
def test_waves_and_rays_agree_on_large_flat_facets(ratio):
    """f ≥ 32·Δc: within the stated 1.4·Δc/f, all over the lobes and in the middle of each."""
    coherence = effective_coherence_um(SHARP, WAVELENGTH)[0]
    heights = fine_ridges(2.0 * ratio * coherence)
    heights = heights[
        : int(COUNT / (2.0 * ratio * coherence / PIXEL)) * round(2.0 * ratio * coherence / PIXEL)
    ]
    choice = choose_optics(WaveSurface.of(heights, PIXEL), SHARP)
    assert choice.f_um == pytest.approx(ratio * coherence, rel=0.02)
    spread = angular_map(WaveSurface.of(heights, PIXEL), WAVELENGTH, SHARP)
    rays = slope_density(heights, PIXEL, spread.frequency_x, WAVELENGTH, SHARP)
    middle = spread.at(np.array([0.1, -0.1]))  # h_x of slopes ∓0.1
    expected = np.interp([0.2 / WAVELENGTH, -0.2 / WAVELENGTH], spread.frequency_x, rays)
    bound = 1.4 / ratio
    np.testing.assert_allclose(middle, expected, rtol=bound)
    step = np.diff(spread.frequency_x)[0]
    assert 0.5 * float(np.abs(spread.density[0] - rays).sum()) * step < bound


def test_facets_under_roughness_lose_less_than_stated():
    """In the middle of the lobe, where geometric optics is chosen."""
    for pitch in (45.0, 60.0, 120.0):
        heights = ridges(pitch, 4.0)
        spread = angular_map(WaveSurface.of(heights, PIXEL), WAVELENGTH, SMOOTHER)
        rays = slope_density(heights, PIXEL, spread.frequency_x, WAVELENGTH, SMOOTHER)
        choice = choose_optics(WaveSurface.of(heights, PIXEL), SMOOTHER)
        at = np.tan(np.radians(4.0))
        found = spread.at(np.array([at]))[0]
        expected = np.interp(2.0 * at / WAVELENGTH, spread.frequency_x, rays)
        assert choice.model == "geometric"
        assert abs(found / expected - 1.0) < choice.stated_error


@pytest.mark.parametrize(
    ("pitch", "angle", "window"), [(50.0, 10.0, PLASTIC), (60.0, 15.0, PLASTIC), (60.0, 10.0, SMOOTHER)]
)
def test_the_stated_error_holds_with_perpendicular_walls(pitch, angle, window):
    """Pixels must hold the phase of the wall, else its light, sin²θ of all, folds back and counts as misplaced."""
    pixel = pitch / round(pitch / 0.015625)
    x = (np.arange(round(4.0 * pitch / pixel)) + 0.5) * pixel
    heights = RidgeDesign(pitch, angle, "perpendicular").profile(x)
    surface = WaveSurface.of(heights, pixel)
    spread = angular_map(surface, WAVELENGTH, window)
    rays = slope_density(heights, pixel, spread.frequency_x, WAVELENGTH, window)
    step = np.diff(spread.frequency_x)[0]
    assert rays.sum() * step == pytest.approx(1.0, abs=1e-3)
    error = 0.5 * float(np.abs(spread.density[0] - rays).sum()) * step
    choice = choose_optics(surface, window)
    assert choice.model == "geometric"
    assert 0.3 * choice.stated_error < error < choice.stated_error


def test_a_map_too_coarse_for_waves_says_so_and_stays_geometric():
    coarse = WaveSurface.of(ridges(20.0, 12.0)[::8], 8 * PIXEL)
    choice = choose_optics(coarse, SHARP)
    assert choice.model == "geometric"
    assert choice.sampling.share > MAX_SHARE
    assert "too coarse for waves" in choice.reason
    assert choice.stated_error == pytest.approx(1.4 * choice.coherence_um / choice.f_um, rel=1e-6)


def test_axes_are_looked_at_separately():
    """Fine ridges across one axis, nothing along the other; turned, the other axis decides."""
    heights = np.tile(fine_ridges(8.0)[:1024], (200, 1))
    for turned in (False, True):
        found = structure_of(WaveSurface.of(heights.T.copy() if turned else heights, PIXEL), WAVELENGTH)
        ridged, plain = (found.along_y, found.along_x) if turned else (found.along_x, found.along_y)
        assert ridged.width_um == pytest.approx(4.0, rel=0.05)
        assert plain.width_um == np.inf
        assert not found.stepped


def test_dots_in_two_dimensions_are_steps():
    dots = np.kron(np.random.default_rng(1).choice([0.0, 0.14], (40, 40)), np.ones((16, 16)))
    choice = choose_optics(WaveSurface.of(dots, 0.25), SHARP)
    assert choice.stepped
    assert choice.model == "wave"


def test_a_plane_needs_no_waves():
    tilted = WaveSurface.of(0.05 * np.add.outer(np.arange(300), np.arange(300)) * 0.25, 0.25)
    choice = choose_optics(tilted, SHARP)
    assert (choice.model, choice.stated_error) == ("geometric", 0.0)
    assert "plain" in choice.reason


def test_coherence_of_all_that_spreads():
    assert effective_coherence_um(SHARP, 0.5)[0] == pytest.approx(5.0)
    assert effective_coherence_um(Window(), 0.5) == (np.inf, np.inf)
    both = Window(Extent("rect", 0.1), slope_variance=np.diag([0.02**2, 0.01**2]))
    x, y = effective_coherence_um(both, 0.5)
    assert x == pytest.approx(0.5 / np.hypot(0.1, np.sqrt(2 * np.pi) * 0.04))
    assert x < y < 5.0
