"""How large a share of all variation the gauge has, as an interval: generalised inference on a ratio of variances.

Every mean square divided by a chi-square variable of its own stands for its expectation (a generalised pivotal
quantity); the quantiles of the ratio made of them are the interval. M. Hamada and S. Weerahandi, Journal of Quality
Technology 32 (2000) 241; R. K. Burdick, C. M. Borror and D. C. Montgomery, Design and Analysis of Gauge R&R Studies
(2005), who compare it with modified large-sample intervals. With one appraiser it is the exact interval of the
intraclass correlation.
"""

import math

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.quality.mean_squares import CONFIDENCE, MeanSquare, Terms

DRAWS = 200_000
SEED = 1980
"""The same measurements always have the same interval."""
CATEGORIES = 1.41


def share_interval(gauge: Terms, part: Terms, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Two-sided interval of the standard deviation of the gauge over that of everything (%GRR as a share).

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
