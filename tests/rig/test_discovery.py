"""Which device may hang on a port, and which does."""

from types import SimpleNamespace

import pytest

from anisoscope.base.plugins import installed
from anisoscope.rig import discovery
from anisoscope.rig.discovery import candidates, find_ports, probe
from anisoscope.rig.drivers import LIGHTS, STAGES
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.serve import TcpServer


@pytest.mark.parametrize(
    ("vendor", "product", "words", "first"),
    [
        (0x0403, 0xFAF0, "", "apt"),
        (0x0403, 0x6015, "", "elliptec"),
        (0x0403, 0x6001, "", "zaber"),
        (0x0403, 0x6001, "FTDI Newport SMC100", "smc100"),
        (0x0403, 0x6001, "Thorlabs Kinesis K10CR1 rotary stage", "apt"),
        (0x104D, 0x3002, "", "smc100"),
        (0x2939, 0x495B, "", "zaber"),
        (0x2341, 0x0043, "", "grbl"),
        (0x2A03, 0x0042, "", "grbl"),
        (0x1A86, 0x7523, "USB Serial", "grbl"),
    ],
)
def test_usb_ids_and_words_lead_to_drivers(vendor, product, words, first):
    found = candidates(vendor, product, words)
    assert found[0] == first
    assert len(set(found)) == len(found)


@pytest.mark.parametrize("ids", [(None, None), (0x046D, 0xC077)])
def test_nothing_is_made_up(ids):
    assert candidates(*ids, "PS/2 something") == ()


def test_every_name_of_the_tables_is_a_driver():
    known = {*installed(STAGES), *installed(LIGHTS)}
    named = [*discovery.BY_USB_ID.values(), *discovery.BY_MAKER.values(), *discovery.BY_WORD.values()]
    assert {name for names in named for name in names} <= known


def test_listing_shows_what_the_system_says_and_opens_nothing(monkeypatch):
    fields = {"manufacturer": "Thorlabs", "product": "Kinesis K10CR1", "serial_number": "55000001"}
    usb = SimpleNamespace(device="COM10", description="USB Serial Port", vid=0x0403, pid=0xFAF0, **fields)
    silent = dict.fromkeys(("vid", "pid", "manufacturer", "product", "serial_number"))
    plain = SimpleNamespace(device="COM1", description="n/a", **silent)
    monkeypatch.setattr(discovery.list_ports, "comports", lambda: [usb, plain])
    monkeypatch.setattr("serial.serial_for_url", lambda *_, **__: pytest.fail("a port was opened"))
    first, second = find_ports()
    assert (first.port, first.usb, first.description, first.may_be) == ("COM1", "", "", ())
    assert (second.usb, second.maker, second.serial) == ("0403:faf0", "Thorlabs", "55000001")
    assert second.may_be == ("apt", "elliptec")


def test_probing_finds_who_is_there_and_moves_nothing():
    axis = RotaryAxis(start_deg=12.0)
    with TcpServer(build("elliptec", [Mount(axis)])) as server:
        answer = probe(server.url, ("elliptec",))
        assert (answer.driver, answer.device, answer.problem) == ("elliptec", "ELL14 11400517", "")
        assert probe(server.url, ("unknown", "elliptec")).driver == "elliptec"
    assert axis.position() == 12.0


def test_a_silent_port_is_said_to_be_silent():
    with TcpServer(build("elliptec", [Mount(RotaryAxis())], faults=["silent"])) as server:
        answer = probe(server.url, ("elliptec",))
    assert (answer.driver, answer.problem) == ("", "nobody answered as elliptec does")


def test_something_else_is_said_to_be_something_else():
    with TcpServer(build("elliptec", [Mount(RotaryAxis())], faults=["babble"])) as server:
        answer = probe(server.url, ("elliptec",))
    assert answer.driver == ""
    assert answer.problem


def test_a_port_that_does_not_open_says_why():
    assert "there is no port /dev/nonesuch" in probe("/dev/nonesuch").problem


class LateAnswers:
    """A device whose answers to the first driver come while the second one asks."""

    def __init__(self, device):
        self.device, self.clock, self.connections, self.late = device, device.clock, 0, b""

    def connect(self):
        self.connections += 1
        self.device.connect()

    def write(self, data):
        self.device.write(data)

    def read(self):
        answer = self.device.read()
        if self.connections <= 2:  # the probe opens the port, then the first driver does
            self.late += answer
            return b""
        late, self.late = self.late, b""
        return late + answer


def test_a_late_answer_does_not_hide_a_device():
    with TcpServer(LateAnswers(build("elliptec", [Mount(RotaryAxis())]))) as server:
        answer = probe(server.url, ("elliptec", "zaber"))
        assert server.firmware.connections > 3
    assert (answer.driver, answer.device) == ("elliptec", "ELL14 11400517")
