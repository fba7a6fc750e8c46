"""Serving to other programs, and the command line that does it."""

import gc
import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from anisoscope.base.errors import RigError, UsageError
from anisoscope.cli.rig.rig import ports
from anisoscope.cli.rig.sim import device
from anisoscope.rig.transport import Transport
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.elliptec import ElliptecFirmware
from anisoscope.sim.bench.serve import PtyServer, TcpServer


def firmware():
    return ElliptecFirmware(RotaryAxis(time_scale=0.0))


def test_any_program_can_talk_over_tcp():
    with TcpServer(firmware()) as server:
        host, port = server.port.split(":")
        for _ in range(3):
            with socket.create_connection((host, int(port)), timeout=30.0) as client:
                client.sendall(b"0in\r\n")
                assert client.recv(100) == b"0IN0E1140051720231701016800023000\r\n"


def test_any_program_can_talk_over_a_pseudo_terminal():
    with PtyServer(firmware()) as server:
        for _ in range(3):
            device = os.open(server.port, os.O_RDWR | os.O_NOCTTY)
            os.write(device, b"0gp")
            assert os.read(device, 100) == b"0PO00000000\r\n"
            os.close(device)


@pytest.mark.parametrize("port", [99999, -1])
def test_no_such_tcp_port(port):
    with pytest.raises(RigError, match="cannot serve"):
        TcpServer(firmware(), port)


def test_a_tcp_port_that_is_taken():
    with TcpServer(firmware()) as server, pytest.raises(RigError, match="cannot serve"):
        TcpServer(firmware(), int(server.port.split(":")[1]))


def test_servers_leave_nothing_behind():
    gc.collect()  # what other tests left is closed before, and not meanwhile
    before = len(list(Path("/proc/self/fd").iterdir()))
    for kind in (PtyServer, TcpServer):
        with kind(firmware()):
            pass
    assert len(list(Path("/proc/self/fd").iterdir())) <= before


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"pty": True, "tcp": 0},
        {"pty": True, "address": "G"},
        {"pty": True, "time_scale": -1.0},
        {"pty": True, "fault": ("gremlins",)},
    ],
)
def test_options_that_make_no_sense(options):
    with pytest.raises(UsageError):
        device("elliptec", **options)


@pytest.mark.parametrize(("option", "ending"), [("--pty", signal.SIGINT), ("--tcp=0", signal.SIGTERM)])
def test_the_command_serves_until_it_is_told_to_stop(option, ending):
    code = (
        "import signal, sys\n"
        "def end(*_): raise KeyboardInterrupt\n"
        "signal.signal(signal.SIGTERM, end)\n"
        "from anisoscope.cli.rig.rig import app\n"
        "sys.exit(app(sys.argv[1:], result_action='return_value'))\n"
    )
    command = [sys.executable, "-c", code, "sim", "elliptec", option, "--time-scale", "0", "--fault", "split"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        assert first.startswith("serving elliptec on ")
        where = first.split()[-1]
        with Transport(where if where.startswith("/") else f"socket://{where}") as line:
            line.write(b"0gs")
            assert line.read_until(b"\r\n", 30.0) == b"0GS00\r\n"
        process.send_signal(ending)
        _, errors = process.communicate(timeout=120.0)
    assert (process.returncode, errors) == (0, "")


def test_ports_are_listed(capsys):
    ports(json=True)
    assert isinstance(json.loads(capsys.readouterr().out), list)
    ports()
    assert capsys.readouterr().out
