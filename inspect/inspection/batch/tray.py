"""Tray list: the part in each slot, from a CSV file or AQDEF."""

import csv
import difflib
import hashlib
import io
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from anisoscope.base.csv_table import read_text
from anisoscope.base.errors import UsageError
from anisoscope.base.printable import check_printable
from anisoscope.history.aqdef import SUFFIXES, read_aqdef
from anisoscope.inspection.job import check_serial

COLUMNS = ("slot", "serial", "lot", "cavity", "recipe", "rig", "x_mm", "y_mm")
NEEDED = ("slot", "serial")
SLOT = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,31}")
_SEPARATORS = ",;\t"


@dataclass(frozen=True)
class Slot:
    """A line of the tray list.

    Attributes:
        label: name of the slot; no two are alike, whether in capitals or not.
        serial: serial number of the part; None where its code will say it.
        lot, cavity: as far as the list says them.
        recipe, rig: files for this part only, or None.
        line: number of the line in the file.
        place_mm: (x, y) of the part from the axis of the stage at sample angle 0, for the axes x and y; or None.
    """

    label: str
    serial: str | None
    lot: str | None = None
    cavity: str | None = None
    recipe: Path | None = None
    rig: Path | None = None
    line: int = 0
    place_mm: tuple[float, float] | None = None


@dataclass(frozen=True)
class Tray:
    """A tray list.

    Attributes:
        path: the file.
        sha256: of the file; from AQDEF, of the list.
        slots: in the order of the file.
        notes: what was passed over in reading, one line each.
    """

    path: Path
    sha256: str
    slots: tuple[Slot, ...]
    notes: tuple[str, ...] = ()

    @property
    def placed(self) -> bool:
        """Whether every part has a place on the plate, so that all are put on at once."""
        return all(slot.place_mm is not None for slot in self.slots)


def read_tray(path: Path) -> Tray:
    """Read a tray list.

    Args:
        path: CSV in UTF-8, with or without a byte order mark, separated by commas, semicolons or tabs; the header
            names ``slot`` and ``serial`` and, if wanted, ``lot``, ``cavity``, ``recipe``, ``rig``, and ``x_mm`` with
            ``y_mm``, in any order. Or AQDEF: its parts (K0014) with lot (K0006) and cavity are in slots 1, 2, …

    Raises:
        UsageError: the file cannot be used; line and column are named.
    """
    if path.suffix.lower() in SUFFIXES:
        return _from_aqdef(path)
    text = read_text(path)
    reader = csv.reader(
        io.StringIO(text, newline=""), delimiter=_separator(text), strict=True, skipinitialspace=True
    )
    try:
        read = [(reader.line_num, fields) for fields in reader]
    except csv.Error as error:
        raise UsageError(f"{path}, line {reader.line_num}: {error}") from error
    lines = [
        (number, fields)
        for number, fields in read
        if any(field.strip() for field in fields) and not _is_hint(fields, number)
    ]
    if not lines:
        raise UsageError(f"{path}, line 1: the file is empty; its header must name {' and '.join(NEEDED)}")
    columns = _columns(lines[0][1], f"{path}, line {lines[0][0]}")
    slots = tuple(_slot(fields, columns, path, number) for number, fields in lines[1:])
    if not slots:
        raise UsageError(f"{path}, line {lines[0][0]}: no slots follow the header")
    _refuse_doubles(slots, path)
    extra = [name for name in columns if name not in COLUMNS]
    notes = (f"{path}: columns passed over: {', '.join(extra)}",) if extra else ()
    return Tray(path, hashlib.sha256(text.encode()).hexdigest(), slots, notes)


def _from_aqdef(path: Path) -> Tray:
    texts = read_aqdef(path).texts
    if "serial" not in texts:
        raise UsageError(f"{path}: no serial numbers of parts (K0014)")
    slots = []
    for number, serial in enumerate(texts["serial"], start=1):
        try:
            check_serial(serial)
        except UsageError as error:
            raise UsageError(f"{path}, part {number}, K0014: {error}") from None
        lot, cavity = (
            texts[name][number - 1] or None if name in texts else None for name in ("lot", "cavity")
        )
        check_printable({f"{path}, part {number}, lot": lot, f"{path}, part {number}, cavity": cavity})
        slots.append(Slot(str(number), serial, lot, cavity, line=number))
    _refuse_doubles(tuple(slots), path, "part")
    return Tray(path, hashlib.sha256(repr(slots).encode()).hexdigest(), tuple(slots))


def _separator(text: str) -> str:
    """Most frequent separator of the header; spreadsheets may state it in a first line ``sep=;``."""
    first = next((line for line in text.splitlines() if line.strip()), "")
    return max(_SEPARATORS, key=first.count)


def _is_hint(fields: list[str], number: int) -> bool:
    return number == 1 and fields[0].strip().lower().startswith("sep=")


def _columns(fields: list[str], place: str) -> tuple[str, ...]:
    columns = tuple(field.strip().lower() for field in fields)
    for name in NEEDED:
        if name not in columns:
            close = difflib.get_close_matches(name, [c for c in columns if c not in COLUMNS], n=1)
            hint = f"is {close[0]!r} meant?" if close else f"it may have {', '.join(COLUMNS)}"
            raise UsageError(f"{place}: the header has no column {name}; {hint}")
    for name in columns:
        if name and columns.count(name) > 1:
            raise UsageError(f"{place}: the column {name} stands twice")
    return columns


def _slot(fields: list[str], columns: tuple[str, ...], path: Path, number: int) -> Slot:
    place = f"{path}, line {number}"
    if len(fields) != len(columns):
        raise UsageError(f"{place}: {len(columns)} values expected, {len(fields)} found")
    texts = {
        name: _clean(text, f"{place}, column {name}")
        for name, text in zip(columns, fields, strict=True)
        if name in COLUMNS
    }
    label = texts["slot"]
    if not SLOT.fullmatch(label):
        raise UsageError(
            f"{place}, column slot: {label!r} cannot name a slot: 1 to 32 letters, digits or . _ -, "
            "beginning with a letter or a digit"
        )
    serial = texts["serial"] or None
    if serial is not None:
        try:
            check_serial(serial)
        except UsageError as error:
            raise UsageError(f"{place}, column serial: {error}") from None
    return Slot(
        label=label,
        serial=serial,
        lot=texts.get("lot") or None,
        cavity=texts.get("cavity") or None,
        recipe=_file(texts, "recipe", path, place),
        rig=_file(texts, "rig", path, place),
        line=number,
        place_mm=_place(texts, place),
    )


def _place(texts: Mapping[str, str], place: str) -> tuple[float, float] | None:
    """Place of the part on the plate."""
    found = {column: texts.get(column) for column in ("x_mm", "y_mm")}
    if not any(found.values()):
        return None
    numbers = []
    for column, text in found.items():
        if not text:
            raise UsageError(f"{place}, column {column}: missing; a place on the plate has x_mm and y_mm")
        try:
            number = float(text.replace(",", "."))
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise UsageError(f"{place}, column {column}: {text!r} is no length in mm")
        numbers.append(number)
    return numbers[0], numbers[1]


def _clean(text: str, place: str) -> str:
    """Text without blanks around it; errors as for `check_printable`."""
    check_printable({place: text.strip()})
    return text.strip()


def _file(texts: Mapping[str, str], column: str, path: Path, place: str) -> Path | None:
    """A file named relative to the list."""
    if not texts.get(column):
        return None
    found = path.parent / texts[column]
    if not found.is_file():
        raise UsageError(f"{place}, column {column}: there is no file {found}")
    return found


def _refuse_doubles(slots: tuple[Slot, ...], path: Path, entry: str = "line") -> None:
    """Refuse names that differ only in case: they share a folder on some systems."""
    first_with: dict[tuple[str, str], Slot] = {}
    for slot in slots:
        names = {"slot": slot.label.casefold(), "serial": slot.serial}
        for column, name in names.items():
            first = slot if name is None else first_with.setdefault((column, name), slot)
            if first is not slot:
                value = slot.label if column == "slot" else slot.serial
                raise UsageError(
                    f"{path}, {entry} {slot.line}, column {column}: {value} stands already in {entry} {first.line}; "
                    f"every {column} stands once"
                )
