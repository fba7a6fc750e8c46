"""The history for other programs: CSV, JSON, and JUnit XML as servers of continuous integration read it."""

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree as ET

from anisoscope.base.csv_style import csv_text, number_text
from anisoscope.base.json_fields import as_json, fields_of
from anisoscope.history.dispositions import Disposition
from anisoscope.history.rows import Row, utc_text

Dispositions = Mapping[int, Sequence[Disposition]]
_TEXTS = ("serial", "product", "recipe", "lot", "cavity", "station", "operator", "verdict")
_LATER = ("folder", "seal", "software", "hash")
# Spreadsheets take such cells for formulae.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def with_dispositions(row: Row, dispositions: Sequence[Disposition] = ()) -> dict[str, Any]:
    """One inspection with what was decided about it, for JSON."""
    return {"id": row.id} | fields_of(row) | {"dispositions": list(dispositions)}


def to_json(rows: Sequence[Row], dispositions: Dispositions) -> str:
    """All inspections as a JSON list."""
    listed = as_json([with_dispositions(row, dispositions.get(row.id, ())) for row in rows])
    return json.dumps(listed, indent=1, allow_nan=False) + "\n"


def to_csv(rows: Sequence[Row], dispositions: Dispositions) -> str:
    """All inspections as a table: a line each, a column for every number that one of them has.

    A text that a spreadsheet would take for a formula gets an apostrophe in front; in JSON it stands as it is.
    """
    labels = list(dict.fromkeys(label for row in rows for label in row.numbers))
    columns = ("id", "created_at", *_TEXTS, "reasons", *_LATER, "disposition", "reviewer", "comment")
    table: list[list[object]] = [[*columns, *map(_cell, labels)]]
    for row in rows:
        last = (dispositions.get(row.id) or (None,))[-1]
        decided = ("", "", "") if last is None else (last.decision, last.reviewer, last.comment)
        texts = [getattr(row, name) or "" for name in _TEXTS]
        texts += ["; ".join(row.reasons), *(getattr(row, name) for name in _LATER), *decided]
        numbers = [number_text(repr(row.numbers[label])) if label in row.numbers else "" for label in labels]
        table.append([row.id, utc_text(row.created_at), *map(_cell, texts), *numbers])
    return csv_text(table, line_end="\r\n")


def _cell(text: str) -> str:
    return f"'{text}" if text.startswith(_FORMULA) else text


def to_junit(rows: Sequence[Row], dispositions: Dispositions) -> str:
    """All inspections as test cases: FAIL is a failure, INVALID an error, INCONCLUSIVE a skipped test.

    Suites are products; a case is called by its serial number and id. What reviewers decided stands in the output of a
    case and does not change its outcome.
    """
    root = ET.Element("testsuites", name="anisoscope")
    for product in dict.fromkeys(row.product for row in rows):
        of_product = [row for row in rows if row.product == product]
        suite = ET.SubElement(root, "testsuite", _suite(product, of_product))
        for row in of_product:
            _case(suite, row, dispositions.get(row.id, ()))
    _count(root, rows)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


_OUTCOMES = {"FAIL": "failure", "INVALID": "error", "INCONCLUSIVE": "skipped"}
_TOTALS = {"failures": "FAIL", "errors": "INVALID", "skipped": "INCONCLUSIVE"}


def _suite(product: str, rows: Sequence[Row]) -> dict[str, str]:
    return {"name": _xml(product), "timestamp": utc_text(rows[0].created_at)}


def _count(root: ET.Element, rows: Sequence[Row]) -> None:
    """The totals that servers show: of all suites, and of each."""
    for suite in (root, *root):
        cases = list(suite.iter("testcase"))
        suite.set("tests", str(len(cases)))
        for total, verdict in _TOTALS.items():
            suite.set(total, str(sum(case.find(_OUTCOMES[verdict]) is not None for case in cases)))
    assert root.get("tests") == str(len(rows))


def _case(suite: ET.Element, row: Row, dispositions: Sequence[Disposition]) -> None:
    name = {"classname": _xml(row.recipe), "name": _xml(f"{row.serial} (inspection {row.id})")}
    case = ET.SubElement(suite, "testcase", name, time="0")
    why = _xml("; ".join(row.reasons))
    if row.verdict in _OUTCOMES:
        outcome = ET.SubElement(case, _OUTCOMES[row.verdict], message=why)
        if row.verdict != "INCONCLUSIVE":
            outcome.set("type", row.verdict)
            outcome.text = "\n".join(f"{label} = {value:g}" for label, value in row.numbers.items())
    lines = [f"folder: {row.folder}", f"created at: {utc_text(row.created_at)}"]
    lines += [
        f"{name}: {getattr(row, name)}"
        for name in ("lot", "cavity", "station", "operator")
        if getattr(row, name)
    ]
    lines += [f"disposition: {one.decision} by {one.reviewer}: {one.comment}" for one in dispositions]
    ET.SubElement(case, "system-out").text = _xml("\n".join(lines))


def _xml(text: str) -> str:
    """Text without the characters that no XML file may hold, not even escaped."""
    return _NOT_XML.sub("\ufffd", text)
