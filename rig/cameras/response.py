"""The response curve of a camera whose counts are not linear: fitted from an exposure series of a still scene.

A pixel sees the same light in all frames, so g(z1)/t1 = g(z2)/t2 for its counts z at the exposures t, where g
turns counts into light. g is a sum of ramps with coefficients of 0 or more, hence monotone; the coefficients
solve these equations for many pixels by non-negative least squares, weighted by the noise of one count, with
g(black) = 0 and g(white) = 1. (After the idea of Mann and Picard, 1995; the linear form is ours.)
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import CalibrationError
from anisoscope.rig.cameras.responsefit import MOST_CLIPPED, Series, solve
from anisoscope.rig.frame import Frame

LINEAR_BITS = 16
LINEAR_BLACK = 1024
"""Counts that stand for no light after linearising, so that noise about black is not cut off."""
_LINEAR_FULL = (1 << LINEAR_BITS) - 1
_LEAST_EXPOSURES = 3
_LEAST_COVERED = 0.85
_MOST_LOWEST = 0.15


class ResponseCurve(BaseModel):
    """A response curve, as it stands in its file.

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
        return ResponseCurve.model_validate_json(path.read_bytes())
    except OSError as problem:
        raise CalibrationError(f"{path}: cannot be read: {problem.strerror or problem}") from problem
    except ValidationError as problem:
        mistake = problem.errors(include_url=False)[0]
        where = ".".join(str(part) for part in mistake["loc"])
        text = mistake["msg"].removeprefix("Value error, ")
        raise CalibrationError(
            f"{path}: not a response curve: {where + ': ' if where else ''}{text}"
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
