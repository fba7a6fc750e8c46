"""Audit of a history: every hash is recomputed."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from sqlalchemy import Connection, Table, func, select, text
from sqlalchemy.exc import SQLAlchemyError

from anisoscope.history import schema
from anisoscope.history.chain import DISPOSITION_FIELDS, INSPECTION_FIELDS, START, digest_of, hash_of
from anisoscope.history.database import Database
from anisoscope.history.problems import Damage, HistoryError

_AT_ONCE = 2000
Values = Mapping[str, Any]


def verify_chain(database: Database) -> list[Damage]:
    """Damage of a history; empty for an intact one.

    A changed row is named by itself: rows are linked by the hashes that are stored, and each is computed from its row.

    Raises:
        HistoryError: the database cannot be read at all.
    """
    with database.reading() as connection:
        found = [
            Damage("", None, f"changes of the table {name} are no longer refused: its triggers are missing")
            for name in schema.missing_guards(connection)
        ]
        labels = _labels(connection, found)
    tables: tuple[tuple[str, Table, Callable[[Values], bytes]], ...] = (
        ("inspection", schema.inspections, lambda row: _inspection_hash(row, labels)),
        ("disposition", schema.dispositions, lambda row: hash_of("disposition", DISPOSITION_FIELDS, row)),
    )
    for kind, table, own_hash in tables:
        found += _verify_table(database, kind, table, own_hash)
    if database.is_sqlite:
        found += _verify_file(database)
    return found


def _labels(connection: Connection, found: list[Damage]) -> dict[int, str]:
    labels = {}
    table = schema.layouts
    for number, digest, line in connection.execute(select(table.c.id, table.c.digest, table.c.labels)):
        labels[number] = line
        if digest_of(str(line)) != bytes(digest):
            found.append(Damage("", None, f"the labels of layout {number} were changed"))
    return labels


def _inspection_hash(row: Values, labels: Mapping[int, str]) -> bytes:
    return hash_of("inspection", INSPECTION_FIELDS, {**row, "labels": labels.get(row["layout"])})


def _verify_table(
    database: Database, kind: str, table: Table, own_hash: Callable[[Values], bytes]
) -> Iterator[Damage]:
    expected, link, link_known = 1, START, True
    for row_id, row in _rows(database, table):
        if row_id > expected:
            yield _gap(kind, expected, row_id - 1)
            link_known = False
        expected = row_id + 1
        if row is None:
            yield Damage(kind, row_id, "cannot be read")
            link_known = False
            continue
        if own_hash(row) != row["hash"]:
            yield Damage(kind, row_id, "was changed")
            link_known = False
        elif link_known and row["previous"] != link:
            yield Damage(kind, row_id, "does not follow the row before it: one of them was exchanged")
            link_known = True
        else:
            link_known = True
        link = row["hash"]


def _gap(kind: str, first: int, last: int) -> Damage:
    return Damage(kind, first, "is missing" if first == last else f"to {last} are missing")


def _rows(database: Database, table: Table) -> Iterator[tuple[int, Values | None]]:
    """All rows by id, None for an unreadable one; read in portions, so that writers do not wait."""
    with database.reading() as connection:
        last = int(connection.scalar(select(func.coalesce(func.max(table.c.id), 0))) or 0)
    for start in range(0, last, _AT_ONCE):
        stop = min(start + _AT_ONCE, last)
        yield from _part(database, table, start, stop)


def _part(database: Database, table: Table, start: int, stop: int) -> list[tuple[int, Values | None]]:
    statement = select(table).where(table.c.id > start, table.c.id <= stop).order_by(table.c.id)
    try:
        with database.reading() as connection:
            return [(row["id"], _plain(row)) for row in connection.execute(statement).mappings()]
    except (HistoryError, TypeError):
        if stop - start == 1:
            return [(stop, None)]
        middle = (start + stop) // 2
        return _part(database, table, start, middle) + _part(database, table, middle, stop)


def _plain(row: Mapping[Any, Any]) -> Values:
    """Bytes as bytes, whatever the driver calls them."""
    return {
        str(name): bytes(value) if isinstance(value, memoryview) else value for name, value in row.items()
    }


def _verify_file(database: Database) -> list[Damage]:
    """What SQLite itself finds in its file: indexes that disagree with their table, torn pages."""
    try:
        with database.reading() as connection:
            lines = list(connection.scalars(text("PRAGMA integrity_check(5)")))
    except (HistoryError, SQLAlchemyError) as error:
        return [Damage("", None, f"the file is damaged: {error}")]
    return [] if lines == ["ok"] else [Damage("", None, f"the file is damaged: {line}") for line in lines]
