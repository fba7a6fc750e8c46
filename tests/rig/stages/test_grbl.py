"""The driver of a Grbl axis: two axes on a board, references, boards without switches, and what nobody can see."""

import time

import pytest

from anisoscope.base.clock import VirtualClock
from anisoscope.base.errors import LimitExceeded, NotConnected, NotHomed, ProtocolError, RigError, Stalled
from anisoscope.rig.stages.grbl import Grbl
from anisoscope.rig.stages.grbl_wire import (
    Alarm,
    Banner,
    Feedback,
    Ok,
    Refused,
    Setting,
    Status,
    error_of_alarm,
    error_of_refusal,
    parse,
)
from anisoscope.rig.transport import Transport, shared_ports
from anisoscope.sim.bench.firmware.axis import LinearAxis, RotaryAxis
from anisoscope.sim.bench.firmware.grbl import GrblFirmware
from anisoscope.sim.bench.firmware.grbl_settings import BELT, NATIVE_USB, UNO

HURRY = {"timeout_s": 0.15, "reset_s": 0.05, "margin_s": 0.15}


def board(model=UNO, *faults, time_scale=0.0):
    axes = [RotaryAxis(time_scale=time_scale) for _ in range(2)]
    return GrblFirmware(*axes, model=model, faults=faults)


@pytest.mark.parametrize("model", [UNO, NATIVE_USB])
def test_two_axes_of_one_board(in_process, model):
    firmware = board(model)
    with Transport(in_process(firmware)) as line:
        turn, tilt = (Grbl(line, axis=axis, **HURRY) for axis in "XY")
        for axis in (turn, tilt):
            axis.home()
        assert turn.limits_deg == (0.0, 360.0)
        assert tilt.limits_deg == (0.0, 120.0)
        turn.move_to(90.0)
        tilt.move_to(30.0)
        assert firmware.axis.position() == pytest.approx(90.0, abs=0.006)
        assert firmware.tilt_axis.position() == pytest.approx(30.0, abs=0.006)
        turn.close()
        assert tilt.position_deg() == pytest.approx(30.0, abs=0.006)


def test_a_board_may_search_as_long_as_it_does_itself(in_process):
    """Z searches first, and slowly: 190 mm at 500 mm/min take 23 s, more than X needs for its whole turn."""
    clock = VirtualClock()
    lift = LinearAxis(start_deg=190.0, time_scale=1.0, clock=clock)
    axes = [RotaryAxis(time_scale=1.0, clock=clock) for _ in range(2)]
    with Grbl.open(in_process(GrblFirmware(*axes, lift, model=UNO))) as stage:
        begun = clock()
        stage.home()
        assert 20.0 < clock() - begun < stage._search_limit_s()
        ways_s = 1.5 * 200.0 / (500.0 / 60.0) + 1.5 * 361.0 / 60.0
        assert 0.0 < stage._search_limit_s() - 1.1 * ways_s - 2.0 < 6.5, (
            "for backing off and finding it again"
        )
    with Grbl.open(in_process(board(NATIVE_USB))) as stage:
        assert 0.0 < stage._search_limit_s() - 1.1 * 1.5 * 361.0 / 60.0 - 2.0 < 3.5, "X alone"


def test_two_axes_of_a_rig_file_share_the_port(in_process):
    firmware = board()
    port = in_process(firmware)
    with shared_ports(), Grbl.open(port, axis="Y", **HURRY) as tilt:
        with Grbl.open(port, axis="X", **HURRY) as turn:
            turn.home()
            assert turn.move_to(45.0) == pytest.approx(45.0, abs=0.006)
        with pytest.raises(NotConnected, match="closed"):
            turn.position_deg()
        tilt.home()
        assert tilt.move_to(20.0) == pytest.approx(20.0, abs=0.006)


def test_a_board_that_homes_all_axes_at_once_takes_the_other_one_along(in_process):
    firmware = board()
    with Transport(in_process(firmware)) as line:
        turn, tilt = (Grbl(line, axis=axis, **HURRY) for axis in "XY")
        tilt.home()
        tilt.move_to(30.0)
        turn.home()
        assert firmware.tilt_axis.position() == 0.0
        assert tilt.is_homed
        assert tilt.position_deg() == 0.0
        assert tilt.move_to(10.0) == pytest.approx(10.0, abs=0.006)


def test_a_board_that_homes_one_by_one_leaves_the_other_one(in_process):
    firmware = board(NATIVE_USB)
    with Transport(in_process(firmware)) as line:
        turn, tilt = (Grbl(line, axis=axis, **HURRY) for axis in "XY")
        tilt.home()
        tilt.move_to(30.0)
        turn.home()
        assert tilt.position_deg() == pytest.approx(30.0, abs=0.006)


def test_a_reset_is_noticed_by_both_axes(in_process):
    firmware = board()
    with Transport(in_process(firmware)) as line:
        turn, tilt = (Grbl(line, axis=axis, **HURRY) for axis in "XY")
        turn.home()
        firmware._power_up()
        for axis in (turn, tilt):
            with pytest.raises(NotHomed):
                axis.move_to(10.0)
            assert not axis.is_homed


def test_no_switches_need_a_word_in_the_rig_file(in_process):
    firmware = board(BELT)
    port = in_process(firmware)
    with Grbl.open(port, **HURRY) as stage, pytest.raises(NotHomed, match='home = "here"'):
        stage.home()
    firmware.axis.start_move(12.0)
    with Grbl.open(port, home="here", **HURRY) as stage:
        assert stage.home() == 0.0
        stage.move_to(90.0)
        assert firmware.axis.position() == pytest.approx(102.0, abs=0.02)


def test_lost_steps_without_a_switch_are_seen_by_nobody(in_process):
    firmware = board(BELT, "stall:45")
    with Grbl.open(in_process(firmware), home="here", **HURRY) as stage:
        stage.home()
        assert stage.move_to(90.0) == pytest.approx(90.0, abs=0.02)
        assert firmware.axis.position() == 45.0


def test_after_a_limit_switch_the_board_is_homed_again(in_process):
    firmware = board(UNO, "stall:45")
    with Grbl.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        with pytest.raises(Stalled, match="ALARM:1"):
            stage.move_to(90.0)
        with pytest.raises(NotHomed):
            stage.move_to(10.0)
        firmware.clear_faults()
        stage.home()
        assert stage.move_to(90.0) == pytest.approx(90.0, abs=0.006)


def test_a_stopped_move_keeps_the_reference(in_process, when_it_turns):
    firmware = board(time_scale=1.0)
    with Grbl.open(in_process(firmware), **(HURRY | {"margin_s": 3.0})) as stage:
        stage.home()
        stopper = when_it_turns(firmware, stage.stop)
        with pytest.raises(RigError, match="was stopped at"):
            stage.move_to(300.0)
        stopper.join()
        here = stage.position_deg()
        assert 0.0 < here < 300.0
        assert firmware.axis.position() == pytest.approx(here, abs=0.02)
        assert stage.is_homed
        assert stage.move_to(10.0) == pytest.approx(10.0, abs=0.006)


def test_a_stopped_search_has_no_reference(in_process, when_it_turns):
    firmware = GrblFirmware(RotaryAxis(start_deg=300.0))
    with Grbl.open(in_process(firmware), **(HURRY | {"margin_s": 3.0})) as stage:
        stopper = when_it_turns(firmware, stage.stop)
        with pytest.raises(RigError):
            stage.home()
        stopper.join()
        assert not stage.is_homed
        assert not firmware.axis.busy()
        assert 200.0 < firmware.axis.position() < 300.0


@pytest.mark.parametrize("mask", [0, 1, 2, 3])
def test_work_coordinates_do_not_matter(in_process, mask):
    firmware = board()
    firmware.memory.settings[10] = float(mask)
    firmware.memory.offsets[54] = (17.0, 5.0, 0.0)
    with Grbl.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        firmware.write(b"G20G91\n")
        stage.move_to(90.0)
        assert stage.move_to(123.0) == pytest.approx(123.0, abs=0.006)
        assert firmware.axis.position() == pytest.approx(123.0, abs=0.006)


def test_homing_toward_the_upper_end_turns_the_limits(in_process):
    firmware = board()
    firmware.memory.settings[23] = 0.0
    with Grbl.open(in_process(firmware), **HURRY) as stage:
        assert stage.limits_deg == (-360.0, 0.0)
        stage.home()
        stage.move_to(-90.0)
        assert firmware.axis.position() == pytest.approx(-90.0, abs=0.006)


def test_the_speed_is_never_more_than_the_board_allows(in_process):
    firmware = board()
    with Grbl.open(in_process(firmware), velocity_deg_s=1e6, **HURRY) as stage:
        assert stage.rules.velocity_deg_s == 300.0
    with Grbl.open(in_process(firmware), velocity_deg_s=20.0, **HURRY) as stage:
        stage.home()
        stage.move_to(1.0)
        assert any(command.endswith(b"F1200.000") for command in firmware.commands)


def test_a_board_without_reset_line_is_reset_by_a_byte(in_process):
    firmware = board(NATIVE_USB)
    start = time.monotonic()
    with Grbl.open(in_process(firmware), **HURRY) as stage:
        assert b"\x18" in firmware.commands
        assert stage.name == "Grbl 1.1h X"
        assert stage.resolution_deg == pytest.approx(1 / 800)
    assert time.monotonic() - start < 60.0


def test_a_feed_hold_at_the_board_is_told(in_process):
    firmware = board(time_scale=1.0)
    with Grbl.open(in_process(firmware), **(HURRY | {"margin_s": 1.0})) as stage:
        stage.home()
        firmware.write(b"G1X-359F10\n")
        firmware.write(b"!")
        with pytest.raises(RigError):
            stage.move_to(10.0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [({13: 1.0}, r"\$13=0"), ({110: 0.0}, "cannot be true")],
)
def test_settings_that_cannot_work(in_process, settings, message):
    firmware = board()
    firmware.memory.settings.update(settings)
    with pytest.raises(ProtocolError, match=message):
        Grbl.open(in_process(firmware), **HURRY)


def test_options_that_mean_nothing(in_process):
    port = in_process(board())
    for options, message in (
        ({"axis": "Q"}, "no axis"),
        ({"home": "sweet"}, "means nothing"),
        ({"axis": "A"}, "axis A"),
    ):
        with pytest.raises(RigError, match=message):
            Grbl.open(port, **options, **HURRY)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (b"ok\r\n", Ok()),
        (b"\x00\xb5ok\r\n", Ok()),
        (b"error:15\r\n", Refused(15)),
        (b"ALARM:1\r\n", Alarm(1)),
        (b"Grbl 1.1h ['$' for help]\r\n", Banner("1.1h")),
        (b"GrblHAL 1.1f ['$' or '$HELP' for help]\r\n", Banner("1.1f")),
        (b"$100=88.889\r\n", Setting(100, 88.889)),
        (b"$100=88.889 (x, step/mm)\r\n", Setting(100, 88.889)),
        (b"[VER:1.1h.20190830:rig 7]\r\n", Feedback("VER", "1.1h.20190830:rig 7")),
        (b"[MSG:'$H'|'$X' to unlock]\r\n", Feedback("MSG", "'$H'|'$X' to unlock")),
        (
            b"<Hold:1|WPos:1.000,-2.500|Bf:15,128|FS:500,8000|WCO:0.000,1.551|Pn:XYZ|Ov:100,100,100|A:SFM>\r\n",
            Status("Hold", 1, (), (1.0, -2.5), (0.0, 1.551), (15.0, 128.0), 500.0, "XYZ", 100),
        ),
        (b"<Idle|MPos:1.000,2.000,3.000|F:0>\r\n", Status("Idle", 0, (1.0, 2.0, 3.0))),
    ],
)
def test_messages(line, message):
    assert parse(line) == message


@pytest.mark.parametrize(
    "line", [b"", b"book\r\n", b"<Idle|MPos:1.0", b"<Idle|MPos:1.0,x>\r\n", b"\xff\xfe", b"$100=\r\n"]
)
def test_damaged_lines_are_no_messages(line):
    assert parse(line) is None


def test_every_number_is_an_error_of_one_line():
    for code in range(1, 60):
        for error in (error_of_refusal("stage", code, "moving"), error_of_alarm("stage", code)):
            assert isinstance(error, RigError)
            assert "\n" not in str(error)
    assert isinstance(error_of_refusal("stage", 15, "moving"), LimitExceeded)
