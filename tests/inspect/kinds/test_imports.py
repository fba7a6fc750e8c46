"""What the kinds of parts load: all of them, to find the one that a recipe is of."""

import subprocess
import sys

from anisoscope.base.plugins import installed
from anisoscope.record.details import GROUP

HEAVY = ("numba", "scipy", "matplotlib", "pyvista", "skimage", "zxingcpp", "PIL")


def test_importing_all_kinds_loads_no_library_that_is_slow_to_import():
    modules = ", ".join(entry.module for entry in installed(GROUP).values())
    script = f"import sys, {modules}\nprint([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
