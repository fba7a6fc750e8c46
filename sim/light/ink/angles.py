"""Angles of the ink model: the half vector, and the half of the sum of both inclinations.

The frame of the surface: z is its normal. Source: Pranovich 2024, Eqs. 1 and 6.
"""

import numpy as np

from anisoscope.base.arrays import FloatArray


def half_vector(to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
    """(…, 3) unit vectors halfway between (…, 3) unit vectors (Eq. 1); zero between opposite ones, which have none."""
    total = np.asarray(to_light) + np.asarray(to_camera)
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=-1, keepdims=True), 1e-12))


def cos_half_sum(cos_i: FloatArray, cos_o: FloatArray) -> FloatArray:
    """cos((θi + θo)/2) from the two cosines (Eq. 6).

    The cosines are cut to [0, 1] first: rounding takes dot products of unit vectors beyond 1, where Eq. 6 is NaN.
    """
    i, o = np.clip(cos_i, 0.0, 1.0), np.clip(cos_o, 0.0, 1.0)
    return np.asarray(0.5 * (np.sqrt((1.0 + i) * (1.0 + o)) - np.sqrt((1.0 - i) * (1.0 - o))))


def shift(cos_i: FloatArray, cos_o: FloatArray) -> FloatArray:
    """Shift x = 1 − cos((θi + θo)/2), from 0 (head-on) to 1 (grazing): what an ink's colour depends on."""
    return np.asarray(1.0 - cos_half_sum(cos_i, cos_o))


def in_plane(theta_deg: FloatArray, side: float = 1.0) -> FloatArray:
    """(…, 3) unit vectors in the xz plane at inclinations in degrees, toward +x for ``side`` 1."""
    theta = np.radians(np.asarray(theta_deg, dtype=np.float64))
    return np.stack([side * np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1)


def goniometer(theta_i_deg: FloatArray, theta_o_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(…, 3) unit vectors to light and camera of an in-plane goniometer.

    θo counts from the normal away from the light: θo = θi is the mirror direction, θo = −θi the light's own.
    """
    i, o = np.broadcast_arrays(np.asarray(theta_i_deg, dtype=np.float64), theta_o_deg)
    return in_plane(i, -1.0), in_plane(o)
