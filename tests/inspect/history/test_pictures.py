"""Whose pictures they were first."""

import re
import time
from hashlib import sha256

import pytest
from sqlalchemy import text
from sqlalchemy.exc import DatabaseError

from anisoscope.cli.history.history import print_added
from anisoscope.history import statements
from anisoscope.history.adding import Added
from anisoscope.history.spool import deliver, wait
from anisoscope.history.store import open_history

ONE, TWO, OTHER = "ab" * 32, "f0" * 32, "0c" * 32


def test_the_first_inspection_of_another_part_is_found(place, new_row):
    with open_history(place) as history:
        history.append_all([new_row(1, pixels=(ONE, TWO)), new_row(2, pixels=(TWO, ONE))])
        assert history.used_by_others([OTHER, TWO], "B") == history.row(1)
        assert history.used_by_others([ONE], "A1") == history.row(2)
        assert history.used_by_others([OTHER], "B") is None
        assert history.used_by_others([], "B") is None
        assert history.verify_chain() == []


def test_pictures_are_found_by_an_index(history, new_row):
    history.append_all([new_row(number, pixels=(picture(number, 0),)) for number in range(50)])
    sqlite = history._database.is_sqlite
    with history._database.reading() as connection:
        if not sqlite:  # so few rows are read sooner than their index
            connection.execute(text("SET LOCAL enable_seqscan = off"))
        statement = statements.shown_by_others([1, 2], "B").compile(
            connection, compile_kwargs={"literal_binds": True}
        )
        explain = "EXPLAIN QUERY PLAN" if sqlite else "EXPLAIN"
        lines = connection.execute(text(f"{explain} {str(statement).replace(':', chr(92) + ':')}"))
        plan = "\n".join(str(tuple(line)) for line in lines)
    assert "pictures" in plan
    assert not re.search(r"SCAN (pictures|inspections)|Seq Scan", plan), plan


def test_a_serial_number_with_different_frames_is_found_and_all_are_kept(history, new_row):
    """Two inspections with other pictures are; one that judged the same frames again is no second one."""
    rows = [
        ("A1", (ONE, TWO)),
        ("A2", (OTHER,)),
        ("A1", (ONE, TWO)),
        ("A2", ("dd" * 32,)),
        ("A3", ()),
        ("A3", ()),
    ]
    news = [new_row(number, serial=serial, pixels=pixels) for number, (serial, pixels) in enumerate(rows)]
    history.append_all(news[:3])
    assert history.differing_frames() == {}
    history.append_all(news[3:])
    assert history.differing_frames(3) == {"A2": 2}
    assert history.differing_frames(6) == {}
    assert history.count() == 6


def test_what_was_added_is_said_with_such_serial_numbers(capsys):
    print_added(Added(2, 0, (), {"A2": 2, **{f"B{k}": 2 for k in range(6)}}), "here", json_=False)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "A2 has 2 inspections with different frames: all of them are kept"
    assert lines[5:] == ["so have 2 more serial numbers", "2 added, 0 there already: here"]


def picture(part, pose):
    return sha256(f"{part}/{pose}".encode()).hexdigest()


@pytest.mark.soak
def test_two_hundred_thousand_inspections_hold_no_part_up(tmp_path, new_row):
    """24 pictures that nobody has seen are looked up in 600,000; the camera takes seconds for them."""
    parts, at_once, poses = 200_000, 2000, range(3)
    with open_history(tmp_path / "history.sqlite") as history:
        for first in range(0, parts, at_once):
            rows = range(first, first + at_once)
            history.append_all([new_row(n, pixels=tuple(picture(n, pose) for pose in poses)) for n in rows])
        took_s = []
        for number in range(20):
            asked = [picture(parts + number, pose) for pose in range(24)]
            begun = time.perf_counter()
            assert history.used_by_others(asked, "new") is None
            took_s.append(time.perf_counter() - begun)
        assert history.used_by_others([picture(parts - 1, 2)], "new").serial == f"A{parts - 1}"
    assert sorted(took_s)[10] < 0.02


def test_a_part_may_be_inspected_again(place, new_row):
    with open_history(place) as history:
        history.append_all([new_row(1, serial="A", pixels=(ONE,)), new_row(2, serial="A", pixels=(ONE,))])
        assert history.used_by_others([ONE], "A") is None


def test_pictures_wait_with_their_row(tmp_path, new_row):
    with open_history(tmp_path / "history.sqlite") as history:
        wait(new_row(1, pixels=(ONE,)), history.address, tmp_path)
        deliver(history, tmp_path)
        assert history.used_by_others([ONE], "B").serial == "A1"


def test_pictures_are_only_added_to(sqlite_place, new_row):
    with open_history(sqlite_place) as history:
        history.append(new_row(1, pixels=(ONE,)))
        with (
            pytest.raises(DatabaseError, match="append-only"),
            history._database.engine.begin() as connection,
        ):
            connection.execute(text("DELETE FROM pictures"))
