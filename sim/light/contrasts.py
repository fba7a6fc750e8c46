"""Contrasts between stage angles, and the scale k between predicted and measured exposures."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.geometry import Pose


@dataclass(frozen=True)
class Contrast:
    """Signed contrasts of one pair of stage angles at one tilt.

    Attributes:
        from_deg: first stage angle.
        to_deg: second stage angle.
        tilt_deg: tilt of camera and light.
        difference: L_from − L_to, in the unit of the radiances (the paper's contrast is its absolute value).
        michelson: (L_from − L_to)/(L_from + L_to), dimensionless.
        log_ratio: ln(L_from/L_to), dimensionless.
    """

    from_deg: float
    to_deg: float
    tilt_deg: float
    difference: float
    michelson: float
    log_ratio: float


def consecutive_pairs(poses: tuple[Pose, ...]) -> tuple[tuple[int, int], ...]:
    """Indices of consecutive poses that share a tilt."""
    return tuple((i, j) for i, j in pairwise(range(len(poses))) if poses[i].tilt_deg == poses[j].tilt_deg)


def contrasts(poses: tuple[Pose, ...], radiance: FloatArray) -> tuple[Contrast, ...]:
    """Contrasts of consecutive stage angles; a ratio with a dark pose is infinite, of two dark ones NaN.

    Args:
        poses: P poses.
        radiance: (P,) values.
    """
    found = []
    for i, j in consecutive_pairs(poses):
        first, second = float(radiance[i]), float(radiance[j])
        with np.errstate(divide="ignore", invalid="ignore"):
            michelson = float(np.divide(first - second, first + second))
            ratio = float(np.log(np.divide(first, second)))
        found.append(
            Contrast(
                poses[i].stage_deg, poses[j].stage_deg, poses[i].tilt_deg, first - second, michelson, ratio
            )
        )
    return tuple(found)


def fit_scale(predicted: FloatArray, measured: FloatArray) -> float:
    """The one global k that brings predicted values closest to measured ones (least squares)."""
    return float(np.dot(predicted, measured) / np.dot(predicted, predicted))
