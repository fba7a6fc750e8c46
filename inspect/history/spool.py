"""Inspections that wait for a history that is out of reach: a file each, delivered later, in order and once.

The folder ``history-waiting`` is among the inspections. A file appears whole or not at all, and goes after its row is
safe in the history; the seal of the record keeps a row from entering twice, whatever is killed in between.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import TypeAdapter, ValidationError

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import RecordError
from anisoscope.base.json_file import parsed_json
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.history.address import Address
from anisoscope.history.rows import NewRow, Row

if TYPE_CHECKING:
    from anisoscope.history.store import History

WAITING = "history-waiting"
_AT_ONCE = 200
_ROW = TypeAdapter(NewRow)


@dataclass(frozen=True)
class Delivered:
    """Outcome of a delivery: the rows that waited, and what is wrong with files that cannot be delivered."""

    rows: tuple[Row, ...]
    damaged: tuple[str, ...]


def wait(new: NewRow, address: Address, out: Path) -> Path:
    """Write an inspection down that cannot enter its history now.

    Args:
        new: the inspection.
        address: the history.
        out: the folder of inspections.

    Returns:
        The folder in which it waits.

    Raises:
        RecordError: the folder cannot be written.
    """
    folder = out / WAITING
    content = {"history": str(address), "row": asdict(new) | {"created_at": new.created_at.isoformat()}}
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise RecordError(f"cannot make {folder}: {error.strerror}") from error
    write_text(folder / f"{new.created_at:%Y%m%dT%H%M%S.%f}-{new.seal[:16]}.json", json.dumps(content) + "\n")
    return folder


def deliver(history: "History", out: Path, news: Sequence[NewRow] = ()) -> Delivered:
    """Enter what waits for a history, the oldest first, and then new inspections.

    Args:
        history: the history; what waits for another one stays.
        out: the folder of inspections.
        news: inspections that follow.

    Raises:
        HistoryError: the history cannot be written; what is not in it goes on waiting.
    """
    damaged: list[str] = []
    waiting = _waiting(history.address, out, damaged)
    found: list[Row] = []
    while some := list(islice(waiting, _AT_ONCE)):
        found += history.append_all([new for _, new in some])
        for path, _ in some:
            path.unlink(missing_ok=True)
    if news:
        history.append_all(news)
    return Delivered(tuple(found), tuple(damaged))


def _waiting(address: Address, out: Path, damaged: list[str]) -> Iterator[tuple[Path, NewRow]]:
    for path in sorted((out / WAITING).glob("[0-9]*.json")):
        try:
            content = parsed_json(bounded_bytes(path))
            if content["history"] == str(address):
                yield (
                    path,
                    _ROW.validate_python(
                        content["row"]
                        | {name: tuple(content["row"].get(name, ())) for name in ("reasons", "pixels")}
                    ),
                )
        except FileNotFoundError:  # delivered meanwhile by another program
            continue
        except (OSError, ValueError, KeyError, TypeError) as error:
            reason = str(error.errors()[0]["msg"]) if isinstance(error, ValidationError) else str(error)
            damaged.append(f"{path} cannot be delivered to the history: {reason.splitlines()[0]}")
