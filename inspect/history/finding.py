"""Which inspection is meant by a serial number, an id or a folder."""

from pathlib import Path

from anisoscope.base.errors import UsageError
from anisoscope.history.filters import Filters
from anisoscope.history.rows import Row, seal_of
from anisoscope.history.store import History
from anisoscope.record.schema import RECORD_NAME

_BY_ID, _BY_SERIAL = "id:", "serial:"
_MAX_DIGITS = 18


def find(history: History, name: str) -> Row:
    """The inspection that is meant; of a part that was inspected several times, the latest one.

    Args:
        history: where to look.
        name: serial number, id, or folder of a finished inspection. ``id:7`` and ``serial:7`` tell apart what else
            could be both.

    Raises:
        UsageError: there is none, or it is not clear which.
        RecordError: the record of the folder cannot be read.
        HistoryError: the history cannot be read.
    """
    if name.startswith(_BY_ID):
        return _there(_by_id(history, name.removeprefix(_BY_ID)), history, name)
    if name.startswith(_BY_SERIAL):
        return _there(_by_serial(history, name.removeprefix(_BY_SERIAL)), history, name)
    if "\0" not in name and (Path(name) / RECORD_NAME).is_file():
        row = history.row_by_seal(seal_of(Path(name)))
        if row is None:
            raise UsageError(
                f"{name} is not in the history {history.address}: `anisoscope history add {name}` adds it"
            )
        return row
    found = [row for row in (_by_id(history, name), _by_serial(history, name)) if row is not None]
    if len(found) == 2 and found[0] != found[1]:
        raise UsageError(
            f"{name} is both an id and a serial number: say {_BY_ID}{name} or {_BY_SERIAL}{name}"
        )
    return _there(found[0] if found else None, history, name)


def _by_id(history: History, text: str) -> Row | None:
    plain = text.isascii() and text.isdigit() and len(text) <= _MAX_DIGITS
    return history.row(int(text)) if plain else None


def _by_serial(history: History, serial: str) -> Row | None:
    rows = history.rows(Filters(serial=serial, limit=1))
    return rows[0] if rows else None


def _there(row: Row | None, history: History, name: str) -> Row:
    if row is None:
        raise UsageError(
            f"the history {history.address} has no inspection {name[:80]!r}: name a serial number, an id or a folder"
        )
    return row
