"""Orders near three widths against orders drawn at the width itself."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.profiles.etching import Etched
from anisoscope.sim.light.wave.halfvectors import across_beam, half_vector
from anisoscope.sim.light.wave.orders import Orders, WidthOrders
from anisoscope.sim.light.wave.windows import Extent, Window

WAVELENGTH_UM, STEP_UM = 0.5, 0.04
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def tile():
    cells = np.random.default_rng(4).integers(0, 4, (32, 32))
    return Etched(np.kron(cells, np.ones((8, 8), dtype=int)).astype(np.uint8), (0.1073, 0.1575), 0.125)


@pytest.fixture(scope="module")
def series(tile):
    return WidthOrders.of(lambda share: Orders.of(tile.widened(share * STEP_UM)))


@pytest.mark.parametrize("share", [-1.0, -0.3, 0.0, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("tilt_deg", [0.0, 4.0])
def test_any_width_is_that_which_is_drawn(tile, series, share, tilt_deg):
    to_camera = np.array([np.sin(np.radians(tilt_deg)), 0.0, np.cos(np.radians(tilt_deg))])
    half, levels = half_vector(UP, to_camera), np.array(tile.levels_um)
    window = Window(Extent("disc", 0.06), Extent("disc", 0.1))
    drawn = Orders.of(tile.widened(share * STEP_UM)).density(levels, half, WAVELENGTH_UM, window)
    found = series.at(share).densities(levels, half, np.array([WAVELENGTH_UM]), window)[0]
    assert found == pytest.approx(drawn, rel=1e-6 if abs(share) <= 1.0 else 1e-4)
    if share == 2.0:  # and the width matters
        assert abs(series.densities(levels, half, np.array([WAVELENGTH_UM]), window)[0] / drawn - 1.0) > 0.01


@pytest.mark.parametrize("discs", [(0.06, 0.1), (0.1, 0.06), (0.08, 0.08), (0.0, 0.1)])
def test_many_directions_at_once_are_as_each_alone(series, tile, discs):
    """Also where the smaller disc is an ellipse or a point, which no kernel knows; by sums over windows as arrays."""
    made, levels, wavelengths = series.at(-0.4, 0.1 + 0.2j), np.array(tile.levels_um), np.array([0.5, 0.55])
    slopes = np.random.default_rng(1).normal(scale=0.05, size=(2, 5, 2))
    slopes[:, 0], slopes[0, 1] = 0.0, (0.5, 0.0)
    to_light, to_camera = np.dstack([slopes, np.sqrt(1.0 - np.sum(slopes**2, axis=2))])
    found = made.seen(levels, to_light, to_camera, wavelengths, discs)
    for one, light, camera in zip(found, to_light, to_camera, strict=True):
        window = Window(
            *(Extent("disc", d, across_beam(v)) for d, v in zip(discs, (light, camera), strict=True))
        )
        alone = made.densities(levels, half_vector(light, camera), wavelengths, window)
        np.testing.assert_allclose(one, alone, rtol=1e-12)


def test_directions_out_of_reach_are_refused(series, tile):
    levels, wavelengths = np.array(tile.levels_um), np.array([WAVELENGTH_UM])
    for aside, why in ((0.9, "beyond the"), (1.0, "above the horizon")):
        away = np.array([UP, [aside, 0.0, np.sqrt(1.0 - aside**2)]])
        with pytest.raises(ModelError, match=why):
            series.seen(levels, away, away, wavelengths, (0.06, 0.1))
