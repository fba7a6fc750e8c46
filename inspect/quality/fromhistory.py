"""Readings from the history of inspections."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from anisoscope.errors import UsageError
from anisoscope.history.filters import Filters
from anisoscope.history.rows import Row
from anisoscope.history.store import open_history
from anisoscope.quality.readings import GROUPS, Readings, without_invalid


def history_readings(place: str | Path, filters: Filters) -> Readings:
    """All numbers of some inspections, the oldest first.

    Args:
        place: as for `open_history`; nothing is made where there is none.
        filters: which inspections.

    Raises:
        UsageError: no inspection is left, or none has a number.
        HistoryError: the history cannot be read.
    """
    with open_history(place, create=False) as history:
        rows = history.rows(filters)
        where = f"history {history.address}"
    if not rows:
        raise UsageError(f"the {where} has no inspection of this kind")
    readings = readings_of(rows, where)
    if not readings.numbers:
        raise UsageError(f"no inspection of this kind in the {where} has a number")
    return readings


def readings_of(rows: Sequence[Row], source: str) -> Readings:
    """Rows as columns; numbers of INVALID inspections are missing, and so are those that a row does not have.

    Args:
        rows: in the order in which they were measured.
        source: where they come from, for messages.
    """
    texts = {
        "time": tuple(row.created_at.strftime("%Y-%m-%d %H:%M:%S") for row in rows),
        "serial": tuple(row.serial for row in rows),
        "verdict": tuple(row.verdict for row in rows),
    }
    texts |= {name: tuple(getattr(row, name) or "" for row in rows) for name in GROUPS}
    names = dict.fromkeys(name for row in rows for name in row.numbers)
    numbers = {name: np.array([row.numbers.get(name, np.nan) for row in rows]) for name in names}
    return Readings(source, texts, without_invalid(texts, numbers))
