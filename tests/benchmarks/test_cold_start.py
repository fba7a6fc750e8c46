"""Processor time of commands in a process of their own, against the import of numpy, OpenCV and scipy.optimize.

Commands and the import alternate, and children's processor time is measured, so that other load counts little.
"""

import os
import statistics
import subprocess
import sys

import pytest

from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import RidgeDesign, ridges

IMPORT = ("-c", "import numpy, cv2, scipy.optimize")
COMMANDS = (
    ("--help",),
    ("profile", "info", "map.x3p"),
    ("predict", "--ridge-angle", "10"),
    ("predict", "map.x3p", "--pitch", "100"),
    ("history", "--history", "none.sqlite"),
)
ROUNDS = 5


def processor_s(folder, *arguments):
    """User and system time of one child in seconds; POSIX."""
    child = subprocess.Popen(
        [sys.executable, *arguments], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    _, state, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(state)
    assert child.returncode in (0, 64, 74), arguments  # a history that does not exist is an error
    return used.ru_utime + used.ru_stime


@pytest.mark.benchmark
def test_cold_start(tmp_path):
    write_height_map(ridges(RidgeDesign(100.0, 10.0), (1000, 1000), 1.0), tmp_path / "map.x3p")
    print(f"\nprocessor time in s, {ROUNDS} rounds in turn with `python -c '{IMPORT[1]}'`")
    for command in COMMANDS:
        processor_s(tmp_path, "-m", "anisoscope", *command)  # what is compiled and cached once
        pairs = [
            (processor_s(tmp_path, "-m", "anisoscope", *command), processor_s(tmp_path, *IMPORT))
            for _ in range(ROUNDS)
        ]
        ours, imports = zip(*pairs, strict=True)
        ratio = min(ours) / min(imports)
        print(
            f"{' '.join(command):32} min {min(ours):.2f} median {statistics.median(ours):.2f}; import min "
            f"{min(imports):.2f} median {statistics.median(imports):.2f}; ratio {ratio:.2f}"
        )
        if command == ("--help",):
            assert ratio < 1.0  # no command and no library of numbers is loaded
