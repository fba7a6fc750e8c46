"""Gauge R&R study, crossed or nested: variances of gauge and parts, their intervals, and the gauge's share.

Two-way analysis of variance with random parts and appraisers: AIAG, Measurement Systems Analysis, 4th edition
(2010), chapter III-B; D. C. Montgomery and G. C. Runger, Quality Engineering 6 (1993) 115 and 289. With one appraiser,
such as a machine that needs none, it is a one-way analysis. Where measurements are missing, each factor has the squares
that remain after the others, and variances follow from the expected mean squares (C. R. Henderson, Biometrics 9 (1953)
226, method 3). Nested is a study in which every part meets one appraiser only, because measuring destroys it.

Intervals of the components are modified large-sample ones: sums after F. A. Graybill and C.-M. Wang, Journal of the
American Statistical Association 75 (1980) 869; differences after N. Ting, R. K. Burdick, F. A. Graybill, S. Jeyaratnam
and T.-F. C. Lu, Journal of Statistical Computation and Simulation 35 (1990) 135; of several differences, as unbalanced
studies have them, generalised ones as below, for which the mean squares count as independent. For gauge studies see
R. K. Burdick, C. M. Borror and D. C. Montgomery, Design and Analysis of Gauge R&R Studies (2005).

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
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.quality.readings import Readings

IntArray = npt.NDArray[np.int64]
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
        terms: weights and mean squares.
        confidence: of the two-sided interval.
    """
    raw = sum(weight * square.value for weight, square in terms)
    tail = (1.0 - confidence) / 2.0
    plus = [(w * s.value, s.freedom) for w, s in terms if w > 0.0]
    minus = [(-w * s.value, s.freedom) for w, s in terms if w < 0.0]
    if len(minus) > 1:
        rng = np.random.default_rng(SEED)
        summed = _summed(terms, {square: _drawn(square, rng) for _, square in terms})
        ends = np.quantile(summed, (tail, 1.0 - tail))
        return Component(name, raw, *(max(float(end), 0.0) for end in ends))
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
    """Measurements of a study.

    Attributes:
        parts: P names.
        appraisers: O names.
        values: (P, O, R); R repeated measurements of every part by every appraiser, NaN is missing.
    """

    parts: tuple[str, ...]
    appraisers: tuple[str, ...]
    values: FloatArray

    @property
    def design(self) -> str:
        """crossed, unbalanced, or nested: every part was measured by one appraiser only."""
        missing = np.isnan(self.values)
        if not missing.any():
            return "crossed"
        by = (~missing.all(axis=2)).sum(axis=1)
        return "nested" if len(self.appraisers) > 1 and by.max() == 1 else "unbalanced"


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
    def design(self) -> str:
        """crossed, unbalanced or nested."""
        return self.data.design

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
        """Measurements of every part by every appraiser, at most."""
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
    """Analyse a study.

    Args:
        data: at least 2 parts, and 2 trials of one of them.
        tolerance: width between the limits of good parts.
        confidence: of the intervals of the variances.

    Raises:
        UsageError: too little or constant data.
    """
    parts, _, trials = data.values.shape
    known = data.values[~np.isnan(data.values)]
    if parts < 2 or trials < 2 or not len(known):
        raise UsageError(
            f"a gauge study needs 2 parts and 2 trials or more, not {parts} parts and {trials} trials"
        )
    if float(np.ptp(known)) == 0.0:
        raise UsageError("all values of the gauge study are the same: nothing varies")
    if tolerance is not None and not 0.0 < tolerance < math.inf:
        raise UsageError(f"the tolerance must be a finite width above 0, not {tolerance:g}")
    return _analysed(data, tolerance, confidence)


def _analysed(data: GaugeData, tolerance: float | None, confidence: float) -> GaugeStudy:
    """Squares, the variances that they stand for, and intervals of these and of their sums."""
    lines, repeat, expected, names = squares_of(data)
    error, pooled = repeat, False
    if "interaction" in names:
        pair = lines[-1].against(repeat)
        pooled = pair.p is None or pair.p > POOLING_ALPHA
        table = (*lines[:-1], pair, repeat, *((error := joined(pair, repeat),) if pooled else ()))
        lines = lines[:-1] if pooled else (*lines[:-1], pair)
        expected, names = (expected[:-1, :-1], names[:-1]) if pooled else (expected, names)
        table = (*(one.against(error if pooled else pair) for one in table[:2]), *table[2:])
    elif data.design == "nested":
        table = (lines[0].against(lines[1]), lines[1].against(repeat), repeat)
    else:
        table = (*(one.against(repeat) for one in lines), repeat)
    sources = (*lines, error)
    whole = np.eye(len(sources))
    whole[:-1, :-1], whole[:, -1] = expected, 1.0
    weights = dict(zip((*names, "repeatability"), np.round(np.linalg.inv(whole), 12), strict=True))

    def terms(*of: str) -> Terms:
        summed = sum((weights[one] for one in of), np.zeros(len(sources)))
        return [(weight, one) for weight, one in zip(summed.tolist(), sources, strict=True) if weight != 0.0]

    measuring = [name for name in weights if name != "part"]
    found = {name: component(name, terms(name), confidence) for name in weights}
    sums = [
        component(name, terms(*of), confidence)
        for name, of in (("gauge R&R", measuring), ("reproducibility", measuring[:-1]), ("total", weights))
        if of
    ]
    noise = [found[name] for name in measuring]
    gauge, both, total = _components(noise[::-1], found["part"], (sums[0], sums[-2], sums[-1]))
    reach = share_interval(terms(*measuring), terms("part"), confidence)
    some = found["repeatability"], found.get("appraiser"), found.get("interaction"), found["part"]
    notes = (*_notes(data, some, pooled=pooled), *_undecided(reach, confidence))
    return GaugeStudy(
        data,
        table,
        pooled,
        found["repeatability"],
        both if len(noise) > 1 else None,
        found.get("appraiser"),
        found.get("interaction"),
        gauge,
        found["part"],
        total,
        tolerance,
        notes,
        confidence,
        reach,
    )


LEAST = 1e-13
"""Of all squares: what is less is the rounding of the fits."""
MOST_CELLS = 4000


def squares_of(data: GaugeData) -> tuple[tuple[MeanSquare, ...], MeanSquare, FloatArray, tuple[str, ...]]:
    """Squares of each factor after the others, of repetition, and what they are made of.

    Means of cells (a part and an appraiser) are fitted with the weights of their counts. The variance of a factor is
    expected in a sum of squares as often as the columns that say its levels would have it.

    Args:
        data: of the study.

    Returns:
        K lines; that of repetition; (K, K) the variance of each factor in each mean square; K names of the factors.

    Raises:
        UsageError: too few measurements for one of them, or too many.
    """
    counts = (~np.isnan(data.values)).sum(axis=2)
    part, whom = np.nonzero(counts)
    if len(part) > MOST_CELLS:
        raise UsageError(
            f"a gauge study has {MOST_CELLS} pairs of part and appraiser at most, not {len(part)}"
        )
    known, count = data.values[part, whom], counts[part, whom].astype(np.float64)
    root, means = np.sqrt(count), np.nansum(known, axis=1) / count
    within = MeanSquare(
        "repeatability", int(counts.sum()) - len(part), float(np.nansum((known - means[:, None]) ** 2))
    )
    y = root * (means - np.nansum(known) / counts.sum())
    cell = np.arange(len(part))
    plan = {
        "part": ([whom], [part, whom]),
        "appraiser": ([part], [part, whom]),
        "interaction": ([part, whom], [cell]),
    }
    if len(data.appraisers) == 1:
        plan = {"part": ([], [cell])}
    elif data.design == "nested":
        plan = {"appraiser": ([], [whom]), "part": ([whom], [cell])}
    levels = {"part": part, "appraiser": whom, "interaction": cell}
    if len(_basis(root, plan[next(reversed(plan))][0]).T) == len(cell) and "interaction" in plan:
        del plan["interaction"]  # too few cells to tell it
    lines, expected = list[MeanSquare](), list[FloatArray]()
    for name, pair in plan.items():
        fewer, more = (_basis(root, factors) for factors in pair)
        freedom = more.shape[1] - fewer.shape[1]
        if freedom == 0 or within.freedom == 0:
            raise UsageError(
                "a gauge study needs appraisers with several parts, and parts measured twice by one of them"
            )
        size = float((y @ more) @ (y @ more) - (y @ fewer) @ (y @ fewer))
        words = {
            "interaction": "part x appraiser",
            "part": "part (appraiser)" if data.design == "nested" else "part",
        }
        lines.append(MeanSquare(words.get(name, name), freedom, size if size > LEAST * float(y @ y) else 0.0))
        shares = [_held(more, root, levels[one]) - _held(fewer, root, levels[one]) for one in plan]
        expected.append(np.array(shares) / freedom)
    return tuple(lines), within, np.round(expected, 9), tuple(plan)


def _basis(root: FloatArray, factors: Sequence[IntArray]) -> FloatArray:
    """(C, r) orthonormal columns of a fit of additive factors; the levels of the first need no fit."""
    if not factors:
        return (root / np.linalg.norm(root))[:, None]
    found = root[:, None] * np.eye(factors[0].max() + 1)[factors[0]]
    found /= np.linalg.norm(found, axis=0)
    for one in factors[1:]:
        more = root[:, None] * np.eye(one.max() + 1)[one]
        own, sizes, _ = np.linalg.svd(more - found @ (found.T @ more), full_matrices=False)
        found = np.hstack([found, own[:, sizes > 1e-9 * sizes.max(initial=1.0)]])
    return found


def _held(basis: FloatArray, root: FloatArray, levels: IntArray) -> float:
    """Squares of the columns of a factor that a fit holds."""
    summed = np.zeros((levels.max() + 1, basis.shape[1]))
    np.add.at(summed, levels, root[:, None] * basis)
    return float((summed**2).sum())


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
    if data.design == "nested":
        notes.append(
            "every part was measured by one appraiser: what appraisers see differently in the same part counts as a "
            "difference of parts; parts of one batch have to be alike"
        )
    elif data.design == "unbalanced":
        lost = int(np.isnan(data.values).sum())
        notes.append(f"{lost} of {data.values.size} measurements are missing: intervals are approximate")
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


def gauge_data(readings: Readings, number: str | None = None, *, nested: bool = False) -> GaugeData:
    """Sort readings by part and appraiser.

    Args:
        readings: the part stands in the column ``part`` or ``serial``, the appraiser in ``appraiser`` or ``operator``;
            where there is neither, one appraiser did all.
        number: which number; the first one for None.
        nested: parts of the same name are others with every appraiser.

    Raises:
        UsageError: no column of parts.
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
    if nested:
        part = tuple(f"{one} of {by}" for one, by in zip(part, whom, strict=True))
    cells: dict[tuple[str, str], list[float]] = {}
    for key, value in zip(zip(part, whom, strict=True), values.tolist(), strict=True):
        if not np.isnan(value):
            cells.setdefault(key, []).append(value)
    appraisers = tuple(dict.fromkeys(by for _, by in cells))
    order = sorted(cells, key=lambda key: appraisers.index(key[1])) if nested else cells
    parts = tuple(dict.fromkeys(one for one, _ in order))
    table = np.full((len(parts), len(appraisers), max(map(len, cells.values()), default=0)), np.nan)
    for (one, by), found in cells.items():
        table[parts.index(one), appraisers.index(by), : len(found)] = found
    return GaugeData(parts, appraisers, table)
