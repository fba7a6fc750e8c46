"""Whatever is done in whatever order, driver and device agree: at most half a count off, limits never crossed."""

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    rule,
    run_state_machine_as_test,
)

from anisoscope.base.clock import VirtualClock
from anisoscope.base.errors import LimitExceeded, NotHomed
from anisoscope.sim.bench.serialports import protocol_sim

HARMLESS = [(), ("split",), ("unsolicited",), ("garbage",), ("joined",), ("busy:1",)]


class DriverAgainstFirmware(RuleBasedStateMachine):
    """Drives the stage of a protocol; a subclass names its ``case``."""

    case = None

    @initialize(faults=st.sampled_from(HARMLESS))
    def connect(self, faults):
        impossible = {str(kind) for kind in self.case.firmware().IMPOSSIBLE}
        possible = [fault for fault in faults if fault.partition(":")[0] not in impossible]
        self.firmware = self.case.firmware(*possible, clock=VirtualClock())
        self.original, protocol_sim.device_of_url = protocol_sim.device_of_url, lambda _: self.firmware
        self.stage = self.case.open("sim://device")
        self.expected = None

    @rule()
    def home(self):
        self.stage.home()
        self.expected = 0.0

    @rule(angle=st.floats(-10.0, 370.0))
    def move_to(self, angle):
        self.attempt(angle, lambda: self.stage.move_to(angle))

    @rule(delta=st.floats(-90.0, 90.0))
    def move_by(self, delta):
        self.attempt(self.stage.position_deg() + delta, lambda: self.stage.move_by(delta))

    @rule()
    def reconnect(self):
        self.stage.close()
        self.stage = self.case.open("sim://device")
        if not self.stage.is_homed:
            self.expected = None

    @rule()
    def stop(self):
        self.stage.stop()

    def attempt(self, target, move):
        low, high = self.stage.limits_deg
        slack = 0.5 * self.stage.resolution_deg
        if not self.stage.is_homed:
            with pytest.raises(NotHomed):
                move()
        elif not low - slack <= target <= high + slack:
            with pytest.raises(LimitExceeded):
                move()
        else:
            move()
            self.expected = target

    @invariant()
    def agrees(self):
        if not hasattr(self, "stage"):
            return
        low, high = self.stage.limits_deg
        slack = self.stage.resolution_deg / 2 + 1e-9
        at = self.firmware.axis.position()
        if self.stage.is_homed:
            assert low - slack <= at <= high + slack
        if self.expected is not None:
            assert abs(at - self.expected) <= slack
            assert abs(self.stage.position_deg() - self.expected) <= slack

    def teardown(self):
        if hasattr(self, "stage"):
            self.stage.close()
            protocol_sim.device_of_url = self.original


def run(case, examples):
    machine = type("Machine", (DriverAgainstFirmware,), {"case": case})
    # on a busy machine drawing is slow, too; and what every run draws anew belongs to the long campaigns
    how = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow], "derandomize": examples < 1000}
    run_state_machine_as_test(
        machine, settings=settings(max_examples=examples, stateful_step_count=12, **how)
    )


def test_forty_sequences(case):
    run(case, 40)


@pytest.mark.soak
def test_ten_thousand_sequences(case):
    run(case, 10_000)
