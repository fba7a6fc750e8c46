"""Capability of values that are not normal: quantiles of a fitted distribution, and the behaviour over time.

ISO 22514-2:2017: Pp is the width of the specification over that between the quantiles of 0.135 and 99.865 %, Ppk the
distance of the nearer limit from the median over that of its quantile. Distribution and behaviour over time have names
of the standard's models: A1 (location and dispersion constant, normal), A2 (the same, not normal), B (dispersion
changes), C1 to C4 (location changes: at random and normal, at random, by a trend, otherwise), D (both change).

Fits are of maximum likelihood; "best" is that of the least Akaike information criterion.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import in_json
from anisoscope.quality.capability import CONFIDENCE, Index, Specification

LOW, HIGH = 0.00135, 0.99865
DRAWS = 400
SEED = 22514
SUBGROUP, LEAST_SUBGROUPS = 5, 6
ALPHA = 0.01
"""Level of the tests whether location and dispersion change."""
FAMILIES = ("normal", "lognormal", "weibull", "rayleigh", "folded-normal", "logistic")


@dataclass(frozen=True)
class Fitted:
    """A fitted distribution.

    Attributes:
        family: one of `FAMILIES`.
        parameters: as scipy takes them: shapes, location, scale.
        criterion: Akaike's; less is better.
    """

    family: str
    parameters: tuple[float, ...]
    criterion: float


@dataclass(frozen=True)
class FittedCapability:
    """Capability by the quantiles of a fitted distribution.

    Attributes:
        fitted: the distribution.
        low, median, high: its quantiles of 0.135, 50 and 99.865 %.
        pp: None with a limit on one side only.
        ppk: index of the nearer limit.
        outside_expected: share beyond a limit by the distribution.
        time_model: of ISO 22514-2; "" with too few values to tell.
        confidence: of the intervals, which are those of a parametric bootstrap.
    """

    fitted: Fitted
    low: float
    median: float
    high: float
    pp: Index | None
    ppk: Index
    outside_expected: float
    time_model: str
    confidence: float

    @property
    @in_json()
    def verdict(self) -> str:
        """The outcome in plain words."""
        model = f", model {self.time_model} of ISO 22514-2" if self.time_model else ""
        index = self.ppk
        return f"{self.fitted.family}: Ppk {index.value:.2f} ({index.low:.2f} to {index.high:.2f}){model}"


def fitted_capability(
    values: FloatArray, specification: Specification, family: str = "best", confidence: float = CONFIDENCE
) -> FittedCapability:
    """Capability of values by a fitted distribution.

    Args:
        values: (N,) in the order in which they were measured; NaN is missing.
        specification: limits of good parts.
        family: one of `FAMILIES`, or "best".
        confidence: of the intervals.

    Raises:
        UsageError: too few values, all the same, another family, or one that has no such values.
    """
    measured = values[~np.isnan(values)]
    if len(measured) < 10 or float(np.ptp(measured)) == 0.0:
        raise UsageError(f"a distribution needs 10 or more values that differ, not {len(measured)}")
    fitted = best_fit(measured) if family == "best" else fit(measured, family)
    rng, drawn = np.random.default_rng(SEED), []
    for _ in range(DRAWS):
        again = _made(fitted.family).rvs(*fitted.parameters, size=len(measured), random_state=rng)
        drawn.append(_indices(fit(np.asarray(again), fitted.family), specification))
    value, tail = _indices(fitted, specification), (1.0 - confidence) / 2.0
    ends = np.quantile(np.array(drawn), (tail, 1.0 - tail), axis=0)
    pp, ppk = (Index(one, float(low), float(high)) for one, low, high in zip(value, *ends, strict=True))
    low, median, high = _quantiles(fitted)
    law = _made(fitted.family)
    outside = 0.0 if specification.lower is None else float(law.cdf(specification.lower, *fitted.parameters))
    outside += 0.0 if specification.upper is None else float(law.sf(specification.upper, *fitted.parameters))
    two_sided = specification.lower is not None and specification.upper is not None
    return FittedCapability(
        fitted,
        low,
        median,
        high,
        pp if two_sided else None,
        ppk,
        outside,
        time_model(measured, fitted),
        confidence,
    )


def best_fit(values: FloatArray) -> Fitted:
    """The family of the least criterion among those that have such values.

    Args:
        values: (N,) without NaN.
    """
    possible = [name for name in FAMILIES if name in _ANY or float(values.min()) > 0.0]
    found = [fit(values, name) for name in possible]
    least = min(one.criterion for one in found)
    return next(one for one in found if one.criterion <= least + _TIE)


_TIE = 0.1
"""Difference of the criterion below which the earlier family is taken: a folded normal far from 0 is a normal one."""


_ANY = {"normal", "logistic"}


def fit(values: FloatArray, family: str) -> Fitted:
    """Fit one family; those of positive values start at 0.

    Args:
        values: (N,) without NaN.
        family: one of `FAMILIES`.

    Raises:
        UsageError: another family, or values at or below 0 where it has none.
    """
    if family not in FAMILIES:
        raise UsageError(f"the distribution is best, {', '.join(FAMILIES)}, not {family!r}")
    if family not in _ANY and float(values.min()) <= 0.0:
        raise UsageError(f"a {family} distribution has positive values only, not {float(values.min()):g}")
    parameters = _FITS[family](values)
    likelihood = float(np.sum(_made(family).logpdf(values, *parameters)))
    return Fitted(family, parameters, 2.0 * _FREE[family] - 2.0 * likelihood)


_FREE = {"normal": 2, "lognormal": 2, "weibull": 2, "rayleigh": 1, "folded-normal": 2, "logistic": 2}


def _made(family: str) -> Any:  # noqa: ANN401 - a distribution of scipy, which is imported late
    from scipy import stats  # noqa: PLC0415 - heavy

    names = {"normal": "norm", "lognormal": "lognorm", "weibull": "weibull_min", "folded-normal": "foldnorm"}
    return getattr(stats, names.get(family, family))


def _normal(values: FloatArray) -> tuple[float, ...]:
    return float(values.mean()), float(values.std())


def _lognormal(values: FloatArray) -> tuple[float, ...]:
    logs = np.log(values)
    return float(logs.std()), 0.0, math.exp(float(logs.mean()))


def _rayleigh(values: FloatArray) -> tuple[float, ...]:
    return 0.0, math.sqrt(float(np.mean(values**2)) / 2.0)


def _weibull(values: FloatArray) -> tuple[float, ...]:
    """Shape by the equation of its likelihood, which has one root (ISO 20501, 8.2)."""
    from scipy.optimize import brentq  # noqa: PLC0415 - heavy

    logs = np.log(values) - math.log(float(values.max()))

    def off(shape: float) -> float:
        weight = np.exp(shape * logs)
        return float(weight @ logs / weight.sum() - 1.0 / shape - logs.mean())

    high = 1.0
    while off(high) < 0.0:
        high *= 2.0
    shape = float(brentq(off, 1e-3, high))
    return shape, 0.0, float(values.max()) * float(np.mean(np.exp(shape * logs))) ** (1.0 / shape)


def _folded(values: FloatArray) -> tuple[float, ...]:
    """Fixed point of the equations of its likelihood (F. C. Leone, L. S. Nelson, Technometrics 3 (1961) 543)."""
    square, mean = float(np.mean(values**2)), float(values.mean())
    for _ in range(500):
        variance = square - mean**2
        new = float(np.mean(values * np.tanh(mean * values / variance)))
        done, mean = abs(new - mean) < 1e-10 * math.sqrt(square), new
        if done:
            break
    sigma = math.sqrt(square - mean**2)
    return mean / sigma, 0.0, sigma


def _logistic(values: FloatArray) -> tuple[float, ...]:
    from scipy.stats import logistic  # noqa: PLC0415 - heavy

    return tuple(float(one) for one in logistic.fit(values))


_FITS: dict[str, Callable[[FloatArray], tuple[float, ...]]] = {
    "normal": _normal,
    "lognormal": _lognormal,
    "weibull": _weibull,
    "rayleigh": _rayleigh,
    "folded-normal": _folded,
    "logistic": _logistic,
}


def _quantiles(fitted: Fitted) -> tuple[float, float, float]:
    low, median, high = _made(fitted.family).ppf((LOW, 0.5, HIGH), *fitted.parameters)
    return float(low), float(median), float(high)


def _indices(fitted: Fitted, specification: Specification) -> tuple[float, float]:
    """Pp (0 with one limit) and Ppk."""
    low, median, high = _quantiles(fitted)
    lower, upper = specification.lower, specification.upper
    sides = [(median - lower) / (median - low)] if lower is not None else []
    sides += [(upper - median) / (high - median)] if upper is not None else []
    return 0.0 if lower is None or upper is None else (upper - lower) / (high - low), min(sides)


def time_model(values: FloatArray, fitted: Fitted) -> str:
    """Model of ISO 22514-2 over subgroups of five neighbours; "" with fewer than six subgroups.

    Whether the location changes is tested by one-way analysis of variance of the ranks (Kruskal and Wallis), the
    dispersion by deviations from the medians (Brown and Forsythe), a trend by Spearman's rank correlation.

    Args:
        values: (N,) in order, without NaN.
        fitted: the distribution of all.
    """
    from scipy import stats  # noqa: PLC0415 - heavy

    count = len(values) // SUBGROUP
    if count < LEAST_SUBGROUPS:
        return ""
    groups = values[: count * SUBGROUP].reshape(count, SUBGROUP)
    if float(np.ptp(groups, axis=1).min()) == 0.0 and float(np.ptp(groups, axis=1).max()) == 0.0:
        return ""
    moves = float(stats.kruskal(*groups).pvalue) < ALPHA
    spreads = float(stats.levene(*groups, center="median").pvalue) < ALPHA
    normal = fitted.family == "normal"
    if spreads or not moves:
        return ("D" if moves else "B") if spreads else "A1" if normal else "A2"
    means = groups.mean(axis=1)
    if float(stats.spearmanr(np.arange(count), means).pvalue) < ALPHA:
        return "C3"
    neighbours = float(np.corrcoef(means[:-1], means[1:])[0, 1])
    return "C4" if neighbours > 2.0 / math.sqrt(count) else "C1" if normal else "C2"
