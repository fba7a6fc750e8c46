"""What commissioning reports: every value with its uncertainty, what cannot be told, and why."""

import numpy as np

from anisoscope.commission.angles import Angles
from anisoscope.commission.findings_light import azimuth_finding, light_finding, tilt_findings
from anisoscope.commission.record import Finding, missing, status_of
from anisoscope.commission.series import Taken
from anisoscope.commission.turning import Turning, wrapped
from anisoscope.rig.rigfile import AxisPart, RigFile

SENSES = {1: "ccw", -1: "cw"}
USUAL_ANGLES = (0.0, 90.0, 180.0, 270.0)
MAX_SEAT_DEG = 0.5  # what an inspection bears between fixture and stage


def findings_of(angles: Angles, file: RigFile, taken: Taken, facet_azimuth_deg: float) -> tuple[Finding, ...]:
    """Everything that was looked for, in the order of the page.

    Args:
        angles: the fits.
        file: the rig file as it stands.
        taken: the pictures, for limits of the stage and size of the picture.
        facet_azimuth_deg: azimuth in the fixture toward which the facets are said to lean.
    """
    return (
        _sense(angles, file),
        _zero(angles, file, taken, facet_azimuth_deg),
        _fixture_zero(angles, file),
        _lean_zero(angles),
        _seat(angles, facet_azimuth_deg),
        _steps(angles),
        *_centre(angles, taken),
        _pixel(angles, file),
        *tilt_findings(angles, file),
        light_finding(angles, file),
        azimuth_finding(angles),
    )


def _sense(angles: Angles, file: RigFile) -> Finding:
    by = "markers" if angles.markers is not None else "ridges; it holds as long as a step is less than 90°"
    return Finding(
        key="stage.turns",
        words="sense in which a growing reading turns the sample, seen from the camera",
        old=file.stage.turns,
        value=SENSES[angles.sense],
        remark=f"by the {by}",
        goes_to_rig_file=True,
    )


def _zero(angles: Angles, file: RigFile, taken: Taken, facet_azimuth_deg: float) -> Finding:
    """Where the fixture stands at 0°, or without one the part: what `stage.zero_deg` means to an inspection."""
    known, remark = True, "where the fixture stands at 0°"
    if angles.markers is not None:
        zero, u = angles.markers.zero_deg, angles.markers.u_zero_deg
    else:
        zero, u = angles.lean_zero_deg + angles.sense * facet_azimuth_deg, angles.u_lean_zero_deg
        known, remark = angles.side_known, "where the part stands at 0°: no markers are seen"
        if not known:
            remark += f"; brightness does not tell it from {zero + 180.0:.2f}°"
    zero = _reachable_zero(zero, angles.sense, file.stage, taken.limits_deg)
    beyond = [a for a in USUAL_ANGLES if not _reached(zero + angles.sense * a, file.stage, taken.limits_deg)]
    if beyond:
        listed = ", ".join(f"{a:g}°" for a in beyond)
        remark += f"; the stage does not reach {listed} of the sample: turn the fixture on it"
    return Finding(
        key="stage.zero_deg",
        words="stage reading at 0°",
        unit="°",
        old=file.stage.zero_deg,
        value=zero,
        u=u,
        status=status_of(known),
        remark=remark,
        goes_to_rig_file=True,
    )


def _reached(reading_deg: float, part: AxisPart, limits_deg: tuple[float, float]) -> bool:
    """Can a reading be approached from below?"""
    return limits_deg[0] + part.approach_deg <= reading_deg <= limits_deg[1]


def _reachable_zero(zero_deg: float, sense: int, part: AxisPart, limits_deg: tuple[float, float]) -> float:
    """The zero among those a turn apart from which most of the usual angles are reached, the nearest to the old one."""

    def merit(zero: float) -> tuple[int, float]:
        readings = [zero + sense * angle for angle in USUAL_ANGLES]
        within = sum(_reached(reading, part, limits_deg) for reading in readings)
        return within, -abs(zero - part.zero_deg)

    first = part.zero_deg + float(wrapped(zero_deg - part.zero_deg))
    return max((first + 360.0 * turns for turns in (-1, 0, 1)), key=merit)


def _fixture_zero(angles: Angles, file: RigFile) -> Finding:
    words = "angle of the fixture where the rig file says 0°"
    if angles.markers is None:
        return missing("fixture.angle_deg", words, "°", "no markers are seen")
    turning: Turning = angles.markers
    return Finding(
        key="fixture.angle_deg",
        words=words,
        unit="°",
        value=float(wrapped(turning.sense * (file.stage.zero_deg - turning.zero_deg))),
        u=turning.u_zero_deg,
        remark=f"markers follow the stage within {turning.residual_deg:.3f}° rms, the other sense within "
        f"{turning.other_deg:.0f}°",
    )


def _lean_zero(angles: Angles) -> Finding:
    words = "stage reading at which the facets lean toward the light's side (+x)"
    side = "the side is decided by brightness"
    if not angles.side_known:
        other = float(np.mod(angles.lean_zero_deg + 180.0, 360.0))
        side = f"or {other:.2f}°: brightness does not tell the two sides apart"
    if angles.ridges is None:
        side += "; the camera does not resolve the ridges: seen by brightness alone, with the light's azimuth"
    return Finding(
        key="ridges.zero_deg",
        words=words,
        unit="°",
        value=float(np.mod(angles.lean_zero_deg, 360.0)),
        u=angles.u_lean_zero_deg,
        status=status_of(angles.side_known),
        remark=f"{side} (χ² {angles.light.side_chi2:.0f} for the other)",
    )


def _seat(angles: Angles, facet_azimuth_deg: float) -> Finding:
    words = "azimuth in the fixture toward which the facets lean"
    if angles.seat_deg is None:
        return missing("part.facet_azimuth_deg", words, "°", "no markers are seen")
    off = float(wrapped(angles.seat_deg - facet_azimuth_deg))
    remark = f"{off:+.2f}° from what was said"
    if abs(off) > 90.0:
        remark += (
            ": the part lies the other way round, or the light stands on the other side; the pictures cannot tell "
            "which. Turn the part, or give poses.facet_azimuth_deg in its recipe"
        )
    elif abs(off) > MAX_SEAT_DEG:
        remark += ": seat the part straight in its fixture, or give poses.facet_azimuth_deg in its recipe"
    return Finding(
        key="part.facet_azimuth_deg",
        words=words,
        unit="°",
        old=facet_azimuth_deg,
        value=float(wrapped(angles.seat_deg)),
        u=angles.u_seat_deg,
        status=status_of(angles.side_known),
        remark=remark,
    )


def _steps(angles: Angles) -> Finding:
    turning = angles.markers or angles.ridges
    assert turning is not None
    slope, u = abs(turning.slope), turning.u_slope
    wrong = abs(slope - 1.0) > max(3.0 * u, 1e-3)
    return Finding(
        key="stage.scale",
        words="turn of the sample per degree of reading",
        unit="1",
        old=1.0,
        value=slope,
        u=u,
        remark="the stage does not count true: check its steps per degree" if wrong else "",
    )


def _centre(angles: Angles, taken: Taken) -> tuple[Finding, ...]:
    named = (
        ("camera.axis_column_px", "rotation centre: column", "px"),
        ("camera.axis_row_px", "rotation centre: row", "px"),
        ("fixture.eccentricity_um", "fixture's origin off the axis", "µm"),
    )
    centre = angles.centre
    if centre is None:
        return tuple(missing(*one, "no markers are seen") for one in named)
    rows, cols = taken.shape
    off = np.hypot(centre.column_px - (cols - 1) / 2, centre.row_px - (rows - 1) / 2)
    eccentric = 1000.0 * float(np.hypot(*centre.eccentricity_mm))
    values = (
        (centre.column_px, centre.u_px, f"{off:.1f} px from the middle of the picture"),
        (centre.row_px, centre.u_px, f"circle fits within {centre.residual_px:.3f} px rms"),
        (eccentric, 1000.0 * centre.u_eccentricity_mm, ""),
    )
    return tuple(
        Finding(key=key, words=words, unit=unit, value=value, u=u, remark=remark)
        for (key, words, unit), (value, u, remark) in zip(named, values, strict=True)
    )


def _pixel(angles: Angles, file: RigFile) -> Finding:
    words = "size of a pixel on the sample"
    if angles.pixel_um is None:
        return missing("camera.pixel_um", words, "µm", "no markers are seen")
    return Finding(
        key="camera.pixel_um",
        words=words,
        unit="µm",
        old=file.camera.pixel_um,
        value=angles.pixel_um,
        u=angles.u_pixel_um,
        remark="as large as the fixture's measures are true",
        goes_to_rig_file=True,
    )
