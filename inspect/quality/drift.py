"""Drift of a measured number: a sequential test with few false alarms in total, and the parameter that moved with it.

The test looks at ranks only. As long as the order of the values is pure chance (they are exchangeable, whatever their
distribution, mean and spread), the rank of every new value among all so far is uniform and independent of the earlier
ranks. A bet on it, p → exp(δ·z - δ²/2) with z the normal quantile of p, averaged over the cell of a rank, then has the
mean 1, and so has every product of such bets. The evidence is a mixture of these products over the shift δ and over the
value from which on it is there: a test martingale. After Ville's inequality it ever reaches 100 with a probability of
at most 1 %, in an endless series and without a known mean.

Sources: J. Ville, Étude critique de la notion de collectif (1939); V. Vovk, A. Gammerman, G. Shafer, Algorithmic
Learning in a Random World (2005), ch. 7 (exchangeability martingales); A. Ramdas, P. Grünwald, V. Vovk, G. Shafer,
Statistical Science 38 (2023) 576; J. Shin, A. Ramdas, A. Rinaldo, arXiv 2203.03532 (mixtures over the change).

The parameter is found by linear models of the values with up to three parameters, with and without a shift or a ramp
that no parameter explains, weighted by BIC and a prior over the number of parameters. Sources: A. Raftery, Sociological
Methodology 25 (1995) 111; J. Scott and J. Berger, Annals of Statistics 38 (2010) 2587.
"""

import itertools
import math
from bisect import bisect_left, bisect_right, insort
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json

FALSE_ALARMS = 0.01
"""Probability that a series without drift ever raises an alarm."""
SHIFTS = (-3.0, -2.0, -1.25, -0.75, 0.75, 1.25, 2.0, 3.0)
"""Shifts that are bet on, in standard deviations."""
BEFORE, AFTER = 200, 50
"""Values before the onset, and after the alarm, that parameters are compared over."""
LAGS = 5
"""By so many parts at most a parameter may act later."""
TOGETHER = 3
"""Parameters in one model."""
FEW = 8
"""Values below which there is nothing to test, and common values below which a parameter is left out."""
NONE = "none of them"
_PRESENT = 0.8
_SEED = 20260901  # of the order in which equal values are ranked
IntArray = npt.NDArray[np.int64]


def sequential_ranks(values: FloatArray) -> IntArray:
    """(N,) ranks from 1 of every value among those before it and itself; equal values in an order drawn at random.

    Args:
        values: (N,), none missing.
    """
    draws = np.random.default_rng(_SEED).random(len(values))
    ordered: list[float] = []
    ranks = np.empty(len(values), dtype=np.int64)
    for place, value in enumerate(values.tolist()):
        low, high = bisect_left(ordered, value), bisect_right(ordered, value)
        ranks[place] = low + 1 + int(draws[place] * (high - low + 1))
        insort(ordered, value)
    return ranks


def log_bets(ranks: IntArray) -> FloatArray:
    """Logarithms of the bets on ranks, (shifts, ..., N): their mean over all ranks that are possible is 1.

    Args:
        ranks: (..., N) from 1, of the first, second, ... value.
    """
    from scipy.special import log_ndtr, ndtri  # noqa: PLC0415 - heavy

    count = np.arange(1, ranks.shape[-1] + 1)
    low, high = ndtri((ranks - 1) / count), ndtri(ranks / count)
    # the lighter tail keeps its digits: Φ(b) - Φ(a) = Φ(-a) - Φ(-b)
    bets = np.empty((len(SHIFTS), *ranks.shape))
    for number, shift in enumerate(SHIFTS):
        a, b = low - shift, high - shift
        upper = a > 0.0
        first, last = np.where(upper, -b, a), np.where(upper, -a, b)
        least, most = log_ndtr(first), log_ndtr(last)
        bets[number] = np.log(count) + most + np.log1p(-np.exp(least - most))
    return bets


def _log_prior(count: int) -> tuple[FloatArray, FloatArray]:
    """Logarithms of the prior of an onset at each of the values, and at a later one, (count,) each; slow tails."""
    later = 1.0 / np.log(np.e + np.arange(count + 1) / 10.0)
    return np.log(later[:-1] - later[1:]), np.log(later[1:])


def log_evidence(ranks: IntArray) -> FloatArray:
    """Logarithm of the evidence for a drift after every value, (..., N); see the module.

    Args:
        ranks: (..., N) from 1, of the first, second, ... value.
    """
    onset, later = _log_prior(ranks.shape[-1])
    bets = log_bets(ranks)
    found = np.empty(ranks.shape)
    running = np.full(bets.shape[:-1], -np.inf)
    for place in range(ranks.shape[-1]):
        running = np.logaddexp(running, onset[place]) + bets[..., place]
        mixed = np.logaddexp.reduce(running, axis=0) - math.log(len(SHIFTS))
        found[..., place] = np.logaddexp(mixed, later[place])
    return found


def onset_weights(ranks: IntArray) -> FloatArray:
    """(N,) posterior of the value at which a drift began, if there is one."""
    sums = np.cumsum(log_bets(ranks), axis=1)
    before = np.concatenate([np.zeros((len(SHIFTS), 1)), sums[:, :-1]], axis=1)
    logs = _log_prior(len(ranks))[0] + np.logaddexp.reduce(sums[:, -1:] - before, axis=0)
    weights: FloatArray = np.exp(logs - np.logaddexp.reduce(logs))
    return weights


@dataclass(frozen=True)
class Parameter:
    """A parameter of the machine against a measured number.

    Attributes:
        name: of the parameter.
        count: values that have it.
        correlation: Pearson's, over the values compared, at the lag.
        low, high: its 95 % interval, after Fisher, as for values without serial correlation.
        slope: of the number over the parameter.
        lag: parts by which it acts later.
        change: of the parameter, mean after the onset minus mean before it; NaN without a drift.
        weight: probability that it drives the drift; NaN without one.
    """

    name: str
    count: int
    correlation: float
    low: float
    high: float
    slope: float
    lag: int
    change: float
    weight: float


@dataclass(frozen=True, eq=False)
class Drift:
    """Outcome of the test of one series, and its parameters, the most likely one first.

    Attributes:
        name: of the number.
        values: (N,), NaN is missing.
        labels: N names of the values.
        log_evidence: (N,) natural logarithm of the evidence after each value.
        alarm_at: place from 0 at which the evidence reached its limit, or None.
        onset_at, onset_first, onset_last: places of the most likely onset, and of its 90 % interval, or None.
        parameters: of the machine, as far as they can be compared.
        none_of_them: probability that no parameter that was named drives the drift; NaN without one.
        covariates: (N,) by name.
        notes: what the reader should know.
    """

    name: str
    values: FloatArray = field(metadata=LEFT_OUT)
    labels: tuple[str, ...] = field(metadata=LEFT_OUT)
    log_evidence: FloatArray = field(metadata=LEFT_OUT)
    alarm_at: int | None = field(metadata=LEFT_OUT)
    onset_at: int | None = field(metadata=LEFT_OUT)
    onset_first: int | None = field(metadata=LEFT_OUT)
    onset_last: int | None = field(metadata=LEFT_OUT)
    parameters: tuple[Parameter, ...]
    none_of_them: float
    covariates: Mapping[str, FloatArray] = field(metadata=LEFT_OUT)
    notes: tuple[str, ...]

    @property
    @in_json("drift")
    def seen(self) -> bool:
        """Whether the alarm was raised."""
        return self.alarm_at is not None

    @property
    @in_json()
    def evidence(self) -> float:
        """The largest evidence: 100 or more raises the alarm."""
        return math.exp(min(float(self.log_evidence.max()), 700.0))

    @property
    @in_json()
    def alarm(self) -> str | None:
        """Name of the value that raised the alarm."""
        return None if self.alarm_at is None else self.labels[self.alarm_at]

    @property
    @in_json()
    def onset(self) -> str | None:
        """Name of the value from which on the drift most likely is there."""
        return None if self.onset_at is None else self.labels[self.onset_at]

    @property
    @in_json()
    def driver(self) -> str | None:
        """The most likely parameter, or "none of them"; None without a drift or parameters."""
        if self.alarm_at is None or not self.parameters:
            return None
        first = self.parameters[0]
        return first.name if first.weight >= self.none_of_them else NONE

    @property
    @in_json()
    def verdict(self) -> str:
        """The outcome in plain words."""
        total = f"false alarms at most {FALSE_ALARMS:.0%} in total"
        if self.alarm_at is None or self.onset_first is None or self.onset_last is None:
            return f"no drift (evidence at most {self.evidence:.3g} of {1 / FALSE_ALARMS:.0f}; {total})"
        ends = f"{self.labels[self.onset_first]} to {self.labels[self.onset_last]}"
        words = f"drift since about {self.onset} ({ends}), seen at {self.alarm}; {total}"
        if self.driver is None:
            return words
        first = self.parameters[0]
        return (
            f"{words}; most likely {self.driver}: {first.name} has the weight {first.weight:.3g}, "
            f"{NONE} {self.none_of_them:.3g}"
        )


def drift_study(
    name: str, values: FloatArray, labels: tuple[str, ...], covariates: Mapping[str, FloatArray]
) -> Drift:
    """Test a series for a drift, and compare it with parameters of the machine.

    Args:
        name: of the number.
        values: (N,) in the order in which they were measured; NaN is missing.
        labels: N names of the values.
        covariates: (N,) parameters of the machine by name; NaN is missing.

    Raises:
        UsageError: fewer than 8 values.
    """
    measured = np.flatnonzero(~np.isnan(values))
    if len(measured) < FEW:
        raise UsageError(f"{name}: a test for drift needs {FEW} measured values or more, not {len(measured)}")
    ranks = sequential_ranks(values[measured])
    logs = log_evidence(ranks)
    found = np.zeros(len(values))
    found[measured] = logs
    found[np.isnan(values)] = -np.inf
    over = np.flatnonzero(logs >= -math.log(FALSE_ALARMS))
    alarm = int(over[0]) if len(over) else None
    weights = None if alarm is None else onset_weights(ranks[: alarm + 1])
    series = {one: column[measured] for one, column in covariates.items()}
    parameters, none, notes = _compared(values[measured], series, weights)
    onset = first = last = None
    if weights is not None:
        chances = np.cumsum(weights)
        onset = int(measured[int(np.argmax(weights))])
        first, last = (
            int(measured[min(int(np.searchsorted(chances, q)), len(chances) - 1)]) for q in (0.05, 0.95)
        )
    seen = None if alarm is None else int(measured[alarm])
    return Drift(
        name, values, labels, found, seen, onset, first, last, parameters, none, covariates, tuple(notes)
    )


def _compared(
    values: FloatArray, series: Mapping[str, FloatArray], weights: FloatArray | None
) -> tuple[tuple[Parameter, ...], float, list[str]]:
    """Parameters with their correlations and weights, the heaviest first; the weight of none; notes."""
    start, stop, onset = 0, len(values), 0
    if weights is not None:
        onset = int(np.argmax(weights))
        start, stop = max(0, onset - BEFORE), min(len(values), len(weights) + AFTER)
    notes, kept = [], {}
    for name, column in series.items():
        there = column[start:stop][~np.isnan(column[start:stop])]
        if len(there) < max(FEW, _PRESENT * (stop - start)):
            notes.append(f"{name} is left out: {len(there)} of {stop - start} values have it")
        elif np.ptp(there) == 0.0:
            notes.append(f"{name} is left out: it never changed")
        else:
            kept[name] = column
    lagged = {name: _lagged(values, column, start, stop) for name, column in kept.items()}
    shares = dict.fromkeys(kept, math.nan)
    none = math.nan
    if weights is not None:
        columns = {name: (column[start:stop], lag) for name, (column, lag) in lagged.items()}
        shares, none = _shares(values[start:stop], columns, weights[start:], onset - start)
    found = [
        _parameter(
            name,
            values[start:stop],
            column[start:stop],
            lag,
            None if weights is None else onset - start,
            shares[name],
        )
        for name, (column, lag) in lagged.items()
    ]
    order = (lambda one: -abs(one.correlation)) if weights is None else (lambda one: -one.weight)
    return tuple(sorted(found, key=order)), none, notes


def _lagged(values: FloatArray, column: FloatArray, start: int, stop: int) -> tuple[FloatArray, int]:
    """A parameter shifted by the lag at which it fits best, and the lag; a lag has to be worth a further constant."""
    best, kept, lag = math.inf, column, 0
    for back in range(LAGS + 1):
        moved = np.full(len(column), np.nan)
        moved[back:] = column[: len(column) - back]
        both = ~np.isnan(moved[start:stop])
        count = int(both.sum())
        if count < FEW or np.ptp(moved[start:stop][both]) == 0.0:
            continue
        r = float(np.corrcoef(moved[start:stop][both], values[start:stop][both])[0, 1])
        score = count * math.log(max(1.0 - r * r, 1e-12)) + (math.log(count) if back else 0.0)
        if score < best:
            best, kept, lag = score, moved, back
    return kept, lag


def _parameter(
    name: str, values: FloatArray, column: FloatArray, lag: int, onset: int | None, weight: float
) -> Parameter:
    both = ~np.isnan(column)
    x, y = column[both], values[both]
    r = float(np.corrcoef(x, y)[0, 1])
    reach = 1.959964 / math.sqrt(max(len(x) - 3, 1))
    middle = math.atanh(max(min(r, 1.0 - 1e-12), -1.0 + 1e-12))
    change = math.nan
    if onset is not None:
        parts = column[:onset], column[onset:]
        change = _mean(parts[1]) - _mean(parts[0])
    slope = r * float(y.std()) / float(x.std())
    ends = math.tanh(middle - reach), math.tanh(middle + reach)
    return Parameter(name, len(x), r, *ends, slope, lag, change, weight)


def _mean(values: FloatArray) -> float:
    there = values[~np.isnan(values)]
    return float(there.mean()) if len(there) else math.nan


def _shares(
    values: FloatArray, columns: Mapping[str, tuple[FloatArray, int]], weights: FloatArray, onset: int
) -> tuple[dict[str, float], float]:
    """Probability of each parameter that its part of the change at the onset is the largest, and that of none."""
    names = list(columns)
    whole = ~np.isnan(np.stack([values, *(column for column, _ in columns.values())])).any(axis=0)
    place = np.arange(len(values))
    likely = [int(k) for k in np.argsort(weights)[::-1][:12] if weights[k] > 0.01 * weights.max()]
    shapes, priors = [], []
    for at in likely:
        for shape in ((place >= at).astype(np.float64), np.maximum(place - at + 1.0, 0.0)):
            if np.ptp(shape[whole]) > 0.0:
                shapes.append(shape)
                priors.append(math.log(0.25 / len(values)))  # it could have begun anywhere
    table = np.stack([*(column for column, _ in columns.values()), *shapes])[:, whole]
    after = place[whole] >= onset
    if not after.any() or after.all():
        return dict.fromkeys(names, 0.0), 1.0
    table = table - table.mean(axis=1, keepdims=True)
    table /= table.std(axis=1, keepdims=True)
    y = values[whole] - values[whole].mean()
    steps = table[:, after].mean(axis=1) - table[:, ~after].mean(axis=1)
    sign = math.copysign(1.0, float(y[after].mean() - y[~after].mean()))
    lags = np.array([lag > 0 for _, lag in columns.values()] + [False] * len(shapes))
    chances, drivers = [], []
    most = min(TOGETHER, len(names))
    for size in range(most + 1):
        sets = list(itertools.combinations(range(len(names)), size))
        prior = -math.log(most + 1) - math.log(len(sets))
        base = np.array(sets, dtype=np.int64).reshape(len(sets), size)
        options = [(base, np.full(len(sets), prior + math.log(0.5)))]
        for number, log in enumerate(priors):
            extra = np.full((len(sets), 1), len(names) + number)
            options.append((np.hstack([base, extra]), np.full(len(sets), prior + log)))
        for models, start in options:
            chance, driver = _models(table, y, models, steps * sign, lags)
            chances.append(chance + start)
            drivers.append(np.where(driver < len(names), driver, -1))
    logs, who = np.concatenate(chances), np.concatenate(drivers)
    shares = np.exp(logs - logs.max())
    shares /= shares.sum()
    found = {name: float(shares[who == number].sum()) for number, name in enumerate(names)}
    return found, float(shares[who == -1].sum())


def _models(
    table: FloatArray, y: FloatArray, models: IntArray, steps: FloatArray, lags: npt.NDArray[np.bool_]
) -> tuple[FloatArray, IntArray]:
    """-BIC/2 of linear models, each a row of columns of the table, and the column whose part of the change is largest.

    The column is -1 where no column changes the values the way that they changed.
    """
    count, size = len(y), models.shape[1]
    left = float(y @ y)
    residual = np.full(len(models), left)
    driver = np.full(len(models), -1)
    if size:
        gram = (table @ table.T)[models[:, :, None], models[:, None, :]] + 1e-9 * count * np.eye(size)
        right = (table @ y)[models]
        slopes = np.linalg.solve(gram, right[..., None])[..., 0]
        residual = np.maximum(left - (slopes * right).sum(axis=1), 1e-12 * left)
        parts = slopes * steps[models]
        largest = np.argmax(parts, axis=1)
        rows = np.arange(len(models))
        driver = np.where(parts[rows, largest] > 0.0, models[rows, largest], -1)
    constants = size + lags[models].sum(axis=1)
    return -0.5 * (count * np.log(residual / count) + constants * math.log(count)), driver
