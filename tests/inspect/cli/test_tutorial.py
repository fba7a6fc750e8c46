"""The commands and the script of docs/tutorial.md, one after the other, as a reader types them."""

import re
import shlex
from pathlib import Path

import pytest

from anisoscope.cli import run

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "tutorial.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```(sh|console|python)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LONG = re.compile(r"anisoscope (inspect|history|recipe check|profile|predict demo)")
ENDS = {"anisoscope inspect": {0, 1, 2}}


@pytest.fixture
def here(demo_folder, tmp_path, monkeypatch):
    """A folder in which the demo of step 1 has run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "demo-output").symlink_to(demo_folder, target_is_directory=True)
    return tmp_path


def follow(*, all_of_it):
    """Do what the page says after its first step; the exit codes by command."""
    codes = {}
    for language, text in BLOCK.findall(PAGE.partition("## 2.")[2]):
        if language == "python":
            exec(compile(text, "tutorial.md", "exec"), {})
            continue
        lines = text.splitlines()
        if language == "console":  # commands with what they print
            lines = [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
        for line in lines:
            if all_of_it or not LONG.match(line):
                codes[line] = run(shlex.split(line)[1:])
    return codes


def test_what_is_quick(here):
    codes = follow(all_of_it=False)
    assert len(codes) == 4
    assert set(codes.values()) == {0}
    assert (here / "plate.toml").is_file()
    assert (here / "my-frames" / "frames.csv").is_file()


@pytest.mark.soak
def test_all_of_it(here):
    codes = follow(all_of_it=True)
    assert len(codes) == 9
    for line, code in codes.items():
        assert code in ENDS.get(" ".join(line.split()[:2]), {0}), line
    assert len(list((here / "parts").glob("*/record.json"))) == 2
