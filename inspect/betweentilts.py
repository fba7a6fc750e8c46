"""Contrasts of one stage angle between two tilts: a spike, or a lobe that is too wide, changes those and no others."""

from collections.abc import Iterator

import numpy as np

from anisoscope.expectation import Expectation
from anisoscope.measurement import Measured
from anisoscope.significance import holm, two_sided
from anisoscope.sim.light.geometry import Pose


def deviating(expected: Expectation, measured: Measured, alpha: float) -> tuple[str, ...]:
    """Names of the ln ratios between the first tilt and another one that deviate by themselves, at one level (Holm).

    Args:
        expected: prediction with its uncertainty components.
        measured: measurement with its uncertainty components.
        alpha: level of all together.
    """
    pairs = tuple(_pairs(expected.poses))
    if not pairs:
        return ()
    off = np.log(measured.radiance / expected.radiance)
    components = expected.components + measured.components
    covariance = np.sum([component.covariance() for component in components], axis=0)
    i, j = np.array(pairs).T
    variance = covariance[i, i] + covariance[j, j] - 2.0 * covariance[i, j]
    u, change = np.sqrt(np.maximum(variance, 0.0)), off[i] - off[j]
    z = np.divide(change, u, out=np.where(change == 0.0, 0.0, np.inf), where=u > 0.0)
    return tuple(
        f"{expected.poses[a].stage_deg:g}° between tilt {expected.poses[a].tilt_deg:g}° and "
        f"{expected.poses[b].tilt_deg:g}° (ln ratio off by {change[k]:+.3f}, u {u[k]:.3f})"
        for k, (a, b) in enumerate(pairs)
        if holm(two_sided(z))[k] < alpha
    )


def _pairs(poses: tuple[Pose, ...]) -> Iterator[tuple[int, int]]:
    """Every pose beside the first one at its stage angle."""
    first: dict[float, int] = {}
    for number, pose in enumerate(poses):
        if pose.stage_deg in first:
            yield first[pose.stage_deg], number
        else:
            first[pose.stage_deg] = number
