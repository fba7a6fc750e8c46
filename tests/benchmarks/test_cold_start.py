"""Processor time of commands in a process of their own, against the import of numpy, OpenCV and scipy.optimize.

What a command finds in the cache of results is there from the call before the first round, as at a user's second call;
a prediction that was not asked for before is timed too. An inspection is that of the demo's good part, from frames on
disk: without its camera's time. The first one with a recipe finds in the cache what `anisoscope warm` leaves there.
"""

import os
import re
import shutil
import subprocess
import sys
import urllib.request

import pytest

from anisoscope.base.progress import silent
from anisoscope.inspection.run import inspect_part
from anisoscope.operations.demo.ridges import SCENE
from anisoscope.operations.predict import CACHED
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import ridges
from anisoscope.record.schema import read_record
from anisoscope.rig.frame import read_frame
from anisoscope.rig.framefolder import write_frame_folder

pytestmark = pytest.mark.benchmark

IMPORT = ("-c", "import numpy, cv2, scipy.optimize")
INSPECTION = 7.5  # times the import of the libraries
LIBRARIES = f"`python -c '{IMPORT[1]}'`"
COMMANDS = (
    ("--help",),
    ("profile", "info", "map.x3p"),
    ("predict", "--ridge-angle", "10"),
    ("predict", "map.x3p", "--pitch", "100"),
    ("history", "--history", "none.sqlite"),
)


def process(folder, *arguments, **environment):
    """A process of its own, from its start to its end; a history that does not exist is an error."""

    def work():
        done = subprocess.run(
            [sys.executable, *arguments],
            cwd=folder,
            env={**os.environ, **environment},
            capture_output=True,
            check=False,
        )
        assert done.returncode in (0, 64, 74), arguments

    return work


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_cold_start(bench, tmp_path, command):
    write_height_map(ridges(RidgeDesign(100.0, 10.0), (1000, 1000), 1.0), tmp_path / "map.x3p")
    works = {
        "command": process(tmp_path, "-m", "anisoscope", *command),
        LIBRARIES: process(tmp_path, *IMPORT),
    }
    if command[0] == "predict":
        cache = tmp_path / "cache"
        again = process(tmp_path, "-m", "anisoscope", *command, ANISOSCOPE_CACHE=str(cache))
        works["the same, not asked before"] = lambda: (
            shutil.rmtree(cache / CACHED, ignore_errors=True),
            again(),
        )
    found = bench.compare(f"`anisoscope {' '.join(command)}`", works)
    if command == ("--help",):
        assert found.ratio("command", LIBRARIES) < 1.0  # no command and no library of numbers is loaded


def test_rig_answers(bench, tmp_path):
    rig = SCENE.lay_out(tmp_path / "demo", 1, silent) / "bench" / "good" / "rig.toml"
    works = {
        "command": process(tmp_path, "-m", "anisoscope", "rig", "status", "--rig", str(rig)),
        LIBRARIES: process(tmp_path, *IMPORT),
    }
    bench.compare("`anisoscope rig status` of a virtual rig", works)


def test_first_page_of_the_console(bench, tmp_path):
    folder = SCENE.lay_out(tmp_path / "demo", 1, silent)
    rig = folder / "bench" / "good" / "rig.toml"
    command = ["serve", "--rig", str(rig), "--recipes", str(folder), "--out", str(tmp_path), "--port", "0"]

    def first_page():
        started = [sys.executable, "-m", "anisoscope", *command]
        with subprocess.Popen(
            started, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        ) as server:
            assert server.stdout is not None
            with urllib.request.urlopen(re.search(r"http\S+", server.stdout.readline())[0]) as page:
                assert b'id="station"' in page.read()
            server.kill()

    works = {"command": first_page, LIBRARIES: process(tmp_path, *IMPORT)}
    found = bench.compare("`anisoscope serve`, from its start to the first page of the station", works)
    bench.note(f"on the clock {found.wall_ratio('command', LIBRARIES):.1f} x")


def test_cold_inspection_of_frames(bench, tmp_path):
    folder = SCENE.lay_out(tmp_path / "demo", 1, silent)
    rig = folder / "bench" / "good" / "rig.toml"
    taken = inspect_part(folder / "recipe.toml", rig, "A1", folder / "out")
    shots = [read_frame(taken.folder / entry.name) for entry in taken.record.frames]
    write_frame_folder(folder / "frames", shots, [entry.again for entry in taken.record.frames])
    command = [
        "inspect",
        "--recipe",
        "recipe.toml",
        "--rig",
        str(rig),
        "--serial",
        "A1",
        "--frames",
        "frames",
    ]
    command += ["--out", str(tmp_path / "judged")]
    cache = tmp_path / "cache"
    job = process(folder, "-m", "anisoscope", *command, ANISOSCOPE_CACHE=str(cache))

    def first():
        for kind in cache.iterdir():
            if kind.is_dir():
                shutil.rmtree(kind)
        job()

    works = {"command": job, LIBRARIES: process(folder, *IMPORT), "the first with a recipe": first}
    # the first in a round follows the last of the round before, which has filled the cache
    found = bench.compare(f"`anisoscope inspect --frames` of {len(shots)} frames of a megapixel", works)
    verdicts = {read_record(path.parent).verdict for path in (tmp_path / "judged").glob("*/record.json")}
    bench.note(f"verdicts {', '.join(verdicts)}; record, history and report included")
    assert verdicts == {taken.record.verdict}
    assert found.ratio("command", LIBRARIES) <= INSPECTION
