"""A history in SQLite and in PostgreSQL: what goes in comes out, once, and stays."""

import shutil
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import make_url, text
from sqlalchemy.exc import DBAPIError

from anisoscope.base.errors import UsageError
from anisoscope.history.filters import Filters
from anisoscope.history.problems import HistoryError
from anisoscope.history.rows import NewRow
from anisoscope.history.store import open_history

FIELDS = tuple(NewRow.__dataclass_fields__)
HOSTILE = "x'); DROP TABLE inspections; --\" %s ? :name [red]\\ \x1b[2J \u202e é 漢 😀"


def content(row):
    return {name: getattr(row, name) for name in FIELDS}


def fill(history, new_row, count=10):
    return history.append_all([new_row(number) for number in range(count)])


def test_what_goes_in_comes_out(history, new_row):
    row = history.append(new_row(1))
    assert content(row) == content(new_row(1))
    assert history.rows() == [row]
    assert history.row(row.id) == row == history.row_by_seal(row.seal)
    assert history.row(99) is None


def test_nothing_and_an_empty_text_are_not_the_same(history, new_row):
    history.append(new_row(1, lot=None, cavity="", numbers={}, reasons=()))
    (row,) = history.rows()
    assert (row.lot, row.cavity, row.numbers, row.reasons) == (None, "", {}, ())


def test_numbers_come_back_to_the_last_bit(history, new_row):
    numbers = {"a": 0.1 + 0.2, "b": 5e-324, "c": -1.7976931348623157e308, "d": -0.0}
    found = history.append(new_row(1, numbers=numbers)).numbers
    assert {label: value.hex() for label, value in found.items()} == {
        label: value.hex() for label, value in numbers.items()
    }


def test_a_record_enters_once_however_often_it_is_added(history, new_row):
    first = history.append(new_row(1))
    again = history.append(new_row(1, folder="/elsewhere"))
    assert again == first
    assert [row.id for row in history.append_all([new_row(2), new_row(1), new_row(2)])] == [2, 1, 2]
    assert history.count() == 2
    assert history.verify_chain() == []


def test_hostile_text_stays_text(history, new_row):
    fields = ("serial", "product", "lot", "cavity", "station", "operator")
    for number, field in enumerate(fields):
        history.append(new_row(number, **{field: HOSTILE}))
        (found,) = history.rows(Filters(**{field: HOSTILE}))
        assert getattr(found, field) == HOSTILE
    assert history.count() == len(fields)
    assert history.verify_chain() == []


def test_hostile_filters_find_nothing_and_break_nothing(history, new_row):
    fill(history, new_row, 3)
    for field in ("serial", "product", "lot", "cavity", "station", "operator", "verdict"):
        assert history.rows(Filters(**{field: "' OR '1'='1"})) == []
    with pytest.raises(UsageError, match=r"the recipe .* is none"):
        history.rows(Filters(recipe="' OR '1'='1"))
    assert history.series(Filters(), "d2' OR 1=1 --").values.size == 0


def test_filters_narrow_and_the_limit_keeps_the_latest(history, new_row):
    rows = fill(history, new_row, 20)
    moment = rows[10].created_at

    def serials(**filters):
        return [row.serial for row in history.rows(Filters(**filters))]

    assert serials(since=moment) == [row.serial for row in rows[10:]]
    assert serials(until=moment) == [row.serial for row in rows[:10]]
    assert serials(lot="L1", cavity="1") == ["A1", "A13"]
    assert serials(verdict="FAIL", limit=2) == ["A12", "A17"]
    assert serials(serial="A3") == ["A3"]
    assert serials(station="west") == []
    assert history.count(Filters(lot="L0", limit=1)) == 7
    with pytest.raises(UsageError, match="limit"):
        history.rows(Filters(limit=0))


def test_recipes_are_found_by_identity_or_by_digits(history, new_row):
    fill(history, new_row, 2)
    history.append(new_row(5, recipe="ridged plate fedcba987654"))
    history.append(new_row(6, product="other", recipe="other fedcba987654"))
    assert [row.serial for row in history.rows(Filters(recipe="fedc"))] == ["A5", "A6"]
    assert [row.serial for row in history.rows(Filters(recipe="fedcba987654" + 52 * "0"))] == ["A5", "A6"]
    assert [row.serial for row in history.rows(Filters(recipe="ridged plate fedcba987654"))] == ["A5"]


def test_rows_come_by_time_not_by_the_order_in_which_they_were_added(history, new_row):
    history.append_all([new_row(number) for number in (5, 1, 3)])
    assert [row.serial for row in history.rows()] == ["A1", "A3", "A5"]
    assert history.series(Filters(), "ln 0-90").values.tolist() == [2.001, 2.003, 2.005]


def test_a_series_is_the_number_of_the_rows_that_have_it(history, new_row):
    fill(history, new_row, 5)
    history.append(new_row(5, numbers={"d2": 3.0}))
    history.append(new_row(6, numbers={"other": 1.0, "ln 0-90": 9.0}))
    found = history.series(Filters(), "ln 0-90")
    rows = [row for row in history.rows() if "ln 0-90" in row.numbers]
    assert found.ids.tolist() == [row.id for row in rows]
    assert found.values.tolist() == [row.numbers["ln 0-90"] for row in rows]
    assert (np.diff(found.times) >= np.timedelta64(0)).all()
    assert found.times[0] == np.datetime64(rows[0].created_at.replace(tzinfo=None))
    assert history.series(Filters(lot="L2"), "d2").values.tolist() == [1.2, 3.0]
    assert len(history.series(Filters(limit=2), "d2")) == 2
    assert len(history.series(Filters(), "nothing")) == 0
    assert set(history.labels()) == {*new_row(1).numbers, "other"}
    assert history.labels(Filters(serial="A5")) == ("d2",)


def test_reviewers_decide_in_rows_of_their_own(history, new_row):
    first, second = fill(history, new_row, 2)
    history.dispose(second.id, reviewer=" R. R. ", decision="hold")
    made = history.dispose(second.id, reviewer="Q", decision="accept", comment=HOSTILE)
    found = history.dispositions(second.id)
    assert [one.decision for one in found] == ["hold", "accept"]
    assert found[1] == made
    assert (found[0].reviewer, found[1].comment) == ("R. R.", HOSTILE)
    assert found[0].created_at <= found[1].created_at
    assert history.dispositions(first.id) == []
    assert history.row(second.id) == second
    assert history.verify_chain() == []


@pytest.mark.parametrize(
    ("row_id", "reviewer", "decision", "comment", "says"),
    [
        (9, "Q", "accept", "", "has no inspection 9"),
        (1, " ", "accept", "", "needs a reviewer"),
        (1, "Q", "burn", "", "a decision is one of accept, reject"),
        (1, "Q", "accept", 501 * "x", "500 are kept"),
    ],
)
def test_a_decision_that_is_none(sqlite_history, new_row, row_id, reviewer, decision, comment, says):
    sqlite_history.append(new_row(1))
    with pytest.raises(UsageError, match=says):
        sqlite_history.dispose(row_id, reviewer=reviewer, decision=decision, comment=comment)
    assert sqlite_history.dispositions(1) == []


CHANGES = (
    "UPDATE inspections SET verdict = 'PASS' WHERE id = 3",
    "DELETE FROM inspections WHERE id = 3",
    "UPDATE dispositions SET decision = 'accept'",
    "DELETE FROM dispositions",
    "UPDATE layouts SET labels = '[]'",
    "DELETE FROM schema_versions",
)


def test_the_database_refuses_to_change_what_is_written(history, new_row):
    before = fill(history, new_row, 4)
    history.dispose(3, reviewer="Q", decision="reject")
    for statement in CHANGES:
        with (
            history._database.engine.connect() as connection,
            pytest.raises(DBAPIError, match="append-only"),
        ):
            connection.execute(text(statement))
    assert history.rows() == before
    assert history.verify_chain() == []


def test_sqlite_refuses_to_replace_a_row(sqlite_history, new_row):
    before = fill(sqlite_history, new_row, 4)
    replacing = (
        "INSERT OR REPLACE INTO inspections "
        "SELECT {0}, created_us, serial, product, recipe, lot, cavity, station, operator, "
        "'PASS', reasons, folder, {1}, software, layout, numbers, previous, hash FROM inspections WHERE id = 3"
    )
    for values in (("id", "zeroblob(32)"), ("77", "seal")):
        with (
            sqlite_history._database.engine.connect() as connection,
            pytest.raises(DBAPIError, match="append-only"),
        ):
            connection.execute(text(replacing.format(*values)))
    assert sqlite_history.rows() == before


def test_postgresql_refuses_to_empty_a_table(postgresql_place, new_row):
    with open_history(postgresql_place) as history:
        before = fill(history, new_row, 4)
        with history._database.engine.connect() as connection, pytest.raises(DBAPIError, match="append-only"):
            connection.execute(text("TRUNCATE inspections CASCADE"))
        assert history.rows() == before


def test_postgresql_serves_a_rig_that_may_only_add(postgresql_place, new_row):
    role = make_url(postgresql_place).database.replace("anisoscope", "rig")
    with open_history(postgresql_place) as history:
        with history._database.engine.begin() as connection:
            connection.execute(text("GRANT USAGE ON SCHEMA public TO PUBLIC"))
            connection.execute(text(f"CREATE ROLE {role} LOGIN PASSWORD 'secret'"))
            connection.execute(text(f"GRANT SELECT, INSERT ON ALL TABLES IN SCHEMA public TO {role}"))
        url = history.address.url.set(username=role, password="secret")
        with open_history(url.render_as_string(hide_password=False)) as rig:
            fill(rig, new_row, 3)
            rig.dispose(1, reviewer="Q", decision="accept")
            assert rig.verify_chain() == []
        with history._database.engine.begin() as connection:
            connection.execute(text(f"DROP OWNED BY {role}"))
            connection.execute(text(f"DROP ROLE {role}"))


def test_both_databases_have_the_same_hashes(sqlite_place, postgresql_place, new_row):
    heads = []
    for place in (sqlite_place, postgresql_place):
        with open_history(place) as history:
            fill(history, new_row, 5)
            heads.append(history.head())
    assert heads[0] == heads[1]


def test_folders_move_with_a_history_that_lies_among_them(tmp_path, new_row):
    out = tmp_path / "out"
    with open_history(out / "history.sqlite") as history:
        history.append(new_row(1, folder=str(out / "A1")))
        history.append(new_row(2, folder="/elsewhere/A2"))
        assert [row.folder for row in history.rows()] == [str(out / "A1"), "/elsewhere/A2"]
    shutil.move(out, tmp_path / "archive")
    with open_history(tmp_path / "archive") as history:
        assert [Path(row.folder) for row in history.rows()] == [
            tmp_path / "archive/A1",
            Path("/elsewhere/A2"),
        ]
        assert history.verify_chain() == []


def test_a_file_outlives_its_program(sqlite_place, new_row):
    with open_history(sqlite_place) as history:
        fill(history, new_row, 3)
        head = history.head()
    with open_history(sqlite_place, create=False) as history:
        assert history.head() == head
        assert history.append(new_row(9)).id == 4
        assert history.holds(head)
        assert not history.holds(64 * "1")


def test_a_history_that_is_not_there(tmp_path):
    with pytest.raises(HistoryError, match=r"there is no history .*none\.sqlite"):
        open_history(tmp_path / "none.sqlite", create=False)
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_no_database(tmp_path):
    path = tmp_path / "history.sqlite"
    path.write_text("this is not a database, but long enough to be taken for one" * 20)
    with pytest.raises(HistoryError, match=f"the history {path}: file is not a database"):
        open_history(path)


def test_a_server_that_is_not_there_is_said_in_one_line_without_the_password():
    with pytest.raises(HistoryError) as caught:
        open_history("postgresql://me:secret@127.0.0.1:1/none")
    said = str(caught.value)
    assert "cannot read the history postgresql+pg8000://me:***@127.0.0.1:1/none" in said
    assert "secret" not in said
    assert "\n" not in said


def test_a_wrong_password_is_said_in_one_line(postgresql_place):
    url = make_url(postgresql_place).set(password="wrong")
    with pytest.raises(HistoryError, match="password authentication failed") as caught:
        open_history(url.render_as_string(hide_password=False))
    assert "\n" not in str(caught.value)


def test_times_before_and_after_the_epoch_are_exact(sqlite_history, new_row):
    moment = new_row(0).created_at.replace(microsecond=123457)
    for number, shift in enumerate((timedelta(0), -timedelta(days=40000))):
        assert sqlite_history.append(new_row(number, created_at=moment + shift)).created_at == moment + shift
