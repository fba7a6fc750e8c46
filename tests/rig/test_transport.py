"""Ports that answer, that are silent, that vanish, that are not there."""

import gc
import socket
import termios
import threading
import time
from pathlib import Path

import pytest

from anisoscope.base.errors import NotConnected
from anisoscope.rig import transport as module
from anisoscope.rig.transport import Transport, available_ports, register_handlers
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.elliptec import ElliptecFirmware
from anisoscope.sim.bench.serve import PtyServer, TcpServer


def firmware():
    return ElliptecFirmware(RotaryAxis(time_scale=0.0))


def test_question_and_answer():
    with Transport("sim://elliptec?time_scale=0") as line:
        line.write(b"0gs0gp")
        assert line.read_until(b"\r\n", 30.0) == b"0GS00\r\n"
        assert line.read_exactly(3, 30.0) == b"0PO"
        assert line.discard() == b"00000000\r\n"
        assert line.discard() == b""


@pytest.mark.parametrize(
    "read", [lambda line: line.read_until(b"!", 0.1), lambda line: line.read_exactly(99, 0.1)]
)
def test_a_deadline_is_kept_and_nothing_is_lost(read):
    """Without one it would wait for ever."""
    with Transport("sim://elliptec?time_scale=0") as line:
        line.write(b"0gs")
        start = time.monotonic()
        assert read(line) is None
        assert time.monotonic() - start > 0.09
        assert line.pending == b"0GS00\r\n"


def test_endless_noise_does_not_fill_the_memory(monkeypatch):
    monkeypatch.setattr(module, "MAX_BACKLOG", 100)
    with Transport("sim://elliptec?time_scale=0") as line:
        line.write(b"0in" * 20)
        assert line.read_until(b"!", 0.1) is None
        assert len(line.pending) <= 133


@pytest.mark.parametrize(
    ("port", "pattern"),
    [
        ("/dev/ttyNOTHERE", "there is no port /dev/ttyNOTHERE; .*port"),
        ("socket://127.0.0.1:9", "check address and port number, and close other programs"),
        ("sim://laser", "no simulated device 'laser'"),
        ("sim://elliptec?speed=3", "unknown option 'speed'"),
        ("sim://elliptec?fault=gremlins", "no fault 'gremlins'"),
        ("sim://elliptec?time_scale=fast", "time_scale=fast: give a number"),
        ("nosuch://x", "no handler for nosuch://"),
        ("socket://127.0.0.1", "cannot open socket"),
        ("/dev/null", "cannot open port /dev/null"),
    ],
)
def test_ports_that_cannot_be_opened(port, pattern):
    with pytest.raises(NotConnected, match=pattern) as caught:
        Transport(port)
    assert "\n" not in str(caught.value)


def test_nobody_listens():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(NotConnected, match="refused"):
        Transport(f"socket://127.0.0.1:{port}")


def test_a_port_in_use():
    with (
        PtyServer(firmware()) as server,
        Transport(server.url),
        pytest.raises(NotConnected, match="in use"),
    ):
        Transport(server.url)


@pytest.mark.parametrize(
    "problem", [PermissionError(13, "Permission denied"), OSError("PermissionError(13, 'no')")]
)
def test_a_port_that_is_not_permitted(monkeypatch, problem):
    def refuse(*_args, **_options):
        raise problem

    monkeypatch.setattr(module.serial, "serial_for_url", refuse)
    with pytest.raises(NotConnected, match="may not be opened"):
        Transport("COM3")


@pytest.mark.parametrize("kind", [PtyServer, TcpServer])
def test_a_device_that_vanishes(kind):
    device = firmware()
    with kind(device) as server:
        line = Transport(server.url)
        device.faults["hangup"] = 0.0
        line.write(b"0ho0")
        with pytest.raises(NotConnected, match="the connection was lost; check the cable"):
            line.read_until(b"\r\n", 30.0)
        assert not line.is_open
        for use in (lambda: line.write(b"0gs"), lambda: line.read_exactly(1, 0.1), line.discard):
            with pytest.raises(NotConnected, match="the port is closed"):
                use()
        with Transport(server.url) as again:
            again.write(b"0gs")
            assert again.read_until(b"\r\n", 30.0) == b"0GS00\r\n"


def test_closing_wakes_a_reader():
    line = Transport("sim://elliptec")
    threading.Timer(0.1, line.close).start()
    start = time.monotonic()
    with pytest.raises(NotConnected):
        line.read_exactly(1, 600.0)
    assert time.monotonic() - start < 60.0


def test_handlers_are_registered_once():
    register_handlers()
    register_handlers()
    assert module.serial.protocol_handler_packages.count("anisoscope.sim.bench.serialports") == 1


def test_ports_are_listed_without_opening_them():
    assert all(isinstance(port, str) for port in available_ports())


def test_no_descriptor_is_left_behind():
    gc.collect()  # what other tests left is closed before, and not meanwhile
    before = len(list(Path("/proc/self/fd").iterdir()))
    with PtyServer(firmware()) as server:
        for _ in range(3):
            Transport(server.url).close()
    assert len(list(Path("/proc/self/fd").iterdir())) <= before


def test_flow_control_reaches_the_port():
    with PtyServer(firmware()) as server:
        for wanted in (True, False):
            with Transport(server.url, xonxoff=wanted) as line:
                port = line._connection.serial
                assert port.xonxoff is wanted
                modes = termios.tcgetattr(port.fileno())[0]
                assert bool(modes & termios.IXON) is wanted
                assert bool(modes & termios.IXOFF) is wanted
                line.write(b"0gs")
                assert line.read_until(b"\r\n", 30.0) == b"0GS00\r\n"
        with Transport(
            server.url, rtscts=True
        ) as line:  # a pseudo terminal has no such lines: it works without
            line.write(b"0gs")
            assert line.read_until(b"\r\n", 30.0) == b"0GS00\r\n"
