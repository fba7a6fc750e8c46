"""Ctrl-C, SIGTERM and kill −9 at any moment of an inspection: real processes, a real terminal, a stage of its own."""

import importlib.util
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest
import tomli_w

from anisoscope.calibration.pictures import take_flat
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.recompute import recompute
from anisoscope.inspection.run import resume_part
from anisoscope.operations.demo.folder import FIXTURE
from anisoscope.record.schema import read_record
from anisoscope.rig.acquisition.journal import JOURNAL, read_journal
from anisoscope.rig.transport import Transport

SPEC = importlib.util.spec_from_file_location("nursery", Path(__file__).with_name("nursery.py"))
nurseries = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(nurseries)

STAGE = """
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.serve import PtyServer
server = PtyServer(build("elliptec", [Mount(RotaryAxis(time_scale=0.7))]))
print(server.port, flush=True)
server.run()
"""
EXPOSURE_S = 0.0015
RECIPE = {
    "schema": 1,
    "product": "ridged test plate",
    "surface": {"pitch_um": 100.0, "design": {"ridge_angle_deg": 10.0}, "reflections": "direct"},
    "material": {"alpha_along": 0.06, "alpha_across": 0.10, "albedo": 0.2, "index": 1.5, "u_tail": 0.0},
    "acquisition": {"exposure_s": EXPOSURE_S, "frames_per_pose": 2, "dark_frames": 2, "settle_s": 0.1},
    "region": {"size_mm": [1.0, 1.0]},
    "decision": {"tolerance": 0.3},
}
FRAMES = 2 + 4 * 2
BENCH = {
    "schema": 1,
    "seed": 11,
    "sample": {
        "kind": "ridges",
        "size_mm": 1.2,
        "resolved_alpha": 0.0,  # all roughness is in the lobe, as predicted
        "reflections": False,
    },
    "sensor": {"rows": 512, "cols": 512},
    "optics": {"pixel_um": 8.0, "blur_um": 5.0, "electrons": 2.4e7},
    "stage": {"time_scale": 0.3},
    "fixture": FIXTURE,
}
# Of pictures without markers nothing can be measured, but they are quickly taken: the record says INVALID.
TILE = {**BENCH, "sample": {"kind": "white-tile"}, "sensor": {"rows": 256, "cols": 256}}
INVALID = 3


def lay_out(folder, bench):
    """Bench, recipe, rig file and flat of a rig; the stage and the light are to be set."""
    folder.mkdir(parents=True)
    part = {"driver": "simulated", "options": {"bench": "${here}/bench.toml"}}
    rig = {
        "schema": 1,
        "name": "virtual rig",
        "stage": {"driver": "elliptec", "port": "sim://elliptec?bench=${here}/bench.toml", "zero_deg": 10.0},
        "camera": part | {"pixel_um": 8.0},
        "light": part,
        "fixture": FIXTURE,
    }
    (folder / "bench.toml").write_text(tomli_w.dumps(bench | {"sample": {"kind": "white-tile"}}))
    (folder / "rig.toml").write_text(tomli_w.dumps(rig))
    take_flat(folder / "rig.toml", folder / "flat.tif", exposure_s=EXPOSURE_S, frames=4)
    (folder / "bench.toml").write_text(tomli_w.dumps(bench))
    (folder / "recipe.toml").write_text(tomli_w.dumps(RECIPE))
    return folder, rig | {"calibration": {"flat": "flat.tif"}}


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    """``start("inspect", …)`` runs the command line on a terminal of its own."""
    folder = nurseries.write_plugin(tmp_path_factory.mktemp("plugin"))
    (folder / "recipe.toml").write_text(tomli_w.dumps(RECIPE))
    with nurseries.nursery(folder, folder / "recipe.toml") as command:
        yield command


@pytest.fixture(scope="module")
def stage_port():
    """A simulated stage that moves in a process of its own, on a pseudo terminal."""
    with subprocess.Popen([sys.executable, "-Ic", STAGE], stdout=subprocess.PIPE, text=True) as process:
        yield process.stdout.readline().strip()
        process.terminate()


@pytest.fixture(scope="module")
def guarded_rig(tmp_path_factory, stage_port):
    """A rig whose stage and light outlive the program that drives them."""
    folder, rig = lay_out(tmp_path_factory.mktemp("guarded") / "rig", TILE)
    patient = {"timeout_s": 5.0}  # the stage's process may have to wait for its turn
    rig["stage"] = {"driver": "elliptec", "port": stage_port, "zero_deg": 10.0, "options": patient}
    rig["light"] = {"driver": "logged", "options": {"log": "${here}/light.log"}}
    (folder / "rig.toml").write_text(tomli_w.dumps(rig))
    return folder


def inspection_of(rig, out):
    return ("inspect", "-r", rig / "recipe.toml", "-g", rig / "rig.toml", "-s", "A1", "--out", out)


def folder_in(out):
    return next((path.parent for path in out.glob("*/job.json")), None)


def wait_for(command, out, lines):
    """Until the journal has so many lines (0: until there is a folder), or the command has ended."""
    deadline = time.monotonic() + 120
    while command.running:
        assert time.monotonic() < deadline, f"the journal never reached {lines} lines"
        folder = folder_in(out)
        if folder is not None:
            path = folder / JOURNAL
            if (path.read_bytes().count(b"\n") if path.exists() else 0) >= lines:
                return
        time.sleep(0.005)


def assert_stands(port):
    """The stage answers, has no error, and stands still."""
    with Transport(port) as line:
        said = []
        for _ in range(2):
            line.discard()
            line.write(b"0gp")
            said.append(line.read_until(b"\r\n", 30.0))
        line.write(b"0gs")
        assert line.read_until(b"\r\n", 30.0) == b"0GS00\r\n"
    assert said[0] is not None
    assert said[0].startswith(b"0PO"), said
    assert said[0] == said[1], "the stage still moves"


def disturb(start, rig, port, out, *, how, lines, delay_s):
    """One inspection that is broken off; returns whether it was finished all the same."""
    log = rig / "light.log"
    log.unlink(missing_ok=True)
    command = start(*inspection_of(rig, out))
    wait_for(command, out, lines)
    time.sleep(delay_s)
    command.interrupt(how)
    code, shown = command.finish()
    assert code in {130, INVALID}, shown
    assert "Traceback" not in shown, shown
    assert_stands(port)
    assert log.read_text().splitlines()[-1] == "off"
    folder = folder_in(out)
    if code == 130:
        assert "anisoscope: interrupted" in shown, shown
    if folder is None:
        assert code == 130
        return False
    finished = (folder / "record.json").exists()
    found = verify(folder)
    assert found.intact, found
    assert found.finished == finished
    assert finished or code == 130
    if finished:
        assert len(read_record(folder).frames) == FRAMES
    else:
        assert f"`anisoscope resume {folder}` goes on from here" in "".join(shown.split("\r\n")), shown
    return finished


WAYS = ("Ctrl-C", "SIGTERM")


def moments(count, seed):
    """Moments over the whole run: lines of the journal (one for the start, one a frame), and a delay."""
    rng = random.Random(seed)
    return [
        (WAYS[number % 2], round(number * (FRAMES + 1) / max(count - 1, 1)), rng.uniform(0.0, 0.25))
        for number in range(count)
    ]


@pytest.mark.parametrize(("how", "lines", "delay_s"), moments(10, seed=1))
def test_whenever_it_is_interrupted_the_rig_is_safe_and_the_folder_consistent(
    start, guarded_rig, stage_port, tmp_path, how, lines, delay_s
):
    disturb(start, guarded_rig, stage_port, tmp_path / "out", how=how, lines=lines, delay_s=delay_s)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(4))
def test_a_hundred_interruptions(start, guarded_rig, stage_port, tmp_path, seed):
    finished = [
        disturb(start, guarded_rig, stage_port, tmp_path / str(number), how=how, lines=lines, delay_s=delay_s)
        for number, (how, lines, delay_s) in enumerate(moments(25, seed=100 + seed))
    ]
    assert not all(finished)


def test_the_real_command_says_what_became_of_rig_and_frames(guarded_rig, stage_port, tmp_path, start):
    for attempt in range(9):  # on a busy machine an inspection may be over before Ctrl-C is pressed
        out = tmp_path / str(attempt)
        command = start(*inspection_of(guarded_rig, out))
        wait_for(command, out, 4)
        command.interrupt("Ctrl-C")
        code, shown = command.finish()
        folder = folder_in(out)
        if not verify(folder).finished and len(read_journal(folder).frames) < FRAMES:
            break
    last = "".join(shown.split("anisoscope: ")[-1].split("\r\n"))
    assert code == 130
    assert last.startswith(
        f"interrupted; the stage is stopped and the light is off; `anisoscope resume {folder}` goes on from here"
    )
    assert_stands(stage_port)
    command = start("resume", folder)
    assert command.finish()[0] == INVALID  # pictures of a tile have no markers
    assert verify(folder).intact


def test_an_interruption_without_a_rig_speaks_of_none():
    command = [sys.executable, "-Im", "anisoscope", "demo", "--out", "/dev/null/none"]
    code = "import sys; from anisoscope import cli; cli._call = lambda *_: (_ for _ in ()).throw(KeyboardInterrupt)"
    done = subprocess.run(
        [*command[:1], "-Ic", f"{code}; sys.exit(cli.run([]))"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (130, "anisoscope: interrupted\n")


@pytest.fixture(scope="module")
def virtual_rig(tmp_path_factory):
    """A rig that dies with its program, and sees a part."""
    folder, rig = lay_out(tmp_path_factory.mktemp("virtual") / "rig", BENCH)
    (folder / "rig.toml").write_text(tomli_w.dumps(rig))
    return folder


def kill_and_resume(start, rig, out, lines, delay_s):
    command = start(*inspection_of(rig, out))
    wait_for(command, out, lines)
    time.sleep(delay_s)
    command.interrupt("SIGKILL")
    code, shown = command.finish()
    assert code in {-9, 0}, shown
    folder = folder_in(out)
    if code == 0 or (folder / "record.json").exists():
        assert verify(folder).intact
        return
    named = {line.name for line in read_journal(folder).frames}
    written = {path.relative_to(folder).as_posix() for path in (folder / "frames").glob("[0-9]*")}
    assert named <= written
    assert len(written - named) <= 1  # at most the frame in flight
    assert not verify(folder).changed
    record = resume_part(folder).record
    assert record.verdict == "PASS", record.reasons
    assert verify(folder).intact
    assert recompute(folder).differences == ()


@pytest.mark.parametrize(("lines", "delay_s"), [(2, 0.0), (8, 0.05), (FRAMES + 1, 0.1)])
def test_after_kill_9_resume_completes_the_inspection(start, virtual_rig, tmp_path, lines, delay_s):
    kill_and_resume(start, virtual_rig, tmp_path / "out", lines, delay_s)


@pytest.mark.soak
def test_twenty_kills(start, virtual_rig, tmp_path):
    for number, (_, lines, delay_s) in enumerate(moments(20, seed=7)):
        kill_and_resume(start, virtual_rig, tmp_path / str(number), lines, delay_s)
