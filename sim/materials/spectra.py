"""Spectra in CSV files (lamps, sensitivities of cameras, reflectances, constants of plastics), and those with names."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.csv_table import Table, read_table
from anisoscope.base.errors import ModelError, UsageError
from anisoscope.parameters.material import Material
from anisoscope.sim.light.colour.illuminant import NEEDED_NM, Illuminant, standard, standard_names
from anisoscope.sim.light.colour.lamps import LED_WHITE, synthetic_white_led
from anisoscope.sim.light.colour.vision import Sensitivities, synthetic_bayer, synthetic_silicon

COLUMNS = ("wavelength_nm", "power")
FILTER_COLUMNS = ("wavelength_nm", "red", "green", "blue")
MONO_COLUMNS = ("wavelength_nm", "mono")
REFLECTANCE_COLUMNS = ("wavelength_nm", "reflectance")
SYNTHETIC = "synthetic"
"""Name of the made-up sensitivities."""

_MICROMETRES = 20.0


def _table(path: Path, *layouts: tuple[str, ...]) -> Table:
    numbers = tuple({name: None for layout in layouts for name in layout[1:]})
    table = read_table(path, layouts, above_zero=("wavelength_nm",), not_negative=numbers, what="wavelengths")
    if table.column("wavelength_nm").max() < _MICROMETRES:
        raise UsageError(f"{path}: wavelength_nm looks like µm: write nm, 1000 times larger")
    return table


def read_spectrum(path: Path) -> Illuminant:
    """Read ``wavelength_nm,power``: relative spectral power at rising wavelengths of any spacing.

    Raises:
        UsageError: a line of the file cannot be used, or it holds no spectrum of a lamp.
    """
    table = _table(path, COLUMNS)
    nm, power = table.column("wavelength_nm"), table.column("power")
    try:
        return Illuminant(path.stem, tuple(nm.tolist()), tuple(power.tolist()))
    except ModelError as problem:
        raise UsageError(f"{path}: {problem}") from None


def find_illuminant(text: str) -> Illuminant:
    """A CIE illuminant by name, ``led-white`` (synthetic), or the spectrum in a file ``*.csv``.

    Raises:
        UsageError: neither.
    """
    if text.lower().endswith(".csv"):
        return read_spectrum(Path(text))
    if text.lower() == LED_WHITE:
        return synthetic_white_led()
    if text.lower() not in standard_names():
        raise UsageError(
            f"no illuminant is named {text!r}; known: {', '.join((*standard_names(), LED_WHITE))}, or a file *.csv"
        )
    return standard(text)


def read_sensitivities(path: Path) -> Sensitivities:
    """Read ``wavelength_nm,red,green,blue`` or ``wavelength_nm,mono``: relative quantum efficiency, in any unit.

    Raises:
        UsageError: a line of the file cannot be used, or it holds no sensitivities of a camera.
    """
    table = _table(path, FILTER_COLUMNS, MONO_COLUMNS)
    nm, *curves = (tuple(table.column(name).tolist()) for name in table.columns)
    try:
        return Sensitivities(path.stem, nm, tuple(curves))
    except ModelError as problem:
        raise UsageError(f"{path}: {problem}") from None


def find_sensitivities(text: str, filters: str) -> Sensitivities:
    """Sensitivities of a camera: from a file ``*.csv``, or ``synthetic``.

    Args:
        text: the file, or ``synthetic``.
        filters: of the camera, as `anisoscope.rig.bayer` names them.

    Raises:
        UsageError: neither; the file cannot be used, or has not the channels of such a camera.
    """
    if text.lower() == SYNTHETIC:
        return synthetic_silicon() if filters == "mono" else synthetic_bayer()
    if not text.lower().endswith(".csv"):
        raise UsageError(f"no sensitivities are named {text!r}; known: {SYNTHETIC}, or a file *.csv")
    path = Path(text)
    found = read_sensitivities(path)
    expected = 1 if filters == "mono" else 3
    if len(found.curves) != expected:
        columns = MONO_COLUMNS if expected == 1 else FILTER_COLUMNS
        raise UsageError(f"{path}: a camera with filters {filters!r} needs the columns {','.join(columns)}")
    return found


def read_reflectance(path: Path) -> tuple[FloatArray, FloatArray]:
    """Read ``wavelength_nm,reflectance``: (W,) wavelengths, and (W,) reflectance of a diffuse surface, 0 to 1.

    Raises:
        UsageError: a line of the file cannot be used, or wavelengths or reflectances make no sense.
    """
    table = _table(path, REFLECTANCE_COLUMNS)
    nm, share = table.column("wavelength_nm"), table.column("reflectance")
    if not np.all(np.diff(nm) > 0.0) or nm[0] > NEEDED_NM[0] or nm[-1] < NEEDED_NM[1]:
        raise UsageError(
            f"{path}: wavelengths must rise, at least from {NEEDED_NM[0]:g} to {NEEDED_NM[1]:g} nm"
        )
    if share.max() > 1.0:
        raise UsageError(f"{path}: a reflectance lies in 0 to 1, not at {share.max():g}: write shares, not %")
    return nm, share


@dataclass(frozen=True)
class PlasticSpectrum:
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


PLASTIC_COLUMNS = ("wavelength_nm", "index", "albedo")


def read_plastic_spectrum(path: Path) -> PlasticSpectrum:
    """Read a CSV file with the columns wavelength_nm, index and albedo, UTF-8, wavelengths rising.

    Raises:
        UsageError: the file cannot be read, or a line of it cannot be used; the message names the line.
    """
    table = read_table(path, (PLASTIC_COLUMNS,), what="wavelengths")
    try:
        return PlasticSpectrum(*(tuple(table.column(name).tolist()) for name in PLASTIC_COLUMNS))
    except ModelError as error:
        raise UsageError(f"{path}: {error}") from None
