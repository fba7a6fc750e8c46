"""Optimum ridge design within bounds: global grid search, then local refinement of the highest maxima.

The grid covers the whole box (pitch and roughness evenly in the logarithm). Every grid point that none of its
neighbours exceeds is a hill; the highest ones are climbed by a bounded simplex, which needs no derivatives: |C|
has kinks where a contrast changes sign, and the worst of several has them elsewhere. The curvature at the top says
how precisely each parameter has to be met, other samples of the same tolerances how well the optimum is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from operator import attrgetter

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import AnisoscopeError, UsageError
from anisoscope.base.json_fields import LEFT_OUT, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.workers import Workers
from anisoscope.study.box import LIMITS, Bounds, Box, check_bounds, scores_of_task, tabled, value_of
from anisoscope.study.objective import Part, Scored, Scoring, score
from anisoscope.study.sweep import sweep

FLAT_SHARE = 0.01  # a parameter is flat if its whole range changes the score by less
COST_SHARE = 0.01  # the interval of a parameter is where the score loses at most this
SLICE_POINTS = 49
_AT_BOUND = 1e-3  # of the range
_HALVINGS = 12
_TOGETHER = 16  # parts that are scored in one task


@dataclass(frozen=True)
class Slice:
    """The score along one parameter, the others at the optimum.

    Attributes:
        name: the parameter.
        values: of the parameter.
        scores: at these values.
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
    scores: FloatArray = field(metadata=json_field(by=np.ravel))


def _scored(
    parts: Sequence[Part], scoring: Scoring, workers: Workers, advance: Advance, doing: str
) -> FloatArray:
    """Scores of many parts, some at a time."""
    blocks = [(tuple(parts[first : first + _TOGETHER]), scoring) for first in range(0, len(parts), _TOGETHER)]
    return np.concatenate(sweep(scores_of_task, blocks, workers, advance=advance, doing=doing))


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
    moved = [box.at((*unit[:k], float(u), *unit[k + 1 :])) for k in range(len(unit)) for u in fine]
    doing = "looking around the optimum"
    rows = np.reshape(_scored(moved, scoring, workers, advance, doing), (len(unit), -1))
    sides = [(k, side) for k in range(len(unit)) for side in (-1, 1)]
    brackets = [_bracket(fine, rows[k], unit[k], side, limit) for k, side in sides]
    crossing_tasks = [
        (box, scoring, unit, k, bracket, limit)
        for (k, _), bracket in zip(sides, brackets, strict=True)
        if bracket is not None
    ]
    crossed = iter(sweep(_crossing, crossing_tasks, workers, advance=advance, doing=doing))
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
    """Neighbouring unit values around the centre between which the score falls below a limit, or None."""
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


GRID = {1: 97, 2: 25, 3: 11, 4: 7}  # points a side, by how many are varied
ROBUST_GRID = {1: 49, 2: 17, 3: 9, 4: 6}
_HILLS = 4
_REPEATS = 4


@dataclass(frozen=True, eq=False)
class Optimum:
    """The best part.

    Attributes:
        part: the part.
        scored: its score.
        nominal: its contrast without tolerances.
        slices: one for every varied parameter.
        landscape: the grid of the search.
        hills: scores of the tops that were climbed, highest first.
        evaluations: how many parts were scored.
    """

    part: Part
    scored: Scored = field(metadata=json_field(merged=True))
    nominal: Scored = field(metadata=json_field("nominal_contrast", by=attrgetter("mean")))
    slices: tuple[Slice, ...] = field(metadata=json_field("parameters"))
    landscape: Landscape = field(metadata=LEFT_OUT)
    hills: tuple[float, ...]
    evaluations: int


def _climb(task: tuple[Box, Scoring, tuple[float, ...], float]) -> tuple[float, tuple[float, ...], int]:
    """Climb from a unit point with a simplex of the given size: score, unit point, evaluations."""
    from scipy.optimize import minimize  # noqa: PLC0415 - slow to import

    box, scoring, start, size = task
    count = len(start)
    corner = np.array(start, dtype=np.float64)
    inward = np.where(corner < 0.5, size, -size)
    simplex = np.vstack([corner, corner + np.diag(inward)])
    highest = abs(value_of(box.at(corner), scoring))

    def below(unit: FloatArray) -> float:
        return -value_of(box.at(unit), scoring)

    found = minimize(
        below,
        corner.tolist(),
        method="Nelder-Mead",
        bounds=[(0.0, 1.0)] * count,
        options={
            "initial_simplex": simplex,
            "xatol": 1e-5 if scoring.tolerances is None else 2e-4,
            "fatol": 1e-9 * max(highest, 1e-9),
            "maxiter": 120 * count,
        },
    )
    return -float(found.fun), tuple(float(u) for u in np.clip(found.x, 0.0, 1.0)), int(found.nfev)


def optimum(
    part: Part, bounds: Bounds, scoring: Scoring, workers: Workers, advance: Advance = silent
) -> Optimum:
    """Find the part with the highest score.

    Args:
        part: what is not varied.
        bounds: of the varied parameters, keyed by their names in ``LIMITS``.
        scoring: what is maximised.
        workers: processes or cluster.
        advance: progress.

    Raises:
        UsageError: bounds that mean nothing, or no part within them that can be made.
    """
    check_bounds(bounds, part, scoring)
    names = tuple(name for name in LIMITS if name in bounds)
    box = Box(part, names, tuple(bounds[n][0] for n in names), tuple(bounds[n][1] for n in names))
    steps = (GRID if scoring.tolerances is None else ROBUST_GRID)[len(names)]
    units = np.linspace(0.0, 1.0, steps)
    points = [box.at(point) for point in product(units, repeat=len(names))]
    exact, scoring = scoring, tabled(box, scoring)
    values = _scored(points, scoring, workers, advance, "searching the grid")
    grid = np.reshape(values, (steps,) * len(names))
    if not np.isfinite(grid).any():
        _explain(box, scoring)
    starts = _hills(grid, units)
    size = 1.0 / (steps - 1)
    climbs = sweep(
        _climb,
        [(box, scoring, s, size) for s in starts],
        workers,
        advance=advance,
        doing="climbing the hills",
    )
    climbs.sort(key=lambda climb: -climb[0])
    best = climbs[0]
    spread, again = _resampled(box, scoring, best[1], size, workers, advance)
    slices = slices_at(box, scoring, best, spread, workers, advance)
    found = box.at(best[1])
    return Optimum(
        found,
        score(found, exact),
        score(found, exact.nominal),
        slices,
        Landscape(
            names,
            tuple(np.array([box.value(k, u) for u in units]) for k in range(len(names))),
            np.where(np.isfinite(grid), grid, np.nan),
        ),
        tuple(climb[0] for climb in climbs),
        len(points) + sum(climb[2] for climb in climbs) + again,
    )


def _explain(box: Box, scoring: Scoring) -> None:
    """Raise the error of the middle of the box, where no part can be manufactured."""
    try:
        score(box.at([0.5] * len(box.names)), scoring)
    except AnisoscopeError as error:
        raise UsageError(f"no part within these bounds can be made: {error}") from error
    raise UsageError("no part within these bounds has a score")


def _hills(grid: FloatArray, units: FloatArray) -> list[tuple[float, ...]]:
    """Unit points of the highest grid points that no neighbour exceeds."""
    from scipy.ndimage import maximum_filter  # noqa: PLC0415 - slow to import

    top = np.isfinite(grid) & (grid >= maximum_filter(grid, size=3, mode="nearest"))
    places = np.argwhere(top)
    order = np.argsort(-grid[top], kind="stable")[:_HILLS]
    return [tuple(float(units[k]) for k in places[number]) for number in order]


def _resampled(
    box: Box,
    scoring: Scoring,
    unit: tuple[float, ...],
    size: float,
    workers: Workers,
    advance: Advance,
) -> tuple[FloatArray | None, int]:
    """Standard deviation of the optimum's values between samples of the tolerances, and evaluations used."""
    if scoring.tolerances is None:
        return None, 0
    tasks = [
        (box, replace(scoring, seed=scoring.seed + 1 + number), unit, 0.5 * size)
        for number in range(_REPEATS)
    ]
    found = sweep(_climb, tasks, workers, advance=advance, doing="asking other samples")
    values = np.array([[box.value(k, u) for k, u in enumerate(climb[1])] for climb in found])
    return values.std(axis=0, ddof=1), sum(climb[2] for climb in found)
