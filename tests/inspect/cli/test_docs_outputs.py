"""Printed results of the pages are those of today."""

import importlib.util
import json
import shlex
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def outputs():
    spec = importlib.util.spec_from_file_location("docs_outputs", ROOT / "tools" / "docs_outputs.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def here(demo_folder, tmp_path_factory):
    """A folder in which the demo has run."""
    folder = tmp_path_factory.mktemp("reader")
    (folder / "demo-output").symlink_to(demo_folder, target_is_directory=True)
    return folder


def test_pages_show_what_the_commands_print_today(outputs, anisoscope, demo, here):
    known, wrong = {}, []
    for page in outputs.pages():
        for command, lines in outputs.shown(page.read_text(encoding="utf-8")):
            if command == outputs.DEMO:
                known[command] = outputs.demo_lines((demo[0].parent / "said.json").read_text())
            elif command not in known:
                done = anisoscope("-q", *shlex.split(command)[1:], cwd=here)
                assert done.code in {0, 1, 2, 3}, done.err
                known[command] = outputs.plain(done.out)
            wrong += [(page.name, command, *pair) for pair in outputs.differences(lines, known[command])]
    assert wrong == [], "make docs-outputs"
    assert len(known) >= 8


def test_a_changed_word_or_number_is_found(outputs):
    assert outputs.same("height 17.10 µm", "height   17.11 µm")
    assert not outputs.same("height 17.10 µm", "depth 17.10 µm")
    assert not outputs.same("height 17.10 µm", "height 17.40 µm")
    assert not outputs.same("10 ridges", "11 ridges")
    assert outputs.differences(["a", "…", "z"], ["a", "b", "c", "z"]) == []
    assert outputs.differences(["a", "…", "z"], ["a", "b", "y"]) == [("z", "y")]
    page = "```console\n$ one\nold 1.00\n$ two\nsame 2.00\n```\n"
    today = {"one": ["new 1.00"], "two": ["same 2.01"]}
    assert outputs.rewritten(page, today.get) == "```console\n$ one\nnew 1.00\n$ two\nsame 2.00\n```\n"


def test_no_picture_is_older_than_what_makes_it(outputs, monkeypatch, tmp_path):
    """Where one is: make it anew and look at it, then python tools/docs_outputs.py hashes."""
    known = json.loads(outputs.MADE.read_text())
    assert outputs.hashes() == known
    assert len(outputs.commands()) >= 8
    monkeypatch.setattr(
        outputs, "commands", lambda: {"render-frame.png": "anisoscope render frame --rough 0.1"}
    )
    assert {name for name, one in outputs.hashes().items() if one != known[name]} >= {"render-frame.png"}


def test_a_changed_picture_is_found(outputs, tmp_path):
    old, new = outputs.PICTURES / "render-frame.png", tmp_path / "new.png"
    picture = outputs.Image.open(old).convert("RGB")
    picture.save(new)
    assert outputs.look_alike(old, new)
    picture.paste((0, 0, 0), (0, 0, 60, 60))
    picture.save(new)
    assert not outputs.look_alike(old, new)
