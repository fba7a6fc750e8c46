"""``anisoscope rig ports``."""

import json

import pytest
from serial.tools.list_ports_common import ListPortInfo

from anisoscope.cli import run
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.serve import PtyServer


def system_port(device, **told):
    """A port as the operating system lists it."""
    port = ListPortInfo(device)
    vars(port).update(told)
    return port


USB = system_port(
    "COM7",
    description="USB Serial Port",
    vid=0x0403,
    pid=0xFAF0,
    manufacturer="Thorlabs",
    product="Kinesis K10CR1",
    serial_number="55000001",
)
PLAIN = system_port("COM1")


@pytest.fixture(autouse=True)
def two_ports(monkeypatch):
    """The operating system lists two ports."""
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [USB, PLAIN])


def test_lines_for_people(capsys):
    assert run(["rig", "ports"]) == 0
    assert capsys.readouterr().out == (
        "COM1\nCOM7  0403:faf0  Thorlabs  Kinesis K10CR1  serial 55000001  may be apt or elliptec\n"
    )


def test_nothing_is_opened_without_probe(capsys, monkeypatch):
    monkeypatch.setattr("serial.serial_for_url", lambda *_, **__: pytest.fail("a port was opened"))
    assert run(["rig", "ports", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [row["port"] for row in found] == ["COM1", "COM7"]
    assert found[1]["may_be"] == ["apt", "elliptec"]
    assert all("probe" not in row for row in found)


def test_probe_says_who_answered(capsys):
    with PtyServer(build("elliptec", [Mount(RotaryAxis())])) as server:
        arguments = ["rig", "ports", "--probe", "--port", server.port, "--port", "/dev/nonesuch"]
        assert run(arguments) == 0
        lines = capsys.readouterr().out.splitlines()
        assert lines[0] == f"{server.port}  elliptec: ELL14 11400517 answered"
        assert "there is no port /dev/nonesuch" in lines[1]
        assert run([*arguments, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found[0]["probe"] == {"driver": "elliptec", "device": "ELL14 11400517", "problem": ""}


def test_a_port_that_is_not_there_is_a_mistake_without_probe(capsys):
    assert run(["rig", "ports", "--port", "COM9"]) == 64
    assert "--port COM9: not a port of this machine" in capsys.readouterr().err
