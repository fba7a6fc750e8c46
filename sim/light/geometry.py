"""Poses and directions: how sample, light and camera stand to each other.

Sample frame at stage angle 0: z up, ridges along +y, the large facets lean toward +x. The stage turns the
sample counter-clockwise as the camera sees it. The light stands ``light_angle_deg`` from the camera, and
both tilt together; in which plane is the convention that the ridge paper (Luongo et al. 2017, Fig. 7) leaves
open. Only ``tilt_plane="perpendicular"`` with the facets facing the light reproduces its findings.
"""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.parameters.geometry import Convention, Pose


def pose_grid(angles_deg: tuple[float, ...], tilts_deg: tuple[float, ...] = (0.0,)) -> tuple[Pose, ...]:
    """Every stage angle at every tilt; stage angles run fastest."""
    return tuple(Pose(angle, tilt) for tilt in tilts_deg for angle in angles_deg)


def _turn_about_z(vectors: FloatArray, angle_rad: FloatArray) -> FloatArray:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    x, y, z = vectors.T
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)


def directions(poses: tuple[Pose, ...], convention: Convention) -> tuple[FloatArray, FloatArray]:
    """Unit vectors to the light and to the camera, in the frame of the sample.

    Args:
        poses: P poses.
        convention: how the angles are counted.

    Returns:
        ``to_light``, ``to_camera``: each (P, 3).

    Raises:
        ModelError: light or camera stands at or below the horizon of the sample in some pose.
    """
    stage = np.radians([pose.stage_deg for pose in poses])
    tilt = np.radians([pose.tilt_deg for pose in poses])
    light = np.radians(convention.light_angle_deg)
    if convention.tilt_plane == "perpendicular":
        to_camera = np.stack([np.zeros_like(tilt), -np.sin(tilt), np.cos(tilt)], axis=-1)
        to_light = np.stack(
            [np.full_like(tilt, np.sin(light)), -np.cos(light) * np.sin(tilt), np.cos(light) * np.cos(tilt)],
            axis=-1,
        )
    else:
        to_camera = np.stack([np.sin(tilt), np.zeros_like(tilt), np.cos(tilt)], axis=-1)
        to_light = np.stack([np.sin(tilt + light), np.zeros_like(tilt), np.cos(tilt + light)], axis=-1)
    for name, vectors in (("light", to_light), ("camera", to_camera)):
        low = vectors[:, 2] < 1e-3
        if low.any():
            pose = poses[int(np.argmax(low))]
            raise ModelError(
                f"at tilt {pose.tilt_deg:g}° the {name} stands at or below the horizon of the sample"
            )
    sense = 1.0 if convention.rotation_sense == "ccw" else -1.0
    turn = -(sense * stage + np.radians(convention.facet_azimuth_deg))
    return _turn_about_z(to_light, turn), _turn_about_z(to_camera, turn)


def seating_rotation(about_x_deg: float | FloatArray, about_y_deg: float | FloatArray) -> FloatArray:
    """(…, 3, 3) rotation of a sample seated askew by small turns about its x and, before that, its y axis.

    ``to_light @ rotation`` and ``to_camera @ rotation`` are the directions that such a sample sees.

    Args:
        about_x_deg: (…) turns about x.
        about_y_deg: (…) turns about y.
    """
    about_x, about_y = np.broadcast_arrays(np.radians(about_x_deg), np.radians(about_y_deg))
    cos_x, sin_x, cos_y, sin_y = np.cos(about_x), np.sin(about_x), np.cos(about_y), np.sin(about_y)
    rotation = np.zeros((*about_x.shape, 3, 3))
    rotation[..., 0, 0], rotation[..., 0, 2] = cos_y, sin_y
    rotation[..., 1, 0], rotation[..., 1, 1], rotation[..., 1, 2] = sin_x * sin_y, cos_x, -sin_x * cos_y
    rotation[..., 2, 0], rotation[..., 2, 1], rotation[..., 2, 2] = -cos_x * sin_y, sin_x, cos_x * cos_y
    return rotation
