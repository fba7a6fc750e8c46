"""Errors and damage of a history."""

from dataclasses import dataclass

from anisoscope.base.errors import AnisoscopeError


class HistoryError(AnisoscopeError):
    """A history that cannot be reached, read or written."""

    exit_code = 74


@dataclass(frozen=True)
class Damage:
    """Something in a history that is not as it was written.

    Attributes:
        table: "inspection", "disposition", or "" for the database as a whole.
        id: which row, or None.
        text: what is wrong with it.
    """

    table: str
    id: int | None
    text: str

    def __str__(self) -> str:
        where = " ".join(part for part in (self.table, "" if self.id is None else str(self.id)) if part)
        return f"{where}: {self.text}" if where else self.text
