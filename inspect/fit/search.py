"""The search for the minimum: starts from a fixed grid, local minima, and rivals of the best one."""

from collections.abc import Mapping
from itertools import product
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from anisoscope.errors import UsageError
from anisoscope.fit.identifiability import derivatives, limits, whitening
from anisoscope.fit.parameters import PARAMETERS
from anisoscope.fit.problem import Problem, interface_alpha
from anisoscope.progress import Advance

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

FloatArray = npt.NDArray[np.float64]
Values = dict[str, float]
Minimum = tuple[Values, float]

RIVAL_CHI2 = 9.0
KEPT = 3  # minima that are refined
_GRIDS = {
    "ridge_angle_deg": (2.0, 4.0, 6.0, 8.0, 10.0, 13.0, 16.0, 20.0, 26.0),
    "alpha_along": (0.03, 0.06, 0.12, 0.25),
    "alpha_across": (0.03, 0.06, 0.12, 0.25),
}
_ROUNDS = 4  # of refreshing the table of the interface
_EVALUATIONS = {True: 100, False: 40}  # of a fine and of a coarse search
_TOLERANCE = {True: 1e-10, False: 1e-6}
_HOPS_DEG = (
    -2.0,
    -1.0,
    1.0,
    2.0,
)  # a glint stands about as bright on either side of a facet's mirror direction


def _with(problem: Problem, values: Mapping[str, float], internal: FloatArray) -> Values:
    free = {n: PARAMETERS[n].external(float(x)) for n, x in zip(problem.free, internal, strict=True)}
    return dict(values) | free


def _with_scale(problem: Problem, values: Values, weight: FloatArray) -> tuple[Values, float]:
    """The values with the best k, where it is free, and the weighted sum of squares."""
    model = weight @ problem.predicted(values, interface_alpha(problem.values))
    seen = weight @ problem.readings.value
    if "k" in problem.free:
        with np.errstate(all="ignore"):
            k = values["k"] * float(model @ seen) / float(model @ model)
        if not PARAMETERS["k"].low < k < PARAMETERS["k"].high:
            return values, float("inf")
        model = model * k / values["k"]
        values = values | {"k": k}
    return values, float(np.sum((seen - model) ** 2))


def starting_points(problem: Problem, weight: FloatArray, count: int) -> list[Values]:
    """The best `count` points of a grid and the given values, no two of them neighbours; the best first.

    With a count of 0 only the given values.
    """
    names = [name for name in _GRIDS if name in problem.free]
    points: list[tuple[float, tuple[int, ...], Values]] = []
    for place in product(*(range(len(_GRIDS[name])) for name in names)) if count else ():
        chosen = {name: _GRIDS[name][i] for name, i in zip(names, place, strict=True)}
        values, cost = _with_scale(problem, dict(problem.values) | chosen, weight)
        points.append((cost, place, values))
    values, cost = _with_scale(problem, dict(problem.values), weight)
    points.append((cost, (-9,) * len(names), values))  # the given values: a place that neighbours none
    points = sorted(
        (point for point in points if np.isfinite(point[0])), key=lambda point: (point[0], point[1])
    )
    if not points:
        raise UsageError(
            "no positive scale k brings the model near these values: are signs or pairs exchanged?"
        )
    chosen_points: list[tuple[float, tuple[int, ...], Values]] = []
    for point in points:
        near = (_neighbours(point[1], other[1]) for other in chosen_points)
        if len(chosen_points) < max(count, 1) and not any(near):
            chosen_points.append(point)
    return [values for _, _, values in chosen_points]


def _neighbours(one: tuple[int, ...], other: tuple[int, ...]) -> bool:
    return all(abs(a - b) <= 1 for a, b in zip(one, other, strict=True))


def search(problem: Problem, weight: FloatArray, starts: int, advance: Advance) -> list[Minimum]:
    """Minima of a problem, the best first, no two of them alike.

    Args:
        problem: what is fitted.
        weight: whitening of its readings.
        starts: how many starting points are followed; 0 follows the given values only.
        advance: told how far the work is.
    """
    begin = starting_points(problem, weight, starts)
    total = len(begin) + len(_HOPS_DEG) + 2
    found: list[Minimum] = []
    for number, values in enumerate(begin):
        advance(f"start {number + 1} of {len(begin)}", number, total)
        found.append(minimise(problem, values, weight, fine=starts == 0))
    if starts and "ridge_angle_deg" in problem.free:
        advance("beside the best one", len(begin), total)
        found = _hop(problem, weight, distinct(problem, found))
    if starts:
        advance("refinement", total - 2, total)
        found = [minimise(problem, values, weight) for values, _ in distinct(problem, found)[:KEPT]]
    return distinct(problem, found)


def _hop(problem: Problem, weight: FloatArray, found: list[Minimum]) -> list[Minimum]:
    """The minima and those reached from ridge angles beside that of the best one."""
    one = PARAMETERS["ridge_angle_deg"]
    for _ in range(2):
        best = found[0]
        for step in _HOPS_DEG:
            angle = float(np.clip(best[0][one.name] + step, one.low, one.high))
            found = [*found, minimise(problem, best[0] | {one.name: angle}, weight, fine=False)]
        found = distinct(problem, found)
        if not _apart(problem.free, found[0][0], best[0]):
            break
    return found


def distinct(problem: Problem, found: list[Minimum]) -> list[Minimum]:
    """The minima by rising cost, without repetitions."""
    kept: list[Minimum] = []
    for values, cost in sorted(found, key=itemgetter(1)):
        if all(_apart(problem.free, values, other) for other, _ in kept):
            kept.append((values, cost))
    return kept


def minimise(problem: Problem, start: Values, weight: FloatArray, *, fine: bool = True) -> Minimum:
    """Local minimum from one start, and its weighted sum of squares."""
    from scipy.optimize import least_squares  # noqa: PLC0415 - half a second that --help should not pay

    low, high = (np.array(ends) for ends in zip(*(PARAMETERS[n].bounds for n in problem.free), strict=True))
    seen = weight @ problem.readings.value
    values, cost = start, float("inf")
    for _ in range(_ROUNDS if fine else 1):
        interface, base = interface_alpha(values), values

        def residual(x: FloatArray, base: Values = base, interface: float = interface) -> FloatArray:
            return np.asarray(weight @ problem.predicted(_with(problem, base, x), interface) - seen)

        def slope(x: FloatArray, base: Values = base, interface: float = interface) -> FloatArray:
            return np.asarray(weight @ derivatives(problem, _with(problem, base, x), interface))

        inside = 1e-9 * (high - low)
        x = np.clip([PARAMETERS[n].internal(values[n]) for n in problem.free], low + inside, high - inside)
        done: OptimizeResult = least_squares(
            residual,
            x,
            slope,
            bounds=(low, high),
            x_scale=limits(problem.free),
            ftol=_TOLERANCE[fine],
            xtol=_TOLERANCE[fine],
            gtol=_TOLERANCE[fine],
            max_nfev=_EVALUATIONS[fine],
        )
        values, cost = _with(problem, values, done.x), float(2.0 * done.cost)
        if interface_alpha(values) == interface:
            break
    return values, cost


def rivals_of(problem: Problem, found: list[Minimum]) -> tuple[Mapping[str, float], ...]:
    """Minima whose chi2 exceeds that of the first by less than `RIVAL_CHI2`, as values of the free parameters."""
    rank = len(whitening(problem.readings.covariance))
    least = found[0][1]
    unit = 1.0 if problem.readings.noise_known else least / max(rank - len(problem.free), 1)
    return tuple(
        {name: values[name] for name in problem.free}
        for values, cost in found[1:]
        if cost - least < RIVAL_CHI2 * unit
    )


def _apart(names: tuple[str, ...], one: Mapping[str, float], other: Mapping[str, float]) -> bool:
    steps = [
        abs(PARAMETERS[n].internal(one[n]) - PARAMETERS[n].internal(other[n])) / PARAMETERS[n].limit
        for n in names
    ]
    return max(steps) > 0.1
