"""Fused pass, padded FFT and correlation against the quadratic form, pair by pair in double precision."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.light.wave import fused, quadratic
from anisoscope.sim.light.wave.correlation import angular_map, correlation_of, reach_um
from anisoscope.sim.light.wave.halfvectors import half_vector
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import POINT, Extent, Window

SQUARE = Window(Extent("rect", 0.12))
DISCS = Window(Extent("disc", 0.08), Extent("disc", 0.06, np.array([[0.9, 0.0], [0.0, 1.0]])))
ROUGH = Window(Extent("rect", 0.03), POINT, np.array([[1.5e-3, 2e-4], [2e-4, 8e-4]]))
PAIRS = [((0.0, 0.0), (0.0, 0.0)), ((0.17, 0.0), (0.0, 0.05)), ((0.3, 0.1), (-0.1, 0.12))]


@pytest.mark.parametrize("window", [SQUARE, DISCS, ROUGH], ids=["square", "discs", "rough"])
@pytest.mark.parametrize("light_camera", PAIRS)
def test_every_way_is_the_quadratic_form(rough_steps, direction, window, light_camera):
    surface = WaveSurface.of(rough_steps, 0.25)
    half = half_vector(*(direction(*one) for one in light_camera))
    exact = quadratic.density(surface, half, 0.55, window)
    assert fused.density(surface, half, 0.55, window) == pytest.approx(exact, rel=5e-4)
    spread = angular_map(surface, 0.55, window, half.z, padding=8.0)
    assert spread.at(np.array([half.x]), np.array([half.y]))[0] == pytest.approx(exact, rel=5e-3)


def test_padded_fft_is_exact_at_its_bins(rough_steps):
    surface = WaveSurface.of(rough_steps, 0.25)
    spread = angular_map(surface, 0.55, DISCS, 0.98)
    rng = np.random.default_rng(2)
    for row, col in rng.integers(20, 60, (4, 2)):
        x, y = 0.275 * spread.frequency_x[col], 0.275 * spread.frequency_y[row]
        half = half_vector(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]))
        half = type(half)(x, y, 0.98, 0.98, 0.98)
        assert spread.density[row, col] == pytest.approx(
            quadratic.density(surface, half, 0.55, DISCS), rel=1e-3
        )


@pytest.mark.parametrize("extent", [0.55 / 16, 0.55 / 40])
def test_decimation_keeps_a_profile_within_half_a_permille(direction, extent):
    """Long enough to be decimated 20 and 50 times; weak directions too."""
    rng = np.random.default_rng(5)
    heights = np.repeat(rng.choice([0.0, 0.07, 0.125], 160), 8) + 0.01 * rng.normal(size=1280)
    surface, window = (
        WaveSurface.of(heights, 0.25),
        Window(Extent("rect", extent), Extent("rect", 0.3 * extent)),
    )
    steps = []
    for x in (0.0, 0.25, 0.31):
        half = half_vector(direction(x), direction(0.0))
        steps.append(fused.reduce(surface, half, 0.55, window).along_x.step)
        exact = quadratic.density(surface, half, 0.55, window)
        assert fused.density(surface, half, 0.55, window) == pytest.approx(exact, rel=5e-4)
    assert min(steps) >= 12


def test_decimation_of_a_map_in_strips(direction):
    """Several strips, both axes decimated, against the map's own spectrum."""
    rng = np.random.default_rng(6)
    surface = WaveSurface.of(np.kron(rng.choice([0.0, 0.125], (75, 100)), np.ones((8, 8))), 0.25)
    window = Window(Extent("disc", 0.06), Extent("disc", 0.03))
    spread = angular_map(surface, 0.5, window, 1.0)
    row, col = spread.frequency_y.size // 2 + 60, spread.frequency_x.size // 2 - 85
    half = half_vector(direction(0.0), direction(0.0))
    half = type(half)(0.25 * spread.frequency_x[col], 0.25 * spread.frequency_y[row], 1.0, 1.0, 1.0)
    reduced = fused.reduce(surface, half, 0.5, window)
    assert reduced.along_x.step > 3
    assert reduced.along_y.step > 3
    assert fused.density(surface, half, 0.5, window) == pytest.approx(spread.density[row, col], rel=5e-4)


@pytest.mark.parametrize("profile", [True, False])
def test_correlation_from_tiles_is_that_of_the_whole(direction, profile):
    rng = np.random.default_rng(3)
    shape = (1200,) if profile else (700, 600)
    heights = np.cumsum(0.03 * rng.normal(size=shape), axis=-1)
    surface = WaveSurface.of(heights, 0.25)
    window = Window(Extent("disc", 0.03), POINT, np.diag([4e-3, 2e-3]))
    half = half_vector(direction(0.1, 0.03), direction(0.0))
    found = correlation_of(surface, 0.55, half.z, reach_um(window, 0.55, half.z))
    assert found.density(half, window) == pytest.approx(fused.density(surface, half, 0.55, window), rel=1e-4)


def test_an_endless_profile_is_a_long_map(direction):
    """A map of equal rows, 60 coherence lengths long, shines like its profile drawn out; the rest are its ends."""
    rng = np.random.default_rng(4)
    line = np.cumsum(0.03 * rng.normal(size=400))
    window = Window(Extent("disc", 0.05), POINT, np.array([[4e-3, 1e-3], [1e-3, 3e-3]]))
    half = half_vector(direction(0.12, 0.04), direction(-0.02, 0.03))
    reach = reach_um(window, 0.55, half.z)
    long = correlation_of(WaveSurface.of(np.tile(line, (240, 1)), 0.25), 0.55, half.z, reach, endless=True)
    thin = correlation_of(WaveSurface.of(line, 0.25), 0.55, half.z, reach, endless=True)
    assert thin.extruded_density(half, window) == pytest.approx(long.density(half, window), rel=1e-3)


def test_short_distances_need_roughness():
    with pytest.raises(ModelError, match="roughness"):
        reach_um(SQUARE, 0.55, 1.0)


def test_without_padding_weak_directions_are_wrong(direction):
    """WAVE optics of a dot: the far edges of an unpadded map interfere, as if the dot repeated."""
    rng = np.random.default_rng(8)
    heights = 0.02 * np.cumsum(rng.normal(size=512)) + np.linspace(0.0, 4.0, 512)
    surface, window = WaveSurface.of(heights, 0.25), Window(Extent("rect", 0.5 / 16))
    worst = {}
    for padding in (1.0, 2.0):
        spread = angular_map(surface, 0.5, window, 1.0, padding)
        errors = []
        for col in range(spread.frequency_x.size // 4, 3 * spread.frequency_x.size // 4, 16):
            half = half_vector(direction(0.0), direction(0.0))
            half = type(half)(0.25 * spread.frequency_x[col], 0.0, 1.0, 1.0, 1.0)
            exact = quadratic.density(surface, half, 0.5, window)
            errors.append(abs(spread.density[0, col] / exact - 1.0))
        worst[padding] = max(errors)
    assert worst[2.0] < 1e-3
    assert worst[1.0] > 0.2


def test_density_integrates_to_one_and_reciprocity_holds(rough_steps, direction):
    spread = angular_map(WaveSurface.of(rough_steps, 0.25), 0.55, DISCS)
    bins = np.diff(spread.frequency_x)[0] * np.diff(spread.frequency_y)[0]
    assert spread.density.sum() * bins == pytest.approx(1.0, abs=1e-5)
    surface = WaveSurface.of(rough_steps, 0.25)
    there, back = (
        fused.density(surface, half_vector(*pair), 0.55, SQUARE)
        for pair in ((direction(0.3), direction(-0.1)), (direction(-0.1), direction(0.3)))
    )
    assert there == back
