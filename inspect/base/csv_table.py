"""Tables of numbers in CSV files; every error names file and line."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.csv_style import CsvReader
from anisoscope.base.errors import UsageError
from anisoscope.base.regular_file import bounded_bytes

Columns = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Table:
    """Numbers of a CSV file.

    Attributes:
        columns: names of the header.
        rows: (N, columns) numbers.
        lines: N line numbers in the file.
        path: the file.
    """

    columns: Columns
    rows: FloatArray
    lines: tuple[int, ...]
    path: Path

    def column(self, name: str) -> FloatArray:
        """(N,) numbers of one column."""
        return np.asarray(self.rows[:, self.columns.index(name)])

    def place(self, row: int) -> str:
        """File and line of a row, for messages."""
        return f"{self.path}, line {self.lines[row]}"


def read_table(
    path: Path,
    headers: tuple[Columns, ...],
    optional: Columns = (),
    *,
    above_zero: Columns = (),
    not_negative: Columns = (),
    what: str = "values",
) -> Table:
    """Read a CSV file of numbers; blank lines are passed over.

    Args:
        path: the file, UTF-8; commas and decimal points, or semicolons and decimal commas.
        headers: the accepted forms of the header.
        optional: columns that may follow, in any order.
        above_zero: columns whose numbers must lie above 0.
        not_negative: columns whose numbers must be 0 or more.
        what: what the rows are, for the message of an empty table.

    Raises:
        UsageError: the file cannot be read, or a line of it cannot be used; the line is named.
    """
    reader = CsvReader(read_text(path), path)
    rows, lines = [], []
    columns = tuple(name.strip() for name in next(reader, []))
    _check_header(columns, headers, optional, path)
    for fields in reader:
        if any(field.strip() for field in fields):
            fields = [reader.with_point(field) for field in fields]  # noqa: PLW2901
            numbers = _numbers(fields, columns, f"{path}, line {reader.line_num}")
            _check_signs(
                numbers, fields, columns, (above_zero, not_negative), f"{path}, line {reader.line_num}"
            )
            rows.append(numbers)
            lines.append(reader.line_num)
    if not rows:
        raise UsageError(f"{path}, line {max(reader.line_num, 1)}: no {what} follow the header")
    return Table(columns, np.array(rows), tuple(lines), path)


def read_text(path: Path) -> str:
    """Text of a UTF-8 file.

    Raises:
        UsageError: it cannot be read, or is not UTF-8.
    """
    try:
        return bounded_bytes(path).decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise UsageError(f"cannot read {path}: {reason}") from error


def _check_header(columns: Columns, headers: tuple[Columns, ...], optional: Columns, path: Path) -> None:
    for header in headers:
        rest = columns[len(header) :]
        if columns[: len(header)] == header and set(rest) <= set(optional) and len(set(rest)) == len(rest):
            return
    tail = "".join(f"[,{name}]" for name in optional)
    forms = " or ".join(",".join(header) + tail for header in headers)
    raise UsageError(f"{path}, line 1: the header must read {forms}, not {','.join(columns)!r}")


def _numbers(fields: list[str], columns: Columns, place: str) -> list[float]:
    if len(fields) != len(columns):
        raise UsageError(f"{place}: {len(columns)} values expected, {len(fields)} found")
    numbers = []
    for name, text in zip(columns, fields, strict=True):
        try:
            numbers.append(float(text))
        except ValueError:
            raise UsageError(f"{place}: {name} is not a number: {text!r}") from None
    return numbers


def _check_signs(
    numbers: list[float], fields: list[str], columns: Columns, signs: tuple[Columns, Columns], place: str
) -> None:
    above_zero, not_negative = signs
    for name, number, text in zip(columns, numbers, fields, strict=True):
        low = (name in above_zero and number <= 0.0) or (name in not_negative and number < 0.0)
        if low or not abs(number) < float("inf"):
            more = " above 0," if name in above_zero else ", 0 or more," if name in not_negative else ","
            raise UsageError(f"{place}: {name} must be a finite number{more} not {text!r}")
