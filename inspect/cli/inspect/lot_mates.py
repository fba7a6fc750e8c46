"""What the history knows of a lot, for the report of its next part."""

from pathlib import Path
from typing import TYPE_CHECKING

from anisoscope.base.errors import AnisoscopeError
from anisoscope.cli.inspect.history_entry import is_away

if TYPE_CHECKING:
    from anisoscope.report.peers import LotMate

MOST = 500


def lot_mates(place: str | Path | None, lot: str | None) -> "tuple[LotMate, ...]":
    """The latest inspections of a lot, the oldest first; empty without a lot or a readable history.

    Args:
        place: where the history is, or None.
        lot: the lot, or None.
    """
    if place is None or lot is None or is_away(place):
        return ()
    from anisoscope.history.filters import Filters
    from anisoscope.history.store import open_history
    from anisoscope.report.peers import LotMate

    try:
        with open_history(place, create=False) as history:
            rows = history.rows(Filters(lot=lot, limit=MOST))
    except AnisoscopeError:  # the report goes without; entering the part will say what is wrong
        return ()
    return tuple(LotMate(row.serial, row.product, row.verdict, row.numbers) for row in rows)
