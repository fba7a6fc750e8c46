"""Tables of earlier and later versions."""

import struct

import pytest
from sqlalchemy import inspect, text

from anisoscope.history import schema
from anisoscope.history.address import parse_address
from anisoscope.history.chain import INSPECTION_FIELDS, START, digest_of, hash_of
from anisoscope.history.columns import columns_of, labels_of
from anisoscope.history.database import Database
from anisoscope.history.filters import Filters
from anisoscope.history.problems import HistoryError
from anisoscope.history.store import open_history


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
