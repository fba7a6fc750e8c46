"""New rows at the end of the chains, within a transaction in which nobody else writes."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Table, func, insert, select

from anisoscope.history import query, schema
from anisoscope.history.chain import DISPOSITION_FIELDS, INSPECTION_FIELDS, START, digest_of, hash_of
from anisoscope.history.columns import columns_of, disposition_from, labels_of, row_from, to_us
from anisoscope.history.dispositions import Disposition
from anisoscope.history.rows import NewRow, Row


def head(connection: Connection, table: Table) -> tuple[int, bytes]:
    """Id and hash of the last row of a chain; 0 and zeros before the first."""
    last = select(table.c.id, table.c.hash).order_by(table.c.id.desc()).limit(1)
    found = connection.execute(last).first()
    return (0, START) if found is None else (int(found[0]), bytes(found[1]))


def append_rows(connection: Connection, news: Sequence[NewRow], history: Path | None) -> list[Row]:
    """Add inspections; those whose seal is there already are passed over.

    Args:
        connection: in a transaction that writes.
        news: the inspections.
        history: file of the history, if it is one.

    Returns:
        For each inspection its row, be it new or earlier.
    """
    known = query.by_seals(connection, list(dict.fromkeys(new.seal for new in news)))
    rows = {row.seal: row for row in (row_from(values, history) for values in known)}
    last, previous = head(connection, schema.inspections)
    added: list[dict[str, Any]] = []
    layouts: dict[str, int] = {}
    for new in news:
        if new.seal in rows:
            continue
        last += 1
        labels = labels_of(new)
        if labels not in layouts:
            layouts[labels] = _layout(connection, labels)
        values = columns_of(new, history) | {"id": last, "previous": previous, "layout": layouts[labels]}
        previous = hash_of("inspection", INSPECTION_FIELDS, values | {"labels": labels})
        values["hash"] = previous
        rows[new.seal] = row_from(values | {"labels": labels}, history)
        added.append(values)
    if added:
        connection.execute(insert(schema.inspections), added)
    return [rows[new.seal] for new in news]


def _layout(connection: Connection, labels: str) -> int:
    """The number under which a list of labels is kept; it is kept from now on if it was not."""
    digest = digest_of(labels)
    table = schema.layouts
    found = connection.scalar(select(table.c.id).where(table.c.digest == digest))
    if found is not None:
        return int(found)
    number = int(connection.scalar(select(func.coalesce(func.max(table.c.id), 0))) or 0) + 1
    connection.execute(insert(table).values(id=number, digest=digest, labels=labels))
    return number


def append_disposition(
    connection: Connection, inspection: int, reviewer: str, decision: str, comment: str
) -> Disposition:
    """Add what a reviewer decided about an inspection that exists."""
    last, previous = head(connection, schema.dispositions)
    values: dict[str, Any] = {
        "id": last + 1,
        "inspection": inspection,
        "created_us": to_us(datetime.now(UTC)),
        "reviewer": reviewer,
        "decision": decision,
        "comment": comment,
        "previous": previous,
    }
    values["hash"] = hash_of("disposition", DISPOSITION_FIELDS, values)
    connection.execute(insert(schema.dispositions).values(values))
    return disposition_from(values)
