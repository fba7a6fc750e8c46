"""``anisoscope rig status|home|move|jog|stop`` on simulated stages."""

import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from anisoscope.cli import run
from anisoscope.rig.frame import read_frame
from anisoscope.rig.portholder import holder_of
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.serve import PtyServer, TcpServer

EXAMPLE = Path(__file__).resolve().parents[3] / "docs" / "examples" / "held-rig" / "held_rig.py"


@pytest.fixture
def command(capsys):
    """``command("rig", ...)`` runs a command line here; gives exit code, output and errors."""

    def go(*arguments):
        code = run([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return code, out, err

    return go


@pytest.fixture
def line():
    """``line(time_scale=…)`` serves an Elliptec with a second one for the tilt; gives the URL and the axes."""
    servers = []

    def serve(time_scale=0.0, kind=TcpServer, start_deg=0.0):
        axes = [RotaryAxis(time_scale=time_scale, start_deg=start_deg) for _ in range(2)]
        server = kind(build("elliptec", [Mount(axis) for axis in axes]))
        servers.append(server.__enter__())
        return server.url, axes

    yield serve
    for server in servers:
        server.__exit__(None, None, None)


@pytest.fixture
def rig_file(tmp_path):
    """``rig_file(url, tilt=True)`` writes a rig file of stages on a line."""

    def write(url, *, tilt=False, **stage):
        table = {
            "schema": 1,
            "name": "test rig",
            "stage": {"driver": "elliptec", "port": url, "zero_deg": 10.0, **stage},
            "camera": {"driver": "simulated", "pixel_um": 8.0, "options": {"port": "127.0.0.1:9"}},
            "light": {"driver": "none"},
        }
        if tilt:
            options = {"address": "1"}
            table["tilt"] = {"driver": "elliptec", "port": url, "zero_deg": 30.0, "options": options}
        path = tmp_path / "rig.toml"
        path.write_text(tomli_w.dumps(table), encoding="utf-8")
        return path

    return write


def test_status_tells_all_and_moves_nothing(command, line, rig_file):
    url, axes = line()
    code, out, err = command("rig", "status", "-g", rig_file(url, tilt=True), "--json")
    found = json.loads(out)
    stage, tilt = found["stage"], found["tilt"]
    assert stage["device"].startswith("ELL14 ")
    assert (stage["position_deg"], stage["angle_deg"], stage["homed"]) == (0.0, -10.0, False)
    assert (stage["limits_deg"], tilt["angle_deg"]) == ([0.0, 360.0], -30.0)
    assert stage["resolution_deg"] == pytest.approx(360 / 143360)
    assert "nobody serves a camera on 127.0.0.1:9" in found["camera"]["error"]
    assert (code, err) == (69, ""), "a device that is missing does not hide the others"
    assert [axis.position() for axis in axes] == [0.0, 0.0]


def test_status_for_people(command, line, rig_file):
    code, out, _ = command("rig", "status", "-g", rig_file(line()[0]))
    assert code == 69
    assert "at 0.000° (part -10.000°), not homed since it was connected, reaches 0°…360°" in out


def test_status_of_a_stage_alone_knows_no_sample(command):
    code, out, _ = command("rig", "status", "--driver", "elliptec", "--port", "sim://elliptec?time_scale=0")
    assert code == 0
    assert out.startswith("stage     ELL14 11400517, at 0.000°, not homed")


@pytest.mark.parametrize(
    ("arguments", "reading", "angle"),
    [
        (["move", 47.5], 47.5, 37.5),
        (["move", 47.5, "--sample"], 57.5, 47.5),
        (["jog", 12], 12.0, 2.0),
        (["home"], 0.0, -10.0),
    ],
)
def test_motion_says_where_it_was_and_is(command, line, rig_file, arguments, reading, angle):
    url, (axis, _) = line()
    code, out, err = command("rig", *arguments, "-g", rig_file(url), "--yes", "--json")
    assert code == 0, err
    assert "homing ELL14 11400517" in err
    found = json.loads(out)
    assert (found["before_deg"], found["homed"]) == (0.0, True)
    assert found["after_deg"] == pytest.approx(reading, abs=0.01)
    assert found["angle_after_deg"] == pytest.approx(angle, abs=0.01)
    assert axis.position() == pytest.approx(reading, abs=0.01)


def test_sample_angles_turn_the_other_way_where_the_rig_file_says_so(command, line, rig_file):
    url, (axis, _) = line()
    code, out, _ = command("rig", "move", -40, "--sample", "-g", rig_file(url, turns="cw"), "--yes")
    assert code == 0
    assert axis.position() == pytest.approx(50.0, abs=0.01)
    assert out == "stage ELL14 11400517: was at 0.000°, is at 50.000° (part -40.000°)\n"


def test_the_tilt_axis_moves_and_the_stage_does_not(command, line, rig_file):
    url, (stage, tilt) = line()
    rig = rig_file(url, tilt=True)
    code, out, _ = command("rig", "move", 20, "--sample", "--axis", "tilt", "-g", rig, "--yes")
    assert code == 0
    assert (stage.position(), tilt.position()) == (0.0, pytest.approx(50.0, abs=0.01))
    assert "(arm 20.00" in out


@pytest.mark.parametrize("arguments", [["home"], ["move", "10"], ["jog", "10"]])
def test_without_a_terminal_nothing_is_homed_unless_told(command, line, rig_file, arguments, monkeypatch):
    monkeypatch.setattr("sys.stdin", None)
    url, (axis, _) = line()
    axis.start_move(5.0)
    code, out, err = command("rig", *arguments, "-g", rig_file(url))
    assert (code, out) == (64, "")
    assert "homing ELL14 11400517: it searches its reference" in err
    assert "--yes" in err
    assert axis.position() == 5.0


@pytest.mark.parametrize(("answer", "moved"), [(b"y\n", True), (b"\n", False), (b"n\n", False)])
def test_in_a_terminal_homing_is_asked_for(line, rig_file, answer, moved):
    url, (axis, _) = line()
    ours, theirs = pty.openpty()
    command = [sys.executable, "-Im", "anisoscope", "rig", "move", "30", "-g", str(rig_file(url))]
    with subprocess.Popen(command, stdin=theirs, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        asked = b""
        while b"Go on? [y/N]" not in asked:
            asked += os.read(process.stderr.fileno(), 1000)
        assert axis.position() == 0.0
        os.write(ours, answer)
        process.communicate(timeout=120)
    os.close(ours)
    os.close(theirs)
    assert process.returncode == (0 if moved else 64)
    assert axis.position() == pytest.approx(30.0 if moved else 0.0, abs=0.01)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["move", "400", "--option", "max_deg=180"], "400° is outside 0°…180°; nothing was moved"),
        (["move", "1", "--sample"], "needs a rig file"),
        (["move", "1", "--axis", "tilt"], "--axis tilt: there is no such axis"),
        (["jog", "-10", "--option", "max_deg=180"], "-10° is outside 0°…180°"),
        (["home", "--option", "address"], "KEY=VALUE"),
        (["home", "--rig", "rig.toml"], "--rig FILE, or --driver"),
    ],
)
def test_mistakes_are_one_line(command, arguments, complaint):
    port = "sim://elliptec?time_scale=0"
    code, out, err = command("rig", *arguments, "--driver", "elliptec", "--port", port, "--yes")
    assert code in {64, 69}
    assert out == ""
    assert complaint in err.splitlines()[-1]
    assert "Traceback" not in err


@pytest.mark.parametrize("arguments", [["move", "200"], ["jog", "200"], ["move", "nan"], ["jog", "-1"]])
def test_an_angle_out_of_reach_is_refused_before_the_stage_is_homed(command, arguments):
    stage = ["--driver", "elliptec", "--port", "sim://elliptec?time_scale=0", "--option", "max_deg=180"]
    code, _, err = command("rig", *arguments, *stage, "--yes")
    assert code == 69
    assert "nothing was moved" in err
    assert "homing" not in err


def test_an_approach_out_of_reach_is_refused_before_the_stage_is_homed(command, line, rig_file):
    rig = rig_file(line()[0])
    code, _, err = command("rig", "move", -9.8, "--sample", "-g", rig, "--yes")
    assert (code, "-1.8° is outside 0°…360°" in err, "homing" in err) == (69, True, False)


@pytest.mark.parametrize(
    ("arguments", "reading"),
    [(["move", -5], 355.0), (["move", 400], 40.0), (["jog", -10], 350.0), (["jog", 725], 5.0)],
)
def test_a_stage_that_turns_all_the_way_round_takes_every_angle(command, line, rig_file, arguments, reading):
    url, (axis, _) = line()
    code, out, err = command("rig", *arguments, "-g", rig_file(url), "--yes", "--json")
    assert code == 0, err
    assert json.loads(out)["after_deg"] == pytest.approx(reading, abs=0.01)
    assert axis.position() == pytest.approx(reading, abs=0.01)


@pytest.mark.parametrize("angle", ["1e9", "-4000"])
def test_an_angle_that_nobody_means_is_refused(command, line, rig_file, angle):
    url, (axis, _) = line()
    code, _, err = command("rig", "move", angle, "-g", rig_file(url), "--yes")
    assert (code, "° is outside 0°…360°; nothing was moved" in err) == (69, True)
    assert ("homing" in err, axis.position()) == (False, 0.0)


def test_an_arm_is_not_turned_round(command, line, rig_file):
    url, (_, tilt) = line()
    code, _, err = command("rig", "move", -5, "--axis", "tilt", "-g", rig_file(url, tilt=True), "--yes")
    assert (code, "-5° is outside 0°…360°" in err, tilt.position()) == (69, True, 0.0)


def test_options_after_the_end_of_the_options_are_named(command):
    arguments = ["--", "-5", "--driver", "elliptec", "--port", "sim://elliptec"]
    code, out, err = command("rig", "move", *arguments)
    assert (code, out) == (64, "")
    assert err.startswith(
        "anisoscope: --driver stands after '--', which ends the options: write the options before"
    )


def test_options_of_a_driver_reach_it(command, line):
    url, (_, second) = line()
    arguments = ["--driver", "elliptec", "--port", url, "--option", "address=1", "--option", "max_deg=90"]
    assert command("rig", "move", "80", *arguments, "--yes")[0] == 0
    assert second.position() == pytest.approx(80.0, abs=0.01)
    code, _, err = command("rig", "move", "91", *arguments, "--yes")
    assert (code, "outside 0°…90°" in err) == (69, True)


def test_stop_where_nothing_moves_says_where_the_axes_stand(command, line, rig_file):
    code, out, _ = command("rig", "stop", "-g", rig_file(line()[0], tilt=True), "--json")
    found = json.loads(out)
    assert (code, found["interrupted"]) == (0, [])
    assert {table: row["at_deg"] for table, row in found["axes"].items()} == {"stage": 0.0, "tilt": 0.0}


@pytest.mark.parametrize("kind", [TcpServer, PtyServer])
def test_stop_reaches_a_stage_that_another_process_moves(command, line, rig_file, kind):
    """Homing takes more than a minute here; the port is held by the process that homes."""
    url, (axis, _) = line(time_scale=60.0, kind=kind, start_deg=300.0)
    rig = rig_file(url)
    moving = [sys.executable, "-Im", "anisoscope", "rig", "home", "--yes", "-g", str(rig)]
    with subprocess.Popen(moving, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 120
        while not axis.busy():
            assert time.monotonic() < deadline
            assert process.poll() is None, process.communicate()
            time.sleep(0.02)
        code, out, err = command("rig", "stop", "-g", rig, "--json")
        _, said = process.communicate(timeout=120)
    assert code == 0, err
    assert json.loads(out)["interrupted"] == [process.pid]
    assert f"interrupted process {process.pid} (" in err
    assert process.returncode == 130
    assert "interrupted; the stage is stopped" in said
    assert not axis.busy()
    assert 0.0 < axis.position() < 300.0
    assert holder_of(url) is None


def test_a_held_rig_stays_homed_and_is_stopped_without_naming_it(
    command, line, rig_file, tmp_path, monkeypatch
):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    url, (axis, _) = line(kind=PtyServer)
    rig = rig_file(url)
    code, _, err = command("rig", "stop")
    assert (code, "no rig is held" in err) == (64, True)
    holding = [sys.executable, "-Im", "anisoscope", "rig", "hold", "--home", "--yes", "-g", str(rig)]
    with subprocess.Popen(holding, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as owner:
        assert owner.stdout.readline() == "holding stage ELL14 11400517 for other commands\n"
        code, out, err = command("rig", "move", 30, "-g", rig)
        assert (code, err) == (0, ""), "nothing homes twice"
        assert out.startswith("stage ELL14 11400517: was at 0.000°, is at 30.00")
        code, _, err = command("rig", "hold", "-g", rig)
        assert (code, "another process holds this rig already" in err) == (64, True)
        axis.stop()
        axis.time_scale = 60.0
        moving = [sys.executable, "-Im", "anisoscope", "rig", "move", "300", "-g", str(rig)]
        with subprocess.Popen(moving, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as mover:
            while not axis.busy():
                assert mover.poll() is None, mover.communicate()
                time.sleep(0.02)
            code, out, _ = command("rig", "status", "-g", rig)
            assert "moving, homed" in out
            code, out, _ = command("rig", "stop", "--json")
            assert (code, json.loads(out)) == (0, {"held": {str(owner.pid): ["stage"]}})
            _, said = mover.communicate(timeout=120)
        assert (mover.returncode, "was stopped at" in said) == (69, True)
        assert not axis.busy()
        owner.send_signal(signal.SIGTERM)
        _, said = owner.communicate(timeout=120)
        assert owner.returncode == 0
    assert "not held: camera (nobody serves a camera on 127.0.0.1:9" in said
    assert ", light; every command opens them itself" in said
    assert holder_of(url) is None


@contextlib.contextmanager
def ended(process):
    """End a process that waits for a signal, also where a test fails."""
    try:
        yield
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=120)


BENCH = """schema = 1
sample = { kind = "white-tile" }
sensor = { rows = 64, cols = 80 }
stage = { time_scale = 0.0 }
"""
HELD = """schema = 1
name = "bench"
[stage]
driver = "elliptec"
port = "sim://elliptec?bench=${here}/bench.toml"
[camera]
driver = "simulated"
pixel_um = 4.0
options = { bench = "${here}/bench.toml" }
[light]
driver = "simulated"
options = { bench = "${here}/bench.toml" }
"""


def test_pictures_of_a_held_rig_are_those_of_its_stage_and_light(command, tmp_path, monkeypatch):
    """A bench lives in one process: its camera sees what other programs do with the held stage and light."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "bench.toml").write_text(BENCH)
    rig = tmp_path / "rig.toml"
    rig.write_text(HELD)
    holding = [sys.executable, "-Im", "anisoscope", "rig", "hold", "-g", str(rig)]
    with (
        subprocess.Popen(holding, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as owner,
        ended(owner),
    ):
        said = owner.stdout.readline()
        assert said == "holding stage ELL14 11400517, light, camera for other commands\n", owner.communicate()
        means = {}
        for name, light in (("lit", "on"), ("dark", "off")):
            path = tmp_path / f"{name}.tif"
            code, _, err = command(
                "rig", "snap", "-g", rig, "--exposure", 0.002, "--light", light, "--out", path
            )
            assert code == 0, err
            means[name] = float(read_frame(path).counts.mean())
        assert means["lit"] > 2.0 * means["dark"] > 100.0
        client = [sys.executable, "-I", EXAMPLE, rig, "30", "0.002"]
        done = subprocess.run(client, capture_output=True, text=True, cwd=tmp_path, timeout=120, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.startswith("frame.raw: [64, 80] counts of 16 bits, little-endian, at 30.00")
        counts = np.fromfile(tmp_path / "frame.raw", dtype="<u2")
        assert (counts.size, counts.mean()) == (64 * 80, pytest.approx(means["lit"], rel=0.02))
        code, out, err = command(
            "rig", "live", "-g", rig, "--exposure", 0.002, "--count", 2, "--fps", 1000, "--json"
        )
        assert (code, len(out.splitlines())) == (0, 2), err
        code, out, _ = command("rig", "status", "-g", rig, "--json")
        assert json.loads(out)["stage"]["position_deg"] == pytest.approx(30.0, abs=0.01)
    assert owner.returncode == 0


def test_ctrl_c_stops_the_stage(line, rig_file):
    url, (axis, _) = line(time_scale=60.0, start_deg=300.0)
    moving = [sys.executable, "-Im", "anisoscope", "rig", "home", "--yes", "-g", str(rig_file(url))]
    with subprocess.Popen(moving, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 120
        while not axis.busy():
            assert time.monotonic() < deadline
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "the stage is stopped" in said
    assert not axis.busy()


@pytest.mark.parametrize("driver", ["apt", "elliptec", "grbl", "smc100", "zaber"])
def test_a_stage_that_loses_its_reference_after_the_move_is_no_success(command, driver):
    port = f"sim://{driver}?fault=lost-homing&time_scale=0"
    code, out, err = command("rig", "move", 90, "--driver", driver, "--port", port, "--yes")
    assert (code, out) == (69, "")
    assert err.endswith("home it again\n")
    assert len(err.splitlines()) == 2  # the announcement of homing is the other


def test_a_rig_file_of_axes_alone_serves_their_commands(command, line, tmp_path):
    url, _ = line()
    path = tmp_path / "rig.toml"
    path.write_text(
        tomli_w.dumps({"schema": 1, "name": "axes", "stage": {"driver": "elliptec", "port": url}})
    )
    code, out, _ = command("rig", "move", 10, "--rig", path, "--yes", "--json")
    assert (code, json.loads(out)["angle_after_deg"]) == (0, pytest.approx(10.0, abs=0.01))
    code, out, _ = command("rig", "status", "--rig", path)
    assert code == 0
    assert [row.split()[0] for row in out.splitlines()] == ["rig", "stage"]
    code, _, err = command("rig", "snap", "--rig", path, "--exposure", 0.01, "--out", tmp_path / "a.tif")
    assert (code, len(err.splitlines())) == (78, 1)
    assert "camera: missing" in err
