"""The public names: all of them in the page, every example runs, and importing them costs little."""

import ast
import doctest
import json
import re
import subprocess
import sys
import tarfile
from importlib.metadata import version
from pathlib import Path

import pytest

import anisoscope.api as an
from anisoscope.rig.frame import read_frame
from anisoscope.rig.framefolder import write_frame_folder

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "examples" / "api.md"
ARCHIVE = ROOT / "tests" / "data" / "inspections" / "ridges.tar.xz"
RECIPE = """schema = 1
product = "ridged test plate"
[surface]
pitch_um = 100.0
reflections = "direct"
[surface.design]
ridge_angle_deg = 10.0
edge_radius_um = 0.0
[material]
alpha_along = 0.06
alpha_across = 0.1
albedo = 0.2
index = 1.5
[poses]
tilts_deg = [0.0]
[acquisition]
exposure_s = 0.0015
frames_per_pose = 2
dark_frames = 2
[region]
size_mm = [1.0, 1.0]
[decision]
tolerance = 0.5
"""
DESK = """schema = 1
name = "desk"
[stage]
driver = "elliptec"
port = "sim://elliptec?time_scale=0"
[camera]
driver = "folder"
pixel_um = 16.0
[camera.options]
folder = "${here}/frames"
[light]
driver = "none"
angle_deg = 10.0
"""


@pytest.fixture
def job(tmp_path, monkeypatch):
    """A folder with a recipe, a rig file, and the frames of an archived inspection as another program leaves them."""
    monkeypatch.chdir(tmp_path)
    with tarfile.open(ARCHIVE) as packed:
        packed.extractall(tmp_path, filter="data")
    done = tmp_path / "ridges"
    entries = json.loads((done / "record.json").read_text(encoding="utf-8"))["frames"]
    frames = [read_frame(done / entry["name"]) for entry in entries]
    write_frame_folder(tmp_path / "frames", frames, [entry["again"] for entry in entries])
    for name in ("rig.toml", "flat.tif", "flat.json"):
        (done / "inputs" / name).rename(tmp_path / name)
    (tmp_path / "recipe.toml").write_text(RECIPE, encoding="utf-8")
    (tmp_path / "desk.toml").write_text(DESK, encoding="utf-8")


@pytest.mark.usefixtures("job")
def test_every_example_of_the_page_runs():
    import matplotlib.pyplot as plt

    try:
        outcome = doctest.testfile(
            str(PAGE), module_relative=False, encoding="utf-8", optionflags=doctest.ELLIPSIS
        )
    finally:
        plt.close("all")
    assert outcome.failed == 0
    assert outcome.attempted > 50


def test_every_public_name_has_an_example():
    examples = "\n".join(
        example.source for example in doctest.DocTestParser().get_examples(PAGE.read_text("utf-8"))
    )
    assert set(an.__all__) - set(re.findall(r"\ban\.(\w+)", examples)) == set()


def test_the_list_for_type_checkers_is_the_list_of_modules():
    """The block of imports under TYPE_CHECKING, and the functions of the page, are `__all__`."""
    tree = ast.parse((ROOT / "inspect" / "api.py").read_text(encoding="utf-8"))
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)} - {
        "__getattr__",
        "__dir__",
        "_homes",
    }
    assert set(an._homes()) | functions == set(an.__all__) == set(dir(an))
    assert list(an.__all__) == sorted(an.__all__)


@pytest.mark.parametrize("name", an.__all__)
def test_every_name_is_there_and_says_what_it_is(name):
    assert getattr(an, name).__doc__


def test_the_version_is_that_of_the_distribution():
    assert an.__version__ == version("anisoscope")


def test_a_name_that_is_none_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'measure'"):
        an.measure  # noqa: B018


def test_importing_the_names_loads_nothing_heavy():
    script = (
        "import sys, anisoscope.api; print({'numpy', 'pydantic', 'matplotlib', 'numba'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize(
    ("call", "why"),
    [
        (
            lambda: an.drivers("nonsense"),
            "no group of drivers is called 'nonsense'; there are stages, cameras, lights",
        ),
        (
            lambda: an.predict(3),
            "predict takes a HeightMap or a RidgeDesign, or the file of a map or a recipe, not int",
        ),
        (lambda: an.texture(3), "texture takes a HeightMap, not int"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(call, why):
    with pytest.raises(an.UsageError) as refused:
        call()
    assert str(refused.value) == why
