"""Findings of a commissioning: sense, zero, seat, centre, tilt, light and pixel size, against what the rig file says.

Every finding is a value with its uncertainty, or the reason why it is undetermined.
"""

import numpy as np

from anisoscope.commissioning.angles import Angles
from anisoscope.commissioning.light import SURE
from anisoscope.commissioning.record import (
    Finding,
    missing,
    status_of,
)
from anisoscope.commissioning.series import PictureSet
from anisoscope.commissioning.turning import Turning, wrapped
from anisoscope.rig.rigfile import RigFile, StagePart
from anisoscope.rig.stage import FULL_TURN_DEG, apart_deg, turns_round

MAX_U_LIGHT_DEG = 0.5
MAX_U_AZIMUTH_DEG = 2.0


def tilt_findings(angles: Angles, file: RigFile) -> tuple[Finding, ...]:
    """Sign and zero of the tilt axis: the sign by the radiances alone, which the markers cannot see."""
    sign = ("tilt.sign", "sense of the tilt axis", "")
    zero = ("tilt.zero_deg", "reading of the tilt axis at an upright camera", "°")
    if file.tilt is None:
        why = "no axis tilts the arm"
        return missing(*sign, why), missing(*zero, why)
    fit = angles.light
    if fit.sign is None or fit.sign_chi2 is None:
        return missing(*sign, "no second tilt can be reached"), missing(
            *zero, "no second tilt can be reached"
        )
    sure = fit.sign_chi2 > SURE and angles.side_known
    base = angles.tilt.zero_deg if angles.tilt is not None else file.tilt.zero_deg
    rest = fit["tilt_zero_deg"]
    axis = angles.tilt
    remark = (
        "from the foreshortening of the markers and the radiances"
        if axis is not None
        else "from the radiances"
    )
    if axis is not None and axis.axis_deg is not None:
        remark = "; ".join(
            (remark, f"in the picture the axis stands {axis.axis_deg:+.2f}° from the horizontal")
        )
    return (
        Finding(
            key=sign[0],
            words=sign[1],
            old=file.tilt.sign,
            value=fit.sign,
            status=status_of(sure),
            remark=f"markers look alike under +tilt and -tilt; by the radiances (χ² {fit.sign_chi2:.0f} for the other)",
            goes_to_rig_file=True,
        ),
        Finding(
            key=zero[0],
            words=zero[1],
            unit="°",
            old=file.tilt.zero_deg,
            value=base - fit.sign * rest.value,
            u=rest.u,
            remark=remark,
            goes_to_rig_file=True,
        ),
    )


def light_finding(angles: Angles, file: RigFile) -> Finding:
    """Light angle, and the data that determine it."""
    found = angles.light["light_deg"]
    good = found.u <= MAX_U_LIGHT_DEG
    if found.u_alone <= MAX_U_LIGHT_DEG:
        remark = f"from the pictures alone: u = {found.u_alone:.2g}°"
    else:
        remark = "not determined by the pictures alone: rests on what is known of the part (ridge angle, roughness)"
    names = [one.name for one in angles.light.parameters]
    row = np.abs(angles.light.correlation[names.index("light_deg")])
    row[names.index("light_deg")] = 0.0
    partner = angles.light.parameters[int(np.argmax(row))]
    strongest = float(np.max(row))
    remarks = [remark, f"most correlated with {partner.words.split(' [')[0]} (correlation {strongest:.2f})"]
    if not good:
        remarks.append(
            f"u is above {MAX_U_LIGHT_DEG:g}°: state what is known of the part more exactly, or tilt the arm"
        )
    channels, name = file.light.channels, file.light.channel
    own = name if name in channels and channels[name].angle_deg is not None else None
    return Finding(
        key=f"light.{'' if own is None else f'channels.{own}.'}angle_deg",
        words="angle between light and camera",
        unit="°",
        old=file.light.angle_deg,
        value=found.value,
        u=found.u,
        status=status_of(good),
        remark="; ".join(remarks),
        goes_to_rig_file=True,
    )


def azimuth_finding(angles: Angles) -> Finding:
    """Azimuth of the light out of the plane of the model."""
    found = angles.light["azimuth_deg"]
    zero = angles.light["tilt_zero_deg"]
    remarks = [
        "from the picture's +x axis, counter-clockwise",
        f"a tilt of the arm has the same effect, its zero is known to {zero.u:.2g}°",
    ]
    if found.u <= MAX_U_AZIMUTH_DEG and abs(found.value) > 3.0 * found.u:
        remarks.append("light and camera do not share the plane of the model: turn the camera about its axis")
    return Finding(
        key="light.azimuth_deg",
        words="azimuth of the light",
        unit="°",
        old=0.0,
        value=found.value,
        u=found.u,
        status=status_of(found.u <= MAX_U_AZIMUTH_DEG),
        remark="; ".join(remarks),
    )


SENSES = {1: "ccw", -1: "cw"}
USUAL_ANGLES = (0.0, 90.0, 180.0, 270.0)
MAX_SEAT_DEG = 0.5  # what an inspection bears between fixture and stage


def findings_of(
    angles: Angles, file: RigFile, picture_set: PictureSet, facet_azimuth_deg: float
) -> tuple[Finding, ...]:
    """All findings in the order of the page.

    Args:
        angles: the fits.
        file: the rig file as it stands.
        picture_set: the pictures, for limits of the stage and size of the picture.
        facet_azimuth_deg: azimuth in the fixture toward which the facets are said to lean.
    """
    return (
        _sense(angles, file),
        _zero(angles, file, picture_set, facet_azimuth_deg),
        _fixture_zero(angles, file),
        _lean_zero(angles),
        _seat(angles, facet_azimuth_deg),
        _steps(angles),
        *_centre(angles, picture_set),
        _pixel(angles, file),
        *tilt_findings(angles, file),
        light_finding(angles, file),
        azimuth_finding(angles),
    )


def _sense(angles: Angles, file: RigFile) -> Finding:
    remark = (
        "by the markers"
        if angles.markers is not None
        else "by the ridges: right as long as a step is less than 90°"
    )
    return Finding(
        key="stage.turns",
        words="sense in which a growing reading turns the sample, seen from the camera",
        old=file.stage.turns,
        value=SENSES[angles.sense],
        remark=remark,
        goes_to_rig_file=True,
    )


def _zero(angles: Angles, file: RigFile, picture_set: PictureSet, facet_azimuth_deg: float) -> Finding:
    """Zero of the fixture, or without one of the part: the meaning of `stage.zero_deg` in an inspection."""
    known, remark = True, "where the fixture stands at 0°"
    if angles.markers is not None:
        zero, u = angles.markers.zero_deg, angles.markers.u_zero_deg
    else:
        zero, u = angles.lean_zero_deg + angles.sense * facet_azimuth_deg, angles.u_lean_zero_deg
        known, remark = angles.side_known, "where the part stands at 0°: no markers are seen"
        if not known:
            remark = "; ".join((remark, f"the brightness cannot distinguish it from {zero + 180.0:.2f}°"))
    zero = _reachable_zero(zero, angles.sense, file.stage, picture_set.limits_deg)
    beyond = _unreached(zero, angles.sense, file.stage, picture_set.limits_deg)
    if beyond:
        listed = ", ".join(f"{a:g}°" for a in beyond)
        remark = "; ".join(
            (remark, f"the stage does not reach {listed} of the sample: turn the fixture on it")
        )
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


def _unreached(
    zero_deg: float, sense: int, part: StagePart, limits_deg: tuple[float, float]
) -> tuple[float, ...]:
    """Usual angles of the sample that the stage cannot approach from below, were this its zero."""
    found = part.model_copy(update={"zero_deg": zero_deg, "turns": SENSES[sense]})
    ways = {angle: found.way(angle, limits_deg) for angle in USUAL_ANGLES}
    return tuple(
        angle for angle, (below, target) in ways.items() if below < limits_deg[0] or target > limits_deg[1]
    )


def _reachable_zero(zero_deg: float, sense: int, part: StagePart, limits_deg: tuple[float, float]) -> float:
    """The zero among those a turn apart from which most of the usual angles are reached, the nearest to the old one.

    Where readings wrap, all are alike: the zero within the first turn then.
    """
    if turns_round(limits_deg):
        return float(zero_deg % FULL_TURN_DEG)

    def merit(zero: float) -> tuple[int, float]:
        return -len(_unreached(zero, sense, part, limits_deg)), -abs(zero - part.zero_deg)

    first = part.zero_deg + apart_deg(zero_deg, part.zero_deg)
    return max((first + FULL_TURN_DEG * turns for turns in (-1, 0, 1)), key=merit)


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
        side = f"or {other:.2f}°: the brightness cannot distinguish the two sides"
    sides = [f"{side} (χ² {angles.light.side_chi2:.0f} for the other)"]
    if angles.ridges is None:
        sides.append(
            "the camera does not resolve the ridges: seen by brightness alone, with the light's azimuth"
        )
    return Finding(
        key="ridges.zero_deg",
        words=words,
        unit="°",
        value=float(np.mod(angles.lean_zero_deg, 360.0)),
        u=angles.u_lean_zero_deg,
        status=status_of(angles.side_known),
        remark="; ".join(sides),
    )


def _seat(angles: Angles, facet_azimuth_deg: float) -> Finding:
    words = "azimuth in the fixture toward which the facets lean"
    if angles.seat_deg is None:
        return missing("part.facet_azimuth_deg", words, "°", "no markers are seen")
    off = float(wrapped(angles.seat_deg - facet_azimuth_deg))
    remarks = [f"{off:+.2f}° from the stated azimuth"]
    if abs(off) > 90.0:
        remarks.append(
            "the part is turned by half a turn, or the light is on the other side, which the pictures cannot "
            "distinguish: turn the part, or give poses.facet_azimuth_deg in its recipe"
        )
    elif abs(off) > MAX_SEAT_DEG:
        remarks.append("seat the part straight in its fixture, or give poses.facet_azimuth_deg in its recipe")
    return Finding(
        key="part.facet_azimuth_deg",
        words=words,
        unit="°",
        old=facet_azimuth_deg,
        value=float(wrapped(angles.seat_deg)),
        u=angles.u_seat_deg,
        status=status_of(angles.side_known),
        remark="; ".join(remarks),
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
        remark="the stage turns by another angle than it reads: check its steps per degree" if wrong else "",
    )


def _centre(angles: Angles, picture_set: PictureSet) -> tuple[Finding, ...]:
    named = (
        ("camera.axis_column_px", "rotation centre: column", "px"),
        ("camera.axis_row_px", "rotation centre: row", "px"),
        ("fixture.eccentricity_um", "fixture's origin off the axis", "µm"),
    )
    centre = angles.centre
    if centre is None:
        return tuple(missing(*one, "no markers are seen") for one in named)
    rows, cols = picture_set.shape
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
