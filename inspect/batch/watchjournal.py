"""``watch.jsonl``: which folders were inspected, by their content; a line before and a line after each inspection."""

import json
import os
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from anisoscope.batch.arrivals import Arrival, Mark
from anisoscope.errors import RecordError

WATCH_NAME = "watch.jsonl"


class Line(BaseModel):
    """A line of the journal.

    Attributes:
        line: "begin" before an inspection; "done" after it; "same" for frames that were inspected already.
        folder: the folder of frames, absolute.
        key: its content; frames: that of its table and pictures alone.
        mark: of its table when it was looked at; None where it changed meanwhile.
        inspection: the inspection folder, relative to the journal.
        verdict: of the inspection.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    line: Literal["begin", "done", "same"]
    folder: str
    key: str
    frames: str | None = None
    mark: Mark | None = None
    inspection: str | None = None
    verdict: str | None = None


class WatchJournal:
    """The journal, read once and then only added to; every line is on disk before anything else happens.

    Raises:
        RecordError: it cannot be read or written, or a line in the middle is damaged.
    """

    def __init__(self, out: Path) -> None:
        self.path = out / WATCH_NAME
        self.marks: dict[str, Mark | None] = {}
        self.by_key: dict[str, Line] = {}
        self.inspections: set[str] = set()
        self.open: Line | None = None
        for line in self._read():
            self._take(line)

    def _read(self) -> list[Line]:
        try:
            data = self.path.read_bytes() if self.path.exists() else b""
        except OSError as error:
            raise RecordError(f"cannot read {self.path}: {error.strerror}") from error
        whole, _, torn = data.rpartition(b"\n")
        if torn:  # the program died while it wrote this line, so that nothing had followed from it
            self._cut(len(data) - len(torn))
        lines = []
        for number, text in enumerate(whole.splitlines(), start=1):
            try:
                lines.append(Line.model_validate_json(text))
            except ValidationError as error:
                raise RecordError(
                    f"{self.path}, line {number} is damaged: {str(error).splitlines()[0]}"
                ) from error
        return lines

    def _cut(self, size: int) -> None:
        try:
            with self.path.open("r+b") as stream:
                stream.truncate(size)
        except OSError as error:
            raise RecordError(f"cannot write {self.path}: {error.strerror}") from error

    def _take(self, line: Line) -> None:
        if line.line == "begin":
            self.open = line
            return
        self.open = None
        self.marks[line.folder] = line.mark
        self.by_key.setdefault(line.key, line)
        if line.line == "done" and line.inspection is not None:
            self.by_key[line.key] = line
            self.inspections.add(line.inspection)

    def add(self, line: Line) -> None:
        """Add a line; it is safe on disk when this returns.

        Raises:
            RecordError: it cannot be written.
        """
        text = json.dumps(line.model_dump(mode="json", exclude_none=True)) + "\n"
        try:
            with self.path.open("ab") as stream:
                stream.write(text.encode())
                stream.flush()
                os.fsync(stream.fileno())
        except OSError as error:
            raise RecordError(f"cannot write {self.path}: {error.strerror}") from error
        self._take(line)

    def knows(self, arrival: Arrival) -> bool:
        """Whether a folder was inspected, and its table has not changed since."""
        return self.marks.get(arrival.folder) == arrival.mark
