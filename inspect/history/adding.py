"""Inspections enter the history: as they are finished, or afterwards from their folders."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.history.rows import NewRow, row_of
from anisoscope.history.spool import deliver
from anisoscope.history.store import History
from anisoscope.record.schema import RECORD_NAME, read_record

_AT_ONCE = 200


@dataclass(frozen=True)
class Added:
    """Result of adding folders.

    Attributes:
        added: how many inspections are new in the history.
        known: how many were there already.
        refused: what is wrong with each of the others, in a line.
        repeated: inspections with frames of their own of each serial number that has several, and got one now.
    """

    added: int
    known: int
    refused: tuple[str, ...]
    repeated: Mapping[str, int] = field(default_factory=dict)


def finished_folders(places: Sequence[Path]) -> list[Path]:
    """All folders with a record, among those given and anywhere below them, oldest first.

    Raises:
        UsageError: one of the places is no folder.
    """
    found: set[Path] = set()
    for place in places:
        if not place.is_dir():
            raise UsageError(f"{place}: there is no such folder")
        found |= {record.parent.resolve() for record in place.rglob(RECORD_NAME)}
    return sorted(found, key=lambda folder: (folder.joinpath(RECORD_NAME).stat().st_mtime_ns, folder))


def add_folders(history: History, places: Sequence[Path], advance: Advance = silent) -> Added:
    """Add finished inspections to a history, and those that wait for it; those that it has already are passed over.

    A record that is damaged is refused and named, and does not keep the others out.

    Args:
        history: where they go.
        places: inspection folders, or folders anywhere above them.
        advance: progress.

    Raises:
        UsageError: one of the places is no folder.
        HistoryError: the history cannot be written.
    """
    folders = finished_folders(places)
    refused: list[str] = []
    before = history.count()
    rows = _rows(folders, refused, advance)
    ids: set[int] = set()
    read = 0
    for out in dict.fromkeys(home for place in places for home in (place.resolve(), place.resolve().parent)):
        waited = deliver(history, out)
        read += len(waited.rows)
        ids |= {row.id for row in waited.rows}
        refused += waited.damaged
    while some := list(islice(rows, _AT_ONCE)):
        read += len(some)
        ids |= {row.id for row in history.append_all(some)}
    added = sum(row_id > before for row_id in ids)
    return Added(added, read - added, tuple(refused), history.differing_frames(before) if added else {})


def _rows(folders: Sequence[Path], refused: list[str], advance: Advance) -> Iterator[NewRow]:
    for number, folder in enumerate(folders):
        advance("records", number, len(folders))
        try:
            yield row_of(read_record(folder), folder)
        except RecordError as error:
            refused.append(str(error))
