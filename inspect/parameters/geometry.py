"""How the angles of stage, light and camera are counted; poses (`anisoscope.sim.light.geometry`)."""

import math
from dataclasses import dataclass
from typing import Literal

from anisoscope.base.errors import ModelError

TiltPlane = Literal["perpendicular", "in-plane"]
RotationSense = Literal["ccw", "cw"]


@dataclass(frozen=True)
class Convention:
    """Convention of angles.

    Attributes:
        light_angle_deg: angle between light and camera θl in degrees, −90 to 90.
        tilt_plane: plane in which camera and light tilt: about the axis along the projected camera-to-light direction
            (perpendicular), or within the plane that holds both (in-plane).
        facet_azimuth_deg: azimuth toward which the large facets lean at stage angle 0, degrees; 0 is toward the light.
        rotation_sense: sense of a positive stage angle, seen from the camera.
    """

    light_angle_deg: float = 10.0
    tilt_plane: TiltPlane = "perpendicular"
    facet_azimuth_deg: float = 0.0
    rotation_sense: RotationSense = "ccw"

    def __post_init__(self) -> None:
        if not -90.0 < self.light_angle_deg < 90.0:
            raise ModelError(f"the light angle must lie between -90° and 90°, not {self.light_angle_deg}°")
        if not math.isfinite(self.facet_azimuth_deg):
            raise ModelError(f"the facet azimuth must be a number of degrees, not {self.facet_azimuth_deg}")
        if self.tilt_plane not in ("perpendicular", "in-plane"):
            raise ModelError(f"tilt plane is 'perpendicular' or 'in-plane', not {self.tilt_plane!r}")
        if self.rotation_sense not in ("ccw", "cw"):
            raise ModelError(f"rotation sense is 'ccw' or 'cw', not {self.rotation_sense!r}")


@dataclass(frozen=True)
class Pose:
    """One photograph: the stage angle and the tilt of camera and light, in degrees."""

    stage_deg: float
    tilt_deg: float = 0.0
