"""Modules, what is in them, and files of the repository that pages and docstrings name exist."""

import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PLACES = {
    "anisoscope": "inspect",
    "anisoscope/rig": "rig",
    "anisoscope/profiles": "profiles",
    "anisoscope/sim": "sim",
}
DOTTED = re.compile(r"(?<!`)`~?([a-z_]\w*(?:\.\w+)+)`(?!`)")
REPOSITORY_FILE = re.compile(r"(?<![\w./-])(?:tests|tools|docs)/[\w./-]*\.(?:py|sh|md|toml|csv|json)\b")
_GROUPS = ("cameras", "lights", "stages", "serial_handlers", "wheels", "defects", "height_maps", "bsdf_files")
ENTRY_POINTS = {f"anisoscope.{group}" for group in _GROUPS}
FILES = ("csv", "html", "json", "jsonl", "npz", "png", "py", "sha256", "sqlite", "tif", "toml", "typed")
TABLES = {
    "area",
    "camera",
    "decision",
    "defects",
    "diagnosis",
    "light",
    "limits",
    "material",
    "optics",
    "print",
    "rig",
    "sample",
}
TABLES |= {"acquisition", "options", "sensor", "stage", "surface"}
"""Tables of recipe, rig file, bench and record, which are called like modules: their keys are no names of code."""
OTHERS = {"serial"}
"""Packages of others that one of our modules shares its name with."""


@cache
def modules():
    """Source files by dotted name."""
    found = {}
    for place, folder in PLACES.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = [*place.split("/"), *path.relative_to(ROOT / folder).with_suffix("").parts]
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def words(path):
    return frozenset(re.findall(r"\w+", path.read_text(encoding="utf-8")))


def exists(name):
    """Whether a full name is a module, or something that its module defines."""
    if name in modules():
        return True
    parts = name.split(".")
    holder = next(
        (".".join(parts[:k]) for k in range(len(parts) - 1, 1, -1) if ".".join(parts[:k]) in modules()), ""
    )
    return bool(holder) and set(parts[holder.count(".") + 1 :]) <= words(modules()[holder])


def stale(text):
    """Dotted names in backticks that look like ours, in full or from a package or module on, and name nothing."""
    for name in sorted(set(DOTTED.findall(text)) - ENTRY_POINTS):
        first, _, rest = name.partition(".")
        if first == "anisoscope":
            if rest not in FILES and not exists(name):
                yield name
        elif first not in TABLES | OTHERS and rest.rpartition(".")[2] not in FILES:
            homes = [one for one in modules() if one.endswith(f".{first}")]
            if homes and not any(exists(f"{home}.{rest}") for home in homes):
                yield name


def test_stale_names_are_found():
    text = "`sim.nothing`, `anisoscope.sim.bench.bench.Bunch`, `report.page`, `rig.toml`, `numpy.nothing`, `sim.light`"
    assert list(stale(text)) == ["anisoscope.sim.bench.bench.Bunch", "sim.nothing"]


@pytest.mark.parametrize("folder", ["docs", "inspect", "profiles", "rig", "sim"])
def test_names_in_backticks_exist(folder):
    paths = sorted((ROOT / folder).rglob("*.md" if folder == "docs" else "*.py"))
    paths = [
        path for path in paths if ROOT / "docs" / "reference" not in path.parents
    ]  # written by make docs
    assert len(paths) > 20
    found = {str(path.relative_to(ROOT)): list(stale(path.read_text(encoding="utf-8"))) for path in paths}
    assert {path: names for path, names in found.items() if names} == {}


def test_files_of_the_repository_that_are_named_exist():
    texts = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    texts += [path for place in PLACES.values() for path in (ROOT / place).rglob("*.py")]
    named = {
        (str(path.relative_to(ROOT)), name)
        for path in texts
        if ROOT / "docs" / "reference" not in path.parents
        for name in REPOSITORY_FILE.findall(path.read_text(encoding="utf-8"))
    }
    assert len({name for _, name in named}) > 20
    assert sorted((where, name) for where, name in named if not (ROOT / name).exists()) == []
