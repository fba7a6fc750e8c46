"""Cycle data of machines: chained, added once, and joined with parts by serial number or time."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from sqlalchemy import text

from anisoscope.history import schema
from anisoscope.history.columns import to_us
from anisoscope.history.covariates import CycleData
from anisoscope.history.store import open_history

START = datetime(2026, 11, 1, 6, 0, tzinfo=UTC)


def tamper(history, statement):
    """A change by somebody with all rights; the triggers are put aside and back again."""
    engine = history._database.engine
    with engine.begin() as connection:
        if engine.dialect.name == "postgresql":
            connection.execute(text("SET LOCAL session_replication_role = replica"))
            connection.execute(text(statement))
            return
        query = "SELECT name, sql FROM sqlite_master WHERE type = 'trigger' AND tbl_name = 'covariates'"
        saved = connection.execute(text(query)).all()
        for line in (*(f"DROP TRIGGER {name}" for name, _ in saved), statement, *(sql for _, sql in saved)):
            connection.execute(text(line))


def cycle(minute=None, serial=None, **numbers):
    at = None if minute is None else START + timedelta(minutes=minute)
    return CycleData(at=at, serial=serial, source="cycles.csv", numbers=numbers)


def test_data_are_added_once_and_chained(history, new_row):
    history.append(new_row(1))
    zeros = history.covariate_head()
    news = [cycle(k, melt=230.0 + k, mould=60.0) for k in range(700)]
    assert history.add_covariates(news) == 700
    first = history.covariate_head()
    assert history.add_covariates([*news, *news, cycle(3, melt=1.0)]) == 1
    assert history.verify_chain() == []
    assert history.holds(first)
    assert history.holds(history.covariate_head())
    assert zeros == "00" * 32 != first
    found = history.covariates()
    assert found.numbers["melt"][[0, 699, 700]].tolist() == [230.0, 929.0, 1.0]
    assert np.isnan(found.numbers["mould"][700])


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE covariates SET serial = 'B' WHERE id = 2",
        "UPDATE covariates SET measured_us = measured_us + 1 WHERE id = 2",
        "UPDATE covariates SET source = 'x' WHERE id = 2",
        "UPDATE covariates SET numbers = (SELECT numbers FROM covariates WHERE id = 1) WHERE id = 2",
    ],
)
def test_what_is_changed_behind_our_back_is_found(history, statement):
    history.add_covariates([cycle(k, f"A{k}", melt=1.0 * k) for k in range(3)])
    tamper(history, statement)
    assert [str(one) for one in history.verify_chain()] == ["covariates 2: was changed"]


def test_the_database_refuses_changes(history):
    history.add_covariates([cycle(1, melt=1.0)])
    with pytest.raises(Exception, match="append-only"), history._database.engine.begin() as connection:
        connection.execute(text("DELETE FROM covariates"))


def test_parts_take_their_own_data_else_the_last_before_them_a_day_old_at_most(sqlite_history):
    sqlite_history.add_covariates(
        [
            cycle(30, melt=3.0),
            cycle(10, melt=1.0),
            cycle(20, melt=2.0),
            cycle(5, "A2", melt=20.0),
            cycle(None, "A3", melt=30.0),
            cycle(25, "A3", melt=31.0),
            cycle(90, "A3", melt=32.0),
            cycle(21, mould=60.0),
        ]
    )
    found = sqlite_history.covariates()
    minutes = [9, 10, 29, 15, 28, 26, 30 + 1440, 31 + 1440]
    serials = ["A1", "A1", "A1", "A2", "A3", "A4", "A5", "A6"]
    times = np.array([to_us(START + timedelta(minutes=m)) for m in minutes])
    of_parts = found.of_parts(serials, times)
    assert of_parts["melt"].tolist()[1:7] == [1.0, 2.0, 20.0, 31.0, 2.0, 3.0]
    assert np.isnan(of_parts["melt"][[0, 7]]).all()
    assert np.nan_to_num(of_parts["mould"]).tolist() == [0.0, 0.0, 60.0, 0.0, 60.0, 60.0, 0.0, 0.0]


def test_an_earlier_history_has_none_and_gets_the_table_with_the_first(sqlite_place, new_row, monkeypatch):
    with monkeypatch.context() as earlier:
        earlier.setattr(schema, "VERSION", 4)
        earlier.setattr(schema, "MIGRATIONS", schema.MIGRATIONS[:4])
        earlier.setattr(schema.migrate, "__defaults__", (4,))
        with open_history(sqlite_place) as history:
            history.append(new_row(1))
    with open_history(sqlite_place) as history:
        assert history.covariates().numbers == {}
        assert history.covariate_head() == "00" * 32
        assert history.verify_chain() == []
        before = history.rows()
        assert history.add_covariates([cycle(1, melt=1.0)]) == 1
        assert history.rows() == before
        assert history.verify_chain() == []
    with monkeypatch.context() as earlier:
        earlier.setattr(schema, "VERSION", 4)
        with pytest.raises(schema.HistoryError, match=r"later anisoscope \(version 7"):
            open_history(sqlite_place)
