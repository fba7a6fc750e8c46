"""What is particular to the Zaber driver; what all drivers do is in test_conformance."""

import time

import pytest

from anisoscope.base.errors import (
    LimitExceeded,
    MotionTimeout,
    NotConnected,
    NotHomed,
    ProtocolError,
    RigError,
    Stalled,
)
from anisoscope.rig.stages.zaber import (
    Reply,
    Zaber,
    ZaberLine,
    checksum,
    command,
    deg_s2_of_acceleration,
    deg_s_of_speed,
    error_of_flag,
    error_of_rejection,
    is_alert_of,
    is_aside,
)
from anisoscope.rig.transport import Transport
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.device import Bus
from anisoscope.sim.bench.firmware.zaber import (
    FLAGS,
    MILD_FLAGS,
    REASONS,
    X_RSB060AD,
    X_RST120AK,
    X_RSW60A,
    ZaberFirmware,
)

HURRY = {"timeout_s": 0.15, "margin_s": 0.15, "velocity_deg_s": 4000.0, "acceleration_deg_s2": 40000.0}
COUNT_DEG = 360 / X_RSW60A.counts_per_turn

MESSAGES = 16  # answers from connecting to having homed and moved


def firmware_with(*faults, time_scale=0.0, **options):
    return ZaberFirmware(RotaryAxis(time_scale=time_scale), faults=faults, **options)


class Forgetful(ZaberFirmware):
    """Loses some of its messages on the way, or damages them."""

    spoilt = 0
    lost: frozenset[int] = frozenset()
    damaged: frozenset[int] = frozenset()

    def _send(self, frame):
        self.spoilt += 1
        if self.spoilt in self.damaged:  # one bit of the last character of the data
            end = frame.index(b":")
            frame = frame[: end - 1] + bytes([frame[end - 1] ^ 1]) + frame[end:]
        if self.spoilt not in self.lost:
            super()._send(frame)


@pytest.mark.parametrize("model", [X_RSW60A, X_RST120AK, X_RSB060AD])
def test_the_scale_comes_from_the_device(in_process, model):
    firmware = firmware_with(model=model)
    with Zaber.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        stage.move_to(90.0)
        assert firmware.motor.counts == model.counts_per_turn // 4
        assert stage.resolution_deg == pytest.approx(360 / model.counts_per_turn)


def test_speed_and_acceleration_come_from_the_device(in_process):
    with Zaber.open(in_process(firmware_with(model=X_RST120AK))) as stage:
        assert stage.rules.velocity_deg_s == pytest.approx(24.0, rel=1e-4)
        assert stage.rules.acceleration_deg_s2 == pytest.approx(205 * 1e4 / 1.6384 / 6400.0)
    firmware = firmware_with()
    firmware.settings["accel"] = 0  # as fast as it can
    with Zaber.open(in_process(firmware)) as stage:
        assert stage.rules.duration_s(115.0) == pytest.approx(1.0, abs=0.02)


def test_limits_of_the_device_narrow_those_of_the_driver(in_process):
    firmware = firmware_with()
    firmware.settings["limit.min"] = X_RSW60A.counts_per_turn // 36
    firmware.settings["limit.max"] = X_RSW60A.counts_per_turn // 2
    port = in_process(firmware)
    with Zaber.open(port, **HURRY) as stage:
        assert stage.limits_deg == pytest.approx((10.0, 180.0), abs=COUNT_DEG)
    with pytest.raises(LimitExceeded, match=r"270° are not within those of the device, .*°…180°"):
        Zaber.open(port, max_deg=270.0, **HURRY)
    with Zaber.open(in_process(firmware_with()), min_deg=-720.0, max_deg=720.0, **HURRY) as stage:
        stage.home()
        assert stage.move_to(-500.0) == pytest.approx(-500.0, abs=COUNT_DEG)


def test_a_stage_that_does_not_know_its_turn(in_process):
    firmware = firmware_with()
    firmware.settings["limit.cycle.dist"] = 0
    port = in_process(firmware)
    with pytest.raises(ProtocolError, match="set the option counts_per_turn"):
        Zaber.open(port, **HURRY)
    with Zaber.open(port, counts_per_turn=384_000.0, **HURRY) as stage:
        assert stage.resolution_deg == COUNT_DEG


def test_the_reference_outlives_the_connection_but_not_the_power(in_process):
    firmware = firmware_with()
    port = in_process(firmware)
    with Zaber.open(port, **HURRY) as stage:
        assert stage.warnings() == ("WR",)
        stage.home()
        assert stage.warnings() == ()
    with Zaber.open(port, **HURRY) as stage:
        assert stage.is_homed
        firmware.write(b"/1 system reset\n")
        with pytest.raises(NotHomed, match="home it again"):
            stage.move_to(10.0)
        assert not stage.is_homed
        stage.home()
        assert stage.move_to(10.0) == pytest.approx(10.0, abs=COUNT_DEG)


def test_a_turn_of_the_knob_loses_nothing(in_process):
    firmware = firmware_with()
    with Zaber.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        stage.move_to(20.0)
        firmware.write(b"/1 move rel 50000\n")
        assert stage.position_deg() == pytest.approx(20.0 + 50000 * COUNT_DEG, abs=COUNT_DEG)
        assert stage.move_to(30.0) == pytest.approx(30.0, abs=COUNT_DEG)


def test_another_program_interrupts_a_move(in_process, when_it_turns):
    firmware = firmware_with(time_scale=5.0)
    with Zaber.open(in_process(firmware), **(HURRY | {"margin_s": 5.0})) as stage:
        stage.home()
        meddler = when_it_turns(firmware, lambda: firmware.write(b"/1 stop\n"))
        with pytest.raises(
            MotionTimeout, match=r"was interrupted at .*\(NI\), by its knob or another program"
        ):
            stage.move_to(180.0)
        meddler.join()
        firmware.axis.time_scale = 0.0
        assert stage.move_to(40.0) == pytest.approx(40.0, abs=COUNT_DEG)


def test_an_obstacle_is_reported_and_the_next_move_starts_afresh(in_process):
    firmware = firmware_with("stall:45")
    with Zaber.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        with pytest.raises(Stalled, match="obstacle"):
            stage.move_to(90.0)
        firmware.motor.repair()
        assert stage.warnings()[0] == "FS"
        assert stage.move_to(90.0) == pytest.approx(90.0, abs=COUNT_DEG)


@pytest.mark.parametrize("spoil", ["lost", "damaged"])
def test_every_single_message_may_be_spoilt(in_process, spoil):
    for number in range(1, MESSAGES + 1):
        firmware = Forgetful(RotaryAxis(time_scale=0.0))
        setattr(firmware, spoil, frozenset({number}))
        with Zaber.open(in_process(firmware), **(HURRY | {"timeout_s": 0.02})) as stage:
            stage.home()
            assert stage.move_to(90.0) == pytest.approx(90.0, abs=COUNT_DEG)
        assert firmware.spoilt == MESSAGES + 1


def test_an_answer_to_an_older_question_is_not_taken(in_process):
    with Transport(in_process(firmware_with())) as port:
        line = ZaberLine(port, 1, 1, 0.15)
        line.send("get maxspeed")
        line.send("get nothing")
        assert line.number("accel") == X_RSW60A.accel


def test_an_alert_ends_a_rest(in_process):
    firmware = firmware_with()
    with Transport(in_process(firmware)) as port:
        line = ZaberLine(port, 1, 1, 0.15)
        line.command("set comm.alert 1", axis=0)
        line.command("home")
        start = time.monotonic()
        line.rest(600.0)
        assert time.monotonic() - start < 60.0
        line.rest(0.01)  # and without one it ends as well


def test_two_stages_share_a_line(in_process):
    first, second = firmware_with(), firmware_with(address=42, model=X_RST120AK, place=1)
    with Transport(in_process(Bus(first, second))) as port:
        stages = [Zaber(port, address=address, **HURRY) for address in ("1", 42)]
        for stage, angle in zip(stages, (10.0, 20.0), strict=True):
            stage.home()
            stage.move_to(angle)
        stages[0].close()
        assert stages[1].position_deg() == pytest.approx(20.0, abs=COUNT_DEG)
        assert first.axis.position() == pytest.approx(10.0, abs=COUNT_DEG)


@pytest.mark.parametrize(
    "options", [{"address": 0}, {"address": 100}, {"address": "A"}, {"axis": 0}, {"axis": 10}]
)
def test_numbers_that_are_none(in_process, options):
    with pytest.raises(RigError, match="use one of 1…"):
        Zaber.open(in_process(firmware_with()), **options)


def test_an_axis_that_the_device_does_not_have(in_process):
    with pytest.raises(ProtocolError, match="microsteps a turn"):
        Zaber.open(in_process(firmware_with()), axis=2, **HURRY)


def test_a_wrong_address_is_named(in_process):
    with pytest.raises(NotConnected, match="address 3, is silent"):
        Zaber.open(in_process(firmware_with()), address=3, **HURRY)


def test_commands_are_those_of_the_makers_client():
    # Recorded from zaber-motion 10.2.
    assert command(1, 0, 1, "get comm.packet.size.max") == b"/1 0 01 get comm.packet.size.max:CF\n"
    assert command(1, 1, 15, "home") == b"/1 1 15 home:2F\n"
    assert command(1, 1, 16, "") == b"/1 1 16:F7\n"
    assert checksum(b"1 0 02 get deviceid") == 0x40


def test_a_reply_is_taken_apart():
    reply = Reply.parse(
        b"\0\xff?@01 1 21 RJ BUSY WR BADDATA:%02X\r\n" % checksum(b"01 1 21 RJ BUSY WR BADDATA")
    )
    assert reply == Reply(1, 1, 21, accepted=False, busy=True, flag="WR", data="BADDATA")


@pytest.mark.parametrize(
    "line",
    [
        b"\r\n",
        b"@01 0 OK IDLE -- 0\r\n",  # neither number nor checksum
        b"@01 0 05 OK IDLE -- 0\r\n",  # no checksum
        b"@01 1 23 OK IDLE -- 0:06\r\n",  # a wrong one
        b"@01 1 23 OK LAZY -- 0:07\r\n",
        b"@1 1 23 OK IDLE -- 0:00\r\n",
        b"#01 1 23 OK IDLE -- 0:00\r\n",
    ],
)
def test_damaged_lines_are_no_replies(line):
    assert Reply.parse(line) is None


def test_asides():
    assert is_aside(b"#01 0 Visit the manual\r\n")
    assert is_alert_of(b"\0!01 1 IDLE --\r\n", 1)
    assert not is_alert_of(b"!02 1 IDLE --\r\n", 1)
    assert not is_alert_of(b"#01 1 IDLE --\r\n", 1)
    assert not is_aside(b"@01 1 23 OK IDLE -- 0:06\r\n")


def test_units():
    # 1.6384 · microsteps/s, and 1.6384 / 10⁴ · microsteps/s²
    assert deg_s_of_speed(16384.0, 1000.0) == pytest.approx(10.0)
    assert deg_s2_of_acceleration(16384.0, 1000.0) == pytest.approx(100_000.0)


def test_every_flag_and_every_reason_is_an_error_of_one_line():
    for flag in (*FLAGS, *MILD_FLAGS, "F9"):
        assert f"({flag})" in str(error_of_flag("stage", flag))
        assert "\n" not in str(error_of_flag("stage", flag))
    for reason in (*REASONS, "STATUSBUSY", "AGAIN", "BADAXIS", "DEVICEONLY", "BADMESSAGEID", "NEWS"):
        reply = Reply(1, 1, 0, accepted=False, busy=False, flag="--", data=reason)
        assert f"({reason})" in str(error_of_rejection("stage", "move abs 1", reply))
