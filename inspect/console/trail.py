"""The audit trail: who changed what, when and why, in a file that several processes add lines to."""

import json
import os
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any, BinaryIO

from anisoscope.base.errors import RecordError
from anisoscope.base.lock import locked
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes

A_PIECE = 4096


@dataclass
class Trail:
    """A line of JSON for every change, chained by hashes so that a line that was changed is found.

    A process that ends while it writes leaves a piece of a line, whose change has not been made. The line after it
    names the piece by its hash: what no line names was changed by somebody.

    Attributes:
        path: the file, which grows only; None keeps no trail.
        now: the time.
        identities: of people whom an OpenID provider knows, by their names: what their lines say of them.
    """

    path: Path | None
    now: Callable[[], datetime] = lambda: datetime.now(UTC)
    identities: dict[str, Mapping[str, str]] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def add(self, who: str, what: str, why: str = "", **more: object) -> None:
        """Add a line; it is on disk when this returns.

        Raises:
            RecordError: it cannot be written; what it was to record must not be done then.
        """
        if self.path is None:
            return
        entry: dict[str, Any] = {"at": self.now().isoformat(timespec="milliseconds"), "who": who}
        entry |= {"what": what, "why": why, "more": {**self.identities.get(who, {}), **more}}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self._lock, self.path.open("ab+") as file, locked(self.path, waits=True):
                previous, rest = _end_of(file)
                entry["previous"] = previous
                if piece := rest.strip(b"\n"):
                    entry["piece"] = sha256(piece).hexdigest()
                entry["hash"] = _digest(entry)
                start = b"" if rest.endswith(b"\n") else b"\n"
                file.write(start + json.dumps(entry, ensure_ascii=False).encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as problem:
            raise RecordError(f"{self.path}: cannot be written: {problem.strerror}") from problem

    def lines(self) -> list[dict[str, Any]]:
        """All whole lines, the oldest first.

        Raises:
            RecordError: the file cannot be read.
        """
        return [entry for entry in map(_entry, _lines(self._read())) if entry is not None]

    def damaged(self) -> list[int]:
        """Numbers of the lines, from 1, that are not as they were written or do not follow the one before."""
        found, previous, pieces = list[int](), "", list[tuple[int, bytes]]()
        content = self._read()
        for number, line in enumerate(_lines(content), 1):
            entry = _entry(line)
            if entry is None:
                pieces.append((number, line))
                continue
            piece = b"\n".join(line for _, line in pieces)
            if entry.get("piece", "") != (sha256(piece).hexdigest() if pieces else ""):
                found += [number for number, _ in pieces] or [number]
            if entry.get("previous") != previous or entry.get("hash") != _digest(entry):
                found.append(number)
            previous, pieces = str(entry.get("hash")), []
        if content.endswith(b"\n"):  # no process ended in the middle of these
            found += [number for number, _ in pieces]
        return sorted(set(found))

    def _read(self) -> bytes:
        if self.path is None or not self.path.exists():
            return b""
        try:
            return bounded_bytes(self.path, MOST_PICTURE_BYTES)
        except OSError as problem:
            raise RecordError(f"{self.path}: cannot be read: {problem.strerror}") from problem


def trail_of(users: Path) -> Trail:
    """The audit trail of a file of accounts, next to it."""
    return Trail(users.with_name(f"{users.stem}.audit.jsonl"))


def _end_of(file: BinaryIO) -> tuple[str, bytes]:
    """Hash of the last whole line, and what is behind it: its end, or the pieces of lines that followed."""
    end = start = file.seek(0, os.SEEK_END)
    found = b""
    while start:
        start = max(0, end - 2 * max(A_PIECE, end - start))
        file.seek(start)
        found = file.read(end - start)
        at = len(found)
        while at > 0:
            before = found.rfind(b"\n", 0, at) + 1
            entry = _entry(found[before:at]) if before or start == 0 else None
            if entry is not None:
                return str(entry.get("hash")), found[at:]
            at = before - 1
    return "", found if end else b"\n"


def _lines(content: bytes) -> list[bytes]:
    return content.removesuffix(b"\n").split(b"\n") if content else []


def _entry(line: bytes) -> dict[str, Any] | None:
    try:
        entry = json.loads(line)
    except ValueError:
        return None
    return entry if isinstance(entry, dict) else None


def _digest(entry: Mapping[str, object]) -> str:
    plain = {key: value for key, value in entry.items() if key != "hash"}
    return sha256(json.dumps(plain, sort_keys=True, ensure_ascii=False).encode()).hexdigest()
