"""Bias: deviation of the mean of repeated measurements from a reference value (AIAG MSA, 4th edition, III-B)."""

import math
from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import in_json

ALPHA = 0.05
MIN_COUNT = 3


@dataclass(frozen=True)
class Bias:
    """A bias and whether it is one.

    Attributes:
        reference: the known value.
        count: measurements.
        mean: of the measurements.
        bias: mean minus reference.
        sigma: standard deviation of the measurements (repeatability).
        u: standard uncertainty of the mean.
        t: bias over u.
        p: probability of so large a t without bias.
        low, high: confidence interval of the bias.
        alpha: of the test and the interval.
    """

    reference: float
    count: int
    mean: float
    bias: float
    sigma: float
    u: float
    t: float
    p: float
    low: float
    high: float
    alpha: float

    @property
    @in_json()
    def significant(self) -> bool:
        """Whether 0 is outside the interval."""
        return not self.low <= 0.0 <= self.high

    @property
    @in_json()
    def verdict(self) -> str:
        """The outcome in plain words."""
        where = f"{self.bias:+.3g}, {1 - self.alpha:.0%} between {self.low:+.3g} and {self.high:+.3g}"
        if self.significant:
            return f"biased: {where}; calibrate, or correct for it"
        return f"no bias is seen: {where}"


def bias_study(values: FloatArray, reference: float, alpha: float = ALPHA) -> Bias:
    """Bias of repeated measurements of one part.

    Args:
        values: (N,), NaN is missing.
        reference: the value that the part has, in the same unit.
        alpha: significance of the two-sided test.

    Raises:
        UsageError: too few values, all the same, or a reference that is no number.
    """
    from scipy.special import stdtr, stdtrit  # noqa: PLC0415 - heavy

    measured = values[~np.isnan(values)]
    if len(measured) < MIN_COUNT:
        raise UsageError(f"a bias study needs {MIN_COUNT} or more measured values, not {len(measured)}")
    if not math.isfinite(reference):
        raise UsageError(f"the reference must be a finite number, not {reference:g}")
    if not 0.0 < alpha < 0.5:
        raise UsageError(f"alpha lies between 0 and 0.5, not at {alpha:g}")
    count, mean, sigma = len(measured), float(measured.mean()), float(measured.std(ddof=1))
    if sigma == 0.0:
        raise UsageError("all values of the bias study are the same: is the number rounded?")
    u = sigma / math.sqrt(count)
    bias = mean - reference
    reach = -float(stdtrit(count - 1, alpha / 2.0)) * u
    p = 2.0 * float(stdtr(count - 1, -abs(bias) / u))
    return Bias(reference, count, mean, bias, sigma, u, bias / u, p, bias - reach, bias + reach, alpha)
