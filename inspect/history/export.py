"""The history for other programs: CSV, JSON, and JUnit XML as servers of continuous integration read it.

Everything is written as it is read: the memory that an export takes does not grow with the history.
"""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET
from xml.sax.saxutils import quoteattr

from anisoscope.base.atomic_write import appearing
from anisoscope.base.csv_style import csv_text, number_text
from anisoscope.base.json_fields import as_json, fields_of
from anisoscope.history.dispositions import Disposition
from anisoscope.history.rows import Row, utc_text

Decided = tuple[Row, Sequence[Disposition]]
"""An inspection and what was decided about it."""
_TEXTS = ("serial", "product", "recipe", "lot", "cavity", "station", "operator", "verdict")
_LATER = ("folder", "seal", "software", "hash")
VALUE_COLUMNS = {
    "id": "",
    "created_at": "UTC",
    **dict.fromkeys(_TEXTS, ""),
    "characteristic": "",
    "unit": "",
    **dict.fromkeys(("value", "u", "deviation", "tolerance"), "unit"),
}
"""Columns of a table of values, and the line of units below them; ``unit`` refers to the column of this name."""
_IN_DEGREES = frozenset(
    {"print tilt", "print curl", "facet angle", "facet angle spread", "facet angle of the worst ridge"}
)
"""The other numbers of a history are ratios, logarithms, shares, probabilities and counts."""
_WITH = ("u", "deviation", "tolerance")
# Spreadsheets take such cells for formulae.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def write_lines(path: Path, lines: Iterable[str]) -> None:
    """Write a file as its lines come, in UTF-8; it appears whole or not at all.

    Raises:
        RecordError: the folder cannot be written.
    """
    with appearing(path) as stream:
        for line in lines:
            stream.write(line.encode())


def with_dispositions(row: Row, dispositions: Sequence[Disposition] = ()) -> dict[str, Any]:
    """One inspection with what was decided about it, for JSON."""
    return {"id": row.id} | fields_of(row) | {"dispositions": list(dispositions)}


def json_lines(found: Iterable[Decided]) -> Iterator[str]:
    """All inspections as a JSON list, a line each."""
    separator = "[\n"
    for row, decided in found:
        yield separator + json.dumps(as_json(with_dispositions(row, decided)), allow_nan=False)
        separator = ",\n"
    yield "[]\n" if separator == "[\n" else "\n]\n"


def csv_lines(found: Iterable[Decided], labels: Sequence[str]) -> Iterator[str]:
    """All inspections as a table: a line each, and a column for every number.

    A text that a spreadsheet would take for a formula gets an apostrophe in front; in JSON it stands as it is.

    Args:
        found: the inspections.
        labels: of the numbers that some of them have.
    """
    columns = ("id", "created_at", *_TEXTS, "reasons", *_LATER, "disposition", "reviewer", "comment")
    yield csv_text([[*columns, *map(_cell, labels)]], line_end="\r\n")
    for row, decided in found:
        last = (decided or (None,))[-1]
        words = ("", "", "") if last is None else (last.decision, last.reviewer, last.comment)
        texts = [getattr(row, name) or "" for name in _TEXTS]
        texts += ["; ".join(row.reasons), *(getattr(row, name) for name in _LATER), *words]
        numbers = [number_text(repr(row.numbers[label])) if label in row.numbers else "" for label in labels]
        line = [row.id, utc_text(row.created_at), *map(_cell, texts), *numbers]
        yield csv_text([line], line_end="\r\n", file=False)


def value_lines(found: Iterable[Decided]) -> Iterator[str]:
    """All numbers of all inspections as a table whose columns never change: a line each, below `VALUE_COLUMNS`.

    What belongs to a characteristic (``u ln 0-90``, ``deviation …``, ``tolerance …``) is in its line.
    """
    yield csv_text([list(VALUE_COLUMNS), list(VALUE_COLUMNS.values())], line_end="\r\n")
    for row, _ in found:
        about = [row.id, utc_text(row.created_at), *(_cell(getattr(row, name) or "") for name in _TEXTS)]
        lines = []
        for label in characteristics(row.numbers):
            cells = [
                number_text(repr(row.numbers[name])) if name in row.numbers else ""
                for name in (label, *(f"{word} {label}" for word in _WITH))
            ]
            lines.append([*about, _cell(label), unit_of(label), *cells])
        if lines:
            yield csv_text(lines, line_end="\r\n", file=False)


def unit_of(label: str) -> str:
    """Unit of a number of inspections."""
    return "deg" if label in _IN_DEGREES else "1"


def characteristics(labels: Iterable[str]) -> list[str]:
    """Numbers that are not said of another one, as ``u ln 0-90`` is of ``ln 0-90``."""
    found = list(labels)
    more = {f"{word} {label}" for label in found for word in _WITH}
    return [label for label in found if label not in more]


def _cell(text: str) -> str:
    return f"'{text}" if text.startswith(_FORMULA) else text


Verdicts = dict[str, dict[str, int]]
"""How many inspections ended with which verdict, by product, in the order in which the products came."""


def junit_lines(verdicts: Verdicts, found: Callable[[str], Iterable[Decided]]) -> Iterator[str]:
    """All inspections as test cases: FAIL is a failure, INVALID an error, INCONCLUSIVE a skipped test.

    Suites are products; a case is called by its serial number and id. What reviewers decided stands in the output of a
    case and does not change its outcome.

    Args:
        verdicts: the totals that servers show, of all suites and of each.
        found: the inspections of a product.
    """
    yield '<?xml version="1.0" encoding="UTF-8"?>\n'
    yield f"<testsuites{_attributes({'name': 'anisoscope'} | _totals(*verdicts.values()))}>\n"
    for product, counts in verdicts.items():
        began = ""
        for row, decided in found(product):
            if not began:
                began = utc_text(row.created_at)
                about = {"name": product, "timestamp": began} | _totals(counts)
                yield f"  <testsuite{_attributes(about)}>\n"
            case = _case(row, decided)
            ET.indent(case, level=2)
            yield f"    {ET.tostring(case, encoding='unicode')}\n"
        yield "  </testsuite>\n"
    yield "</testsuites>\n"


_OUTCOMES = {"FAIL": "failure", "INVALID": "error", "INCONCLUSIVE": "skipped"}
_TOTALS = {"failures": "FAIL", "errors": "INVALID", "skipped": "INCONCLUSIVE"}


def _totals(*counts: dict[str, int]) -> dict[str, str]:
    found = {"tests": sum(sum(one.values()) for one in counts)}
    found |= {total: sum(one.get(verdict, 0) for one in counts) for total, verdict in _TOTALS.items()}
    return {total: str(number) for total, number in found.items()}


def _attributes(values: dict[str, str]) -> str:
    return "".join(f" {name}={quoteattr(_xml(text))}" for name, text in values.items())


def _case(row: Row, dispositions: Sequence[Disposition]) -> ET.Element:
    name = {"classname": _xml(row.recipe), "name": _xml(f"{row.serial} (inspection {row.id})")}
    case = ET.Element("testcase", name, time="0")
    why = _xml("; ".join(row.reasons))
    if row.verdict in _OUTCOMES:
        outcome = ET.SubElement(case, _OUTCOMES[row.verdict], message=why)
        if row.verdict != "INCONCLUSIVE":
            outcome.set("type", row.verdict)
            outcome.text = _xml("\n".join(f"{label} = {value:g}" for label, value in row.numbers.items()))
    lines = [f"folder: {row.folder}", f"created at: {utc_text(row.created_at)}"]
    lines += [
        f"{name}: {getattr(row, name)}"
        for name in ("lot", "cavity", "station", "operator")
        if getattr(row, name)
    ]
    lines += [f"disposition: {one.decision} by {one.reviewer}: {one.comment}" for one in dispositions]
    ET.SubElement(case, "system-out").text = _xml("\n".join(lines))
    return case


def _xml(text: str) -> str:
    """Text without the characters that no XML file may hold, not even escaped."""
    return _NOT_XML.sub("\ufffd", text)
