"""The predictor of etched wafers: physical identities, what its changes do, and what is refused."""

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError, RecipeError
from anisoscope.kinds.wafers.etched import EtchedPredictor, WaferLight, tile_of
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.profiles.etching import Etched
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.wave.halfvectors import half_vector

LIGHT = WaferLight(520.0, 0.0, 0.3, 0.7)
MIRROR = Material(0.001, 0.001, 0.0)
DISC = np.pi * np.sin(np.radians(0.7)) ** 2


def random_tile(seed=0, cells=32, side=8, pixel_um=0.25):
    """64 µm of squares of 2 µm, a quarter wave deep."""
    labels = np.random.default_rng(seed).integers(0, 2, (cells, cells))
    return Etched(np.kron(labels, np.ones((side, side), dtype=int)).astype(np.uint8), (0.13,), pixel_um)


def seen(predictor, tilts=(0.0, 3.0), material=MIRROR, angles=(0.0, 90.0)):
    return predictor(*directions(pose_grid(angles, tilts), Convention(0.0)), material)


def test_a_flat_mirror_shows_the_lens_the_lamp():
    """Radiance of a lamp of unit irradiance in the wider lens: 1 over the lens's solid angle, at any wavelength."""
    flat = Etched(np.zeros((64, 64), dtype=np.uint8), (0.13,), 0.25)
    for nm in (450.0, 520.0):
        light = WaferLight(nm, 0.0, 0.3, 0.7)
        found = seen(EtchedPredictor.of(flat, light, 0.9), (0.0,), angles=(0.0,))
        assert found == pytest.approx([0.9 / DISC], rel=1e-5)
    assert seen(EtchedPredictor.of(flat, LIGHT), (3.0,)) == pytest.approx([0.0, 0.0], abs=1e-9)


def test_the_lobe_holds_all_the_light_that_the_spike_does_not():
    """∫L·v_z dω_v over all views under one lamp is 1 for a mirror with steps; what is left out lies in the tails."""
    predictor = EtchedPredictor.of(random_tile(), WaferLight(520.0, 0.0, 0.3, 3.0))
    edge = np.arange(-0.5, 0.5001, 0.04)
    x, y = np.meshgrid(edge, edge)
    inside = np.hypot(x, y) < 0.5
    views = np.stack([x[inside], y[inside], np.sqrt(1.0 - x[inside] ** 2 - y[inside] ** 2)], axis=1)
    lights = np.tile([0.0, 0.0, 1.0], (len(views), 1))
    found = predictor(lights, views, MIRROR)
    total = float(found.sum() * 0.04**2)  # L·v_z·dω = L·dv_x·dv_y
    assert 0.85 < total < 1.02


def test_the_spike_of_a_quarter_wave_is_that_of_its_unequal_areas_and_grows_with_etching():
    tile = random_tile()
    share = float(tile.labels.mean())
    good = EtchedPredictor.of(tile, LIGHT)
    for deeper in (0.0, 10.0, 30.0):
        turns = 2.0 * (0.13 + 1e-3 * deeper) / 0.52
        tau = abs(1.0 - share + share * np.exp(2j * np.pi * turns))
        levels = np.array(good.with_depths(deeper).tile.levels_um)
        pose = directions(pose_grid((0.0,)), Convention(0.0))
        wave, _, _ = good.orders.around(
            (0.0, 0.0),
            (1e-3, 1e-3),
            np.exp(-4j * np.pi * half_vector(pose[0][0], pose[1][0]).z / 0.52 * levels),
        )
        assert abs(wave.item()) == pytest.approx(tau, abs=1e-5)
        mirrored = seen(good.with_depths(deeper), (0.0,), angles=(0.0,))
        assert mirrored >= tau**2 / DISC * (1.0 - 1e-6)  # the lobe's share comes on top


def test_a_quarter_turn_of_the_wafer_is_one_of_the_stage():
    tile = random_tile(3)
    turned = Etched(np.ascontiguousarray(np.rot90(tile.labels)), tile.passes_um, tile.pixel_um)
    one, other = (
        seen(EtchedPredictor.of(made, LIGHT), (3.0,), angles=(0.0, 90.0, 180.0)) for made in (tile, turned)
    )
    # rot90 of rows that rise with y turns clockwise; turning the stage on makes up for it
    assert other[1:] == pytest.approx(one[:-1], rel=1e-4) or other[:-1] == pytest.approx(one[1:], rel=1e-4)
    assert one[0] == pytest.approx(
        one[2], rel=1e-4
    )  # two levels a half wave apart: real, so that ±ω are alike
    assert abs(np.log(one[0] / one[1])) > 0.02


def test_other_widths_and_light_are_those_of_a_predictor_made_anew():
    tile = random_tile(1)
    good = EtchedPredictor.of(tile, LIGHT)
    assert seen(good.with_widths(37.0)) == pytest.approx(seen(EtchedPredictor.of(tile.widened(0.037), LIGHT)))
    other = WaferLight(530.0, 8.0, 0.4, 0.9)
    assert seen(good.under(other)) == pytest.approx(seen(EtchedPredictor.of(tile, other)))
    assert seen(good.with_widths(30.0).with_widths(-30.0)) == pytest.approx(seen(good), rel=1e-6)


def test_scattered_light_is_taken_from_the_mirrored():
    good = EtchedPredictor.of(random_tile(), LIGHT, 0.8)
    clean, dirty = seen(good), seen(good, material=Material(0.001, 0.001, 0.1))
    cosines = directions(pose_grid((0.0, 90.0), (0.0, 3.0)), Convention(0.0))[0][:, 2]
    assert dirty == pytest.approx(0.9 * clean + 0.8 * 0.1 / np.pi * cosines)


def test_the_tile_of_a_recipe_is_square_and_as_large_as_the_pitch():
    tile = random_tile()
    surface = HeightMap(np.array(tile.levels_um)[tile.labels], 0.25, 0.25)
    assert tile_of(surface, 64.0, "tile.npz").passes_um == pytest.approx((0.13,))
    with pytest.raises(RecipeError, match=r"tile\.npz is 64 × 64 µm, the pitch 60 µm"):
        tile_of(surface, 60.0, "tile.npz")
    rough = surface.with_height(np.random.default_rng(0).random(surface.shape))
    with pytest.raises(HeightMapError, match=r"tile\.npz: .* etch passes"):
        tile_of(rough, 64.0, "tile.npz")
