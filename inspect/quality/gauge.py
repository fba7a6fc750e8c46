"""Crossed gauge R&R study: variance components of gauge and parts, their confidence intervals, and the gauge's share.

Two-way analysis of variance with random parts and appraisers: AIAG, Measurement Systems Analysis, 4th edition
(2010), chapter III-B; D. C. Montgomery and G. C. Runger, Quality Engineering 6 (1993) 115 and 289. With one appraiser,
such as a machine that needs none, it is a one-way analysis.

Intervals of the components are modified large-sample ones: sums after F. A. Graybill and C.-M. Wang, Journal of the
American Statistical Association 75 (1980) 869; differences after N. Ting, R. K. Burdick, F. A. Graybill, S. Jeyaratnam
and T.-F. C. Lu, Journal of Statistical Computation and Simulation 35 (1990) 135. For gauge studies see R. K. Burdick,
C. M. Borror and D. C. Montgomery, Design and Analysis of Gauge R&R Studies (2005).

The interval of the gauge's share of all variation is a generalised one: every mean square divided by a chi-square
variable of its own stands for its expectation (a generalised pivotal quantity), and the quantiles of the ratio of these
are the interval. M. Hamada and S. Weerahandi, Journal of Quality Technology 32 (2000) 241; Burdick, Borror and
Montgomery compare it with modified large-sample intervals. With one appraiser it is the exact interval of the
intraclass correlation.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import combinations, product

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.quality.readings import Readings

CONFIDENCE = 0.95


@dataclass(frozen=True)
class MeanSquare:
    """A line of an ANOVA table.

    Attributes:
        source: what varies.
        freedom: degrees of freedom.
        sum_squares: sum of squares.
        f: ratio to the mean square that it is tested against; None where it is not tested.
        p: probability of so large a ratio by chance.
    """

    source: str
    freedom: int
    sum_squares: float
    f: float | None = None
    p: float | None = None

    @property
    @in_json("mean_square")
    def value(self) -> float:
        """Sum of squares over degrees of freedom."""
        return self.sum_squares / self.freedom

    def against(self, other: "MeanSquare") -> "MeanSquare":
        """This line with its F test against another one."""
        from scipy.special import fdtrc  # noqa: PLC0415 - heavy

        if other.value == 0.0:
            return self
        ratio = self.value / other.value
        p = float(fdtrc(self.freedom, other.freedom, ratio))
        return MeanSquare(self.source, self.freedom, self.sum_squares, ratio, p)


def crossed_squares(values: FloatArray) -> tuple[MeanSquare, MeanSquare, MeanSquare, MeanSquare]:
    """Parts, appraisers, their interaction, and repetition.

    Args:
        values: (P, O, R); R repeated measurements of every part by every appraiser.
    """
    p, o, r = values.shape
    mean, cells = values.mean(), values.mean(axis=2)
    by_part, by_whom = cells.mean(axis=1) - mean, cells.mean(axis=0) - mean
    left = cells - mean - by_part[:, None] - by_whom[None, :]
    return (
        MeanSquare("part", p - 1, float(o * r * (by_part**2).sum())),
        MeanSquare("appraiser", max(o - 1, 1), float(p * r * (by_whom**2).sum())),
        MeanSquare("part x appraiser", max((p - 1) * (o - 1), 1), float(r * (left**2).sum())),
        MeanSquare("repeatability", p * o * (r - 1), float(((values - cells[:, :, None]) ** 2).sum())),
    )


def joined(one: MeanSquare, other: MeanSquare) -> MeanSquare:
    """Two lines counted as one."""
    return MeanSquare(
        "repeatability, pooled", one.freedom + other.freedom, one.sum_squares + other.sum_squares
    )


@dataclass(frozen=True)
class Component:
    """Variance component as a combination of mean squares.

    Attributes:
        name: what varies.
        raw: the estimate, which may be negative.
        low, high: confidence interval; never below 0.
    """

    name: str
    raw: float
    low: float
    high: float

    @property
    @in_json()
    def variance(self) -> float:
        """The estimate; 0 where it came out negative."""
        return max(self.raw, 0.0)

    @property
    @in_json()
    def sigma(self) -> float:
        """Standard deviation."""
        return math.sqrt(self.variance)

    @property
    def negative(self) -> bool:
        """The estimate was negative, and counts as 0."""
        return self.raw < 0.0


@dataclass(frozen=True)
class ComponentOfStudy(Component):
    """A component of a study, its standard deviation over the total one, and six of them over the tolerance."""

    of_study: float
    of_tolerance: float | None


Terms = Sequence[tuple[float, MeanSquare]]


def component(name: str, terms: Terms, confidence: float = CONFIDENCE) -> Component:
    """A variance as a sum of weighted mean squares; weights may be negative.

    Args:
        name: what varies.
        terms: weights and mean squares; at most one weight is negative.
        confidence: of the two-sided interval.
    """
    raw = sum(weight * square.value for weight, square in terms)
    tail = (1.0 - confidence) / 2.0
    plus = [(w * s.value, s.freedom) for w, s in terms if w > 0.0]
    minus = [(-w * s.value, s.freedom) for w, s in terms if w < 0.0]
    assert len(minus) <= 1
    below, above = 0.0, 0.0
    for size, freedom in plus:
        g, h = _chi_square_factors(freedom, tail)
        below, above = below + (g * size) ** 2, above + (h * size) ** 2
    for size, freedom in minus:
        g, h = _chi_square_factors(freedom, tail)
        below, above = below + (h * size) ** 2, above + (g * size) ** 2
    crossed = _crossed(plus, minus, tail)
    low, high = (math.sqrt(max(reach, 0.0)) for reach in (below + crossed[0], above + crossed[1]))
    return Component(name, raw, max(raw - low, 0.0), max(raw + high, 0.0))


Sized = Sequence[tuple[float, int]]


def _crossed(plus: Sized, minus: Sized, tail: float) -> tuple[float, float]:
    """The products of two terms in the squares of the reaches below and above; a plain sum has none."""
    below, above = 0.0, 0.0
    for (one, n1), (two, n2) in product(plus, minus):
        (g1, h1), (g2, h2) = _chi_square_factors(n1, tail), _chi_square_factors(n2, tail)
        upper, lower = _f_points(n1, n2, tail)
        below += one * two * ((upper - 1.0) ** 2 - (g1 * upper) ** 2 - h2**2) / upper
        above += one * two * ((1.0 - lower) ** 2 - (h1 * lower) ** 2 - g2**2) / lower
    if minus:
        for (one, n1), (two, n2) in combinations(plus, 2):
            g1, g2 = _chi_square_factors(n1, tail)[0], _chi_square_factors(n2, tail)[0]
            joint = _chi_square_factors(n1 + n2, tail)[0] ** 2 * (n1 + n2) ** 2 / (n1 * n2)
            below += one * two * (joint - g1**2 * n1 / n2 - g2**2 * n2 / n1) / (len(plus) - 1)
    return below, above


@lru_cache
def _chi_square_factors(freedom: int, tail: float) -> tuple[float, float]:
    """Distances of the interval of a variance from its mean square, as shares of it (G and H)."""
    from scipy.special import chdtri  # noqa: PLC0415 - heavy

    return 1.0 - freedom / float(chdtri(freedom, tail)), freedom / float(chdtri(freedom, 1.0 - tail)) - 1.0


@lru_cache
def _f_points(first: int, second: int, tail: float) -> tuple[float, float]:
    from scipy.special import fdtri  # noqa: PLC0415 - heavy

    return float(fdtri(first, second, 1.0 - tail)), float(fdtri(first, second, tail))


DRAWS = 200_000
SEED = 1980
"""The same measurements always have the same interval."""
CATEGORIES = 1.41


def share_interval(gauge: Terms, part: Terms, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Two-sided interval of the gauge's share of the total standard deviation (%GRR as a share).

    Args:
        gauge: weights and mean squares that make the variance of the gauge.
        part: those that make the variance of the parts; what comes out negative counts as 0.
        confidence: of the interval.

    Returns:
        Its ends, within 0 and 1. An estimate in which negative components were counted as 0 may lie outside.
    """
    rng = np.random.default_rng(SEED)
    drawn = {square: _drawn(square, rng) for square in dict.fromkeys(one for _, one in (*gauge, *part))}
    noise = np.maximum(_summed(gauge, drawn), 0.0)
    parts = np.maximum(_summed(part, drawn), 0.0)
    whole = noise + parts
    ratio = np.divide(noise, whole, out=np.ones_like(noise), where=whole > 0.0)
    tail = (1.0 - confidence) / 2.0
    low, high = np.sqrt(np.quantile(ratio, (tail, 1.0 - tail)))
    return float(low), float(high)


def categories_of(share: float) -> int | None:
    """Distinct categories (ndc) that go with a share of the study variation, cut to a whole number; None without noise.

    ndc is 1.41 part over gauge, so that an interval of the one is an interval of the other.
    """
    return None if share == 0.0 else int(CATEGORIES * math.sqrt(max(1.0 / share**2 - 1.0, 0.0)))


def _drawn(square: MeanSquare, rng: np.random.Generator) -> FloatArray:
    return square.sum_squares / rng.chisquare(square.freedom, DRAWS)


def _summed(terms: Terms, drawn: dict[MeanSquare, FloatArray]) -> FloatArray:
    return sum((weight * drawn[square] for weight, square in terms), np.zeros(DRAWS))


GOOD_SHARE, POOR_SHARE = 0.10, 0.30
ENOUGH_CATEGORIES = 5


@dataclass(frozen=True, eq=False)
class GaugeData:
    """Measurements of a crossed study.

    Attributes:
        parts: P names.
        appraisers: O names.
        values: (P, O, R); R repeated measurements of every part by every appraiser.
    """

    parts: tuple[str, ...]
    appraisers: tuple[str, ...]
    values: FloatArray


@dataclass(frozen=True, eq=False)
class GaugeStudy:
    """Result of a gauge study.

    Attributes:
        data: the measurements.
        table: the ANOVA table, with the interaction as long as there are two appraisers.
        pooled: the interaction was counted as repeatability, for it is not significant at 0.25.
        repeatability, reproducibility, gauge, part, total: variances; gauge is repeatability and reproducibility.
        appraiser, interaction: the two of reproducibility; None where not estimated.
        tolerance: width between the limits, or None.
        notes: what the reader should know.
        confidence: of the intervals.
        share: interval of the gauge's share of the study variation (%GRR as a share).
    """

    data: GaugeData = field(metadata=LEFT_OUT)
    table: tuple[MeanSquare, ...] = field(metadata=json_field("anova"))
    pooled: bool
    repeatability: Component = field(metadata=LEFT_OUT)
    reproducibility: Component | None = field(metadata=LEFT_OUT)
    appraiser: Component | None = field(metadata=LEFT_OUT)
    interaction: Component | None = field(metadata=LEFT_OUT)
    gauge: Component = field(metadata=LEFT_OUT)
    part: Component = field(metadata=LEFT_OUT)
    total: Component = field(metadata=LEFT_OUT)
    tolerance: float | None
    notes: tuple[str, ...]
    confidence: float
    share: tuple[float, float] = field(metadata=json_field("of_study_interval"))

    @property
    def components(self) -> tuple[Component, ...]:
        """All estimated components, the gauge first."""
        some = (
            self.gauge, self.repeatability, self.reproducibility, self.appraiser, self.interaction, self.part,
            self.total,
        )  # fmt: skip
        return tuple(one for one in some if one is not None)

    @property
    @in_json()
    def parts(self) -> int:
        """Measured parts."""
        return len(self.data.parts)

    @property
    @in_json()
    def appraisers(self) -> int:
        """Those who measured."""
        return len(self.data.appraisers)

    @property
    @in_json()
    def trials(self) -> int:
        """Measurements of every part by every appraiser."""
        return int(self.data.values.shape[2])

    @property
    @in_json("components")
    def shares(self) -> dict[str, ComponentOfStudy]:
        """All estimated components by name, with their shares."""
        return {
            one.name: ComponentOfStudy(
                one.name, one.raw, one.low, one.high, self.share_of_study(one), self.share_of_tolerance(one)
            )
            for one in self.components
        }

    def share_of_study(self, one: Component) -> float:
        """Standard deviation over the total one (%GRR as a share)."""
        return one.sigma / self.total.sigma

    def share_of_tolerance(self, one: Component) -> float | None:
        """Six standard deviations over the tolerance; None without one."""
        return None if self.tolerance is None else 6.0 * one.sigma / self.tolerance

    @property
    @in_json("ndc")
    def categories(self) -> int | None:
        """Number of distinct categories (ndc): 1.41 part over gauge, cut to a whole number; None without noise."""
        return None if self.gauge.sigma == 0.0 else int(CATEGORIES * self.part.sigma / self.gauge.sigma)

    @property
    @in_json("ndc_interval")
    def categories_interval(self) -> tuple[int | None, int | None]:
        """Interval of ndc; None at an end where the noise may be zero."""
        low, high = self.share
        return categories_of(high), categories_of(low)

    @property
    @in_json("of_tolerance_interval")
    def tolerance_interval(self) -> tuple[float, float] | None:
        """The interval of the gauge's share of the tolerance, from that of its variance; None without a tolerance."""
        if self.tolerance is None:
            return None
        return 6.0 * math.sqrt(self.gauge.low) / self.tolerance, 6.0 * math.sqrt(
            self.gauge.high
        ) / self.tolerance

    @property
    def usable(self) -> bool:
        """Measuring makes up 30 % of the study variation, and of the tolerance, at most."""
        return max(self.share_of_study(self.gauge), self.share_of_tolerance(self.gauge) or 0.0) <= POOR_SHARE

    @property
    @in_json()
    def verdict(self) -> str:
        """The outcome in plain words, by the rules of the AIAG manual."""
        share, of = self.share_of_study(self.gauge), "of the study variation"
        tolerance_share = self.share_of_tolerance(self.gauge)
        if tolerance_share is not None:
            share, of = max((share, of), (tolerance_share, "of the tolerance"))
        if share < GOOD_SHARE:
            word = "good"
        elif share <= POOR_SHARE:
            word = "usable for some purposes"
        else:
            word = "not good enough"
        text = f"{word}: measuring makes up {share:.1%} {of}"
        few = self.categories is not None and self.categories < ENOUGH_CATEGORIES
        return text + (
            f"; it tells only {self.categories} classes of parts apart ({ENOUGH_CATEGORIES} wanted)"
            if few
            else ""
        )


POOLING_ALPHA = 0.25


def gauge_study(
    data: GaugeData, tolerance: float | None = None, confidence: float = CONFIDENCE
) -> GaugeStudy:
    """Analyse a crossed study.

    Args:
        data: at least 2 parts and 2 trials; no value may be missing.
        tolerance: width between the limits of good parts.
        confidence: of the intervals of the variances.

    Raises:
        UsageError: too little, unbalanced or constant data.
    """
    parts, appraisers, trials = data.values.shape
    if parts < 2 or trials < 2:
        raise UsageError(
            f"a gauge study needs 2 parts and 2 trials or more, not {parts} parts and {trials} trials"
        )
    if np.isnan(data.values).any():
        raise UsageError(
            "a gauge study needs every part measured by every appraiser equally often: a value is missing"
        )
    if float(np.ptp(data.values)) == 0.0:
        raise UsageError("all values of the gauge study are the same: nothing varies")
    if tolerance is not None and not 0.0 < tolerance < math.inf:
        raise UsageError(f"the tolerance must be a finite width above 0, not {tolerance:g}")
    if appraisers == 1:
        return _one_way(data, tolerance, confidence)
    return _two_way(data, tolerance, confidence)


def _two_way(data: GaugeData, tolerance: float | None, confidence: float) -> GaugeStudy:
    p, o, r = data.values.shape
    part, appraiser, interaction, repeat = crossed_squares(data.values)
    interaction = interaction.against(repeat)
    pooled = interaction.p is None or interaction.p > POOLING_ALPHA
    error = joined(interaction, repeat) if pooled else interaction
    noise = error if pooled else repeat
    part, appraiser = part.against(error), appraiser.against(error)
    by_whom, by_pair = 1.0 / (p * r), 0.0 if pooled else (p - 1.0) / (p * r)

    def of(name: str, *terms: tuple[float, MeanSquare]) -> Component:
        return component(name, terms, confidence)

    own = of("repeatability", (1.0, noise))
    who = of("appraiser", (by_whom, appraiser), (-by_whom, error))
    pair = None if pooled else of("interaction", (1.0 / r, interaction), (-1.0 / r, repeat))
    share = 1.0 - by_whom - by_pair
    measuring = ((by_whom, appraiser), (by_pair, interaction), (share, noise))
    gauge = of("gauge R&R", *measuring)
    both = of("reproducibility", (by_whom, appraiser), (by_pair, interaction), (share - 1.0, noise))
    between = 1.0 / (o * r)
    among = ((between, part), (-between, error))
    parts = of("part", *among)
    total = of("total", (between, part), (by_whom, appraiser), (by_pair - between, interaction), (share, noise)) \
        if not pooled else of("total", (between, part), (by_whom, appraiser), (share - between, noise))  # fmt: skip
    found = _components([own, who, *([pair] if pair else [])], parts, (gauge, both, total))
    table = (part, appraiser, interaction, repeat, *((error,) if pooled else ()))
    reach = share_interval(measuring, among, confidence)
    notes = (*_notes(data, (own, who, pair, parts), pooled=pooled), *_undecided(reach, confidence))
    return GaugeStudy(
        data,
        table,
        pooled,
        own,
        found[1],
        who,
        pair,
        found[0],
        parts,
        found[2],
        tolerance,
        notes,
        confidence,
        reach,
    )


def _one_way(data: GaugeData, tolerance: float | None, confidence: float) -> GaugeStudy:
    r = data.values.shape[2]
    part, _, _, repeat = crossed_squares(data.values)
    part = part.against(repeat)
    own = component("repeatability", [(1.0, repeat)], confidence)
    among = ((1.0 / r, part), (-1.0 / r, repeat))
    parts = component("part", among, confidence)
    gauge = component("gauge R&R", [(1.0, repeat)], confidence)
    total = component("total", [(1.0 / r, part), (1.0 - 1.0 / r, repeat)], confidence)
    (gauge, _, total) = _components([own], parts, (gauge, gauge, total))
    reach = share_interval([(1.0, repeat)], among, confidence)
    notes = (*_notes(data, (own, None, None, parts), pooled=False), *_undecided(reach, confidence))
    return GaugeStudy(
        data,
        (part, repeat),
        False,
        own,
        None,
        None,
        None,
        gauge,
        parts,
        total,
        tolerance,
        notes,
        confidence,
        reach,
    )


def _components(
    measuring: list[Component], part: Component, sums: tuple[Component, Component, Component]
) -> tuple[Component, Component, Component]:
    """Gauge, reproducibility and total as sums of components; a negative estimate counts as 0."""
    gauge, both, total = sums
    noise = sum(one.variance for one in measuring)
    return (
        replace(gauge, raw=noise),
        replace(both, raw=noise - measuring[0].variance),
        replace(total, raw=noise + part.variance),
    )


def _notes(data: GaugeData, found: tuple[Component | None, ...], *, pooled: bool) -> tuple[str, ...]:
    p, o, _ = data.values.shape
    notes = [
        f"the variance of {one.name} came out negative ({one.raw:.3g}) and counts as 0: it drowns in the noise"
        for one in found
        if one is not None and one.negative
    ]
    if pooled:
        notes.append(
            f"part and appraiser do not interact (p above {POOLING_ALPHA:g}): their interaction is pooled with the "
            "repeatability"
        )
    if o == 1:
        notes.append("one appraiser: reproducibility was not studied")
    elif o < 3:
        notes.append(f"{o} appraisers tell little about appraisers: its interval is wide")
    if p < 10:
        notes.append(f"{p} parts; 10 that span the process are usual")
    return tuple(notes)


def _undecided(reach: tuple[float, float], confidence: float) -> tuple[str, ...]:
    """Note on a study too small to separate a good gauge from a poor one."""
    low, high = reach
    if not low <= POOR_SHARE < high:
        return ()
    message = (
        f"the share of the study variation lies between {low:.1%} and {high:.1%} ({confidence:.0%} interval), on both "
        f"sides of {POOR_SHARE:.0%}: more appraisers or parts would decide"
    )
    return (message,)


ALONE = "(one)"


def gauge_data(readings: Readings, number: str | None = None) -> GaugeData:
    """Sort readings by part and appraiser.

    Args:
        readings: the part stands in the column ``part`` or ``serial``, the appraiser in ``appraiser`` or ``operator``;
            where there is neither, one appraiser did all.
        number: which number; the first one for None.

    Raises:
        UsageError: no column of parts, a missing value, or a part that was not measured as often as the others.
    """
    _, values = readings.number(number)
    if not {"part", "serial"} & readings.texts.keys():
        raise UsageError(
            f"{readings.source}: there is no column 'part': a gauge study needs a row for every measurement with the "
            "columns part, appraiser and a number, such as part,appraiser,height"
        )
    part = readings.column("part" if "part" in readings.texts else "serial")
    whom = next((readings.texts[name] for name in ("appraiser", "operator") if name in readings.texts), ())
    whom = tuple(name or ALONE for name in whom) or (ALONE,) * len(part)
    cells: dict[tuple[str, str], list[float]] = {}
    for key, value in zip(zip(part, whom, strict=True), values.tolist(), strict=True):
        if np.isnan(value):
            raise UsageError(
                f"{readings.source}: part {key[0]} by {key[1]} has a missing value: measure it again"
            )
        cells.setdefault(key, []).append(value)
    parts, appraisers = tuple(dict.fromkeys(part)), tuple(dict.fromkeys(whom))
    trials = max(len(cell) for cell in cells.values())
    for one in parts:
        for by in appraisers:
            found = len(cells.get((one, by), ()))
            if found != trials:
                raise UsageError(
                    f"{readings.source}: part {one} was measured {found} times by {by}, others {trials} times: a gauge "
                    "study needs every part equally often"
                )
    table = [[cells[one, by] for by in appraisers] for one in parts]
    return GaugeData(parts, appraisers, np.array(table, dtype=np.float64))
