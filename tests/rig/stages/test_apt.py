"""What only the APT driver does: scales, noise on a binary line, a servo's errors, the reference that is remembered."""

import struct
import time

import pytest

from anisoscope.base.clock import VirtualClock
from anisoscope.base.errors import LimitExceeded, MotionTimeout, NotHomed, ProtocolError, RigError, Stalled
from anisoscope.rig.stages.apt import Apt, scale_of, trouble_of
from anisoscope.rig.stages.apt_wire import (
    MOVE_ABSOLUTE,
    DeviceInfo,
    Message,
    Status,
    position_data,
    take_message,
)
from anisoscope.sim.bench.firmware.apt import MODELS, AptFirmware, AptModel
from anisoscope.sim.bench.firmware.axis import RotaryAxis

HURRY = {"timeout_s": 0.3, "margin_s": 0.15, "velocity_deg_s": 2000.0}
PRM1 = {"actuator": "PRM1-Z8"}
STATUS = bytes.fromhex("8104 0e00 81 50 0100 35200200 00000000 00250080")


def firmware_with(*faults, model="K10CR1", time_scale=0.0, **axis):
    return AptFirmware(RotaryAxis(time_scale=time_scale, **axis), model=MODELS[model], faults=faults)


def test_a_k10cr1_counts_409600_microsteps_in_three_degrees(in_process):
    firmware = firmware_with()
    with Apt.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        stage.move_to(90.0)
        assert firmware.counts == 90 * 409600 // 3
        assert stage.resolution_deg == 3 / 409600
        assert stage.velocity_deg_s() == pytest.approx(10.0)


def test_a_kdc101_counts_as_its_actuator_does(in_process):
    firmware = firmware_with(model="KDC101")
    with Apt.open(in_process(firmware), **PRM1, **HURRY) as stage:
        assert stage.name == "KDC101 27000123"
        stage.home()
        assert stage.move_to(90.0) == pytest.approx(90.0, abs=0.5 / 1919.64)
        assert firmware.counts == 172768
        assert stage.velocity_deg_s() == pytest.approx(25.0, rel=1e-4)


def test_time_limits_follow_the_slower_of_the_two_velocities(in_process):
    firmware = firmware_with()
    with Apt.open(in_process(firmware)) as stage:
        assert stage.rules.velocity_deg_s == pytest.approx(10.0)
        # a full turn at 10°/s, twice over, and half as much again
        assert 105.0 < 2.0 * stage.rules.timeout_s(360.0) < 125.0
    firmware.write(Message(0x0440, data=struct.pack("<HHHii", 1, 2, 1, 7329109 * 4, 0)).to_bytes(0x50))
    with Apt.open(in_process(firmware)) as stage:
        assert stage.rules.velocity_deg_s == pytest.approx(4.0)


def test_the_scale_of_an_unknown_model_is_asked_for(in_process):
    strange = AptModel("KST201", 26000001, 34304.0, 34304 * 53.68, 380.0, 10.0, 10.0, servo=False)
    firmware = AptFirmware(RotaryAxis(time_scale=0.0), model=strange)
    with pytest.raises(RigError, match=r"a KST201 does not tell.* set the option counts_per_deg"):
        Apt.open(in_process(firmware), **HURRY)
    with Apt.open(in_process(firmware), counts_per_deg=34304.0, **HURRY) as stage:
        stage.home()
        stage.move_to(10.0)
    assert firmware.axis.position() == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "actuator = 'PRM1-Z8', or counts_per_deg"),
        ({"actuator": "Z825"}, "actuator 'Z825' is not known; known: PRM1-Z8"),
        ({"counts_per_deg": -1.0}, "above 0"),
        ({**PRM1, "address": "51"}, "'51' is not an APT address"),
        ({**PRM1, "address": "x"}, "'x' is not an APT address"),
        ({**PRM1, "stop": "never"}, "profiled, immediate"),
    ],
)
def test_options_that_cannot_be(in_process, options, message):
    with pytest.raises(RigError, match=message):
        Apt.open(in_process(firmware_with(model="KDC101")), **options, **HURRY)


def test_a_rack_unit_has_another_address(in_process):
    firmware = AptFirmware(RotaryAxis(time_scale=0.0), address=0x22)
    with Apt.open(in_process(firmware), address="22", **HURRY) as stage:
        stage.home()
        assert stage.move_to(5.0) == pytest.approx(5.0, abs=1e-5)


@pytest.mark.parametrize(
    ("fault", "error", "message"),
    [
        ("stall", Stalled, "the motor did not follow"),
        ("motion-error:24", Stalled, "current limit"),
        ("motion-error:26", Stalled, "over-current"),
        ("motion-error:17", Stalled, "too hot"),
        ("motion-error:0", LimitExceeded, "limit switch, at 0°"),
        ("motion-error:18", RigError, "supply voltage"),
        ("overshoot:3000", MotionTimeout, "ended at 91.5"),
    ],
)
def test_a_servo_reports_its_troubles(in_process, fault, error, message):
    firmware = firmware_with(model="KDC101", time_scale=0.01)
    with Apt.open(in_process(firmware), **PRM1, **HURRY) as stage:
        stage.home()
        name, _, number = fault.partition(":")
        wrong = firmware_with(fault, model="KDC101").faults
        firmware.faults.update(wrong)
        firmware.axis.stall_at_deg = 45.0 if name == "stall" else None
        with pytest.raises(error, match=message):
            stage.move_to(90.0)
    assert firmware.stops > 0
    assert number or firmware.axis.position() == pytest.approx(45.0)


def test_an_error_of_the_past_is_cleared_by_switching_the_channel(in_process):
    firmware = firmware_with("latched-error:14", model="KDC101")
    with Apt.open(in_process(firmware), **PRM1, **HURRY) as stage:
        assert stage.status().has(14)
        stage.home()
        assert not stage.status().has(14)


def test_a_stepper_without_encoder_loses_steps_and_homing_finds_them(in_process):
    firmware = firmware_with("stall")
    with Apt.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        assert stage.move_to(90.0) == pytest.approx(90.0)
        assert firmware.axis.position() == 45.0
        firmware.clear_faults()
        stage.home()
        assert stage.move_to(90.0) == pytest.approx(firmware.axis.position())


def test_a_stepper_that_is_held_at_its_search_counts_on_for_a_turn_and_no_longer(in_process):
    firmware = firmware_with("stall", time_scale=1.0, start_deg=200.0, clock=VirtualClock())
    with Apt.open(in_process(firmware)) as stage:
        with pytest.raises(
            Stalled, match=r"the home has counted 39\d° and met no switch: something holds the stage"
        ):
            stage.home()
        assert firmware.stops > 0
        assert firmware.counts / stage.scale.counts_per_deg == pytest.approx(-397.0, abs=3.0), (
            "by its own count"
        )
        firmware.clear_faults()
        assert stage.home() == pytest.approx(0.0, abs=1e-5)


def test_a_search_over_a_whole_turn_and_a_count_that_is_set_at_the_switch_are_no_stall(in_process):
    firmware = firmware_with(time_scale=1.0, start_deg=359.9, clock=VirtualClock())
    firmware._slipped = round(
        5000.0 * MODELS["K10CR1"].counts_per_deg
    )  # ends with a jump of five thousand degrees
    with Apt.open(in_process(firmware)) as stage:
        assert stage.home() == pytest.approx(0.0, abs=1e-5)
        assert 0.9 < stage._searched_counts / (360.0 * stage.scale.counts_per_deg) < 1.05


def test_a_reference_is_remembered_by_the_device_until_it_loses_power(in_process):
    firmware = firmware_with()
    port = in_process(firmware)
    with Apt.open(port, **HURRY) as stage:
        stage.home()
    with Apt.open(port, **HURRY) as stage:
        assert stage.is_homed
        stage.move_to(20.0)
        firmware._power_up()
        with pytest.raises(NotHomed, match="was switched off; home it again"):
            stage.move_to(30.0)
        assert not stage.is_homed
        assert firmware.axis.position() == pytest.approx(20.0, abs=1e-5)


def test_a_turn_by_hand_is_noticed(in_process):
    firmware = firmware_with()
    with Apt.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        stage.move_to(20.0)
        firmware.axis.start_move(25.0)
        with pytest.raises(NotHomed, match="moved by hand"):
            stage.move_to(30.0)


def test_a_second_search_is_waited_for_though_the_stage_stands_at_its_zero(in_process):
    firmware = firmware_with(time_scale=0.05)
    with Apt.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        stage.move_to(8.0)
        assert stage.home() == pytest.approx(0.0, abs=1e-5)
        assert firmware.motor.referenced
        stage.home()
    assert [command[:2] for command in firmware.commands].count(b"\x43\x04") == 3


def test_zero_may_read_a_step_below(in_process):
    firmware = firmware_with("overshoot:-1")
    with Apt.open(in_process(firmware), **HURRY, min_deg=0.0) as stage:
        stage.home()
        stage.move_to(10.0)
        assert stage.move_to(0.0) == -stage.resolution_deg
        assert stage.move_by(5.0) == pytest.approx(5.0, abs=2e-5)


def test_several_turns_are_counted(in_process):
    firmware = firmware_with()
    with Apt.open(in_process(firmware), max_deg=1e6, min_deg=-1e6, **HURRY) as stage:
        stage.home()
        assert stage.move_to(-800.25) == pytest.approx(-800.25, abs=1e-5)
        assert stage.position_deg() == pytest.approx(-800.25, abs=1e-5)
        with pytest.raises(LimitExceeded, match="32 bits"):
            stage.move_to(20_000.0)


@pytest.mark.parametrize(("option", "mode"), [({}, 2), ({"stop": "immediate"}, 1)])
def test_stops(in_process, option, mode):
    firmware = firmware_with()
    with Apt.open(in_process(firmware), **option, **HURRY) as stage:
        stage.stop()
    assert b"\x65\x04\x01" + bytes([mode]) in firmware.commands


def test_updates_are_switched_off_when_connecting_and_acknowledged_when_on(in_process):
    firmware = firmware_with(model="KDC101", time_scale=1.0)
    updates_on = Message(0x0011).to_bytes(0x50)
    with Apt.open(in_process(firmware), **PRM1, **HURRY) as stage:
        assert b"\x12\x00\x00\x00" in firmware.commands
        firmware.write(updates_on)
        firmware._unacknowledged = 45
        for _ in range(10):
            stage.position_deg()
            time.sleep(0.06)
        assert firmware._unacknowledged < 20
        assert b"\x92\x04\x00\x00" in firmware.commands


def test_a_disabled_motor_is_enabled_before_a_motion(in_process):
    firmware = AptFirmware(RotaryAxis(time_scale=0.0), enabled=False)
    with Apt.open(in_process(firmware), **HURRY) as stage:
        assert not stage.status().enabled
        stage.home()
        assert stage.status().enabled
        stage.identify()
    assert firmware.identified == 1


def late(*faults, enabling_s, model="K10CR1"):
    axis = RotaryAxis(time_scale=0.0, clock=VirtualClock())
    return AptFirmware(axis, model=MODELS[model], enabled=False, enabling_s=enabling_s, faults=faults)


@pytest.mark.parametrize("faults", [(), ("split", "unsolicited", "garbage"), ("latched-error:14",)])
def test_a_motion_waits_until_the_motor_has_current(in_process, faults):
    firmware = late(*faults, enabling_s=0.4)
    with Apt.open(in_process(firmware)) as stage:
        assert stage.home() == pytest.approx(0.0, abs=stage.resolution_deg)
        assert stage.move_to(90.0) == pytest.approx(90.0, abs=stage.resolution_deg)
        assert not stage.status().has(14)
    assert [command[:2] for command in firmware.commands].count(b"\x43\x04") == 1


def test_a_motor_that_gets_no_current_is_named(in_process):
    firmware = late(enabling_s=1e6)
    with (
        Apt.open(in_process(firmware)) as stage,
        pytest.raises(RigError, match="channel 1 is switched off"),
    ):
        stage.home()
    assert not firmware.motor.referenced


def test_a_controller_that_does_not_say_so_is_named_by_its_status():
    silent = trouble_of("K10CR1", Status(0, 1 << 10), 0.0, moved=False)
    assert "does not switch its motor on" in str(silent)


class SlowLine(AptFirmware):
    """Its line passes one message in 20 ms, and some of before are on it when the channel is switched on."""

    _passes_at = 0.0

    def _set_enabled(self, packet):
        for _ in range(3):
            self._report_status(0x0481, servo=False)
        super()._set_enabled(packet)

    def read(self):
        if not self._outbox or self._clock() < self._passes_at:
            return b""
        self._passes_at = self._clock() + 0.02
        end = self._outbox.find(b"\x81\x04", 1)
        ready = bytes(self._outbox if end < 0 else self._outbox[:end])
        del self._outbox[: len(ready)]
        return ready


def test_a_status_of_before_that_comes_late_is_not_believed(in_process):
    firmware = SlowLine(RotaryAxis(time_scale=0.0, clock=VirtualClock()), enabled=False)
    with Apt.open(in_process(firmware)) as stage:
        assert stage.home() == pytest.approx(0.0, abs=stage.resolution_deg)
        assert stage.status().enabled


# The bytes.


def test_a_message_is_found_in_noise():
    noise = b"\x00\x00\xfe\x7f~!\r\n\x81\x04\x0e\x00\x81\x33\x81\x04"
    received = bytearray(noise + STATUS + STATUS[:7])
    message, dropped = take_message(received)
    assert (message.id, message.source, message.data) == (0x0481, 0x50, STATUS[6:])
    assert dropped == len(noise)
    assert bytes(received) == STATUS[:7]
    assert take_message(received) == (None, 0)
    received += STATUS[7:]
    assert take_message(received)[0] == message
    assert not received


def test_what_cannot_be_a_message_is_dropped():
    for spoiled in (1, 2, 4, 5):
        received = bytearray(STATUS)
        received[spoiled] ^= 0x40
        assert take_message(received)[0] is None
        assert len(received) < 6


def test_short_messages_carry_their_parameters():
    received = bytearray(bytes.fromhex("4404 01 02 01 50"))
    assert take_message(received) == (Message(0x0444, (1, 2), source=0x50), 0)


def test_the_bytes_of_a_move_are_those_of_the_manual():
    # the protocol's own example: channel 1, absolute position 200000 counts
    sent = Message(MOVE_ABSOLUTE, data=position_data(200_000)).to_bytes(0x50)
    assert sent == bytes.fromhex("53 04 06 00 D0 01 01 00 40 0D 03 00")


def test_status_bits():
    status = Status.parse(STATUS[6:])
    assert (status.counts, status.bits) == (139317, 0x80002500)
    assert status.homed
    assert status.enabled
    assert not status.moving
    for bit in (4, 5, 6, 7, 9):
        assert Status(0, 1 << bit).moving
    assert Status(0, 1 << 1).at_limit_switch


def test_information():
    data = struct.pack("<I8sHBBBB60sHHH", 55000123, b"K10CR1", 16, 3, 0, 1, 0, bytes(60), 1, 0, 1)
    assert DeviceInfo.parse(data) == DeviceInfo("K10CR1", "55000123", "1.0.3")
    with pytest.raises(ProtocolError, match="is it a Thorlabs"):
        DeviceInfo.parse(bytes(4) + b"\xff\xfe\x01\x02" + bytes(76))


def test_an_option_goes_before_what_is_known():
    assert scale_of("K10CR1", None, 100.0).counts_per_deg == 100.0
    assert scale_of("KDC101", "PRM1-Z8", None).velocity_per_deg_s == pytest.approx(42941.66, rel=1e-6)
    assert scale_of("K10CR1", None, None).velocity_per_deg_s == pytest.approx(7329109, rel=1e-5)
