"""Read the spectrum of a plastic from a CSV file."""

from pathlib import Path

from anisoscope.base.csv_table import read_table
from anisoscope.base.errors import ModelError, UsageError
from anisoscope.sim.light.spectrum import Spectrum

COLUMNS = ("wavelength_nm", "index", "albedo")


def read_spectrum(path: Path) -> Spectrum:
    """Read a CSV file with the columns wavelength_nm, index and albedo, UTF-8, wavelengths rising.

    Raises:
        UsageError: the file cannot be read, or a line of it cannot be used; the message names the line.
    """
    table = read_table(path, (COLUMNS,), what="wavelengths")
    try:
        return Spectrum(*(tuple(table.column(name).tolist()) for name in COLUMNS))
    except ModelError as error:
        raise UsageError(f"{path}: {error}") from None
