"""Several devices on one cable."""

import pytest

from anisoscope.base.errors import NotConnected
from anisoscope.rig.acquisition.opening import open_rig
from anisoscope.rig.rigfile import read_rig
from anisoscope.rig.transport import Transport, shared_ports
from anisoscope.sim.bench.bench import shared_bench


@pytest.fixture
def bench(tmp_path):
    """The file of a bench with two axes on one cable."""
    path = tmp_path / "bench.toml"
    path.write_text('schema = 1\n[stage]\ntime_scale = 0.0\n[tilt]\naddress = "1"\n')
    return path


@pytest.fixture
def line(bench):
    """A port that is open once, as a real one: the stage of a bench."""
    return f"sim://elliptec?bench={bench}"


def test_within_the_context_a_port_is_shared_and_the_last_one_closes_it(line):
    with shared_ports():
        first, second = Transport(line), Transport(line)
    assert first.lock is second.lock
    first.write(b"0gs")
    assert second.read_until(b"\r\n", 1.0) == b"0GS00\r\n"
    first.close()
    first.close()
    assert not first.is_open
    with pytest.raises(NotConnected, match="the port is closed"):
        first.write(b"0gs")
    with pytest.raises(NotConnected, match="the port is closed"):
        first.discard()
    second.write(b"0gs")
    assert second.read_until(b"\r\n", 1.0) == b"0GS00\r\n"
    second.close()
    with Transport(line) as again:
        assert again.is_open


def test_outside_of_the_context_a_port_is_open_once(line):
    with shared_ports():
        first = Transport(line)
    with pytest.raises(NotConnected, match="in use"):
        Transport(line)
    with shared_ports(), pytest.raises(NotConnected, match="in use"):
        Transport(line)  # another rig is another context
    first.close()


def test_a_port_that_was_closed_is_opened_anew(line):
    with shared_ports():
        Transport(line).close()
        with Transport(line) as again:
            again.write(b"0gs")
            assert again.read_until(b"\r\n", 1.0) == b"0GS00\r\n"


def test_devices_on_one_port_speak_alike(line):
    with (
        shared_ports(),
        Transport(line, baudrate=9600),
        pytest.raises(NotConnected, match=r"open with baudrate 9600 .* wanted with 115200"),
    ):
        Transport(line, baudrate=115200)


def test_a_lost_connection_is_lost_for_all(line):
    with shared_ports():
        first, second = Transport(line), Transport(line)
    with pytest.raises(NotConnected):
        first._lost(OSError("unplugged"))
    with pytest.raises(NotConnected, match="closed"):
        second.write(b"0gs")


RIG = """
schema = 1
name = "two on a cable"
[stage]
driver = "elliptec"
port = "sim://elliptec?bench=${{here}}/{bench}"
zero_deg = 10.0
options = {{ address = "0" }}
[tilt]
driver = "elliptec"
port = "sim://elliptec?bench=${{here}}/{bench}"
zero_deg = 30.0
options = {{ address = "1" }}
[camera]
driver = "simulated"
pixel_um = 14.0
options = {{ bench = "${{here}}/{bench}" }}
[light]
driver = "simulated"
options = {{ bench = "${{here}}/{bench}" }}
"""


def test_stage_and_tilt_on_one_cable(bench):
    path = bench.with_name("rig.toml")
    path.write_text(RIG.format(bench=bench.name))
    with open_rig(read_rig(path)) as rig:
        for axis, angle in zip(rig.axes, (100.0, 40.0), strict=True):
            axis.home()
            axis.move_to(angle)
        assert shared_bench(bench).sample_angle_deg == pytest.approx(90.0, abs=0.01)
        assert shared_bench(bench).tilt_deg == pytest.approx(10.0, abs=0.01)
        rig.tilt.close()
        assert rig.stage.position_deg() == pytest.approx(100.0, abs=0.01)
    with open_rig(read_rig(path)):  # the port was closed
        pass
