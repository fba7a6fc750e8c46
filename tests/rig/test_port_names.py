"""Names of ports on Windows, macOS and Linux: from the rig file to pyserial as they are."""

import pytest

from anisoscope.base.errors import NotConnected
from anisoscope.rig.portholder import claim, release
from anisoscope.rig.rigfile import read_rig
from anisoscope.rig.transport import Transport

NAMES = [
    "COM3",
    r"\\.\COM10",
    "/dev/cu.usbserial-1",
    "/dev/ttyUSB0",
    "/dev/serial/by-id/usb-FTDI_FT230X_Basic_UART_DK0A1B2C-if00-port0",
    "socket://192.168.1.20:4001",
    "socket://[::1]:4001",
    "sim://elliptec?time_scale=0.1&fault=stall:30",
]
RIG = """
schema = 1
name = "rig"
[stage]
driver = "elliptec"
port = '{port}'
[tilt]
driver = "elliptec"
port = '{port}'
options = {{ address = "1" }}
[camera]
driver = "folder"
pixel_um = 4.0
[light]
driver = "serial"
options = {{ port = '{port}' }}
"""


@pytest.mark.parametrize("port", NAMES)
def test_the_rig_file_takes_the_name_as_it_is(tmp_path, port):
    path = tmp_path / "rig.toml"
    path.write_text(RIG.format(port=port), encoding="utf-8")
    file = read_rig(path)
    assert (file.stage.port, file.tilt.port, file.light.port) == (port, port, port)


@pytest.mark.parametrize("port", NAMES)
def test_pyserial_gets_the_name_as_it_is(monkeypatch, port):
    asked = []

    def refuse(url, **settings):
        asked.append((url, settings["exclusive"]))
        raise OSError(2, "no such port here")

    monkeypatch.setattr("serial.serial_for_url", refuse)
    with pytest.raises(NotConnected):
        Transport(port)
    assert asked == [(port, True)]


@pytest.mark.parametrize("port", NAMES)
def test_every_name_makes_a_file_name(monkeypatch, tmp_path, port):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    note = claim(port)
    assert (note is None) == port.startswith("sim://")
    release(note)
    assert list((tmp_path / "anisoscope").glob("*")) == []
