"""Styles of CSV files: commas and decimal points, or semicolons and decimal commas as European spreadsheets take them.

The style of what is written is stated by an option or the project file, never by the language of the machine, so that a
program that reads our tables finds the same on every computer. What is read may have either style.
"""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Self

from anisoscope.base.errors import UsageError

COMMA, SEMICOLON = "comma", "semicolon"
STYLES = (COMMA, SEMICOLON)
BYTE_ORDER_MARK = "\ufeff"
"""Without it, spreadsheets do not read UTF-8."""

_present = COMMA


def use_style(name: str) -> None:
    """Set the style of what is written from now on.

    Args:
        name: one of `STYLES`.

    Raises:
        ValueError: another name.
    """
    global _present  # noqa: PLW0603 - one style a process, as one language
    if name not in STYLES:
        raise ValueError(f"no CSV style {name!r}: {', '.join(STYLES)}")
    _present = name


@contextmanager
def writing(name: str) -> Iterator[None]:
    """Set the style for the duration of one command.

    Args:
        name: as for `use_style`.

    Raises:
        ValueError: another name.
    """
    before = _present
    use_style(name)
    try:
        yield
    finally:
        use_style(before)


def number_text(number: str) -> str:
    """A number with the decimal mark of the present style.

    Args:
        number: with a decimal point.
    """
    return number.replace(".", ",") if _present == SEMICOLON else number


def csv_text(rows: Iterable[Sequence[object]], *, line_end: str = "\n", file: bool = True) -> str:
    """Rows as CSV in the present style; numbers come as `number_text` gives them.

    Args:
        rows: the header first.
        line_end: end of every line.
        file: whether the text is that of a file, which spreadsheets open.
    """
    stream = io.StringIO(newline="")
    separator = ";" if _present == SEMICOLON else ","
    csv.writer(stream, lineterminator=line_end, delimiter=separator).writerows(rows)
    mark = BYTE_ORDER_MARK if file and _present == SEMICOLON else ""
    return mark + stream.getvalue()


class CsvReader:
    """Lines of a CSV file whose columns are separated by commas or, by its first line, by semicolons.

    In a file with semicolons numbers have a decimal comma or a decimal point, all of them the same.

    Attributes:
        line_num: lines read.
    """

    def __init__(self, text: str, path: Path) -> None:
        lines = text.splitlines()
        self._semicolons = bool(lines) and lines[0].count(";") > lines[0].count(",")
        self._reader = csv.reader(lines, delimiter=";" if self._semicolons else ",")
        self._path = path
        self._mark = ""

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> list[str]:
        """Fields of the next line.

        Raises:
            UsageError: it is no line of CSV, or has a field of more than 128 KiB.
        """
        try:
            return next(self._reader)
        except csv.Error as error:
            raise UsageError(f"{self._path}, line {self.line_num}: {error}") from None

    @property
    def line_num(self) -> int:
        """Lines read."""
        return self._reader.line_num

    def with_point(self, text: str) -> str:
        """A field of a column of numbers, with a decimal point.

        Raises:
            UsageError: a decimal comma and a decimal point in one file.
        """
        found = {mark for mark in ".," if mark in text}
        if not self._semicolons or not found:
            return text
        self._mark = self._mark or min(found)
        if found != {self._mark}:
            raise UsageError(
                f"{self._path}: {text.strip()!r} mixes decimal commas and points, or has a mark for thousands; write "
                "all numbers of the file with the same decimal mark"
            )
        return text.replace(",", ".")
