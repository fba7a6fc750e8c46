"""Whatever somebody changes behind the program's back is found, and the row is named."""

import math
import re
import sqlite3
from contextlib import closing
from itertools import combinations

import pytest
from sqlalchemy import text

from anisoscope.history import schema
from anisoscope.history.chain import hash_of, pack, unpack, unpack_one
from anisoscope.history.rows import _shortened
from anisoscope.history.schema import inspections
from anisoscope.history.store import open_history

COUNT = 6
VICTIM = 4
# Every column, and a value that differs from the right one as little as possible.
FLIPPED = {
    "created_us": "created_us + 1",
    "serial": "serial || ' '",
    "product": "product || '.'",
    "recipe": "replace(recipe, '0', '1')",
    "lot": "NULL",
    "cavity": "''",
    "station": "upper(station)",
    "operator": "replace(operator, 'M', 'N')",
    "verdict": "'PASS'",
    "reasons": "replace(reasons, 'well', 'bell')",
    "folder": "folder || '/'",
    "software": "software || '1'",
}


def fill(history, new_row, count=COUNT):
    rows = history.append_all([new_row(number, verdict="FAIL") for number in range(count)])
    history.dispose(VICTIM, reviewer="Q", decision="reject", comment="burrs")
    history.dispose(VICTIM, reviewer="R", decision="accept", comment="no burrs")
    return rows


def tamper(history, *statements):
    """What somebody with all rights over the database can do; the triggers are put aside and back again."""
    engine = history._database.engine
    with engine.begin() as connection:
        if engine.dialect.name == "postgresql":
            connection.execute(text("SET LOCAL session_replication_role = replica"))
            for statement in statements:
                connection.execute(text(statement))
            return
        saved = connection.execute(text("SELECT name, sql FROM sqlite_master WHERE type = 'trigger'")).all()
        for name, _ in saved:
            connection.execute(text(f"DROP TRIGGER {name}"))
        for statement in statements:
            connection.execute(text(statement))
        for _, sql in saved:
            connection.execute(text(sql))


def said(history):
    return [str(one) for one in history.verify_chain()]


def test_a_change_in_any_column_names_its_row_and_no_other(history, new_row):
    fill(history, new_row)
    for column, value in FLIPPED.items():
        keep = f"CREATE TABLE kept AS SELECT id, {column} AS was FROM inspections WHERE id = {VICTIM}"
        tamper(history, keep, f"UPDATE inspections SET {column} = {value} WHERE id = {VICTIM}")
        assert said(history) == [f"inspection {VICTIM}: was changed"], column
        back = f"UPDATE inspections SET {column} = (SELECT was FROM kept) WHERE id = {VICTIM}"
        tamper(history, back, "DROP TABLE kept")
        assert said(history) == [], column


@pytest.mark.parametrize("column", ["seal", "numbers", "previous", "hash"])
def test_a_change_of_any_byte_of_what_is_binary(sqlite_history, new_row, column):
    fill(sqlite_history, new_row)
    with closing(sqlite3.connect(sqlite_history.address.path)) as other:
        (data,) = other.execute(f"SELECT {column} FROM inspections WHERE id = {VICTIM}").fetchone()
    for place in range(len(data)):
        changed = bytearray(data)
        changed[place] ^= 1 << (place % 8)
        tamper(sqlite_history, f"UPDATE inspections SET {column} = x'{changed.hex()}' WHERE id = {VICTIM}")
        assert f"inspection {VICTIM}: was changed" in said(sqlite_history), place
    tamper(sqlite_history, f"UPDATE inspections SET {column} = x'{data.hex()}' WHERE id = {VICTIM}")
    assert said(sqlite_history) == []


def test_a_row_whose_hash_was_computed_anew_no_longer_fits_the_next_one(history, new_row):
    fill(history, new_row)
    tamper(history, f"UPDATE inspections SET verdict = 'PASS' WHERE id = {VICTIM}")
    with history._database.reading() as connection:
        row = connection.execute(inspections.select().where(inspections.c.id == VICTIM)).mappings().one()
        labels = connection.scalar(text("SELECT labels FROM layouts"))
    from anisoscope.history.chain import INSPECTION_FIELDS

    forged = hash_of("inspection", INSPECTION_FIELDS, {**row, "labels": labels}).hex()
    digits = f"x'{forged}'" if history._database.is_sqlite else f"'\\x{forged}'"
    tamper(history, f"UPDATE inspections SET hash = {digits} WHERE id = {VICTIM}")
    assert said(history) == [
        f"inspection {VICTIM + 1}: does not follow the row before it: one of them was exchanged"
    ]


def test_rows_that_were_removed(history, new_row):
    fill(history, new_row)
    head = history.head()
    tamper(history, "DELETE FROM inspections WHERE id = 2")
    assert said(history) == ["inspection 2: is missing"]
    tamper(history, "DELETE FROM inspections WHERE id IN (1, 3)")
    assert said(history) == ["inspection 1: to 3 are missing"]
    assert history.holds(head)
    tamper(history, f"DELETE FROM inspections WHERE id = {COUNT}")
    assert not history.holds(head)  # a cut end is seen by who noted the head


def test_what_reviewers_decided_is_chained_as_well(history, new_row):
    fill(history, new_row)
    tamper(history, "UPDATE dispositions SET decision = 'accept' WHERE id = 1")
    assert said(history) == ["disposition 1: was changed"]
    tamper(history, "DELETE FROM dispositions WHERE id = 1")
    assert said(history) == ["disposition 1: is missing"]


def test_a_cut_end_of_the_dispositions_is_seen_by_who_noted_their_head(history, new_row):
    fill(history, new_row)
    head = history.disposition_head()
    assert history.holds(head)
    tamper(history, "DELETE FROM dispositions")
    assert said(history) == []
    assert not history.holds(head)
    assert history.holds(history.disposition_head())


def test_labels_of_numbers_belong_to_the_rows(history, new_row):
    fill(history, new_row)
    tamper(history, "UPDATE layouts SET labels = replace(labels, '0-90', '0-91')")
    found = said(history)
    assert found[0] == "the labels of layout 1 were changed"
    assert found[1:] == [f"inspection {number}: was changed" for number in range(1, COUNT + 1)]


def test_a_trigger_that_was_taken_away_is_missed(history, new_row):
    fill(history, new_row)
    table = " ON inspections" if not history._database.is_sqlite else ""
    with history._database.engine.begin() as connection:
        connection.execute(text(f"DROP TRIGGER inspections_refuse_delete{table}"))
    assert said(history) == [
        "changes of the table inspections are no longer refused: its triggers are missing or others"
    ]


def test_a_trigger_of_the_same_name_that_refuses_nothing_is_named(history, new_row):
    fill(history, new_row)
    if history._database.is_sqlite:
        name = "dispositions_refuse_delete"
        hollow = [
            f"DROP TRIGGER {name}",
            f"CREATE TRIGGER {name} BEFORE DELETE ON dispositions BEGIN SELECT 1; END",
        ]
        tables = ["dispositions"]
    else:
        hollow = [
            (
                "CREATE OR REPLACE FUNCTION anisoscope_refuse() RETURNS trigger LANGUAGE plpgsql AS "
                "$body$ BEGIN RETURN OLD; END $body$"
            )
        ]
        tables = [table.name for table in schema.GUARDED]
    with history._database.engine.begin() as connection:
        for statement in hollow:
            connection.execute(text(statement))
    assert said(history) == [
        f"changes of the table {table} are no longer refused: its triggers are missing or others"
        for table in tables
    ]


def test_a_type_that_was_changed_is_a_change(sqlite_history, new_row):
    fill(sqlite_history, new_row)
    tamper(sqlite_history, f"UPDATE inspections SET seal = CAST(seal AS TEXT) WHERE id = {VICTIM}")
    assert any(
        re.match(f"inspection {VICTIM}: (was changed|cannot be read)", line) for line in said(sqlite_history)
    )


def payload(path, serial):
    """Where the content of a row lies in the file: from its serial number to its reasons."""
    data = path.read_bytes()
    start = data.index(serial.encode() + b"ridged plate")
    return start, data.index(b"indeed", start)


def test_any_byte_of_a_row_in_the_file_itself(sqlite_place, new_row):
    """As a failing disk or a hexadecimal editor changes it."""
    with open_history(sqlite_place) as history:
        fill(history, new_row)
        with history._database.engine.connect() as connection:
            connection.exec_driver_sql("COMMIT")
            connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
        path = history.address.path
    start, stop = payload(path, "A3")
    for place in range(start, stop, 3):
        data = bytearray(path.read_bytes())
        data[place] ^= 0x81  # no ASCII any more, so that the text cannot even be decoded
        path.write_bytes(bytes(data))
        with open_history(path) as history:
            assert any(line.startswith("inspection 4: ") for line in said(history)), place
        data[place] ^= 0x81
        path.write_bytes(bytes(data))
    with open_history(path) as history:
        assert said(history) == []


def test_a_file_with_torn_pages_is_said_to_be_damaged(sqlite_place, new_row):
    with open_history(sqlite_place) as history:
        history.append_all([new_row(number) for number in range(200)])
        path = history.address.path
    with closing(sqlite3.connect(path)) as other:
        other.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    data = bytearray(path.read_bytes())
    middle = len(data) // 2 // 4096 * 4096
    data[middle : middle + 4096] = bytes(4096)
    path.write_bytes(bytes(data))
    with open_history(path) as history:
        assert said(history)


def test_what_is_hashed_tells_apart_what_databases_confuse():
    def of(value):
        return hash_of("inspection", ("a", "b"), {"a": value, "b": ""})

    values = [None, "", "None", 1, "1", 1.0, b"1", "[]", {"x": 1}, True]
    assert len({of(value) for value in values}) == len(values)
    assert of(b"12") == of(memoryview(b"12"))
    assert hash_of("disposition", ("a",), {"a": 1}) != hash_of("inspection", ("a",), {"a": 1})


@pytest.mark.parametrize(
    ("values", "size"),
    [
        ([], 0),
        ([2.1, -0.0234567, 0.0, 0.25, 1e-30, math.inf], 4),
        ([2.1, 1e-60], 8),  # a probability that single precision cannot hold
        ([2.1, 1e300], 8),
        ([2.1, math.nan], 8),
    ],
)
def test_numbers_come_back_as_they_were_to_seven_digits(values, size):
    data = pack(values)
    assert len(data) == size * len(values)
    assert unpack(data, len(values)) == pytest.approx(values, rel=1e-6, abs=0.0, nan_ok=True)
    assert [unpack_one(data, len(values), place) for place in range(len(values))] == pytest.approx(
        list(unpack(data, len(values))), rel=0.0, abs=0.0, nan_ok=True
    )


def test_what_has_seven_digits_comes_back_exactly():
    values = [k * 1e-4 - 0.5 for k in range(10_000)]
    written = [float(f"{value:.7g}") for value in values]
    assert list(unpack(pack(written), len(written))) == written


def test_a_row_of_fifteen_contrasts_weighs_about_a_kilobyte(sqlite_place, new_row):
    """Six poses, all pairs, with numbers that do not repeat, and the indexes; growth is counted after the tables."""
    pairs = [f"{a}-{b}" for a, b in combinations((0, 45, 90, 135, 180, 225), 2)]
    kinds = ("", "u ", "deviation ", "tolerance ")

    def row(number):
        labels = [f"{kind}ln {pair}" for pair in pairs for kind in kinds] + ["d2", "p", "area share", "drift"]
        numbers = {label: math.sin(number + 7 * at) for at, label in enumerate(labels)}
        reasons = [f"ln ratio {pair} at tilt 0° deviates by {number} (tolerance ±0.25)" for pair in pairs]
        folder = f"/data/inspections/PART-{number:06d}-20240101T000000Z"
        return new_row(number, numbers=numbers, reasons=_shortened(tuple(reasons)), folder=folder)

    def size():
        with closing(sqlite3.connect(sqlite_place)) as database:
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            return database.execute("PRAGMA page_count").fetchone()[0] * 4096

    sizes = []
    with open_history(sqlite_place) as history:
        for start in (0, 500):
            history.append_all([row(number) for number in range(start, start + 500)])
            sizes.append(size())
    assert (sizes[1] - sizes[0]) / 500 <= 1100
