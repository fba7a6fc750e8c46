"""What the Makefile does for who edits: packages laid for checkers, and the tests of one module."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")


def make(*arguments):
    """Run make with this environment taken as complete, whatever is newer than it."""
    command = ["make", "--no-print-directory", "-o", f"{sys.prefix}/.dev", f"VENV={sys.prefix}", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=120)


@pytest.fixture
def tree():
    assert make("tree").returncode == 0
    return ROOT / "build" / "tree" / "anisoscope"


def modules(folder):
    return {path.relative_to(folder) for path in folder.rglob("*.py")}


def test_checkers_see_every_module_as_a_wheel_lays_it(tree):
    for package in ("rig", "profiles", "sim"):
        assert modules(tree / package) == modules(ROOT / package)
    for entry in (ROOT / "inspect").iterdir():
        assert entry.name == "__pycache__" or (tree / entry.name).samefile(entry)


def test_a_link_of_a_package_that_is_gone_goes(tree):
    (tree / "gone").symlink_to("../../../inspect/gone")
    assert make("tree").returncode == 0
    assert not (tree / "gone").is_symlink()


@pytest.mark.parametrize(
    ("file", "tests"),
    [
        ("inspect/decision/decision.py", "tests/inspect/decision/test_decision.py"),
        ("rig/frame.py", "tests/rig/test_frame.py"),
        ("tests/rig/test_frame.py", "tests/rig/test_frame.py"),
    ],
)
def test_quick_runs_the_tests_that_mirror_a_file(file, tests):
    assert make("-n", "quick", f"FILE={file}").stdout.endswith(f"-Im pytest -q {tests}\n")


def test_quick_says_in_a_line_what_is_missing():
    done = make("quick", "FILE=inspect/report/wording.py")
    assert done.stderr.splitlines()[0] == (
        "quick: no test mirrors inspect/report/wording.py: write tests/inspect/report/test_wording.py, "
        "or say TESTS=tests/..."
    )
    done = make("quick", "FILE=inspect/nothing.py")
    assert done.stderr.startswith("quick: no file 'inspect/nothing.py'; say FILE=")


def test_what_runs_is_locked_in_the_versions_that_are_tested():
    """Otherwise pip installs one version for the demo, and another one, with complaints, for the tests."""

    def pinned(name):
        return {line.rstrip(" \\") for line in (ROOT / name).read_text().splitlines() if "==" in line}

    assert pinned("requirements.lock") - pinned("requirements-dev.lock") == set()
