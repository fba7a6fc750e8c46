"""Last record and last head that a station signed, noted in the folder of its key, away from history and inspections.

``rig.pem.last.json`` holds, for each folder of inspections, number and seal of the last record, and, for each history,
number and hash of the last signed head. A key that is no file, or lies where nothing can be written, has no such note:
its records say no number.
"""

import contextlib
import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import ConfigError, RecordError
from anisoscope.base.json_file import parsed_json
from anisoscope.base.lock import locked
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.base.signature import KeyFile, Signer

RECORDS, HEADS = "records", "heads"
Notes = dict[str, dict[str, Any]]


def note_of(signer: Signer) -> Path | None:
    """The file of the notes next to a key, or None where the key is no file."""
    return signer.path.with_name(f"{signer.path.name}.last.json") if isinstance(signer, KeyFile) else None


def noted(signer: Signer) -> Notes:
    """The notes next to a key; empty ones where there are none.

    Raises:
        ConfigError: they are damaged.
    """
    path = note_of(signer)
    empty: Notes = {RECORDS: {}, HEADS: {}}
    if path is None or not path.exists():
        return empty
    try:
        found = parsed_json(bounded_bytes(path))
        return {name: dict(found[name]) for name in empty}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"{path}: what this key signed last cannot be read: {type(error).__name__}"
        ) from None


def note_head(signer: Signer, history: str, number: int, envelope: str) -> None:
    """Note the last signed head of a history.

    Args:
        signer: the key that signed it.
        history: address of the history.
        number: of the head.
        envelope: the signed head.
    """
    path = note_of(signer)
    if path is None:
        return
    with contextlib.suppress(OSError, RecordError), locked(path.parent, waits=True):
        notes = noted(signer)
        notes[HEADS][history] = {"number": number, "sha256": hashlib.sha256(envelope.encode()).hexdigest()}
        _write(path, notes)


@contextlib.contextmanager
def next_record(signer: Signer, folder: Path, seal: str) -> Iterator[dict[str, Any]]:
    """What links a record to the one that the key signed before it in the same folder of inspections.

    The record counts once the context is left without an error, or, after a program was killed, once it is there.

    Args:
        signer: the key.
        folder: of the inspection; the folder that holds it has a count of its own.
        seal: of the record.

    Yields:
        ``number``, from 1, and ``previous``, the seal of the record before ("" for the first); nothing where the key
        has no note, or a damaged one.
    """
    path, series = note_of(signer), str(folder.resolve().parent)
    with contextlib.ExitStack() as stack:
        try:
            if path is not None:
                stack.enter_context(locked(path.parent, waits=True))
        except OSError:
            path = None
        if path is None:
            yield {}
            return
        try:
            notes = noted(signer)
        except ConfigError:  # the verdict does not wait for it; that the link is missing shows
            yield {}
            return
        last = _counted(notes[RECORDS].get(series, {}))
        number, previous = int(last.get("number", 0)), str(last.get("seal", ""))
        begun = {"number": number + 1, "seal": seal, "folder": str(folder.resolve())}
        notes[RECORDS][series] = last | {"begun": begun}
        try:
            _write(path, notes)
        except RecordError:
            yield {}
            return
        yield {"number": number + 1, "previous": previous}
        notes[RECORDS][series] = {"number": number + 1, "seal": seal}
        _write(path, notes)


def last_records(signer: Signer) -> dict[str, tuple[int, str]]:
    """Number and seal of the last record in each folder of inspections.

    Raises:
        ConfigError: the note is damaged.
    """
    counted = {series: _counted(last) for series, last in noted(signer)[RECORDS].items()}
    return {series: (last["number"], last["seal"]) for series, last in counted.items() if "number" in last}


def _counted(last: dict[str, Any]) -> dict[str, Any]:
    """Number and seal of the last record; one that was begun counts if it is there."""
    begun = last.get("begun")
    if begun is not None:
        with contextlib.suppress(OSError):
            if str(begun["seal"]).encode() in bounded_bytes(Path(begun["folder"]) / "record.json"):
                return {name: begun[name] for name in ("number", "seal")}
    return {name: last[name] for name in ("number", "seal") if name in last}


def _write(path: Path, notes: Notes) -> None:
    write_text(path, json.dumps(notes, indent=1))
    path.chmod(0o600)
