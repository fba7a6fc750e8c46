"""What commissioning reports of tilt and light."""

import numpy as np

from anisoscope.commission.angles import Angles
from anisoscope.commission.light import SURE
from anisoscope.commission.record import Finding, missing, status_of
from anisoscope.rig.rigfile import RigFile

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
        remark += f"; in the picture the axis stands {axis.axis_deg:+.2f}° from the horizontal"
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
    """The light angle, and what it rests on."""
    found = angles.light["light_deg"]
    good = found.u <= MAX_U_LIGHT_DEG
    if found.u_alone <= MAX_U_LIGHT_DEG:
        remark = f"from the pictures alone: u = {found.u_alone:.2g}°"
    else:
        remark = (
            "the pictures alone do not say it: it rests on what is known of the part (ridge angle, roughness)"
        )
    names = [one.name for one in angles.light.parameters]
    row = np.abs(angles.light.correlation[names.index("light_deg")])
    row[names.index("light_deg")] = 0.0
    partner = angles.light.parameters[int(np.argmax(row))]
    remark += f"; goes most with {partner.words.split(' [')[0]} (correlation {float(np.max(row)):.2f})"
    if not good:
        remark += (
            f"; u is above {MAX_U_LIGHT_DEG:g}°: give what is known of the part more exactly, or tilt the arm"
        )
    return Finding(
        key="light.angle_deg",
        words="angle between light and camera",
        unit="°",
        old=file.light.angle_deg,
        value=found.value,
        u=found.u,
        status=status_of(good),
        remark=remark,
        goes_to_rig_file=True,
    )


def azimuth_finding(angles: Angles) -> Finding:
    """How far the light stands beside the plane of the model."""
    found = angles.light["azimuth_deg"]
    zero = angles.light["tilt_zero_deg"]
    remark = (
        "from the picture's +x axis, counter-clockwise; a tilt of the arm shows alike, its zero is known to "
    )
    remark += f"{zero.u:.2g}°"
    if found.u <= MAX_U_AZIMUTH_DEG and abs(found.value) > 3.0 * found.u:
        remark += ": light and camera do not share the plane of the model; turn the camera about its axis"
    return Finding(
        key="light.azimuth_deg",
        words="azimuth of the light",
        unit="°",
        old=0.0,
        value=found.value,
        u=found.u,
        status=status_of(found.u <= MAX_U_AZIMUTH_DEG),
        remark=remark,
    )
