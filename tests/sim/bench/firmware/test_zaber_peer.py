"""The maker's own client, `zaber-motion`, drives the simulated stage as if it were one of his (without internet)."""

import contextlib
import threading

import pytest

from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.device import Bus
from anisoscope.sim.bench.firmware.zaber import X_RST120AK, X_RSW60A, ZaberFirmware
from anisoscope.sim.bench.serve import TcpServer

WHY = "the maker's client is not installed: pip install zaber-motion"
maker = pytest.importorskip("zaber_motion.ascii", reason=WHY)
failures = pytest.importorskip("zaber_motion.exceptions", reason=WHY)

QUARTER = X_RSW60A.counts_per_turn // 4


def stage(*faults, time_scale=0.0, **options):
    return ZaberFirmware(RotaryAxis(time_scale=time_scale), faults=faults, **options)


@pytest.fixture
def connect():
    """``connect(firmware)`` serves it on TCP and gives the client's connection; all is closed in the end."""
    with contextlib.ExitStack() as opened:

        def open_connection(firmware):
            server = opened.enter_context(TcpServer(firmware))
            host, port = server.port.split(":")
            return opened.enter_context(maker.Connection.open_tcp(host, int(port)))

        yield open_connection


@pytest.fixture
def axis_of(connect):
    """``axis_of(firmware)`` gives the client's axis of the only device."""
    return lambda firmware: connect(firmware).get_device(1).get_axis(1)


def test_it_finds_the_devices_of_a_line(connect):
    line = Bus(stage(address=1), stage(address=2, place=1, model=X_RST120AK))
    devices = connect(line).detect_devices(identify_devices=False)
    assert [device.device_address for device in devices] == [1, 2]
    assert [device.settings.get("deviceid") for device in devices] == [59060, 59120]
    assert [device.get_axis(1).settings.get("limit.cycle.dist") for device in devices] == [384_000, 2_304_000]


def test_it_renumbers_the_devices_of_a_line(connect):
    line = Bus(stage(address=7), stage(address=3, place=1))
    connection = connect(line)
    assert connection.renumber_devices(first_address=4) == 2
    assert [firmware.address for firmware in line.devices] == [4, 5]
    assert connection.get_device(5).settings.get("comm.address") == 5


def test_it_homes_and_moves(axis_of):
    firmware = stage(time_scale=0.05)
    axis = axis_of(firmware)
    assert not axis.is_homed()
    assert axis.settings.get("limit.home.triggered") == 0
    axis.home()
    assert axis.is_homed()
    assert axis.settings.get("limit.home.triggered") == 1
    axis.move_absolute(QUARTER)
    assert firmware.axis.position() == pytest.approx(90.0)
    axis.move_relative(-QUARTER / 2)
    assert axis.get_position() == QUARTER / 2
    assert firmware.axis.position() == pytest.approx(45.0)
    assert not axis.is_busy()


def test_it_moves_at_another_speed(axis_of):
    firmware = stage(time_scale=0.02)
    axis = axis_of(firmware)
    axis.home()
    axis.move_absolute(QUARTER, velocity=60_000, acceleration=50)
    assert firmware.axis.position() == pytest.approx(90.0)
    assert firmware.axis.velocity_deg_s == pytest.approx(60_000 / 1.6384 / X_RSW60A.counts_per_deg, rel=1e-4)


def test_it_turns_until_it_is_stopped(axis_of):
    firmware = stage()
    axis = axis_of(firmware)
    firmware.axis.time_scale = 1.0
    axis.move_velocity(40_000)
    assert axis.is_busy()
    axis.stop()
    assert not axis.is_busy()
    assert firmware.stops == 1
    assert not firmware.axis.busy()


def test_it_learns_that_a_move_was_interrupted(axis_of):
    firmware = stage()
    axis = axis_of(firmware)
    axis.home()
    firmware.axis.time_scale = 10.0
    # The client's own stop() would clear the flag before its waiting thread sees it.
    stopper = threading.Timer(0.2, axis.generic_command, args=("stop",))
    stopper.start()
    with pytest.raises(failures.MovementInterruptedException):
        axis.move_absolute(QUARTER)
    stopper.join()
    assert 0 < axis.get_position() < QUARTER


def test_it_sees_that_the_reference_is_missing(axis_of):
    axis = axis_of(stage())
    assert axis.warnings.get_flags() == {maker.WarningFlags.NO_REFERENCE_POSITION}
    with pytest.raises(failures.BadDataException):
        axis.move_absolute(1000)
    axis.home()
    assert axis.warnings.get_flags() == set()


def test_it_sees_a_stall(axis_of):
    firmware = stage("stall:45", time_scale=0.02)
    axis = axis_of(firmware)
    axis.home()
    with pytest.raises(failures.MovementFailedException, match="FS"):
        axis.move_absolute(QUARTER)
    assert axis.get_position() == pytest.approx(QUARTER / 2, abs=1)
    assert axis.warnings.get_flags() == set()  # the client has acknowledged it
    firmware.clear_faults()  # the obstacle is taken away
    axis.move_absolute(0)
    assert firmware.axis.position() == pytest.approx(0.0, abs=1e-3)


def test_it_sees_and_enables_a_disabled_driver(axis_of):
    axis = axis_of(stage("latched-error:9"))
    assert axis.warnings.get_flags() >= {maker.WarningFlags.DRIVER_DISABLED_NO_FAULT}
    with pytest.raises(failures.DriverDisabledException):
        axis.home()
    axis.driver_enable()
    axis.home()
    axis.driver_disable()
    assert axis.warnings.get_flags() == {maker.WarningFlags.DRIVER_DISABLED_NO_FAULT}


@pytest.mark.parametrize("faults", [("motion-error:2",), ("motion-error:3",), ("motion-error:11",)])
def test_it_sees_every_fault_flag_of_a_motion(axis_of, faults):
    axis = axis_of(stage(*faults))
    with pytest.raises(failures.MovementFailedException):
        axis.home()


@pytest.mark.parametrize(
    ("words", "error"),
    [
        ("tools findrange", failures.BadCommandException),
        ("move sideways 5", failures.BadCommandException),
        ("get no.such.setting", failures.BadCommandException),
        ("set limit.max 1e99", failures.BadDataException),
        ("set maxspeed 0", failures.BadDataException),
        ("move rel 2000000000", failures.BadDataException),
        ("get deviceid", failures.CommandFailedException),  # DEVICEONLY
    ],
)
def test_it_understands_every_rejection(axis_of, words, error):
    axis = axis_of(stage())
    with pytest.raises(error):
        axis.generic_command(words)


def test_it_reads_and_writes_settings(axis_of):
    axis = axis_of(stage())
    axis.settings.set("maxspeed", 50_000)
    assert axis.settings.get("maxspeed") == 50_000
    assert axis.settings.get("resolution") == 64


def test_it_hears_alerts(connect):
    connection = connect(stage())
    axis = connection.get_device(1).get_axis(1)
    heard = threading.Event()
    alerts = []

    def hear(alert):
        alerts.append((alert.device_address, alert.axis_number, alert.status))
        heard.set()

    subscription = connection.alert.subscribe(hear)
    connection.enable_alerts()
    axis.home()
    assert heard.wait(60.0)
    subscription.dispose()
    assert alerts[0] == (1, 1, "IDLE")


def test_it_speaks_without_checksums(connect):
    firmware = stage()
    connection = connect(firmware)
    connection.checksum_enabled = False
    connection.get_device(1).get_axis(1).home()
    assert firmware.commands
    assert not any(b":" in command for command in firmware.commands)


def test_it_skips_information_lines(connect):
    replies = connect(stage()).generic_command_multi_response("help", device=1)
    assert len(replies) > 1
    assert {"home", "move", "warnings"} <= {reply.data for reply in replies[1:]}


@pytest.mark.parametrize("fault", ["split", "unsolicited", "joined"])
def test_it_copes_with_what_a_line_does(axis_of, fault):
    axis = axis_of(stage(fault))
    axis.home()
    axis.move_absolute(QUARTER)
    assert axis.get_position() == QUARTER


def test_it_notices_a_silent_device(axis_of):
    axis = axis_of(stage("silent"))
    with pytest.raises(failures.RequestTimeoutException):
        axis.get_position()


def test_it_notices_a_dead_line(axis_of):
    axis = axis_of(stage("hangup"))
    with pytest.raises((failures.RequestTimeoutException, failures.ConnectionClosedException)):
        axis.home()
    with pytest.raises(failures.ConnectionClosedException):
        axis.get_position()
