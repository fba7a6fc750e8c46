"""Data for a fit: exposures, contrasts and BRDF tables from CSV files, and the published experiment."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.csv_style import CsvReader
from anisoscope.base.csv_table import Table, read_table, read_text
from anisoscope.base.errors import UsageError
from anisoscope.base.notation import contrast_name
from anisoscope.bsdf.directions_table import COLUMNS, STEEPEST_DEG, sampled
from anisoscope.bsdf.formats import is_reflectance_file, read_reflectance
from anisoscope.experiment.experiment import PAIRS_DEG, RIDGE_ANGLES_DEG, STAGE_DEG, TILTS_DEG, combinations
from anisoscope.fit.problem import RATIOS, Kind, Problem, Readings, Scene
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.sim.light.contrasts import consecutive_pairs
from anisoscope.sim.light.geometry import directions, pose_grid

Errors = Literal["shared", "independent"]

EXPOSURES = ("stage_deg", "tilt_deg", "value")
CONTRASTS = ("from_deg", "to_deg", "tilt_deg", "value")
UNKNOWN = "no uncertainties were given: the scatter is estimated from the residuals"


def uncorrelated(table: Table) -> tuple[FloatArray, bool]:
    """(N, N) diagonal covariance of the values, and whether it was given; else all scatter alike."""
    value = table.column("value")
    if "u" in table.columns:
        return np.diag(table.column("u") ** 2), True
    scale = float(np.mean(value**2)) or 1.0
    return scale * np.eye(len(value)), False


def read_readings(
    path: Path, kind: Kind | None, errors: Errors = "shared", covariance: Path | None = None
) -> tuple[tuple[Pose, ...], Readings]:
    """Poses and readings of a table of exposures or of contrasts, identified by its header.

    Args:
        path: ``stage_deg,tilt_deg,value[,u]`` or ``from_deg,to_deg,tilt_deg,value[,u]``.
        kind: of contrasts: what they are. Of exposures: None fits them as they are; a kind of contrast fits the
            contrasts of consecutive lines that share a tilt, with the covariance that their common poses give.
        errors: of contrasts with or without u: "shared": two contrasts that share a photograph are correlated, each
            photograph carrying half of the variance of a contrast; "independent": they are not.
        covariance: CSV file without header, N lines of N numbers, in place of u and `errors`.

    Raises:
        UsageError: a file that cannot be read or used.
    """
    table = read_table(path, (EXPOSURES, CONTRASTS), ("u",), above_zero=("u",))
    given = None if covariance is None else _read_covariance(covariance, len(table.rows))
    if table.columns[:3] == EXPOSURES:
        return _exposures(table, kind, given)
    if kind not in ("difference", "michelson", "log_ratio"):
        raise UsageError(
            f"{path} holds contrasts: say which with --quantity difference, michelson or log_ratio"
        )
    return _contrasts(table, kind, errors, given)


def _read_covariance(path: Path, size: int) -> FloatArray:
    try:
        reader = CsvReader(read_text(path), path)
        found = np.array([[float(reader.with_point(x)) for x in row] for row in reader if row])
    except ValueError:
        raise UsageError(f"{path}: {size} lines of {size} numbers expected") from None
    if found.shape != (size, size) or not np.isfinite(found).all():
        raise UsageError(f"{path}: {size} lines of {size} finite numbers expected, as many as values")
    least = float(np.linalg.eigvalsh(found)[0])
    if not np.allclose(found, found.T) or np.any(np.diag(found) <= 0) or least < -1e-9 * np.trace(found):
        raise UsageError(
            f"{path}: no covariance: it must be symmetric, positive on its diagonal, and not negative"
        )
    return found


def _exposures(
    table: Table, kind: Kind | None, given: FloatArray | None
) -> tuple[tuple[Pose, ...], Readings]:
    poses = tuple(
        Pose(float(s), float(t))
        for s, t in zip(table.column("stage_deg"), table.column("tilt_deg"), strict=True)
    )
    value = table.column("value")
    matrix, known = uncorrelated(table) if given is None else (given, True)
    if kind is None or kind == "exposure":
        labels = tuple(f"{pose.stage_deg:g}° @ {pose.tilt_deg:g}°" for pose in poses)
        words = "exposures with uncertainties as given" if known else UNKNOWN + ", equal for all exposures"
        index = np.arange(len(poses))
        return poses, Readings("exposure", index, index, value, matrix, known, labels, words)
    pairs = consecutive_pairs(poses)
    if not pairs:
        raise UsageError(f"{table.path}: no two consecutive lines share a tilt: there is no contrast to fit")
    if kind in RATIOS and np.any(value <= 0):
        row = int(np.argmax(value <= 0))
        raise UsageError(f"{table.place(row)}: the ratio of an exposure of {value[row]:g} is not defined")
    first, second = (np.array(index) for index in zip(*pairs, strict=True))
    shell = Readings(kind, first, second, np.zeros(len(pairs)), np.eye(len(pairs)), known, (), "")
    slopes = (
        shell.by_log_radiance(value, 1.0) / value if kind in RATIOS else _incidence(first, second, len(value))
    )
    words = "covariance of contrasts that share a photograph built from the exposures"
    return poses, Readings(
        shell.kind,
        first,
        second,
        shell.predicted(value, 1.0),
        slopes @ matrix @ slopes.T,
        known,
        tuple(_pair_label(poses[i], poses[j]) for i, j in pairs),
        words if known else f"{UNKNOWN}; {words}, all alike",
    )


def _incidence(first: npt.NDArray[np.intp], second: npt.NDArray[np.intp], size: int) -> FloatArray:
    found = np.zeros((len(first), size))
    rows = np.arange(len(first))
    found[rows, first] += 1.0
    found[rows, second] -= 1.0
    return found


def _pair_label(first: Pose, second: Pose) -> str:
    return contrast_name(first.stage_deg, second.stage_deg, first.tilt_deg)


def _contrasts(
    table: Table, kind: Kind, errors: Errors, given: FloatArray | None
) -> tuple[tuple[Pose, ...], Readings]:
    poses: dict[Pose, int] = {}
    pairs_read: set[tuple[Pose, Pose]] = set()
    pairs = []
    for row, (start, end, tilt) in enumerate(table.rows[:, :3]):
        pair = Pose(float(start), float(tilt)), Pose(float(end), float(tilt))
        if start == end:
            raise UsageError(f"{table.place(row)}: a contrast of {start:g}° with itself")
        # A repeated pair shares both photographs, which makes the covariance below singular.
        if pair in pairs_read and errors == "shared" and given is None:
            raise UsageError(
                f"{table.place(row)}: this pair is given twice: --errors independent takes it for new photographs"
            )
        pairs_read.add(pair)
        pairs.append(tuple(poses.setdefault(pose, len(poses)) for pose in pair))
    value = table.column("value")
    if kind == "michelson" and np.any(np.abs(value) >= 1.0):
        row = int(np.argmax(np.abs(value) >= 1.0))
        raise UsageError(
            f"{table.place(row)}: a Michelson contrast lies between -1 and 1, not {value[row]:g}"
        )
    first, second = (np.array(index) for index in zip(*pairs, strict=True))
    matrix, known = uncorrelated(table) if given is None else (given, True)
    words = "covariance as given" if given is not None else "contrasts taken as independent"
    if given is None and errors == "shared":
        matrix = matrix_of_shared(matrix, first, second)
        words = (
            "contrasts that share a photograph taken as correlated, half of the variance from each photograph"
        )
    if not known:
        words = f"{UNKNOWN}, equal for all contrasts; {words}"
    places = tuple(poses)
    labels = tuple(_pair_label(places[i], places[j]) for i, j in pairs)
    return places, Readings(kind, first, second, value, matrix, known, labels, words)


def matrix_of_shared(
    diagonal: FloatArray, first: npt.NDArray[np.intp], second: npt.NDArray[np.intp]
) -> FloatArray:
    """(N, N) covariance of contrasts whose photographs carry half of the variance each."""
    size = int(max(first.max(), second.max())) + 1
    spread = np.sqrt(np.diag(diagonal) / 2.0)[:, None] * _incidence(first, second, size)
    return np.asarray(spread @ spread.T)


def experiment_problem(
    measured: FloatArray,
    convention: Convention,
    optics: Mapping[str, Any],
    values: Mapping[str, float],
    free: tuple[str, ...],
) -> Problem:
    """A problem from measured absolute contrasts.

    Args:
        measured: (ridge angle, tilt, pair) contrasts, NaN where not measured (`experiment.read_measured`).
        convention: how the angles are counted.
        optics: keywords of `Scene`: model, bounces (1 by default, as `experiment.Setup` predicts), design,
            material.
        values: all parameters.
        free: the free ones.

    Raises:
        UsageError: a parameter cannot be free, or too few contrasts are given.
    """
    grid = pose_grid(STAGE_DEG, TILTS_DEG)
    poses = grid * len(RIDGE_ANGLES_DEG)
    to_light, to_camera = directions(poses, convention)
    angles = np.repeat(RIDGE_ANGLES_DEG, len(grid))
    light = {"bounces": 1} | dict(optics)
    scene = Scene(to_light, to_camera, ridge_angles_deg=angles, poses=poses, convention=convention, **light)
    first, labels, value = [], [], []
    for (a, t, p), (angle, tilt, start, end) in combinations():
        if np.isfinite(measured[a, t, p]):
            first.append((a * len(TILTS_DEG) + t) * len(STAGE_DEG) + STAGE_DEG.index(PAIRS_DEG[p][0]))
            labels.append(f"{angle:g}°: {contrast_name(start, end, tilt)}")
            value.append(measured[a, t, p])
    index, contrast = np.array(first), np.array(value)
    scale = float(np.mean(contrast**2)) or 1.0
    words = f"{UNKNOWN}, equal for all contrasts and independent"
    readings = Readings(
        "absolute", index, index + 1, contrast, scale * np.eye(index.size), False, tuple(labels), words
    )
    return Problem(scene, readings, values, free)


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
        p_value: probability of such differences or larger ones by the stated uncertainties alone; None without them.
        negative: number of rows with a negative value.
        negative_p_value: probability of such values or lower ones by the stated uncertainties alone, of surfaces that
            reflect nothing there; None without them, or without negative rows.
        largest_k: largest difference of a pair over its stated uncertainty; None without them.
    """

    pairs: int
    rms_share: float | None
    worst_share: float | None
    worst_lines: tuple[int, int] | None
    p_value: float | None = None
    negative: int = 0
    negative_p_value: float | None = None
    largest_k: float | None = None


def unit_vectors(theta_deg: FloatArray, phi_deg: FloatArray) -> FloatArray:
    """(N, 3) unit vectors of polar angles in the sample frame."""
    theta, phi = np.radians(theta_deg), np.radians(phi_deg)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def read_brdf(path: Path, wavelength_nm: float | None = None) -> BrdfTable:
    """Read ``theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,value[,u][,wavelength_nm]``, values in 1/sr.

    Args:
        path: the CSV file, or a gridded file of `bsdf.formats`, which is sampled (`bsdf.directions_table.sampled`).
        wavelength_nm: which rows are taken, where the file has several wavelengths.

    Raises:
        UsageError: the file cannot be read or used.
    """
    if is_reflectance_file(path):
        grid = sampled(read_reflectance(path))
        table = Table(grid.columns, grid.rows, tuple(range(2, 2 + len(grid.rows))), path)
    else:
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
    """Agreement of rows measured in both directions (Helmholtz reciprocity: f(i, o) = f(o, i))."""
    forward = np.hstack([table.to_light, table.to_camera])
    backward = np.hstack([table.to_camera, table.to_light])
    keys = {tuple(np.round(row / _SAME).astype(int).tolist()): number for number, row in enumerate(forward)}
    value = table.readings.value
    u = np.sqrt(np.diag(table.readings.covariance)) if table.readings.noise_known else None
    found: list[tuple[float, tuple[int, int]]] = []
    z = []
    for number, row in enumerate(backward):
        other = keys.get(tuple(np.round(row / _SAME).astype(int).tolist()))
        if other is None or other <= number:
            continue
        mean = 0.5 * (value[number] + value[other])
        share = float((value[number] - value[other]) / mean) if mean else 0.0
        found.append((share, (table.lines[number], table.lines[other])))
        if u is not None:
            z.append(float((value[number] - value[other]) / np.hypot(u[number], u[other])))
    below = value < 0.0
    low = None if u is None else _p_value(value[below] / u[below])
    if not found:
        return Reciprocity(0, None, None, None, None, int(below.sum()), low)
    worst, lines = max(found, key=lambda pair: abs(pair[0]))
    rms = float(np.sqrt(np.mean([share**2 for share, _ in found])))
    largest = float(np.abs(z).max()) if z else None
    return Reciprocity(
        len(found), rms, abs(worst), lines, _p_value(np.array(z)), int(below.sum()), low, largest
    )


def _p_value(z: FloatArray) -> float | None:
    """Probability of a sum of squares as large as that of standard normal deviates; None of none."""
    from scipy.stats import chi2  # noqa: PLC0415 - slow to import

    return float(chi2.sf(float(np.sum(z**2)), z.size)) if z.size else None
