"""Finished inspections of schema 1, as an earlier version wrote them, give the same answers as they did then."""

import json
import tarfile
from pathlib import Path

import pytest

DATA = Path(__file__).parents[2] / "data" / "inspections"
KINDS = ("ridges", "print", "wafer")
MADE = "/tmp/arch/work"  # where recipe and rig of the archived inspections were

PAIRS = (("ridges", "wafer"), ("ridges", "print"), ("print", "wafer"))


@pytest.fixture(scope="module")
def archive(tmp_path_factory, anisoscope):
    """The unpacked folders, and a history that holds all three."""
    folder = tmp_path_factory.mktemp("archive")
    for kind in KINDS:
        with tarfile.open(DATA / f"{kind}.tar.xz") as packed:
            packed.extractall(folder, filter="data")
    history = f"sqlite:///{folder / 'history.sqlite'}"
    for kind in KINDS:
        done = anisoscope("history", "add", kind, "--history", history, cwd=folder)
        assert done.code == 0, done.err
    return folder, history


def _then(name, folder):
    text = (DATA / "expected" / name).read_text(encoding="utf-8").replace("FOLDER", str(folder))
    return json.loads(text) if name.endswith(".json") else text


def _without_hash(content):
    """Without the hashes that chain the history, which cover the folder's path, and the causes, which came later."""
    if isinstance(content, dict):
        return {
            key: _without_hash(value)
            for key, value in content.items()
            if key != "hash" and not key.startswith("cause ")
        }
    if isinstance(content, list):
        return [
            _without_hash(one)
            for one in content
            if not (isinstance(one, dict) and str(one.get("label", "")).startswith("cause "))
        ]
    return content


def _then_without_origin(name, folder):
    return _without_hash(json.loads(json.dumps(_then(name, folder)).replace("MADE", MADE)))


UNSIGNED = "note: the record is not signed\n"


@pytest.mark.parametrize("kind", KINDS)
def test_verify_says_what_it_said(archive, anisoscope, kind):
    folder, _ = archive
    found = anisoscope("verify", kind, "--json", cwd=folder).json
    later = (
        ("report_written", True),
        ("signed_by", None),
        ("distrust", []),
        ("origin", ""),
        ("report_signed", None),
        ("judged_anew", ""),
        ("number", None),
    )  # keys that came later
    assert all(found.pop(key) == value for key, value in later)
    assert found == _then(f"verify-{kind}.json", folder)
    done = anisoscope("verify", kind, cwd=folder)
    assert UNSIGNED in done.out
    assert f"{done.out.replace(UNSIGNED, '')}exit {done.code}\n" == _then(f"verify-{kind}.txt", folder)


@pytest.mark.parametrize("kind", KINDS)
def test_recompute_finds_every_number_as_recorded(archive, anisoscope, kind):
    folder, _ = archive
    found = anisoscope("recompute", kind, "--json", cwd=folder).json
    notes = found.pop("notes")  # on numbers that the version then did not record
    then = _then(f"recompute-{kind}.json", folder)
    del then["notes"]
    assert found == then
    assert any("not compared" in note for note in notes)
    assert found["same"]
    assert found["differences"] == []


@pytest.mark.parametrize("kind", KINDS)
def test_show_tells_the_same_numbers(archive, anisoscope, kind):
    folder, history = archive
    found = anisoscope("show", kind, "--history", history, "--json", cwd=folder).json
    assert found.pop("finding").endswith(".")  # in words of today
    assert found.pop("action").endswith(".")
    assert _without_hash(found) == _then(f"show-{kind}.json", folder)


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_compare_tells_the_same_differences(archive, anisoscope, first, second):
    folder, history = archive
    found = anisoscope("compare", first, second, "--history", history, "--json", cwd=folder).json
    assert _without_hash(found) == _then_without_origin(f"compare-{first}-{second}.json", folder)
