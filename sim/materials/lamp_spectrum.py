"""Read the spectrum of a plastic from a CSV file."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from anisoscope.base.csv_table import read_table
from anisoscope.base.errors import ModelError, UsageError
from anisoscope.sim.light.material import Material


@dataclass(frozen=True)
class Spectrum:
    """Optical constants at W wavelengths; the roughness does not depend on them.

    Attributes:
        wavelengths_nm: rising, in nm of vacuum.
        index: refractive index at each of them.
        albedo: diffuse albedo at each of them, 0 to 1.

    Raises:
        ModelError: no wavelength, lengths that differ, or wavelengths that are not positive and rising.
    """

    wavelengths_nm: tuple[float, ...]
    index: tuple[float, ...]
    albedo: tuple[float, ...]

    def __post_init__(self) -> None:
        if not len(self.wavelengths_nm) == len(self.index) == len(self.albedo):
            raise ModelError("a spectrum needs one index and one albedo for every wavelength")
        steps = np.diff((0.0, *self.wavelengths_nm))
        if steps.size == 0 or not np.all((steps > 0.0) & np.isfinite(steps)):
            raise ModelError("the wavelengths of a spectrum must be positive, in nm, and rise")

    def materials(self, base: Material) -> tuple[Material, ...]:
        """(W,) materials: ``base`` with the index and albedo of each wavelength.

        Raises:
            ModelError: an index or albedo outside the range of the model; the message names the wavelength.
        """
        found = []
        for wavelength, index, albedo in zip(self.wavelengths_nm, self.index, self.albedo, strict=True):
            try:
                found.append(replace(base, index=index, albedo=albedo))
            except ModelError as error:
                raise ModelError(f"at {wavelength:g} nm: {error}") from None
        return tuple(found)


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
