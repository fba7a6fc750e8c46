"""``anisoscope rig sim bench``: one virtual rig in a process of its own, used by others."""

import json
import re
import signal
import subprocess
import sys
import tomllib
from dataclasses import dataclass

import numpy as np
import pytest
import tomli_w

from anisoscope.cli import run
from anisoscope.inspection.run import inspect_part
from anisoscope.live_view.view import look_at, wrapped_deg
from anisoscope.rig.acquisition.opening import open_rig
from anisoscope.rig.drivers import open_camera
from anisoscope.rig.frame import read_frame
from anisoscope.rig.rigfile import read_rig


@dataclass
class Served:
    first_line: str
    process: subprocess.Popen
    rig: object


@pytest.fixture
def serve(tmp_path):
    """``serve(bench_file, *options)`` serves a bench and writes a rig file for it."""
    started = []

    def start(bench, *options):
        rig = tmp_path / "served.toml"
        command = [
            sys.executable,
            "-Im",
            "anisoscope",
            "rig",
            "sim",
            "bench",
            bench,
            "--write-rig",
            rig,
            *options,
        ]
        process = subprocess.Popen([str(part) for part in command], stdout=subprocess.PIPE, text=True)
        started.append(process)
        return Served(process.stdout.readline(), process, rig)

    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.fixture
def bench(virtual_rig):
    """The file of a bench with a part that fills the middle of the picture."""
    return virtual_rig(bench={"sample": {"size_mm": 2.4}}).rig.with_name("bench.toml")


def test_what_one_program_turns_and_lights_another_sees(serve, bench, tmp_path, capsys):
    served = serve(bench)
    where = r"serving bench on stage (\S+), light (\S+), camera (\S+)\n"
    stage, light, camera = re.fullmatch(where, served.first_line).groups()
    assert all(place.startswith("127.0.0.1:") for place in (stage, light, camera))
    onlooker = open_camera("simulated", port=camera)
    onlooker.configure(0.0015, 1.0)
    assert onlooker.grab().mean() < 80
    assert run(["rig", "move", "40", "--sample", "-g", str(served.rig), "--yes"]) == 0
    out = tmp_path / "a.tif"
    assert run(["rig", "snap", "-g", str(served.rig), "--exposure", "0.0015", "--out", str(out)]) == 0
    assert "saturated" in capsys.readouterr().out
    frame = read_frame(out)
    assert frame.stage_deg == pytest.approx(40.0, abs=0.01)
    assert abs(wrapped_deg(look_at(frame.counts, onlooker.info).ridge_deg - 40.0)) < 0.3
    assert onlooker.grab().mean() < 80, "snap has switched the light off"
    with open_rig(read_rig(served.rig)) as rig:
        rig.light.on()
        rig.camera.configure(0.0015, 1.0)
        ours, theirs = rig.camera.grab().astype(float), onlooker.grab().astype(float)
    onlooker.close()
    assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.9
    served.process.send_signal(signal.SIGINT)
    assert served.process.wait(120) == 0


def test_a_part_is_inspected_through_another_process(serve, virtual_rig):
    rig = virtual_rig()
    served = serve(rig.rig.with_name("bench.toml"))
    table = tomllib.loads(served.rig.read_text())
    flat = tomllib.loads(rig.rig.read_text())["calibration"]
    served.rig.write_text(tomli_w.dumps({**table, "calibration": flat}))
    record = inspect_part(rig.recipe, served.rig, "T-1", rig.out).record
    assert record.verdict == "PASS", record.reasons


def test_the_tilt_axis_is_on_the_line_of_the_stage(serve, virtual_rig, capsys):
    bench = {"sample": {"kind": "white-tile"}, "sensor": {"filters": "grbg"}, "tilt": {"zero_deg": 25.0}}
    served = serve(virtual_rig(bench=bench).rig.with_name("bench.toml"), "--pty")
    assert served.first_line.startswith("serving bench on stage /dev/pts/")
    assert run(["rig", "move", "5", "--sample", "--axis", "tilt", "-g", str(served.rig), "--yes"]) == 0
    capsys.readouterr()
    assert run(["rig", "status", "-g", str(served.rig), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["tilt"]["position_deg"] == pytest.approx(30.0, abs=0.01)
    assert found["tilt"]["angle_deg"] == pytest.approx(5.0, abs=0.01)
    assert found["stage"]["position_deg"] == 0.0
    assert (found["camera"]["rows"], found["light"]["driver"]) == (512, "serial")
    file = read_rig(served.rig)
    assert (found["camera"]["filters"], file.camera.sensitivities) == ("grbg", "synthetic")
    assert file.light.spectrum == "led-white"


def test_ports_can_be_chosen(serve, virtual_rig):
    rig = virtual_rig(bench={"sample": {"kind": "white-tile"}}).rig.with_name("bench.toml")
    served = serve(rig, "--tcp-base", 21110)
    assert served.first_line == (
        "serving bench on stage 127.0.0.1:21110, light 127.0.0.1:21111, camera 127.0.0.1:21112\n"
    )


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--pty", "--tcp-base", "4001"], "give one of --pty and --tcp-base"),
        (["--tcp-base", "65534"], "--tcp-base must lie between"),
        (["--tcp-base", "-2"], "--tcp-base must lie between"),
    ],
)
def test_options_that_make_no_sense(capsys, tmp_path, options, complaint):
    assert run(["rig", "sim", "bench", str(tmp_path / "b.toml"), *options]) == 64
    assert complaint in capsys.readouterr().err


def test_a_bench_file_that_is_missing(capsys, tmp_path):
    assert run(["rig", "sim", "bench", str(tmp_path / "b.toml")]) == 78
    assert "there is no such file" in capsys.readouterr().err


@pytest.mark.parametrize("protocol", ["elliptec", "zaber", "grbl", "smc100"])
def test_the_rig_file_finds_both_axes_by_every_protocol(serve, virtual_rig, capsys, protocol):
    bench = {"sample": {"kind": "white-tile"}, "stage": {"protocol": protocol}, "tilt": {}}
    served = serve(virtual_rig(bench=bench).rig.with_name("bench.toml"))
    arguments = ["-g", str(served.rig), "--json"]
    assert run(["rig", "move", "20", "--axis", "tilt", "--yes", *arguments]) == 0
    assert json.loads(capsys.readouterr().out)["after_deg"] == pytest.approx(20.0, abs=0.05)
    assert run(["rig", "status", *arguments]) == 0
    found = json.loads(capsys.readouterr().out)
    kept = (
        0.0 if protocol == "grbl" else 20.0
    )  # a board that is reset by opening its port counts from zero again
    assert found["tilt"]["position_deg"] == pytest.approx(kept, abs=0.05)
    assert found["stage"]["position_deg"] == pytest.approx(0.0, abs=0.05)
