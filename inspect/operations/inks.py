"""Inks fitted to goniometer readings or to prints on a rig, and models of an ink against pictures from readings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import CalibrationError, ModelError, UsageError
from anisoscope.base.json_fields import in_json
from anisoscope.base.progress import Advance, silent
from anisoscope.ink.fitting import InkFit, RigInk, fit
from anisoscope.ink.goniometer import Readings, White, read_correction, read_goniometer, to_brdf
from anisoscope.inspection.manifest import reopen
from anisoscope.kinds.parts import Inked
from anisoscope.parameters.ink import InkFitting, InkReadings, InkSpheres
from anisoscope.parameters.keywords import by_keywords
from anisoscope.record.schema import read_record
from anisoscope.sim.light.ink.ink import SPECTRALON
from anisoscope.sim.materials.inks import SYNTHETIC, synthetic_ink
from anisoscope.sim.materials.spectra import find_illuminant
from anisoscope.sim.proof.comparison import CONVENTION, Comparison, compare, synthetic_readings
from anisoscope.sim.proof.imagefile import picture_png
from anisoscope.sim.proof.measured import Measured


def read_brdf(
    data: Path | str, how: InkReadings, table: Path | None = None, readings: Path | None = None
) -> Readings:
    """Goniometer readings of an ink as a BRDF in 1/sr.

    Args:
        data: CSV file theta_i_deg,theta_o_deg,wavelength_nm,value; θo counts away from the light.
        how: meaning of the values.
        table: CSV file theta_i_deg[,theta_o_deg],correction: BRDF of the reference over a Lambertian one.
        readings: CSV file as ``data``: readings of the reference, where values are not divided yet.

    Raises:
        UsageError: a file that cannot be used, or a reference beside values that are the BRDF.
    """
    white = White(
        SPECTRALON if how.reflectance is None else how.reflectance,
        None if table is None else read_correction(table),
        None if readings is None else read_goniometer(readings),
    )
    return to_brdf(read_goniometer(Path(data)), how.values, white)


@by_keywords(fitting=InkFitting)
def fit_ink(data: Path | str, *, fitting: InkFitting) -> InkFit:
    """Roughness, reflectance and goniochromatism of an ink from goniometer readings.

    Args:
        data: as for ``read_brdf``.
        fitting: meaning of the readings and method of the fit, or the fields as keywords.

    Raises:
        UsageError: as ``read_brdf``, or readings that do not determine the parameters.
    """
    readings = read_brdf(data, fitting, fitting.white_table, fitting.white_readings)
    try:
        return fit(readings, fitting.method, noise=fitting.u_reading, floor=fitting.floor)
    except UsageError as problem:
        raise UsageError(f"{data}: {problem}") from None


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


@by_keywords(how=InkReadings, spheres=InkSpheres)
def compare_inks(
    data: Sequence[Path | str] = (),
    *,
    how: InkReadings,
    spheres: InkSpheres,
    on_progress: Advance = silent,
) -> InkComparison:
    """Compare spheres shown by the models with ones made from readings: RMSE, SSIM and time of a frame.

    Args:
        data: files as for ``read_brdf``, one an ink, each of which is fitted first; without any, made-up readings of
            the synthetic inks.
        how: meaning of the readings, or its fields as keywords.
        spheres: roughness, light and pictures, or its fields as keywords.
        on_progress: called with the ink, inks done and inks in all.

    Raises:
        UsageError: a file that cannot be used, or readings that do not determine the parameters.
        ModelError: a size below 32.
    """
    lamp, found, warnings = find_illuminant(spheres.illuminant), [], []
    sets = [(Path(one).stem, *_read(Path(one), how)) for one in data] or _synthetic(spheres.seed)
    for done, (name, read, measured) in enumerate(sets):
        on_progress(name, done, len(sets))
        try:
            fitted = fit(read)
            ink = fitted.ink(name, "fitted to the readings")
        except (UsageError, ModelError) as problem:
            raise UsageError(f"{data[done] if data else name}: {problem}") from None
        if data:  # made-up readings have on purpose what the fit would warn of
            warnings += [f"{name}: {warning}" for warning in fitted.warnings]
        # A given roughness replaces the fitted one only in the models, not in the readings they are compared with.
        ink = ink if spheres.alpha is None else replace(ink, alpha=spheres.alpha)
        found.append(compare(measured, ink, illuminant=lamp, size=spheres.size))
    return InkComparison(not data, tuple(found), tuple(warnings))


def _read(path: Path, how: InkReadings) -> tuple[Readings, Measured]:
    read = read_brdf(path, how)
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
