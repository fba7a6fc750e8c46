"""The firmware's bytes, against the maker's table of messages."""

import struct

import pytest

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.apt import MODELS, AptFirmware
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build

K10CR1, KDC101 = MODELS["K10CR1"], MODELS["KDC101"]
ENABLE = bytes.fromhex("1002 01 01 50 01")
HOME = bytes.fromhex("4304 01 00 50 01")
STOP = bytes.fromhex("6504 01 02 50 01")
REQ_STATUS = {"K10CR1": bytes.fromhex("8004 01 00 50 01"), "KDC101": bytes.fromhex("9004 01 00 50 01")}
ENABLED_AT_REST = 1 << 31 | 1 << 13 | 1 << 8


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def ask(firmware, data):
    firmware.write(bytes.fromhex(data) if isinstance(data, str) else data)
    return firmware.read()


def instant(model=K10CR1, **options):
    return AptFirmware(RotaryAxis(time_scale=0.0), model=model, **options)


def move(counts):
    return struct.pack("<HHBBHi", 0x0453, 6, 0xD0, 0x01, 1, counts)


def status_of(firmware):
    answer = ask(firmware, REQ_STATUS[firmware.model.name])
    return struct.unpack("<HiiI", answer[-14:])


def test_information_is_84_bytes():
    answer = ask(instant(), "0500 00 00 50 01")
    assert answer[:6] == bytes.fromhex("0600 5400 81 50")
    assert len(answer) == 6 + 84
    assert struct.unpack_from("<I8s", answer, 6) == (55000123, b"K10CR1\0\0")
    assert struct.unpack_from("<H", answer, 6 + 82) == (1,)


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        ("1102 01 00 50 01", "1202 01 01 01 50"),
        ("1104 01 00 50 01", "1204 0600 81 50 0100 00000000"),
        ("0A04 01 00 50 01", "0B04 0600 81 50 0100 00000000"),
        ("2904 01 00 50 01", "2A04 0600 81 50 0100 00210080"),
        ("8004 01 00 50 01", "8104 0E00 81 50 0100 00000000 00000000 00210080"),
        ("2404 01 00 50 01", "2504 1000 81 50 0100 0100 0100 00000000 00000000 0100"),
        ("3B04 01 00 50 01", "3C04 0600 81 50 0100 00000000"),
        ("1404 01 00 50 01", "1504 0E00 81 50 0100 00000000 AC3A0000 52555E04"),
        ("4104 01 00 50 01", "4204 0E00 81 50 0100 0200 0100 52555E04 00000000"),
        ("9004 01 00 50 01", ""),
        ("9204 00 00 50 01", ""),
        ("0200 00 00 50 01", ""),
        ("1800 00 00 50 01", ""),
        ("1200 00 00 50 01", ""),
        ("0500 00 00 21 01", ""),
        ("6504 01 01 50 01", "6604 0E00 81 50 0100 00000000 00000000 00210080"),
    ],
)
def test_answers(command, answer):
    assert ask(instant(), command) == bytes.fromhex(answer)


def test_jog_parameters_are_22_bytes_and_kept():
    firmware = instant()
    assert len(ask(firmware, "1704 01 00 50 01")) == 6 + 22
    data = struct.pack("<HHiiiiH", 1, 2, 1234, 0, 5, 6, 1)
    ask(firmware, struct.pack("<HHBB", 0x0416, 22, 0xD0, 1) + data)
    assert ask(firmware, "1704 01 00 50 01")[6:] == data


def test_a_servo_speaks_in_the_messages_of_servos():
    firmware = instant(KDC101)
    assert ask(firmware, REQ_STATUS["K10CR1"]) == b""
    answer = ask(firmware, REQ_STATUS["KDC101"])
    assert answer == bytes.fromhex("9104 0E00 81 50 0100 00000000 0000 0000 00210080")


def test_the_channel_is_on_at_power_up_as_published_clients_expect():
    firmware = instant()
    assert ask(firmware, HOME) == bytes.fromhex("4404 01 00 01 50")
    assert status_of(firmware)[3] == ENABLED_AT_REST | 1 << 10


def test_a_motion_of_a_channel_that_was_switched_off_is_refused_and_said():
    firmware = instant()
    ask(firmware, "1002 01 02 50 01")
    for command, about in ((move(1000), 0x0453), (HOME, 0x0443)):
        answer = ask(firmware, command)
        assert answer[:6] == bytes.fromhex("8100 4400 81 50")
        assert struct.unpack_from("<HH", answer, 6) == (about, 1)
        assert b"switched off" in answer
    assert (firmware.counts, firmware.motor.referenced) == (0, False)
    ask(firmware, ENABLE)
    ask(firmware, move(1000))
    assert firmware.counts == 1000
    assert ask(firmware, "1102 01 00 50 01") == bytes.fromhex("1202 01 01 01 50")


def test_a_motion_is_answered_once_when_it_is_over(clock):
    firmware = AptFirmware(RotaryAxis(clock=clock))
    assert ask(firmware, ENABLE + move(409600)) == b""
    assert status_of(firmware)[3] == 1 << 31 | 1 << 8 | 1 << 4
    clock.now += 0.8
    assert 0 < status_of(firmware)[1] < 409600
    clock.now += 0.4
    # 3° at 10°/s and 10°/s²: never at full speed, 2√(3/10) s
    assert firmware.read() == struct.pack("<HHBBHiiI", 0x0464, 14, 0x81, 0x50, 1, 409600, 0, ENABLED_AT_REST)
    assert firmware.read() == b""
    ask(firmware, move(0))
    assert status_of(firmware)[3] == 1 << 31 | 1 << 8 | 1 << 5


def test_homing_forgets_the_reference_and_finds_it(clock):
    firmware = AptFirmware(RotaryAxis(start_deg=-20.0, clock=clock))
    firmware.write(ENABLE + HOME)
    assert status_of(firmware)[3] >> 9 & 3 == 1
    clock.now += 10.0
    assert firmware.read() == bytes.fromhex("4404 01 00 01 50")
    assert status_of(firmware)[3] == ENABLED_AT_REST | 1 << 10
    assert firmware.axis.position() == 0.0
    firmware.write(move(1000))
    clock.now += 1.0
    firmware.write(HOME)
    assert not status_of(firmware)[3] >> 10 & 1


def test_homing_goes_to_the_offset_that_was_set():
    firmware = instant()
    ask(firmware, struct.pack("<HHBBHHHii", 0x0440, 14, 0xD0, 1, 1, 2, 1, 73291090, 409600))
    ask(firmware, ENABLE + HOME)
    assert firmware.axis.position() == pytest.approx(3.0)
    assert firmware.counts == 0


def test_a_stop_ends_the_motion_where_it_is(clock):
    firmware = AptFirmware(RotaryAxis(clock=clock))
    firmware.write(ENABLE + move(40960000))
    clock.now += 2.0
    answer = ask(firmware, STOP)
    assert answer[:6] == bytes.fromhex("6604 0E00 81 50")
    at = struct.unpack_from("<i", answer, 8)[0]
    assert at / K10CR1.counts_per_deg == pytest.approx(15.0, abs=0.01)
    clock.now += 10.0
    assert firmware.read() == b""
    assert status_of(firmware)[1] == at


@pytest.mark.parametrize(
    ("data", "moved"), [(struct.pack("<Hi", 1, 700), 700), (struct.pack("<Hi", 1, -9), -9)]
)
def test_relative_moves_and_moves_to_what_was_set_before(data, moved):
    firmware = instant()
    ask(firmware, ENABLE + move(100))
    ask(firmware, struct.pack("<HHBB", 0x0448, 6, 0xD0, 1) + data)
    assert firmware.counts == 100 + moved
    ask(firmware, struct.pack("<HHBB", 0x0450, 6, 0xD0, 1) + data + bytes.fromhex("5304 01 00 50 01"))
    assert firmware.counts == moved
    ask(firmware, struct.pack("<HHBB", 0x0445, 6, 0xD0, 1) + data + bytes.fromhex("4804 01 00 50 01"))
    assert firmware.counts == 2 * moved


def test_velocity_parameters_set_the_speed(clock):
    firmware = AptFirmware(RotaryAxis(clock=clock))
    ask(firmware, struct.pack("<HHBBHiii", 0x0413, 14, 0xD0, 1, 1, 0, 1502 * 1000, 7329109 * 5))
    firmware.write(ENABLE + move(round(100 * K10CR1.counts_per_deg)))
    clock.now += 10.0
    assert firmware.axis.position() == pytest.approx(50.0, abs=0.05)


@pytest.mark.parametrize("model", [K10CR1, KDC101])
def test_packets_split_and_joined(model):
    firmware = instant(model)
    data = REQ_STATUS[model.name] + ENABLE + move(77) + REQ_STATUS[model.name]
    whole = ask(instant(model), data)
    pieces = b""
    for byte in data:
        pieces += ask(firmware, bytes([byte]))
    assert pieces == whole
    assert len(whole) == 3 * 20


def test_noise_between_packets_is_swallowed():
    assert ask(instant(), b"\x00\xff\r\n?" + bytes.fromhex("1104 01 00 50 01")).hex().startswith("12040600")


def test_updates_come_ten_times_a_second_when_asked_for(clock):
    firmware = AptFirmware(RotaryAxis(clock=clock))
    updates = 0
    ask(firmware, "1100 0A 00 50 01")
    for _ in range(100):
        clock.now += 0.02
        updates += len(firmware.read()) // 20
    assert 15 <= updates <= 20
    ask(firmware, "1200 00 00 50 01")
    clock.now += 1.0
    assert firmware.read() == b""


def test_a_servo_whose_updates_nobody_acknowledges_falls_silent(clock):
    firmware = AptFirmware(RotaryAxis(clock=clock), model=KDC101)
    ask(firmware, "1100 0A 00 50 01")
    for _ in range(60):
        clock.now += 0.11
        firmware.read()
    assert ask(firmware, REQ_STATUS["KDC101"]) == b""
    assert len(ask(firmware, bytes.fromhex("9204 00 00 50 01") + REQ_STATUS["KDC101"])) >= 20


def test_before_homing_the_count_is_from_power_up():
    firmware = AptFirmware(RotaryAxis(start_deg=37.0, time_scale=0.0))
    assert status_of(firmware)[1] == 0
    ask(firmware, ENABLE + HOME)
    assert firmware.axis.position() == 0.0


def test_a_servo_that_stalls_says_so_and_a_stepper_does_not():
    for model, error in ((KDC101, True), (K10CR1, False)):
        firmware = instant(model, faults=("stall:10",))
        ask(firmware, ENABLE + HOME)
        ask(firmware, move(round(20 * model.counts_per_deg)))
        ask(firmware, REQ_STATUS[model.name])
        _, counts, _, bits = status_of(firmware)
        assert bool(bits >> 14 & 1) is error
        assert counts / model.counts_per_deg == pytest.approx(10.0 if error else 20.0, abs=1e-3)
        assert firmware.axis.position() == 10.0


def test_a_stepper_that_cannot_reach_its_mark_searches_until_it_is_stopped():
    firmware = AptFirmware(RotaryAxis(start_deg=60.0, time_scale=0.0), faults=("stall:45",))
    ask(firmware, ENABLE + HOME)
    for _ in range(3):
        assert status_of(firmware)[3] >> 9 & 1
    ask(firmware, STOP)
    assert not status_of(firmware)[3] >> 9 & 1


def test_an_error_stays_until_the_channel_is_switched_off():
    firmware = instant(KDC101, faults=("latched-error:14",))
    ask(firmware, ENABLE + move(100))
    assert firmware.counts == 0
    ask(firmware, bytes.fromhex("1002 01 02 50 01") + ENABLE + move(100))
    assert firmware.counts == 100


def test_a_controller_has_one_axis_and_a_known_address():
    mount = Mount(RotaryAxis())
    with pytest.raises(UsageError, match="one axis"):
        build("apt", [mount, mount])
    with pytest.raises(UsageError, match="'7' is not an APT address"):
        build("apt", [Mount(RotaryAxis(), "7")])
    assert build("apt", [Mount(RotaryAxis(), "21")], model="KDC101").address == 0x21
    with pytest.raises(UsageError, match="cannot have the fault 'busy'"):
        build("apt", [mount], faults=["busy"])
