"""The driver of SMC100 and CONEX controllers: states, references that survive, several on a line."""

import pytest

from anisoscope.base.errors import LimitExceeded, NotConnected, NotHomed, ProtocolError, RigError, Stalled
from anisoscope.rig.stages.smc100 import Answer, Smc100, State, error_of_letter
from anisoscope.rig.transport import Transport, shared_ports
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.device import Bus
from anisoscope.sim.bench.firmware.smc100 import AG_PR100P, URS75PP, Smc100Firmware

HURRY = {"timeout_s": 0.15, "margin_s": 0.15, "velocity_deg_s": 4000.0}


def controller(*faults, time_scale=0.0, **options):
    return Smc100Firmware(RotaryAxis(time_scale=time_scale), faults=faults, **options)


def test_scale_speed_and_limits_come_from_the_controller(in_process):
    with Smc100.open(in_process(controller(model=AG_PR100P)), timeout_s=0.15) as stage:
        assert stage.name == "AG-PR100P, address 1"
        assert stage.resolution_deg == 0.0005
        assert stage.limits_deg == (0.0, 340.0)
        assert stage.rules.velocity_deg_s == 2.0
        assert stage.rules.acceleration_deg_s2 == 8.0


def test_the_port_is_set_as_the_manual_asks(monkeypatch):
    asked = []

    def refuse(port, **settings):
        asked.append(settings)
        raise OSError("not today")

    monkeypatch.setattr("serial.serial_for_url", refuse)
    for options in ({}, {"baudrate": 921600, "xonxoff": False}):
        with pytest.raises(NotConnected):
            Smc100.open("COM3", **options)
    # 8 bits, no parity and 1 stop bit are what pyserial takes where nothing else is said
    assert [(one["baudrate"], one["xonxoff"], one["rtscts"]) for one in asked] == [
        (57600, True, False),
        (921600, False, False),
    ]
    assert not any({"bytesize", "parity", "stopbits"} & one.keys() for one in asked)


def test_two_stages_on_a_line(in_process):
    first, second = controller(address=1), controller(address=12)
    port = in_process(Bus(first, second))
    with Transport(port) as line:
        stages = [Smc100(line, address=address, **HURRY) for address in (1, "12")]
        for stage, angle in zip(stages, (10.0, 20.0), strict=True):
            stage.home()
            stage.move_to(angle)
        stages[0].close()
        assert stages[1].position_deg() == pytest.approx(20.0)
    with shared_ports(), Smc100.open(port, **HURRY) as one, Smc100.open(port, address=12, **HURRY) as other:
        assert one.position_deg() == pytest.approx(10.0)
        assert other.move_by(1.0) == pytest.approx(21.0)


def test_the_reference_survives_a_new_connection(in_process):
    firmware = controller()
    port = in_process(firmware)
    with Smc100.open(port, **HURRY) as stage:
        stage.home()
    with Smc100.open(port, **HURRY) as stage:
        assert stage.is_homed
        assert stage.move_to(5.0) == pytest.approx(5.0)


def test_a_second_search_restarts_the_controller(in_process):
    firmware = controller(time_scale=0.02)
    with Smc100.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        stage.move_to(30.0)
        assert stage.home() == pytest.approx(0.0)
        assert firmware.commands.count(b"RS") == 1
        assert firmware.axis.position() == pytest.approx(0.0, abs=0.001)


def test_a_controller_that_does_not_come_back(in_process):
    firmware = controller()
    with Smc100.open(in_process(firmware), restart_s=0.2, **HURRY) as stage:
        stage.home()
        firmware._restart = lambda: setattr(firmware, "_restarted_at", 1e99)
        with pytest.raises(NotConnected, match="restart"):
            stage.home()


def test_a_disabled_motor_is_enabled_once(in_process):
    firmware = controller()
    with Smc100.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        firmware.write(b"1MM0\r\n")
        assert stage.move_to(10.0) == pytest.approx(10.0)
        assert firmware.commands.count(b"MM1") == 1


def test_after_an_obstacle_the_reference_is_kept_because_there_is_an_encoder(in_process):
    firmware = controller("stall:45")
    with Smc100.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        with pytest.raises(Stalled, match="following error"):
            stage.move_to(90.0)
        firmware.clear_faults()
        assert stage.is_homed
        assert stage.move_to(90.0) == pytest.approx(90.0)


def test_a_blocked_search(in_process):
    firmware = Smc100Firmware(RotaryAxis(start_deg=90.0, time_scale=0.0), faults=("stall:45",))
    with Smc100.open(in_process(firmware), **HURRY) as stage:
        with pytest.raises(Stalled, match="took too long"):
            stage.home()
        assert not stage.is_homed


def test_a_controller_being_configured_is_left_alone(in_process):
    firmware = controller()
    port = in_process(firmware)
    firmware.write(b"1PW1\r\n")
    with Smc100.open(port, **HURRY) as stage, pytest.raises(RigError, match="PW0"):
        stage.home()
    assert b"PW0" not in firmware.commands
    assert firmware.axis.position() == 0.0


def test_a_stopped_move_keeps_the_reference(in_process, when_it_turns):
    firmware = controller(time_scale=1.0)
    with Smc100.open(in_process(firmware), timeout_s=0.15) as stage:
        stage.home()
        stopper = when_it_turns(firmware, stage.stop)
        with pytest.raises(RigError, match="was stopped at"):
            stage.move_to(300.0)
        stopper.join()
        assert 0.0 < stage.position_deg() < 300.0
        assert stage.is_homed


def test_limits_changed_in_the_controller_meanwhile_are_told(in_process):
    firmware = controller()
    with Smc100.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        firmware.write(b"1SR50\r\n")
        with pytest.raises(LimitExceeded, match="TE G"):
            stage.move_to(90.0)


def test_a_stepper_tells_its_resolution_by_its_microsteps(in_process):
    firmware = Smc100Firmware(RotaryAxis(time_scale=0.0), model=URS75PP)
    with Smc100.open(in_process(firmware), **HURRY) as stage:
        assert stage.resolution_deg == pytest.approx(0.0002)
        stage.home()
        assert stage.move_to(12.3456) == pytest.approx(12.3456, abs=1e-6)


def test_a_controller_that_does_not_tell_its_resolution(in_process):
    firmware = controller()
    port = in_process(firmware)
    del firmware.parameters["SU"]
    with pytest.raises(ProtocolError, match="resolution_deg"):
        Smc100.open(port, **HURRY)
    with Smc100.open(port, resolution_deg=0.01, **HURRY) as stage:
        stage.home()
        assert stage.move_to(1.234) == pytest.approx(1.23)


@pytest.mark.parametrize("address", [0, 32, "x", "1.5", ""])
def test_addresses(in_process, address):
    with pytest.raises(RigError, match="1…31"):
        Smc100.open(in_process(controller()), address=address)


def test_power_lost_between_moves(in_process):
    firmware = controller()
    with Smc100.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        firmware._power_up()
        with pytest.raises(NotHomed, match="home it again"):
            stage.move_to(10.0)
        assert not stage.is_homed


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        (b"1TS000033\r\n", Answer(1, "TS", "000033")),
        (b"\x00\xb512TP-1.5\r\n", Answer(12, "TP", "-1.5")),
        (b"1VE SMC_CC version 1.0\r\n", Answer(1, "VE", "SMC_CC version 1.0")),
        (b"1TE@\r\n", Answer(1, "TE", "@")),
    ],
)
def test_answers(line, answer):
    assert Answer.parse(line) == answer


@pytest.mark.parametrize(
    "line", [b"", b"\r\n", b"TS000033\r\n", b"1ts000033\r\n", b"123TS00\r\n", b"\xff\xfe\r\n"]
)
def test_damaged_lines_are_no_answers(line):
    assert Answer.parse(line) is None


def test_states():
    assert State.parse("00203D") == State(0x20, 0x3D)
    assert "following error" in State.parse("00203D").faults_text
    assert State.parse("00203") is None
    assert State.parse("00203G") is None


def test_every_letter_is_an_error_of_one_line():
    for letter in "ABCDEFGHIJKLMNOPQRSTUVWXYZ":
        error = error_of_letter("stage", letter, "moving")
        assert isinstance(error, RigError)
        assert "\n" not in str(error)
