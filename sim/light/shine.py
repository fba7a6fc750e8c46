"""Parameters of facet reflectance for one material and pose, as compiled kernels take them."""

from typing import NamedTuple

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.light.material import Material, diffuse_scale, fresnel, transmittance_table

Vector = tuple[float, float, float]


class Shine(NamedTuple):
    """One pose of one material: numbers, because kernels count references to arrays again and again.

    Attributes:
        light: unit vector to the light.
        camera: unit vector to the camera.
        half: unit vector between them.
        mirror: F/(4π α_u α_v), the height of the lobe.
        alpha_along: roughness along the ridges.
        alpha_across: roughness across.
        diffuse: factor of the Lambertian base.
        table: transmittance of the interface over the cosine.
    """

    light: Vector
    camera: Vector
    half: Vector
    mirror: float
    alpha_along: float
    alpha_across: float
    diffuse: float
    table: FloatArray


def shine_in(light: FloatArray, camera: FloatArray, material: Material) -> Shine:
    """For (3,) unit vectors to light and camera."""
    half = (light + camera) / np.linalg.norm(light + camera)
    mirrored = float(fresnel(np.asarray(light @ half), material.index))
    alpha_along, alpha_across = material.alpha_along, material.alpha_across
    return Shine(
        vector(light),
        vector(camera),
        vector(half),
        mirrored / (4.0 * np.pi * alpha_along * alpha_across),
        alpha_along,
        alpha_across,
        diffuse_scale(material),
        transmittance_table(material),
    )


def vector(direction: FloatArray) -> Vector:
    """Components of a (3,) direction, one by one."""
    return float(direction[0]), float(direction[1]), float(direction[2])
