"""The firmware's bytes, against what real devices answer and the maker's client asks."""

import pytest

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.axis import LinearAxis, RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.firmware.device import Bus
from anisoscope.sim.bench.firmware.zaber import (
    LINEAR,
    MODELS,
    X_RST120AK,
    X_RSW60A,
    Command,
    ZaberFirmware,
    frame,
    lrc,
)


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
    return ZaberFirmware(RotaryAxis(time_scale=0.0), **options)


def homed(**options):
    firmware = instant(**options)
    ask(firmware, b"/1 home\n")
    return firmware


def timed(clock, *faults):
    firmware = ZaberFirmware(RotaryAxis(clock=clock), faults=faults)
    ask(firmware, b"/1 home\n/1 set comm.alert 1\n")
    return firmware


def test_the_makers_client_is_answered():
    # What zaber-motion 10.2 sends; the checksums of the answers are by the rule of the manual.
    firmware = instant()
    assert ask(firmware, b"/0 0 00:00\n") == b"@01 0 00 OK IDLE WR 0:BE\r\n"
    assert ask(firmware, b"/1 0 01 get comm.packet.size.max:CF\n") == b"@01 0 01 RJ IDLE WR BADCOMMAND:25\r\n"
    assert ask(firmware, b"/1 0 02 get deviceid:40\n").startswith(b"@01 0 02 OK IDLE WR 59060:")
    assert ask(firmware, b"/1 1 15 home:2F\n").startswith(b"@01 1 15 OK BUSY WR 0:")
    assert ask(firmware, b"/1 1 16:F7\n").startswith(b"@01 1 16 OK IDLE -- 0:")


def test_no_two_devices_of_a_bus_bear_one_serial_number():
    bus = build("zaber", [Mount(RotaryAxis(time_scale=0.0)), Mount(RotaryAxis(time_scale=0.0))])
    found = [ask(bus, b"/%d get system.serial\n" % number).split()[-1] for number in (1, 2)]
    assert found == [b"68101", b"68102"]


def test_homing_as_the_makers_older_library_expects_it(clock):
    # From the tests of zaber.serial: neither number nor checksum, CR LF.
    firmware = ZaberFirmware(RotaryAxis(clock=clock, start_deg=20.0))
    assert ask(firmware, b"/1 0 home\r\n") == b"@01 0 OK BUSY WR 0\r\n"
    assert ask(firmware, b"/1 0\r\n") == b"@01 0 OK BUSY WR 0\r\n"
    clock.now += 10.0
    assert ask(firmware, b"/1 0\r\n") == b"@01 0 OK IDLE -- 0\r\n"
    assert firmware.axis.position() == 0.0


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        (b"/\n", b"@01 0 OK IDLE -- 0\r\n"),
        (b"/get pos\n", b"@01 0 OK IDLE -- 0\r\n"),
        (b"/1 1 get pos\r", b"@01 1 OK IDLE -- 0\r\n"),
        (b"/1 1 7 get pos\n", b"@01 1 07 OK IDLE -- 0\r\n"),
        (b"/01 1 get pos\n", b"@01 1 OK IDLE -- 0\r\n"),
        (b"/1 2 get pos\n", b"@01 2 RJ IDLE -- BADAXIS\r\n"),
        (b"/1 1 100 get pos\n", b"@01 1 100 RJ IDLE -- BADMESSAGEID\r\n"),
        (b"/1 1 get system.axiscount\n", b"@01 1 RJ IDLE -- DEVICEONLY\r\n"),
        (b"/1 get system.serial\n", b"@01 0 OK IDLE -- 68101\r\n"),
        (b"/1 get version\n", b"@01 0 OK IDLE -- 7.33\r\n"),
        (b"/1 get limit.cycle.dist\n", b"@01 0 OK IDLE -- 384000\r\n"),
        (b"/1 get\n", b"@01 0 RJ IDLE -- BADCOMMAND\r\n"),
        (b"/1 get peripheralid\n", b"@01 0 RJ IDLE -- BADCOMMAND\r\n"),
        (b"/1 set maxspeed 4000\n", b"@01 0 OK IDLE -- 0\r\n"),
        (b"/1 set maxspeed\n", b"@01 0 RJ IDLE -- BADCOMMAND\r\n"),
        (b"/1 set maxspeed fast\n", b"@01 0 RJ IDLE -- BADDATA\r\n"),
        (b"/1 set system.serial 5\n", b"@01 0 RJ IDLE -- BADCOMMAND\r\n"),
        (b"/1 1 set comm.alert 1\n", b"@01 1 RJ IDLE -- DEVICEONLY\r\n"),
        (b"/1 move abs 2000000000\n", b"@01 0 RJ IDLE -- BADDATA\r\n"),
        (b"/1 move abs\n", b"@01 0 RJ IDLE -- BADCOMMAND\r\n"),
        (b"/1 move abs here\n", b"@01 0 RJ IDLE -- BADDATA\r\n"),
        (b"/1 move abs 5 9999999\n", b"@01 0 RJ IDLE -- BADDATA\r\n"),
        (b"/1 move\n", b"@01 0 RJ IDLE -- BADCOMMAND\r\n"),
        (b"/1 move vel 0\n", b"@01 0 OK BUSY -- 0\r\n"),
        (b"/1 move max\n", b"@01 0 OK BUSY -- 0\r\n"),
        (b"/1 stop\n", b"@01 0 OK IDLE -- 0\r\n"),
        (b"/1 estop\n", b"@01 0 OK IDLE -- 0\r\n"),
        (b"/1 warnings\n", b"@01 0 OK IDLE -- 00\r\n"),
        (b"/1 warnings clear\n", b"@01 0 OK IDLE -- 00\r\n"),
        (b"/1 warnings away\n", b"@01 0 RJ IDLE -- BADCOMMAND\r\n"),
        (b"/1 driver disable\n", b"@01 0 OK IDLE FO 0\r\n"),
        (b"/1 driver\n", b"@01 0 RJ IDLE -- BADCOMMAND\r\n"),
        (b"/1 tools echo hello\n", b"@01 0 RJ IDLE -- BADCOMMAND\r\n"),
        (b"/1 system restore\n", b"@01 0 RJ IDLE -- BADCOMMAND\r\n"),
        (b"/1 system reset\n", b"@01 0 OK IDLE WR 0\r\n"),
        (b"/1 renumber 17\n", b"@01 0 OK IDLE -- 0\r\n"),
        (b"/1 renumber x\n", b"@01 0 RJ IDLE -- BADDATA\r\n"),
        (b"/1 1 renumber 5\n", b"@01 1 RJ IDLE -- DEVICEONLY\r\n"),
        (b"/2 get pos\n", b""),
        (b"/1 1 -- get pos\n", b""),
        (b"get pos\n", b""),
        (b"\r\n\r\n", b""),
    ],
)
def test_answers(command, answer):
    firmware = homed()
    firmware.axis.time_scale = 1.0
    assert ask(firmware, command) == answer


def test_numbers_and_checksums_are_answered_in_kind():
    firmware = instant()
    assert ask(firmware, b"/1 1 05:F9\n").count(b":") == 1
    assert ask(firmware, b"/1 1 05:f9\n") != b""
    assert ask(firmware, b"/1 1 05:FA\n") == b""  # a wrong checksum is ignored
    assert b":" not in ask(firmware, b"/1 1 05\n")
    ask(firmware, b"/1 set comm.checksum 1\n")
    assert b":" in ask(firmware, b"/1 1 05\n")


@pytest.mark.parametrize("body", [b"1 1 05", b"1 0 16 home", b"0 0 00", b""])
def test_a_checksum_makes_the_sum_zero(body):
    assert (sum(body) + lrc(body)) % 256 == 0
    assert Command.parse(b"/%s:%02X" % (body, lrc(body))) is not None
    assert frame("@", body.decode(), checked=True) == b"@%s:%02X\r\n" % (body, lrc(body))


def test_packets_joined_and_split():
    firmware = homed()
    assert ask(firmware, b"/1 ge") == b""
    assert ask(firmware, b"t pos\n/1 get accel\n/1") == b"@01 0 OK IDLE -- 0\r\n@01 0 OK IDLE -- 205\r\n"
    assert ask(firmware, b"\n") == b"@01 0 OK IDLE -- 0\r\n"


def test_noise_before_a_command_is_ignored():
    assert ask(homed(), b"\x00\xff?/get pos\n") == b"@01 0 OK IDLE -- 0\r\n"


def test_before_homing_the_count_is_from_power_up():
    firmware = ZaberFirmware(RotaryAxis(start_deg=37.0, time_scale=0.0))
    assert ask(firmware, b"/1 get pos\n") == b"@01 0 OK IDLE WR 0\r\n"
    assert ask(firmware, b"/1 warnings\n") == b"@01 0 OK IDLE WR 01 WR\r\n"
    assert ask(firmware, b"/1 move abs 100\n") == b"@01 0 RJ IDLE WR BADDATA\r\n"
    ask(firmware, b"/1 move rel 96000\n")
    assert firmware.axis.position() == pytest.approx(127.0)
    ask(firmware, b"/1 home\n")
    ask(firmware, b"/1 move abs 96000\n")
    assert firmware.axis.position() == 90.0
    ask(firmware, b"/1 system reset\n")
    assert ask(firmware, b"/1 get pos\n") == b"@01 0 OK IDLE WR 0\r\n"


def test_a_move_takes_the_time_that_speed_and_acceleration_need(clock):
    firmware = timed(clock)
    ask(firmware, b"/1 move abs 384000\n")
    duration_s = 360.0 / 115.0 + 115.0 / (205e4 / 1.6384 / X_RSW60A.counts_per_deg)
    clock.now += duration_s - 0.01
    assert ask(firmware, b"/1 1\n").startswith(b"@01 1 OK BUSY --")
    clock.now += 0.02
    assert ask(firmware, b"/1 get pos\n").endswith(b"@01 0 OK IDLE -- 384000\r\n")


def test_a_move_may_bring_its_own_speed(clock):
    firmware = timed(clock)
    ask(firmware, b"/1 move abs 384000 %d 0\n" % round(1.6384 * 38_400))
    clock.now += 9.9
    assert b"BUSY" in ask(firmware, b"/1\n")
    clock.now += 0.2
    assert b"IDLE" in ask(firmware, b"/1\n")


def test_turning_goes_on_until_stopped(clock):
    firmware = timed(clock)
    ask(firmware, b"/1 move vel %d\n" % round(-1.6384 * 38_400))
    clock.now += 20.0
    stopped = ask(firmware, b"/1 stop\n")
    assert stopped == b"!01 1 IDLE NI\r\n@01 0 OK IDLE NI 0\r\n"
    assert firmware.motor.counts == pytest.approx(-768_000, abs=3000)
    assert ask(firmware, b"/1 warnings clear\n") == b"@01 0 OK IDLE -- 01 NI\r\n"


def test_the_end_of_a_motion_is_announced_if_wanted(clock):
    firmware = timed(clock)
    ask(firmware, b"/1 move abs 1000\n")
    assert firmware.read() == b""
    clock.now += 10.0
    assert firmware.read() == b"!01 1 IDLE --\r\n"
    ask(firmware, b"/1 set comm.alert 0\n/1 move abs 0\n")
    clock.now += 10.0
    assert firmware.read() == b""


def test_a_new_motion_interrupts_the_old_one(clock):
    firmware = timed(clock)
    ask(firmware, b"/1 move abs 100000\n")
    clock.now += 0.1
    assert ask(firmware, b"/1 move abs 0\n") == b"@01 0 OK BUSY NI 0\r\n"


def test_a_stall_stands_until_it_is_acknowledged(clock):
    firmware = timed(clock, "stall:10")
    ask(firmware, b"/1 move abs 384000\n")
    clock.now += 5.0
    assert b"BUSY" in ask(firmware, b"/1\n")
    clock.now += 0.3
    assert ask(firmware, b"/1 get pos\n") == b"!01 1 IDLE FS\r\n@01 0 OK IDLE FS 10667\r\n"
    assert ask(firmware, b"/1 warnings clear\n") == b"@01 0 OK IDLE -- 01 FS\r\n"


def test_a_disabled_driver_rejects_motions_until_it_is_enabled():
    firmware = homed(faults=("latched-error:9",))
    assert not firmware.motor.referenced
    assert ask(firmware, b"/1 home\n") == b"@01 0 RJ IDLE FO DRIVERDISABLED\r\n"
    assert ask(firmware, b"/1 warnings clear\n") == b"@01 0 OK IDLE FO 02 FO WR\r\n"
    assert ask(firmware, b"/1 get driver.enabled\n") == b"@01 0 OK IDLE FO 0\r\n"
    assert ask(firmware, b"/1 driver enable\n") == b"@01 0 OK IDLE WR 0\r\n"
    assert ask(firmware, b"/1 home\n") == b"@01 0 OK BUSY WR 0\r\n"


def test_everybody_answers_in_the_order_of_the_line(clock):
    devices = [ZaberFirmware(RotaryAxis(clock=clock), address=9 - place, place=place) for place in range(3)]
    line = Bus(*devices)
    assert ask(line, b"/get deviceid\n") == b"@09 0 OK IDLE WR 59060\r\n"
    heard = b""
    for _ in range(4):
        clock.now += 0.005
        heard += line.read()
    assert heard == b"@08 0 OK IDLE WR 59060\r\n@07 0 OK IDLE WR 59060\r\n"
    assert ask(line, b"/8 get pos\n") == b"@08 0 OK IDLE WR 0\r\n"


def test_renumbering_follows_the_line():
    devices = [instant(address=address, place=place) for place, address in enumerate((5, 5, 1))]
    assert ask(Bus(*devices), b"/renumber\n").startswith(b"@05 0 OK")
    assert [device.address for device in devices] == [1, 2, 3]
    ask(Bus(*devices), b"/2 renumber 30\n")
    assert [device.address for device in devices] == [1, 30, 3]


def test_help_comes_as_information():
    lines = ask(homed(), b"/1 0 04 help\n").splitlines()
    assert lines[0] == b"@01 0 04 OK IDLE -- 0"
    assert b"#01 0 04 home" in lines[1:]


def test_another_model_has_another_scale():
    firmware = homed(model=X_RST120AK)
    ask(firmware, b"/1 move abs 576000\n")
    assert firmware.axis.position() == 90.0


@pytest.mark.parametrize("model", MODELS)
def test_every_model_can_be_built(model):
    turns = model not in LINEAR
    axes = [(RotaryAxis if turns else LinearAxis)(time_scale=0.0) for _ in range(2)]
    line = build(
        "zaber", [Mount(axes[0], "", model), Mount(axes[1], "7", model)], model=model if turns else ""
    )
    ask(line, b"/1 home\n/7 home\n")
    counts = MODELS[model].counts_per_turn or MODELS[model].limits[1]
    ask(line, b"/7 move abs %d\n" % counts)
    assert [axis.position() for axis in axes] == pytest.approx(
        [0.0, 360.0 if turns else MODELS[model].travel_mm]
    )


@pytest.mark.parametrize("address", ["0", "100", "A", "-1"])
def test_addresses_that_are_none(address):
    with pytest.raises(UsageError, match="not a Zaber address"):
        build("zaber", [Mount(RotaryAxis(), address)])


@pytest.mark.parametrize(
    "fault", ["latched-error:0", "latched-error:99", "motion-error:99", "motion-error:200"]
)
def test_codes_that_stand_for_nothing(fault):
    with pytest.raises(UsageError, match="choose"):
        instant(faults=(fault,))


def test_a_dead_line_works_again_after_connecting():
    firmware = instant(faults=("hangup",))
    with pytest.raises(ConnectionError):
        ask(firmware, b"/1 home\n")
    firmware.connect()
    assert ask(firmware, b"/1 home\n") == b"@01 0 OK BUSY WR 0\r\n"
