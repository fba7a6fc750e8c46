"""One case a protocol, and the lines on which a test can reach its simulated device."""

import contextlib
import threading
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest
from serial.urlhandler import protocol_socket

from anisoscope.base import errors
from anisoscope.base.clock import SYSTEM, VirtualClock
from anisoscope.rig.drivers import open_stage
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.serialports import protocol_sim
from anisoscope.sim.bench.serve import PtyServer, TcpServer


@dataclass(frozen=True)
class Case:
    """A protocol under test: its driver with hurried options, its simulated device, and what to expect."""

    protocol: str
    driver: dict
    stage: dict
    faults: dict

    def firmware(self, *faults, time_scale=0.0, **axis):
        """The device; with ``clock=`` that of a test, what waits for it waits by that clock, too."""
        return build(self.protocol, [Mount(RotaryAxis(time_scale=time_scale, **axis))], faults=faults)

    def open(self, port, **options):
        return open_stage(self.protocol, port=port, **(self.driver | options))

    def error_of(self, fault):
        """The error class and the part of its message, or None where the driver copes."""
        expected = self.faults[fault]
        return None if expected == "copes" else (getattr(errors, expected[0]), expected[1])


def read_cases():
    return {
        path.stem: Case(path.stem, **tomllib.loads(path.read_text(encoding="utf-8")))
        for path in sorted((Path(__file__).parent / "conformance").glob("*.toml"))
    }


CASES = read_cases()
LINES = ("sim", "pty", "tcp")
WAITED_OUT = frozenset({"babble", "busy", "lost-reply", "silent", "slow", "wrong-address"})
"""Faults that end by a time limit of the driver, whatever the line."""


def pytest_generate_tests(metafunc):
    """``case`` runs a test for every protocol, ``case`` with ``fault`` for every fault of every protocol.

    Where such a test is served as well, every fault comes over ``sim``, every second one over one of the two real
    lines, every line has faults of every protocol, and ``make soak`` does the rest: on real lines nearly all of it is
    waiting. So a fault that is waited out comes over a real line for one protocol.
    """
    asked = {"case", "fault", "served"} & set(metafunc.fixturenames)
    pairs = [(case, fault) for case in CASES.values() for fault in case.faults]
    ids = [f"{case.protocol}-{fault}" for case, fault in pairs]
    if asked == {"case", "fault", "served"}:
        metafunc.parametrize(
            ("case", "fault", "served"),
            [
                pytest.param(*pair, line, id=f"{name}-{line}", marks=[] if soon else [pytest.mark.soak])
                for name, pair, lines in zip(ids, pairs, _lines(pairs), strict=True)
                for line in LINES
                for soon in [line in lines]
            ],
            indirect=["served"],
        )
        return
    if {"case", "fault"} <= asked:
        metafunc.parametrize(("case", "fault"), pairs, ids=ids)
    elif "case" in asked:
        metafunc.parametrize("case", CASES.values(), ids=CASES)
    if "served" in asked:
        metafunc.parametrize("served", LINES, indirect=True)


def _lines(pairs):
    """The lines over which the fault of each pair comes at once; over the others it comes in ``make soak``."""
    waited = set()
    for number, (_, fault) in enumerate(pairs):
        kind, line = fault.partition(":")[0], LINES[number % 4 % 3]
        yield {"sim"} if kind in waited else {"sim", line}
        if kind in WAITED_OUT and line != "sim":
            waited.add(kind)


@pytest.fixture
def all_cases():
    """The cases of all protocols, by name."""
    return CASES


@pytest.fixture
def clock(request):
    """Time of a device in this process passes where the driver waits; a real line takes the system's."""
    line = request.node.callspec.params.get("served", "sim") if hasattr(request.node, "callspec") else "sim"
    return VirtualClock() if line == "sim" else SYSTEM


@pytest.fixture
def in_process(monkeypatch):
    """Serve firmware of the test's choice behind sim:// in this process."""

    def serve(firmware):
        monkeypatch.setattr(protocol_sim, "device_of_url", lambda _: firmware)
        return "sim://device"

    return serve


@pytest.fixture
def when_it_turns():
    """``when_it_turns(firmware, action)`` does something once the axis turns, in a thread that it returns."""
    ended, threads = threading.Event(), []

    def act(axis, start_deg, action):
        while abs(axis.position() - start_deg) < 0.05:  # a few counts
            if ended.wait(0.005):
                return
        action()

    def wait(firmware, action):
        axis = firmware.axis
        threads.append(threading.Thread(target=act, args=(axis, axis.position(), action)))
        threads[-1].start()
        return threads[-1]

    yield wait
    ended.set()
    for thread in threads:
        thread.join()


@pytest.fixture
def served(request, in_process, monkeypatch):
    """The same over every line; gives (function that starts to serve and returns the port)."""
    # pyserial waits 0.3 s whenever it closes a socket, for servers that need a rest before the next client; ours do not
    monkeypatch.setattr(protocol_socket, "time", SimpleNamespace(sleep=lambda _: None, time=time.time))
    with contextlib.ExitStack() as servers:

        def serve(firmware):
            if request.param == "sim":
                return in_process(firmware)
            server = PtyServer(firmware) if request.param == "pty" else TcpServer(firmware)
            return servers.enter_context(server).url

        yield serve
