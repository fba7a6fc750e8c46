"""Measured BRDF table: reading, residuals against the models, and reciprocity.

Angles are those of the sample frame: θ from +z, φ from +x counter-clockwise; ridges run along +y and the facets lean
toward +x. The models give radiance per unit irradiance perpendicular to the beam; the BRDF is that over cos θi.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.csv_table import Table, read_table
from anisoscope.base.errors import UsageError
from anisoscope.fit.problem import Readings
from anisoscope.fit.table import UNKNOWN, uncorrelated

COLUMNS = ("theta_i_deg", "phi_i_deg", "theta_o_deg", "phi_o_deg", "value")
STEEPEST_DEG = 89.0
_SAME = 1e-6


@dataclass(frozen=True, eq=False)
class BrdfTable:
    """N rows of a measured BRDF.

    Attributes:
        angles_deg: (N, 4) θi, φi, θo, φo.
        to_light: (N, 3) unit vectors in the sample frame.
        to_camera: (N, 3).
        readings: values in 1/sr with their covariance.
        lines: N line numbers in the file.
        wavelength_nm: of the rows, or None where the file has no such column.
    """

    angles_deg: FloatArray
    to_light: FloatArray
    to_camera: FloatArray
    readings: Readings
    lines: tuple[int, ...]
    wavelength_nm: float | None


@dataclass(frozen=True)
class Reciprocity:
    """Rows that a table holds in both directions.

    Attributes:
        pairs: how many.
        rms_share: rms difference of the two values of a pair, as a share of their mean; None without pairs.
        worst_share: largest of them.
        worst_lines: the two lines of that pair.
    """

    pairs: int
    rms_share: float | None
    worst_share: float | None
    worst_lines: tuple[int, int] | None


def unit_vectors(theta_deg: FloatArray, phi_deg: FloatArray) -> FloatArray:
    """(N, 3) unit vectors of polar angles in the sample frame."""
    theta, phi = np.radians(theta_deg), np.radians(phi_deg)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def read_brdf(path: Path, wavelength_nm: float | None = None) -> BrdfTable:
    """Read ``theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,value[,u][,wavelength_nm]``, values in 1/sr.

    Args:
        path: the CSV file.
        wavelength_nm: which rows are taken, where the file has several wavelengths.

    Raises:
        UsageError: the file cannot be read or used.
    """
    table = read_table(path, (COLUMNS,), ("u", "wavelength_nm"), above_zero=("u",))
    for name in ("theta_i_deg", "theta_o_deg"):
        bad = (table.column(name) < 0.0) | (table.column(name) > STEEPEST_DEG)
        if bad.any():
            row = int(np.argmax(bad))
            raise UsageError(
                f"{table.place(row)}: {name} must lie between 0 and {STEEPEST_DEG:g}, not "
                f"{table.column(name)[row]:g}"
            )
    table, wavelength = _one_wavelength(table, wavelength_nm)
    angles = table.rows[:, :4]
    light, camera = unit_vectors(angles[:, 0], angles[:, 1]), unit_vectors(angles[:, 2], angles[:, 3])
    covariance, known = uncorrelated(table)
    index = np.arange(len(angles))
    words = "rows independent, uncertainties as given" if known else f"{UNKNOWN}, equal for all rows"
    labels = tuple(f"{a:g}°, {b:g}° → {c:g}°, {d:g}°" for a, b, c, d in angles)
    readings = Readings(
        "brdf", index, index, table.column("value"), covariance, known, labels, words, 1.0 / light[:, 2]
    )
    return BrdfTable(angles, light, camera, readings, table.lines, wavelength)


def _one_wavelength(table: Table, wavelength_nm: float | None) -> tuple[Table, float | None]:
    if "wavelength_nm" not in table.columns:
        if wavelength_nm is not None:
            raise UsageError(f"{table.path} has no column wavelength_nm: leave --wavelength out")
        return table, None
    column = table.column("wavelength_nm")
    known = np.unique(column)
    if wavelength_nm is None and known.size > 1:
        some = ", ".join(f"{value:g}" for value in known[:8]) + (" …" if known.size > 8 else "")
        raise UsageError(
            f"{table.path} holds {known.size} wavelengths ({some} nm): choose one with --wavelength"
        )
    chosen = float(known[0]) if wavelength_nm is None else wavelength_nm
    rows = np.flatnonzero(np.isclose(column, chosen))
    if rows.size == 0:
        some = ", ".join(f"{value:g}" for value in known[:8])
        raise UsageError(f"{table.path} has no rows at {chosen:g} nm; it holds {some} nm")
    return Table(table.columns, table.rows[rows], tuple(table.lines[i] for i in rows), table.path), chosen


def reciprocity(table: BrdfTable) -> Reciprocity:
    """How well rows measured in both directions agree (Helmholtz reciprocity: f(i, o) = f(o, i))."""
    forward = np.hstack([table.to_light, table.to_camera])
    backward = np.hstack([table.to_camera, table.to_light])
    keys = {tuple(np.round(row / _SAME).astype(int).tolist()): number for number, row in enumerate(forward)}
    value = table.readings.value
    found: list[tuple[float, tuple[int, int]]] = []
    for number, row in enumerate(backward):
        other = keys.get(tuple(np.round(row / _SAME).astype(int).tolist()))
        if other is None or other <= number:
            continue
        mean = 0.5 * (value[number] + value[other])
        share = float((value[number] - value[other]) / mean) if mean else 0.0
        found.append((share, (table.lines[number], table.lines[other])))
    if not found:
        return Reciprocity(0, None, None, None)
    worst, lines = max(found, key=lambda pair: abs(pair[0]))
    rms = float(np.sqrt(np.mean([share**2 for share, _ in found])))
    return Reciprocity(len(found), rms, abs(worst), lines)
