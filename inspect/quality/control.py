"""Statistical control of one number: chart, EWMA, patterns, capability and normality, and a verdict in words.

The exponentially weighted moving average (EWMA) shows slow drifts that no single value shows. Source: S. W. Roberts,
Technometrics 1 (1959) 239; NIST/SEMATECH e-Handbook 6.3.2.4. The limits are the exact ones, which are narrower for
the first values.

Normality is tested after Anderson and Darling; where values are not normal, the result says what to do. Source: R. B.
D'Agostino and M. A. Stephens (ed.), Goodness-of-Fit Techniques (1986), table 4.9: the statistic for a mean and a
standard deviation that are estimated, and its p-value.
"""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.base.notebook import axes_or_new, data_frame, html_table
from anisoscope.quality.capability import GOOD, POOR, Capability, Specification, capability
from anisoscope.quality.distributions import FittedCapability, fitted_capability
from anisoscope.quality.individuals import BoolArray, Limits, Period, given_limits, limits_of, moving_range
from anisoscope.quality.nelson import RULES, Flag, flags

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WEIGHT, WIDTH = 0.2, 3.0


@dataclass(frozen=True, eq=False)
class Ewma:
    """The average after every value, and its limits.

    Attributes:
        average: (N,); NaN where no value was measured: the average then stands still.
        lower, upper: (N,) exact limits for as many values as were measured so far.
        weight: lambda, the share of the newest value.
        width: L, in standard deviations of the average.
    """

    average: FloatArray = field(metadata=LEFT_OUT)
    lower: FloatArray = field(metadata=LEFT_OUT)
    upper: FloatArray = field(metadata=LEFT_OUT)
    weight: float = field(metadata=json_field("lambda"))
    width: float

    @property
    def outside(self) -> BoolArray:
        """(N,) averages beyond their limits."""
        return (self.average < self.lower) | (self.average > self.upper)


def ewma(values: FloatArray, limits: Limits, weight: float = WEIGHT, width: float = WIDTH) -> Ewma:
    """The average of a series, started at the centre of its limits.

    Args:
        values: (N,), NaN is missing.
        limits: centre and short-term standard deviation.
        weight: lambda, above 0 and at most 1; 1 is the chart of the values themselves.
        width: L, above 0.

    Raises:
        UsageError: a weight or a width that makes no sense.
    """
    if not 0.0 < weight <= 1.0:
        raise UsageError(f"the weight of an EWMA (lambda) lies above 0 and at most at 1, not at {weight:g}")
    if not 0.0 < width < 100.0:
        raise UsageError(f"the width of the limits of an EWMA (L) lies above 0, not at {width:g}")
    valid = ~np.isnan(values)
    average = np.full(len(values), np.nan)
    average[valid] = _averaged(values[valid], limits.center, weight)
    seen = np.maximum(np.cumsum(valid), 1)
    spread = weight / (2.0 - weight) * -np.expm1(2.0 * seen * np.log1p(-weight)) if weight < 1.0 else 1.0
    reach = width * limits.sigma * np.sqrt(np.broadcast_to(spread, average.shape))
    return Ewma(average, limits.center - reach, limits.center + reach, weight, width)


def _averaged(values: FloatArray, start: float, weight: float) -> FloatArray:
    found, last = np.empty(len(values)), start
    for number, value in enumerate(values.tolist()):
        last += weight * (value - last)
        found[number] = last
    return found


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


@dataclass(frozen=True)
class Settings:
    """Settings of a control chart.

    Attributes:
        baseline: measured values from the start that the limits rest on; None for all.
        weight: lambda of the EWMA.
        width: L of the EWMA.
        center, sigma: known mean and short-term standard deviation, in place of a baseline; both or neither.
        period: whose values the limits rest on, in place of a baseline.
        distribution: of the capability by quantiles besides that of a normal one, or "best"; None for none.
        rules: numbers of Nelson's rules that count.

    Raises:
        UsageError: a rule that there is not, or none.
    """

    baseline: int | None = None
    weight: float = WEIGHT
    width: float = WIDTH
    center: float | None = None
    sigma: float | None = None
    period: Period | None = None
    distribution: str | None = None
    rules: tuple[int, ...] = tuple(RULES)

    def __post_init__(self) -> None:
        if not self.rules or not set(self.rules) <= set(RULES):
            raise UsageError(
                f"Nelson's rules have the numbers 1 to {len(RULES)}: name some of them, such as 1,2,5,6"
            )

    def limits(self, values: FloatArray) -> Limits:
        """Limits of a series.

        Raises:
            UsageError: one of mean and sigma is missing, or as `limits_of`.
        """
        if (self.center is None) != (self.sigma is None):
            raise UsageError("a known mean and a known sigma go together: give both or neither")
        if self.period is not None and (self.baseline, self.center) != (None, None):
            raise UsageError(
                "limits rest on a reference period, on a baseline or on a known mean and sigma: name one of them"
            )
        if self.center is not None and self.sigma is not None:
            if self.baseline is not None:
                raise UsageError("a known mean and sigma take the place of a baseline: leave one of them out")
            return given_limits(self.center, self.sigma)
        return limits_of(values, self.baseline, self.period)


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


@dataclass(frozen=True, eq=False)
class ControlStudy:
    """Control chart of one series: limits, rule violations, normality and capability.

    Attributes:
        name: of the number, and of the group it belongs to.
        values: (N,), NaN is missing.
        labels: N names of the values, such as serial numbers.
        limits: of the chart.
        ranges: (N,) moving ranges.
        average: EWMA.
        flags: patterns of the values.
        wide: (N,) moving ranges above their limit.
        capability: where there is a specification.
        normality: where there are enough values.
        notes: what the reader should know.
        fitted: capability by a fitted distribution, where it was asked for.
    """

    name: str
    values: FloatArray = field(metadata=LEFT_OUT)
    labels: tuple[str, ...] = field(metadata=LEFT_OUT)
    limits: Limits
    ranges: FloatArray = field(metadata=LEFT_OUT)
    average: Ewma = field(metadata=json_field("ewma"))
    flags: tuple[Flag, ...] = field(metadata=LEFT_OUT)
    wide: BoolArray = field(metadata=LEFT_OUT)
    capability: Capability | None
    normality: Normality | None
    notes: tuple[str, ...]
    fitted: FittedCapability | None = None

    @property
    @in_json("measured")
    def count(self) -> int:
        """Measured values."""
        return int(np.count_nonzero(~np.isnan(self.values)))

    @property
    @in_json()
    def missing(self) -> int:
        """Values that were not measured."""
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
        """Labels of the moving ranges above their limit."""
        return tuple(self.labels[k] for k in np.flatnonzero(self.wide))

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
        words = [f"stable: nothing unusual among {self.count} values" if self.stable else self._trouble()]
        if self.capability is not None:
            words.append(capable_words(self.capability, self.stable))
        if self.fitted is not None:
            words.append(self.fitted.verdict)
        return "; ".join(words)

    def _trouble(self) -> str:
        found = []
        if self.flags:
            first, patterns = self.flags[0], _times(len(self.flags), "pattern")
            name, rule, meaning = self.labels[first.seen_at], first.rule, first.text
            found.append(f"{patterns}, the first at {name} (rule {rule}: {meaning})")
        if self.wide.any():
            jumps = _times(int(self.wide.sum()), "jump")
            found.append(f"{jumps} between neighbours above the limit")
        if self.average.outside.any():
            name = self.labels[int(np.argmax(self.average.outside))]
            found.append(f"the moving average leaves its limits, first at {name}")
        trouble = "; ".join(found)
        return f"not stable: {trouble}"

    def __repr__(self) -> str:
        """One line: name, how many values, and the outcome."""
        return f"ControlStudy({self.name}, {self.count} values: {self.verdict})"

    def _repr_html_(self) -> str:
        limits = self.limits
        rows = [
            ("outcome", self.verdict),
            ("values", self.count),
            ("centre", f"{limits.center:.5g}"),
            ("limits", f"{limits.lower:.5g} to {limits.upper:.5g}"),
            ("short-term standard deviation", f"{limits.sigma:.3g}"),
            *(("note", note) for note in self.notes),
        ]
        return html_table(self.name, ("", ""), rows)

    def plot(self, axes: "Axes | None" = None) -> "Axes":
        """Draw the chart of individual values with its limits; values that belong to a pattern are red.

        Args:
            axes: of matplotlib, to draw into; a new figure where they are not given.
        """
        axes, limits = axes_or_new(axes), self.limits
        at = np.arange(1, len(self.values) + 1)
        marked = np.zeros(len(at), dtype=bool)
        for flag in self.flags:
            marked[flag.first : flag.last + 1] = True
        axes.plot(at, self.values, "o-", color="tab:blue")
        axes.plot(at[marked], self.values[marked], "o", color="tab:red")
        axes.axhline(limits.center, color="grey")
        for limit in (limits.lower, limits.upper):
            axes.axhline(limit, color="grey", linestyle="--")
        axes.set(xlabel="value", ylabel=self.name)
        return axes

    def to_frame(self) -> Any:  # noqa: ANN401 - pandas need not be installed
        """The values as a pandas data frame: label, value, moving range, whether it belongs to a pattern.

        Raises:
            UsageError: pandas is not installed.
        """
        patterns = [
            any(flag.first <= place <= flag.last for flag in self.flags) for place in range(len(self.values))
        ]
        return data_frame(
            {"label": self.labels, "value": self.values, "range": self.ranges, "in_pattern": patterns}
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


def control_study(
    name: str,
    values: FloatArray,
    labels: tuple[str, ...],
    settings: Settings,
    specification: Specification | None = None,
) -> ControlStudy:
    """Chart and judge a series.

    Args:
        name: of the number.
        values: (N,) in the order in which they were measured; NaN is missing.
        labels: N names of the values.
        settings: how.
        specification: limits of good parts.

    Raises:
        UsageError: too few values, or settings that make no sense.
    """
    if settings.distribution is not None and specification is None:
        raise UsageError(f"{name}: a capability by a distribution needs limits: --lower, --upper or --recipe")
    limits = settings.limits(values)
    ranges = moving_range(values)
    wide = ranges > limits.range_upper
    average = ewma(values, limits, settings.weight, settings.width)
    found = flags(values, limits.center, limits.sigma, settings.rules)
    able = None if specification is None else capability(values, limits, specification)
    notes = tuple(_notes(values, ranges, limits))
    fitted = None
    if settings.distribution is not None and specification is not None:
        fitted = fitted_capability(values, specification, settings.distribution)
    normal = anderson_darling(values)
    return ControlStudy(
        name, values, labels, limits, ranges, average, found, wide, able, normal, notes, fitted
    )


def _notes(values: FloatArray, ranges: FloatArray, limits: Limits) -> list[str]:
    number, known = int(np.isnan(values).sum()), ranges[~np.isnan(ranges)]
    notes = []
    if number:
        missing = _times(number, "value")
        notes.append(f"{missing} missing; no moving range and no pattern reaches across")
    if limits.baseline == 0:
        notes.append("mean and sigma of the limits were given")
    elif limits.baseline < FEW:
        notes.append(f"the limits rest on {limits.baseline} values only; {FEW} or more are usual")
    still = int(np.count_nonzero(known == 0.0))
    if len(known) and still > 0.3 * len(known):
        notes.append(
            f"{still} of {len(known)} neighbours are equal: the number is rounded too coarsely for a chart, and its "
            "limits are too narrow or too wide"
        )
    return notes
