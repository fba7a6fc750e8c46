"""Contrasts of any two poses, and how they change with the radiances: of one tilt, or between two."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from anisoscope.recipe import ContrastKind

FloatArray = npt.NDArray[np.float64]
Pairs = Sequence[tuple[int, int]]


def pair_values(pairs: Pairs, radiance: FloatArray, kind: ContrastKind) -> FloatArray:
    """(N,) contrasts of N pairs of poses, first against second.

    Args:
        pairs: indices of the poses.
        radiance: (P,) of all poses, above 0.
        kind: ln ratio, Michelson contrast, or difference.
    """
    a, b = (radiance[list(side)] for side in zip(*pairs, strict=True))
    if kind == "log_ratio":
        return np.asarray(np.log(a / b))
    return np.asarray(a - b if kind == "difference" else (a - b) / (a + b))


def pair_gradient(pairs: Pairs, radiance: FloatArray, kind: ContrastKind) -> FloatArray:
    """(N, P) derivative of N contrasts with respect to ln L of every pose; arguments as for `pair_values`."""
    gradient = np.zeros((len(pairs), len(radiance)))
    for row, (i, j) in enumerate(pairs):
        a, b = radiance[i], radiance[j]
        if kind == "log_ratio":
            gradient[row, [i, j]] = 1.0, -1.0
        elif kind == "difference":
            gradient[row, [i, j]] = a, -b
        else:
            slope = 2.0 * a * b / (a + b) ** 2
            gradient[row, [i, j]] = slope, -slope
    return gradient
