"""Somebody else's client (``thorlabs-apt-protocol``, MIT) talks to the simulated controllers on a pseudo terminal."""

import time

import pytest
import serial

from anisoscope.sim.bench.firmware.apt import MODELS, AptFirmware
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.serve import PtyServer

apt = pytest.importorskip("thorlabs_apt_protocol", reason="pip install thorlabs-apt-protocol (extra dev)")
UNIT = {"dest": 0x50, "source": 1}
CHANNEL = {**UNIT, "chan_ident": 1}


class Client:
    def __init__(self, port):
        self.serial = serial.Serial(port, 115200, rtscts=True, timeout=0.05)
        self.messages = apt.Unpacker(self.serial, on_error="raise")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.serial.close()

    def ask(self, command, expected):
        self.serial.write(command)
        end = time.monotonic() + 10.0
        while time.monotonic() < end:
            for message in self.messages:
                if message.msg == expected:
                    return message
        raise AssertionError(f"no {expected}")


@pytest.fixture(params=MODELS)
def firmware(request):
    return AptFirmware(RotaryAxis(time_scale=0.01, start_deg=12.0), model=MODELS[request.param])


def test_a_session_as_somebody_else_would_hold_it(firmware):
    model, servo = firmware.model, firmware.model.servo
    ask_status = apt.mot_req_dcstatusupdate if servo else apt.mot_req_statusupdate
    status = "mot_get_dcstatusupdate" if servo else "mot_get_statusupdate"
    with PtyServer(firmware) as server, Client(server.port) as client:
        client.serial.write(apt.hw_no_flash_programming(**UNIT))
        info = client.ask(apt.hw_req_info(**UNIT), "hw_get_info")
        assert (info.serial_number, info.nchs) == (model.serial, 1)
        assert info.model_number.startswith(
            model.name.encode() if isinstance(info.model_number, bytes) else model.name
        )
        client.serial.write(apt.mod_set_chanenablestate(**CHANNEL, enable_state=1))
        client.ask(apt.mot_move_home(**CHANNEL), "mot_move_homed")
        velocity = client.ask(apt.mot_req_velparams(**CHANNEL), "mot_get_velparams")
        assert velocity.max_velocity == round(model.velocity_deg_s * model.velocity_unit)
        target = round(33.0 * model.counts_per_deg)
        done = client.ask(apt.mot_move_absolute(**CHANNEL, position=target), "mot_move_completed")
        assert done.position == target
        at = client.ask(ask_status(**CHANNEL), status)
        assert (at.position, at.homed, at.moving_forward) == (target, True, False)
        assert client.ask(apt.mot_req_poscounter(**CHANNEL), "mot_get_poscounter").position == target
        client.ask(apt.mot_move_relative(**CHANNEL, distance=-target), "mot_move_completed")
        assert client.ask(apt.mot_move_stop(**CHANNEL, stop_mode=2), "mot_move_stopped").position == 0
        assert client.ask(apt.hw_start_updatemsgs(**UNIT), status).position == 0
        client.serial.write(apt.hw_stop_updatemsgs(**UNIT))
    assert firmware.axis.position() == pytest.approx(0.0, abs=1e-3)
