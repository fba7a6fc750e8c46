"""Are values normal? Anderson-Darling, with what to do if not.

Source: R. B. D'Agostino and M. A. Stephens (ed.), Goodness-of-Fit Techniques (1986), table 4.9: the statistic for a
mean and a standard deviation that are estimated, and its p-value.
"""

import math
from dataclasses import dataclass

import numpy as np

from anisoscope.quality.individuals import FloatArray

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
