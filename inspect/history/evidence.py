"""Rows compared with the signed records that they are of, wherever those are within reach; and gaps between records.

A signed head covers rows as they are. So before a station signs one, and when a history is verified, each new row is
compared with its record, and each record has to follow one that the history holds.
"""

import contextlib
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from sqlalchemy import select

from anisoscope.base.errors import RecordError
from anisoscope.base.json_fields import LEFT_OUT
from anisoscope.base.last_signed import last_records
from anisoscope.base.signature import Signed, Signer, Trust, clock_set_back
from anisoscope.history.rows import PRECISION, Row, row_of, storable
from anisoscope.history.schema import inspections
from anisoscope.history.store import History
from anisoscope.record.schema import RECORD_NAME, Record, read_record, record_signature

_AT_ONCE = 500
_GAP = (
    "it is record {} of its station, and the history does not hold record {}: that was removed, or `anisoscope history "
    "add` adds it"
)
_SAME = (
    "created_at",
    "serial",
    "product",
    "recipe",
    "lot",
    "cavity",
    "station",
    "operator",
    "verdict",
    "software",
)


@dataclass(frozen=True)
class RowsCompared:
    """Outcome of comparing rows with their records.

    Attributes:
        compared: rows whose record is within reach.
        beyond: rows whose folder is not there, in the archive perhaps.
        not_linked: signed records, of earlier versions, that do not say which record was before them.
        problems: what is wrong, a line each.
        remarks: records signed by a clock that was set back.
    """

    compared: int
    beyond: int
    not_linked: int
    problems: tuple[str, ...] = field(default=(), metadata=LEFT_OUT)
    remarks: tuple[str, ...] = field(default=(), metadata=LEFT_OUT)


def differences(row: Row, record: Record) -> tuple[str, ...]:
    """What a row says otherwise than its record: seal, texts, and the numbers that both have.

    Raises:
        RecordError: the record cannot be read.
    """
    own = row_of(record, Path(row.folder))
    if own.seal != row.seal:
        return ("seal",)
    found = [name for name in _SAME if getattr(own, name) != getattr(row, name)]
    known = set(map(storable, record.reasons))
    whole = [one for one in row.reasons if not (one.startswith("… ") or one.endswith("…"))]
    if (record.reasons and not row.reasons) or not known.issuperset(whole):
        found.append("reasons")
    found += [
        label
        for label in own.numbers.keys() & row.numbers.keys()
        if not math.isclose(own.numbers[label], row.numbers[label], rel_tol=4.0 * PRECISION, abs_tol=0.0)
        and not (math.isnan(own.numbers[label]) and math.isnan(row.numbers[label]))
    ]
    return tuple(sorted(found))


def unlike(row: Row, record: Record) -> str | None:
    """How a row differs from its record, in words, or None where they agree."""
    found = differences(row, record)
    if found == ("seal",):
        return f"{row.folder} holds another record than the history knows"
    shown = ", ".join(found[:3]) + (" …" if len(found) > 3 else "")
    return f"its row says another {shown} than its record: one of them was rewritten" if found else None


def compare_rows(
    history: History,
    trust: Trust | None = None,
    *,
    after: int = 0,
    signed_since: Mapping[str, int] | None = None,
    elsewhere: Mapping[str, str] | None = None,
) -> RowsCompared:
    """Compare rows with the records in their folders, and records with those that they follow.

    Args:
        history: open.
        trust: keys that count.
        after: id of the last row that need not be compared.
        signed_since: by station, the row from which on its records have to be signed.
        elsewhere: verdicts in the archive by the first 12 digits of the seal, for rows whose folder is not there.

    Raises:
        HistoryError: the history cannot be read.
    """
    since, compared, beyond, not_linked, problems = signed_since or {}, 0, 0, 0, list[str]()
    remarks: list[str] = []
    linked: set[str] = set()
    while rows := history.after(after, _AT_ONCE):
        after = rows[-1].id
        for row in rows:
            where = f"inspection {row.id} ({row.serial})"
            if not (Path(row.folder) / RECORD_NAME).is_file():
                archived = None if elsewhere is None else elsewhere.get(row.seal[:12])
                beyond += archived is None
                compared += archived is not None
                if archived not in (None, row.verdict):
                    problems.append(f"{where}: its row says {row.verdict}, the archive {archived}")
                continue
            compared += 1
            try:
                found = record_signature(Path(row.folder))
                problem = unlike(row, read_record(Path(row.folder)))
            except RecordError as error:
                problems.append(f"{where}: {error}")
                continue
            problems += [] if problem is None else [f"{where}: {problem}"]
            if found is None:
                begun = since.get(row.station or "")
                if begun is not None and row.id > begun:
                    problems.append(f"{where}: its record is not signed, and others of its station are")
                continue
            distrust = None if trust is None else trust.distrust(found)
            problems += [] if distrust is None else [f"{where}: {distrust}"]
            there, before = _before(history, found)
            back = None if before is None else clock_set_back(before, found)
            remarks += [] if back is None else [f"{where}: {back}"]
            gap = None if there else _GAP.format(found.content["number"], found.content["number"] - 1)
            if found.content.get("number") is not None:
                linked.add(found.key)
            elif found.key in linked:
                gap = "its record does not say which one was before it, and earlier ones do"
            else:
                not_linked += 1
            problems += [] if gap is None else [f"{where}: {gap}"]
    return RowsCompared(compared, beyond, not_linked, tuple(problems), tuple(remarks))


def _before(history: History, found: Signed) -> tuple[bool, Signed | None]:
    """Whether the history holds the record that one says was before it, and the signature of that one within reach."""
    number, previous = found.content.get("number"), found.content.get("previous")
    if not isinstance(number, int) or number == 1:
        return True, None
    try:
        row = history.row_by_seal(str(previous))
    except ValueError:
        row = None
    with contextlib.suppress(RecordError):  # what is wrong with it, its own row says
        return row is not None, None if row is None else record_signature(Path(row.folder))
    return True, None


def last_missing(history: History, signer: Signer) -> Iterator[str]:
    """Folders of inspections whose last record, by the note next to the key, the history does not hold.

    Only those are looked at that hold the history, or an inspection of it.

    Raises:
        HistoryError, ConfigError: the history, or the note, cannot be read.
    """
    place = history.address.path
    for series, (number, seal) in last_records(signer).items():
        if place is None:
            with history.reading() as connection:
                below = inspections.c.folder.startswith(series + os.sep, autoescape=True)
                known = connection.scalar(select(inspections.c.id).where(below).limit(1)) is not None
        else:
            known = series == str(place.parent.resolve())
        if known and history.row_by_seal(seal) is None:
            yield (
                f"the last record that this station signed in {series}, number {number}, is not in the history: the "
                "end was cut, or `anisoscope history add` adds it"
            )
