"""Output of a command as a kind of part gives it: as JSON, and as tables and lines for people."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Table:
    """A table on the terminal."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str | None = None


@dataclass(frozen=True)
class CommandOutput:
    """An answer of a command: as JSON, and as tables and lines for people.

    Attributes:
        content: as JSON.
        tables: of the answer.
        lines: of the answer, below the tables.
        behind: tables that explain the answer, above it with --verbose alone.
    """

    content: dict[str, Any]
    tables: tuple[Table, ...] = ()
    lines: tuple[str, ...] = ()
    behind: tuple[Table, ...] = ()
