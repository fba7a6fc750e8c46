"""Entry of a finished inspection into the history, and the history of its lot, without risk for a verdict."""

import math
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from anisoscope.base.errors import AnisoscopeError, RecordError
from anisoscope.base.signature import signer_in_use
from anisoscope.history.address import VARIABLE, chosen, parse_address
from anisoscope.history.filters import Filters
from anisoscope.history.rows import NewRow, row_of, storable

if TYPE_CHECKING:  # a server hands these functions to the process that inspects, and does without the rest
    from anisoscope.history.store import History
    from anisoscope.inspection.reports import Reports
    from anisoscope.inspection.run import Inspected, Methods, UsedBefore
    from anisoscope.report.peers import LotMate

RETRY_S = 60.0
MOST_MATES = 500
LOT_STEPS = (0, 2, 6)
"""Parts of a lot beyond the least number, at which those whose verdict is open are judged anew."""
_retry_at: dict[str, tuple[float, str]] = {}
"""By history: until when it is not tried again, and why; a server that is away would hold up every part."""


def history_place(option: str | None, out: Path) -> str | Path | None:
    """Where inspections in a folder are remembered; looked at before anything moves. None: nowhere.

    Raises:
        UsageError: there can be no history.
    """
    place = chosen(option, out)
    if place is not None:
        parse_address(place)
    return place


def remember(inspected: "Inspected", place: str | Path | None) -> None:
    """Enter a finished inspection into the history; on failure it waits in a file, and one line says so.

    Verdict and exit code are those of the part: what becomes of a database changes neither. What waits is delivered
    before the next inspection that can be entered.
    """
    if place is None:
        return
    out, key = inspected.folder.parent, str(place)
    new = None
    try:
        new = row_of(inspected.record, inspected.folder)
        if is_away(place):
            _put_aside(new, inspected.folder, place, _retry_at[key][1])
            return
        _enter(new, out, place)
        _retry_at.pop(key, None)
    except Exception as error:  # noqa: BLE001 - record and verdict stand, whatever goes wrong here
        problem = " ".join(str(error).split()) or type(error).__name__
        if not isinstance(error, RecordError):  # of this part alone: the history is not away
            _retry_at[key] = time.monotonic() + RETRY_S, problem
        _put_aside(new, inspected.folder, place, problem)


def lot_mates(place: str | Path | None, lot: str | None) -> "tuple[LotMate, ...]":
    """The latest inspections of a lot, the oldest first; empty without a lot or a readable history.

    Args:
        place: where the history is, or None.
        lot: the lot, or None.
    """
    if place is None or lot is None or is_away(place):
        return ()
    from anisoscope.history.store import open_history
    from anisoscope.report.peers import LotMate

    try:
        with open_history(place, create=False) as history:
            rows = history.rows(Filters(lot=lot, limit=MOST_MATES))
    except AnisoscopeError:  # the report goes without; entering the part will say what is wrong
        return ()
    return tuple(map(LotMate.of, rows))


def judge_lot(
    inspected: "Inspected",
    place: str | Path | None,
    *,
    methods: "Methods | None" = None,
    reports: "Reports | None" = None,
) -> "tuple[Inspected, ...]":
    """Judge the INCONCLUSIVE parts of a lot anew, when an inspection makes it one of 3, 5 or 9 parts (or 4, 6 or 10).

    A changed verdict is an inspection of its own, which enters the history.

    Args:
        inspected: the inspection, which has entered the history.
        place: where the history is, or None.
        methods: what varies, for tests.
        reports: where reports are written in the background.

    Returns:
        The changed inspections; none where the recipe does not compare parts with their lot.
    """
    record = inspected.record
    lot = record.particulars.lot
    rule = record.recipe.get("decision", {})
    if lot is None or not rule.get("compare_with_lot") or record.verdict == "INVALID":
        return ()
    mates = tuple(mate for mate in lot_mates(place, lot) if mate.product == storable(record.product))
    last = {mate.serial: mate for mate in mates if mate.verdict != "INVALID"}
    from anisoscope.inspection.replay import judge_anew
    from anisoscope.kinds.parts import References
    from anisoscope.kinds.registry import kind_named

    kind, found = kind_named(record.kind), []
    if not isinstance(kind, References) or len(last) - kind.reference_set.least_of_lot() not in LOT_STEPS:
        return ()
    if reports is not None:
        reports.wait()  # a report of an earlier part of the lot may be at work
    for mate in last.values():
        if mate.verdict != "INCONCLUSIVE" or mate.serial == storable(record.serial):
            continue
        try:
            anew = judge_anew(Path(mate.folder), mates, methods=methods, reports=reports)
        except Exception as error:  # noqa: BLE001 - the verdict of the part stands, whatever goes wrong with another one
            _say(
                f"{mate.serial} of lot {lot} is not judged anew: {' '.join(str(error).split()) or type(error).__name__}"
            )
            continue
        if anew is not None:
            remember(anew, place)
            found.append(anew)
    return tuple(found)


def used_before(place: str | Path | None) -> "UsedBefore":
    """Function that looks frames up in a history: the other part that they were judged as, in words, or None.

    Args:
        place: where the history is, or None.
    """

    def look(pixels: Sequence[str], serial: str) -> str | None:
        if place is None or is_away(place):
            return None
        from anisoscope.history.store import open_history

        try:
            with open_history(place, create=False) as history:
                row = history.used_by_others(pixels, serial)
        except AnisoscopeError:  # entering the part will say what is wrong
            return None
        return None if row is None else f"serial number {row.serial} on {row.created_at:%Y-%m-%d}"

    return look


def is_away(place: str | Path) -> bool:
    """Whether a history failed a moment ago, so that it is not tried again yet."""
    return time.monotonic() < _retry_at.get(str(place), (-math.inf, ""))[0]


def _enter(new: NewRow, out: Path, place: str | Path) -> None:
    from anisoscope.history.spool import deliver
    from anisoscope.history.store import open_history

    with open_history(place) as history:
        found = deliver(history, out, [new])
        _sign(history)
    if found.rows:
        _say(f"{len(found.rows)} inspections that waited are in the history now")
    for line in found.damaged:
        _say(line)


def _sign(history: "History") -> None:
    try:
        signer = signer_in_use()
        if signer is not None:
            from anisoscope.history.heads import sign_head

            sign_head(history, signer)
    except AnisoscopeError as error:
        _say(f"the head of the history is not signed: {error}")


def _put_aside(new: NewRow | None, folder: Path, place: str | Path, problem: str) -> None:
    later = f"`anisoscope history add {folder}{_where(place)}` adds it"
    if new is not None:
        from anisoscope.history.spool import wait

        try:
            waits = wait(new, parse_address(place), folder.parent)
            later = f"it waits in {waits} for the next one, or {later}"
        except Exception as error:  # noqa: BLE001 - as for `remember`
            later = f"it cannot wait either ({error}); {later}"
    _say(f"the inspection is not in the history yet: {problem}; {later}")


def _say(text: str) -> None:
    print(f"anisoscope: {text}", file=sys.stderr)  # noqa: T201


def unsigned(problem: str) -> None:
    """Say that the fleet page does not hear of this station; for `anisoscope.history.signs.Beacon`."""
    _say(f"the fleet page gets no sign of this station: {problem}; it is tried again")


def _where(place: str | Path) -> str:
    """The option that names a history, if commands would not find it by themselves; without a password."""
    return "" if os.environ.get(VARIABLE, "").strip() == place else f" --history {parse_address(place)}"
