"""Joint fit of all poses: sense and zero of the stage, rotation centre, tilt, and the radiance model."""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError
from anisoscope.commissioning.light import SURE, LightFit, Radiances, fit_light
from anisoscope.commissioning.observation import Observed, ObservedPose
from anisoscope.commissioning.part import RidgedPart
from anisoscope.commissioning.turning import (
    Centre,
    Foreshortening,
    Turning,
    circular_mean,
    fit_centre,
    fit_foreshortening,
    fit_turning,
    wrapped,
)
from anisoscope.rig.rigfile import RigFile

MIN_PICTURES = 5
U_ARM_DEG = 0.2
U_UNSEEN_TILT_DEG = 1.0


@dataclass(frozen=True)
class Assumed:
    """Assumptions about rig and model: relative standard uncertainties.

    Attributes:
        model_share: of the model, different from pose to pose.
        scale_share: of the white reference.
        fixture_share: of the printed size of the fixture.
        bounces: reflections that the model counts; None counts all.
    """

    model_share: float = 0.005
    scale_share: float = 0.02
    fixture_share: float = 0.001
    bounces: int | None = None


@dataclass(frozen=True, eq=False)
class Angles:
    """Fitted quantities; None where the pictures do not determine them.

    Attributes:
        markers: turning of the fixture.
        ridges: turning of the line across the ridges, period 180°.
        centre, pixel_um, u_pixel_um: from the turn without tilts.
        tilt: foreshortening of the markers under tilts.
        light: fit of the radiances.
        tilts_deg: tilts of all poses but the last, before their sign.
        corrected: radiances of all poses but the last, with the drift of the lamp taken out.
        u_relative: of these.
        drift: L(first pose, at the end)/L(first pose) − 1.
        lean_zero_deg, u_lean_zero_deg: reading at which the facets lean toward the picture's +x, or None.
        seat_deg, u_seat_deg: azimuth toward which the facets lean in the fixture, or None.
    """

    markers: Turning | None
    ridges: Turning | None
    centre: Centre | None
    pixel_um: float | None
    u_pixel_um: float | None
    tilt: Foreshortening | None
    light: LightFit
    tilts_deg: FloatArray
    corrected: FloatArray
    u_relative: FloatArray
    drift: float
    lean_zero_deg: float
    u_lean_zero_deg: float
    seat_deg: float | None
    u_seat_deg: float | None

    @property
    def sense(self) -> int:
        """1 where a growing reading turns the sample counter-clockwise."""
        return _any(self.markers, self.ridges).sense

    @property
    def side_known(self) -> bool:
        """Whether brightness decides to which side the facets lean."""
        return self.light.side_chi2 > SURE


def evaluate(observed: Observed, file: RigFile, part: RidgedPart, assumed: Assumed, absolute: bool) -> Angles:
    """Fit all quantities to the observed poses.

    Args:
        observed: what was seen.
        file: the rig file; its light angle is where the search begins, its tilt what the arm is at if nothing moves it.
        part: the part.
        assumed: what is assumed of rig and model.
        absolute: whether radiances are in 1/sr.

    Raises:
        MeasurementError: neither markers nor ridges are seen often enough, or nothing fits.
    """
    poses = [pose for pose in observed.poses if not pose.again]
    # Only the poses at the first tilt form a full turn; tilted ones foreshorten the markers.
    turn = [pose for pose in poses if pose.tilt_reading_deg == poses[0].tilt_reading_deg]
    markers = _turning_of_markers(poses)
    ridges = _turning_of_ridges(poses, markers)
    tilt = _foreshortening(poses) if file.tilt is not None else None
    # The closing pose repeats the first one: it measures the drift of the lamp and is not fitted.
    radiance, u, drift = _without_drift(observed.poses, assumed.model_share)
    line, u_line = _lines(poses, markers, ridges, part)
    tilts, u_tilt = _tilts(poses, file, tilt)
    light = fit_light(
        part,
        Radiances(
            line,
            tilts,
            radiance,
            u,
            absolute,
            assumed.scale_share,
            u_tilt,
            free_sign=len(set(np.round(tilts, 3))) > 1,
        ),
        file.light.angle_deg,
        bounces=assumed.bounces,
    )
    # Markers and ridges turn with the same sense; only the radiance decides to which side the facets lean.
    sense = _any(markers, ridges).sense
    lean = line + (180.0 if light.half_turn else 0.0)
    fixes = [pose.fix for pose in turn if pose.fix is not None]
    zero = circular_mean(np.array([pose.reading_deg for pose in poses]) - sense * lean)
    seats = np.array(
        [
            wrapped(at - pose.fix.angle_deg)
            for at, pose in zip(lean, poses, strict=True)
            if pose.fix is not None
        ]
    )
    pixels = np.array([fix.pixel_um for fix in fixes])
    known = len(fixes) >= MIN_PICTURES
    return Angles(
        markers,
        ridges,
        fit_centre(fixes) if known else None,
        float(pixels.mean()) if known else None,
        float(np.hypot(pixels.std() / np.sqrt(len(pixels)), assumed.fixture_share * pixels.mean())) if known else None,
        tilt,
        light,
        tilts,
        radiance,
        u,
        drift,
        zero,
        u_line,
        circular_mean(seats) if markers is not None else None,
        u_line if markers is not None else None,
    )  # fmt: skip


def _any(markers: Turning | None, ridges: Turning | None) -> Turning:
    found = markers or ridges
    if found is None:
        raise MeasurementError(
            "neither the fixture's markers nor the ridges are seen in the pictures: is the light on, the lens in "
            "focus, the part on the stage, and the fixture that of the rig file?"
        )
    return found


def _turning_of_markers(poses: list[ObservedPose]) -> Turning | None:
    readings = [(pose.reading_deg, pose.fix.angle_deg) for pose in poses if pose.fix is not None]
    if len(readings) < MIN_PICTURES:
        return None
    reading, angle = np.array(readings).T
    return fit_turning(reading, angle)


def _turning_of_ridges(poses: list[ObservedPose], markers: Turning | None) -> Turning | None:
    """Rotation of the direction across the ridges, without outliers: dim ridges drown in noise."""
    readings = [(pose.reading_deg, pose.ridge_deg) for pose in poses if pose.ridge_deg is not None]
    if len(readings) < MIN_PICTURES:
        return None
    reading, angle = np.array(readings).T
    try:
        first = fit_turning(reading, angle, 180.0, floor_deg=0.02)
    except MeasurementError:
        if markers is None:
            raise
        return None  # something else than ridges made those waves
    if markers is not None and first.sense != markers.sense:
        return None
    off = np.abs(first.residuals_deg)
    inliers = off <= max(4.0 * float(np.median(off)), 0.05)
    return fit_turning(reading[inliers], angle[inliers], 180.0, floor_deg=0.02)


def _foreshortening(poses: list[ObservedPose]) -> Foreshortening | None:
    readings = [(pose.tilt_reading_deg, pose.fix) for pose in poses if pose.fix is not None]
    if len({round(reading, 2) for reading, _ in readings}) < 3:
        return None
    return fit_foreshortening(np.array([reading for reading, _ in readings]), [fix for _, fix in readings])


def _without_drift(
    observed: tuple[ObservedPose, ...], model_share: float
) -> tuple[FloatArray, FloatArray, float]:
    """Radiances of all poses but the closing one, u of each, and the drift, assumed linear in time."""
    poses = [one for one in observed if not one.again]
    closing = [one for one in observed if one.again]
    radiance = np.array([one.radiance for one in poses])
    drift = closing[0].radiance / radiance[0] - 1.0 if closing else 0.0
    flicker = float(np.sqrt(np.mean([one.flicker**2 for one in observed])))
    noise = np.array([one.u_noise for one in poses])
    u = np.sqrt(noise**2 + flicker**2 + drift**2 / 12.0 + model_share**2)
    return radiance / (1.0 + drift * np.arange(len(poses)) / len(poses)), u, float(drift)


def _lines(
    poses: list[ObservedPose], markers: Turning | None, ridges: Turning | None, part: RidgedPart
) -> tuple[FloatArray, float]:
    """Azimuth across the ridges in every picture, and its standard uncertainty, from all pictures together."""
    reading = np.array([pose.reading_deg for pose in poses])
    found = _any(markers, ridges)
    if ridges is not None:
        sense = found.sense  # that of the markers, if there are any: their angle has no half turn
        return sense * (reading - ridges.zero_deg), ridges.u_zero_deg
    return found.sense * (reading - found.zero_deg) + part.facet_azimuth_deg, 1.0


def _tilts(
    poses: list[ObservedPose], file: RigFile, found: Foreshortening | None
) -> tuple[FloatArray, float]:
    if file.tilt is None:
        return np.full(len(poses), file.geometry.tilt_deg), U_ARM_DEG
    reading = np.array([pose.tilt_reading_deg for pose in poses])
    if found is None:
        return reading - file.tilt.zero_deg, U_UNSEEN_TILT_DEG
    return reading - found.zero_deg, max(found.u_zero_deg, 0.005)
