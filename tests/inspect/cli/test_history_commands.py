"""history, show, compare, export on the command line."""

import json
import sqlite3
from contextlib import closing
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from anisoscope import cli
from anisoscope.cli.history import history as commands
from anisoscope.history.filters import Filters
from anisoscope.history.rows import NewRow
from anisoscope.history.store import open_history
from anisoscope.quality.readings import history_readings, read_readings

NOW = datetime.now(UTC).replace(microsecond=0)
MARKUP = "[red]x[/red] [/] \\[b] [link=file:///etc/passwd]y[/link] \x1b[2J\x07\u202e %s"


def row(number, **changes):
    values = {
        "created_at": NOW - timedelta(days=10 - number, hours=-1),
        "serial": f"A{number}",
        "product": "ridged plate",
        "recipe": f"ridged plate {number % 2}123456789ab",
        "lot": f"L{number % 3}",
        "cavity": str(number % 4),
        "station": "east",
        "operator": "M. M.",
        "verdict": ("PASS", "PASS", "FAIL", "INCONCLUSIVE", "INVALID")[number % 5],
        "reasons": ("all is well",),
        "folder": f"/inspections/A{number}",
        "seal": sha256(str(number).encode()).hexdigest(),
        "software": "anisoscope 0.1.0",
        "numbers": {"ln 0-90": 2.0 + 0.01 * number, "u ln 0-90": 0.05, "d2": 1.0},
    }
    return NewRow(**(values | changes))


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A history of ten inspections, one a day, the last of them yesterday."""
    path = tmp_path / "history.sqlite"
    with open_history(path) as history:
        history.append_all([row(number) for number in range(10)])
    monkeypatch.setenv("ANISOSCOPE_HISTORY", str(path))
    return path


@pytest.fixture
def said(capsys):
    """``said("history", "--json")`` runs a command; returns exit code, standard output and standard error."""

    def run(*arguments):
        code = cli.run(list(map(str, arguments)))
        found = capsys.readouterr()
        return code, found.out, found.err

    return run


def serials(said, *options):
    code, out, err = said("history", *options, "--json")
    assert (code, err) == (0, "")
    return [one["serial"] for one in json.loads(out)["inspections"]]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ((), list(range(10))),
        (("--since", "3d"), [7, 8, 9]),
        (("--until", "8d"), [0, 1]),
        (("--lot", "L1"), [1, 4, 7]),
        (("--lot", "L1", "--cavity", "3"), [7]),
        (("--verdict", "fail"), [2, 7]),
        (("--recipe", "1123"), [1, 3, 5, 7, 9]),
        (("--product", "ridged"), []),
        (("--product", "ridged plate", "--limit", "2"), [8, 9]),
        (("--station", "east", "--operator", "M. M.", "--serial", "A4"), [4]),
        (("--limit", "0"), list(range(10))),
    ],
)
def test_filters(place, said, options, expected):
    assert serials(said, *options) == [f"A{number}" for number in expected]


def test_the_table(place, said):
    code, out, _ = said("history", "--limit", 3)
    assert code == 0
    lines = [line.split("│") for line in out.splitlines() if line.startswith("│")]
    assert [[cell.strip() for cell in line[3:7]] for line in lines] == [
        ["A7", "FAIL", "L1", "3"],
        ["A8", "INCONCLUSIVE", "L2", "0"],
        ["A9", "INVALID", "L0", "1"],
    ]
    assert "the last 3 of 10; --limit 0 for all" in out
    assert said("history", "--lot", "none")[1] == "no inspections\n"


def test_long_words_leave_room_for_numbers_and_verdicts(said, tmp_path, monkeypatch):
    path = tmp_path / "history.sqlite"
    with open_history(path) as history:
        history.append(row(2, product="ridged plate of a long name " * 3, reasons=("much to say " * 30,)))
    code, out, _ = said("history", "--history", path)
    assert code == 0
    assert all(word in out for word in ("A2", "FAIL", "much to say", "long name"))
    assert max(map(len, out.splitlines())) <= 120


@pytest.mark.parametrize(
    "options",
    [
        ("--since", "soon"),
        ("--verdict", "GOOD"),
        ("--limit", "-1"),
        ("--recipe", "x"),
        ("--history", "mysql://h/d"),
    ],
)
def test_filters_that_make_no_sense(place, said, options):
    code, out, err = said("history", *options)
    assert (code, out, err.count("\n")) == (64, "", 1)


def test_markup_and_control_characters_are_printed_as_text(place, said):
    with open_history(place) as history:
        history.append(row(10, serial="M", lot=MARKUP, product=MARKUP, reasons=(MARKUP,), operator=MARKUP))
        history.dispose(11, reviewer=MARKUP, decision="hold", comment=MARKUP)
    for command in (("history",), ("show", "M"), ("compare", "M", "A1")):
        code, out, err = said(*command)
        assert (code, err) == (0, "")
        assert "\x1b" not in out
        assert "\x07" not in out
        assert "\u202e" not in out
    assert (
        "[red]x[/red] [/] \\[b] [link=file:///etc/passwd]y[/link] \\x1b[2J\\x07\\u202e %s"
        in said("show", "M")[1]
    )
    assert serials(said, "--lot", MARKUP) == ["M"]


def test_one_inspection(place, said):
    assert (
        said("history", "dispose", "A2", "accept", "--reviewer", "R. R.", "-m", "burrs are allowed")[0] == 0
    )
    for name in ("A2", "3", "id:3", "serial:A2"):
        code, out, _ = said("show", name)
        assert code == 0
        assert out.startswith("FAIL\n  all is well\n")
        assert "accept by R. R.: burrs are allowed" in out
        assert "/inspections/A2 (gone)" in out
    found = json.loads(said("show", "A2", "--json")[1])
    assert (found["id"], found["numbers"]["ln 0-90"], found["folder_state"]) == (3, 2.02, "gone")
    assert found["dispositions"][0]["decision"] == "accept"
    code, _, err = said("show", "nobody")
    assert (code, err.count("\n")) == (64, 1)


def test_a_decision_shows_in_the_list_and_leaves_the_verdict(place, said):
    said("history", "dispose", "A2", "hold", "--reviewer", "Q", "-m", "to be measured")
    said("history", "dispose", "A2", "rework", "--reviewer", "R", "-m", "burrs come off")
    line = next(line for line in said("history")[1].splitlines() if " A2 " in line)
    assert "FAIL" in line
    assert "rework" in line
    assert said("history", "dispose", "A2", "burn", "--reviewer", "Q", "-m", "no")[0] == 64
    assert said("history", "dispose", "nobody", "accept", "--reviewer", "Q", "-m", "no")[0] == 64
    code, _, err = said("history", "dispose", "A2", "accept", "--reviewer", "Q")
    assert (code, "a decision needs a reason: say why, with --comment TEXT" in err) == (64, True)


def test_two_inspections(place, said):
    code, out, _ = said("compare", "A1", "A4")
    assert code == 0
    line = next(line for line in out.splitlines() if "ln ratio 0° / 90°, tilt 0°" in line)
    assert [cell.strip() for cell in line.split("│")[1:-1]] == [
        "ln ratio 0° / 90°, tilt 0°",
        "2.01",
        "2.04",
        "+0.03",
        "0.071",
        "+0.4",
    ]
    assert "recipe: ridged plate 1123456789ab -> ridged plate 0123456789ab" in out
    assert "lot" not in out
    found = json.loads(said("compare", "A1", "A4", "--json")[1])
    assert found["contrasts"][0]["ratio"] == pytest.approx(0.03 / (0.05 * 2**0.5))
    assert len(found["notes"]) == 2


def test_export(place, said, tmp_path):
    files = {name: tmp_path / f"out.{name}" for name in ("csv", "json", "junit")}
    options = [text for name, path in files.items() for text in (f"--{name}", path)]
    code, out, _ = said("export", *options, "--lot", "L1")
    assert (code, out.count("3 inspections: ")) == (0, 3)
    assert len(json.loads(files["json"].read_text())) == 3
    assert len(files["csv"].read_text().splitlines()) == 4
    root = ET.parse(files["junit"]).getroot()
    assert [root.get(name) for name in ("tests", "failures", "errors")] == ["3", "1", "1"]
    assert said("export")[0] == 64
    code, _, err = said("export", "--csv-file", tmp_path / "none" / "out.csv")
    assert (code, err.count("\n")) == (74, 1)


def test_export_of_aqdef_is_read_by_the_statistics(place, said, tmp_path):
    path = tmp_path / "out.dfq"
    code, _, err = said("export", "--aqdef", path, "--lot", "L1")
    assert (code, "2 recipes" in err, path.exists()) == (64, True, False)
    which = ("--recipe", "ridged plate 1123456789ab")
    code, out, err = said("export", "--aqdef", path, *which)
    assert (code, err, out.count("5 inspections: ")) == (0, "", 1)
    found = read_readings(path)
    history = history_readings(place, Filters(recipe=which[1]))
    assert found.column("serial") == history.column("serial")
    assert found.column("verdict") == history.column("verdict")
    assert [found.moment(k) for k in range(5)] == [history.moment(k) for k in range(5)]
    assert "u ln 0-90" in history.numbers  # its uncertainty is no characteristic of its own
    assert list(found.numbers) == [name for name in history.numbers if not name.startswith("u ")]
    for name, values in found.numbers.items():
        np.testing.assert_array_equal(values, history.numbers[name])
    assert said("export", "--aqdef", tmp_path / "apart.dfd", *which)[0] == 0
    assert (tmp_path / "apart.dfx").exists()
    code, _, err = said("export", "--aqdef", tmp_path / "out.txt")
    assert (code, "name a file *.dfq" in err) == (64, True)


def test_verify_names_what_was_changed_and_notices_a_cut(place, said):
    code, out, _ = said("history", "verify")
    assert code == 0
    assert "10 inspections are as they were written" in out
    head = out.split("head: ")[1].split()[0]
    assert said("history", "verify", "--head", head)[0] == 0
    with closing(sqlite3.connect(place, isolation_level=None)) as other:
        other.execute("DROP TRIGGER inspections_refuse_delete")
        other.execute("DROP TRIGGER inspections_refuse_update")
        other.execute("UPDATE inspections SET operator = 'N. N.' WHERE id = 4")
        other.execute("DELETE FROM inspections WHERE id = 10")
    code, out, _ = said("history", "verify", "--head", head)
    assert code == 1
    assert "inspection 4: was changed" in out.splitlines()
    assert "no longer refused" in out
    assert "the history was cut or rewritten since" in out
    found = json.loads(said("history", "verify", "--json")[1])
    assert (found["intact"], found["inspections"]) == (False, 9)
    assert said("history", "verify", "--head", "x")[0] == 64


def test_where_there_is_no_history(said, tmp_path, monkeypatch):
    monkeypatch.delenv("ANISOSCOPE_HISTORY", raising=False)
    monkeypatch.chdir(tmp_path)
    for command in (("history",), ("show", "A1"), ("compare", "A1", "A2"), ("history", "verify")):
        code, out, err = said(*command)
        assert (code, out, err.count("\n")) == (74, "", 1)
        assert "there is no history" in err
    assert not list(tmp_path.iterdir())
    assert said("history", "--history", "none")[0] == 64
    assert said("history", "add")[0] == 64


def test_a_page_of_too_many_inspections_is_refused_before_it_is_made(place, said, tmp_path, monkeypatch):
    monkeypatch.setattr(commands, "MOST_ON_PAGE", 5)
    page = tmp_path / "history.html"
    code, _, err = said("history", "--limit", 0, "--html", page)
    assert code == 64
    assert "10 inspections are too many for a page (at most 5): choose with --since" in err
    assert not page.exists()
    code, _, _ = said("history", "--limit", 0)
    assert code == 0
    assert said("history", "--limit", 5, "--html", page)[0] == 0
