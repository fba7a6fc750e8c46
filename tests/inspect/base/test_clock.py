"""The clock of what is waited for: waiting by a virtual one takes no time, and its device sees the time pass."""

import time

import pytest

from anisoscope.base.clock import SYSTEM, Clock, VirtualClock
from anisoscope.rig.transport import Transport
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.serialports import protocol_sim


@pytest.mark.parametrize("clock", [SYSTEM, VirtualClock()])
def test_waiting_passes_time_and_never_goes_back(clock):
    assert isinstance(clock, Clock)
    begun = clock()
    clock.sleep(-1.0)
    clock.sleep(0.01)
    assert clock() - begun >= 0.01 * (1.0 - 1e-9)


def test_a_timeout_on_a_simulated_port_takes_its_time_by_the_clock_of_the_device(monkeypatch):
    clock = VirtualClock(5.0)
    firmware = build("zaber", [Mount(RotaryAxis(clock=clock))], faults=["silent"])
    monkeypatch.setattr(protocol_sim, "device_of_url", lambda _: firmware)
    begun = time.monotonic()
    with Transport("sim://zaber") as port:
        assert port.clock is clock
        assert port.read_until(b"\n", 20.0) is None
    assert 25.0 <= clock() < 25.1
    assert time.monotonic() - begun < 15.0


def test_a_port_of_the_system_runs_on_the_time_of_the_system():
    with Transport("loop://") as port:
        assert port.clock is SYSTEM
