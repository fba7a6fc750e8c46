"""What git tracks is small and of a known kind: caches and results of a run stay out of the repository."""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LARGEST_BYTES = 6_000_000
SUFFIXES = {
    "code": {".py", ".js", ".css", ".html", ".sh", ".sql", ".ino", ".ipynb"},
    "settings": {".toml", ".lock", ".yml", ".yaml", ".cff", ".in"},
    "text": {".md", ".txt", ".po", ".mo", ".typed"},
    "pictures": {".png", ".svg", ".gif"},
    "data": {".csv", ".json", ".xml", ".npy", ".sqlite", ".xz"},
}
NAMES = {"Dockerfile", "LICENSE", "Makefile", "run", ".dockerignore", ".gitignore"}


def refused(sizes):
    """What is wrong with tracked files, a line each; ``sizes``: path -> bytes."""
    known = set().union(*SUFFIXES.values())
    wrong = []
    for path, size in sizes.items():
        if size > LARGEST_BYTES:
            wrong.append(f"{path}: {size / 1e6:.1f} MB, over {LARGEST_BYTES / 1e6:.0f} MB")
        kind = Path(path).suffix or Path(path).name
        if kind not in known | NAMES:
            wrong.append(f"{path}: no list of this test names {kind}")
    return wrong


def test_tracked_files_are_small_and_of_a_known_kind():
    try:
        listed = subprocess.run(
            ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False, timeout=60
        )
    except OSError as error:
        pytest.skip(f"git cannot be run: {error}")
    paths = [path for path in listed.stdout.split("\0") if (ROOT / path).is_file()]
    if not paths:
        pytest.skip(f"no git checkout: {listed.stderr.strip() or 'git tracks nothing here'}")
    assert refused({path: (ROOT / path).stat().st_size for path in paths}) == []


def test_a_large_file_a_database_and_an_unknown_name_are_refused():
    sizes = {
        "docs/large.png": 7_000_000,
        ".mypy_cache_new/3.11/cache.0.db": 10,
        "notes": 10,
        "rig/stage.py": 10,
    }
    assert refused(sizes) == [
        "docs/large.png: 7.0 MB, over 6 MB",
        ".mypy_cache_new/3.11/cache.0.db: no list of this test names .db",
        "notes: no list of this test names notes",
    ]
    assert refused({"tests/data/parts.tar.xz": 5_900_000, ".ci/run": 1, "Makefile": 1, ".gitignore": 1}) == []


def test_files_of_others_have_their_licence_in_the_metadata():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    texts = [
        file.read_text(encoding="utf-8") for glob in project["license-files"] for file in ROOT.glob(glob)
    ]
    for path in (ROOT / "inspect" / "line" / "data").glob("*.xml"):
        holder = re.search(r"Copyright \(c\) .*", path.read_text(encoding="utf-8"))[0]
        assert any(path.name in text and holder in text for text in texts), path.name
    assert "MIT" in project["license"].split(" AND ")
