"""The driver against the firmware: in this process, on a pseudo terminal, on TCP."""

import threading
import time

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from anisoscope.errors import (
    LimitExceeded,
    MotionTimeout,
    NotConnected,
    NotHomed,
    ProtocolError,
    RigError,
    Stalled,
)
from anisoscope.rig.stage import RotationStage
from anisoscope.rig.stages.elliptec import Elliptec
from anisoscope.rig.stages.elliptec_wire import (
    Answer,
    DeviceInfo,
    counts_from_hex,
    counts_to_hex,
    error_of_status,
)
from anisoscope.rig.transport import Transport
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.elliptec import ELL8, ElliptecBus, ElliptecFirmware, ElliptecModel
from anisoscope.sim.bench.serialports import protocol_sim
from anisoscope.sim.bench.serve import PtyServer, TcpServer

HURRY = {"timeout_s": 0.15, "move_gap_s": 0.0, "margin_s": 0.15, "velocity_deg_s": 4000.0}
COUNT_DEG = 360 / 143360


@pytest.fixture
def in_process(monkeypatch):
    """Serve firmware of the test's choice behind sim:// in this process."""

    def serve(firmware):
        monkeypatch.setattr(protocol_sim, "device_of_url", lambda _: firmware)
        return "sim://elliptec"

    return serve


@pytest.fixture(params=["sim", "pty", "tcp"])
def served(request, in_process):
    """The same over every line; gives (function that starts to serve and returns the port)."""
    servers = []

    def serve(firmware):
        if request.param == "sim":
            return in_process(firmware)
        server = PtyServer(firmware) if request.param == "pty" else TcpServer(firmware)
        servers.append(server.__enter__())
        return server.url

    yield serve
    for server in servers:
        server.__exit__(None, None, None)


def firmware_with(*faults, time_scale=0.0, **options):
    return ElliptecFirmware(RotaryAxis(time_scale=time_scale), faults=faults, **options)


def test_a_day_in_the_life(served):
    firmware = firmware_with("split", "unsolicited", "garbage", address="2")
    with Elliptec.open(served(firmware), address="2", **HURRY) as stage:
        assert isinstance(stage, RotationStage)
        assert stage.name == "ELL14 11400517"
        assert stage.limits_deg == (0.0, 360.0)
        assert not stage.is_homed
        assert stage.home() == 0.0
        assert stage.move_to(90.0) == 90.0
        assert stage.move_by(-30.0) == pytest.approx(60.0, abs=COUNT_DEG / 2)
        assert stage.position_deg() == pytest.approx(firmware.axis.position(), abs=COUNT_DEG)
    assert not stage.is_homed


def test_clients_come_and_go(served):
    port = served(firmware_with())
    for _ in range(2):
        with Elliptec.open(port, **HURRY) as stage:
            assert stage.home() == 0.0


@pytest.mark.parametrize("angle", [10.0, 0.001, 359.9999, 123.4567])
def test_angles_are_rounded_to_counts(in_process, angle):
    with Elliptec.open(in_process(firmware_with()), **HURRY) as stage:
        stage.home()
        assert stage.move_to(angle) == pytest.approx(angle, abs=COUNT_DEG / 2)


def test_the_scale_comes_from_the_device(in_process):
    firmware = firmware_with(model=ELL8)
    with Elliptec.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        stage.move_to(90.0)
        assert firmware.counts == 65536
        assert stage.resolution_deg == 360 / 262144


@pytest.mark.parametrize("angle", [-0.1, 360.1, float("nan"), float("inf")])
def test_limits_are_checked_before_anything_is_sent(in_process, angle):
    firmware = firmware_with()
    with Elliptec.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        sent = len(firmware.commands)
        with pytest.raises(LimitExceeded):
            stage.move_to(angle)
        assert len(firmware.commands) == sent


def test_own_limits(in_process):
    with Elliptec.open(in_process(firmware_with()), min_deg=5.0, max_deg=20.0, **HURRY) as stage:
        stage.home()
        with pytest.raises(LimitExceeded, match="5°…20°"):
            stage.move_to(21.0)


def test_no_absolute_move_before_homing(in_process):
    firmware = firmware_with()
    with Elliptec.open(in_process(firmware), **HURRY) as stage:
        with pytest.raises(NotHomed):
            stage.move_to(10.0)
        with pytest.raises(NotHomed):
            stage.move_by(10.0)
    assert not any(command.startswith(b"m") for command in firmware.commands)


def test_settings(in_process):
    with Elliptec.open(in_process(firmware_with()), **HURRY) as stage:
        stage.set_velocity_percent(50)
        assert stage.velocity_percent() == 50
        stage.set_home_offset(4.0)
        assert stage.home_offset_deg() == pytest.approx(4.0, abs=COUNT_DEG)
        with pytest.raises(RigError):
            stage.set_velocity_percent(0)
        with pytest.raises(LimitExceeded):
            stage.set_home_offset(400.0)
        assert stage.status() == 4
        assert stage.status() == 0


@pytest.mark.parametrize(
    ("fault", "error", "pattern"),
    [
        ("silent", NotConnected, "silent"),
        ("silent:6", NotConnected, "silent"),
        ("babble", ProtocolError, "port and baud rate"),
        ("wrong-address", NotConnected, "address 1 answers"),
        ("hangup", NotConnected, "lost"),
        ("hangup:1", NotConnected, "lost"),
        ("stall", Stalled, "mechanical"),
        ("motion-error:2", Stalled, "mechanical"),
        ("motion-error:13", Stalled, "over-current"),
        ("motion-error:12", LimitExceeded, "out of range"),
        ("motion-error:3", ProtocolError, "command error"),
        ("motion-error:7", RigError, "initialising"),
        ("busy:100000", MotionTimeout, "home did not end"),
        ("slow:100000", MotionTimeout, "move to 90° did not end"),
        ("overshoot:200", MotionTimeout, "ended at 90.5"),
        ("lost-homing", NotHomed, "home it again"),
    ],
)
def test_a_fault_ends_in_its_error_within_its_time(served, fault, error, pattern):
    threads = threading.active_count()
    firmware = firmware_with(fault, time_scale=0.02)
    port = served(firmware)
    server_threads = threading.active_count() - threads
    start = time.monotonic()
    with pytest.raises(error, match=pattern) as caught, Elliptec.open(port, **HURRY) as stage:
        stage.home()
        stage.move_to(90.0)
        stage.move_to(100.0)
    assert "\n" not in str(caught.value)
    assert time.monotonic() - start < 4.0
    if error in {MotionTimeout, Stalled}:
        assert firmware.commands[-1] == b"st"
    assert threading.active_count() == threads + server_threads


@pytest.mark.parametrize("fault", ["silent", "babble", "stall", "busy:100000", "hangup"])
def test_after_a_fault_the_next_connection_works(in_process, fault):
    firmware = firmware_with(fault)
    port = in_process(firmware)
    with pytest.raises(RigError), Elliptec.open(port, **HURRY) as stage:
        stage.home()
        stage.move_to(90.0)
    firmware.clear_faults()
    with Elliptec.open(port, **HURRY) as stage:
        stage.home()
        assert stage.move_to(90.0) == 90.0


@pytest.mark.parametrize(
    "fault", ["latched-error:8", "busy:2", "lost-reply", "overshoot:2", "unsolicited", "garbage"]
)
def test_what_the_driver_copes_with(in_process, fault):
    with Elliptec.open(in_process(firmware_with(fault)), **HURRY) as stage:
        stage.home()
        assert stage.move_to(90.0) == pytest.approx(90.0, abs=stage.rules.tolerance_deg)


def test_stop_from_another_thread_ends_the_move(served):
    firmware = firmware_with(time_scale=20.0)
    with Elliptec.open(served(firmware), **(HURRY | {"margin_s": 5.0})) as stage:
        stage.home()
        stopper = threading.Timer(0.2, stage.stop)
        stopper.start()
        start = time.monotonic()
        with pytest.raises(RigError, match="was stopped at"):
            stage.move_to(180.0)
        stopper.join()
        assert time.monotonic() - start < 2.0
        assert 0.0 < stage.position_deg() < 180.0
        assert not firmware.axis.busy()


def test_a_second_move_at_the_same_time_is_refused(in_process):
    with Elliptec.open(in_process(firmware_with(time_scale=5.0)), **(HURRY | {"margin_s": 5.0})) as stage:
        stage.home()
        mover = threading.Thread(target=stage.move_to, args=(20.0,))
        mover.start()
        time.sleep(0.1)
        with pytest.raises(RigError, match="moving already"):
            stage.move_to(30.0)
        mover.join()
        assert stage.position_deg() == pytest.approx(20.0, abs=COUNT_DEG)


def test_an_interrupt_stops_the_stage(in_process, monkeypatch):
    firmware = firmware_with(time_scale=20.0)
    with Elliptec.open(in_process(firmware), **HURRY) as stage:
        stage.home()

        def interrupt(_wait_s):
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(stage, "_is_busy", interrupt)
            with pytest.raises(KeyboardInterrupt):
                stage.move_to(180.0)
        assert firmware.commands[-1] == b"st"
        assert not firmware.axis.busy()


def test_stop_at_rest_and_closing_twice_are_harmless(in_process):
    stage = Elliptec.open(in_process(firmware_with()), **HURRY)
    stage.stop()
    assert stage.home() == 0.0
    stage.close()
    stage.close()
    with pytest.raises(NotConnected):
        stage.position_deg()


def test_the_pause_between_moves_is_kept(in_process):
    with Elliptec.open(in_process(firmware_with()), **(HURRY | {"move_gap_s": 0.1})) as stage:
        stage.home()
        start = time.monotonic()
        stage.move_to(10.0)
        assert time.monotonic() - start >= 0.09


def test_two_stages_share_a_line(in_process):
    first, second = firmware_with(address="0"), firmware_with(address="B")
    with Transport(in_process(ElliptecBus(first, second))) as line:
        stages = [Elliptec(line, address=address, **HURRY) for address in "0B"]
        for stage, angle in zip(stages, (10.0, 20.0), strict=True):
            stage.home()
            stage.move_to(angle)
        stages[0].close()
        assert stages[1].position_deg() == pytest.approx(20.0, abs=COUNT_DEG)


def test_what_is_no_rotation_stage(in_process):
    with pytest.raises(ProtocolError, match="ELL20 is not a rotation stage"):
        Elliptec.open(in_process(firmware_with(model=ElliptecModel(number=20))), **HURRY)
    with pytest.raises(ProtocolError, match="0 counts"):
        Elliptec.open(in_process(firmware_with(model=ElliptecModel(pulses=0, number=14))), **HURRY)
    with pytest.raises(RigError, match="not an Elliptec address"):
        Elliptec.open(in_process(firmware_with()), address="Z")


def test_real_information():
    info = DeviceInfo.parse(Answer.parse(b"2IN0E1140051720231701016800023000\r\n").data)
    assert (info.model, info.serial, info.year, info.travel_deg) == (14, "11400517", "2023", 360)
    assert info.pulses == 143360


@pytest.mark.parametrize("line", [b"\r\n", b"0PO123\r\n", b"PO00000000\r\n", b"0XX00\r\n", b"\xff\xfe\r\n"])
def test_damaged_lines_are_no_answers(line):
    assert Answer.parse(line) is None


@pytest.mark.parametrize("counts", [0, -1, 143360, -(1 << 31), (1 << 31) - 1])
def test_positions_are_signed(counts):
    assert counts_from_hex(counts_to_hex(counts)) == counts


def test_positions_beyond_32_bits_are_refused():
    with pytest.raises(LimitExceeded):
        counts_to_hex(1 << 31)


def test_every_status_is_an_error_of_one_line():
    for status in range(1, 256):
        error = error_of_status("stage", status, "moving")
        assert isinstance(error, RigError)
        assert "\n" not in str(error)


class DriverAgainstFirmware(RuleBasedStateMachine):
    """Whatever is done, driver and device agree, and the error of position is at most half a count."""

    @initialize(fault=st.sampled_from([(), ("split",), ("unsolicited",), ("garbage",)]))
    def connect(self, fault):
        self.firmware = firmware_with(*fault)
        self.original, protocol_sim.device_of_url = protocol_sim.device_of_url, lambda _: self.firmware
        self.stage = Elliptec.open("sim://elliptec", **HURRY)
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
        self.stage = Elliptec.open("sim://elliptec", **HURRY)
        assert not self.stage.is_homed
        self.expected = None

    @rule()
    def stop(self):
        self.stage.stop()

    def attempt(self, target, move):
        if not self.stage.is_homed:
            with pytest.raises(NotHomed):
                move()
        elif not -COUNT_DEG / 2 <= target <= 360.0 + COUNT_DEG / 2:
            with pytest.raises(LimitExceeded):
                move()
        else:
            move()
            self.expected = target

    @invariant()
    def agrees(self):
        if getattr(self, "expected", None) is not None:
            assert abs(self.firmware.axis.position() - self.expected) <= COUNT_DEG / 2 + 1e-9
            assert abs(self.stage.position_deg() - self.expected) <= COUNT_DEG / 2 + 1e-9

    def teardown(self):
        if hasattr(self, "stage"):
            self.stage.close()
            protocol_sim.device_of_url = self.original


TestDriverAgainstFirmware = DriverAgainstFirmware.TestCase
TestDriverAgainstFirmware.settings = settings(max_examples=15, stateful_step_count=12, deadline=None)
