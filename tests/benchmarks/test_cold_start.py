"""Processor time of commands in a process of their own, against the import of numpy, OpenCV and scipy.optimize."""

import subprocess
import sys

import pytest

from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import RidgeDesign, ridges

pytestmark = pytest.mark.benchmark

IMPORT = ("-c", "import numpy, cv2, scipy.optimize")
COMMANDS = (
    ("--help",),
    ("profile", "info", "map.x3p"),
    ("predict", "--ridge-angle", "10"),
    ("predict", "map.x3p", "--pitch", "100"),
    ("history", "--history", "none.sqlite"),
)


def process(folder, *arguments):
    """A process of its own, from its start to its end; a history that does not exist is an error."""

    def work():
        done = subprocess.run([sys.executable, *arguments], cwd=folder, capture_output=True, check=False)
        assert done.returncode in (0, 64, 74), arguments

    return work


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_cold_start(bench, tmp_path, command):
    write_height_map(ridges(RidgeDesign(100.0, 10.0), (1000, 1000), 1.0), tmp_path / "map.x3p")
    libraries = f"`python -c '{IMPORT[1]}'`"
    found = bench.compare(
        f"`anisoscope {' '.join(command)}`",
        {"command": process(tmp_path, "-m", "anisoscope", *command), libraries: process(tmp_path, *IMPORT)},
    )
    if command == ("--help",):
        assert found.ratio("command", libraries) < 1.0  # no command and no library of numbers is loaded
