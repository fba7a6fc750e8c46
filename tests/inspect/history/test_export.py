"""CSV, JSON and JUnit XML as other programs read them."""

import csv
import io
import json
import re
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from anisoscope.base.errors import RecordError
from anisoscope.history.export import csv_lines, json_lines, junit_lines, value_lines, write_lines
from anisoscope.history.filters import Filters
from anisoscope.history.store import open_history

EVERYTHING = Filters()
HOSTILE = ("=1+1", "+1", "-1", "@x", "\tx", '"', "a,b\n", "<b>&'", "x\x00\x1b\ufffe", "]]>", "[red]")


@pytest.fixture
def exported(sqlite_history, new_row):
    """Ten inspections, of which one was decided about twice."""
    sqlite_history.append_all([new_row(number) for number in range(10)])
    sqlite_history.append(new_row(10, product="other", numbers={"d2": 7.0}, lot=None))
    sqlite_history.dispose(3, reviewer="Q", decision="hold")
    sqlite_history.dispose(3, reviewer="R", decision="accept", comment="looks <fine>")
    return sqlite_history


def to_json(history, filters=EVERYTHING):
    with history.selection(filters) as selected:
        return "".join(json_lines(selected.decided()))


def to_csv(history, filters=EVERYTHING):
    with history.selection(filters) as selected:
        return "".join(csv_lines(selected.decided(), selected.labels()))


def to_junit(history, filters=EVERYTHING):
    with history.selection(filters) as selected:
        return "".join(junit_lines(selected.verdicts(), selected.decided))


def test_json_holds_everything(exported):
    rows = exported.rows()
    found = json.loads(to_json(exported))
    assert [one["id"] for one in found] == [row.id for row in rows]
    assert found[2]["numbers"] == rows[2].numbers
    assert [one["decision"] for one in found[2]["dispositions"]] == ["hold", "accept"]
    assert found[10]["lot"] is None
    assert found[0]["created_at"] == "2026-11-01T06:00:00.000000+00:00"


def test_csv_has_a_line_for_each_and_a_column_for_every_number(exported):
    rows = exported.rows()
    found = list(csv.DictReader(io.StringIO(to_csv(exported))))
    assert len(found) == 11
    assert [float(line["ln 0-90"]) for line in found[:10]] == [row.numbers["ln 0-90"] for row in rows[:10]]
    assert (found[10]["ln 0-90"], found[10]["d2"], found[10]["lot"]) == ("", "7.0", "")
    assert (found[2]["disposition"], found[2]["reviewer"]) == ("accept", "R")


def test_values_have_the_columns_of_the_page_and_each_number_once(sqlite_history, new_row):
    numbers = {"ln 0-90": 0.25, "u ln 0-90": 0.01, "deviation ln 0-90": -0.02, "p": 0.5, "print tilt": 1.5}
    rows = [new_row(0, numbers=numbers, lot="=1+1"), new_row(1, numbers={}), new_row(2, numbers={"d2": 7.0})]
    sqlite_history.append_all(rows)
    with sqlite_history.selection(EVERYTHING) as selected:
        header, units, *lines = csv.reader(io.StringIO("".join(value_lines(selected.decided()))))
    page = (Path(__file__).parents[3] / "docs" / "history.md").read_text(encoding="utf-8")
    (listed,) = (part for part in page.split("\n- ") if part.startswith("**CSV of fixed columns"))
    assert re.findall("`([a-z_0-9]+)`", listed.partition(":")[2].partition("Line 2")[0]) == header
    assert dict(zip(header, units, strict=True)) == dict.fromkeys(header, "") | {
        "created_at": "UTC", "value": "unit", "u": "unit", "deviation": "unit", "tolerance": "unit",
    }  # fmt: skip
    assert [[line[0], *line[10:]] for line in lines] == [
        ["1", "ln 0-90", "1", "0.25", "0.01", "-0.02", ""],
        ["1", "p", "1", "0.5", "", "", ""],
        ["1", "print tilt", "deg", "1.5", "", "", ""],
        ["3", "d2", "1", "7.0", "", "", ""],
    ]
    assert lines[0][5] == "'=1+1"


def test_csv_holds_no_formula(sqlite_history, new_row):
    sqlite_history.append_all([new_row(number, lot=text) for number, text in enumerate(HOSTILE)])
    found = [line["lot"] for line in csv.DictReader(io.StringIO(to_csv(sqlite_history)))]
    assert found[:5] == ["'=1+1", "'+1", "'-1", "'@x", "'\tx"]
    assert found[5:] == list(HOSTILE[5:])


def test_junit_fails_what_failed(exported):
    rows = exported.rows()
    root = ET.fromstring(to_junit(exported))
    assert (root.tag, root.get("tests")) == ("testsuites", "11")
    verdicts = [row.verdict for row in rows]
    for total, verdict in (("failures", "FAIL"), ("errors", "INVALID"), ("skipped", "INCONCLUSIVE")):
        assert int(root.get(total)) == verdicts.count(verdict)
        assert sum(int(suite.get(total)) for suite in root) == verdicts.count(verdict)
    assert [suite.get("name") for suite in root] == ["ridged plate", "other"]
    cases = {case.get("name"): case for case in root.iter("testcase")}
    assert len(cases) == 11
    tags = {case: [part.tag for part in cases[case] if part.tag != "system-out"] for case in cases}
    assert tags["A0 (inspection 1)"] == []
    assert tags["A2 (inspection 3)"] == ["failure"]
    assert tags["A3 (inspection 4)"] == ["skipped"]
    assert tags["A4 (inspection 5)"] == ["error"]
    failure = cases["A2 (inspection 3)"].find("failure")
    assert failure.get("message") == "all is well; indeed"
    assert "ln 0-90 = 2.002" in failure.text
    # what a reviewer says is told, and changes no outcome
    assert "disposition: accept by R: looks <fine>" in cases["A2 (inspection 3)"].findtext("system-out")


def test_junit_is_xml_whatever_the_fields_hold(sqlite_history, new_row):
    texts = [text.replace("\0", "") for text in HOSTILE]
    sqlite_history.append_all(
        [
            new_row(number, serial=text, lot=text, product=text, reasons=(text,), verdict="FAIL")
            for number, text in enumerate(texts)
        ]
    )
    root = ET.fromstring(to_junit(sqlite_history))
    assert int(root.get("failures")) == len(texts)
    assert "x\ufffd\ufffd (inspection 9)" in {case.get("name") for case in root.iter("testcase")}


def test_nothing_to_export(sqlite_history):
    assert json.loads(to_json(sqlite_history)) == []
    assert len(to_csv(sqlite_history).splitlines()) == 1
    assert ET.fromstring(to_junit(sqlite_history)).get("tests") == "0"


def test_an_export_has_the_latest_of_one_state_whatever_is_added_meanwhile(place, new_row):
    """More inspections than are read at once, on both databases."""
    with open_history(place) as history, open_history(place) as other:
        history.append_all([new_row(number, product=f"p{number % 3}") for number in range(1203)])
        history.dispose(1200, reviewer="Q", decision="hold")
        latest = Filters(limit=1100)
        with history.selection(latest) as selected:
            labels, verdicts = selected.labels(), selected.verdicts()
            other.append(new_row(5000, product="p0", numbers={"late": 1.0}))
            found = list(selected.decided())
            of_products = [row.id for product in verdicts for row, _ in selected.decided(product)]
        assert [row.id for row, _ in found] == list(range(104, 1204))
        assert [row.id for row, decided in found if decided] == [1200]
        assert sorted(of_products) == list(range(104, 1204))
        assert sum(sum(one.values()) for one in verdicts.values()) == 1100
        assert "late" not in labels
        assert other.count() == 1204


def test_a_table_that_cannot_be_written_to_its_end_leaves_none(tmp_path):
    def lines():
        yield "one"
        raise OSError(28, "No space left on device")

    with pytest.raises(RecordError, match=r"cannot write .*week\.csv: No space left"):
        write_lines(tmp_path / "week.csv", lines())
    assert not list(tmp_path.iterdir())
