"""SQL statements of the history: selections, and rows appended to the hash chains."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, cast

from sqlalchemy import ColumnElement, Connection, Select, Table, func, insert, select

from anisoscope.base.errors import UsageError
from anisoscope.history import schema
from anisoscope.history.chain import (
    DISPOSITION_FIELDS,
    INSPECTION_FIELDS,
    START,
    digest_of,
    hash_of,
    unpack_one,
)
from anisoscope.history.columns import columns_of, disposition_from, labels_of, parsed_labels, row_from, to_us
from anisoscope.history.dispositions import Disposition
from anisoscope.history.filters import MOST_IDS, Filters
from anisoscope.history.rows import RECIPE_DIGITS, NewRow, Row
from anisoscope.history.schema import dispositions as _dispositions
from anisoscope.history.schema import inspections, layouts

Values = Mapping[str, Any]
_EQUAL = ("lot", "cavity", "product", "station", "operator", "serial", "verdict")
_DIGITS = re.compile(r"[0-9a-f]{4,64}")
_AT_ONCE = 500
_JOINED = inspections.join(layouts, inspections.c.layout == layouts.c.id)
_WHOLE = select(inspections, layouts.c.labels).select_from(_JOINED)


def conditions(connection: Connection, filters: Filters) -> list[ColumnElement[bool]]:
    """Filters as SQL conditions; all user input is bound as parameters.

    Raises:
        UsageError: a filter that makes no sense.
    """
    table = inspections.c
    found = [table[name] == value for name in _EQUAL if (value := getattr(filters, name)) is not None]
    if filters.since is not None:
        found.append(table.created_us >= to_us(filters.since))
    if filters.until is not None:
        found.append(table.created_us < to_us(filters.until))
    if filters.ids is not None:
        if len(filters.ids) > MOST_IDS:
            raise UsageError(f"a selection names {MOST_IDS} ids at most, not {len(filters.ids)}")
        found.append(table.id.in_(filters.ids))
    if filters.recipe is not None:
        product, _, digits = filters.recipe.rpartition(" ")
        if not _DIGITS.fullmatch(digits):
            raise UsageError(
                f"the recipe {filters.recipe[:80]!r} is none: name it as the history shows it, or by the first four "
                "or more digits of its SHA-256"
            )
        found.append(table.recipe.in_(_recipes(connection, digits[:RECIPE_DIGITS])))
        if product:
            found.append(table.product == product)
    if filters.limit is not None and filters.limit < 1:
        raise UsageError(f"the limit is a positive whole number, not {filters.limit}")
    return found


def _recipes(connection: Connection, digits: str) -> list[str]:
    """Recipes whose SHA-256 begins with these digits; one look into the index for each."""
    column, last, found = inspections.c.recipe, digits, list[str]()
    condition = column >= digits
    while (
        last := connection.scalar(select(func.min(column)).where(condition, column < f"{digits}g"))
    ) is not None:
        found.append(last)
        condition = column > last
    return found


def chosen(connection: Connection, statement: Select[Any], filters: Filters) -> Select[Any]:
    """Selection in descending order of time, limited in number."""
    order = (inspections.c.created_us.desc(), inspections.c.id.desc())
    statement = statement.where(*conditions(connection, filters)).order_by(*order)
    return statement if filters.limit is None else statement.limit(filters.limit)


def rows(connection: Connection, filters: Filters) -> list[Values]:
    """Inspections with their labels, the oldest first."""
    found = connection.execute(chosen(connection, _WHOLE, filters)).mappings().all()
    return [_values(row) for row in reversed(found)]


def stream(connection: Connection, filters: Filters, product: str | None = None) -> Iterator[Values]:
    """Inspections with their labels, the oldest first, as the database delivers them; `product` narrows the filters."""
    statement = _WHOLE.where(*_selected(connection, filters)).order_by(
        inspections.c.created_us, inspections.c.id
    )
    if product is not None:
        statement = statement.where(inspections.c.product == product)
    found = connection.execute(statement, execution_options={"stream_results": True, "yield_per": _AT_ONCE})
    yield from map(_values, found.mappings())


def _selected(connection: Connection, filters: Filters) -> list[ColumnElement[bool]]:
    """Conditions of the inspections that filters let through, their limit included."""
    if filters.limit is None:
        return conditions(connection, filters)
    return [inspections.c.id.in_(chosen(connection, select(inspections.c.id), filters))]


def verdicts(connection: Connection, filters: Filters) -> dict[str, dict[str, int]]:
    """Number of inspections by product and verdict; the product that came first stands first."""
    table = inspections.c
    statement = select(table.product, table.verdict, func.count(), func.min(table.created_us))
    statement = statement.where(*_selected(connection, filters)).group_by(table.product, table.verdict)
    found: dict[str, dict[str, int]] = {}
    for product, verdict, number, _ in sorted(connection.execute(statement).all(), key=lambda row: row[3]):
        found.setdefault(product, {})[verdict] = int(number)
    return found


def one(connection: Connection, condition: ColumnElement[bool]) -> Values | None:
    """The inspection of which this holds, or None."""
    found = connection.execute(_WHOLE.where(condition)).mappings().first()
    return None if found is None else _values(found)


def by_seals(connection: Connection, seals: Sequence[str]) -> Iterator[Values]:
    """The inspections that have one of these seals."""
    for start in range(0, len(seals), _AT_ONCE):
        some = [bytes.fromhex(seal) for seal in seals[start : start + _AT_ONCE]]
        yield from map(_values, connection.execute(_WHOLE.where(inspections.c.seal.in_(some))).mappings())


def _values(row: Mapping[Any, Any]) -> Values:
    # SQLAlchemy's rows are typed as having keys of their own; they are found by name all the same
    return cast("Values", row)


def count(connection: Connection, filters: Filters) -> int:
    """Number of inspections; the limit is ignored."""
    statement = select(func.count()).select_from(inspections).where(*conditions(connection, filters))
    return int(connection.scalar(statement) or 0)


def labels(connection: Connection, filters: Filters) -> tuple[str, ...]:
    """Labels of the numbers that some of the inspections have."""
    statement = select(layouts.c.labels).order_by(layouts.c.id)
    if found := _selected(connection, filters):  # without filters, every layout has a row
        statement = statement.where(layouts.c.id.in_(select(inspections.c.layout).where(*found)))
    lines = connection.scalars(statement)
    return tuple(dict.fromkeys(label for line in lines for label in parsed_labels(line)))


def series(connection: Connection, filters: Filters, number: str) -> tuple[list[int], list[int], list[float]]:
    """Ids, times in microseconds and values of one number, the oldest first."""
    table = inspections.c
    reads = _readers(connection, number)
    statement = chosen(connection, select(table.id, table.created_us, table.layout, table.numbers), filters)
    statement = statement.where(table.layout.in_(list(reads)))
    found = [
        (row_id, moment, reads[layout](data))
        for row_id, moment, layout, data in connection.execute(statement)
    ]
    found.reverse()
    return [one[0] for one in found], [one[1] for one in found], [one[2] for one in found]


def _readers(connection: Connection, number: str) -> dict[int, Callable[[bytes], float]]:
    """Reader of the number for each layout that has it."""
    found: dict[int, Callable[[bytes], float]] = {}
    for layout, line in connection.execute(select(layouts.c.id, layouts.c.labels)):
        if number in (names := parsed_labels(line)):
            found[layout] = partial(unpack_one, count=len(names), place=names.index(number))
    return found


def after(connection: Connection, row_id: int, most: int) -> list[Values]:
    """Inspections with a larger id, by id, with their labels."""
    statement = _WHOLE.where(inspections.c.id > row_id).order_by(inspections.c.id).limit(most)
    return list(map(_values, connection.execute(statement).mappings()))


def dispositions(connection: Connection, row_ids: Sequence[int]) -> Iterator[Values]:
    """Dispositions of some inspections, the oldest first."""
    table = _dispositions
    for start in range(0, len(row_ids), _AT_ONCE):
        some = list(row_ids[start : start + _AT_ONCE])
        statement = select(table).where(table.c.inspection.in_(some)).order_by(table.c.id)
        yield from map(_values, connection.execute(statement).mappings())


def head(connection: Connection, table: Table) -> tuple[int, bytes]:
    """Id and hash of the last row of a chain; 0 and zeros before the first."""
    last = select(table.c.id, table.c.hash).order_by(table.c.id.desc()).limit(1)
    found = connection.execute(last).first()
    return (0, START) if found is None else (int(found[0]), bytes(found[1]))


def holds(connection: Connection, table: Table, hash_: bytes) -> bool:
    """Whether a row of a chain has a hash."""
    return connection.execute(select(table.c.id).where(table.c.hash == hash_).limit(1)).first() is not None


def append_rows(connection: Connection, news: Sequence[NewRow], history: Path | None) -> list[Row]:
    """Append inspections; those whose seal is present already are skipped.

    Args:
        connection: in a transaction that writes.
        news: the inspections.
        history: file of the history, if it is one.

    Returns:
        For each inspection its row, be it new or earlier.
    """
    known = by_seals(connection, list(dict.fromkeys(new.seal for new in news)))
    rows = {row.seal: row for row in (row_from(values, history) for values in known)}
    last, previous = head(connection, schema.inspections)
    added: list[dict[str, Any]] = []
    shown: list[dict[str, int]] = []
    layouts: dict[str, int] = {}
    for new in news:
        if new.seal in rows:
            continue
        last += 1
        labels = labels_of(new)
        if labels not in layouts:
            layouts[labels] = layout_of(connection, labels)
        values = columns_of(new, history) | {"id": last, "previous": previous, "layout": layouts[labels]}
        previous = hash_of("inspection", INSPECTION_FIELDS, values | {"labels": labels})
        values["hash"] = previous
        rows[new.seal] = row_from(values | {"labels": labels}, history)
        added.append(values)
        shown += [{"pixels": picture_key(one), "inspection": last} for one in dict.fromkeys(new.pixels)]
    if added:
        statement = insert(schema.inspections)
        if (
            connection.dialect.name == "postgresql"
        ):  # many rows a statement; else each would be a journey of its own
            connection.execute(statement.returning(schema.inspections.c.id), added)
        else:
            connection.execute(statement, added)
    if shown:
        connection.execute(insert(schema.pictures), shown)
    return [rows[new.seal] for new in news]


def picture_key(pixels: str) -> int:
    """First eight bytes of a hash of pixels, as a number with sign."""
    return int.from_bytes(bytes.fromhex(pixels)[:8], "big", signed=True)


def used_by_others(connection: Connection, pixels: Sequence[str], serial: str) -> Values | None:
    """The first inspection of another serial number that shows one of these pictures, or None."""
    found = list(dict.fromkeys(map(picture_key, pixels)))
    for start in range(0, len(found), _AT_ONCE):
        first = (
            connection.execute(shown_by_others(found[start : start + _AT_ONCE], serial)).mappings().first()
        )
        if first is not None:
            return _values(first)
    return None


def shown_by_others(keys: Sequence[int], serial: str) -> Select[Any]:
    """Statement for the first inspection of another serial number with a picture of these keys (`picture_key`)."""
    shown = select(schema.pictures.c.inspection).where(schema.pictures.c.pixels.in_(keys))
    statement = _WHOLE.where(inspections.c.id.in_(shown), inspections.c.serial != serial)
    return statement.order_by(inspections.c.id).limit(1)


def differing_frames(connection: Connection, after: int) -> dict[str, int]:
    """Serial numbers whose inspections show pictures of which none is the same, one of them added after an id.

    Returns:
        How many such inspections each has; those whose record does not say its pictures are not among them.
    """
    several = select(inspections.c.serial).group_by(inspections.c.serial)
    several = several.having(func.count() > 1, func.max(inspections.c.id) > after)
    joined = inspections.join(schema.pictures, schema.pictures.c.inspection == inspections.c.id)
    wanted = select(inspections.c.serial, inspections.c.id, schema.pictures.c.pixels).select_from(joined)
    groups: dict[str, dict[int, set[int]]] = {}
    for serial, row_id, pixels in connection.execute(wanted.where(inspections.c.serial.in_(several))):
        groups.setdefault(serial, {}).setdefault(row_id, set()).add(pixels)
    found = {}
    for serial, shown in groups.items():
        seen, own = set[int](), 0
        for _, pictures in sorted(shown.items()):
            own += seen.isdisjoint(pictures)
            seen |= pictures
        if own > 1:
            found[serial] = own
    return found


def layout_of(connection: Connection, labels: str) -> int:
    """Number of a list of labels; a new list is stored."""
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
    """Append a reviewer's disposition of an existing inspection."""
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
