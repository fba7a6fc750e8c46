"""The driver of the light against its firmware: in this process, on a pseudo terminal, on TCP."""

import contextlib
import threading
import time
from types import SimpleNamespace

import pytest
from serial.urlhandler import protocol_socket

from anisoscope.base.clock import SYSTEM, VirtualClock
from anisoscope.base.errors import NotConnected, ProtocolError, RigError
from anisoscope.rig.drivers import open_light
from anisoscope.rig.light import Light
from anisoscope.rig.lights.serial import LightStatus, SerialLight
from anisoscope.sim.bench.firmware.faults import FaultKind
from anisoscope.sim.bench.firmware.light import LightFirmware
from anisoscope.sim.bench.serialports import protocol_sim
from anisoscope.sim.bench.serve import PtyServer, TcpServer

HURRY = {"timeout_s": 0.3, "boot_s": 0.0, "settle_s": 0.1}
PATIENT = HURRY | {"timeout_s": 20.0}
"""Where the answer comes at once: a busy computer may take its time."""
BABBLED = HURRY | {"timeout_s": 1.0}
"""Where three tries wait to the end, and each must hear something."""
FAULTS = {
    "silent": (NotConnected, "silent"),
    "silent:4": (NotConnected, "silent"),
    "babble": (ProtocolError, "port and baud rate"),
    "garbage": None,
    "split": None,
    "unsolicited": None,
    "joined": None,
    "motion-error": (RigError, "refuses: 13"),
    "hangup": (NotConnected, "lost"),
    "stall:45": (RigError, "45 % are measured at the lamp instead of 100 %"),
    "lost-homing": (RigError, "switched on, but says that it is off"),
    "lost-reply": (NotConnected, "silent"),
}

SILENT = {fault for fault, end in FAULTS.items() if end is not None and end[1] == "silent"}


@pytest.fixture
def in_process(monkeypatch):
    def serve(firmware):
        monkeypatch.setattr(protocol_sim, "device_of_url", lambda _: firmware)
        return "sim://light"

    return serve


@pytest.fixture(params=["sim", "pty", "tcp"])
def served(request, in_process, monkeypatch):
    # pyserial waits 0.3 s whenever it closes a socket, for servers that need a rest before the next client; ours do not
    monkeypatch.setattr(protocol_socket, "time", SimpleNamespace(sleep=lambda _: None, time=time.time))
    with contextlib.ExitStack() as servers:

        def serve(firmware):
            if request.param == "sim":
                return in_process(firmware)
            server = PtyServer(firmware) if request.param == "pty" else TcpServer(firmware)
            return servers.enter_context(server).url

        yield serve


def test_a_day_in_the_life(served):
    firmware = LightFirmware(faults=("split", "garbage"))
    light = open_light("serial", port=served(firmware), level_percent=60, **PATIENT)
    assert isinstance(light, Light)
    assert light.name == "light ANISOLIGHT 1 L0001"
    assert firmware.lamp.level == 0.0
    light.on()
    assert firmware.lamp.level == pytest.approx(0.6)
    assert light.status() == LightStatus(on=True, level_percent=60, sensed_percent=60, watchdog_s=10)
    light.off()
    assert firmware.lamp.level == 0.0
    light.on()
    light.close()
    light.close()
    assert firmware.lamp.level == 0.0
    with pytest.raises(NotConnected):
        light.on()


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_ends_in_its_error(request, served, fault):
    line = request.node.callspec.params["served"]
    firmware = LightFirmware(faults=(fault,), clock=VirtualClock() if line == "sim" else SYSTEM)
    port = served(firmware)
    with contextlib.ExitStack() as stack:
        if FAULTS[fault] is not None:
            error, message = FAULTS[fault]
            stack.enter_context(pytest.raises(error, match=message))
        light = SerialLight(port, **(BABBLED if fault == "babble" else HURRY if fault in SILENT else PATIENT))
        stack.callback(light.close)
        light.on()
        assert firmware.lamp.level == 1.0
    assert firmware.lamp.level == 0.0 or fault == "hangup"
    assert not any(thread.name.startswith("keep ") for thread in threading.enumerate())


def test_every_fault_that_a_light_can_have_is_in_the_table():
    possible = set(FaultKind) - LightFirmware.IMPOSSIBLE
    assert {fault.partition(":")[0] for fault in FAULTS} == {str(kind) for kind in possible}


def test_a_light_that_is_on_stays_on_because_the_driver_keeps_talking(in_process):
    firmware = LightFirmware()
    light = SerialLight(in_process(firmware), watchdog_s=1, **HURRY)
    light.on()
    time.sleep(1.4)
    firmware.attend()
    assert firmware.lamp.level == 1.0
    light.off()
    light.close()


def test_a_light_whose_program_died_goes_off():
    now = [0.0]
    firmware = LightFirmware(clock=lambda: now[0])
    firmware.write(b"ON\n")
    now[0] += 10.5
    firmware.attend()
    assert firmware.lamp.level == 0.0
    assert firmware.read().endswith(b"! WATCHDOG\r\n")


def test_a_light_that_went_out_by_itself_is_told_when_it_is_switched_off(in_process):
    firmware = LightFirmware()
    light = SerialLight(in_process(firmware), watchdog_s=1, **HURRY)
    light.on()
    firmware._power_up()  # its supply failed for a moment
    end = time.monotonic() + 60.0
    while not light._went_out and time.monotonic() < end:
        time.sleep(0.02)
    with pytest.raises(RigError, match="went out by itself; frames taken since may be dark"):
        light.off()
    light.on()
    light.off()
    light.close()


def test_a_lamp_that_still_shines_is_not_off(in_process):
    firmware = LightFirmware()
    light = SerialLight(in_process(firmware), **HURRY)
    light.on()

    class Stuck:
        attend = staticmethod(lambda: None)
        level = property(lambda _: 1.0, lambda _, __: None)

    firmware.lamp = Stuck()
    with pytest.raises(RigError, match="switched off, but 100 % are measured"):
        light.off()
    light.close()


def test_a_board_that_takes_time_to_start_is_waited_for(in_process):
    class Booting(LightFirmware):
        asleep = 2

        def _send(self, frame):
            if b"ID" in frame and self.asleep:
                self.asleep -= 1
                return
            if b"READY" not in frame:
                super()._send(frame)

    light = SerialLight(in_process(Booting()), timeout_s=0.1, boot_s=5.0)
    light.on()
    light.close()


@pytest.mark.parametrize("options", [{"level_percent": 0}, {"level_percent": 101}, {"watchdog_s": 0}])
def test_options_out_of_range(in_process, options):
    with pytest.raises(RigError, match=next(iter(options))):
        SerialLight(in_process(LightFirmware()), **options)


@pytest.mark.parametrize("text", ["STATUS", "STATUS ON 1 2", "STATUS on 1 2 3", "STATUS ON 1 x 3"])
def test_a_strange_status_is_a_protocol_error(text):
    with pytest.raises(ProtocolError, match="its firmware"):
        LightStatus.parse(text)


def test_a_board_without_sensor_measures_nothing():
    assert LightStatus.parse("STATUS OFF 70 - 10").sensed_percent is None
