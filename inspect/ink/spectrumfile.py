"""Spectra of lamps: CIE ones by name, measured ones from CSV files."""

from pathlib import Path

from anisoscope.csvtable import read_table
from anisoscope.errors import ModelError, UsageError
from anisoscope.sim.light.colour.illuminant import Illuminant, standard, standard_names

COLUMNS = ("wavelength_nm", "power")


def read_spectrum(path: Path) -> Illuminant:
    """Read ``wavelength_nm,power``: relative spectral power at rising wavelengths of any spacing.

    Raises:
        UsageError: a line of the file cannot be used, or it holds no spectrum of a lamp.
    """
    table = read_table(
        path, (COLUMNS,), above_zero=("wavelength_nm",), not_negative=("power",), what="wavelengths"
    )
    nm, power = table.column("wavelength_nm"), table.column("power")
    if nm.max() < 20.0:
        raise UsageError(f"{path}: wavelength_nm looks like µm: write nm, 1000 times larger")
    try:
        return Illuminant(path.stem, tuple(nm.tolist()), tuple(power.tolist()))
    except ModelError as problem:
        raise UsageError(f"{path}: {problem}") from None


def find_illuminant(text: str) -> Illuminant:
    """A CIE illuminant by name, or the spectrum in a file ``*.csv``.

    Raises:
        UsageError: neither.
    """
    if text.lower().endswith(".csv"):
        return read_spectrum(Path(text))
    if text.lower() not in standard_names():
        raise UsageError(
            f"no illuminant is named {text!r}; known: {', '.join(standard_names())}, or a file *.csv"
        )
    return standard(text)
