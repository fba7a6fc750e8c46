"""Inspections that wait for a history enter it later, in order and once."""

import json
from pathlib import Path

import pytest

from anisoscope.history.adding import add_folders
from anisoscope.history.address import parse_address
from anisoscope.history.spool import WAITING, deliver, wait
from anisoscope.history.store import History, open_history


@pytest.fixture
def waiting(place, new_row, tmp_path):
    """Four inspections that wait for a history, written down in another order than they were made in."""
    out = tmp_path / "inspections"
    out.mkdir()
    for number in (2, 0, 3, 1):
        wait(new_row(number), parse_address(place), out)
    return out


def files(out):
    return sorted(path.name for path in (out / WAITING).iterdir())


def test_what_waits_is_delivered_in_order_before_the_next_one(waiting, history, new_row):
    found = deliver(history, waiting, [new_row(9)])
    assert [row.serial for row in found.rows] == ["A0", "A1", "A2", "A3"]
    assert [(row.id, row.serial) for row in history.rows()][-1] == (5, "A9")
    assert history.rows()[:4] == list(found.rows)
    assert history.rows()[1].numbers == new_row(1).numbers
    assert files(waiting) == []
    assert history.verify_chain() == []


@pytest.mark.parametrize("moment", ["before", "after"])
def test_a_delivery_that_is_killed_loses_and_doubles_nothing(waiting, place, new_row, monkeypatch, moment):
    """Killed before the rows are safe, and between that and the end of their files."""
    append_all = History.append_all

    def killed(self, news):
        if moment == "after":
            append_all(self, news)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, open_history(place) as history:
        patch.setattr(History, "append_all", killed)
        with pytest.raises(KeyboardInterrupt):
            deliver(history, waiting)
    assert len(files(waiting)) == 4
    with open_history(place) as history:
        deliver(history, waiting, [new_row(9)])
        assert [row.serial for row in history.rows()] == ["A0", "A1", "A2", "A3", "A9"]
    assert files(waiting) == []


def test_what_waits_for_another_history_goes_on_waiting(waiting, tmp_path, new_row):
    with open_history(tmp_path / "other.sqlite") as other:
        assert deliver(other, waiting, [new_row(9)]).rows == ()
        assert other.count() == 1
    assert len(files(waiting)) == 4


@pytest.mark.parametrize(
    "change",
    [lambda text: text[:40], lambda text: "[" * 200_000, lambda text: text.replace("serial", "cereal")],
)
def test_a_damaged_file_is_named_and_holds_nobody_up(waiting, history, change):
    path = waiting / WAITING / files(waiting)[1]
    path.write_text(change(path.read_text()))
    found = deliver(history, waiting)
    assert [row.serial for row in found.rows] == ["A0", "A2", "A3"]
    assert len(found.damaged) == 1
    assert str(path) in found.damaged[0]
    assert "\n" not in found.damaged[0]
    assert files(waiting) == [path.name]


def test_adding_folders_delivers_what_waits_among_them(waiting, history):
    added = add_folders(history, [waiting])
    assert (added.added, added.known, added.refused) == (4, 0, ())
    assert files(waiting) == []


def test_no_password_is_written_down(new_row, tmp_path):
    address = parse_address("postgresql://me:secret@server/inspections")
    path = next(wait(new_row(1), address, tmp_path).iterdir())
    assert "secret" not in path.read_text()
    assert json.loads(path.read_text())["history"] == str(address)
    assert Path(path).stat().st_mode & 0o777 == 0o666 & ~umask()


def umask():
    import os

    present = os.umask(0o22)
    os.umask(present)
    return present
