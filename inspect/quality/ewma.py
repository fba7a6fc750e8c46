"""Exponentially weighted moving average: slow drifts that no single value shows.

Source: S. W. Roberts, Technometrics 1 (1959) 239; NIST/SEMATECH e-Handbook 6.3.2.4. The limits are the exact ones,
which are narrower for the first values.
"""

from dataclasses import dataclass

import numpy as np

from anisoscope.errors import UsageError
from anisoscope.quality.individuals import BoolArray, FloatArray, Limits

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

    average: FloatArray
    lower: FloatArray
    upper: FloatArray
    weight: float
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
    there = ~np.isnan(values)
    average = np.full(len(values), np.nan)
    average[there] = _averaged(values[there], limits.center, weight)
    seen = np.maximum(np.cumsum(there), 1)
    spread = weight / (2.0 - weight) * -np.expm1(2.0 * seen * np.log1p(-weight)) if weight < 1.0 else 1.0
    reach = width * limits.sigma * np.sqrt(np.broadcast_to(spread, average.shape))
    return Ewma(average, limits.center - reach, limits.center + reach, weight, width)


def _averaged(values: FloatArray, start: float, weight: float) -> FloatArray:
    found, last = np.empty(len(values)), start
    for number, value in enumerate(values.tolist()):
        last += weight * (value - last)
        found[number] = last
    return found
