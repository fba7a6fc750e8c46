"""The board's bytes, against the interface description of Grbl 1.1."""

import itertools

import pytest

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.firmware.grbl import GrblFirmware
from anisoscope.sim.bench.firmware.grbl_motion import Stepper
from anisoscope.sim.bench.firmware.grbl_settings import BELT, NATIVE_USB, UNO

BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
UNLOCK = b"[MSG:'$H'|'$X' to unlock]\r\n"


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def ask(firmware, data):
    firmware.write(data)
    return firmware.read()


def instant(model=UNO, **options):
    firmware = GrblFirmware(RotaryAxis(time_scale=0.0), model=model, **options)
    firmware.connect()
    firmware.read()
    return firmware


def homed(**options):
    firmware = instant(**options)
    assert ask(firmware, b"$H\n") == b"ok\r\n"
    return firmware


def in_time(clock, **options):
    firmware = GrblFirmware(RotaryAxis(clock=clock), **options)
    firmware.connect()
    if firmware.memory.settings[22]:
        assert ask(firmware, b"$H\n").endswith(b"ok\r\n")
    firmware.read()
    return firmware


def test_connecting_resets_a_board_and_locks_it_until_it_is_homed():
    firmware = homed()
    firmware.connect()
    assert firmware.read() == BANNER + UNLOCK
    assert ask(firmware, b"G0X1\n") == b"error:9\r\n"
    assert ask(firmware, b"?") == b"<Alarm|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>\r\n"
    assert ask(firmware, b"$X\n") == b"[MSG:Caution: Unlocked]\r\nok\r\n"
    assert firmware.state == "Idle"


def test_a_board_without_the_reset_line_goes_on():
    firmware = homed(model=NATIVE_USB)
    firmware.connect()
    assert firmware.read() == b""
    assert firmware.state == "Idle"


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        (b"", b"ok"),
        (b"(a comment) ; and another", b"ok"),
        (b"$I", b"[VER:1.1h.20190830:]\r\n[OPT:V,15,128]\r\nok"),
        (b"$G", b"[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]\r\nok"),
        (b"$N", b"$N0=\r\n$N1=\r\nok"),
        (b"$", b"[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]\r\nok"),
        (b"12", b"error:1"),
        (b"GX", b"error:2"),
        (b"$Q", b"error:3"),
        (b"$HX", b"error:3"),
        (b"$100=-1", b"error:4"),
        (b"$0=2", b"error:6"),
        (b"$999=1", b"error:3"),
        (b"$100=abc", b"error:2"),
        (b"G1X" + 90 * b"1", b"error:11"),
        (b"$J=X1F100", b"error:15"),
        (b"$J=G1X-1F100", b"error:16"),
        (b"$J=M3X-1F100", b"error:16"),
        (b"$J=X-1F100S3", b"error:36"),
        (b"$J=X-1", b"error:22"),
        (b"$J=F100", b"error:26"),
        (b"G2X1", b"error:20"),
        (b"G21G20", b"error:21"),
        (b"G1X-10", b"error:22"),
        (b"G1.5", b"error:23"),
        (b"G92G1X0", b"error:24"),
        (b"X-1X-2", b"error:25"),
        (b"G92", b"error:26"),
        (b"N99999999X-1", b"error:27"),
        (b"G4", b"error:28"),
        (b"G10L2P9X1", b"error:29"),
        (b"G80X-1", b"error:31"),
        (b"X-1I3", b"error:36"),
        (b"T300", b"error:38"),
        (b"F-1", b"error:4"),
        (b"M3 S1000", b"ok"),
        (b"G4P0.5", b"ok"),
    ],
)
def test_lines_and_their_answers(line, answer):
    assert ask(homed(), line + b"\n") == answer + b"\r\n"


def test_a_search_ends_pulled_off_in_negative_space():
    firmware = instant()
    firmware.axis.start_move(40.0)
    assert ask(firmware, b"$H\n") == b"ok\r\n"
    assert ask(firmware, b"?").startswith(b"<Idle|MPos:-360.000,-120.004,0.000|")
    assert firmware.axis.position() == 0.0
    assert firmware.tilt_axis.position() == 0.0


def test_axes_are_searched_one_by_one_where_the_option_is_compiled_in():
    firmware = instant(model=NATIVE_USB)
    firmware.tilt_axis.start_move(15.0)
    assert ask(firmware, b"$HX\n") == b"ok\r\n"
    assert ask(firmware, b"?").startswith(b"<Idle|MPos:-360.000,0.000,")
    assert firmware.tilt_axis.position() == 15.0


def test_homing_that_is_switched_off():
    assert ask(instant(model=BELT), b"$H\n") == b"error:5\r\n"
    assert ask(instant(model=BELT), b"$20=1\n") == b"error:10\r\n"
    firmware = homed()
    assert ask(firmware, b"$22=0\n") == b"ok\r\n"
    assert firmware.memory.settings[20] == 0.0


def test_ok_says_queued_and_the_report_says_where(clock):
    firmware = in_time(clock)
    assert ask(firmware, b"$J=G53X-350F600\n") == b"ok\r\n"
    assert ask(firmware, b"?").startswith(b"<Jog|MPos:-360.000,")
    clock.now += 0.5
    assert ask(firmware, b"?").startswith(b"<Jog|MPos:-35")
    assert ask(firmware, b"G1X-1F5\n") == b"error:9\r\n"
    clock.now += 5.0
    assert ask(firmware, b"?").startswith(b"<Idle|MPos:-349.998,")


def test_a_cancelled_jog_keeps_its_position(clock):
    firmware = in_time(clock)
    firmware.write(b"$J=G53X-300F600\n")
    assert firmware.read() == b"ok\r\n"
    clock.now += 2.0
    assert ask(firmware, b"\x85") == b""
    assert firmware.state == "Idle"
    assert firmware.counts / 88.889 + 360.0 == pytest.approx(firmware.axis.position(), abs=0.02)
    assert 10.0 < firmware.axis.position() < 25.0


def test_real_time_bytes_overtake_lines(clock):
    firmware = in_time(clock)
    firmware.write(b"G1X-300F600\nG1X-2?90F600\n")
    assert firmware.read().count(b"<Run") == 1
    clock.now += 1.0
    assert ask(firmware, b"!") == b""
    here = firmware.axis.position()
    clock.now += 1.0
    assert ask(firmware, b"?").startswith(b"<Hold:0|")
    assert firmware.axis.position() == here
    firmware.write(b"~")
    clock.now += 60.0
    firmware.read()
    clock.now += 60.0
    assert ask(firmware, b"?").startswith(b"<Idle|MPos:-290.")


def test_the_queue_holds_fifteen_moves_and_lines_wait_for_room(clock):
    firmware = in_time(clock, model=BELT)
    firmware.write(b"?")
    firmware.read()
    answers = ask(firmware, b"".join(b"G1X%dF600\n" % n for n in range(1, 10)))
    answers += ask(firmware, b"".join(b"G1X%dF600\n" % n for n in range(10, 19)))
    assert answers.count(b"ok") == 16
    for _ in range(20):
        clock.now += 1.0
        answers += firmware.read()
    assert answers.count(b"ok") == 18
    assert firmware.axis.position() == pytest.approx(18.0, abs=0.02)


def test_a_reset_in_motion_loses_the_position(clock):
    firmware = in_time(clock)
    firmware.write(b"G1X-300F600\n")
    clock.now += 1.0
    firmware.read()
    assert ask(firmware, b"\x18") == b"ALARM:3\r\n" + BANNER + UNLOCK


def test_a_reset_at_rest_keeps_the_position():
    firmware = homed()
    ask(firmware, b"$J=G53X-270F6000\n")
    assert ask(firmware, b"\x18") == BANNER
    assert ask(firmware, b"?").startswith(b"<Idle|MPos:-270.000,")


def test_while_it_searches_it_answers_nothing(clock):
    firmware = GrblFirmware(RotaryAxis(start_deg=90.0, clock=clock))
    firmware.connect()
    firmware.read()
    assert ask(firmware, b"$H\n?$G\n") == b""
    clock.now += 10.0
    answers = firmware.read().split(b"\r\n")
    assert [answer[:5] for answer in answers] == [b"<Home", b"ok", b"[GC:G", b"ok", b""]


def test_a_reset_is_the_only_way_out_of_a_search(clock):
    firmware = GrblFirmware(RotaryAxis(start_deg=90.0, clock=clock))
    firmware.connect()
    firmware.read()
    firmware.write(b"$H\n\x85")
    assert firmware.state == "Home"
    assert ask(firmware, b"\x18") == b"ALARM:6\r\n" + BANNER + UNLOCK


def test_an_obstacle_is_a_limit_switch_where_these_are_on():
    firmware = homed(faults=("stall:45",))
    answer = ask(firmware, b"$J=G53X-270F6000\n")
    assert answer == b"ok\r\nALARM:1\r\n[MSG:Reset to continue]\r\n"
    assert ask(firmware, b"?$X\n") == b""
    assert ask(firmware, b"\x18") == BANNER + UNLOCK


def test_without_switches_an_obstacle_goes_unnoticed():
    firmware = instant(model=BELT, faults=("stall:45",))
    ask(firmware, b"G0X90\n")
    assert ask(firmware, b"?").startswith(b"<Idle|MPos:89.999,0.000,0.000|FS:0,0|WCO")
    assert firmware.axis.position() == 45.0


def test_soft_limits():
    firmware = homed()
    assert ask(firmware, b"G0X1\n") == b"ALARM:2\r\n[MSG:Reset to continue]\r\n"
    assert ask(firmware, b"\x18") == BANNER + UNLOCK


def test_origins_and_inches():
    firmware = homed()
    assert ask(firmware, b"G92X10\n?") == (
        b"ok\r\n<Idle|MPos:-360.000,-120.004,0.000|FS:0,0|WCO:-370.000,0.000,0.000>\r\n"
    )
    ask(firmware, b"$10=2\n")
    assert ask(firmware, b"?").startswith(b"<Idle|WPos:10.000,-120.004,0.000|Bf:15,127|FS:")
    ask(firmware, b"G10L20P2X5\nG92.1\nG28.1\n")
    origins = ask(firmware, b"$#\n")
    assert b"[G55:" in origins
    assert b"[G28:-360.000,-120.004,0.000]" in origins
    assert b"[G92:0.000,0.000,0.000]" in origins
    ask(firmware, b"G20 G91 G0 X1\n")
    assert firmware.axis.position() == pytest.approx(25.4, abs=0.01)
    ask(firmware, b"$13=1\n$10=1\n")
    assert ask(firmware, b"?").startswith(b"<Idle|MPos:-13.17")


def test_modes_of_a_jog_do_not_stay():
    firmware = homed()
    ask(firmware, b"$J=G91G20X1F10\n")
    assert b"G21 G90" in ask(firmware, b"$G\n")


def test_check_mode_moves_nothing():
    firmware = homed()
    assert ask(firmware, b"$C\n") == b"[MSG:Enabled]\r\nok\r\n"
    assert ask(firmware, b"G0X-90\n") == b"ok\r\n"
    assert firmware.axis.position() == 0.0
    assert ask(firmware, b"$C\n") == b"[MSG:Disabled]\r\nok\r\n" + BANNER


def test_settings_and_startup_lines_survive_a_power_cycle():
    firmware = homed()
    assert ask(firmware, b"$110=600\n$N0=G20\n$I=rig 7\n") == b"ok\r\n" * 3
    firmware.connect()
    ask(firmware, b"$X\n")
    assert b"$110=600.000\r\n" in ask(firmware, b"$$\n")
    assert b":RIG7]" in ask(firmware, b"$I\n")
    assert ask(firmware, b"\x18").endswith(b">G20:ok\r\n")


def test_a_wrong_scale_shows_in_what_the_axis_does():
    firmware = instant(model=BELT)
    ask(firmware, b"$100=53.334\n")
    ask(firmware, b"G0X90\n")
    assert firmware.axis.position() == pytest.approx(180.0, abs=0.05)


def test_both_axes_end_together(clock):
    tilt = RotaryAxis(clock=clock)
    firmware = GrblFirmware(RotaryAxis(clock=clock), tilt, model=BELT)
    firmware.write(b"G1X60Y30F600\n")
    for _ in range(80):
        clock.now += 0.1
        if firmware.state == "Run":
            assert tilt.position() == pytest.approx(firmware.axis.position() / 2.0, abs=0.5)
    assert (firmware.axis.position(), tilt.position()) == pytest.approx((60.0, 30.0), abs=0.02)


def test_building():
    mounts = [Mount(RotaryAxis(time_scale=0.0)), Mount(RotaryAxis(time_scale=0.0), "Y")]
    firmware = build("grbl", mounts, model="a4988-belt")
    ask(firmware, b"G0Y10\n")
    assert mounts[1].axis.position() == pytest.approx(10.0, abs=0.02)
    for wrong in ([*mounts, Mount(RotaryAxis())], [Mount(RotaryAxis(), "Q")]):
        with pytest.raises(UsageError):
            build("grbl", wrong)
    with pytest.raises(UsageError, match="cannot have"):
        build("grbl", mounts, faults=("wrong-address",))


def test_load_follows_its_pulses_on_a_busy_computer():
    times = itertools.accumulate(itertools.cycle([5e-3] + 6 * [1e-5]))
    axis = RotaryAxis(clock=lambda: next(times))
    stepper = Stepper(axis, 10.0)
    for target in range(10, 210, 10):
        stepper.go(target, 430.0, 4000.0)
        while stepper.busy:
            pass
    assert (stepper.steps, axis.position()) == (200, pytest.approx(20.0, abs=1e-9))
