"""Statistical control: a chart of points, EWMA, patterns, capability and normality, and a verdict in words.

The exponentially weighted moving average (EWMA) shows slow drifts that no single value shows. Source: S. W. Roberts,
Technometrics 1 (1959) 239; NIST/SEMATECH e-Handbook 6.3.2.4. The limits are the exact ones, which are narrower for
the first points and follow the sizes of subgroups.

Normality is tested after Anderson and Darling; where values are not normal, the result says what to do. Source: R. B.
D'Agostino and M. A. Stephens (ed.), Goodness-of-Fit Techniques (1986), table 4.9: the statistic for a mean and a
standard deviation that are estimated, and its p-value.
"""

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.base.notebook import axes_or_new, data_frame, html_table
from anisoscope.parameters.charting import Charting
from anisoscope.quality.capability import GOOD, POOR, Capability, Specification, capability
from anisoscope.quality.distributions import FittedCapability, fitted_capability
from anisoscope.quality.limits import (
    CHARTS,
    BoolArray,
    Limits,
    Period,
    Points,
    given_limits,
    limits_of,
)
from anisoscope.quality.limits import WIDTH as SIGMAS
from anisoscope.quality.nelson import RULES, Flag, flags

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WEIGHT, WIDTH = Charting.weight, Charting.width


@dataclass(frozen=True, eq=False)
class Line:
    """A line of a chart: points, and a centre and limits for each of them.

    Attributes:
        name: what it shows.
        values: (N,); NaN where there is none.
        center, lower, upper: (N,).
    """

    name: str = field(metadata=LEFT_OUT)
    values: FloatArray = field(metadata=LEFT_OUT)
    center: FloatArray = field(metadata=LEFT_OUT)
    lower: FloatArray = field(metadata=LEFT_OUT)
    upper: FloatArray = field(metadata=LEFT_OUT)

    @property
    def outside(self) -> BoolArray:
        """(N,) points beyond their limits."""
        return (self.values < self.lower) | (self.values > self.upper)


@dataclass(frozen=True, eq=False)
class Ewma(Line):
    """The average after every point: ``weight`` is lambda, the share of the newest, ``width`` L in its own sigma."""

    weight: float = field(metadata=json_field("lambda"))
    width: float


LineT = TypeVar("LineT", bound=Line)


def ewma(
    values: FloatArray, center: float, sigma: FloatArray, weight: float = WEIGHT, width: float = WIDTH
) -> Ewma:
    """The average of a series, started at its centre; it stands still where nothing was measured, and is NaN there.

    Args:
        values: (N,), NaN is missing.
        center: of the chart.
        sigma: (N,) short-term standard deviations of the values, or one for all.
        weight: lambda, above 0 and at most 1; 1 is the chart of the values themselves.
        width: L, above 0.

    Raises:
        UsageError: a weight or a width that makes no sense.
    """
    if not 0.0 < weight <= 1.0:
        raise UsageError(f"the weight of an EWMA (lambda) lies above 0 and at most at 1, not at {weight:g}")
    if not 0.0 < width < 100.0:
        raise UsageError(f"the width of the limits of an EWMA (L) lies above 0, not at {width:g}")
    average, variance = np.full(len(values), np.nan), np.empty(len(values))
    last, scatter, keep = center, 0.0, (1.0 - weight) ** 2
    new = (weight * np.broadcast_to(sigma, values.shape)) ** 2
    for place, (value, own) in enumerate(zip(values.tolist(), new.tolist(), strict=True)):
        if not math.isnan(value):
            last += weight * (value - last)
            scatter = own + keep * scatter
            average[place] = last
        variance[place] = scatter or own
    reach = width * np.sqrt(variance)
    middle = np.full(len(values), center)
    return Ewma("EWMA", average, middle, middle - reach, middle + reach, weight, width)


MIN_COUNT = 8
LARGE = 5000
ALPHA = 0.05


@dataclass(frozen=True)
class Normality:
    """The test.

    Attributes:
        statistic: A², not adjusted.
        adjusted: A²·(1 + 0.75/n + 2.25/n²).
        p: probability of so large a value among normal ones.
        count: measured values.
        hint: what it means and what to do.
    """

    statistic: float
    adjusted: float
    p: float
    count: int
    hint: str


def anderson_darling(values: FloatArray) -> Normality | None:
    """Test a series; None for fewer than 8 values, or where all are the same.

    Args:
        values: (N,), NaN is missing.
    """
    from scipy.special import log_ndtr  # noqa: PLC0415 - heavy

    ordered = np.sort(values[~np.isnan(values)])
    count = len(ordered)
    if count < MIN_COUNT or ordered[0] == ordered[-1]:
        return None
    z = (ordered - ordered.mean()) / ordered.std(ddof=1)
    weight = 2.0 * np.arange(1, count + 1) - 1.0
    statistic = -count - float(np.mean(weight * (log_ndtr(z) + log_ndtr(-z[::-1]))))
    adjusted = statistic * (1.0 + 0.75 / count + 2.25 / count**2)
    p = p_value(adjusted)
    distinct = 1 + int(np.count_nonzero(np.diff(ordered)))
    return Normality(statistic, adjusted, p, count, _hint(p, count, distinct))


def p_value(adjusted: float) -> float:
    """Probability of the adjusted statistic, after D'Agostino and Stephens."""
    a = adjusted
    if a >= 0.6:
        power = 1.2937 - 5.709 * a + 0.0186 * a * a if a < 13.0 else -math.inf
        return math.exp(power)
    if a >= 0.34:
        return math.exp(0.9177 - 4.279 * a - 1.38 * a * a)
    if a >= 0.2:
        return 1.0 - math.exp(-8.318 + 42.796 * a - 59.938 * a * a)
    return 1.0 - math.exp(-13.436 + 101.14 * a - 223.73 * a * a)


def _hint(p: float, count: int, distinct: int) -> str:
    if p >= ALPHA:
        return "nothing speaks against normal values"
    why = "the values are not normal: "
    if distinct < 20 and distinct < count / 3:
        return why + f"only {distinct} different ones occur, so they are rounded; record more digits"
    advice = (
        "first look for shifts and for mixed lots or cavities (--by); if the chart is quiet, trust the values that "
        "were counted beyond the limits more than Cpk"
    )
    if count > LARGE:
        return why + "with so many, the smallest departure shows; " + advice
    return why + advice


FEW = 20
FEW_COUNTED = 5
COUNTED_RULES = (1, 2, 3, 4)


@dataclass(frozen=True)
class Settings:
    """Settings of a control chart.

    Attributes:
        baseline: measured points from the start that the limits rest on; None for all.
        weight: lambda of the EWMA.
        width: L of the EWMA.
        center, sigma: known mean and short-term standard deviation, in place of a baseline; both or neither.
        period: whose values the limits rest on, in place of a baseline.
        distribution: of the capability by quantiles besides that of a normal one, or "best"; None for none.
        rules: numbers of Nelson's rules that count; all by default, of shares and rates the first four.
        chart: one of ``CHARTS``.
        known: limits of earlier data, in place of a baseline.

    Raises:
        UsageError: a rule that there is not, or none; an unknown chart.
    """

    baseline: int | None = None
    weight: float = WEIGHT
    width: float = WIDTH
    center: float | None = None
    sigma: float | None = None
    period: Period | None = None
    distribution: str | None = None
    rules: tuple[int, ...] | None = None
    chart: str = "i-mr"
    known: Limits | None = None

    def __post_init__(self) -> None:
        if self.chart not in CHARTS:
            raise UsageError(f"--chart takes {', '.join(CHARTS)}, not {self.chart!r}")
        if self.rules is not None and not (self.rules and set(self.rules) <= set(RULES)):
            raise UsageError(
                f"Nelson's rules have the numbers 1 to {len(RULES)}: name some of them, such as 1,2,5,6"
            )

    def limits(self, points: Points) -> Limits:
        """Limits of a series.

        Raises:
            UsageError: one of mean and sigma is missing, several sources of limits, or as `limits_of`.
        """
        if (self.sigma is not None and self.center is None) or (
            self.center is not None and self.sigma is None and not points.counted
        ):
            raise UsageError("a known mean and a known sigma go together: give both or neither")
        if self.center is not None and self.baseline is not None:
            raise UsageError("a known mean and sigma take the place of a baseline: leave one of them out")
        if sum(one is not None for one in (self.period, self.baseline, self.center, self.known)) > 1:
            raise UsageError(
                "limits rest on a reference period, on a baseline, on earlier limits or on a known mean and sigma: "
                "name one of them"
            )
        if self.center is not None:
            return given_limits(self.center, *(() if self.sigma is None else (self.sigma,)))
        return self.known or limits_of(points, self.baseline, self.period)


@dataclass(frozen=True)
class Pattern:
    """A pattern of a chart for its reader.

    Attributes:
        rule: number of the rule.
        text: the rule in words.
        first, last: places of its first and last value, from 1.
        seen_at: place of the value at which it became complete, from 1.
        labels: of its values.
    """

    rule: int
    text: str
    first: int
    last: int
    seen_at: int
    labels: tuple[str, ...]


@dataclass(frozen=True)
class Point:
    """A subgroup: its label, how many values or parts it has, mean, share or rate, its limits, and its spread."""

    label: str
    size: float
    value: float
    lower: float
    upper: float
    spread: float


@dataclass(frozen=True)
class ChartLimits:
    """Numbers of a chart; None for a limit that follows the size of the subgroups, or that the chart does not have."""

    center: float
    sigma: float
    lower: float | None
    upper: float | None
    range_center: float | None
    range_upper: float | None
    baseline: int


@dataclass(frozen=True, eq=False)
class ControlStudy:
    """Control chart of one series: limits, rule violations, normality and capability.

    Attributes:
        name: of the number, and of the group it belongs to.
        points: N points: single values, means of subgroups, shares or rates.
        basis: of the limits.
        line: the points with their limits.
        spread: moving range, or range or standard deviation of the subgroups; None where there is none.
        average: EWMA.
        flags: patterns of the points.
        capability: where there is a specification.
        normality: of the single values, where there are enough.
        notes: what the reader should know.
        fitted: capability by a fitted distribution, where it was asked for.
    """

    name: str
    points: Points = field(metadata=json_field("chart", by=lambda points: points.chart))
    basis: Limits = field(metadata=LEFT_OUT)
    line: Line = field(metadata=LEFT_OUT)
    spread: Line | None = field(metadata=LEFT_OUT)
    average: Ewma = field(metadata=json_field("ewma"))
    flags: tuple[Flag, ...] = field(metadata=LEFT_OUT)
    capability: Capability | None
    normality: Normality | None
    notes: tuple[str, ...]
    fitted: FittedCapability | None = None

    @property
    def values(self) -> FloatArray:
        """(N,) of the points, NaN is missing."""
        return self.points.values

    @property
    def labels(self) -> tuple[str, ...]:
        """N names of the points, such as serial numbers."""
        return self.points.labels

    @property
    def lines(self) -> tuple[Line, ...]:
        """All lines, that of the points first."""
        return tuple(one for one in (self.line, self.spread, self.average) if one is not None)

    @property
    @in_json()
    def limits(self) -> ChartLimits:
        """Limits as numbers, as far as all points have the same."""
        spread, basis = self.spread, self.basis
        return ChartLimits(
            basis.center,
            basis.sigma,
            _same(self.line.lower),
            _same(self.line.upper),
            None if spread is None else _same(spread.center),
            None if spread is None else _same(spread.upper),
            basis.baseline,
        )

    @property
    @in_json("points", only_given=True)
    def subgroups(self) -> tuple[Point, ...]:
        """The points of charts of subgroups; none of single values."""
        if self.points.chart == "i-mr":
            return ()
        spread = np.full(len(self.values), np.nan) if self.spread is None else self.spread.values
        columns = (self.values, self.line.lower, self.line.upper, spread)
        rows = zip(*(one.tolist() for one in columns), strict=True)
        sizes = self.points.sizes.tolist()
        return tuple(
            Point(*one, *row) for one, row in zip(zip(self.labels, sizes, strict=True), rows, strict=True)
        )

    @property
    @in_json("measured")
    def count(self) -> int:
        """Measured points."""
        return int(np.count_nonzero(~np.isnan(self.values)))

    @property
    @in_json()
    def missing(self) -> int:
        """Points that were not measured."""
        return len(self.values) - self.count

    @property
    @in_json("flags")
    def patterns(self) -> tuple[Pattern, ...]:
        """The flags with their places and labels."""
        return tuple(
            Pattern(
                one.rule,
                one.text,
                one.first + 1,
                one.last + 1,
                one.seen_at + 1,
                self.labels[one.first : one.last + 1],
            )
            for one in self.flags
        )

    @property
    @in_json()
    def wide_ranges(self) -> tuple[str, ...]:
        """Labels of the ranges or standard deviations beyond their limits."""
        return tuple(self.labels[k] for k in np.flatnonzero(self.wide))

    @property
    def wide(self) -> BoolArray:
        """(N,) spreads beyond their limits."""
        return np.zeros(len(self.values), dtype=np.bool_) if self.spread is None else self.spread.outside

    @property
    @in_json()
    def ewma_outside(self) -> tuple[str, ...]:
        """Labels of the averages beyond their limits."""
        return tuple(self.labels[k] for k in np.flatnonzero(self.average.outside))

    @property
    @in_json()
    def stable(self) -> bool:
        """No pattern, no wide range, no average outside."""
        return not (self.flags or self.wide.any() or self.average.outside.any())

    @property
    @in_json()
    def verdict(self) -> str:
        """The outcome in plain words."""
        quiet = (
            f"stable: nothing unusual among {self.count} values"
            if self.points.chart == "i-mr"
            else f"stable: nothing unusual among {self.count} subgroups"
        )
        words = [quiet if self.stable else self._trouble()]
        if self.capability is not None:
            words.append(capable_words(self.capability, self.stable))
        if self.fitted is not None:
            words.append(self.fitted.verdict)
        return "; ".join(words)

    @property
    def unit(self) -> str:
        """What its points are."""
        return "values" if self.points.chart == "i-mr" else "subgroups"

    def _trouble(self) -> str:
        found = []
        if self.flags:
            first, patterns = self.flags[0], _times(len(self.flags), "pattern")
            name, rule, meaning = self.labels[first.seen_at], first.rule, first.text
            found.append(f"{patterns}, the first at {name} (rule {rule}: {meaning})")
        if self.wide.any():
            jumps = _times(int(self.wide.sum()), "jump" if self.points.within is None else "spread")
            found.append(
                f"{jumps} between neighbours above the limit"
                if self.points.within is None
                else f"{jumps} within subgroups beyond the limits"
            )
        if self.average.outside.any():
            name = self.labels[int(np.argmax(self.average.outside))]
            found.append(f"the moving average leaves its limits, first at {name}")
        trouble = "; ".join(found)
        return f"not stable: {trouble}"

    def __repr__(self) -> str:
        """One line: name, how many values, and the outcome."""
        return f"ControlStudy({self.name}, {self.count} {self.unit}: {self.verdict})"

    def _repr_html_(self) -> str:
        low, high = self.line.lower, self.line.upper
        rows = [
            ("outcome", self.verdict),
            (self.unit, self.count),
            ("centre", f"{self.basis.center:.5g}"),
            ("limits", f"{np.nanmin(low):.5g} to {np.nanmax(high):.5g}"),
            ("short-term standard deviation", f"{self.basis.sigma:.3g}"),
            *(("note", note) for note in self.notes),
        ]
        return html_table(self.name, ("", ""), rows)

    def plot(self, axes: "Axes | None" = None) -> "Axes":
        """Draw the chart of the points with its limits; points that belong to a pattern are red.

        Args:
            axes: of matplotlib, to draw into; a new figure where they are not given.
        """
        axes, line = axes_or_new(axes), self.line
        at = np.arange(1, len(self.values) + 1)
        marked = np.zeros(len(at), dtype=bool)
        for flag in self.flags:
            marked[flag.first : flag.last + 1] = True
        axes.plot(at, self.values, "o-", color="tab:blue")
        axes.plot(at[marked], self.values[marked], "o", color="tab:red")
        for level, style in ((line.center, "-"), (line.lower, "--"), (line.upper, "--")):
            axes.step(at, level, where="mid", color="grey", linestyle=style)
        axes.set(xlabel=line.name, ylabel=self.name)
        return axes

    def to_frame(self) -> Any:  # noqa: ANN401 - pandas need not be installed
        """The points as a pandas data frame: label, value, spread, whether it belongs to a pattern.

        Raises:
            UsageError: pandas is not installed.
        """
        patterns = [
            any(flag.first <= place <= flag.last for flag in self.flags) for place in range(len(self.values))
        ]
        spread = np.full(len(self.values), np.nan) if self.spread is None else self.spread.values
        return data_frame(
            {"label": self.labels, "value": self.values, "range": spread, "in_pattern": patterns}
        )


def _times(count: int, word: str) -> str:
    return f"{count} {word}" + ("" if count == 1 else "s")


def capable_words(found: Capability, stable: bool) -> str:
    """Capability in words, with its uncertainty."""
    index = found.ppk
    if index.low >= GOOD:
        word = "capable"
    elif index.value >= GOOD:
        word = "probably capable, but too few values to be sure"
    elif index.value >= POOR:
        word = "barely capable"
    else:
        word = "not capable"
    value, low, high = f"{index.value:.2f}", f"{index.low:.2f}", f"{index.high:.2f}"
    capable = f"{word}: Ppk {value} ({low} to {high}), {found.outside} of {found.count} outside"
    return capable if stable else f"{capable}; capability is meaningless until the process is stable"


def _same(values: FloatArray) -> float | None:
    """The number that all are; None where they differ."""
    known = values[~np.isnan(values)]
    return float(known[0]) if len(known) and (known == known[0]).all() else None


OVERDISPERSED = 0.01


def control_study(
    name: str, points: Points, settings: Settings, specification: Specification | None = None
) -> ControlStudy:
    """Chart and judge a series.

    Args:
        name: of the number.
        points: in the order in which they were measured, of the chart that the settings name.
        settings: how.
        specification: limits of good parts.

    Raises:
        UsageError: too few points, or settings that make no sense.
    """
    if specification is not None and points.counted:
        raise UsageError(
            f"{name}: a chart of counts has no limits of good parts: leave --lower and --upper out"
        )
    if settings.distribution is not None and specification is None:
        raise UsageError(f"{name}: a capability by a distribution needs limits: --lower, --upper or --recipe")
    limits = settings.limits(points)
    center = limits.center
    most = 1.0 if points.chart.startswith("p") else math.inf
    if points.counted and not 0.0 < center < most:
        raise UsageError(
            f"{name}: the centre is {center:g}: limits need some that are counted, and some that are not"
        )
    sigma = limits.sigma * points.scale(center)
    names = CHARTS[points.chart]
    line = _line(names[0], points.values, np.full(len(sigma), center), sigma)
    average = ewma(points.values, center, sigma, settings.weight, settings.width)
    if points.counted:
        line, average = _clipped(line, most), _clipped(average, most)
    within, spread = points.spread(center), None
    if within is not None:
        mean, deviation = points.spread_moments()
        spread = _clipped(_line(names[1], within, mean * limits.sigma, deviation * limits.sigma), math.inf)
    rules = settings.rules or (COUNTED_RULES if points.counted else tuple(RULES))
    found = flags(points.values, center, sigma, rules)
    able = None if specification is None else capability(points.single, limits, specification)
    fitted = None
    if settings.distribution is not None and specification is not None:
        fitted = fitted_capability(points.single, specification, settings.distribution)
    normal = anderson_darling(points.single)
    notes = tuple(_notes(points, spread, limits))
    return ControlStudy(name, points, limits, line, spread, average, found, able, normal, notes, fitted)


def _line(name: str, values: FloatArray, center: FloatArray, sigma: FloatArray) -> Line:
    return Line(name, values, center, center - SIGMAS * sigma, center + SIGMAS * sigma)


def _clipped(line: LineT, most: float) -> LineT:
    """A line with limits between 0 and what its points can be at most."""
    return replace(line, lower=np.maximum(line.lower, 0.0), upper=np.minimum(line.upper, most))


def _notes(points: Points, spread: Line | None, limits: Limits) -> list[str]:
    single, number = points.chart == "i-mr", int(np.isnan(points.values).sum())
    notes = []
    if number:
        missing = _times(number, "value" if single else "subgroup")
        notes.append(
            f"{missing} missing; no moving range and no pattern reaches across"
            if single
            else f"{missing} missing; no pattern reaches across"
        )
    if limits.source and limits.baseline == 0:
        notes.append(f"the limits are those of {limits.source}")
    elif limits.baseline == 0:
        notes.append("mean and sigma of the limits were given")
    elif limits.baseline < FEW:
        notes.append(
            f"the limits rest on {limits.baseline} values only; {FEW} or more are usual"
            if single
            else f"the limits rest on {limits.baseline} subgroups only; {FEW} or more are usual"
        )
    if single and spread is not None:
        known = spread.values[~np.isnan(spread.values)]
        still = int(np.count_nonzero(known == 0.0))
        if len(known) and still > 0.3 * len(known):
            notes.append(
                f"{still} of {len(known)} neighbours are equal: the number is rounded too coarsely for a chart, and "
                "its limits are too narrow or too wide"
            )
    return notes + (_counted_notes(points, limits) if points.counted else [])


def _counted_notes(points: Points, limits: Limits) -> list[str]:
    """What a chart of counts presumes: enough of them, and scatter by chance alone (chi-square test of dispersion)."""
    from scipy.special import chdtrc  # noqa: PLC0415 - heavy

    notes = []
    least = float(np.median(points.sizes)) * limits.center
    if least < FEW_COUNTED:
        notes.append(
            f"a subgroup holds {least:.2g} counted ones on average: limits of fewer than {FEW_COUNTED} are "
            "rough; larger subgroups have better ones"
        )
    z = ((points.values - limits.center) / points.scale(limits.center))[
        limits.first : limits.last + 1 or None
    ]
    z = z[~np.isnan(z)]
    freedom, square = len(z) - (limits.baseline > 0), float(z @ z)
    chance = float(chdtrc(freedom, square)) if freedom > 0 else 1.0
    if chance < OVERDISPERSED and "laney" not in points.chart:
        notes.append(
            f"the points scatter more than by chance (chi-square {square:.1f} with {freedom} degrees of freedom, p "
            f"{chance:.2g}): lots or days differ, and these limits are too narrow; --chart {points.chart}-laney widens "
            "them to what neighbours show"
        )
    return notes
