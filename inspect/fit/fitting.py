"""Weighted nonlinear least squares of the reflectance models; reports only parameters determined by the data.

Starts are the best of a fixed grid of ridge angles and roughnesses, so that the same data always give the same
fit. The search counts two reflections, coarsely integrated, and ends with the reflections asked for.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import rank, whitening
from anisoscope.base.errors import UsageError
from anisoscope.base.notebook import axes_or_new, data_frame, html_table
from anisoscope.base.progress import Advance, silent
from anisoscope.base.rejection import Misfit, best_model, misfit
from anisoscope.fit.identifiability import (
    MODEL_SHARE,
    Combination,
    Information,
    derivatives,
    helping_measurement,
    information,
    limits,
    scaled_covariance,
)
from anisoscope.fit.parameters import OPTICS, OPTIONAL, PARAMETERS
from anisoscope.fit.problem import COARSE_NODES, MATTE, Problem, interface_alpha

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from scipy.optimize import OptimizeResult

Values = dict[str, float]
Minimum = tuple[Values, float]

RIVAL_CHI2 = 9.0
MAX_MINIMA = 3  # minima that are refined
_GRIDS = {
    "ridge_angle_deg": (2.0, 4.0, 6.0, 8.0, 10.0, 13.0, 16.0, 20.0, 26.0),
    "alpha_along": (0.03, 0.06, 0.12, 0.25),
    "alpha_across": (0.03, 0.06, 0.12, 0.25),
}
_ROUNDS = 10  # of a fine search
_STILL = 1e-5  # limits of the parameters by which a round may move them at the end of a fine search
_SHORTER, _SHORTENED = 4, 0.2  # tries of a round that makes the fit worse, and share of its step that is left
_EVALUATIONS = {True: 100, False: 40}  # of a fine and of a coarse search
_TOLERANCE = {True: 1e-10, False: 1e-6}
_AHEAD = {True: 0.1, False: 1.0}  # share of the steps of the derivatives
_HOPS_DEG = (
    -2.0,
    -1.0,
    1.0,
    2.0,
)  # a glint is about equally bright on either side of a facet's mirror direction


def _with(problem: Problem, values: Mapping[str, float], internal: FloatArray) -> Values:
    free = {n: PARAMETERS[n].external(float(x)) for n, x in zip(problem.free, internal, strict=True)}
    return dict(values) | free


def _with_scale(problem: Problem, values: Values, weight: FloatArray) -> tuple[Values, float]:
    """The values with the best k, where it is free, and the weighted sum of squares."""
    model = weight @ problem.predicted(values, interface_alpha(problem.values))
    weighted = weight @ problem.readings.value
    if "k" in problem.free:
        with np.errstate(all="ignore"):
            k = values["k"] * float(model @ weighted) / float(model @ model)
        if not PARAMETERS["k"].low < k < PARAMETERS["k"].high:
            return values, float("inf")
        model = model * k / values["k"]
        values = values | {"k": k}
    return values, float(np.sum((weighted - model) ** 2))


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


def search(
    problem: Problem, weight: FloatArray, starts: int | Sequence[Values], advance: Advance
) -> list[Minimum]:
    """Minima of a problem, the best first, no two of them alike.

    Args:
        problem: what is fitted.
        weight: whitening of its readings.
        starts: how many starting points are followed, or these; 0 follows the given values only.
        advance: progress.
    """
    begin = starting_points(problem, weight, starts) if isinstance(starts, int) else starts
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
        found = [minimise(problem, values, weight) for values, _ in distinct(problem, found)[:MAX_MINIMA]]
    return distinct(problem, found)


def _hop(problem: Problem, weight: FloatArray, found: list[Minimum]) -> list[Minimum]:
    """Minima, including those reached from ridge angles adjacent to that of the best one."""
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
    distinct_minima: list[Minimum] = []
    for values, cost in sorted(found, key=itemgetter(1)):
        if all(_apart(problem.free, values, other) for other, _ in distinct_minima):
            distinct_minima.append((values, cost))
    return distinct_minima


def minimise(problem: Problem, start: Values, weight: FloatArray, *, fine: bool = True) -> Minimum:
    """Local minimum from one start, and its weighted sum of squares.

    Light that reflects more than once is costly and changes slowly: it is taken as linear in the parameters about where
    a round starts, and at the end of a fine search nothing moves any more. A coarse search is one round.
    """
    values, cost = start, float("inf")
    for _ in range(_ROUNDS if fine else 1):
        before, interface = values, interface_alpha(values)
        values, cost = _minimum(problem, values, weight, interface, fine)
        still = not problem.scene.follows or not _apart(problem.free, values, before, _STILL)
        if still and interface_alpha(values) == interface:
            break
    return values, cost


def _minimum(problem: Problem, start: Values, weight: FloatArray, interface: float, fine: bool) -> Minimum:
    """The minimum of a round, with the table of the interface as it is; never worse than its start."""
    from scipy.optimize import least_squares  # noqa: PLC0415 - half a second that --help should not pay

    low, high = (np.array(ends) for ends in zip(*(PARAMETERS[n].bounds for n in problem.free), strict=True))
    inside, weighted = 1e-9 * (high - low), weight @ problem.readings.value
    begin = np.array([PARAMETERS[n].internal(start[n]) for n in problem.free])
    begin = np.clip(begin, low + inside, high - inside)
    direct, scale = problem, np.array([name == "k" for name in problem.free])
    rest, by_rest = np.zeros_like(problem.readings.value), np.zeros(len(begin))

    if problem.scene.follows:
        here = _with(problem, start, begin)
        direct = replace(problem, scene=replace(problem.scene, bounces=1))
        rest = problem.predicted(here, interface) - direct.predicted(here, interface)
        rough = replace(problem, scene=replace(problem.scene, nodes=COARSE_NODES))
        by_rest = derivatives(rough, here, interface, ahead=1.0)
        by_rest = by_rest - derivatives(direct, here, interface, ahead=1.0)
        by_rest[:, scale] = 0.0  # k multiplies all light

    def more(x: FloatArray) -> FloatArray:
        return np.asarray(
            np.exp(np.sum((x - begin)[scale])) * (rest + np.sum(by_rest * (x - begin), axis=-1))
        )

    def residual(x: FloatArray) -> FloatArray:
        return np.asarray(
            weight @ (direct.predicted(_with(problem, start, x), interface) + more(x)) - weighted
        )

    def slope(x: FloatArray) -> FloatArray:
        found = derivatives(direct, _with(problem, start, x), interface, ahead=_AHEAD[fine])
        found += np.exp(np.sum((x - begin)[scale])) * by_rest
        found[:, scale] += more(x)[:, None]
        return np.asarray(weight @ found)

    step, first = limits(problem.free), float(np.sum(residual(begin) ** 2))
    reach = np.inf
    for _ in range(_SHORTER):
        done: OptimizeResult = least_squares(
            residual,
            begin,
            slope,
            bounds=(np.maximum(low, begin - reach * step), np.minimum(high, begin + reach * step)),
            x_scale=step,
            ftol=_TOLERANCE[fine],
            xtol=_TOLERANCE[fine],
            gtol=_TOLERANCE[fine],
            max_nfev=_EVALUATIONS[fine],
        )
        values, cost = _with(problem, start, done.x), float(2.0 * done.cost)
        if problem.scene.follows:
            cost = float(np.sum((weight @ problem.predicted(values, interface) - weighted) ** 2))
        if cost <= first or not problem.scene.follows:
            return values, cost
        reach = _SHORTENED * float(np.max(np.abs(done.x - begin) / step))
    return _with(problem, start, begin), first


def rivals_of(problem: Problem, found: list[Minimum]) -> tuple[Mapping[str, float], ...]:
    """Minima whose chi2 exceeds that of the first by less than `RIVAL_CHI2`, as values of the free parameters."""
    least = found[0][1]
    free = rank(problem.readings.covariance) - len(problem.free)
    unit = 1.0 if problem.readings.noise_known else least / max(free, 1)
    return tuple(
        {name: values[name] for name in problem.free}
        for values, cost in found[1:]
        if cost - least < RIVAL_CHI2 * unit
    )


def _apart(
    names: tuple[str, ...], one: Mapping[str, float], other: Mapping[str, float], least: float = 0.1
) -> bool:
    steps = [
        abs(PARAMETERS[n].internal(one[n]) - PARAMETERS[n].internal(other[n])) / PARAMETERS[n].limit
        for n in names
    ]
    return max(steps) > least


STARTS = 3
ANCHORINGS = 2  # of the third and further reflections to the values found
HOPELESS = 10.0  # limits of uncertainty from which on index or albedo are not tried
_AT_BOUND = 1e-6


@dataclass(frozen=True)
class Estimate:
    """A fitted parameter.

    Attributes:
        name: with its unit.
        value: None where the data do not determine it.
        u: standard uncertainty, None likewise.
        low95: lower end of the 95 % interval, from the internal value and cut at the bound.
        high95: upper end.
        at_bound: the value stands at a bound of the parameter, so that its uncertainty only holds inward.
    """

    name: str
    value: float | None
    u: float | None
    low95: float | None
    high95: float | None
    at_bound: bool


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of a fit.

    Attributes:
        problem: what was fitted.
        values: all parameters at the minimum, including undetermined ones: not for reporting.
        estimates: p free parameters.
        covariance: (p, p) of the free parameters as reported; NaN where one is not determined.
        correlation: (p, p), NaN likewise.
        fitted: (N,) values of the model.
        u_value: (N,) standard uncertainties of the measured values.
        chi2: weighted sum of squares; of unknown noise 1 per degree of freedom by construction.
        dof: degrees of freedom.
        misfit: test of the model; where it is rejected, u and covariance are enlarged by its Birge ratio.
        lacking: combinations that are not determined.
        advice: the measurement that would help, or None.
        rivals: other minima that fit about as well, as values of the free parameters.
        tests: of this model and of its rivals where it was rejected, the one that was asked for first.
    """

    problem: Problem
    values: Mapping[str, float]
    estimates: tuple[Estimate, ...]
    covariance: FloatArray
    correlation: FloatArray
    fitted: FloatArray
    u_value: FloatArray
    chi2: float
    dof: int
    misfit: Misfit
    lacking: tuple[Combination, ...]
    advice: str | None
    rivals: tuple[Mapping[str, float], ...]
    tests: tuple[Misfit, ...] = ()

    @property
    def p_value(self) -> float | None:
        """Of chi2, None where the noise was estimated from the residuals or no freedom is left."""
        return self.misfit.p_value

    @property
    def fits(self) -> bool:
        """Whether the data do not reject this model."""
        return not self.misfit.rejected

    @property
    def residual(self) -> FloatArray:
        """(N,) measured − fitted."""
        return self.problem.readings.value - self.fitted

    @property
    def z(self) -> FloatArray:
        """(N,) residuals in units of the standard uncertainties of the values."""
        return np.divide(self.residual, self.u_value, out=np.zeros_like(self.fitted), where=self.u_value > 0)

    @property
    def rms(self) -> float:
        """Root mean square of the residuals, in the unit of the values."""
        return float(np.sqrt(np.mean(self.residual**2)))

    def __repr__(self) -> str:
        """One line: the fitted parameters with their standard uncertainties, and how well they fit."""
        values = ", ".join(f"{one.name} {_with_u(one)}" for one in self.estimates)
        return f"Fit({values or 'nothing free'}; rms {self.rms:.3g}, {self.dof} degrees of freedom)"

    def _repr_html_(self) -> str:
        rows = [
            (one.name, _with_u(one), "–" if one.low95 is None else f"{one.low95:.5g} to {one.high95:.5g}")
            for one in self.estimates
        ]
        p_value = "" if self.p_value is None else f", p = {self.p_value:.2g}"
        p_value += "" if self.fits else ": rejected"
        title = f"fit: rms {self.rms:.3g}, {self.dof} degrees of freedom{p_value}"
        return html_table(title, ("parameter", "value", "95 % interval"), rows)

    def plot(self, axes: "Axes | None" = None) -> "Axes":
        """Draw measured against fitted values, bars of ±2 u, and the line on which both agree.

        Args:
            axes: matplotlib axes; a new figure by default.
        """
        axes, measured = axes_or_new(axes), self.problem.readings.value
        axes.errorbar(self.fitted, measured, 2.0 * self.u_value, fmt="o", capsize=3)
        ends = [float(min(self.fitted.min(), measured.min())), float(max(self.fitted.max(), measured.max()))]
        axes.plot(ends, ends, color="grey")
        axes.set(xlabel="fitted", ylabel="measured")
        return axes

    def to_frame(self) -> Any:  # noqa: ANN401 - pandas need not be installed
        """The fitted parameters as a pandas data frame: parameter, value, u, 95 % interval.

        Raises:
            UsageError: pandas is not installed.
        """
        names = ("name", "value", "u", "low95", "high95", "at_bound")
        return data_frame({name: [getattr(one, name) for one in self.estimates] for name in names})


def _with_u(one: Estimate) -> str:
    return "not determined" if one.value is None else f"{one.value:.5g} ± {one.u:.2g}"


def fit(problem: Problem, advance: Advance = silent, starts: int | Sequence[Values] = STARTS) -> Fit:
    """Fit the free parameters of a problem; with none free, only compare.

    Args:
        problem: what to fit.
        advance: told how far the work is.
        starts: how many starting points are followed, the best of a grid, or these; 0 follows the given values only.

    Raises:
        UsageError: refractive index or albedo are free and cannot be identified; or nothing fits.
    """
    problem, weight = problem.freed(problem.free), whitening(problem.readings.covariance)
    if not problem.free:
        return _result(problem, dict(problem.values), weight, ())
    quick = replace(problem, scene=problem.scene.coarse())
    searched = tuple(name for name in problem.free if name not in OPTICS) or problem.free
    found = search(replace(quick, free=searched), weight, starts, advance)
    if any(name in problem.free for name in OPTICS):
        found = _with_optics(quick, found, weight, advance)
    rivals = rivals_of(quick, found)
    values = found[0][0]
    if problem.scene.follows:
        for _ in range(ANCHORINGS):
            advance("all reflections", 1, 2)
            scene = problem.scene.anchored(values, interface_alpha(values))
            problem = replace(problem, scene=scene)
            values = minimise(problem, values, weight)[0]
    return _result(problem, values, weight, rivals)


RIVALS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("a lobe with a tail", ("tail",)),
    ("a second lobe", ("second_weight", "second_width")),
    ("rounded crests", ("edge_radius_um",)),
    ("rounded feet", ("foot_radius_um",)),
    ("a wall of another draft", ("draft_deg",)),
)
"""What a rejected model may lack, and the parameters that are then free as well."""
_OF_A_LOBE = ("alpha_along", "alpha_across", "index", "tail", "second_weight", "second_width")
_TYPICAL_TAIL = 0.5
FAR_OFF = 30.0
"""χ² over its degrees of freedom that no exacter integration repairs."""


def fit_or_rival(problem: Problem, advance: Advance = silent) -> Fit:
    """Fit the free parameters; where the model is rejected, also with what it may lack.

    Rivals are those of `RIVALS` and `MATTE`; where they are rejected too, the former with the albedo free. With unknown
    noise only the matte limits are compared, by the information criterion. A rival follows the starting points of the
    model and its minimum.

    Args:
        problem: what to fit.
        advance: told how far the work is.

    Returns:
        The fit that describes the data best, with the tests of all that were tried.

    Raises:
        UsageError: as of `fit`.
    """
    scene, free, weight = problem.scene, problem.free, whitening(problem.readings.covariance)
    asked = replace(problem.freed(free), scene=scene.coarse())
    grid = starting_points(asked, weight, STARTS) if free else []
    own = fit(problem, advance, grid)
    if not free or scene.model == "printed" or (own.fits and own.p_value is not None):
        return replace(own, tests=(own.misfit,))
    begin = [own.values, *grid[:2]]
    shaped = scene.material.second_lobe is not None or problem.values["tail"] > 0.0 or "tail" in free
    excluded = {*free, *(("tail", "second_weight") if shaped else ())}
    if problem.values["ridge_angle_deg"] == 0.0 and "ridge_angle_deg" not in free:
        excluded |= {"edge_radius_um", "foot_radius_um", "draft_deg", "ridge_angle_deg"}
    lacking = [(words, names) for words, names in RIVALS if not excluded & {*names}]
    brighter: list[tuple[str, tuple[str, ...]]] = []
    if "albedo" not in free and problem.readings.scaled:
        brighter = [("another albedo", ("albedo",))]
        brighter += [(f"{words}, and another albedo", (*names, "albedo")) for words, names in lacking]

    reached: dict[tuple[str, ...], Mapping[str, float]] = {}

    def rival(words: str, names: tuple[str, ...]) -> Fit | None:
        advance(f"the model is rejected; {words}", 1, 2)
        usual = {"tail": _TYPICAL_TAIL} if "tail" in names else {}
        simpler = reached.get(names[:-1])
        places = begin if simpler is None else [simpler, own.values]
        found = _tried(own, problem.freed((*free, *names), usual), places, words)
        if found is not None:
            reached[names] = found.values
        return found

    def matte(words: str, names: tuple[str, ...]) -> Fit | None:
        advance(words, 1, 2)
        amplitude = ("albedo",) if problem.readings.scaled and "k" not in free else ()
        kept = (name for name in free if name not in _OF_A_LOBE)
        usual = {"matte_deg": 0.0, "tail": 0.0} | {name: OPTIONAL[name] for name in names}
        return _tried(own, problem.freed((*kept, *names, *amplitude), usual), begin, words)

    matt = [partial(matte, *one) for one in MATTE]
    stages = ([*(partial(rival, *one) for one in lacking), *matt], [partial(rival, *one) for one in brighter])
    chosen, tests = best_model(own, stages, attrgetter("misfit"), matt)
    estimates = chosen.estimates
    if not chosen.fits:
        estimates = tuple(replace(one, low95=None, high95=None) for one in estimates)
    return replace(chosen, tests=tests, estimates=estimates)


def _tried(own: Fit, problem: Problem, begin: Sequence[Mapping[str, float]], words: str) -> Fit | None:
    """The fit of a rival; None where these data do not determine it.

    A rival that is far off with its reflections coarsely integrated is not fitted to the end: only its test and values
    are its own.
    """
    weight, quick = whitening(problem.readings.covariance), replace(problem, scene=problem.scene.coarse())
    starts = [dict(problem.values) | {n: one[n] for n in problem.free if n in one} for one in begin]
    found = distinct(problem, [minimise(quick, start, weight, fine=False) for start in starts])
    (values, cost), known = found[0], problem.readings.noise_known
    count = own.dof + len(own.problem.free)
    enough = FAR_OFF * max(count - len(problem.free), 1)
    if not known or cost < FAR_OFF * enough:
        values, cost = minimise(quick, values, weight)
    if known and cost > enough:
        return replace(own, values=values, misfit=misfit(words, cost, count, len(problem.free)))
    try:
        done = fit(replace(problem, values=values), starts=0)
    except UsageError:
        return None
    test = misfit(words, cost if not known else done.chi2, count, len(problem.free), known=known)
    return replace(done, misfit=test)


def _with_optics(
    problem: Problem, found: list[Minimum], weight: FloatArray, advance: Advance
) -> list[Minimum]:
    """Minima with index and albedo free as well, unless these are not identifiable there."""
    doubt = _doubt(problem, found[0][0])
    if doubt is not None and doubt[1] > HOPELESS:
        raise UsageError(doubt[0])
    advance("with index or albedo free", 1, 2)
    # a wrong albedo may have misled the search: the given values are another start
    starts = [*found[:2], *((values, float("inf")) for values in starting_points(problem, weight, 0))]
    refined = distinct(problem, [minimise(problem, one, weight) for one, _ in distinct(problem, starts)])
    doubt = _doubt(problem, refined[0][0])
    if doubt is not None:
        raise UsageError(doubt[0])
    return refined


def _doubt(problem: Problem, values: Mapping[str, float]) -> tuple[str, float] | None:
    """Reason why index or albedo is not identifiable even without noise, with their uncertainties."""
    optics = [name for name in OPTICS if name in problem.free]
    found = information(problem, values, np.zeros_like(problem.readings.covariance))
    for name in optics:
        row = found.names.index(name)
        if found.uncertainty[row] <= 1.0:
            continue
        others = np.abs(found.correlation[row])
        others[row] = -1.0
        partner = int(np.argmax(others))
        with_other = (
            f"its effect is that of {PARAMETERS[found.names[partner]].words} "
            f"(correlation {found.correlation[row, partner]:+.6f})"
            if others[partner] > 0.5
            else "it hardly changes the values"
        )
        u = found.uncertainty[row] * PARAMETERS[name].limit
        text = (
            f"--free {name} is refused: {PARAMETERS[name].words} cannot be identified from these "
            f"{len(problem.readings.value)} values: {with_other}, and a model error of "
            f"{100.0 * MODEL_SHARE:g} % alone makes it uncertain by {u:.2g}: leave it out of --free and "
            f"give it with --{name}"
        )
        return text, float(found.uncertainty[row])
    return None


def _result(
    problem: Problem, values: dict[str, float], weight: FloatArray, rivals: tuple[Mapping[str, float], ...]
) -> Fit:
    from scipy.special import stdtrit  # noqa: PLC0415 - as above

    readings = problem.readings
    fitted = problem.predicted(values, interface_alpha(values))
    chi2 = float(np.sum((weight @ (readings.value - fitted)) ** 2))
    dof = rank(readings.covariance) - len(problem.free)
    factor = 1.0 if readings.noise_known else chi2 / max(dof, 1)
    noise = factor * readings.covariance
    slope = derivatives(problem, values)
    known = information(problem, values, noise, slope) if problem.free else None
    test = misfit(
        "the model as asked for", chi2, dof + len(problem.free), len(problem.free), known=readings.noise_known
    )
    covariance = np.zeros((0, 0))
    estimates: tuple[Estimate, ...] = ()
    if known is not None:
        steps = limits(problem.free)
        scaled = scaled_covariance(weight @ slope * steps)
        covariance = factor * test.birge_ratio**2 * scaled * np.outer(steps, steps)
        quantile = 1.959964 if readings.noise_known else float(stdtrit(max(dof, 1), 0.975))
        estimates = tuple(
            _estimate(n, values[n], float(np.sqrt(v)), quantile, n in known.undetermined)
            for n, v in zip(problem.free, np.diag(covariance), strict=True)
        )
        covariance = _reported(problem, values, covariance, known)
    advice = helping_measurement(problem, values, noise) if known is not None and known.undetermined else None
    spread = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(spread, spread)
    return Fit(
        problem,
        values,
        estimates,
        covariance,
        correlation,
        fitted,
        np.sqrt(np.diag(noise)),
        chi2 / factor if factor > 0 else 0.0,
        dof,
        test,
        () if known is None else known.combinations,
        advice,
        rivals,
    )


def _estimate(name: str, value: float, spread: float, quantile: float, unknown: bool) -> Estimate:
    if unknown:
        return Estimate(name, None, None, None, None, at_bound=False)
    one = PARAMETERS[name]
    here, (low, high) = one.internal(value), one.bounds
    reach = quantile * spread
    ends = [one.external(float(np.clip(here + s * reach, low, high))) for s in (-1.0, 1.0)]
    at_bound = min(here - low, high - here) < _AT_BOUND * (high - low)
    u = spread * value if one.logarithmic else spread
    return Estimate(name, value, u, ends[0], ends[1], at_bound)


def _reported(
    problem: Problem, values: Mapping[str, float], covariance: FloatArray, known: Information
) -> FloatArray:
    """The covariance of the parameters as printed, NaN where one is not determined."""
    names = problem.free
    by_internal = np.array([values[n] if PARAMETERS[n].logarithmic else 1.0 for n in names])
    found = covariance * np.outer(by_internal, by_internal)
    hidden = np.array([n in known.undetermined for n in names])
    return np.where(hidden[:, None] | hidden[None, :], np.nan, found)
