"""Text files and their numbers, as programs of many countries and ages write them."""

import codecs
import re
from pathlib import Path

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.profiles.files.checks import check_claim, refuse
from anisoscope.profiles.files.content import DAMAGED

MAX_TEXT_BYTES = 2**31
MISSING = {"", "-", "--", "***", "nan", "na", "n/a", "null", "bad", "no data", "nodata"}
FORTRAN = re.compile(r"([+-]?[0-9.]+)[dD]([+-]?[0-9]+)")
"""Double precision of Fortran, 1.5D-03."""


def text_of(path: Path) -> str:
    """Text of a file in UTF-8, UTF-16 with its mark, or Latin-1.

    Raises:
        HeightMapError: it is too large, or holds binary data.
    """
    name = path.name
    if (size := path.stat().st_size) > MAX_TEXT_BYTES:
        refuse(name, "size", f"{size} bytes", "text files up to 2 GiB are read; use x3p or npy")
    content = bounded_bytes(path, MAX_TEXT_BYTES)
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16", "replace")
    if b"\0" in content[:4096]:
        refuse(name, "text", "holds binary data", "this is no text file; give it its own extension")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def number_of(name: str, line: int, cell: str, decimal: str = ".") -> float:
    """The number of a cell, NaN where it says that nothing was measured.

    Args:
        name: of the file.
        line: number of the line.
        cell: text of the cell.
        decimal: its decimal sign.

    Raises:
        HeightMapError: it is no number; with line and text.
    """
    plain = cell if decimal == "." else cell.replace(",", ".")
    try:
        return float(plain)
    except ValueError:
        if fortran := FORTRAN.fullmatch(plain):
            try:
                return float(f"{fortran[1]}e{fortran[2]}")
            except ValueError:
                pass
        if cell.lower().strip('"') not in MISSING:
            refuse(name, f"line {line}", f"{cell[:40]!r} is no number", "this is no height map as text")
        return float(np.nan)


def numbers_of(name: str, start: int, lines: list[str]) -> list[float]:
    """All numbers of lines, the first of which has the number ``start``."""
    return [number_of(name, k, cell) for k, line in enumerate(lines, start) for cell in line.split()]


def grid_of(name: str, numbers: list[float], rows: int, cols: int) -> FloatArray:
    """(rows, cols) of the numbers of a file.

    Raises:
        HeightMapError: there are more or fewer.
    """
    check_claim(name, rows, cols, 0, 0)
    if len(numbers) != rows * cols:
        refuse(name, "data", f"{len(numbers)} numbers for {rows} × {cols} points", DAMAGED)
    return np.array(numbers).reshape(rows, cols)
