"""Who holds a port, as another process can see it."""

import json
import os
import signal
import socket
import subprocess
import sys
from types import SimpleNamespace

import pytest
from serial.tools import list_ports

from anisoscope.base.errors import NotConnected, RigError
from anisoscope.rig import portholder
from anisoscope.rig.portholder import (
    Holder,
    actual_port,
    claim,
    holder_of,
    is_abandoned,
    release,
    wait_until_released,
)
from anisoscope.rig.stages.elliptec import Elliptec
from anisoscope.rig.transport import Transport
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.elliptec import ElliptecFirmware
from anisoscope.sim.bench.serve import PtyServer, TcpServer

HOLD = """
import sys
from anisoscope.rig.stages.elliptec import Elliptec
from anisoscope.rig.transport import Transport
line = Transport(sys.argv[1])
print("open", flush=True)
try:
    sys.stdin.read()
except KeyboardInterrupt:
    line.close()
    sys.exit(7)
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Notes of these tests lie in a folder of their own."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / "anisoscope"


@pytest.fixture
def port():
    with PtyServer(ElliptecFirmware(RotaryAxis(time_scale=0.0))) as server:
        yield server.port


@pytest.fixture
def other(port):
    """Another process that has the port open."""
    command = [sys.executable, "-c", HOLD, port]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as process:
        assert process.stdout.readline() == "open\n"
        yield process
        process.kill()


def test_the_holder_is_found_named_and_interrupted(other, port):
    found = holder_of(port)
    assert (found.pid, found.interrupt_by) == (other.pid, "SIGINT")
    with pytest.raises(NotConnected, match=rf"in use by process {other.pid} .*rig stop"):
        Transport(port)
    assert not wait_until_released(port, 0.1)
    found.interrupt()
    assert other.wait(120) == 7
    assert wait_until_released(port, 0.0)
    Transport(port).close()


def test_a_tcp_port_that_another_process_holds_is_named_before_it_is_opened():
    """A second client of such a server is accepted, and never answered."""
    with TcpServer(ElliptecFirmware(RotaryAxis(time_scale=0.0))) as server:
        command = [sys.executable, "-c", HOLD, server.url]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        with subprocess.Popen(command, text=True, **pipes) as process:
            assert process.stdout.readline() == "open\n"
            with pytest.raises(NotConnected, match=rf"in use by process {process.pid} .*rig stop"):
                Transport(server.url)
            process.communicate()
        Transport(server.url).close()


def test_a_tcp_port_that_a_foreign_program_holds_is_silent_and_the_message_says_why():
    with TcpServer(ElliptecFirmware(RotaryAxis(time_scale=0.0))) as server:
        host, port = server.port.split(":")
        with (
            socket.create_connection((host, int(port))),
            pytest.raises(NotConnected, match=r"is silent; check .* close other programs connected to it"),
        ):
            Elliptec.open(server.url, timeout_s=0.2)


def test_one_port_has_one_holder_by_any_name(other, port, tmp_path):
    link = tmp_path / "by-id"
    link.symlink_to(port)
    assert holder_of(str(link)).pid == other.pid


def test_a_process_that_was_killed_holds_nothing(other, port, folder):
    os.kill(other.pid, signal.SIGKILL)
    os.waitid(os.P_PID, other.pid, os.WEXITED | os.WNOWAIT)  # it has ended, and nobody has waited for it
    assert list(folder.glob("*.json")), "the note is still there"
    assert holder_of(port) is None
    other.wait()
    assert holder_of(port) is None


def test_another_process_of_the_same_number_is_not_the_holder(other, port, folder):
    (note,) = folder.glob("*.json")
    found = json.loads(note.read_text())
    note.write_text(json.dumps(found | {"started": "1"}))
    assert holder_of(port) is None


def test_own_ports_and_simulated_ones_are_nobody_elses(port, folder):
    with Transport(port):
        assert holder_of(port) is None
        assert len(list(folder.glob("*.json"))) == 1
    assert list(folder.iterdir()) == []
    with Transport("sim://elliptec"):
        assert list(folder.iterdir()) == []


def test_a_note_of_another_process_is_left_alone(other, folder):
    (note,) = folder.glob("*.json")
    release(note)
    assert note.exists()


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"pid": "x"}', "\x00"])
def test_a_damaged_note_counts_for_nothing(port, folder, content):
    note = claim("/dev/x")
    note.write_text(content)
    assert holder_of("/dev/x") is None


def test_a_folder_that_others_can_write_to_is_not_used(folder):
    folder.mkdir()
    folder.chmod(0o777)
    assert claim("/dev/x") is None
    assert holder_of("/dev/x") is None


def test_a_folder_that_cannot_be_made_keeps_nobody_from_the_port(port, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/dev/null")
    with Transport(port) as line:
        assert line.is_open


@pytest.mark.parametrize(("system", "by"), [("nt", "SIGINT"), ("posix", "")])
def test_who_cannot_be_interrupted_from_here_is_named(monkeypatch, system, by):
    monkeypatch.setattr(portholder.os, "name", system)
    monkeypatch.setattr(portholder.os, "kill", lambda *_: pytest.fail("a signal was sent"))
    with pytest.raises(RigError, match=r"process 4711 .*press Ctrl-C in its window"):
        Holder(4711, "COM3", "anisoscope inspect", "1", by).interrupt()


def test_com_ports_have_no_upper_and_lower_case():
    note = claim("com3")
    assert claim("COM3") == note
    release(note)


def usb(device, vid=0x0403, pid=0x6015, serial_number="DK0A1B2C", location="1-1.4"):
    return SimpleNamespace(device=device, vid=vid, pid=pid, serial_number=serial_number, location=location)


@pytest.mark.parametrize("name", ["DK0A1B2C", "dk0a1b2c", "0403:6015", "0403:6015:DK0A1B2C", "1-1.4"])
def test_a_port_named_by_its_usb_device_is_found_under_any_number(monkeypatch, name):
    others = [usb("/dev/ttyUSB1", 0x1A86, 0x7523, None, "1-1.2"), usb("/dev/ttyS0", None, None, None, None)]
    for device in ("/dev/ttyUSB0", "/dev/ttyUSB7"):
        monkeypatch.setattr(list_ports, "comports", lambda device=device: [usb(device), *others])
        assert actual_port(f"usb:{name}") == device
    assert actual_port("COM3") == "COM3"
    with pytest.raises(NotConnected, match=r"there is no USB device 9999:0000 now; plug it in"):
        actual_port("usb:9999:0000")
    monkeypatch.setattr(list_ports, "comports", lambda: [usb("COM4"), usb("COM5")])
    with pytest.raises(NotConnected, match=r"fits COM4 and COM5; name one by its serial number or socket"):
        actual_port(f"usb:{name}")


def test_the_holder_of_a_port_is_found_by_its_usb_device(other, port, monkeypatch):
    monkeypatch.setattr(list_ports, "comports", lambda: [usb(port)])
    assert holder_of("usb:DK0A1B2C").pid == other.pid


def test_without_proc_a_killed_process_holds_nothing_either(other, port, folder, monkeypatch):
    """As on Windows and macOS: psutil says when a process was started, and that it has ended."""
    monkeypatch.setattr(portholder, "PROC", folder / "no such folder")
    (note,) = folder.glob("*.json")
    started = portholder._started(other.pid)
    assert started != ""
    note.write_text(json.dumps(json.loads(note.read_text()) | {"started": started}))
    assert holder_of(port).pid == other.pid
    other.kill()
    other.wait()
    assert holder_of(port) is None
    assert is_abandoned(port)
