"""Every command that a page shows is one: its options exist and take these values."""

import re
import shlex
from pathlib import Path

from cyclopts import App
from cyclopts.exceptions import CycloptsError

from anisoscope.cli import app
from detection import detection_command

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *(page for folder in ("start", "evidence") for page in sorted((ROOT / "docs" / folder).glob("*.md"))),
]
BLOCK = re.compile(r"^```(?:sh|console)\n(.*?)^```", re.MULTILINE | re.DOTALL)
IN_LINE = re.compile(r"`(anisoscope [^`]+)`")
OF_ALL = {"--verbose", "-v", "--quiet", "-q", "--debug"}
"""Options of every command, which are taken off before a command sees them."""
OF_ALL_WITH_VALUE = re.compile(r" --(?:csv-style|lang|log-file)[= ]\S+")
STUDY = "python tests/evidence/detection.py "
"""The command of the detection study, which is not installed."""
PLACEHOLDER = re.compile(r"…|\.\.\.|\bNAME\b")


def commands(text):
    """Command lines of the blocks of a page, and those in its start pages' tables."""
    for block in BLOCK.findall(text):
        for typed in block.replace("\\\n", " ").splitlines():
            line = typed.removeprefix("$ ")
            if line.startswith(("anisoscope ", STUDY)):
                yield line
    if "## Every day" in text or "## What you can do" in text:
        yield from (line for line in IN_LINE.findall(text) if not PLACEHOLDER.search(line))


def shown():
    found = {}
    for page in PAGES:
        for line in commands(page.read_text(encoding="utf-8")):
            found.setdefault(line, page.name)
    return found


def test_commands_of_the_pages_can_be_parsed():
    wrong = {}
    lines = shown()
    study = App(default_command=detection_command)
    assert sum(line.startswith(STUDY) for line in lines) == 4
    assert len(lines) > 150
    for line, page in lines.items():
        parser, start = (study, STUDY) if line.startswith(STUDY) else (app, "anisoscope ")
        words = shlex.split(OF_ALL_WITH_VALUE.sub("", line).removeprefix(start), comments=True)
        words = words[: min((words.index(sign) for sign in "|>" if sign in words), default=len(words))]
        try:
            parser.parse_args(
                [word for word in words if word not in OF_ALL], exit_on_error=False, print_error=False
            )
        except CycloptsError as error:
            wrong[f"{page}: {line}"] = str(error)
    assert wrong == {}
