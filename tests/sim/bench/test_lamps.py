"""A bench with several lamps and a filter wheel."""

import contextlib

import numpy as np
import pytest

from anisoscope.base.errors import NotConnected
from anisoscope.rig.lights.coolled import CoolLed
from anisoscope.rig.lights.fw102c import ThorlabsWheel
from anisoscope.sim.bench.bench import Bench, shared_bench
from anisoscope.sim.bench.benchfile import read_bench

IDEAL = {"prnu": 0.0, "dsnu_e": 0.0, "read_noise_e": 0.0, "dark_current_e_s": 0.0, "black_level": 0.0}
LAMPS = {
    "A": {"light_angle_deg": 10.0},
    "B": {"light_angle_deg": -25.0, "brightness": 0.5},
    "C": {"light_angle_deg": 10.0, "brightness": 2.0},
}
FILTERS = [{}, {"passes": 0.25}]


@pytest.fixture
def lit(bench_path):
    """A bench of ridges with three lamps and two filters; its mean signal with some of the lamps and a filter."""
    with contextlib.ExitStack() as stack:

        def open_(**changes):
            path = bench_path(lamps=LAMPS, filters=FILTERS, sensor=IDEAL, **changes)
            bench = shared_bench(path)
            light = CoolLed(f"sim://coolled?bench={path}")
            stack.callback(light.close)
            wheel = ThorlabsWheel(f"sim://fw102c?bench={path}", settle_s=0.0)
            stack.callback(wheel.close)

            def picture(levels, place=1):
                wheel.go(place)
                light.select(levels)
                light.on()
                return np.mean([bench.photograph(0.002, 1.0) for _ in range(8)], axis=0)

            return picture

        yield open_


def test_light_of_lamps_adds_up_behind_the_filter(lit):
    picture = lit()
    a, b, both = picture({"A": 100}), picture({"B": 100}), picture({"A": 100, "B": 100})
    assert np.mean(a) > 20.0
    assert np.mean(both) == pytest.approx(np.mean(a) + np.mean(b), rel=0.01)
    assert np.mean(picture({"C": 100})) == pytest.approx(2.0 * np.mean(a), rel=0.01)
    assert np.mean(picture({"C": 50})) == pytest.approx(np.mean(a), rel=0.01)
    assert np.mean(picture({"C": 100}, place=2)) == pytest.approx(0.5 * np.mean(a), rel=0.02)
    # a lamp from elsewhere lights other flanks: its picture is no multiple of the first
    assert np.corrcoef(a.ravel(), b.ravel())[0, 1] < 0.99


def test_a_lamp_shows_what_a_bench_with_that_lamp_alone_shows(lit, bench_path):
    picture = lit()({"B": 100})
    alone = Bench(read_bench(bench_path("alone.toml", sensor=IDEAL, geometry={"light_angle_deg": -25.0})))
    alone.light_on = True
    expected = np.mean([alone.photograph(0.002, 1.0) for _ in range(8)], axis=0)
    assert np.mean(picture) == pytest.approx(0.5 * np.mean(expected), rel=0.01)


@pytest.mark.parametrize("name", ["coolled", "fw102c"])
def test_a_bench_with_one_lamp_has_no_controller_and_no_wheel(bench_path, name):
    driver = {"coolled": CoolLed, "fw102c": ThorlabsWheel}[name]
    with pytest.raises(NotConnected, match=r"this bench has one lamp \(light\) and no wheel"):
        driver(f"sim://{name}?bench={bench_path()}")
