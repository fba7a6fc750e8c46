"""The sim:// port behaves as pyserial's ports do."""

import sys
import time
import types

import pytest
import serial

from anisoscope.rig.transport import register_handlers
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.elliptec import ElliptecFirmware

URL = "sim://elliptec?time_scale=0"


@pytest.fixture(autouse=True)
def handlers():
    register_handlers()


def test_it_reads_writes_and_closes_as_a_port_does():
    with serial.serial_for_url(URL, timeout=0.05) as port:
        assert port.write(b"0gs") == 3
        port.flush()
        assert port.in_waiting == 7
        assert port.readline() == b"0GS00\r\n"
        port.write(b"0gs")
        port.reset_input_buffer()
        port.reset_output_buffer()
        assert port.in_waiting == 0
        assert (port.cts, port.dsr, port.ri, port.cd) == (True, True, False, True)
        port.baudrate = 115200
        port.rts = port.dtr = False
    assert not port.is_open
    for use in (lambda: port.write(b"x"), lambda: port.read(1), lambda: port.in_waiting):
        with pytest.raises(serial.PortNotOpenError):
            use()
    port.close()


@pytest.mark.parametrize("timeout", [0, 0.1])
def test_timeouts(timeout):
    with serial.serial_for_url(URL, timeout=timeout) as port:
        start = time.monotonic()
        assert port.read(5) == b""
        assert timeout <= time.monotonic() - start < timeout + 30.0


def test_without_timeout_it_waits_for_the_answer():
    with serial.serial_for_url("sim://elliptec?time_scale=0.1") as port:
        port.write(b"0ma00011800")
        assert port.read(13) == b"0PO00011800\r\n"


def test_options_of_the_url():
    with serial.serial_for_url(
        "sim://elliptec?address=3&time_scale=0&fault=latched%2derror:8", timeout=0.1
    ) as port:
        port.write(b"3gs0gs")
        assert port.read(20) == b"3GS08\r\n"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("bench=rig/bench.toml&fault=stall", "'fault' has no effect with bench=; state it in rig/bench.toml"),
        ("bench=rig/bench.toml&time_scale=0", "'time_scale' has no effect with bench="),
        ("address=1&address=2", "'address' is given twice"),
        ("time_scale=fast", "time_scale=fast: give a number of at least 0"),
        ("time_scale=-1", "time_scale=-1: give a number of at least 0"),
        ("colour=red", "unknown option 'colour'"),
    ],
)
def test_options_without_effect_are_refused(options, message):
    with pytest.raises(serial.SerialException, match=message):
        serial.serial_for_url(f"sim://elliptec?{options}")


def test_opening_twice_is_an_error():
    with serial.serial_for_url(URL) as port, pytest.raises(serial.SerialException):
        port.open()


def test_a_stage_of_a_bench_is_shared_and_held(monkeypatch):
    firmware = ElliptecFirmware(RotaryAxis(time_scale=0.0))
    asked = []

    def shared_bench(path):
        asked.append(path)
        return types.SimpleNamespace(device=lambda _name: firmware)

    bench = types.ModuleType("bench")
    bench.shared_bench = shared_bench
    monkeypatch.setitem(sys.modules, "anisoscope.sim.bench.bench", bench)
    url = "sim://elliptec?bench=/a%20b/bench.toml"
    for _ in range(2):
        with serial.serial_for_url(url) as port:
            port.write(b"0ma00000010")
            with pytest.raises(serial.SerialException, match="in use"):
                serial.serial_for_url(url)
    assert asked[0] == "/a b/bench.toml"
    assert firmware.counts == 16
