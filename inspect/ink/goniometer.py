"""Readings of an in-plane goniometer, brought to the BRDF by a white reference."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.csv_table import Table, read_table
from anisoscope.base.errors import UsageError
from anisoscope.sim.light.ink.ink import SPECTRALON

Values = Literal["factor", "brdf"]

COLUMNS = ("theta_i_deg", "theta_o_deg", "wavelength_nm", "value")
BY_BOTH = ("theta_i_deg", "theta_o_deg", "correction")
BY_LIGHT = ("theta_i_deg", "correction")


@dataclass(frozen=True, eq=False)
class Readings:
    """Goniometer readings of one sample, N rows.

    Attributes:
        theta_i_deg: (N,) inclination of the light.
        theta_o_deg: (N,) inclination of the detector: positive away from the light, where θo = θi is the mirror
            direction; negative on the light's side.
        wavelength_nm: (N,).
        value: (N,) BRDF in 1/sr, noise and all: it may be 0 or negative.
        lines: (N,) lines of the file, for messages.
        scale: how the values became a BRDF, in words.
    """

    theta_i_deg: FloatArray
    theta_o_deg: FloatArray
    wavelength_nm: FloatArray
    value: FloatArray
    lines: tuple[int, ...]
    scale: str = "values are the BRDF in 1/sr"


def read_goniometer(path: Path) -> Readings:
    """Read ``theta_i_deg,theta_o_deg,wavelength_nm,value``; the values are not scaled.

    Raises:
        UsageError: a line of the file cannot be used.
    """
    table = read_table(path, (COLUMNS,), not_negative=("theta_i_deg",), above_zero=("wavelength_nm",))
    for name in COLUMNS[:2]:
        steep = np.abs(table.column(name)) >= 90.0
        if steep.any():
            row = int(np.argmax(steep))
            raise UsageError(
                f"{table.place(row)}: {name} must lie below 90°, not at {table.column(name)[row]:g}°"
            )
    if table.column("wavelength_nm").max() < 20.0:
        raise UsageError(f"{table.place(0)}: wavelength_nm looks like µm: write nm, 1000 times larger")
    theta_i, theta_o, nm, value = (table.column(name) for name in COLUMNS)
    return Readings(theta_i, theta_o, nm, value, table.lines)


@dataclass(frozen=True, eq=False)
class White:
    """The white reference.

    Attributes:
        reflectance: of the reference, 0.99 for the paper's Spectralon.
        correction: table of its BRDF over that of a Lambertian surface; a pressed white is not Lambertian near the
            mirror direction at large angles.
        readings: of the reference itself, at the places of the sample's, where the values are not divided yet; a place
            that was read more than once counts with its mean.
    """

    reflectance: float = SPECTRALON
    correction: Table | None = None
    readings: Readings | None = None


def read_correction(path: Path) -> Table:
    """Read ``theta_i_deg,theta_o_deg,correction`` (a full grid) or ``theta_i_deg,correction``.

    Raises:
        UsageError: a line of the file cannot be used, or the grid has holes.
    """
    table = read_table(path, (BY_BOTH, BY_LIGHT), above_zero=("correction",), what="corrections")
    if table.columns == BY_LIGHT:
        places = len(np.unique(table.column("theta_i_deg")))
    else:
        places = len(np.unique(table.column("theta_i_deg"))) * len(np.unique(table.column("theta_o_deg")))
        distinct = len(np.unique(table.rows[:, :2], axis=0))
        if distinct != places:
            raise UsageError(f"{path}: {distinct} of the {places} pairs of angles are given: fill the grid")
    if len(table.rows) != places:
        raise UsageError(f"{path}: {len(table.rows)} rows for {places} places: one is given twice")
    return table


def to_brdf(readings: Readings, values: Values, white: White) -> Readings:
    """Readings as a BRDF in 1/sr: white reflectance/π · correction · factor.

    Args:
        readings: as read.
        values: "brdf": they already are; "factor": they are ratios to the white reference.
        white: the reference; its own readings turn counts into ratios.

    Raises:
        UsageError: options that exclude each other, or a place where the reference is not known.
    """
    if values == "brdf":
        if white.correction is not None or white.readings is not None:
            raise UsageError(
                "values that are a BRDF need no white reference: leave it out, or say --values factor"
            )
        return readings
    if not 0.0 < white.reflectance <= 1.1:
        raise UsageError(
            f"the reflectance of the white reference lies in 0 to 1.1, not at {white.reflectance:g}"
        )
    factor, words = readings.value, "values are ratios to the white reference"
    if white.readings is not None:
        factor, words = (
            factor / _white_at(readings, white.readings),
            "values were divided by those of the white reference",
        )
    scale = np.full(len(factor), white.reflectance / np.pi)
    words += f"; BRDF = {white.reflectance:g}/π × ratio"
    if white.correction is not None:
        scale = scale * _correction_at(readings, white.correction)
        words += f" × correction of {white.correction.path.name}"
    return replace(readings, value=factor * scale, scale=words)


def _white_at(readings: Readings, white: Readings) -> FloatArray:
    at = np.stack([white.theta_i_deg, white.theta_o_deg, white.wavelength_nm], axis=-1)
    once, number = np.unique(at, axis=0, return_inverse=True)
    means = np.bincount(number.ravel(), white.value) / np.bincount(number.ravel())
    known = dict(zip(map(tuple, once.tolist()), means.tolist(), strict=True))
    found = np.empty(len(readings.value))
    places = zip(readings.theta_i_deg, readings.theta_o_deg, readings.wavelength_nm, strict=True)
    for row, place in enumerate(places):
        value = known.get(place)
        if value is None or value <= 0.0:
            what = "has no reading" if value is None else f"reads {value:g}"
            raise UsageError(
                f"line {readings.lines[row]}: the white reference {what} at θi {place[0]:g}°, θo {place[1]:g}°, "
                f"{place[2]:g} nm: measure it there"
            )
        found[row] = value
    return found


def _correction_at(readings: Readings, table: Table) -> FloatArray:
    i, o = readings.theta_i_deg, readings.theta_o_deg
    knots_i = np.unique(table.column("theta_i_deg"))
    _inside(readings, i, knots_i, "θi", table)
    if table.columns == BY_LIGHT:
        order = np.argsort(table.column("theta_i_deg"))
        return np.interp(i, knots_i, table.column("correction")[order])
    knots_o = np.unique(table.column("theta_o_deg"))
    _inside(readings, o, knots_o, "θo", table)
    grid = np.empty((len(knots_i), len(knots_o)))
    at = (
        np.searchsorted(knots_i, table.column("theta_i_deg")),
        np.searchsorted(knots_o, table.column("theta_o_deg")),
    )
    grid[at] = table.column("correction")
    rows = np.stack([np.interp(o, knots_o, line) for line in grid])
    return np.array([np.interp(angle, knots_i, rows[:, n]) for n, angle in enumerate(i)])


def _inside(readings: Readings, angles: FloatArray, knots: FloatArray, name: str, table: Table) -> None:
    outside = (angles < knots[0]) | (angles > knots[-1])
    if outside.any():
        row = int(np.argmax(outside))
        raise UsageError(
            f"{table.path}: the correction is known for {name} from {knots[0]:g}° to {knots[-1]:g}°, and needed at "
            f"{angles[row]:g}° (line {readings.lines[row]} of the readings)"
        )
