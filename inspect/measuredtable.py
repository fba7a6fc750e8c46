"""Measured contrasts of the ridge experiment, read from a CSV file."""

import csv
from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.errors import UsageError
from anisoscope.experiment import COLUMNS, SHAPE, combinations

FloatArray = npt.NDArray[np.float64]


def read_measured(path: Path) -> FloatArray:
    """Measured contrasts from a CSV file with the columns ``COLUMNS``; rows may be missing, none twice.

    Returns:
        Contrasts in the unit of the file, NaN where not measured.

    Raises:
        UsageError: the file cannot be read, or a line of it cannot be used.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise UsageError(f"cannot read {path}: {reason}") from error
    reader = csv.reader(text.splitlines())
    where = {row: index for index, row in combinations()}
    measured = np.full(SHAPE, np.nan)
    try:
        _check_header([name.strip() for name in next(reader, [])], path)
        for fields in reader:
            if not any(field.strip() for field in fields):
                continue
            place = f"{path}, line {reader.line_num}"
            *row, contrast = _numbers(fields, place)
            index = where.get((row[0], row[1], row[2], row[3]))
            if index is None:
                raise UsageError(
                    f"{place}: the experiment has no ridge angle {row[0]:g}°, tilt {row[1]:g}°, "
                    f"pair {row[2]:g}°/{row[3]:g}°"
                )
            if not np.isnan(measured[index]):
                raise UsageError(f"{place}: this combination is given twice")
            measured[index] = contrast
    except csv.Error as error:
        raise UsageError(f"{path}, line {reader.line_num}: {error}") from error
    if np.isnan(measured).all():
        raise UsageError(f"{path}, line {max(reader.line_num, 1)}: no contrasts follow the header")
    return measured


def _check_header(names: list[str], path: Path) -> None:
    if tuple(names) != COLUMNS:
        raise UsageError(f"{path}, line 1: the header must read {','.join(COLUMNS)}, not {','.join(names)!r}")


def _numbers(fields: list[str], place: str) -> list[float]:
    if len(fields) != len(COLUMNS):
        raise UsageError(f"{place}: {len(COLUMNS)} values expected, {len(fields)} found")
    numbers = []
    for name, text in zip(COLUMNS, fields, strict=True):
        try:
            number = float(text)
        except ValueError:
            raise UsageError(f"{place}: {name} is not a number: {text!r}") from None
        if not np.isfinite(number) or (name == "contrast" and number < 0.0):
            kind = "a finite number, 0 or more," if name == "contrast" else "a finite number"
            raise UsageError(f"{place}: {name} must be {kind} not {text!r}")
        numbers.append(number)
    return numbers
