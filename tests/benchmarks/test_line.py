"""What the line adds to an inspection: StartSingleJob to ResultReady, journal and hand-over included."""

import contextlib
import importlib.util
import os
import shutil
import socket
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from anisoscope.operations.demo.ridges import SCENE

pytestmark = pytest.mark.benchmark
JOBS, ADDED_S, RESULT_READY = int(os.environ.get("ANISOSCOPE_LINE_JOBS", "40")), 0.05, 1024
PATH = Path(__file__).parents[1] / "inspect" / "line" / "controller.py"
SPEC = importlib.util.spec_from_file_location("controller", PATH)
CONTROLLER = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(CONTROLLER)


@pytest.fixture
def line(tmp_path):
    """The server, its address, and the file of its stamps."""
    rig = SCENE.lay_out(tmp_path / "demo", 1, lambda *_: None)
    (tmp_path / "recipes").mkdir()
    for name in ("recipe.toml", "reference.x3p"):
        shutil.copy(rig / name, tmp_path / "recipes")
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    places = (rig / "bench" / "good" / "rig.toml", tmp_path / "recipes", tmp_path / "out")
    script = [sys.executable, "-I", Path(__file__).with_name("line_server.py"), *places]
    stamps = tmp_path / "stamps"
    with subprocess.Popen(
        [*map(str, script), str(port), str(stamps)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as server:
        yield server, server.stdout.readline().strip(), stamps
        with contextlib.suppress(BrokenPipeError):
            server.stdin.close()


def inspection_of(stamps):
    """Begin of the latest inspection and its end, on the monotonic clock."""
    *_, begin, end = (line.split() for line in stamps.read_text().splitlines())
    assert (begin[0], end[0]) == ("begin", "end")
    return float(begin[1]), float(end[1])


def test_what_a_job_adds_to_its_inspection(bench, line):
    server, address, stamps = line
    loop = CONTROLLER.Loop()
    alone, ordered, within, before, behind = [], [], [], [], []
    try:
        controller = loop(CONTROLLER.Controller(address).__aenter__())
        loop(controller.call("SelectModeAutomatic"))
        loop(controller.prepare("recipe"))
        for number in range(-1, JOBS):  # the first one loads everything
            server.stdin.write(f"B{number + 1}\n")
            server.stdin.flush()
            assert server.stdout.readline() == "done\n"
            begin, end = inspection_of(stamps)
            began = time.monotonic()
            _, error = loop(controller.start(f"A{number + 1}"))
            assert error == 0
            event = loop(controller.next(RESULT_READY))
            heard = time.monotonic()
            assert event.ResultState == 1
            if number < 0:
                continue
            alone.append(end - begin)
            begin, end = inspection_of(stamps)
            ordered.append(heard - began)
            within.append(end - begin)
            before.append(begin - began)
            behind.append(heard - end)
        loop(controller.__aexit__())
    finally:
        loop.close()
    added, pairs = np.subtract(ordered, within), np.sort(np.subtract(ordered, alone))
    low, high = (pairs[int(one)] for one in binom.interval(0.95, len(pairs), 0.5))
    bench.note(
        f"StartSingleJob to ResultReady, {JOBS} jobs in turn with inspections without the line: "
        f"median {1e3 * statistics.median(ordered):.0f} ms, alone {1e3 * statistics.median(alone):.0f} ms; of pairs in "
        f"turn {1e3 * np.median(pairs):+.0f} ms (95 %: {1e3 * low:.0f} to {1e3 * high:.0f})"
    )
    bench.note(
        f"the line adds {1e3 * np.median(added):.0f} ms (95 %: {1e3 * np.quantile(added, 0.95):.0f} ms) around the "
        f"inspection: {1e3 * np.median(before):.0f} before it begins, {1e3 * np.median(behind):.0f} from its row in "
        f"the history to the event; within it {1e3 * np.median(np.subtract(within, alone)):+.0f} ms"
    )
    assert (
        np.median(added) <= ADDED_S
    )  # the 95 % are those of the machine's load, too: an fsync waits for others
