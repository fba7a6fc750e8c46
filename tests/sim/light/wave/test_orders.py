"""Diffraction orders of a repeated tile, against the fused pass over many tiles; the window against its definition."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.profiles.etching import Etched
from anisoscope.sim.light.wave import fused
from anisoscope.sim.light.wave.halfvectors import across_beam, half_vector
from anisoscope.sim.light.wave.orders import Orders, level_phases, window_density
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Extent, Window

PIXEL_UM = 0.125
WAVELENGTH_UM = 0.5


def tile(levels=2, seed=0, passes_um=(0.13,), cells=16):
    """Squares of 1 µm, 16 µm × 16 µm of them by default."""
    cells = np.random.default_rng(seed).integers(0, levels, (cells, cells))
    return Etched(np.kron(cells, np.ones((8, 8), dtype=int)).astype(np.uint8), passes_um, PIXEL_UM)


def unit(x_deg, y_deg):
    found = np.array([np.sin(np.radians(x_deg)), np.sin(np.radians(y_deg)), 0.0])
    found[2] = np.sqrt(1.0 - found @ found)
    return found


def window(to_light, to_camera, lamp=0.06, lens=0.1):
    return Window(Extent("disc", lamp, across_beam(to_light)), Extent("disc", lens, across_beam(to_camera)))


@pytest.mark.parametrize(
    ("made", "angles"),
    [
        (tile(), ((0.0, 0.0), (0.0, 0.0))),  # the spike
        (tile(), ((6.0, 0.0), (0.0, -3.0))),
        (tile(4, 1, (0.1073, 0.1575)), ((3.0, 2.0), (-1.0, 0.0))),
    ],
)
def test_orders_are_what_many_tiles_side_by_side_tend_to(made, angles):
    """The edge of n tiles diffracts too: it falls off as 1/n, so that two n give the limit."""
    to_light, to_camera = (unit(*angle) for angle in angles)
    half, seen = half_vector(to_light, to_camera), window(to_light, to_camera)
    found = Orders.of(made).density(np.array(made.levels_um), half, WAVELENGTH_UM, seen)
    heights = np.kron(np.array(made.levels_um)[made.labels], np.ones((2, 2)))
    by_tiles = []
    for n in (3, 6):
        surface = WaveSurface.of(np.tile(heights, (n, n)), PIXEL_UM / 2.0, cells=True)
        by_tiles.append(fused.density(surface, half, WAVELENGTH_UM, seen))
    assert found == pytest.approx(2.0 * by_tiles[1] - by_tiles[0], rel=5e-3)


@pytest.mark.parametrize(
    "angles", [((0.0, 0.0), (0.0, 0.0)), ((0.0, 0.0), (3.0, 0.0)), ((9.0, 4.0), (0.0, -6.0))]
)
@pytest.mark.parametrize("wider_um", [0.025, 0.1, -0.05, 0.3])
def test_a_bias_far_below_the_grid_is_one_on_a_grid_that_draws_it(wider_um, angles):
    """Pixels of 125 nm with edges within them, against pixels of 12.5 nm."""
    made = tile(seed=4, cells=8).widened(wider_um)
    times = 10
    drawn = np.kron(made.labels, np.ones((times, times), dtype=np.uint8)).astype(bool)
    for _ in range(round(abs(wider_um) / 2.0 / (PIXEL_UM / times))):
        near = [np.roll(drawn, (dy, dx), (0, 1)) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
        drawn = np.logical_or.reduce(near) if wider_um > 0.0 else np.logical_and.reduce(near)
    to_light, to_camera = (unit(*angle) for angle in angles)
    half, seen = half_vector(to_light, to_camera), window(to_light, to_camera)
    finely = Orders.of(Etched(drawn.astype(np.uint8), made.passes_um, PIXEL_UM / times))
    wanted, found = (
        one.density(np.array(made.levels_um), half, WAVELENGTH_UM, seen) for one in (finely, Orders.of(made))
    )
    assert found == pytest.approx(wanted, rel=1e-5)


def test_pieces_that_were_kept_give_the_same_orders():
    made, band_cache = tile(seed=6), {}
    Orders.of(made.widened(0.02), band_cache=band_cache)
    count = len(band_cache)
    again = Orders.of(made.widened(0.09), band_cache=band_cache)
    assert len(band_cache) == count == 9
    assert np.array_equal(again.spectra, Orders.of(made.widened(0.09)).spectra)


def test_all_orders_carry_all_the_light():
    """But for the tails of sinc² beyond f: of steps of width a, 1/(π²·a·f) along each axis."""
    made, reach = tile(), 3.9
    phases = level_phases(np.array(made.levels_um), WAVELENGTH_UM, 1.0)
    waves, _, _ = Orders.of(made, reach=4.0).around((0.0, 0.0), (reach, reach), phases)
    tails = 1.0 / (np.pi**2 * reach)
    assert float(np.sum(np.abs(waves) ** 2)) == pytest.approx((1.0 - tails) ** 2, abs=0.01)


def test_the_spike_is_the_mean_phase():
    """Order 0 holds |τ|² of the light: with shares q of two levels, |1 − q + q·exp(−2πi·2d/λ)|²."""
    made = tile(seed=5)
    share = float(made.labels.mean())
    wave, _, _ = Orders.of(made).around(
        (0.0, 0.0), (1e-3, 1e-3), level_phases(np.array(made.levels_um), WAVELENGTH_UM, 1.0)
    )
    tau = 1.0 - share + share * np.exp(2j * np.pi * 2.0 * 0.13 / WAVELENGTH_UM)
    assert wave.item() == pytest.approx(tau, abs=1e-6)


def test_a_direction_that_the_tile_is_not_sampled_for_is_refused():
    orders = Orders.of(tile(), reach=0.3)
    to_light = unit(20.0, 0.0)
    half = half_vector(to_light, to_light)
    with pytest.raises(ModelError, match=r"beyond the 0\.25"):
        orders.density(np.zeros(2), half, WAVELENGTH_UM, window(to_light, to_light))


@pytest.mark.parametrize(
    ("angles", "lamp", "lens"),
    [
        (((0.0, 0.0), (0.0, -3.0)), 0.01, 0.024),
        (((10.0, 0.0), (0.0, 0.0)), 0.03, 0.03),
        (((50.0, 0.0), (0.0, 0.0)), 0.02, 0.05),
    ],
)
def test_the_window_is_the_transform_of_its_coherence(angles, lamp, lens):
    """Moments of W: its integral is 1, and its variance is the sum of those of the two discs, a quarter of r² each."""
    to_light, to_camera = (unit(*angle) for angle in angles)
    seen = window(to_light, to_camera, lamp, lens)
    reach = seen.half_width(WAVELENGTH_UM, 1.0)
    f = [np.linspace(-1.02 * wide, 1.02 * wide, 161) for wide in reach]
    density = window_density(seen, f[0][None, :], f[1][:, None], WAVELENGTH_UM)
    cell = (f[0][1] - f[0][0]) * (f[1][1] - f[1][0])
    assert density.sum() * cell == pytest.approx(1.0, rel=2e-3)
    for axis, x in ((0, f[0][None, :]), (1, f[1][:, None])):
        variance = float(np.sum(density * x**2)) * cell
        wanted = sum(
            float((0.5 * extent.size / WAVELENGTH_UM) ** 2 * (extent.axes[:, axis] ** 2).sum()) / 4.0
            for extent in (seen.source, seen.aperture)
        )
        assert variance == pytest.approx(wanted, rel=1e-2)


def test_a_window_of_one_disc_is_a_plateau_and_one_of_none_is_refused():
    axis = np.array([0.0, 0.0, 1.0])
    seen = window(axis, axis, 0.0, 0.1)
    density = window_density(seen, np.array([0.0, 0.099, 0.101]), np.zeros(3), WAVELENGTH_UM)
    assert density == pytest.approx([1.0 / (np.pi * 0.01), 1.0 / (np.pi * 0.01), 0.0])
    with pytest.raises(ModelError, match="of some size"):
        window_density(Window(), np.zeros(1), np.zeros(1), WAVELENGTH_UM)
