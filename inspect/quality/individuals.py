"""Charts of individual values and of their moving range (I-MR), with limits from a chosen baseline.

Source: NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2.2; limits are the mean ± 3 times the mean moving range
over d2. A missing value has no moving range, and neither has the value after it.
"""

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json

BoolArray = npt.NDArray[np.bool_]

D2 = 2.0 / math.sqrt(math.pi)  # mean range of two values of a normal distribution, in sigma
D3 = math.sqrt(2.0 - 4.0 / math.pi)  # standard deviation of that range
WIDTH = 3.0
MIN_BASELINE = 5


@dataclass(frozen=True)
class Limits:
    """Centre and limits of both charts.

    Attributes:
        center: mean of the baseline.
        sigma: short-term standard deviation, from the mean moving range.
        range_center: mean moving range.
        baseline: measured values that the limits rest on; 0 if they were given.
        ranges: moving ranges among them.
        first, last: places of the first and last of these values, from 0; last is -1 if the limits were given.
        period: of the reference, in words; "" where none was named.
    """

    center: float
    sigma: float
    range_center: float
    baseline: int
    ranges: int = field(metadata=LEFT_OUT)
    first: int = field(default=0, metadata=LEFT_OUT)
    last: int = field(default=-1, metadata=LEFT_OUT)
    period: str = field(default="", metadata=LEFT_OUT)

    @property
    @in_json()
    def upper(self) -> float:
        """Upper limit of the values."""
        return self.center + WIDTH * self.sigma

    @property
    @in_json()
    def lower(self) -> float:
        """Lower limit of the values."""
        return self.center - WIDTH * self.sigma

    @property
    @in_json()
    def range_upper(self) -> float:
        """Upper limit of the moving range (D4 = 3.27 times its mean); the lower one is 0."""
        return self.range_center * (1.0 + WIDTH * D3 / D2)


def moving_range(values: FloatArray) -> FloatArray:
    """(N,) absolute differences to the value before; NaN where either is missing, and at the first."""
    ranges = np.full(len(values), np.nan)
    ranges[1:] = np.abs(np.diff(values))
    return ranges


@dataclass(frozen=True, eq=False)
class Period:
    """A reference period: its name, and (N,) which values of a series belong to it."""

    name: str
    inside: BoolArray


def limits_of(values: FloatArray, baseline: int | None = None, period: Period | None = None) -> Limits:
    """Limits from the first measured values of a series, or from those of a reference period.

    Args:
        values: (N,) in the order in which they were measured; NaN is missing.
        baseline: measured values to use, counted from the start; None for all.
        period: in place of a baseline.

    Raises:
        UsageError: too few values, or a baseline that does not vary.
    """
    name = "baseline" if period is None else f"reference period {period.name}"
    if period is not None:
        values = np.where(period.inside, values, np.nan)
    measured = np.flatnonzero(~np.isnan(values))
    if baseline is not None and baseline > len(measured):
        raise UsageError(
            f"the baseline is to hold {baseline} values, but {len(measured)} were measured: choose a smaller one"
        )
    count = len(measured) if baseline is None else baseline
    if count < MIN_BASELINE:
        where = "" if period is None else f" in the {name}"
        raise UsageError(f"a control chart needs at least {MIN_BASELINE} measured values{where}, not {count}")
    first, last = int(measured[0]), int(measured[count - 1])
    used = values[: last + 1]
    ranges = moving_range(used)
    ranges = ranges[~np.isnan(ranges)]
    if len(ranges) == 0:
        raise UsageError(f"no two measured values of the {name} follow each other: there is no moving range")
    mean_range = float(ranges.mean())
    if mean_range == 0.0:
        raise UsageError(
            f"all values of the {name} are the same: there is nothing to draw limits from; is the number rounded?"
        )
    words = "" if period is None else period.name
    return Limits(
        float(np.nanmean(used)), mean_range / D2, mean_range, count, len(ranges), first, last, words
    )


def given_limits(center: float, sigma: float) -> Limits:
    """Limits from a mean and a standard deviation that are known.

    Raises:
        UsageError: the standard deviation is not above 0.
    """
    if not (0.0 < sigma < math.inf and math.isfinite(center)):
        raise UsageError(
            f"a known mean must be finite and a known sigma above 0, not {center:g} and {sigma:g}"
        )
    return Limits(center, sigma, sigma * D2, 0, 0)


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
