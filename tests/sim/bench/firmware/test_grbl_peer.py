"""Somebody else's client (``pygrbl-streamer``, MIT) streams G-code to the simulated board on a pseudo terminal."""

import time

import pytest

from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.serve import PtyServer

client = pytest.importorskip("pygrbl_streamer", reason="pip install pygrbl-streamer (extra dev)")
HOME = -360.0
"""Machine position where the search for the switch ends."""


@pytest.fixture
def axis():
    return RotaryAxis(time_scale=0.01, start_deg=12.0)


@pytest.fixture
def session(axis):
    """``session(*faults)`` serves a board and connects to it; what the client reports is in ``session.heard``."""
    opened = []

    def open_session(*faults):
        server = PtyServer(build("grbl", [Mount(axis)], faults=faults)).__enter__()
        grbl = client.GrblStreamer(server.port)
        grbl.heard = []
        grbl.alarm_callback = grbl.error_callback = grbl.heard.append
        opened.extend((server, grbl))
        grbl.connect()
        return grbl

    yield open_session
    for one in reversed(opened):
        one.__exit__(None, None, None)


def test_it_homes_and_streams_moves(session, axis):
    grbl = session()
    assert grbl.home(wait_idle=True)
    assert axis.position() == pytest.approx(0.0, abs=0.1)
    steps = [f"G1 X{HOME + 10 + k / 10} F3600" for k in range(200)]
    assert grbl.stream(["G90 G21", f"G53 G0 X{HOME + 20} (there)", "", *steps])
    assert grbl.heard == []
    assert grbl.last_status["state"] == "Idle"
    reported = float(grbl.last_status["raw"].partition("MPos:")[2].partition(",")[0])
    assert axis.position() == pytest.approx(reported - HOME, abs=0.05)
    assert axis.position() == pytest.approx(29.9, abs=0.05)


def test_it_hears_a_refusal_and_an_alarm(session):
    grbl = session()
    assert grbl.home(wait_idle=True)
    assert not grbl.command("G2 X1")
    assert not grbl.stream(["G53 G0 X5000"], completion_timeout=10.0)
    deadline = time.monotonic() + 60.0  # a thread of its own calls back
    while "ALARM:2" not in grbl.heard and time.monotonic() < deadline:
        time.sleep(0.01)
    assert grbl.heard[0].startswith("error:")
    assert "ALARM:2" in grbl.heard


def test_it_resets_after_an_alarm_and_goes_on(session, axis):
    grbl = session("latched-error")
    assert grbl.reset()
    assert grbl.home(wait_idle=True)
    assert grbl.stream([f"G53 G0 X{HOME + 30}"])
    assert axis.position() == pytest.approx(30.0, abs=0.1)
