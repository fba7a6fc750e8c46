"""Without VTK everything but the 3-D view works, and the view says what is missing."""

import subprocess
import sys

import pytest

PROGRAM = """
import importlib.util, sys
HIDDEN = {"vtk", "vtkmodules", "trame_vtk"}

class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in HIDDEN:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Hidden())
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, package=None: None if name in HIDDEN else find(name, package)

from anisoscope.cli import run
for line in sys.argv[1:]:
    code = run(line.split())
    print("code", code)
"""
LINES = (
    "profile make ridges --size 120,240 --pitch 60 --out map.npz",
    "predict map.npz",
    "profile view map.npz --out view.html",
)


@pytest.mark.soak
def test_commands_need_no_vtk_and_the_3d_view_says_so(tmp_path):
    found = subprocess.run(
        [sys.executable, "-Ic", PROGRAM, *LINES], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    codes = [line for line in found.stdout.splitlines() if line.startswith("code")]
    assert codes == ["code 0"] * 3, found.stderr
    assert "VTK is not installed" in found.stdout + found.stderr
    assert "internal error" not in found.stderr
