import json
import subprocess
import sys
from dataclasses import dataclass

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

    def run(*arguments, cwd=None, timeout=120):
        command = [sys.executable, "-Im", "anisoscope", *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout, cwd=cwd)
        return Done(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture(scope="session")
def demo_folder(anisoscope, tmp_path_factory):
    """A finished demo: recipe, rigs, flat, inspections."""
    folder = tmp_path_factory.mktemp("demo")
    done = anisoscope("demo", "--out", folder, "--seed", 5, "--json")
    assert done.code == 0, done.err
    return folder
