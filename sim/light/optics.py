"""What an eye and a lamp of finite size see: light and camera apertures, and a light close to the field.

A pose has one direction to the light and one to the camera. Real ones subtend a disc, and a lamp at a finite
distance stands at another angle for every place of the field. Each pose becomes a bundle of pairs of directions with
weights; a prediction is the weighted mean over the bundle. Discs are uniform in direction cosines: an aplanatic
lens collects so, and a lamp of uniform radiance lights so, per irradiance perpendicular to its axis.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.parameters.material import Material
from anisoscope.parameters.optics import Optics

Model = Callable[[FloatArray, FloatArray, Material], FloatArray]

_FIELD_NODES = 3  # Gauss-Legendre, on each axis of the field


@dataclass(frozen=True, eq=False)
class Bundle:
    """Directions that represent P poses, Q pairs each.

    Attributes:
        to_light: (P, Q, 3) unit vectors in the frame of the sample.
        to_camera: (P, Q, 3) unit vectors in the frame of the sample.
        weight: (Q,) weights of a mean; where the lamp has a size they add up to a little more than 1, because
            slanting parts of the beam must be stronger to give the same irradiance perpendicular to its axis.
    """

    to_light: FloatArray
    to_camera: FloatArray
    weight: FloatArray


def bundle(to_light: FloatArray, to_camera: FloatArray, optics: Optics) -> Bundle:
    """Directions that represent each pose.

    Args:
        to_light: (P, 3) unit vectors from the middle of the field, in the frame of the sample.
        to_camera: (P, 3) unit vectors in the frame of the sample.
        optics: apertures, and where the lamp stands.

    Raises:
        ModelError: some direction lies at or below the horizon of the sample.
    """
    place, place_weight = _places(optics)
    light_disc, light_weight = _disc(optics.lamp_half_angle_deg, optics.disc_rings)
    camera_disc, camera_weight = _disc(optics.aperture_half_angle_deg, optics.disc_rings)
    light_cosine = np.sqrt(1.0 - np.sum(light_disc**2, axis=-1))
    near = _from_places(to_light, to_camera, place, optics.lamp_distance_mm)  # (P, F, 3)
    lamps = _around(near[:, :, None], light_disc)  # (P, F, L, 3)
    lenses = _around(to_camera[:, None], camera_disc)  # (P, C, 3)
    shape = (len(to_light), len(place), len(light_disc), len(camera_disc), 3)
    all_light = np.broadcast_to(lamps[:, :, :, None], shape).reshape(len(to_light), -1, 3)
    all_camera = np.broadcast_to(lenses[:, None, None], shape).reshape(len(to_light), -1, 3)
    weight = np.einsum("f,l,c->flc", place_weight, light_weight / light_cosine, camera_weight).ravel()
    if min(float(all_light[..., 2].min()), float(all_camera[..., 2].min())) < 1e-3:
        raise ModelError("part of the light or of the lens stands at or below the horizon of the sample")
    return Bundle(all_light, all_camera, weight)


def through(model: Model, optics: Optics) -> Model:
    """A predictor averaged over lens and lamp of finite size; errors of :func:`bundle` and its own.

    Args:
        model: takes (N, 3) directions to light and camera and a material, gives (N,) radiances.
        optics: apertures, and where the lamp stands.
    """
    if optics.is_point_like:
        return model

    def mean(to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
        found = bundle(to_light, to_camera, optics)
        values = model(found.to_light.reshape(-1, 3), found.to_camera.reshape(-1, 3), material)
        return np.asarray(values.reshape(len(to_light), -1) @ found.weight, dtype=np.float64)

    return mean


def _places(optics: Optics) -> tuple[FloatArray, FloatArray]:
    """(F, 2) places in the field in mm, and their weights."""
    if optics.lamp_distance_mm is None or max(optics.field_mm) == 0.0:
        return np.zeros((1, 2)), np.ones(1)
    node, weight = np.polynomial.legendre.leggauss(_FIELD_NODES)
    x, y = np.meshgrid(0.5 * optics.field_mm[0] * node, 0.5 * optics.field_mm[1] * node, indexing="ij")
    return np.stack([x.ravel(), y.ravel()], axis=-1), np.outer(0.5 * weight, 0.5 * weight).ravel()


def _disc(half_angle_deg: float, rings: int) -> tuple[FloatArray, FloatArray]:
    """(N, 2) direction cosines of a disc around its axis, and their weights."""
    if half_angle_deg == 0.0:
        return np.zeros((1, 2)), np.ones(1)
    size = np.sin(np.radians(half_angle_deg))
    if rings == 1:  # centre and a hexagon
        turn = np.arange(6) * np.pi / 3.0
        ring = np.sqrt(2.0 / 3.0) * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        return size * np.concatenate([np.zeros((1, 2)), ring]), np.array([0.25] + [0.125] * 6)
    node, weight = np.polynomial.legendre.leggauss(rings)
    radius = np.sqrt(0.5 * (node + 1.0))
    turn = (np.arange(4 * rings) + 0.5) * np.pi / (2.0 * rings)
    points = radius[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    return size * points.reshape(-1, 2), np.repeat(0.5 * weight / (4 * rings), 4 * rings)


def _from_places(
    to_light: FloatArray, to_camera: FloatArray, place: FloatArray, distance_mm: float | None
) -> FloatArray:
    """(P, F, 3) unit vectors to the light from each place of the field, in the frame of the sample.

    The field lies on the sample and stands still: its width runs along the line from camera to light.
    """
    if distance_mm is None:
        return to_light[:, None]
    cosine = np.sum(to_light * to_camera, axis=-1, keepdims=True)
    width = (to_light - cosine * to_camera)[:, :2]
    size = np.linalg.norm(width, axis=-1, keepdims=True)
    width = np.where(size > 1e-9, width / np.maximum(size, 1e-9), [1.0, 0.0])
    height = np.stack([-width[:, 1], width[:, 0]], axis=-1)
    on_sample = place[:, 0, None] * width[:, None] + place[:, 1, None] * height[:, None]  # (P, F, 2)
    way = distance_mm * to_light[:, None] - np.pad(on_sample, ((0, 0), (0, 0), (0, 1)))
    return np.asarray(way / np.linalg.norm(way, axis=-1, keepdims=True))


def _around(axis: FloatArray, disc: FloatArray) -> FloatArray:
    """(…, N, 3) unit vectors around axes (…, 1, 3), at direction cosines (N, 2) from them."""
    helper = np.where(np.abs(axis[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    first = np.cross(axis, helper)
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(axis, first)
    along = np.sqrt(1.0 - np.sum(disc**2, axis=-1))[:, None]
    return np.asarray(disc[:, :1] * first + disc[:, 1:] * second + along * axis)
