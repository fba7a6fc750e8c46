"""Identifiability of the parameters from the Fisher information, checked before reporting.

The information includes the noise of the data and, for every pose, an error of the model itself (`MODEL_SHARE`): a
parameter whose effect is below the model error is not determined, however low the noise. Parameters are scaled to
their limits (`parameters`), so that an eigenvalue below 1 belongs to a combination that the data do not determine.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import signed, whitening
from anisoscope.fit.parameters import PARAMETERS
from anisoscope.fit.problem import Problem, Readings, interface_alpha
from anisoscope.parameters.geometry import Pose
from anisoscope.sim.light.contrasts import consecutive_pairs
from anisoscope.sim.light.geometry import directions, pose_grid

MODEL_SHARE = 0.01  # of every radiance; a lobe that scatters once loses 2 to 3 % of it at alpha up to 0.1
QUIETER = 0.1
_FINITE = 1e-7  # singular values below this share of the largest are finite-difference noise
_VISIBLE = 0.1  # least weight in a combination that is named


@dataclass(frozen=True)
class Combination:
    """Free parameters that the data determine only together, or not at all.

    Attributes:
        parts: (name, weight) in units of the limits of the parameters; the squares add up to about 1.
        spread: standard uncertainty of the combination in the same units; above 1 it is not determined.
    """

    parts: tuple[tuple[str, float], ...]
    spread: float

    @property
    def words(self) -> str:
        """The combination in words."""
        text = " ".join(f"{weight:+.2f}·{PARAMETERS[name].words}" for name, weight in self.parts).replace(
            "-", "−"
        )
        size = "not at all" if self.spread > 1e4 else f"only to {self.spread:.2g} times the limit"
        return f"{text.removeprefix('+')} ({size})"


@dataclass(frozen=True, eq=False)
class Information:
    """Fisher information of the data on the free parameters.

    Attributes:
        names: p free parameters.
        uncertainty: (p,) standard uncertainties in units of the limits.
        correlation: (p, p).
        combinations: what is not determined, worst first.
    """

    names: tuple[str, ...]
    uncertainty: FloatArray
    correlation: FloatArray
    combinations: tuple[Combination, ...]

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of the parameters that are not determined."""
        return tuple(n for n, u in zip(self.names, self.uncertainty, strict=True) if u > 1.0)


def derivatives(
    problem: Problem, values: Mapping[str, float], interface: float | None = None, *, ahead: float = 0.0
) -> FloatArray:
    """(N, p) derivative of the values by the internal free parameters, by central differences.

    With `interface` the table of the interface stays as it is; `ahead` takes one-sided differences instead, over this
    share of the steps.
    """
    table = interface_alpha(values) if interface is None else interface
    middle = problem.predicted(values, table) if ahead or "k" in problem.free else np.zeros(0)
    columns = []
    for name in problem.free:
        if name == "k":  # the values are proportional to it
            columns.append(middle)
            continue
        one = PARAMETERS[name]
        here, (low, high) = one.internal(values[name]), one.bounds
        step = one.step * (ahead or 1.0)
        ends = max(here - step, low), min(here + step, high)
        if ahead:
            ends = (here, ends[1]) if ends[1] > here else (here, ends[0])
        sides = [
            middle
            if ahead and end == here
            else problem.predicted(dict(values) | {name: one.external(end)}, table)
            for end in ends
        ]
        columns.append((sides[1] - sides[0]) / (ends[1] - ends[0]))
    return np.stack(columns, axis=1) if columns else np.zeros((len(problem.readings.value), 0))


def scaled_covariance(sensitivity: FloatArray) -> FloatArray:
    """(p, p) covariance from a whitened (R, p) sensitivity; directions without information get a huge one."""
    _, size, turn = _svd(sensitivity)
    return np.asarray((turn.T / size**2) @ turn)


def _svd(sensitivity: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    rows, columns = sensitivity.shape
    padded = np.vstack([sensitivity, np.zeros((max(columns - rows, 0), columns))])
    left, size, turn = np.linalg.svd(padded, full_matrices=False)
    floor = max(_FINITE * float(size[0]) if size.size else 0.0, 1e-12)
    return left, np.maximum(size, floor), turn


def limits(names: tuple[str, ...]) -> FloatArray:
    """(p,) internal limits of parameters."""
    return np.array([PARAMETERS[name].limit for name in names])


def _sensitivity(
    problem: Problem, values: Mapping[str, float], noise: FloatArray, slope: FloatArray | None = None
) -> FloatArray:
    """Whitened derivatives in units of the limits, with the error of the model in the noise."""
    radiance = problem.scene.radiance(values, interface_alpha(values))
    slopes = problem.readings.by_log_radiance(radiance, values["k"])
    total = noise + MODEL_SHARE**2 * slopes @ slopes.T
    slope = derivatives(problem, values) if slope is None else slope
    return whitening(total) @ slope * limits(problem.free)


def _information_of(names: tuple[str, ...], sensitivity: FloatArray) -> Information:
    covariance = scaled_covariance(sensitivity)
    uncertainty = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(uncertainty, uncertainty)
    _, size, turn = _svd(sensitivity)
    lacking = []
    for strength, vector in sorted(zip(size, turn, strict=True), key=lambda pair: float(pair[0])):
        if strength < 1.0 and np.any(uncertainty > 1.0):
            weights = signed(vector)
            parts = tuple((n, float(w)) for n, w in zip(names, weights, strict=True) if abs(w) > _VISIBLE)
            lacking.append(Combination(parts, float(1.0 / strength)))
    return Information(names, uncertainty, correlation, tuple(lacking))


def information(
    problem: Problem, values: Mapping[str, float], noise: FloatArray, slope: FloatArray | None = None
) -> Information:
    """Information of the readings on the free parameters near these values.

    Args:
        problem: what is fitted.
        values: all parameters.
        noise: (N, N) covariance of the values; of zeros, only the model's error counts.
        slope: `derivatives` there, where they are known.
    """
    return _information_of(problem.free, _sensitivity(problem, values, noise, slope))


def helping_measurement(problem: Problem, values: Mapping[str, float], noise: FloatArray) -> str | None:
    """Smallest measurement from a short list that determines all free parameters, or None.

    Each candidate is computed: same kind of value, same noise per pose as the data show, together with the data; last
    the same poses with less noise. Only for poses of a stage.
    """
    scene = problem.scene
    if not scene.poses or scene.convention is None:
        return None
    radiance = scene.radiance(values, interface_alpha(values))
    slopes = problem.readings.by_log_radiance(radiance, values["k"])
    weight = np.sum(slopes**2, axis=1)
    relative = np.median(np.diag(noise)[weight > 0] / weight[weight > 0]) if np.any(weight > 0) else 0.0
    here = _sensitivity(problem, values, noise)
    for words, poses in _candidates(scene.poses):
        to_light, to_camera = directions(poses, scene.convention)
        extra = replace(
            scene,
            to_light=to_light,
            to_camera=to_camera,
            poses=poses,
            ridge_angles_deg=None,
            bounces=2 if scene.follows else scene.bounces,  # a sensitivity needs no more
            higher=None,
        )
        readings = _imagined(problem.readings, poses)
        trial = replace(problem, scene=extra, readings=readings)
        light = extra.radiance(values, interface_alpha(values))
        own = readings.by_log_radiance(light, values["k"])
        enlarged = _sensitivity(trial, values, float(relative) * own @ own.T)
        if not _information_of(problem.free, np.vstack([here, enlarged])).undetermined:
            return words
    quiet = information(problem, values, QUIETER**2 * noise)
    return None if quiet.undetermined else "the same poses with a tenth of the noise"


def _candidates(poses: tuple[Pose, ...]) -> list[tuple[str, tuple[Pose, ...]]]:
    tilts = tuple(sorted({pose.tilt_deg for pose in poses}))
    quarter, eighth = (0.0, 90.0, 180.0, 270.0), tuple(np.arange(0.0, 360.0, 45.0))
    wide = (-20.0, -10.0, 0.0, 10.0, 20.0)
    return [
        ("stage angles 0, 90, 180 and 270° at the tilts measured", pose_grid(quarter, tilts)),
        ("stage angles every 45° at the tilts measured", pose_grid(eighth, tilts)),
        ("stage angles 0, 90, 180 and 270° at tilts −20, −10, 0, 10 and 20°", pose_grid(quarter, wide)),
        ("stage angles every 45° at tilts −20, −10, 0, 10 and 20°", pose_grid(eighth, wide)),
    ]


def _imagined(readings: Readings, poses: tuple[Pose, ...]) -> Readings:
    pairs = consecutive_pairs(poses)
    single = readings.kind in ("exposure", "brdf")
    first = np.arange(len(poses)) if single else np.array([i for i, _ in pairs])
    second = first if single else np.array([j for _, j in pairs])
    size = len(first)
    return replace(
        readings,
        first=first,
        second=second,
        value=np.ones(size),
        covariance=np.eye(size),
        noise_known=True,
        labels=("",) * size,
        gain=None,
    )
