"""What the score does around an optimum: along every parameter, and over the whole grid."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.progress import Advance
from anisoscope.study.box import Box, score_of_task, value_of
from anisoscope.study.objective import Scoring
from anisoscope.study.sweep import Workers, sweep

FloatArray = npt.NDArray[np.float64]

FLAT_SHARE = 0.01  # a parameter is flat if its whole range changes the score by less
COST_SHARE = 0.01  # the interval of a parameter is where the score loses at most this
SLICE_POINTS = 49
_AT_BOUND = 1e-3  # of the range
_HALVINGS = 12


@dataclass(frozen=True)
class Slice:
    """The score along one parameter, the others at the optimum.

    Attributes:
        name: the parameter.
        values: where.
        scores: the scores there.
        kept: interval within which the score loses at most COST_SHARE; bounds where it never loses that much.
        flat: the score changes by less than FLAT_SHARE over the whole range.
        at_bound: "lower" or "upper" where the optimum stands there, else None.
        sampling_sd: standard deviation of the optimum between samples of the tolerances, None without any.
    """

    name: str
    values: tuple[float, ...]
    scores: tuple[float, ...]
    kept: tuple[float, float]
    flat: bool
    at_bound: str | None
    sampling_sd: float | None


@dataclass(frozen=True, eq=False)
class Landscape:
    """Scores of the grid, in the order of ``names``.

    Attributes:
        names: varied parameters.
        axes: values of each.
        scores: (len(axis), …) scores, NaN where the part cannot be made.
    """

    names: tuple[str, ...]
    axes: tuple[FloatArray, ...]
    scores: FloatArray


def slices_at(
    box: Box,
    scoring: Scoring,
    best: tuple[float, tuple[float, ...], int],
    spread: FloatArray | None,
    workers: Workers,
    advance: Advance,
) -> tuple[Slice, ...]:
    """The score along every parameter through the best point."""
    top, unit, _ = best
    limit = top - COST_SHARE * abs(top)
    fine = np.linspace(0.0, 1.0, SLICE_POINTS)
    moved = [(box.at((*unit[:k], float(u), *unit[k + 1 :])), scoring) for k in range(len(unit)) for u in fine]
    doing = "looking around the optimum"
    rows = np.reshape(sweep(score_of_task, moved, workers, advance=advance, doing=doing), (len(unit), -1))
    sides = [(k, side) for k in range(len(unit)) for side in (-1, 1)]
    brackets = [_bracket(fine, rows[k], unit[k], side, limit) for k, side in sides]
    asked = [
        (box, scoring, unit, k, bracket, limit)
        for (k, _), bracket in zip(sides, brackets, strict=True)
        if bracket is not None
    ]
    crossed = iter(sweep(_crossing, asked, workers, advance=advance, doing=doing))
    ends = [
        (0.0 if side < 0 else 1.0) if bracket is None else next(crossed)
        for (_, side), bracket in zip(sides, brackets, strict=True)
    ]
    return tuple(
        _slice(box, k, unit[k], fine, rows[k], top, (ends[2 * k], ends[2 * k + 1]), spread)
        for k in range(len(unit))
    )


def _slice(
    box: Box,
    number: int,
    unit: float,
    fine: FloatArray,
    row: FloatArray,
    top: float,
    kept: tuple[float, float],
    spread: FloatArray | None,
) -> Slice:
    flat = bool(np.isfinite(row).all() and top - row.min() < FLAT_SHARE * abs(top))
    at = "lower" if unit < _AT_BOUND else "upper" if unit > 1.0 - _AT_BOUND else None
    return Slice(
        box.names[number],
        tuple(box.value(number, float(u)) for u in fine),
        tuple(float(v) for v in row),
        (box.value(number, kept[0]), box.value(number, kept[1])),
        flat,
        None if flat else at,
        None if spread is None else float(spread[number]),
    )


def _bracket(
    fine: FloatArray, row: FloatArray, centre: float, side: int, limit: float
) -> tuple[float, float] | None:
    """Neighbouring unit values beside the centre between which the score falls below a limit, or None."""
    beyond = (fine - centre) * side > 0
    past, scores = fine[beyond][::side], row[beyond][::side]
    below = np.flatnonzero(~(scores >= limit))
    if not below.size:
        return None
    first = int(below[0])
    return float(centre if first == 0 else past[first - 1]), float(past[first])


def _crossing(task: tuple[Box, Scoring, tuple[float, ...], int, tuple[float, float], float]) -> float:
    """Unit value of one parameter at which the score falls below a limit, by halving a bracket."""
    box, scoring, best, number, (inner, outer), limit = task
    for _ in range(_HALVINGS):
        middle = 0.5 * (inner + outer)
        moved = (*best[:number], middle, *best[number + 1 :])
        if value_of(box.at(moved), scoring) >= limit:
            inner = middle
        else:
            outer = middle
    return 0.5 * (inner + outer)
