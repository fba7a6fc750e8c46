"""Radiance of a ridged part on a rig as a function of the parameters that commissioning determines."""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.commissioning.part import RidgedPart
from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import seating_rotation
from anisoscope.sim.light.material import Material


def lab_directions(
    lean_deg: FloatArray, tilt_deg: FloatArray, light_deg: float, azimuth_deg: float
) -> tuple[FloatArray, FloatArray]:
    """Unit vectors (N, 3) to light and camera in the frame of the ridges, +x where the facets lean.

    The same as `geometry.directions` with the tilt perpendicular to the light, but for a light that stands beside the
    xz plane by an azimuth.
    """
    theta, beta = np.radians(light_deg), np.radians(azimuth_deg)
    light = np.array([np.sin(theta) * np.cos(beta), np.sin(theta) * np.sin(beta), np.cos(theta)])
    tilt, turn = np.radians(tilt_deg), np.radians(-lean_deg)
    found = []
    for one in (light, np.array([0.0, 0.0, 1.0])):
        y = one[1] * np.cos(tilt) - one[2] * np.sin(tilt)
        z = one[1] * np.sin(tilt) + one[2] * np.cos(tilt)
        x = np.full_like(y, one[0])
        found.append(
            np.stack([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, z], axis=-1)
        )
    return found[0], found[1]


class RigModel:
    """ln of the radiance of all poses as a function of the parameters.

    Args:
        part: the part.
        lean_deg: (N,) azimuths toward which its facets lean.
        tilt_deg: (N,) tilts, but for their zero.
        bounces: reflections that count; None for all.
    """

    def __init__(
        self, part: RidgedPart, lean_deg: FloatArray, tilt_deg: FloatArray, bounces: int | None
    ) -> None:
        self.part, self.bounces = part, bounces
        self.lean_deg, self.tilt_deg = lean_deg, tilt_deg

    def __call__(self, p: dict[str, float]) -> FloatArray:
        """(N,) ln of the radiances for parameters by name."""
        light, camera = lab_directions(
            self.lean_deg, self.tilt_deg + p["tilt_zero_deg"], p["light_deg"], p["azimuth_deg"]
        )
        seat = seating_rotation(p["seat_x_deg"], p["seat_y_deg"])
        design = RidgeDesign(self.part.pitch_um, p["ridge_deg"], self.part.wall)
        along = float(np.exp(p["log_mean"] - 0.5 * p["log_ratio"]))
        across = float(np.exp(p["log_mean"] + 0.5 * p["log_ratio"]))
        material = Material(along, across, p["albedo"], p["index"])
        value = corrected.radiance(light @ seat, camera @ seat, design, material, self.bounces)
        return np.asarray(np.log(np.maximum(value, 1e-12)) + p["log_scale"], dtype=np.float64)
