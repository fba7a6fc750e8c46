"""Uncertainty of contrasts from the covariance of the pose radiances."""

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.geometry import Pose
from anisoscope.prediction.sensitivity import DARK
from anisoscope.sim.light.contrasts import consecutive_pairs

KINDS = ("difference", "michelson", "log_ratio")


def contrast_values(poses: tuple[Pose, ...], radiance: FloatArray, kind: str) -> FloatArray:
    """(…, C) contrasts of radiances (…, P); infinite or NaN where a dark pose leaves them undefined."""
    pairs = np.array(consecutive_pairs(poses), dtype=np.intp).reshape(-1, 2)
    first, second = radiance[..., pairs[:, 0]], radiance[..., pairs[:, 1]]
    if kind == "difference":
        return np.asarray(first - second)
    with np.errstate(divide="ignore", invalid="ignore"):
        if kind == "michelson":
            return np.asarray((first - second) / (first + second))
        return np.asarray(np.log(first / second))


def contrast_gradient(
    poses: tuple[Pose, ...], radiance: FloatArray, kind: str
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Derivative of every contrast with respect to the radiance of every pose.

    Returns:
        (C, P) derivatives, zero where there are none, and (C,) True where there are: not in the dark (1e-9 1/sr).
    """
    pairs = consecutive_pairs(poses)
    gradient = np.zeros((len(pairs), len(poses)))
    defined = np.ones(len(pairs), dtype=np.bool_)
    for row, (i, j) in enumerate(pairs):
        a, b = float(radiance[i]), float(radiance[j])
        if kind == "difference":
            gradient[row, [i, j]] = 1.0, -1.0
        elif kind == "michelson":
            defined[row] = a + b > DARK
            if defined[row]:
                gradient[row, [i, j]] = 2.0 * b / (a + b) ** 2, -2.0 * a / (a + b) ** 2
        else:
            defined[row] = min(a, b) > DARK
            if defined[row]:
                gradient[row, [i, j]] = 1.0 / a, -1.0 / b
    return gradient, defined


def contrast_covariance(
    poses: tuple[Pose, ...], radiance: FloatArray, covariance: FloatArray, kind: str
) -> FloatArray:
    """Covariance of the contrasts of consecutive poses, to first order.

    Args:
        poses: P poses.
        radiance: (P,) in 1/sr.
        covariance: (P, P) of the radiances in 1/sr².
        kind: "difference", "michelson" or "log_ratio".

    Returns:
        (C, C); of a contrast that a dark pose leaves undefined the variance is infinite and the covariances are 0.
    """
    gradient, defined = contrast_gradient(poses, radiance, kind)
    found = gradient @ covariance @ gradient.T
    found[~defined, ~defined] = np.inf
    return np.asarray(found)
