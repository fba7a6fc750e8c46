"""Comparison of two inspections: differences of their contrasts, and of recipe, rig and software."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.base.json_fields import in_json, json_field
from anisoscope.history.evidence import unlike
from anisoscope.history.export import with_dispositions
from anisoscope.history.rows import Row, row_of
from anisoscope.record.schema import Record, read_record, record_signature

_PREFIXES = ("u ", "deviation ", "tolerance ")
_ROW_FIELDS = ("product", "recipe", "lot", "cavity", "station", "operator", "software")
MAX_CHANGES = 40


@dataclass(frozen=True)
class Compared:
    """One number of two inspections.

    Attributes:
        label: of the number.
        first, second: its values; None where an inspection does not have it.
        difference: second - first.
        u: standard uncertainty of the difference, if both values have one. What both inspections share, as the
            prediction's part, is counted twice in it, so that it is rather too large.
    """

    label: str
    first: float | None
    second: float | None
    difference: float | None
    u: float | None

    @property
    @in_json()
    def ratio(self) -> float | None:
        """The difference in units of its uncertainty."""
        return None if self.difference is None or not self.u else self.difference / self.u


@dataclass(frozen=True)
class Change:
    """Difference between two inspections: its name, and the value in each (None: absent)."""

    what: str
    first: str | None
    second: str | None


@dataclass(frozen=True)
class Comparison:
    """Two inspections compared; ``notes`` name unreadable records, and what is therefore not compared.

    The row of an inspection that was not taken from a history has the number 0.
    """

    first: Row = field(metadata=json_field(by=with_dispositions))
    second: Row = field(metadata=json_field(by=with_dispositions))
    contrasts: tuple[Compared, ...]
    numbers: tuple[Compared, ...]
    changes: tuple[Change, ...]
    notes: tuple[str, ...]


class Finished(Protocol):
    """A finished inspection, as ``inspect`` and ``resume`` return it."""

    @property
    def record(self) -> Record:
        """Its record."""
        ...


def compare(
    first_of: Row | Record | Finished | Path | str, second_of: Row | Record | Finished | Path | str
) -> Comparison:
    """Compare two inspections: by their numbers, and as far as they can be read also by their records.

    Args:
        first_of: a row of a history, a record, an inspection that was just finished, or an inspection folder.
        second_of: the other one, of the same or another of these.

    Raises:
        UsageError: something else.
        RecordError: the record of a folder cannot be read.
    """
    first, second = _row(first_of), _row(second_of)
    compared = [_compared(label, first, second) for label in _labels(first, second)]
    contrasts = tuple(one for one in compared if one.u is not None or _has_u(one.label, first, second))
    changes = list(_row_changes(first, second))
    records, notes = [], []
    for given, row in ((first_of, first), (second_of, second)):
        try:
            records.append(record_of(row) if isinstance(given, Row) else _record(given))
        except RecordError as error:
            notes.append(f"recipe, rig and calibrations in detail are not compared: {error}")
    if len(records) == 2:
        changes += _record_changes(records[0], records[1])
    return Comparison(
        first,
        second,
        contrasts,
        tuple(one for one in compared if one not in contrasts),
        tuple(changes[:MAX_CHANGES]),
        (*notes, *_too_many(len(changes))),
    )


def _record(given: Record | Finished | Path | str) -> Record:
    if isinstance(given, Path | str):
        return read_record(Path(given))
    found = given if isinstance(given, Record) else getattr(given, "record", None)
    if not isinstance(found, Record):
        raise UsageError(
            "compare takes two inspections, each a row of a history, a record, what inspect returned, or an inspection "
            f"folder, not {type(given).__name__}"
        )
    return found


def _row(given: Row | Record | Finished | Path | str) -> Row:
    if isinstance(given, Row):
        return given
    folder = given if isinstance(given, Path | str) else getattr(given, "folder", None)
    return Row(id=0, **vars(row_of(_record(given), None if folder is None else Path(folder))))


def _too_many(count: int) -> Iterator[str]:
    if count > MAX_CHANGES:
        yield f"{count - MAX_CHANGES} more things differ"


def _labels(first: Row, second: Row) -> list[str]:
    together = dict.fromkeys((*first.numbers, *second.numbers))
    return [label for label in together if not label.startswith(_PREFIXES)]


def _has_u(label: str, *rows: Row) -> bool:
    return any(f"u {label}" in row.numbers for row in rows)


def _compared(label: str, first: Row, second: Row) -> Compared:
    a, b = first.numbers.get(label), second.numbers.get(label)
    u_a, u_b = first.numbers.get(f"u {label}"), second.numbers.get(f"u {label}")
    difference = None if a is None or b is None else b - a
    return Compared(label, a, b, difference, None if u_a is None or u_b is None else math.hypot(u_a, u_b))


def _row_changes(first: Row, second: Row) -> Iterator[Change]:
    for name in _ROW_FIELDS:
        a, b = getattr(first, name), getattr(second, name)
        if a != b:
            yield Change(name, a, b)


def record_of(row: Row) -> Record:
    """The record in a row's folder.

    Raises:
        RecordError: it is gone, damaged, another one than the history knows, signed as another one, or says something
            else than the row.
    """
    folder = Path(row.folder)
    record = read_record(folder)
    record_signature(folder)
    problem = unlike(row, record)
    if problem is not None:
        raise RecordError(problem)
    return record


def _record_changes(first: Record, second: Record) -> Iterator[Change]:
    for title in ("recipe", "rig", "white_reference", "convention"):
        a, b = _flat(getattr(first, title)), _flat(getattr(second, title))
        for key in dict.fromkeys((*a, *b)):
            if a.get(key) != b.get(key):
                yield Change(f"{title.replace('_', ' ')}: {key}", a.get(key), b.get(key))
    for title in ("camera", "stage", "model"):
        if getattr(first, title) != getattr(second, title):
            yield Change(title, getattr(first, title), getattr(second, title))
    yield from _input_changes(first, second)


def _input_changes(first: Record, second: Record) -> Iterator[Change]:
    """Files that both started from: calibrations, height map, golden parts; their hashes, shortened."""
    a, b = ({file.name: file.sha256[:12] for file in record.inputs} for record in (first, second))
    for name in dict.fromkeys((*a, *b)):
        if a.get(name) != b.get(name):
            yield Change(f"file {name}", a.get(name), b.get(name))


def _flat(value: object, key: str = "") -> dict[str, str]:
    """A nested table as keys with dots and texts."""
    if isinstance(value, Mapping):
        parts: list[tuple[str, Any]] = [
            (f"{key}.{name}".removeprefix("."), one) for name, one in value.items()
        ]
    elif isinstance(value, list | tuple):
        parts = [(f"{key}[{number}]", one) for number, one in enumerate(value)]
    else:
        return {key: str(value)}
    return {name: text for part, one in parts for name, text in _flat(one, part).items()}
