"""Directions to the light and to the camera as wave optics needs them, and the scale of its reflectance."""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError


@dataclass(frozen=True)
class HalfVector:
    """h = (l + v)/2 of one pair of unit vectors; not a unit vector itself.

    Attributes:
        x: component along x.
        y: component along y.
        z: component along the normal.
        light_z: cosine of the angle of incidence.
        camera_z: cosine of the viewing angle.
    """

    x: float
    y: float
    z: float
    light_z: float
    camera_z: float

    @property
    def square(self) -> float:
        """|h|² = (1 + ⟨l, v⟩)/2."""
        return self.x**2 + self.y**2 + self.z**2

    @property
    def slopes(self) -> tuple[float, float]:
        """Slopes ∂z/∂x, ∂z/∂y of the facet that mirrors the light into the camera."""
        return -self.x / self.z, -self.y / self.z

    def frequency(self, wavelength_um: float) -> tuple[float, float]:
        """ω = 2·h/λ along x and y in cycles per µm."""
        return 2.0 * self.x / wavelength_um, 2.0 * self.y / wavelength_um

    def gamma(self, wavelength_um: float, dimensions: int = 2) -> float:
        """Foreshortening γ = (1 + ⟨l, v⟩)/(v_z + l_z), over λ for a surface, over √λ for a profile.

        Source: Levin et al. 2013, Eq. 23, which gives 1/λ for both; with it a profile does not conserve energy.
        """
        return float(self.square / self.z / wavelength_um ** (0.5 * dimensions))


def half_vector(to_light: FloatArray, to_camera: FloatArray) -> HalfVector:
    """From (3,) unit vectors in the frame of the sample.

    Raises:
        ModelError: light or camera at or below the horizon.
    """
    light, camera = np.asarray(to_light, dtype=np.float64), np.asarray(to_camera, dtype=np.float64)
    if min(light[2], camera[2]) < 1e-6:
        raise ModelError("light and camera must stand above the horizon of the sample")
    x, y, z = 0.5 * (light + camera)
    return HalfVector(float(x), float(y), float(z), float(light[2]), float(camera[2]))


def across_beam(direction: FloatArray) -> FloatArray:
    """(2, 2): x and y components (columns) of two unit vectors (rows) across a (3,) unit vector and each other."""
    horizontal = float(np.hypot(direction[0], direction[1]))
    azimuth = (
        np.array([direction[0], direction[1]]) / horizontal if horizontal > 1e-12 else np.array([1.0, 0.0])
    )
    return np.array([azimuth * direction[2], [-azimuth[1], azimuth[0]]])
