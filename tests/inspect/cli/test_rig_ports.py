"""``anisoscope rig ports``."""

import json

import pytest

from anisoscope.cli import run
from anisoscope.rig.discovery import FoundPort
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.serve import PtyServer

USB = FoundPort("COM7", "USB Serial Port", "0403:faf0", "Thorlabs", "Kinesis K10CR1", "55000001", ("apt",))
PLAIN = FoundPort("COM1", "", "", "", "", "", ())


@pytest.fixture(autouse=True)
def two_ports(monkeypatch):
    monkeypatch.setattr("anisoscope.rig.discovery.find_ports", lambda: (PLAIN, USB))


def test_lines_for_people(capsys):
    assert run(["rig", "ports"]) == 0
    assert capsys.readouterr().out == (
        "COM1\nCOM7  0403:faf0  Thorlabs  Kinesis K10CR1  serial 55000001  may be apt\n"
    )


def test_nothing_is_opened_without_probe(capsys, monkeypatch):
    monkeypatch.setattr("serial.serial_for_url", lambda *_, **__: pytest.fail("a port was opened"))
    assert run(["rig", "ports", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [row["port"] for row in found] == ["COM1", "COM7"]
    assert found[1]["may_be"] == ["apt"]
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
