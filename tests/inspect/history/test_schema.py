"""Tables of earlier and later versions."""

import shutil
import struct
from pathlib import Path

import pytest
from sqlalchemy import inspect, make_url, text

from anisoscope.history import schema
from anisoscope.history.address import parse_address
from anisoscope.history.chain import INSPECTION_FIELDS, START, digest_of, hash_of
from anisoscope.history.columns import columns_of, labels_of
from anisoscope.history.database import Database
from anisoscope.history.filters import Filters
from anisoscope.history.problems import HistoryError
from anisoscope.history.signs import give_sign
from anisoscope.history.store import open_history

DATA = Path(__file__).parents[2] / "data" / "history"


@pytest.fixture
def first_version(place, new_row):
    """A history as version 1 made it, with one inspection and without dispositions."""
    database = Database(parse_address(place))
    new = new_row(1)
    labels = labels_of(new)
    with database.writing() as connection:
        schema.migrate(connection, to=1)
        assert not inspect(connection).has_table("dispositions")
        connection.execute(schema.layouts.insert().values(id=1, digest=digest_of(labels), labels=labels))
        values = columns_of(new, database.address.path) | {"id": 1, "previous": START}
        values["numbers"] = struct.pack(f"<{len(new.numbers)}d", *new.numbers.values())
        own = hash_of("inspection", INSPECTION_FIELDS, values | {"labels": labels})
        connection.execute(schema.inspections.insert().values(values | {"layout": 1, "hash": own}))
    database.close()
    return place


def versions(place):
    database = Database(parse_address(place))
    with database.reading() as connection:
        found = list(connection.scalars(text("SELECT version FROM schema_versions ORDER BY version")))
    database.close()
    return found


def test_an_earlier_history_is_brought_up_to_date_and_keeps_its_rows(first_version, new_row):
    assert versions(first_version) == [1]
    with open_history(first_version) as history:
        assert [row.serial for row in history.rows()] == ["A1"]
        assert history.rows()[0].numbers == new_row(1).numbers
        history.append(new_row(2))
        assert history.series(Filters(), "ln 0-90").values.tolist() == [
            2.001,
            2.002,
        ]  # double, and single precision
        history.dispose(1, reviewer="Q", decision="accept")
        assert history.verify_chain() == []
    assert versions(first_version) == list(range(1, schema.VERSION + 1))
    with open_history(first_version) as history:
        assert len(history.dispositions(1)) == 1


@pytest.fixture
def last_version(request, place, new_row):
    """A copy of a database that the last version wrote: ten inspections and two dispositions."""
    if place.startswith("postgresql"):
        request.getfixturevalue("postgresql_programs").load(DATA / "history-3.sql", place)
    else:
        shutil.copy(DATA / "history-3.sqlite", place)
    return place


HEAD = "fbd15d122b7f5347f499ed6151df092626aad91fb762081af0800912df55aabb"
DECISIONS = {
    "d232437a0a34179ec174260a0731454b0ed44afa0329f646d090c1a5ff2ed192",  # in SQLite
    "cd1d9e6e3be21cce14841a4db172d28781f47b160ae949c7f194bd181063d5d6",  # in PostgreSQL, some minutes later
}


def test_a_history_of_the_last_version_is_read_as_it_is_and_brought_up_to_date_to_be_written(
    last_version, new_row
):
    with open_history(last_version, create=False) as history:
        assert history.head() == HEAD
        assert (decisions := history.disposition_head()) in DECISIONS
        assert history.verify_chain() == []
        assert history.rows()[8].numbers == {"d2": 1e-60, "p": 0.5}
        assert [row.serial for row in history.rows(Filters(product="wafer"))] == ["A1", "A3", "A5", "A7"]
    assert versions(last_version) == [1, 2, 3]
    with open_history(last_version, create=False) as history:
        before = history.rows()
        history.append(new_row(20))
        assert history.rows()[:10] == before
        assert history.verify_chain() == []
        assert all(map(history.holds, (HEAD, decisions)))
    assert versions(last_version) == list(range(1, schema.VERSION + 1))


def test_the_last_version_refuses_what_this_one_wrote(last_version, new_row, monkeypatch):
    with open_history(last_version) as history:
        history.append(new_row(20))
        head = history.head()
    with monkeypatch.context() as earlier:
        earlier.setattr(schema, "VERSION", 3)
        earlier.setattr(schema, "MIGRATIONS", schema.MIGRATIONS[:3])
        with pytest.raises(HistoryError, match=r"made by a later anisoscope \(version 7 .*update"):
            open_history(last_version)
    with open_history(last_version) as history:
        assert history.head() == head


def test_a_rig_that_may_only_add_is_sent_to_the_owner_of_an_earlier_history(postgresql_place, new_row):
    """And may sign heads once the owner has brought the tables up to date."""
    database = Database(parse_address(postgresql_place))
    role = make_url(postgresql_place).database.replace("anisoscope", "adder")
    with database.writing() as connection:
        schema.migrate(connection, to=3)
        for statement in (
            "GRANT USAGE ON SCHEMA public TO PUBLIC",
            f"CREATE ROLE {role} LOGIN PASSWORD 'secret'",
            f"GRANT SELECT, INSERT ON ALL TABLES IN SCHEMA public TO {role}",
        ):
            connection.execute(text(statement))
    url = make_url(postgresql_place).set(username=role, password="secret")
    with open_history(url.render_as_string(hide_password=False)) as rig:
        with pytest.raises(HistoryError, match=r"of version 3, .* needs 7, .* as their owner"):
            rig.append(new_row(1))
        with open_history(postgresql_place) as owner:
            owner.append(new_row(2))
        rig.append(new_row(1))
        assert [row.serial for row in rig.rows()] == ["A1", "A2"]
        with database.reading() as connection:
            for name in ("signed_heads", "time_stamps", "covariates", "stations"):
                assert connection.scalar(text(f"SELECT has_table_privilege('{role}', '{name}', 'INSERT')"))
        for _ in range(2):
            give_sign(rig, "east", "idle")
    with database.writing() as connection:
        connection.execute(text(f"DROP OWNED BY {role}"))
        connection.execute(text(f"DROP ROLE {role}"))
    database.close()


def test_a_step_that_fails_leaves_the_earlier_version(first_version, monkeypatch):
    def fail(connection):
        schema.metadata.create_all(connection, [schema.dispositions])
        raise RuntimeError("the power went")

    with monkeypatch.context() as patch:
        patch.setattr(schema, "MIGRATIONS", (schema.MIGRATIONS[0], fail))
        with pytest.raises(RuntimeError):
            open_history(first_version)
    assert versions(first_version) == [1]
    with open_history(first_version) as history:
        assert history.verify_chain() == []
    assert versions(first_version) == list(range(1, schema.VERSION + 1))


def test_a_history_of_a_later_program_is_refused_unchanged(place):
    with open_history(place) as history, history._database.writing() as connection:
        connection.execute(schema.versions.insert().values(version=schema.VERSION + 1, applied_us=0))
    with pytest.raises(HistoryError, match=r"was made by a later anisoscope .*update anisoscope here"):
        open_history(place)
