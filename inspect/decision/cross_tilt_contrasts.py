"""Contrasts of one stage angle between two tilts, which reveal a spike or an excessive lobe width."""

from collections.abc import Iterator, Sequence

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.significance import holm, two_sided
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.prediction.expectation import Component, Expectation
from anisoscope.recipe.surface import ContrastKind
from anisoscope.record.schema import TiltContrastRecord
from anisoscope.sim.light.geometry import Pose

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


def between_tilts(
    expected: Expectation, measured: Measured, kind: ContrastKind
) -> tuple[TiltContrastRecord, ...]:
    """The contrasts of every stage angle between the first tilt and each other one, in the order of the poses.

    Args:
        expected: prediction with its uncertainty components.
        measured: measurement with its uncertainty components.
        kind: of contrast.
    """
    pairs = tuple(_pairs(expected.poses))
    if not pairs:
        return ()
    measured_values, predicted_values = (
        pair_values(pairs, side.radiance, kind) for side in (measured, expected)
    )
    components = expected.components + measured.components
    u_contrast = _spread(pairs, measured.radiance, kind, [c for c in components if c.kind == "measurement"])
    u_predicted = _spread(pairs, expected.radiance, kind, [c for c in components if c.kind != "measurement"])
    u = np.hypot(u_contrast, u_predicted)
    adjusted = holm(two_sided(_by_u(measured_values - predicted_values, u)))
    poses = expected.poses
    return tuple(
        TiltContrastRecord(
            stage_deg=poses[i].stage_deg,
            from_tilt_deg=poses[i].tilt_deg,
            to_tilt_deg=poses[j].tilt_deg,
            kind=kind,
            measured=measured_values[k],
            predicted=predicted_values[k],
            u_measured=u_contrast[k],
            u_predicted=u_predicted[k],
            u=u[k],
            p_value=adjusted[k],
        )
        for k, (i, j) in enumerate(pairs)
    )


def deviating(expected: Expectation, measured: Measured, alpha: float) -> tuple[str, ...]:
    """Names of the individually significant ln ratios between the first tilt and another one, at one level (Holm).

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
    adjusted = holm(two_sided(_by_u(change, u)))
    return tuple(
        f"{expected.poses[a].stage_deg:g}° between tilt {expected.poses[a].tilt_deg:g}° and "
        f"{expected.poses[b].tilt_deg:g}° (ln ratio off by {change[k]:+.3f}, u {u[k]:.3f})"
        for k, (a, b) in enumerate(pairs)
        if adjusted[k] < alpha
    )


def _spread(
    pairs: tuple[tuple[int, int], ...], radiance: FloatArray, kind: ContrastKind, components: list[Component]
) -> FloatArray:
    """(N,) standard uncertainties of contrasts from components."""
    gradient = pair_gradient(pairs, radiance, kind)
    total = np.zeros((len(radiance), len(radiance)))
    for component in components:
        total += component.covariance()
    return np.sqrt(np.maximum(np.diag(gradient @ total @ gradient.T), 0.0))


def _by_u(change: FloatArray, u: FloatArray) -> FloatArray:
    """Deviations in standard uncertainties; infinite where a deviating value has no uncertainty."""
    return np.divide(change, u, out=np.where(change == 0.0, 0.0, np.inf), where=u > 0.0)


def _pairs(poses: tuple[Pose, ...]) -> Iterator[tuple[int, int]]:
    """Pairs of every pose with the first one at its stage angle."""
    first: dict[float, int] = {}
    for number, pose in enumerate(poses):
        if pose.stage_deg in first:
            yield first[pose.stage_deg], number
        else:
            first[pose.stage_deg] = number
