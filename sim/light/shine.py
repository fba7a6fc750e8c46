"""Parameters of facet reflectance for one material and pose, as compiled kernels take them."""

from typing import NamedTuple

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.material import SHORTEST_TAIL, Material
from anisoscope.sim.light.material import diffuse_scale, fresnel, shadowing_table, transmittance_table

Vector = tuple[float, float, float]


class LobeShape(NamedTuple):
    """Shape of the lobe at any roughness.

    Attributes:
        tail: τ, 0 for Beckmann's lobe.
        weight: share of the slopes that are those of a second lobe, 0 without.
        width: its width over that of the first.
        reach: square of a width that holds the whole lobe over that of Beckmann's, infinite with a tail.
        shadowing: `material.shadowing_table`; empty for Beckmann's lobe, which has no need of it.
    """

    tail: float
    weight: float
    width: float
    reach: float
    shadowing: FloatArray


class Plastic(NamedTuple):
    """Rough plastic: roughness along and across, index, scale of the base [1/sr], transmittance table, lobe."""

    alpha_u: float
    alpha_v: float
    refraction: float
    diffuse: float
    table: FloatArray
    lobe: LobeShape


class Shine(NamedTuple):
    """One pose of one material: numbers, because kernels count references to arrays again and again.

    Attributes:
        light: unit vector to the light.
        camera: unit vector to the camera.
        turn: cosine and sine of the direction of the ridges, counter-clockwise from +y.
        from_light: unit vector to the light with x across and y along the ridges.
        from_camera: the same of the camera.
        half: unit vector between these two.
        mirror: F/(4π α_u α_v), the height of the lobe.
        alpha_along: roughness along the ridges.
        alpha_across: roughness across.
        diffuse: factor of the Lambertian base.
        table: transmittance of the interface over the cosine.
        lobe: shape of the lobe.
    """

    light: Vector
    camera: Vector
    turn: tuple[float, float]
    from_light: Vector
    from_camera: Vector
    half: Vector
    mirror: float
    alpha_along: float
    alpha_across: float
    diffuse: float
    table: FloatArray
    lobe: LobeShape


_NO_TABLE = np.empty(0)
_NO_TABLE.flags.writeable = False


def lobe_shape(material: Material) -> LobeShape:
    """The shape of a material's lobe."""
    weight, width = material.second_lobe or (0.0, 1.0)
    tail = material.tail if material.tail >= SHORTEST_TAIL else 0.0
    reach = np.inf if tail > 0.0 else max(1.0, width**2)
    table = _NO_TABLE if material.is_beckmann else shadowing_table(tail, material.second_lobe)
    return LobeShape(tail, float(weight), float(width), float(reach), table)


def plastic_of(material: Material) -> Plastic:
    """A material as kernels take it that let light reflect again and again."""
    return Plastic(
        material.alpha_along,
        material.alpha_across,
        material.index,
        diffuse_scale(material),
        transmittance_table(material),
        lobe_shape(material),
    )


def turn_of(direction_deg: float) -> tuple[float, float]:
    """Cosine and sine, exact at quarter turns."""
    angle = np.radians(direction_deg)
    return round(float(np.cos(angle)), 15), round(float(np.sin(angle)), 15)


def turned(direction: FloatArray, turn: tuple[float, float]) -> Vector:
    """Components of a (3,) direction across and along ridges, and up."""
    x, y, z = vector(direction)
    return turn[0] * x + turn[1] * y, turn[0] * y - turn[1] * x, z


def shine_in(light: FloatArray, camera: FloatArray, material: Material, direction_deg: float = 0.0) -> Shine:
    """For (3,) unit vectors to light and camera, and ridges that run so far counter-clockwise from +y."""
    turn = turn_of(direction_deg)
    half = (light + camera) / np.linalg.norm(light + camera)
    mirrored = float(fresnel(np.asarray(light @ half), material.index))
    alpha_along, alpha_across = material.alpha_along, material.alpha_across
    return Shine(
        vector(light),
        vector(camera),
        turn,
        turned(light, turn),
        turned(camera, turn),
        turned(half, turn),
        mirrored / (4.0 * np.pi * alpha_along * alpha_across),
        alpha_along,
        alpha_across,
        diffuse_scale(material),
        transmittance_table(material),
        lobe_shape(material),
    )


def vector(direction: FloatArray) -> Vector:
    """Components of a (3,) direction, one by one."""
    return float(direction[0]), float(direction[1]), float(direction[2])
