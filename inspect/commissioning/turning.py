"""Sense and zero of the stage, rotation centre and zero of the tilt axis from angles measured at many readings."""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError
from anisoscope.commissioning.markers import Fix


@dataclass(frozen=True)
class Turning:
    """Rotation of the sample with the reading: ψ = sense·(reading − zero), ψ counter-clockwise as the camera sees it.

    Attributes:
        sense: 1 where a growing reading turns the sample counter-clockwise, −1 clockwise.
        zero_deg: reading at ψ = 0.
        u_zero_deg: its standard uncertainty.
        period_deg: 360, or 180 where ψ is that of a line and the zero known but for half turns.
        slope: change of ψ per degree of reading, unwrapped: ±1 for a stage that counts true.
        u_slope: its standard uncertainty.
        residual_deg: rms of ψ about the relation.
        other_deg: the same for the other sense; infinite where the angles cannot tell.
        residuals_deg: of every picture.
    """

    sense: int
    zero_deg: float
    u_zero_deg: float
    period_deg: float
    slope: float
    u_slope: float
    residual_deg: float
    other_deg: float
    residuals_deg: tuple[float, ...]


def wrapped(angle_deg: FloatArray | float, period_deg: float = 360.0) -> FloatArray:
    """Angles in (−period/2, period/2]."""
    half = period_deg / 2.0
    return half - np.mod(half - np.asarray(angle_deg, dtype=np.float64), period_deg)


def circular_mean(angle_deg: FloatArray, period_deg: float = 360.0) -> float:
    """Mean of angles that are alike but for whole periods."""
    turn = 2.0 * np.pi / period_deg
    return float(np.angle(np.mean(np.exp(1j * turn * np.asarray(angle_deg)))) / turn)


def fit_turning(
    reading_deg: FloatArray, angle_deg: FloatArray, period_deg: float = 360.0, *, floor_deg: float = 0.002
) -> Turning:
    """Sense and zero of a stage from the angles measured at its readings.

    Args:
        reading_deg: (N,) readings.
        angle_deg: (N,) angles ψ seen, known but for whole periods.
        period_deg: 360 for markers, 180 for the direction of lines.
        floor_deg: scatter that is assumed at least.

    Raises:
        MeasurementError: the angles follow neither sense.
    """
    trials = []
    for sense in (1, -1):
        zero = circular_mean(reading_deg - sense * angle_deg, period_deg)
        rest = wrapped(angle_deg - sense * (reading_deg - zero), period_deg)
        trials.append((float(np.sqrt(np.mean(rest**2))), sense, zero, rest))
    (rms, sense, zero, rest), (other, *_) = sorted(trials, key=lambda trial: trial[0])
    if rms > 5.0 or other < 4.0 * max(rms, floor_deg):
        raise MeasurementError(
            f"the angles seen follow neither sense of the stage ({rms:.1f}° rms, the other sense {other:.1f}°): does "
            "the stage turn the fixture at all, and does it sit tight?"
        )
    spread = reading_deg - reading_deg.mean()
    scatter = max(rms * np.sqrt(len(rest) / max(len(rest) - 2, 1)), floor_deg)
    slope = sense + float(spread @ rest / (spread @ spread))
    return Turning(
        sense,
        zero,
        float(scatter / np.sqrt(len(rest))),
        period_deg,
        slope,
        float(scatter / np.sqrt(spread @ spread)),
        rms,
        other,
        tuple(float(value) for value in rest),
    )


@dataclass(frozen=True)
class Centre:
    """The rotation centre in the picture.

    Attributes:
        column_px, row_px: the centre.
        u_px: standard uncertainty of either.
        eccentricity_mm: (x, y) of the fixture's origin from the axis, in the fixture's frame.
        u_eccentricity_mm: standard uncertainty of either.
        residual_px: rms distance of the origins from the circle.
    """

    column_px: float
    row_px: float
    u_px: float
    eccentricity_mm: tuple[float, float]
    u_eccentricity_mm: float
    residual_px: float


def fit_centre(fixes: list[Fix]) -> Centre:
    """Centre of rotation: the origin of the fixture moves on a circle about it, origin = c + A·e.

    Raises:
        MeasurementError: fewer than three pictures.
    """
    if len(fixes) < 3:
        raise MeasurementError(f"the rotation centre needs the markers in 3 pictures, not {len(fixes)}")
    design = np.concatenate([np.column_stack([np.eye(2), fix.matrix]) for fix in fixes])
    origins = np.concatenate([fix.origin_px for fix in fixes])
    solution = np.linalg.lstsq(design, origins, rcond=None)[0]
    rest = (design @ solution - origins).reshape(-1, 2)
    rms = float(np.sqrt(np.mean(np.sum(rest**2, axis=1))))
    # from the corners of one picture the origin is no better known than this
    floor = np.sqrt(np.mean([fix.residual_px**2 / (4 * fix.markers) for fix in fixes]))
    scatter = max(rms * np.sqrt(rest.size / (2.0 * max(rest.size - 4, 1))), float(floor), 1e-4)
    covariance = scatter**2 * np.linalg.inv(design.T @ design)
    u = np.sqrt(np.diag(covariance))
    return Centre(
        float(solution[0]),
        float(solution[1]),
        float(max(u[0], u[1])),
        (float(solution[2]), float(solution[3])),
        float(max(u[2], u[3])),
        rms,
    )


@dataclass(frozen=True)
class Foreshortening:
    """Reading of the tilt axis at an upright camera, from squeeze = cos(reading − zero): the sign is undetermined.

    Attributes:
        zero_deg, u_zero_deg: reading at which the camera looks straight down, and its standard uncertainty.
        residual: rms of the squeeze.
        axis_deg: direction of the tilt axis in the picture, counter-clockwise from its horizontal; None if unseen.
        u_axis_deg: its standard uncertainty.
    """

    zero_deg: float
    u_zero_deg: float
    residual: float
    axis_deg: float | None
    u_axis_deg: float | None


def fit_foreshortening(reading_deg: FloatArray, fixes: list[Fix]) -> Foreshortening:
    """Zero of the tilt axis; the readings must span it on both sides.

    Args:
        reading_deg: (N,) readings of the tilt axis.
        fixes: N views of the fixture.

    Raises:
        MeasurementError: fewer than three readings differ.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415 - takes long to import

    if len(set(np.round(reading_deg, 2))) < 3:
        raise MeasurementError("the zero of the tilt axis needs markers under at least 3 tilts")
    squeeze = np.array([fix.squeeze for fix in fixes])

    def rest(zero: FloatArray) -> FloatArray:
        return np.asarray(np.cos(np.radians(reading_deg - zero[0])) - squeeze, dtype=np.float64)

    start = reading_deg[np.argmax(squeeze)]
    found = least_squares(rest, [start], x_scale=1.0)
    rms = float(np.sqrt(np.mean(found.fun**2)))
    scatter = max(rms, 2e-5)
    slope = float(np.sum(np.radians(1.0) ** 2 * np.sin(np.radians(reading_deg - found.x[0])) ** 2))
    tilted = [fix for fix in fixes if fix.squeeze < np.cos(np.radians(5.0))]
    axis = u_axis = None
    if len(tilted) >= 2:
        directions = np.array([fix.squeeze_deg + 90.0 for fix in tilted])
        axis = float(wrapped(circular_mean(directions, 180.0), 180.0))
        off = wrapped(directions - axis, 180.0)
        u_axis = float(max(np.sqrt(np.mean(off**2)), 0.01) / np.sqrt(len(tilted)))
    return Foreshortening(float(found.x[0]), scatter / np.sqrt(max(slope, 1e-12)), rms, axis, u_axis)
