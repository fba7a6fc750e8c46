"""From the start of ``anisoscope rig stop`` in another terminal to the stop at a stage that searches its reference."""

import contextlib
import os
import resource
import statistics
import subprocess
import sys
import threading
import time

import pytest

from anisoscope.base.errors import RigError
from anisoscope.rig.drivers import open_stage
from anisoscope.rig.hold import Owner
from anisoscope.rig.rigfile import StagePart
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.serve import PtyServer

pytestmark = pytest.mark.benchmark
TRIALS = 9


def processor_of(program):
    """Seconds of processor time of a process that runs a program."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-Ic", program], check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def test_stop_of_a_held_rig(bench, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    axis = RotaryAxis(time_scale=60.0, start_deg=300.0)
    firmware = build("zaber", [Mount(axis)])
    with PtyServer(firmware) as server, open_stage("zaber", port=server.port, margin_s=10.0) as stage:
        part = StagePart(driver="zaber", port=server.port)

        def home():
            with contextlib.suppress(RigError):
                stage.home()

        def stop_from(command):
            """Seconds from the start of a process to the stop at the stage."""
            searching = threading.Thread(target=home)
            searching.start()
            while not axis.busy():
                time.sleep(0.01)
            before, started = firmware.stops, time.monotonic()
            with subprocess.Popen(command, stdout=subprocess.DEVNULL):
                while firmware.stops == before:
                    time.sleep(0.001)
                took_s = time.monotonic() - started
            searching.join()
            return took_s

        def start_of_python():
            started = time.monotonic()
            subprocess.run([sys.executable, "-Ic", "pass"], check=True)
            return time.monotonic() - started

        with Owner({"stage": (part, stage)}):
            command = [sys.executable, "-Im", "anisoscope", "rig", "stop"]
            sending = min(
                processor_of("from anisoscope.rig.holdline import stop_held; stop_held()") for _ in range(5)
            )
            pairs = [(stop_from(command), start_of_python()) for _ in range(TRIALS)]
    stops, starts = (sorted(column) for column in zip(*pairs, strict=True))
    for name, spans in (
        ("`anisoscope rig stop` to the stop at the stage", stops),
        ("`python -c pass`", starts),
    ):
        bench.note(f"{name}: median {1e3 * statistics.median(spans):.0f} ms, least {1e3 * spans[0]:.0f} ms")
    bare = min(processor_of("pass") for _ in range(5))
    bench.note(
        f"processor until it is sent {1e3 * sending:.0f} ms, of that Python itself {1e3 * bare:.0f} ms"
    )
    bench.note(
        f"{TRIALS} trials during a search, load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors"
    )
    assert not axis.busy()
    assert sending < 0.1


BY_THE_COMMAND = "from anisoscope.cli import main; main()"
RIG = """schema = 1
[stage]
driver = "zaber"
port = "{port}"
"""


def test_stop_of_a_rig_that_another_process_moves(bench, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    rig = tmp_path / "rig.toml"
    stop = ["rig", "stop", "--rig", str(rig)]

    def stop_by(program):
        """Seconds from the start of a process to the stop at a stage that another process homes."""
        axis = RotaryAxis(time_scale=60.0, start_deg=300.0)
        firmware = build("zaber", [Mount(axis)])
        with PtyServer(firmware) as server:
            rig.write_text(RIG.format(port=server.port), encoding="utf-8")
            home = [sys.executable, "-Im", "anisoscope", "rig", "home", "--rig", str(rig), "--yes"]
            with subprocess.Popen(home, stderr=subprocess.DEVNULL):
                while not axis.busy():
                    time.sleep(0.01)
                before, started = firmware.stops, time.monotonic()
                with subprocess.Popen(
                    [*program, *stop], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
                ):
                    while firmware.stops == before:
                        time.sleep(0.001)
                    return time.monotonic() - started

    programs = {
        "`anisoscope rig stop --rig` to the stop at the stage": [sys.executable, "-Im", "anisoscope"],
        "the same after the command line is loaded, as before": [sys.executable, "-Ic", BY_THE_COMMAND],
    }
    spans = {name: [] for name in programs}
    for _ in range(TRIALS):
        for name, program in programs.items():
            spans[name].append(stop_by(program))
    for name, found in spans.items():
        bench.note(f"{name}: median {1e3 * statistics.median(found):.0f} ms, least {1e3 * min(found):.0f} ms")
    bench.note(f"{TRIALS} trials each in turn, load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    first, second = (statistics.median(found) for found in spans.values())
    assert first < second
