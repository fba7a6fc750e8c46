"""First lines of docstrings are written in terms of the field; words that stand for persons and talk are not."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FIRST_LINE = re.compile(r'^\s*r?"""(?P<text>[^"\n]+)', re.MULTILINE)
WORDS = re.compile(
    r"\b(beside|kept|told|tells?|nobody|somebody|anybody|asked|unfit|whoever)\b", re.IGNORECASE
)


def talk(source):
    """First lines of the docstrings of a source that contain such a word."""
    return [found["text"] for found in FIRST_LINE.finditer(source) if WORDS.search(found["text"])]


@pytest.mark.parametrize("folder", ["inspect", "profiles", "rig", "sim"])
def test_first_lines_of_docstrings_name_quantities_and_actions(folder):
    found = {str(path): talk(path.read_text(encoding="utf-8")) for path in (ROOT / folder).rglob("*.py")}
    assert {path: lines for path, lines in found.items() if lines} == {}


def test_such_a_word_is_found_in_a_first_line_only():
    source = (
        'def f():\n    """What nobody asked."""\n\n\ndef g():\n    """Mean.\n\n    Told apart.\n    """\n'
    )
    assert talk(source) == ["What nobody asked."]
