"""Mean squares of a crossed study, variances made of them, and the confidence intervals of those.

Intervals are modified large-sample ones: sums after F. A. Graybill and C.-M. Wang, Journal of the American
Statistical Association 75 (1980) 869; differences after N. Ting, R. K. Burdick, F. A. Graybill, S. Jeyaratnam and
T.-F. C. Lu, Journal of Statistical Computation and Simulation 35 (1990) 135. For gauge studies see R. K. Burdick,
C. M. Borror and D. C. Montgomery, Design and Analysis of Gauge R&R Studies (2005).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, product

from anisoscope.base.arrays import FloatArray

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
    """A variance made of mean squares.

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
    def variance(self) -> float:
        """The estimate; 0 where it came out negative."""
        return max(self.raw, 0.0)

    @property
    def sigma(self) -> float:
        """Standard deviation."""
        return math.sqrt(self.variance)

    @property
    def negative(self) -> bool:
        """The estimate was negative, and counts as 0."""
        return self.raw < 0.0


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
    """How far a variance may lie below and above a mean square, as shares of it (G and H)."""
    from scipy.special import chdtri  # noqa: PLC0415 - heavy

    return 1.0 - freedom / float(chdtri(freedom, tail)), freedom / float(chdtri(freedom, 1.0 - tail)) - 1.0


@lru_cache
def _f_points(first: int, second: int, tail: float) -> tuple[float, float]:
    from scipy.special import fdtri  # noqa: PLC0415 - heavy

    return float(fdtri(first, second, 1.0 - tail)), float(fdtri(first, second, tail))
