"""However a run of tests ends, no process of its Dask clusters is left."""

import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
import pytest

RUN = """
import time

def test_runs_until_it_is_stopped(scheduler):
    time.sleep(600)
"""


def dask_processes(process):
    with suppress(psutil.NoSuchProcess):
        return [child for child in process.children(recursive=True) if "dask" in child.cmdline()]
    return []


@contextmanager
def run_with_a_scheduler(folder, *options):
    """A run of one test that has the scheduler of this folder's fixtures; yields the run and Dask's processes."""
    shutil.copy(Path(__file__).with_name("conftest.py"), folder)
    (folder / "test_run.py").write_text(RUN)
    command = [sys.executable, "-Im", "pytest", "-q", *options, f"--rootdir={folder}", folder]
    started = []
    streams = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, start_new_session=True, **streams) as run:
        try:
            deadline = time.monotonic() + 120
            while not (started := dask_processes(psutil.Process(run.pid))):
                assert time.monotonic() < deadline
                assert run.poll() is None
                time.sleep(0.05)
            yield run, started
        finally:
            with suppress(ProcessLookupError):
                os.killpg(run.pid, signal.SIGKILL)
            for process in started:
                with suppress(psutil.NoSuchProcess):
                    process.kill()


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="util-linux is not installed: no setpriv")
@pytest.mark.parametrize(
    ("number", "whom"),
    [(signal.SIGINT, "run"), (signal.SIGTERM, "run"), (signal.SIGKILL, "run"), (signal.SIGKILL, "worker")],
)
def test_no_process_of_dask_is_left(number, whom, tmp_path):
    pytest.importorskip("distributed")
    options = ["-n", "1"] if whom == "worker" else ["-p", "no:xdist"]
    with run_with_a_scheduler(tmp_path, *options) as (run, started):
        os.kill(started[0].ppid() if whom == "worker" else run.pid, number)
        _, left = psutil.wait_procs(started, timeout=60)
        assert left == []
