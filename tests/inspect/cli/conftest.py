import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest


@dataclass
class Done:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def json(self):
        return json.loads(self.out)


@pytest.fixture(scope="session")
def anisoscope():
    """Runs the real command line in a process of its own."""

    def run(*arguments, cwd=None, timeout=400):
        command = [sys.executable, "-Im", "anisoscope", *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout, cwd=cwd)
        return Done(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture(scope="session")
def demo_folder(anisoscope, tmp_path_factory):
    """A finished demo: recipe, rigs, flat, inspections."""
    mine = tmp_path_factory.mktemp("demo")
    # One worker makes it for all of them: a demo takes as long as a hundred tests.
    shared = Path(os.environ["ANISOSCOPE_CACHE"]) / "demo"
    try:
        shared.mkdir(parents=True)
    except FileExistsError:
        deadline = time.monotonic() + 600
        while not (shared / "made").exists():
            assert time.monotonic() < deadline, "the worker that makes the demo has failed"
            time.sleep(0.2)
    else:
        done = anisoscope("demo", "--out", shared / "demo", "--seed", 5, "--json")
        assert done.code == 0, done.err
        (shared / "made").touch()
    shutil.copytree(shared / "demo", mine, dirs_exist_ok=True)
    return mine
