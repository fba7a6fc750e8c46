"""Radiance of a ridged part on a rig as a function of the parameters that commissioning determines."""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.commissioning.part import RidgedPart
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.reflections import StandIn, groove_of_design
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import seating_rotation


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

    Light that reflects between facet and wall is that of the groove of the ridge angle. Its amplitude is a parameter.

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
        self._stand_in: StandIn | None = None

    def anchored(self, p: dict[str, float], every: int = 1) -> "RigModel":
        """The same near given parameters, cheaply: two reflections, times the ratio of all to two as it is there.

        Args:
            p: parameters by name.
            every: the ratio is taken at every so many-th pose; the others have that of the nearest one.
        """
        near = RigModel(self.part, self.lean_deg, self.tilt_deg, self.bounces)
        light, camera, design, material = self._scene(p)
        groove = groove_of_design(design, self.bounces)
        near._stand_in = (
            None if groove is None else StandIn(groove, light[::every], camera[::every], material)
        )
        return near

    def indirect_share(self, p: dict[str, float]) -> FloatArray:
        """(N,) share of the radiances that reflects twice and more, for parameters by name."""
        scene = self._scene(p)
        indirect = self._indirect(*scene) * p.get("reflections", 1.0)
        return np.asarray(indirect / (corrected.radiance(*scene) + indirect), dtype=np.float64)

    def __call__(self, p: dict[str, float]) -> FloatArray:
        """(N,) ln of the radiances for parameters by name."""
        scene = self._scene(p)
        value = corrected.radiance(*scene) + p.get("reflections", 1.0) * self._indirect(*scene)
        return np.asarray(np.log(np.maximum(value, 1e-12)) + p["log_scale"], dtype=np.float64)

    def _scene(self, p: dict[str, float]) -> tuple[FloatArray, FloatArray, RidgeDesign, Material]:
        light, camera = lab_directions(
            self.lean_deg, self.tilt_deg + p["tilt_zero_deg"], p["light_deg"], p["azimuth_deg"]
        )
        seat = seating_rotation(p["seat_x_deg"], p["seat_y_deg"])
        along = float(np.exp(p["log_mean"] - 0.5 * p["log_ratio"]))
        across = float(np.exp(p["log_mean"] + 0.5 * p["log_ratio"]))
        return (
            light @ seat,
            camera @ seat,
            RidgeDesign(
                self.part.pitch_um,
                p["ridge_deg"],
                self.part.wall,
                edge_radius_um=self.part.edge_radius_um,
                foot_radius_um=self.part.foot_radius_um,
            ),
            Material(
                along,
                across,
                p["albedo"],
                p["index"],
                self.part.internal_reflection,
                p.get("tail", self.part.tail),
                self.part.second_lobe,
            ),
        )

    def _indirect(
        self, to_light: FloatArray, to_camera: FloatArray, design: RidgeDesign, material: Material
    ) -> FloatArray:
        groove = groove_of_design(design, self.bounces)
        if groove is None:
            return np.zeros(len(to_light))
        if self._stand_in is None:
            return groove.light(to_light, to_camera, material)
        return self._stand_in.of(groove)(to_light, to_camera, material)
