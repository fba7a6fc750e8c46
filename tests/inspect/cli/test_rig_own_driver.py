"""The example of docs/own-driver.md, installed by pip as a third party's package is."""

import json
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from anisoscope.rig.frame import read_frame

DOCS = Path(__file__).resolve().parents[3] / "docs"
EXAMPLE = DOCS / "examples" / "turntable"


def build_wheel(folder):
    """The wheel of the example, as its pyproject.toml describes it; built here: building tools may be missing."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text(encoding="utf-8"))
    name, version = project["project"]["name"].replace("-", "_"), project["project"]["version"]
    points = "".join(
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in entries.items())
        for group, entries in project["project"]["entry-points"].items()
    )
    files = {
        f"{module}.py": (EXAMPLE / f"{module}.py").read_text()
        for module in project["tool"]["setuptools"]["py-modules"]
    }
    about = f"{name}-{version}.dist-info"
    files[f"{about}/METADATA"] = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
    files[f"{about}/WHEEL"] = (
        "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    )
    files[f"{about}/entry_points.txt"] = points
    files[f"{about}/RECORD"] = "".join(f"{path},,\n" for path in [*files, f"{about}/RECORD"])
    wheel = folder / f"{name}-{version}-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        for path, content in files.items():
            archive.writestr(path, content)
    return wheel


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The folder into which pip installed the example, with its entry points."""
    folder = tmp_path_factory.mktemp("third party")
    target = folder / "installed"
    options = ["--quiet", "--no-deps", "--no-index", "--disable-pip-version-check"]
    command = [
        sys.executable,
        "-m",
        "pip",
        "install",
        *options,
        "--target",
        str(target),
        str(build_wheel(folder)),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=200)
    assert done.returncode == 0, done.stderr
    return target


@pytest.fixture
def with_example(anisoscope, installed, tmp_path):
    """Runs the command line with the example installed."""
    return lambda *arguments: anisoscope(*arguments, cwd=tmp_path, path=[installed])


def test_status_names_the_devices_of_the_third_party(with_example):
    done = with_example("rig", "status", "-g", EXAMPLE / "rig.toml", "--json")
    assert done.code == 0, done.out + done.err
    found = json.loads(done.out)
    assert found["stage"]["device"] == "turntable at COM3"
    assert found["stage"]["limits_deg"] == [0.0, 350.0]
    assert found["camera"]["device"] == "grating camera G-1"


def test_its_stage_keeps_the_motion_rules(with_example):
    rig = EXAMPLE / "rig.toml"
    done = with_example("rig", "move", "30", "--sample", "-g", rig, "--yes")
    assert done.out == "stage turntable at COM3: was at 0.000°, is at 35.000° (part 30.000°)\n", done.err
    done = with_example("rig", "move", "355", "-g", rig, "--yes")
    assert (done.code, "355° is outside 0°…350°" in done.err) == (69, True)


def test_its_camera_takes_pictures(with_example, tmp_path):
    done = with_example(
        "rig", "snap", "-g", EXAMPLE / "rig.toml", "--exposure", 0.005, "--out", "a.tif", "--json"
    )
    assert done.code == 0, done.err
    frame, found = read_frame(tmp_path / "a.tif"), json.loads(done.out)
    assert frame.camera == "grating camera G-1"
    assert frame.stage_deg == -5.0
    assert found["ridge_deg"] == pytest.approx(0.0, abs=0.1)
    assert found["mean_counts"] == pytest.approx(64 + 1000, rel=0.01)


def test_without_the_package_its_name_is_unknown(anisoscope):
    done = anisoscope("rig", "status", "-g", EXAMPLE / "rig.toml")
    assert done.code == 69
    assert "there is no stage driver 'turntable'; installed: apt" in done.out


def test_what_the_page_shows_is_in_the_files():
    page = (DOCS / "own-driver.md").read_text(encoding="utf-8")
    for language, name in (("python", "turntable.py"), ("toml", "pyproject.toml")):
        (shown,) = re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)
        assert shown in (EXAMPLE / name).read_text(encoding="utf-8"), name
