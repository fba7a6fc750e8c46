"""What the reflectance models load: nothing heavy before it is needed."""

import subprocess
import sys

MODULES = (
    "light.corrected",
    "light.printed",
    "light.bounces",
    "light.relief",
    "light.relief_paths",
    "light.optics",
    "light.unresolved",
    "light.picture",
)
HEAVY = ("numba", "scipy", "cv2", "matplotlib", "pyvista", "skimage", "pydantic")


def test_importing_the_models_loads_numpy_only():
    script = (
        "import sys\n"
        + "".join(f"import anisoscope.sim.{name}\n" for name in MODULES)
        + f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
