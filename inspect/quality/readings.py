"""Readings to chart: numbers in measurement order with their groups, from CSV and AQDEF files or from the history."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, tzinfo
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.csv_style import CsvReader
from anisoscope.base.csv_table import read_text
from anisoscope.base.errors import UsageError
from anisoscope.history.aqdef import SUFFIXES, read_aqdef
from anisoscope.history.filters import Filters

if TYPE_CHECKING:
    from anisoscope.history.column_wise import Columns

GROUPS = ("product", "recipe", "lot", "cavity", "station", "operator")
TEXTS = ("time", "serial", *GROUPS, "verdict", "part", "appraiser", "trial", "folder")
SYNONYMS = {
    **dict.fromkeys(("part id", "part number", "part no", "parts", "specimen"), "part"),
    **dict.fromkeys(("appraisers", "inspector", "measurer"), "appraiser"),
    **dict.fromkeys(("operators", "op"), "operator"),
    **dict.fromkeys(("replicate", "repeat", "rep", "run"), "trial"),
    **dict.fromkeys(("timestamp", "datetime", "date/time"), "time"),
    **dict.fromkeys(("serial number", "serial no"), "serial"),
    **dict.fromkeys(("batch", "lot number"), "lot"),
}
"""Headers of other programs, in lower case; blanks may be ``_``, ``-`` or ``.``."""
MISSING = {"", "nan", "na", "-", "missing", "invalid"}
INVALID = "INVALID"


@dataclass(frozen=True, eq=False)
class Readings:
    """Columns of equal length.

    Attributes:
        source: where they come from, for messages and titles.
        texts: columns of words: some of ``TEXTS``.
        numbers: columns of numbers, NaN where there is none.
        zone: of the times; None for that of this computer.
        base: folder that relative folders of inspections are in.
        limits: lower and upper limit of numbers that come with such.
        machine: cycle data of the machine, by name, NaN where there is none: see `with_machine`.
    """

    source: str
    texts: Mapping[str, tuple[str, ...]]
    numbers: Mapping[str, FloatArray]
    zone: tzinfo | None = None
    base: Path = Path()
    limits: Mapping[str, tuple[float | None, float | None]] = field(default_factory=dict)
    machine: Mapping[str, FloatArray] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(next(iter(self.numbers.values()), ()))

    @property
    def labels(self) -> tuple[str, ...]:
        """A name for every reading: serial number or time, else its place from 1."""
        for column in ("serial", "time"):
            if column in self.texts:
                names = self.texts[column]
                return tuple(name or f"#{k}" for k, name in enumerate(names, start=1))
        return tuple(f"#{k}" for k in range(1, len(self) + 1))

    def moment(self, place: int) -> datetime | None:
        """Time of a reading in the zone of this computer; None where there is none that can be read."""
        text = self.texts["time"][place] if "time" in self.texts else ""
        try:
            found = datetime.fromisoformat(text)
        except ValueError:
            return None
        return (found if found.tzinfo or self.zone is None else found.replace(tzinfo=self.zone)).astimezone()

    def folder(self, place: int) -> str:
        """Inspection folder of a reading; "" where none is named."""
        text = self.texts["folder"][place] if "folder" in self.texts else ""
        return str(self.base / text) if text else ""

    def number(self, name: str | None) -> tuple[str, FloatArray]:
        """Name and values of a number; the first one for None.

        Raises:
            UsageError: there is no such number.
        """
        if name is None:
            return next(iter(self.numbers.items()))
        if name not in self.numbers:
            known = ", ".join(self.numbers)
            raise UsageError(f"{self.source}: there is no number {name!r}; there are: {known}")
        return name, self.numbers[name]

    def only(self, keep: Mapping[str, str | None]) -> "Readings":
        """Readings whose texts match; None matches all.

        Raises:
            UsageError: there is no such column, or nothing is left.
        """
        mask = np.ones(len(self), dtype=np.bool_)
        selection = {column: word for column, word in keep.items() if word is not None}
        for column, word in selection.items():
            mask &= np.array([text == word for text in self.column(column)], dtype=np.bool_)
        if not mask.any():
            wish = ", ".join(f"{column} {word}" for column, word in selection.items())
            raise UsageError(f"{self.source}: no reading has {wish}")
        return self if mask.all() else self.at(mask.nonzero()[0].tolist())

    def latest(self, limit: int) -> "Readings":
        """The last readings; all for 0."""
        return self if limit in (0, len(self)) else self.at(list(range(len(self)))[-limit:])

    def column(self, name: str) -> tuple[str, ...]:
        """A column of words.

        Raises:
            UsageError: there is none.
        """
        if name not in self.texts:
            raise UsageError(f"{self.source}: there is no column {name!r} to choose or group by")
        return self.texts[name]

    def grouped(self, by: str | None) -> dict[str, "Readings"]:
        """Readings of every word of a column, in the order in which the words first occur; all under "" for None.

        Raises:
            UsageError: there is no such column.
        """
        if by is None:
            return {"": self}
        places: dict[str, list[int]] = {}
        for place, word in enumerate(self.column(by)):
            places.setdefault(word, []).append(place)
        return {word: self.at(where) for word, where in places.items()}

    def at(self, places: list[int]) -> "Readings":
        """The readings at some places, from 0."""
        return Readings(
            self.source,
            {name: tuple(column[k] for k in places) for name, column in self.texts.items()},
            {name: column[places] for name, column in self.numbers.items()},
            self.zone,
            self.base,
            self.limits,
            {name: column[places] for name, column in self.machine.items()},
        )

    def against(self, names: tuple[str, ...] | None, number: str) -> dict[str, FloatArray]:
        """Columns that a number is compared with: cycle data, or other numbers, by name; all cycle data for None.

        Raises:
            UsageError: there is no such column.
        """
        if names is None:
            return dict(self.machine)
        known = {**{name: one for name, one in self.numbers.items() if name != number}, **self.machine}
        for name in names:
            if name not in known:
                raise UsageError(
                    f"{self.source}: there is nothing named {name!r}; there are: {', '.join(known)}"
                )
        return {name: known[name] for name in names}


def read_readings(path: Path | str) -> Readings:
    """Read a CSV file: a header, then one reading a line, in the order in which they were measured; or an AQDEF file.

    Columns are separated by commas, or by semicolons, and numbers then have a decimal comma.

    Columns named as in ``TEXTS`` or ``SYNONYMS``, whatever their capitals, hold words, all others numbers. An empty
    field, ``nan``, ``invalid`` or ``-`` is a missing number; so is a blank line in a file of one column. Where there
    is a column ``verdict``, the numbers of a line that says INVALID are missing too.

    Raises:
        UsageError: the file cannot be read, or a line of it cannot be used; line and column are named.
    """
    path = Path(path)
    if path.suffix.lower() in SUFFIXES:
        found = read_aqdef(path)
        if not next((len(column) for column in found.numbers.values()), 0):
            raise UsageError(f"{path}: the characteristics have no values (.dfx)")
        return Readings(
            str(path),
            found.texts,
            without_invalid(found.texts, found.numbers),
            base=path.parent,
            limits=found.limits,
        )
    reader = CsvReader(read_text(path), path)
    columns = _columns(path, next(reader, []))
    rows = _rows(reader, len(columns))
    if not rows:
        raise UsageError(f"{path}, line 2: no readings follow the header")
    for line, row in rows:
        if len(row) != len(columns):
            raise UsageError(f"{path}, line {line}: {len(columns)} values expected, {len(row)} found")
    lines = [line for line, _ in rows]
    fields = dict(zip(columns, zip(*(row for _, row in rows), strict=True), strict=True))
    texts = {name: tuple(text.strip() for text in column) for name, column in fields.items() if name in TEXTS}
    numbers = {
        name: _numbers(path, name, [reader.with_point(text) for text in column], lines)
        for name, column in fields.items()
        if name not in TEXTS
    }
    return Readings(str(path), texts, without_invalid(texts, numbers), base=path.parent)


def _rows(reader: CsvReader, columns: int) -> list[tuple[int, list[str]]]:
    """Line numbers and fields. A blank line between others is a missing reading of one column, else no line at all."""
    rows = [(reader.line_num, row or [""] * columns) for row in reader]
    while rows and not any(field.strip() for field in rows[-1][1]):
        rows.pop()
    if columns == 1:
        return rows
    return [(line, row) for line, row in rows if any(field.strip() for field in row)]


def without_invalid(
    texts: Mapping[str, tuple[str, ...]], numbers: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Readings with the numbers of INVALID inspections removed: they do not describe the part."""
    if "verdict" not in texts:
        return dict(numbers)
    invalid = np.array([verdict == INVALID for verdict in texts["verdict"]], dtype=np.bool_)
    return {name: np.where(invalid, np.nan, column) for name, column in numbers.items()}


def _column(name: str) -> str:
    """Name of a column of words as we call it, whatever its capitals; that of a number as it is."""
    plain = " ".join(name.lower().translate(str.maketrans("_-.", "   ")).split())
    found = SYNONYMS.get(plain, plain)
    return found if found in TEXTS else name


def _columns(path: Path, header: list[str]) -> list[str]:
    columns = [_column(name.strip()) for name in header]
    if not columns or not all(columns) or len(set(columns)) != len(columns):
        raise UsageError(f"{path}, line 1: the header must name every column, and each of them once")
    if all(name in TEXTS for name in columns):
        raise UsageError(
            f"{path}, line 1: there is no column of numbers; columns other than {', '.join(TEXTS)} hold numbers"
        )
    return columns


def _numbers(path: Path, name: str, column: Iterable[str], lines: list[int]) -> FloatArray:
    found = np.empty(len(lines))
    for place, text in enumerate(column):
        try:
            found[place] = value = float(text)
        except ValueError:
            if text.strip().lower() not in MISSING:
                raise UsageError(
                    f"{path}, line {lines[place]}: {name} is not a number: {text!r} (leave it empty if missing)"
                ) from None
            found[place] = np.nan
            continue
        if math.isinf(value):
            raise UsageError(f"{path}, line {lines[place]}: {name} must be a finite number, not {text!r}")
    return found


def history_readings(place: str | Path, filters: Filters) -> Readings:
    """All numbers of some inspections, the oldest first.

    Args:
        place: as for `open_history`; nothing is made where there is none.
        filters: which inspections.

    Raises:
        UsageError: no inspection is left, or none has a number.
        HistoryError: the history cannot be read.
    """
    from anisoscope.history.store import open_history  # noqa: PLC0415 - slow to import

    with open_history(place, create=False) as history:
        found = history.columns(filters)
        where = f"history {history.address}"
    if not len(found.times):
        raise UsageError(f"the {where} has no inspection of this kind")
    readings = readings_of(found, where)
    if not readings.numbers:
        raise UsageError(f"no inspection of this kind in the {where} has a number")
    return readings


def with_machine(readings: Readings, place: str | Path) -> Readings:
    """Readings of a history with the cycle data of machines that it holds.

    Args:
        readings: from `history_readings`.
        place: the same history.

    Raises:
        HistoryError: the history cannot be read.
    """
    from anisoscope.history.store import open_history  # noqa: PLC0415

    with open_history(place, create=False) as history:
        found = history.covariates()
    # times of readings are whole seconds
    times = np.array(readings.column("time"), dtype="datetime64[s]").astype(np.int64) * 1_000_000 + 999_999
    return replace(readings, machine=found.of_parts(readings.column("serial"), times))


def readings_of(found: "Columns", source: str) -> Readings:
    """Numbers of INVALID inspections are missing, and so are those that an inspection does not have.

    Args:
        found: in the order in which they were measured.
        source: where they come from, for messages.
    """
    texts = {"time": _written(found.times)}
    texts |= {name: found.texts[name] for name in ("serial", "verdict", *GROUPS, "folder")}
    return Readings(source, texts, without_invalid(texts, found.numbers), UTC, found.base)


def _written(times: npt.NDArray[np.datetime64]) -> tuple[str, ...]:
    """Times to the second, day and time with a blank between them."""
    written = np.datetime_as_string(times.astype("datetime64[s]"))
    if written.size:
        signs = written.view(("U1", written.dtype.itemsize // 4))
        signs[:, np.argmax(signs[0] == "T")] = " "
    return tuple(written.tolist())
