"""The simulated press follows its stated sensitivities."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.sim.press import CONTRAST, COOLER, SENSITIVITIES, SETTINGS, Change, mould


@pytest.mark.parametrize(("setting", "size"), [("packing pressure", 40.0), ("tool shots", 400_000.0)])
def test_a_step_shows_in_what_is_measured_by_the_sensitivity(setting, size):
    made = mould(4000, (Change(setting, size, 2000),), np.random.default_rng(1))
    for name, slopes in SENSITIVITIES.items():
        wear = slopes["tool shots"] * 20 * 2000
        step = made.measured[name][2000:].mean() - made.measured[name][:2000].mean() - wear
        assert step == pytest.approx(slopes[setting] * size, abs=4e-3)
    assert CONTRAST["ridge height"] > 0 > CONTRAST["edge radius"]


def test_a_ramp_grows_part_by_part_and_a_longer_cycle_cools_the_mould():
    plain, slower = (
        mould(60, changes, np.random.default_rng(2)) for changes in ((), (Change("cycle time", 5.0, 20, 10),))
    )
    grown = slower.cycles["cycle time"] - plain.cycles["cycle time"]
    assert grown[:20].tolist() == [0.0] * 20
    assert grown[19:31] == pytest.approx(0.5 * np.arange(12).clip(0, 10), abs=1e-9)
    cooler = slower.cycles["mould temperature"] - plain.cycles["mould temperature"]
    assert cooler[-1] == pytest.approx(5.0 * COOLER, abs=1e-6)
    assert slower.seconds[-1] > plain.seconds[-1]
    assert set(plain.cycles) == set(SETTINGS)


def test_a_setting_that_there_is_not_is_refused():
    with pytest.raises(UsageError, match="no 'barrel'"):
        mould(10, (Change("barrel", 1.0, 2),), np.random.default_rng(1))
