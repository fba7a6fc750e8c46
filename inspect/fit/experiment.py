"""The published experiment as a problem for the fit: one plastic, one scale, four ridge angles."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.experiment.experiment import PAIRS_DEG, RIDGE_ANGLES_DEG, STAGE_DEG, TILTS_DEG, combinations
from anisoscope.fit.problem import Problem, Readings, Scene
from anisoscope.fit.table import UNKNOWN
from anisoscope.sim.light.geometry import Convention, directions, pose_grid


def experiment_problem(
    measured: FloatArray,
    convention: Convention,
    optics: Mapping[str, Any],
    values: Mapping[str, float],
    free: tuple[str, ...],
) -> Problem:
    """A problem from measured absolute contrasts.

    Args:
        measured: (ridge angle, tilt, pair) contrasts, NaN where not measured (`measuredtable.read_measured`).
        convention: how the angles are counted.
        optics: keywords of `Scene`: model, bounces, wall, internal_reflection.
        values: all parameters.
        free: the free ones.

    Raises:
        UsageError: a parameter cannot be free, or too few contrasts are given.
    """
    grid = pose_grid(STAGE_DEG, TILTS_DEG)
    poses = grid * len(RIDGE_ANGLES_DEG)
    to_light, to_camera = directions(poses, convention)
    angles = np.repeat(RIDGE_ANGLES_DEG, len(grid))
    scene = Scene(to_light, to_camera, ridge_angles_deg=angles, poses=poses, convention=convention, **optics)
    first, labels, value = [], [], []
    for (a, t, p), (angle, tilt, start, end) in combinations():
        if np.isfinite(measured[a, t, p]):
            first.append((a * len(TILTS_DEG) + t) * len(STAGE_DEG) + STAGE_DEG.index(PAIRS_DEG[p][0]))
            labels.append(f"{angle:g}°: {start:g}°/{end:g}° @ {tilt:g}°")
            value.append(measured[a, t, p])
    index, contrast = np.array(first), np.array(value)
    scale = float(np.mean(contrast**2)) or 1.0
    words = f"{UNKNOWN}, equal for all contrasts and independent"
    readings = Readings(
        "absolute", index, index + 1, contrast, scale * np.eye(index.size), False, tuple(labels), words
    )
    return Problem(scene, readings, values, free)
