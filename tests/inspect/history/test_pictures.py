"""Whose pictures they were first."""

import pytest
from sqlalchemy import text
from sqlalchemy.exc import DatabaseError

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
