"""What the reflectance models load: nothing heavy before it is needed, and for a design not even then."""

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


def test_a_design_is_predicted_without_compiler_and_scipy():
    script = (
        "import sys\n"
        "from anisoscope.prediction.predict import predict_design\n"
        "from anisoscope.parameters.geometry import Convention\n"
        "from anisoscope.parameters.inputs import InputUncertainty\n"
        "from anisoscope.parameters.material import Material\n"
        "from anisoscope.parameters.ridges import RidgeDesign\n"
        "from anisoscope.sim.light.geometry import pose_grid\n"
        "poses, inputs = pose_grid((0.0, 90.0), (0.0,)), InputUncertainty()\n"
        "found = predict_design(RidgeDesign(100.0, 10.0), Material(), poses, Convention(), inputs=inputs)\n"
        f"print(found.notes['bounces'], [name for name in {HEAVY!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "all []"
