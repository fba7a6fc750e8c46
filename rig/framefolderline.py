"""The lines of ``frames.csv``: texts into numbers and paths, with an error that names the line."""

import csv
import difflib
import io
import math
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

from anisoscope.base.errors import RecordError
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.rig.bayer import FILTERS

COLUMNS = ("file", "kind", "stage_deg", "tilt_deg", "exposure_s", "gain", "bit_depth", "black_level")
OPTIONAL = ("again", "filters")
_AGAIN = {"": False, "0": False, "1": True}


@dataclass(frozen=True)
class Line:
    """The values of a line; `number` counts from 1 at the header; `filters` is None where the table has none."""

    number: int
    file: str
    kind: str
    stage_deg: float
    tilt_deg: float
    exposure_s: float
    gain: float
    bit_depth: int
    black_level: float
    again: bool
    filters: str | None


def read_header(fields: list[str], table: Path) -> tuple[str, ...]:
    """Names of the columns, checked.

    Raises:
        RecordError: a column is missing or stands twice.
    """
    columns = tuple(name.strip().lower() for name in fields)
    if len(columns) == 1 and set(csv.reader([columns[0]], delimiter=";").__next__()) >= {"file", "kind"}:
        raise RecordError(f"{table}, line 1: columns are separated by commas here, not by semicolons")
    for name in COLUMNS:
        if name not in columns:
            close = difflib.get_close_matches(name, set(columns) - set(COLUMNS), n=1)
            hint = f"; is '{close[0]}' meant?" if close else f"; the header needs {','.join(COLUMNS)}"
            raise RecordError(f"{table}, line 1: the column {name} is missing{hint}")
    for name in (*COLUMNS, *OPTIONAL):
        if columns.count(name) > 1:
            raise RecordError(f"{table}, line 1: the column {name} stands twice")
    return columns


def read_lines(table: Path) -> tuple[list[Line], tuple[str, ...]]:
    """Lines and columns of a table; blank lines are passed over.

    Raises:
        RecordError: the table is missing, is no CSV in UTF-8, or a line of it makes no sense.
    """
    try:
        text = bounded_bytes(table).decode("utf-8-sig")
    except FileNotFoundError:
        there = table.parent.is_dir()
        what = (
            f"there is no {table.name} in it, which lists the frames; `anisoscope inspect --frames {table.parent} "
            "--init` begins one"
        )
        raise RecordError(
            f"{table.parent}: {what if there else 'there is no such folder of frames'}"
        ) from None
    except UnicodeDecodeError:
        raise RecordError(f"{table}: not a text file in UTF-8; save it as 'CSV UTF-8'") from None
    except OSError as problem:
        raise RecordError(f"{table}: cannot be read: {problem.strerror or problem}") from problem
    reader = csv.reader(io.StringIO(text, newline=""), skipinitialspace=True)
    try:
        columns = read_header(next(reader, []), table)
        return [
            parse_line(fields, columns, f"{table}, line {reader.line_num}", reader.line_num)
            for fields in reader
            if any(field.strip() for field in fields)
        ], columns
    except csv.Error as problem:
        raise RecordError(f"{table}, line {reader.line_num}: {problem}") from problem


def parse_line(fields: list[str], columns: tuple[str, ...], place: str, number: int) -> Line:
    """Values of a line.

    Raises:
        RecordError: it has too few or too many values, or one of them makes no sense.
    """
    if len(fields) != len(columns):
        raise RecordError(f"{place}: {len(columns)} values expected, {len(fields)} found")
    texts = {name: text.strip() for name, text in zip(columns, fields, strict=True)}
    if not texts["file"].isprintable() or not texts["file"]:
        raise RecordError(f"{place}: the file has no name, or one that cannot be printed")
    again = _AGAIN.get(texts.get("again", ""))
    if again is None:
        raise RecordError(f"{place}: again must be 0 or 1, not {texts['again']!r}")
    filters = texts.get("filters", "").lower() or None
    if filters is not None and filters not in FILTERS:
        raise RecordError(f"{place}: filters must be one of {', '.join(FILTERS)}, not {texts['filters']!r}")
    values = {name: _number(texts[name], name, place) for name in COLUMNS[2:]}
    for name in ("exposure_s", "gain"):
        if values[name] <= 0.0:
            raise RecordError(f"{place}: {name} must be above 0, not {texts[name]!r}")
    bits = values["bit_depth"]
    if bits != int(bits) or not 1 <= bits <= 16:
        raise RecordError(
            f"{place}: bit_depth must be a whole number from 1 to 16, not {texts['bit_depth']!r}"
        )
    if not 0.0 <= values["black_level"] < 2.0**bits:
        raise RecordError(
            f"{place}: black_level must lie from 0 to {2 ** int(bits) - 1}, not {texts['black_level']!r}"
        )
    return Line(
        number=number,
        file=texts["file"],
        kind=texts["kind"].lower(),
        stage_deg=values["stage_deg"],
        tilt_deg=values["tilt_deg"],
        exposure_s=values["exposure_s"],
        gain=values["gain"],
        bit_depth=int(bits),
        black_level=values["black_level"],
        again=again,
        filters=filters,
    )


def find_inside(folder: Path, name: str, place: str) -> Path:
    """The file that a line names; a name with backslashes was written under Windows.

    Raises:
        RecordError: there is none, or it lies outside of the folder.
    """
    inside = folder.resolve()
    path = (inside / name).resolve()
    windows = PureWindowsPath(name)
    if "\\" in name and not windows.drive and not path.exists():
        path = (inside / windows.as_posix()).resolve()
    if windows.drive or not path.is_relative_to(inside):
        raise RecordError(f"{place}: {name} lies outside of {folder}; move it into the folder")
    if not path.is_file():
        raise RecordError(f"{place}: there is no file {name} in {folder}")
    return path


def _number(text: str, name: str, place: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise RecordError(f"{place}: {name} must be a number (with a point), not {text!r}")
    return number
