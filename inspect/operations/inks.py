"""Inks fitted to goniometer readings or to prints on a rig, and models of an ink against pictures from readings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import CalibrationError, ModelError, UsageError
from anisoscope.base.json_fields import in_json
from anisoscope.base.progress import Advance, silent
from anisoscope.ink.fitting import InkFit, Method, RigInk, fit
from anisoscope.ink.goniometer import Readings, Values, White, read_correction, read_goniometer, to_brdf
from anisoscope.inspection.manifest import reopen
from anisoscope.kinds.parts import Inked
from anisoscope.record.schema import read_record
from anisoscope.sim.light.ink.ink import SPECTRALON
from anisoscope.sim.materials.inks import SYNTHETIC, synthetic_ink
from anisoscope.sim.materials.spectra import find_illuminant
from anisoscope.sim.proof.comparison import CONVENTION, Comparison, compare, synthetic_readings
from anisoscope.sim.proof.imagefile import picture_png
from anisoscope.sim.proof.measured import Measured


def read_brdf(
    data: Path | str,
    values: Values = "factor",
    *,
    reflectance: float | None = None,
    white_table: Path | str | None = None,
    white_readings: Path | str | None = None,
) -> Readings:
    """Goniometer readings of an ink as a BRDF in 1/sr.

    Args:
        data: CSV file theta_i_deg,theta_o_deg,wavelength_nm,value; θo counts away from the light.
        values: "factor": ratios to the white reference; "brdf": BRDF in 1/sr.
        reflectance: of the white reference; 0.99 where it is not given.
        white_table: CSV file theta_i_deg[,theta_o_deg],correction: BRDF of the reference over a Lambertian one.
        white_readings: CSV file as ``data``: readings of the reference, where values are not divided yet.

    Raises:
        UsageError: a file that cannot be used, or a reference beside values that are the BRDF.
    """
    white = White(
        SPECTRALON if reflectance is None else reflectance,
        None if white_table is None else read_correction(Path(white_table)),
        None if white_readings is None else read_goniometer(Path(white_readings)),
    )
    return to_brdf(read_goniometer(Path(data)), values, white)


def fit_ink(
    data: Path | str,
    method: Method = "joint",
    values: Values = "factor",
    *,
    reflectance: float | None = None,
    white_table: Path | str | None = None,
    white_readings: Path | str | None = None,
    u_reading: float | None = None,
    floor: float | None = None,
) -> InkFit:
    """Roughness, reflectance and goniochromatism of an ink from goniometer readings.

    Args:
        data: as for ``read_brdf``, and so are ``values``, ``reflectance``, ``white_table`` and ``white_readings``.
        method: all parameters at once, or the published two steps.
        values: what the values of the file are.
        reflectance: of the white reference.
        white_table: its correction.
        white_readings: its readings.
        u_reading: relative standard uncertainty of a reading, by which the model is tested; 3 % for the weights where
            it is not given.
        floor: noise floor in 1/sr; readings up to 3 times as large are dropped.

    Raises:
        UsageError: as ``read_brdf``, or readings that do not determine the parameters.
    """
    readings = read_brdf(
        data, values, reflectance=reflectance, white_table=white_table, white_readings=white_readings
    )
    return fit(readings, method, noise=u_reading, floor=floor)


def calibrate_ink(folders: Sequence[Path | str], name: str) -> RigInk:
    """Ink of good prints, from their inspections on a rig; the recipe's ink does not matter.

    Args:
        folders: finished inspections of prints of the same ink, poses, lamp and camera; their mean counts.
        name: of the ink.

    Raises:
        UsageError: no folder, too few poses, or prints that were not photographed alike.
        CalibrationError: an inspection of something else, or of a sheet without ink.
        MeasurementError: the width of the lobe is not determined.
        RecordError: a folder holds no finished inspection, or no copies of its files.
    """
    found, kinds = [], []
    for folder in map(Path, folders):
        record, (_, job) = read_record(folder), reopen(folder)
        if not isinstance(job.kind, Inked):
            raise CalibrationError(f"{folder}: an inspection of {job.kind.one}, which has no ink")
        kinds.append(job.kind)
        found.append((str(folder), record, job.recipe, job.rig))
    if not kinds:
        raise UsageError("name the folders of one or more finished inspections of good prints")
    return kinds[0].ink_of(found, name)


@dataclass(frozen=True, eq=False)
class InkComparison:
    """Models of inks against pictures from readings.

    Attributes:
        synthetic: the readings are made up: they show that the comparison works, and nothing about real inks.
        inks: one an ink.
        warnings: of the fits to readings.
    """

    synthetic: bool
    inks: tuple[Comparison, ...]
    warnings: tuple[str, ...]

    @property
    @in_json()
    def convention(self) -> str:
        """Colour space, exposure, mask and window."""
        return CONVENTION

    def write_picture(self, path: Path | str) -> None:
        """Write the spheres as PNG: a row an ink; readings, then the models.

        Raises:
            RecordError: the file cannot be written.
        """
        rows = [np.concatenate([one.reference, *(row.srgb for row in one.rows)], axis=1) for one in self.inks]
        write_bytes(Path(path), picture_png(np.rint(255.0 * np.concatenate(rows)).astype(np.uint8)))


def compare_inks(
    data: Sequence[Path | str] = (),
    values: Values = "factor",
    *,
    reflectance: float | None = None,
    alpha: float | None = None,
    illuminant: str = "d65",
    size: int = 512,
    seed: int = 1,
    on_progress: Advance = silent,
) -> InkComparison:
    """Compare spheres shown by the models with ones made from readings: RMSE, SSIM and time of a frame.

    Args:
        data: files as for ``read_brdf``, one an ink, each of which is fitted first; without any, made-up readings of
            the synthetic inks.
        values: what the values of the files are.
        reflectance: of the white reference.
        alpha: roughness to show the models with, in place of the fitted one.
        illuminant: name or CSV file of the light.
        size: side of the pictures in pixels, 32 or more.
        seed: of the noise of made-up readings.
        on_progress: called with the ink, inks done and inks in all.

    Raises:
        UsageError: a file that cannot be used, or readings that do not determine the parameters.
        ModelError: a size below 32.
    """
    lamp, found, warnings = find_illuminant(illuminant), [], []
    sets = [(Path(one).stem, *_read(Path(one), values, reflectance)) for one in data] or _synthetic(seed)
    for done, (name, read, measured) in enumerate(sets):
        on_progress(name, done, len(sets))
        fitted = fit(read)
        if data:  # made-up readings have on purpose what the fit would warn of
            warnings += [f"{name}: {warning}" for warning in fitted.warnings]
        ink = fitted.ink(name, "fitted to the readings")
        # A given roughness replaces the fitted one only in the models, not in the readings they are compared with.
        ink = ink if alpha is None else replace(ink, alpha=alpha)
        found.append(compare(measured, ink, illuminant=lamp, size=size))
    return InkComparison(not data, tuple(found), tuple(warnings))


def _read(path: Path, values: Values, reflectance: float | None) -> tuple[Readings, Measured]:
    read = read_brdf(path, values, reflectance=reflectance)
    try:
        return read, _by_place(read, path)
    except ModelError as problem:
        raise UsageError(f"{path}: {problem}") from None


def _by_place(read: Readings, path: Path) -> Measured:
    """Readings as places × wavelengths; a place that was read twice is averaged."""
    angles, place = np.unique(
        np.stack([read.theta_i_deg, read.theta_o_deg], axis=-1), axis=0, return_inverse=True
    )
    nm, column = np.unique(read.wavelength_nm, return_inverse=True)
    total, count = np.zeros((len(angles), len(nm))), np.zeros((len(angles), len(nm)))
    np.add.at(total, (place.ravel(), column), read.value)
    np.add.at(count, (place.ravel(), column), 1.0)
    if not count.all():
        at, band = np.argwhere(count == 0.0)[0]
        raise UsageError(
            f"{path}: no reading at θi {angles[at, 0]:g}°, θo {angles[at, 1]:g}°, {nm[band]:g} nm: "
            "pictures need every wavelength at every place"
        )
    return Measured(angles[:, 0], angles[:, 1], nm, total / count)


def _synthetic(seed: int) -> list[tuple[str, Readings, Measured]]:
    found = []
    for name, rng in zip(SYNTHETIC, np.random.default_rng(seed).spawn(len(SYNTHETIC)), strict=True):
        measured = synthetic_readings(synthetic_ink(name), rng)
        places, bands = measured.value.shape
        read = Readings(
            np.repeat(measured.theta_i_deg, bands),
            np.repeat(measured.theta_o_deg, bands),
            np.tile(measured.wavelengths_nm, places),
            measured.value.ravel(),
            tuple(range(measured.value.size)),
        )
        found.append((name, read, measured))
    return found
