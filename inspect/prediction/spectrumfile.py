"""Read the spectrum of a plastic from a CSV file."""

import csv
from pathlib import Path

from anisoscope.errors import ModelError, UsageError
from anisoscope.sim.light.spectrum import Spectrum

COLUMNS = ("wavelength_nm", "index", "albedo")


def read_spectrum(path: Path) -> Spectrum:
    """Read a CSV file with the columns wavelength_nm, index and albedo, UTF-8, wavelengths rising.

    Raises:
        UsageError: the file cannot be read, or a line of it cannot be used; the message names the line.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise UsageError(f"cannot read {path}: {reason}") from error
    lines = csv.reader(text.splitlines())
    try:
        names = tuple(name.strip() for name in next(lines, []))
        if names != COLUMNS:
            raise UsageError(
                f"{path}, line 1: the header must read {','.join(COLUMNS)}, not {','.join(names)!r}"
            )
        rows = [
            _numbers(fields, f"{path}, line {lines.line_num}")
            for fields in lines
            if any(f.strip() for f in fields)
        ]
    except csv.Error as error:
        raise UsageError(f"{path}, line {lines.line_num}: {error}") from error
    if not rows:
        raise UsageError(f"{path}: no wavelengths follow the header")
    wavelengths, index, albedo = zip(*rows, strict=True)
    try:
        return Spectrum(wavelengths, index, albedo)
    except ModelError as error:
        raise UsageError(f"{path}: {error}") from None


def _numbers(fields: list[str], place: str) -> tuple[float, float, float]:
    if len(fields) != len(COLUMNS):
        raise UsageError(f"{place}: {len(COLUMNS)} values expected, {len(fields)} found")
    numbers = []
    for name, text in zip(COLUMNS, fields, strict=True):
        try:
            number = float(text)
        except ValueError:
            raise UsageError(f"{place}: {name} is not a number: {text!r}") from None
        if not abs(number) < float("inf"):
            raise UsageError(f"{place}: {name} must be a finite number, not {text!r}")
        numbers.append(number)
    return numbers[0], numbers[1], numbers[2]
