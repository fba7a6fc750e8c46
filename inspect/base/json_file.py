"""Content of JSON files, with limits of size and depth: a hostile or damaged file is one line, never a crash."""

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ValidationError

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import RecordError
from anisoscope.base.regular_file import bounded_bytes

Line = TypeVar("Line", bound=BaseModel)
MOST_LEVELS = 64
"""Lists and objects within each other; records have nine."""


def parsed_json(text: str | bytes) -> Any:  # noqa: ANN401 - JSON holds anything
    """The content of a JSON text.

    Raises:
        ValueError: it is no JSON, or nested more than 64 deep.
    """
    try:
        found = json.loads(text)
        if not is_deeper(found, MOST_LEVELS):
            return found
    except RecursionError:
        pass
    raise ValueError(f"lists or objects nested more than {MOST_LEVELS} deep")


def is_deeper(content: Any, levels: int) -> bool:  # noqa: ANN401
    """Whether lists and tables are nested more than so many levels deep."""
    level = [content] if isinstance(content, dict | list) else []
    for _ in range(levels):
        level = [
            item
            for value in level
            for item in (value.values() if isinstance(value, dict) else value)
            if isinstance(item, dict | list)
        ]
    return bool(level)


class JsonLines(Generic[Line]):
    """A file of JSON lines that are added one by one; a line counts once it is there as a whole.

    Args:
        path: the file.
        model: what a line says.
    """

    def __init__(self, path: Path, model: type[Line]) -> None:
        self.path, self._model = path, model

    def read(self) -> list[Line]:
        """All lines; a torn last one is cut off: its writer died meanwhile, so that nothing had followed from it.

        Raises:
            RecordError: the file cannot be read or written, or a line in the middle is damaged.
        """
        try:
            data = bounded_bytes(self.path) if self.path.exists() else b""
            whole, _, torn = data.rpartition(b"\n")
            if torn:
                with self.path.open("r+b") as stream:
                    stream.truncate(len(data) - len(torn))
        except OSError as error:
            raise RecordError(f"cannot read {self.path}: {error.strerror}") from error
        lines = []
        for number, text in enumerate(whole.splitlines(), start=1):
            try:
                lines.append(self._model.model_validate_json(text))
            except ValidationError as error:
                raise RecordError(
                    f"{self.path}, line {number} is damaged: {str(error).splitlines()[0]}"
                ) from error
        return lines

    def replace(self, lines: Iterable[Line]) -> None:
        """Put these lines in the place of all that are there, as a whole or not at all.

        Raises:
            RecordError: the file cannot be written.
        """
        write_text(self.path, "".join(map(_text, lines)))

    def add(self, line: Line, *, is_safe: bool = True) -> None:
        """Add a line; it is safe on disk when this returns.

        One that follows from what is safe elsewhere need not be: a process that is killed leaves it, a power failure
        may take it away.

        Raises:
            RecordError: it cannot be written.
        """
        try:
            with self.path.open("ab") as stream:
                stream.write(_text(line).encode())
                stream.flush()
                if is_safe:
                    os.fsync(stream.fileno())
        except OSError as error:
            raise RecordError(f"cannot write {self.path}: {error.strerror}") from error


def _text(line: BaseModel) -> str:
    return json.dumps(line.model_dump(mode="json", exclude_none=True)) + "\n"
