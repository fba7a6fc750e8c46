"""Hash chain of the rows and its audit: each hash covers its row and the hash of the row before it."""

import hashlib
import json
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from sqlalchemy import Connection, Table, func, select, text
from sqlalchemy.exc import SQLAlchemyError

from anisoscope.history import schema
from anisoscope.history.database import Database
from anisoscope.history.problems import Damage, HistoryError
from anisoscope.history.rows import PRECISION

START = bytes(32)
"""What the first row has for the hash of the row before it."""
_encoded = json.JSONEncoder(separators=(",", ":")).encode
DIGITS = 7
"""Of the stored numbers of a row, in their display."""
_SINGLE, _DOUBLE = struct.Struct("<f"), struct.Struct("<d")
INSPECTION_FIELDS = (
    "id",
    "created_us",
    "serial",
    "product",
    "recipe",
    "lot",
    "cavity",
    "station",
    "operator",
    "verdict",
    "reasons",
    "folder",
    "seal",
    "software",
    "labels",
    "numbers",
    "previous",
)
COVARIATE_FIELDS = ("id", "measured_us", "serial", "source", "labels", "numbers", "previous")
DISPOSITION_FIELDS = ("id", "inspection", "created_us", "reviewer", "decision", "comment", "previous")


def hash_of(kind: str, fields: Sequence[str], row: Mapping[str, Any]) -> bytes:
    """SHA-256 of `text_of` of a row."""
    return hashlib.sha256(text_of(kind, fields, row).encode()).digest()


def text_of(kind: str, fields: Sequence[str], row: Mapping[str, Any]) -> str:
    """A row as a JSON list: its kind, then its columns in a fixed order, bytes as hexadecimal digits.

    The hash of the row before is one of the columns. Numbers and texts are told apart, so are nothing and an empty
    text; what two databases return differently (bytes and views of them) is not.
    """
    content = [kind, *(_plain(row[field]) for field in fields)]
    return _encoded(content)


def _plain(value: object) -> object:
    if isinstance(value, bytes | memoryview):
        return {"bytes": bytes(value).hex()}
    return value


def pack(values: Sequence[float]) -> bytes:
    """Numbers, little-endian: single precision where that is exact to `PRECISION`, else double.

    An uncertainty is known to two digits; seven are kept of every number. The record in the folder holds all.
    """
    try:
        single = struct.pack(f"<{len(values)}f", *values)
    except OverflowError:
        single = b""
    if single and all(
        one == stored or abs(one - stored) <= PRECISION * abs(one)
        for one, stored in zip(values, unpack(single, len(values)), strict=True)
    ):
        return single
    return struct.pack(f"<{len(values)}d", *values)


def unpack(data: bytes, count: int) -> tuple[float, ...]:
    """The numbers that `pack` took; of single precision those that a person would write.

    Args:
        data: what `pack` returned; rows of versions 1 and 2 of the tables are always double.
        count: how many numbers there are.
    """
    if len(data) == 8 * count:
        return struct.unpack(f"<{count}d", data)
    return tuple(float(f"{value:.{DIGITS}g}") for value in struct.unpack(f"<{count}f", data))


def unpack_one(data: bytes, count: int, place: int) -> float:
    """The number at a place, counted from 0, as `unpack` gives it."""
    if len(data) == 8 * count:
        return float(_DOUBLE.unpack_from(data, 8 * place)[0])
    return float(f"{_SINGLE.unpack_from(data, 4 * place)[0]:.{DIGITS}g}")


def unpack_rows(rows: Sequence[bytes], count: int) -> npt.NDArray[np.float64]:
    """The numbers of many rows at once, (rows, count), as `unpack` gives them."""
    found = np.full((len(rows), count), np.nan)
    lengths = np.fromiter(map(len, rows), dtype=np.int64, count=len(rows))
    for size in (4, 8) if count else ():
        every = np.flatnonzero(lengths == size * count)
        for at in np.array_split(
            every, len(every) // 10_000 + 1
        ):  # rounding takes ten times the memory of the numbers
            block = np.frombuffer(b"".join(rows[k] for k in at.tolist()), dtype=f"<f{size}").reshape(
                -1, count
            )
            found[at] = block if size == 8 else _written(block.astype(np.float64))
    return found


def _written(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Numbers rounded to `DIGITS` digits, each to the nearest double of its decimal form."""
    size = np.abs(values)
    usual = (size > 0.0) & np.isfinite(values)
    places = DIGITS - 1 - np.floor(np.log10(np.where(usual, size, 1.0)))
    scale = 10.0 ** np.abs(places)
    with np.errstate(over="ignore", invalid="ignore"):
        rounded = np.where(places >= 0.0, np.round(values * scale) / scale, np.round(values / scale) * scale)
    return np.where(usual, rounded, values)


def digest_of(labels: str) -> bytes:
    """SHA-256 of a list of labels."""
    return hashlib.sha256(labels.encode()).digest()


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
            Damage(
                "",
                None,
                f"changes of the table {name} are no longer refused: its triggers are missing or others",
            )
            for name in schema.unguarded(connection)
        ]
        labels = _labels(connection, found)
        version = schema.version_of(connection)
    tables: tuple[tuple[str, Table, Callable[[Values], bytes]], ...] = (
        (
            "inspection",
            schema.inspections,
            lambda row: _labelled("inspection", INSPECTION_FIELDS, row, labels),
        ),
        ("disposition", schema.dispositions, lambda row: hash_of("disposition", DISPOSITION_FIELDS, row)),
        ("covariates", schema.covariates, lambda row: _labelled("covariates", COVARIATE_FIELDS, row, labels)),
    )
    for kind, table, own_hash in tables if version >= schema.WITH_COVARIATES else tables[:2]:
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


def _labelled(kind: str, fields: Sequence[str], row: Values, labels: Mapping[int, str]) -> bytes:
    return hash_of(kind, fields, {**row, "labels": labels.get(row["layout"])})


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
            return [(row["id"], _as_bytes(row)) for row in connection.execute(statement).mappings()]
    except (HistoryError, TypeError):
        if stop - start == 1:
            return [(stop, None)]
        middle = (start + stop) // 2
        return _part(database, table, start, middle) + _part(database, table, middle, stop)


def _as_bytes(row: Mapping[Any, Any]) -> Values:
    """Row with bytes in place of the driver's memory views."""
    return {
        str(name): bytes(value) if isinstance(value, memoryview) else value for name, value in row.items()
    }


def _verify_file(database: Database) -> list[Damage]:
    """Damage that SQLite finds in its file: indexes that disagree with their table, torn pages."""
    try:
        with database.reading() as connection:
            lines = list(connection.scalars(text("PRAGMA integrity_check(5)")))
    except (HistoryError, SQLAlchemyError) as error:
        return [Damage("", None, f"the file is damaged: {error}")]
    return [] if lines == ["ok"] else [Damage("", None, f"the file is damaged: {line}") for line in lines]
