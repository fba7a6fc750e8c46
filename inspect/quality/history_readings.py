"""Readings from the history of inspections."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import UsageError
from anisoscope.history.column_wise import Columns
from anisoscope.history.filters import Filters
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
        found = history.columns(filters)
        where = f"history {history.address}"
    if not len(found.times):
        raise UsageError(f"the {where} has no inspection of this kind")
    readings = readings_of(found, where)
    if not readings.numbers:
        raise UsageError(f"no inspection of this kind in the {where} has a number")
    return readings


def readings_of(found: Columns, source: str) -> Readings:
    """Numbers of INVALID inspections are missing, and so are those that an inspection does not have.

    Args:
        found: in the order in which they were measured.
        source: where they come from, for messages.
    """
    texts = {"time": _written(found.times)}
    texts |= {name: found.texts[name] for name in ("serial", "verdict", *GROUPS)}
    return Readings(source, texts, without_invalid(texts, found.numbers))


def _written(times: npt.NDArray[np.datetime64]) -> tuple[str, ...]:
    """Times to the second, day and time with a blank between them."""
    written = np.datetime_as_string(times.astype("datetime64[s]"))
    if written.size:
        signs = written.view(("U1", written.dtype.itemsize // 4))
        signs[:, np.argmax(signs[0] == "T")] = " "
    return tuple(written.tolist())
