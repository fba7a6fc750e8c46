"""The axis moves as mechanics demands."""

import itertools

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from anisoscope.sim.bench.firmware.axis import RotaryAxis

angles = st.floats(-720.0, 720.0)


def still_clock():
    return 0.0


@settings(deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(start=angles, target=angles)
def test_it_starts_at_the_start_ends_at_the_target_and_never_turns_back(start, target):
    axis = RotaryAxis(start_deg=start, clock=still_clock)
    axis.start_move(target)
    path = [axis.position(0.02 * step) for step in range(300)]
    assert path[0] == pytest.approx(start)
    assert path[-1] == target
    steps = [(after - before) * (1 if target > start else -1) for before, after in itertools.pairwise(path)]
    assert min(steps) >= -1e-9
    assert max(steps) <= axis.velocity_deg_s * 0.02 + 1e-9
    assert not axis.busy(6.0)


def test_time_scale_stretches_time_and_zero_ends_at_once():
    slow = RotaryAxis(time_scale=2.0, clock=still_clock)
    real = RotaryAxis(clock=still_clock)
    instant = RotaryAxis(time_scale=0.0, clock=still_clock)
    for axis in (slow, real, instant):
        axis.start_move(180.0)
    assert slow.position(0.4) == pytest.approx(real.position(0.2))
    assert instant.position(0.0) == 180.0
    assert not instant.busy(0.0)


def test_stop_holds_the_angle():
    now = [0.0]
    axis = RotaryAxis(clock=lambda: now[0])
    axis.start_move(180.0)
    now[0] = 0.2
    axis.stop()
    held = axis.position()
    now[0] = 5.0
    assert 0.0 < held == axis.position() < 180.0
    assert not axis.busy()


def test_backlash_shows_when_the_side_changes():
    axis = RotaryAxis(time_scale=0.0, backlash_deg=0.3)
    axis.start_move(90.0)
    assert axis.load_deg() == 90.0
    axis.start_move(80.0)
    assert axis.load_deg() == pytest.approx(80.3)
    axis.start_move(80.1)
    assert axis.load_deg() == pytest.approx(80.3)
    axis.start_move(90.0)
    assert axis.load_deg() == 90.0


def test_it_stalls_at_the_obstacle_only_if_it_is_in_the_way():
    axis = RotaryAxis(time_scale=0.0, stall_at_deg=45.0)
    axis.start_move(30.0)
    assert not axis.stalled()
    axis.start_move(90.0)
    assert axis.stalled()
    assert axis.position() == 45.0
