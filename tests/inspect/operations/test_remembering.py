"""Inspections enter the history as they are finished, and no history can take a verdict from them."""

import sqlite3

import pytest

from anisoscope import cli
from anisoscope.history import store
from anisoscope.history.problems import HistoryError
from anisoscope.history.rows import seal_of
from anisoscope.history.store import History, open_history
from anisoscope.inspection import run as inspection
from anisoscope.operations import inspecting, remembering
from anisoscope.record.schema import Particulars, Record, read_record, write_record

pytestmark = pytest.mark.usefixtures("no_history_said")
INCONCLUSIVE = 2
NOWHERE = "postgresql://me:secret@127.0.0.1:1/none"


@pytest.fixture
def no_history_said(monkeypatch):
    monkeypatch.delenv("ANISOSCOPE_HISTORY", raising=False)


@pytest.fixture
def inspect_on(capsys):
    """``inspect_on(rig, "--lot", "L1")`` runs the command; returns exit code, standard error and the folder."""

    def run(rig, *options):
        code = cli.run(
            [
                "inspect",
                "-r",
                str(rig.recipe),
                "-g",
                str(rig.rig),
                "-s",
                "T-1",
                "--out",
                str(rig.out),
                *options,
            ]
        )
        folders = sorted(path.parent for path in rig.out.glob("*/record.json"))
        return code, capsys.readouterr().err, folders[-1] if folders else None

    return run


@pytest.fixture
def judged(virtual_rig, monkeypatch):
    """A rig on which inspecting takes no time, and comes to INCONCLUSIVE."""

    def inspect_part(_recipe, _rig, serial, out, *_, particulars=None, **__):
        folder = out / f"{serial}-{len(list(out.glob('*/')))}"
        folder.mkdir(parents=True)
        record = Record.model_validate(
            {
                "kind": "ridges",
                "software": "anisoscope 0.1.0",
                "created_at": "2026-11-01T06:00:00+00:00",
                "serial": f"{serial}-{folder.name}",
                "particulars": particulars or Particulars(),
                "product": "ridged plate",
                "verdict": "INCONCLUSIVE",
                "reasons": ("nobody looked",),
                "inputs": ({"name": "inputs/recipe.toml", "sha256": 32 * "5e"},),
                **dict.fromkeys(("model", "camera", "stage"), "none"),
                **dict.fromkeys(("d2", "dof", "p_value", "drift")),
                **dict.fromkeys(("poses", "budget", "frames"), ()),
                **{key: {} for key in ("convention", "white_reference", "recipe", "rig")},
            }
        )
        write_record(record, folder)
        return inspection.Inspected(record, folder, folder / "report.html")

    monkeypatch.setattr(inspecting, "inspect_part", inspect_part)
    return virtual_rig()


def rows_in(place):
    with open_history(place, create=False) as history:
        assert history.verify_chain() == []
        return history.rows()


def test_an_inspection_enters_the_history_of_its_folder(virtual_rig, inspect_on):
    rig = virtual_rig()
    code, err, folder = inspect_on(
        rig, "--lot", "L1", "--cavity", "2", "--operator", "M. M.", "--station", "east"
    )
    assert (code, err) == (0, "")
    (row,) = rows_in(rig.out)
    record = read_record(folder)
    assert (row.serial, row.lot, row.cavity, row.operator, row.station) == ("T-1", "L1", "2", "M. M.", "east")
    assert (row.verdict, row.seal, row.folder) == (record.verdict, seal_of(folder), str(folder))
    assert row.numbers["ln 0-90"] == pytest.approx(
        record.details.contrasts[0].measured, rel=1e-6
    )  # seven digits
    assert row.numbers["u ln 0-90"] == pytest.approx(record.details.contrasts[0].u, rel=1e-6)


def test_a_history_elsewhere_or_none(judged, inspect_on, monkeypatch, tmp_path):
    code, err, _ = inspect_on(judged, "--history", "none")
    assert (code, err) == (INCONCLUSIVE, "")
    monkeypatch.setenv("ANISOSCOPE_HISTORY", str(tmp_path / "mine.sqlite"))
    assert inspect_on(judged)[0] == INCONCLUSIVE
    assert [row.verdict for row in rows_in(tmp_path / "mine.sqlite")] == ["INCONCLUSIVE"]
    assert not (judged.out / "history.sqlite").exists()


def test_a_history_that_cannot_be_reached_changes_no_verdict_and_is_caught_up(judged, inspect_on, capsys):
    code, err, folder = inspect_on(judged, "--history", NOWHERE)
    assert code == INCONCLUSIVE
    assert read_record(folder).verdict == "INCONCLUSIVE"
    assert err.count("\n") == 1
    assert err.startswith("anisoscope: the inspection is not in the history yet: cannot read the history")
    assert f"`anisoscope history add {folder} --history postgresql+pg8000://me:***@" in err
    assert "secret" not in err
    for added in (1, 0):
        assert cli.run(["history", "add", str(judged.out), "--history", str(judged.out)]) == 0
        assert f"{added} added, {1 - added} there already" in capsys.readouterr().out
    assert [row.seal for row in rows_in(judged.out)] == [seal_of(folder)]


@pytest.mark.parametrize("what", ["program", "file"])
def test_whatever_goes_wrong_after_the_verdict_is_said_in_one_line(judged, inspect_on, monkeypatch, what):
    if what == "program":
        monkeypatch.setattr(History, "append_all", lambda *_: 1 / 0)
    else:
        judged.out.mkdir(parents=True)
        (judged.out / "history.sqlite").write_text("no database at all, but text " * 40)
    code, err, folder = inspect_on(judged)
    assert (code, err.count("\n")) == (INCONCLUSIVE, 1)
    assert ("division by zero" if what == "program" else "file is not a database") in err
    assert read_record(folder).verdict == "INCONCLUSIVE"


def test_a_history_that_cannot_be_is_refused_before_anything_moves(judged, inspect_on):
    code, err, folder = inspect_on(judged, "--history", "mysql://me:secret@h/db")
    assert (code, folder, err.count("\n")) == (64, None, 1)
    assert "secret" not in err
    assert not judged.out.exists()


def test_a_resumed_inspection_enters_as_well_and_once(virtual_rig, capsys, tmp_path):
    rig = virtual_rig()
    folder = rig.inspect().folder
    (folder / "record.json").unlink()
    assert cli.run(["resume", str(folder)]) == 0
    (row,) = rows_in(rig.out)
    assert row.seal == seal_of(folder)
    assert cli.run(["history", "add", str(folder), "--history", str(rig.out)]) == 0
    assert "0 added, 1 there already" in capsys.readouterr().out


def test_a_history_that_another_program_writes_for_long_does_not_hold_up_the_verdict(
    judged, inspect_on, monkeypatch
):
    monkeypatch.setattr("anisoscope.history.database.WAIT_S", 0.2)
    assert inspect_on(judged)[0] == INCONCLUSIVE
    other = sqlite3.connect(judged.out / "history.sqlite", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    code, err, folder = inspect_on(judged)
    other.execute("ROLLBACK")
    other.close()
    assert code == INCONCLUSIVE
    assert "database is locked" in err
    assert len(rows_in(judged.out)) == 1
    assert cli.run(["history", "add", str(folder), "--history", str(judged.out)]) == 0
    assert len(rows_in(judged.out)) == 2


def test_what_waits_for_a_history_enters_with_the_next_inspection(judged, inspect_on, monkeypatch):
    """A history that is away is not tried at every part; what waits is delivered in order and once."""
    now = [1000.0]
    monkeypatch.setattr(remembering.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(remembering, "_retry_at", {})
    place = judged.out / "mine.sqlite"
    opened = []

    def away(found, **options):
        opened.append(found)
        raise HistoryError("the server is away")

    with monkeypatch.context() as patch:
        patch.setattr(store, "open_history", away)
        for moment in (0.0, 59.0, 61.0):
            now[0] = 1000.0 + moment
            code, err, _ = inspect_on(judged, "--history", str(place))
            assert (code, err.count("\n")) == (INCONCLUSIVE, 1)
            assert "the server is away; it waits in" in err
        assert len(opened) == 2
    now[0] += 61.0
    code, err, _ = inspect_on(judged, "--history", str(place))
    assert (code, "3 inspections that waited are in the history now" in err) == (INCONCLUSIVE, True)
    rows = rows_in(place)
    assert len(rows) == len({row.seal for row in rows}) == 4
    assert not list((judged.out / "history-waiting").iterdir())


def test_a_damaged_record_keeps_no_other_inspection_from_the_history(judged, inspect_on, monkeypatch, capsys):
    monkeypatch.setattr(remembering, "_retry_at", {})
    place = judged.out / "mine.sqlite"
    _, _, folder = inspect_on(judged, "--history", "none")
    record = read_record(folder)
    (folder / "record.json").write_text("{", encoding="utf-8")
    remembering.remember(inspection.Inspected(record, folder, folder / "report.html"), place)
    assert "record.json is damaged" in capsys.readouterr().err
    _, _, other = inspect_on(judged, "--history", str(place))
    assert str(other) in {row.folder for row in rows_in(place)}
