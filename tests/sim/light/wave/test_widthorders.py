"""Orders near three widths against orders drawn at the width itself."""

import numpy as np
import pytest

from anisoscope.profiles.etching import Etched
from anisoscope.sim.light.wave.halfvectors import half_vector
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
