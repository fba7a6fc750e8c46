"""What the reflectance models load: nothing heavy before it is needed."""

import subprocess
import sys

MODULES = (
    "corrected",
    "printed",
    "bounces",
    "relief",
    "relief_paths",
    "optics",
    "unresolved",
    "spectrum",
    "picture",
)
HEAVY = ("numba", "scipy", "cv2", "matplotlib", "pyvista", "skimage", "pydantic")


def test_importing_the_models_loads_numpy_only():
    script = (
        "import sys\n"
        + "".join(f"import anisoscope.sim.light.{name}\n" for name in MODULES)
        + f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
