"""Points of control charts, and limits from a chosen part of them: single values, means of subgroups, shares, rates.

One mechanism serves all charts. A point scatters about the centre c by sigma · scale, where scale is 1/√n for the mean
of n values, √(c(1 − c)/n) for a share, √(c/n) for a rate. sigma is 1 for shares and rates, else it is found from how
much neighbours or the values of a subgroup differ: the spread over the mean that it has for sigma 1, each weighted by
the square of that mean over its standard deviation (I. W. Burr, Journal of Quality Technology 1 (1969) 163).

Sources: NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2 and 6.3.3; D. B. Laney, Quality Engineering 14 (2002)
531, for shares and rates whose scatter is that of the process. A missing value has no moving range, and neither has the
value after it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT

BoolArray = npt.NDArray[np.bool_]

D2 = 2.0 / math.sqrt(math.pi)  # mean range of two values of a normal distribution, in sigma
D3 = math.sqrt(2.0 - 4.0 / math.pi)  # standard deviation of that range
WIDTH = 3.0
MIN_BASELINE = 5
CHARTS = {
    "i-mr": ("value", "moving range"),
    "xbar-r": ("mean", "range"),
    "xbar-s": ("mean", "standard deviation"),
    "p": ("share", ""),
    "p-laney": ("share", "moving range of z"),
    "u": ("rate", ""),
    "u-laney": ("rate", "moving range of z"),
}
"""Names of the points and of the spread of every chart."""


@lru_cache(maxsize=512)
def range_moments(count: int) -> tuple[float, float]:
    """Mean and standard deviation of the range of some normal values, in sigma (the constants d2 and d3).

    The mean and the mean square are integrals of the probability that the range exceeds r, which is 1 − n ∫ φ(x)
    (Φ(x + r) − Φ(x))ⁿ⁻¹ dx (L. H. C. Tippett, Biometrika 17 (1925) 364).

    Args:
        count: values, 2 or more.
    """
    from scipy.special import ndtr  # noqa: PLC0415 - heavy

    nodes, weights = np.polynomial.legendre.leggauss(80)
    r, weights = 7.0 * (nodes + 1.0), 7.0 * weights
    step = 0.05
    x = np.arange(-9.0, 9.0, step)[:, None]
    density = np.exp(-0.5 * x**2) / math.sqrt(2.0 * math.pi)
    beyond = 1.0 - count * step * (density * (ndtr(x + r) - ndtr(x)) ** (count - 1)).sum(axis=0)
    mean, square = float(weights @ beyond), float(weights @ (2.0 * r * beyond))
    return mean, math.sqrt(square - mean**2)


def deviation_moments(count: int) -> tuple[float, float]:
    """Mean and standard deviation of the standard deviation of some normal values, in sigma (c4 and √(1 − c4²)).

    Args:
        count: values, 2 or more.
    """
    half = 0.5 * (count - 1)
    c4 = math.exp(math.lgamma(half + 0.5) - math.lgamma(half)) / math.sqrt(half)
    return c4, math.sqrt(1.0 - c4**2)


@dataclass(frozen=True, eq=False)
class Points:
    """Points of a chart.

    Attributes:
        chart: one of ``CHARTS``.
        values: (N,); NaN where nothing was measured.
        labels: N names.
        sizes: (N,) values or parts behind each point.
        single: the single measured values behind all points; none of shares and rates.
        within: (N,) range or standard deviation of each subgroup, NaN of a single value; None for other charts.
    """

    chart: str
    values: FloatArray
    labels: tuple[str, ...]
    sizes: FloatArray
    single: FloatArray
    within: FloatArray | None = None

    @property
    def counted(self) -> bool:
        """Shares and rates, whose scatter by chance follows from their centre."""
        return self.chart[0] in "pu"

    def scale(self, center: float) -> FloatArray:
        """(N,) standard deviations of the points for sigma 1."""
        own = {"p": center * (1.0 - center), "u": center}.get(self.chart[0], 1.0)
        return np.sqrt(own / np.where(self.sizes > 0.0, self.sizes, np.nan))

    def spread(self, center: float, base: BoolArray | None = None) -> FloatArray | None:
        """(N,) spread within subgroups or between neighbours, of chosen points only; None where the chart has none."""
        if not CHARTS[self.chart][1]:
            return None
        if self.within is not None:
            return self.within if base is None else np.where(base, self.within, np.nan)
        known = self.values if base is None else np.where(base, self.values, np.nan)
        return moving_range((known - center) / self.scale(center) if self.counted else known)

    def spread_moments(self) -> tuple[FloatArray, FloatArray]:
        """(N,) means and standard deviations of the spread for sigma 1."""
        if self.within is None:
            return np.full(len(self.values), D2), np.full(len(self.values), D3)
        moments = range_moments if self.chart == "xbar-r" else deviation_moments
        known = {n: moments(n) for n in set(self.sizes.astype(int).tolist()) if n > 1}
        found = np.array([known.get(int(n), (np.nan, np.nan)) for n in self.sizes.tolist()])
        return found[:, 0], found[:, 1]


def individuals(values: FloatArray, labels: Sequence[str] | None = None) -> Points:
    """Points of a chart of individual values and their moving range.

    Args:
        values: (N,) in the order in which they were measured; NaN is missing.
        labels: N names; counted from 1 by default.
    """
    names = tuple(map(str, range(1, len(values) + 1))) if labels is None else tuple(labels)
    return Points("i-mr", values, names, np.ones(len(values)), values)


def subgroup_points(groups: Sequence[FloatArray], labels: Sequence[str], chart: str = "xbar-s") -> Points:
    """Points of a chart of means of subgroups with their ranges or standard deviations.

    Args:
        groups: values of every subgroup, NaN is missing; sizes may differ.
        labels: a name for each.
        chart: xbar-r or xbar-s.
    """
    kept = [one[~np.isnan(one)] for one in groups]
    spread = np.ptp if chart == "xbar-r" else _deviation
    within = np.array([spread(one) if len(one) > 1 else np.nan for one in kept])
    means = np.array([one.mean() if len(one) else np.nan for one in kept])
    sizes = np.array([float(len(one)) for one in kept])
    return Points(chart, means, tuple(labels), sizes, np.concatenate([*kept, []]), within)


def _deviation(values: FloatArray) -> float:
    return float(values.std(ddof=1))


def counted_points(counts: FloatArray, sizes: FloatArray, labels: Sequence[str], chart: str = "p") -> Points:
    """Points of a chart of shares of parts (p) or of rates, which are counts for each part (u).

    Args:
        counts: (N,) bad parts, or marks.
        sizes: (N,) parts among which they were counted; a point without any is missing.
        labels: N names.
        chart: p, u, p-laney or u-laney.

    Raises:
        UsageError: a count below 0, or more bad parts than parts.
    """
    most = sizes if chart.startswith("p") else np.inf
    wrong = np.flatnonzero((counts < 0.0) | (counts > most) | (sizes < 0.0))
    if len(wrong):
        place = int(wrong[0])
        raise UsageError(
            f"{labels[place]}: {counts[place]:g} of {sizes[place]:g} is no share of parts: correct the counts"
            if chart.startswith("p")
            else f"{labels[place]}: {counts[place]:g} for {sizes[place]:g} parts is no rate: correct the counts"
        )
    shares = np.divide(counts, sizes, out=np.full(len(counts), np.nan), where=sizes > 0.0)
    return Points(chart, shares, tuple(labels), sizes, np.array([]))


@dataclass(frozen=True)
class Limits:
    """What the limits of a chart rest on.

    Attributes:
        center: mean of the baseline.
        sigma: short-term standard deviation of single values; of shares and rates 1, or their scatter beyond chance.
        baseline: points that the limits rest on; 0 if they were given.
        freedom: degrees of freedom of sigma.
        first, last: places of the first and last of these points, from 0; last is -1 if the limits were given.
        source: reference period, or the file and what its limits rest on, in words; "" where none was named.
    """

    center: float
    sigma: float
    baseline: int
    freedom: float = field(default=math.inf, metadata=LEFT_OUT)
    first: int = field(default=0, metadata=LEFT_OUT)
    last: int = field(default=-1, metadata=LEFT_OUT)
    source: str = field(default="", metadata=LEFT_OUT)


def moving_range(values: FloatArray) -> FloatArray:
    """(N,) absolute differences to the value before; NaN where either is missing, and at the first."""
    ranges = np.full(len(values), np.nan)
    ranges[1:] = np.abs(np.diff(values))
    return ranges


@dataclass(frozen=True, eq=False)
class Period:
    """A reference period: its name, and (N,) which points of a series belong to it."""

    name: str
    inside: BoolArray


def limits_of(points: Points, baseline: int | None = None, period: Period | None = None) -> Limits:
    """Limits from the first measured points of a series, or from those of a reference period.

    Args:
        points: in the order in which they were measured.
        baseline: measured points to use, counted from the start; None for all.
        period: in place of a baseline.

    Raises:
        UsageError: too few points, or a baseline that does not vary.
    """
    name = "baseline" if period is None else f"reference period {period.name}"
    values = points.values if period is None else np.where(period.inside, points.values, np.nan)
    measured = np.flatnonzero(~np.isnan(values))
    if baseline is not None and baseline > len(measured):
        raise UsageError(
            f"the baseline is to hold {baseline} values, but {len(measured)} were measured: choose a smaller one"
        )
    count = len(measured) if baseline is None else baseline
    if count < MIN_BASELINE:
        where = "" if period is None else f" in the {name}"
        what = "values" if points.chart == "i-mr" else "subgroups"
        raise UsageError(f"a control chart needs at least {MIN_BASELINE} measured {what}{where}, not {count}")
    base = np.zeros(len(values), dtype=np.bool_)
    base[measured[:count]] = True
    center = float(np.average(values[base], weights=points.sizes[base]))
    limits = Limits(
        center,
        1.0,
        count,
        math.inf,
        int(measured[0]),
        int(measured[count - 1]),
        "" if period is None else name,
    )
    spread = points.spread(center, base)
    if spread is None:
        return limits
    mean, deviation = points.spread_moments()
    known = ~np.isnan(spread)
    if not known.any():
        raise UsageError(
            f"no two measured values of the {name} follow each other: there is no moving range"
            if points.within is None
            else f"no subgroup of the {name} has two values: there is no {CHARTS[points.chart][1]}"
        )
    weight = (mean[known] / deviation[known]) ** 2
    sigma = float(np.average(spread[known] / mean[known], weights=weight))
    if sigma == 0.0:
        raise UsageError(
            f"all values of the {name} are the same: there is nothing to draw limits from; is the number rounded?"
        )
    freedom = sigma_freedom(len(weight)) if points.within is None else 0.5 * float(weight.sum())
    return replace(limits, sigma=sigma, freedom=freedom)


def given_limits(center: float, sigma: float = 1.0, freedom: float = math.inf, source: str = "") -> Limits:
    """Limits from a mean and a standard deviation that are known.

    Raises:
        UsageError: the standard deviation is not above 0.
    """
    if not (0.0 < sigma < math.inf and math.isfinite(center)):
        raise UsageError(
            f"a known mean must be finite and a known sigma above 0, not {center:g} and {sigma:g}"
        )
    return Limits(center, sigma, 0, freedom, source=source)


def sigma_freedom(ranges: int) -> float:
    """Degrees of freedom that a mean of moving ranges is worth as an estimate of sigma.

    The chi-square with the same relative variance; neighbouring ranges share a value and are correlated
    (Cryer & Ryan 1990, Journal of Quality Technology 22, 187). 0.605 for every range in a long series.

    Args:
        ranges: moving ranges that follow each other.
    """
    shared = 4.0 / math.pi * (math.sqrt(3.0) / 2.0 + math.pi / 12.0) - 4.0 / math.pi
    variance = (ranges * D3**2 + 2.0 * (ranges - 1) * shared) / ranges**2
    return 1.0 / (2.0 * variance / D2**2)
