"""The firmware's bytes, against recordings of real devices and the maker's table."""

import pytest

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount
from anisoscope.sim.bench.firmware.device import Bus
from anisoscope.sim.bench.firmware.elliptec import ELL8, ElliptecFirmware, build
from anisoscope.sim.bench.firmware.faults import Fault, FaultKind


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


def instant(**options):
    return ElliptecFirmware(RotaryAxis(time_scale=0.0), **options)


def test_information_is_that_of_a_real_device():
    assert ask(instant(address="2"), b"2in") == b"2IN0E1140051720231701016800023000\r\n"


def test_no_two_devices_of_a_bus_bear_one_serial_number():
    bus = build([Mount(RotaryAxis(time_scale=0.0)), Mount(RotaryAxis(time_scale=0.0))], "ELL14", ())
    assert [ask(bus, b"%din" % number)[5:13] for number in (0, 1)] == [b"11400517", b"11400518"]


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        (b"0gs", b"0GS00\r\n"),
        (b"0gp", b"0PO00000000\r\n"),
        (b"0ho0", b"0PO00000000\r\n"),
        (b"0ma00002000", b"0PO00002000\r\n"),
        (b"0mr00000400", b"0PO00000400\r\n"),
        (b"0maFFFFFFFF", b"0POFFFFFFFF\r\n"),
        (b"0fw", b"0PO0000018E\r\n"),
        (b"0gj", b"0GJ0000018E\r\n"),
        (b"0go", b"0HO00000000\r\n"),
        (b"0gv", b"0GV64\r\n"),
        (b"0sv32", b"0GS00\r\n"),
        (b"0sv00", b"0GS04\r\n"),
        (b"0sj00000010", b"0GS00\r\n"),
        (b"0so00000010", b"0GS00\r\n"),
        (b"0st", b"0GS00\r\n"),
        (b"0us", b"0GS00\r\n"),
        (b"0is05", b"0GS00\r\n"),
        (b"0f10ABC", b"0GS00\r\n"),
        (b"0b20ABC", b"0GS00\r\n"),
        (b"0s1", b"0GS00\r\n"),
        (b"0ca5", b"5GS00\r\n"),
        (b"0xy", b"0GS03\r\n"),
        (b"0sv??", b"0GS03\r\n"),
        (b"0ma00023002", b"0GS04\r\n"),
        (b"0bw", b"0GS04\r\n"),
        (b"1gs", b""),
    ],
)
def test_answers(command, answer):
    assert ask(instant(), command) == answer


def test_motor_information_has_22_digits():
    assert len(ask(instant(), b"0i1")) == 1 + 2 + 22 + 2


@pytest.mark.parametrize("data", [b"\r\n0gs\r\n", b"\n0gs", b"0gs\r", b"\x000gs"])
def test_stray_bytes_are_swallowed(data):
    assert ask(instant(), data) == b"0GS00\r\n"


def test_packets_joined_and_split():
    firmware = instant()
    assert ask(firmware, b"0gs0gp0g") == b"0GS00\r\n0PO00000000\r\n"
    assert ask(firmware, b"v") == b"0GV64\r\n"


def test_bytes_too_far_apart_are_dropped(clock):
    firmware = ElliptecFirmware(RotaryAxis(clock=clock))
    firmware.write(b"0ma0000")
    clock.now += 2.1
    assert ask(firmware, b"0gs") == b"0GS00\r\n"


def test_a_fault_is_latched_until_it_is_read():
    firmware = instant(faults=("latched-error:8",))
    assert [ask(firmware, b"0gs") for _ in range(2)] == [b"0GS08\r\n", b"0GS00\r\n"]
    ask(firmware, b"0ma7FFFFFFF")
    assert [ask(firmware, b"0gs") for _ in range(2)] == [b"0GS04\r\n", b"0GS00\r\n"]


def test_a_motion_is_answered_once_when_it_is_over(clock):
    firmware = ElliptecFirmware(RotaryAxis(clock=clock))
    assert ask(firmware, b"0ma00011800") == b""
    assert ask(firmware, b"0gp") == b"0GS09\r\n"
    clock.now += 10.0
    assert firmware.read() == b"0PO00011800\r\n"
    assert firmware.read() == b""


def test_a_stop_ends_the_motion_where_it_is(clock):
    firmware = ElliptecFirmware(RotaryAxis(clock=clock))
    firmware.write(b"0ma00011800")
    clock.now += 0.2
    answer = ask(firmware, b"0st")
    assert 0 < int(answer[3:11], 16) < 0x11800
    assert ask(firmware, b"0gp") == answer


def test_before_homing_the_count_is_from_power_up():
    firmware = ElliptecFirmware(RotaryAxis(start_deg=37.0, time_scale=0.0))
    assert ask(firmware, b"0gp") == b"0PO00000000\r\n"
    ask(firmware, b"0ho0")
    assert firmware.axis.position() == 0.0
    ask(firmware, b"0ma00008C00")
    assert firmware.axis.position() == 90.0


def test_home_offset_moves_the_zero():
    firmware = instant()
    ask(firmware, b"0so00000FA0")
    assert ask(firmware, b"0ho0") == b"0PO00000000\r\n"
    assert firmware.axis.position() == pytest.approx(4000 * 360 / 143360)


def test_another_model_has_another_scale():
    firmware = instant(model=ELL8)
    ask(firmware, b"0ma00010000")
    assert firmware.axis.position() == 90.0


def test_several_stages_on_one_line():
    bus = Bus(instant(address="0"), instant(address="A"))
    assert ask(bus, b"Ama00000010") == b"APO00000010\r\n"
    assert ask(bus, b"0gp") == b"0PO00000000\r\n"


def test_a_dead_line_works_again_after_connecting():
    firmware = instant(faults=("hangup",))
    with pytest.raises(ConnectionError):
        ask(firmware, b"0ho0")
    firmware.connect()
    assert ask(firmware, b"0ho0") == b"0PO00000000\r\n"


@pytest.mark.parametrize("text", ["nonsense", "stall:x"])
def test_faults_that_do_not_exist(text):
    with pytest.raises(UsageError):
        Fault.parse(text)


def test_every_fault_has_a_name():
    assert {Fault.parse(kind).kind for kind in FaultKind} == set(FaultKind)
