"""The response curve of a camera whose counts are not linear: fitted from an exposure series of a still scene.

A pixel sees the same light in all frames, so g(z1)/t1 = g(z2)/t2 for its counts z at the exposures t, where g
turns counts into light. g is a sum of ramps with coefficients of 0 or more, hence monotone; the coefficients
solve these equations for many pixels by non-negative least squares, weighted by the noise of one count, with
g(black) = 0 and g(white) = 1. (After the idea of Mann and Picard, 1995; the linear form is ours.)
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import CalibrationError
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.base.toml_file import one_line
from anisoscope.rig.frame import Frame

Mask = npt.NDArray[np.bool_]

KNOTS = 33
LEAST_LEVEL = 0.03
MOST_CLIPPED = 0.98
_MOST_PIXELS = 200_000
_SMOOTHNESS = 3e-4
_SUM_WEIGHT = 1e3
_ROUNDS = 5
_LEAST_EQUATIONS = 50
_ANCHOR = 0.9
_GROUPS = 300
_MOSTLY = 0.99


@dataclass(frozen=True, eq=False)
class Series:
    """An exposure series.

    Attributes:
        levels: (exposures, pixels) counts as a share of the range: 0 is black, 1 is white.
        times_s: (exposures,) ascending.
        step: share of the range that is one count.
    """

    levels: FloatArray
    times_s: FloatArray
    step: float

    @cached_property
    def usable(self) -> Mask:
        """(exposures, pixels) neither nearly black nor clipped."""
        return np.asarray((self.levels > LEAST_LEVEL) & (self.levels < MOST_CLIPPED))


@dataclass(frozen=True, eq=False)
class Solution:
    """A curve: `light` of levels, 0 at 0 and 1 at 1; and how well the pixels agree on it."""

    light: Callable[[FloatArray], FloatArray]
    residual: float


@dataclass(frozen=True, eq=False)
class _Groups:
    """(groups, exposures) mean levels and whether they can be used; (groups, exposures, ramps) mean ramps."""

    levels: FloatArray
    ramps: FloatArray
    usable: Mask
    times_s: FloatArray


def solve(series: Series) -> Solution:
    """Solve for the curve.

    Raises:
        CalibrationError: hardly any place is neither black nor clipped in two neighbouring exposures.
    """
    groups = _grouped(series)
    usable = np.stack([series.usable[:, group].mean(axis=1) > _MOSTLY for group in groups])
    levels = np.stack([series.levels[:, group].mean(axis=1) for group in groups])
    ramps = np.stack([[_ramps(line).mean(axis=0) for line in series.levels[:, group]] for group in groups])
    if np.sum(usable[:, :-1] & usable[:, 1:]) < _LEAST_EQUATIONS:
        raise CalibrationError(
            "hardly any place is neither black nor clipped in two neighbouring exposures: choose exposures that "
            "lie closer together, and a scene with dark and bright places"
        )
    coefficients = np.full(KNOTS - 1, 1.0 / (KNOTS - 1))
    for _ in range(_ROUNDS):
        coefficients = _least_squares(_Groups(levels, ramps, usable, series.times_s), coefficients)
    return Solution(_curve(coefficients), _residual(ramps @ coefficients, usable, series.times_s))


def _grouped(series: Series) -> list[npt.NDArray[np.intp]]:
    """Pixels in groups of like brightness.

    One equation a group instead of one a pixel: the noise of single counts would bend the curve, since it
    stands in what multiplies the unknowns.
    """
    seen = np.flatnonzero(series.usable.sum(axis=0) > 1)
    ordered = seen[np.argsort(series.levels[:, seen].mean(axis=0), kind="stable")]
    if len(ordered) > _MOST_PIXELS:
        ordered = ordered[np.linspace(0, len(ordered) - 1, _MOST_PIXELS).astype(int)]
    return np.array_split(ordered, min(_GROUPS, len(ordered)))


def _ramps(levels: FloatArray) -> FloatArray:
    """(N, KNOTS − 1) ramps from 0 to 1, each over one piece between knots."""
    return np.clip(levels[:, None] * (KNOTS - 1) - np.arange(KNOTS - 1)[None, :], 0.0, 1.0)


def _least_squares(groups: _Groups, before: FloatArray) -> FloatArray:
    from scipy.optimize import nnls  # noqa: PLC0415 - slow to import

    normal = np.zeros((KNOTS - 1, KNOTS - 1))
    slope = np.maximum(before, 0.1 / (KNOTS - 1)) * (KNOTS - 1)
    piece = np.clip((groups.levels * (KNOTS - 1)).astype(int), 0, KNOTS - 2)
    rows = groups.ramps / groups.times_s[None, :, None]
    sigma = slope[piece] / groups.times_s
    for short in range(len(groups.times_s) - 1):
        both = groups.usable[:, short] & groups.usable[:, short + 1]
        weight = 1.0 / np.hypot(sigma[both, short], sigma[both, short + 1])
        weighted = (rows[both, short] - rows[both, short + 1]) * weight[:, None]
        normal += weighted.T @ weighted
    scale = np.trace(normal) / len(normal)
    bend = np.diff(np.eye(KNOTS - 1), n=2, axis=0)
    normal += _SMOOTHNESS * scale * bend.T @ bend
    root = np.linalg.cholesky(normal + 1e-12 * scale * np.eye(len(normal))).T
    # The equations leave the scale free. It is fixed where there are counts: fixed at white, which no usable
    # count reaches, the sum of squares would be least with all the light beyond the last count.
    top = np.quantile(groups.levels[groups.usable], _ANCHOR)
    anchor = _SUM_WEIGHT * np.sqrt(scale) * _ramps(np.array([top]))
    found, _ = nnls(np.vstack([root, anchor]), np.append(np.zeros(KNOTS - 1), _SUM_WEIGHT * np.sqrt(scale)))
    return np.asarray(found / found.sum())


def _curve(coefficients: FloatArray) -> Callable[[FloatArray], FloatArray]:
    from scipy.interpolate import PchipInterpolator  # noqa: PLC0415 - slow to import

    inside = PchipInterpolator(np.linspace(0.0, 1.0, KNOTS), np.append(0.0, np.cumsum(coefficients)))
    first_slope = float(coefficients[0]) * (KNOTS - 1)

    def light(levels: FloatArray) -> FloatArray:
        """Below black the curve goes on as it begins, so that noise about black stays even."""
        within = np.asarray(inside(np.clip(levels, 0.0, 1.0)))
        return np.where(levels < 0.0, first_slope * levels, within)

    return light


def _residual(light: FloatArray, usable: Mask, times_s: FloatArray) -> float:
    """Relative rms disagreement of the exposures about the (groups, exposures) light of like pixels."""
    exposed_s = np.where(usable, times_s, 0.0).sum(axis=1)
    several = usable.sum(axis=1) > 1
    rate = np.where(usable, light, 0.0)[several].sum(axis=1) / exposed_s[several]
    deviation = light[several] / (rate[:, None] * times_s) - 1.0
    return float(np.sqrt(np.mean(deviation[usable[several]] ** 2)))


LINEAR_BITS = 16
LINEAR_BLACK = 1024
"""Counts that stand for no light after linearising, so that noise about black is not cut off."""
_LINEAR_FULL = (1 << LINEAR_BITS) - 1
_LEAST_EXPOSURES = 3
_LEAST_COVERED = 0.85
_MOST_LOWEST = 0.15


class ResponseCurve(BaseModel):
    """Response curve, as in its file.

    Attributes:
        camera: serial number of the camera.
        bit_depth: bits of its counts.
        black_level: counts without light.
        white_level: counts at which it clips.
        light: for every count from 0, light relative to that at `white_level`; never falling.
        residual: relative deviation (rms) of the light of like pixels between the exposures, as the curve sees it.
        exposures_s: exposures from which it was fitted.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    kind: Literal["camera response"] = "camera response"
    camera: str
    bit_depth: Annotated[int, Field(ge=1, le=12)]
    black_level: Annotated[float, Field(ge=0.0)]
    white_level: Annotated[int, Field(gt=0)]
    light: tuple[float, ...]
    residual: Annotated[float, Field(ge=0.0)]
    exposures_s: tuple[float, ...]

    @model_validator(mode="after")
    def _is_a_curve(self) -> "ResponseCurve":
        if len(self.light) != 1 << self.bit_depth:
            raise ValueError(f"light needs {1 << self.bit_depth} values, not {len(self.light)}")
        if np.any(np.diff(self.light) < 0.0):
            raise ValueError("light falls somewhere; more counts are never less light")
        if not self.black_level < self.white_level < 1 << self.bit_depth:
            raise ValueError("white_level must lie above black_level and within the bit depth")
        return self

    def linearise(self, counts: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]) -> npt.NDArray[np.uint16]:
        """Linear counts of 16 bits with black at `LINEAR_BLACK`; what is clipped becomes 65535.

        Args:
            counts: raw counts of the camera, any shape.
        """
        scaled = LINEAR_BLACK + np.asarray(self.light) * (_LINEAR_FULL - LINEAR_BLACK)
        table = np.clip(np.rint(scaled), 0, _LINEAR_FULL).astype(np.uint16)
        table[self.white_level :] = _LINEAR_FULL
        return np.asarray(table[counts])


@dataclass(frozen=True)
class _Averaged:
    """Mean counts of the frames of one exposure."""

    time_s: float
    counts: npt.NDArray[np.float64]


def fit_response(
    frames: Sequence[Frame],
    darks: Sequence[Frame] = (),
    *,
    white_level: int | None = None,
    most_residual: float = 0.05,
) -> ResponseCurve:
    """Fit the response curve.

    The scene has to hold dark and bright places, and each exposure some that are neither black nor clipped: from
    an exposure at which the brightest place just clips down to a sixteenth of it, in steps of 2 or less.

    Args:
        frames: raw frames of a still scene under steady light, three exposures or more, gain unchanged.
        darks: frames with the light off; their mean is black. The frames' black level if there are none.
        white_level: counts at which the camera clips; full scale if not given.
        most_residual: largest residual that is accepted.

    Raises:
        CalibrationError: too few exposures, counts that are not covered, or frames that do not agree: the scene
            moved, the light changed, or auto exposure was on.
    """
    averaged = _averaged(frames)
    first = frames[0]
    white = first.full_scale if white_level is None else white_level
    black = float(np.mean([frame.counts.mean() for frame in darks])) if darks else first.black_level
    codes: npt.NDArray[np.float64] = np.stack([one.counts.reshape(-1) for one in averaged])
    series = Series(
        levels=np.asarray((codes - black) / (white - black), dtype=np.float64),
        times_s=np.array([one.time_s for one in averaged]),
        step=1.0 / (white - black),
    )
    _check_covered(series)
    solution = solve(series)
    if solution.residual > most_residual:
        raise CalibrationError(
            f"the frames do not agree with any response curve: the light of a place changes by "
            f"{100 * solution.residual:.1f} % with the exposure; the scene moved, the light changed, auto "
            "exposure was on, or black is not what was said (give dark frames)"
        )
    counts = np.arange(first.full_scale + 1)
    return ResponseCurve(
        camera=first.camera,
        bit_depth=first.bit_depth,
        black_level=black,
        white_level=white,
        light=tuple(
            float(value)
            for value in solution.light(np.asarray((counts - black) / (white - black), dtype=np.float64))
        ),
        residual=solution.residual,
        exposures_s=tuple(one.time_s for one in averaged),
    )


def write_response(path: Path, curve: ResponseCurve) -> None:
    """Write a curve as JSON.

    Raises:
        RecordError: the file cannot be written.
    """
    write_text(path, json.dumps(curve.model_dump(by_alias=True), indent=1) + "\n")


def read_response(path: Path) -> ResponseCurve:
    """Read a curve.

    Raises:
        CalibrationError: there is no such file, or it is no curve.
    """
    try:
        return ResponseCurve.model_validate_json(bounded_bytes(path))
    except OSError as problem:
        raise CalibrationError(f"{path}: cannot be read: {problem.strerror or problem}") from problem
    except ValidationError as problem:
        raise CalibrationError(
            f"{path}: not a response curve: {one_line(problem, ResponseCurve)}"
        ) from problem


def _averaged(frames: Sequence[Frame]) -> list[_Averaged]:
    times = sorted({frame.exposure_s for frame in frames})
    if len(times) < _LEAST_EXPOSURES:
        raise CalibrationError(
            f"a response curve needs frames at {_LEAST_EXPOSURES} exposures or more, not {len(times)}"
        )
    first = frames[0]
    for frame in frames:
        if (frame.counts.shape, frame.gain, frame.bit_depth) != (
            first.counts.shape,
            first.gain,
            first.bit_depth,
        ):
            raise CalibrationError("the frames of an exposure series differ in size, gain or bit depth")
    return [
        _Averaged(
            time_s, np.mean([f.counts for f in frames if f.exposure_s == time_s], axis=0, dtype=np.float64)
        )
        for time_s in times
    ]


def _check_covered(series: Series) -> None:
    good = series.usable & (series.usable.sum(axis=0) > 1)
    if not good.any():
        raise CalibrationError(
            "no pixel is neither black nor clipped in two exposures: choose exposures that lie closer together"
        )
    low, high = float(series.levels[good].min()), float(series.levels[good].max())
    if low > _MOST_LOWEST or high < _LEAST_COVERED:
        raise CalibrationError(
            f"the frames cover only {100 * low:.0f} % to {100 * high:.0f} % of the range of counts; take more "
            f"exposures, so that it is {100 * _MOST_LOWEST:.0f} % to {100 * min(_LEAST_COVERED, MOST_CLIPPED):.0f} %"
        )
