"""``design plate`` of 256 × 256 fields with all its files, and a code of 256 fields from its text to its verdict."""

import json
import os
import re
import subprocess
import sys

import cv2
import pytest
import skimage.data

from anisoscope.api import design_code

pytestmark = pytest.mark.benchmark
FIELDS, LONGEST_S, MOST_KB = 256, 60.0, 2e6
# The memory that wait4 reports of a process begins with that of the process which started it.
TELLING = """
import atexit, pathlib, sys
from anisoscope.__main__ import main
atexit.register(lambda: sys.stderr.write(pathlib.Path("/proc/self/status").read_text()))
main()
"""


def test_a_plate_of_256_fields_a_side(bench, tmp_path):
    pictures = {
        "a.png": skimage.data.camera(),
        "b.png": cv2.cvtColor(skimage.data.astronaut(), cv2.COLOR_RGB2GRAY),
    }
    for name, one in pictures.items():
        cv2.imwrite(str(tmp_path / name), one)
    command = [sys.executable, "-Ic", TELLING, "design", "plate", *pictures, "--field-count", str(FIELDS)]
    command += ["--stl", "--path", "--out", "plate", "--overwrite", "--json"]

    def designed():
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        with subprocess.Popen(command, cwd=tmp_path, **pipes) as process:
            content, said = json.loads(process.stdout.read()), process.stderr.read()
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        assert process.returncode == 0, said
        return content, used, int(re.search(r"VmHWM:\s*(\d+) kB", said)[1])

    found = bench.compare(
        f"{FIELDS} × {FIELDS} fields, two pictures", {"design plate": designed}, 1, warm=False
    )
    content, used, peak_kb = found["design plate"].result
    bench.note(f"{1e-6 * peak_kb:.2f} GB at most; SSIM {min(content['ssim']):.3f} and more")
    assert content["fields"] == [FIELDS, FIELDS]
    assert min(content["ssim"]) > 0.8
    assert used.ru_utime + used.ru_stime < LONGEST_S
    assert peak_kb < MOST_KB


def test_a_code_of_256_fields_is_designed_photographed_and_judged(bench, tmp_path):
    """The recipe as written, on the virtual rig at three stage angles."""

    def tried():
        return design_code("LOT 7-XY", tmp_path / "code", trial=True, overwrite=True)

    found = bench.compare("a code of 16 × 16 fields", {"design code --trial": tried}, 1, warm=False)
    code = found["design code --trial"].result
    record = json.loads(code.trial.report.with_name("record.json").read_text(encoding="utf-8"))
    bench.note(f"p = {record['p_value']:.2g} of its classes")
    assert (len(code.plan.rows), len(code.plan.rows[0])) == (16, 16)
    assert record["details"]["code"]["readings"][:2] == ["LOT 7-XY"] * 2
    assert code.trial.verdict == "PASS"
