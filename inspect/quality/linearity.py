"""Linearity of a gauge: dependence of its bias on the measured value (AIAG MSA, 4th edition, III-B).

A straight line through all biases over the reference values; the gauge is fit if the line of zero bias lies everywhere
within the confidence band of the fitted one.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json
from anisoscope.quality.bias import ALPHA, MIN_COUNT, Bias, bias_study

MIN_LEVELS = 3


@dataclass(frozen=True)
class Coefficient:
    """A number of the line, its standard uncertainty, and the test whether it is 0."""

    value: float
    u: float
    t: float
    p: float


@dataclass(frozen=True, eq=False)
class GaugeLinearity:
    """The line of bias over reference.

    Attributes:
        references: (N,) known values.
        biases: (N,) measured minus reference.
        slope, intercept: of the line.
        sigma: standard deviation about the line.
        r2: share of the variance that the line explains.
        levels: bias at each reference value.
        t_limit: of the two-sided band.
        alpha: of tests and band.
    """

    references: FloatArray = field(metadata=LEFT_OUT)
    biases: FloatArray = field(metadata=LEFT_OUT)
    slope: Coefficient
    intercept: Coefficient
    sigma: float
    r2: float
    levels: tuple[Bias, ...]
    t_limit: float
    alpha: float

    @property
    @in_json()
    def measured(self) -> int:
        """How many values were measured."""
        return len(self.references)

    def band(self, reference: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The line and the confidence band of the mean bias, low and high, at some reference values."""
        center = self.references.mean()
        spread = float(np.sum((self.references - center) ** 2))
        line = self.intercept.value + self.slope.value * reference
        reach = (
            self.t_limit
            * self.sigma
            * np.sqrt(1.0 / len(self.references) + (reference - center) ** 2 / spread)
        )
        return line, line - reach, line + reach

    @property
    @in_json()
    def fit(self) -> bool:
        """Whether zero bias is within the band over the whole range."""
        _, low, high = self.band(np.linspace(self.references.min(), self.references.max(), 201))
        return bool(np.all((low <= 0.0) & (high >= 0.0)))

    @property
    @in_json()
    def verdict(self) -> str:
        """The outcome in plain words."""
        if self.fit:
            return "linear and without bias as far as is seen: zero bias lies within the band over the whole range"
        if self.slope.p < self.alpha:
            return f"not linear: the bias changes by {self.slope.value:+.3g} for every unit (p {self.slope.p:.2g})"
        return "linear but biased: zero bias leaves the band, and its slope is not significant; correct the offset"


def gauge_linearity(references: FloatArray, values: FloatArray, alpha: float = ALPHA) -> GaugeLinearity:
    """Fit the line.

    Args:
        references: (N,) known value of what was measured.
        values: (N,) measured, NaN is missing.
        alpha: significance of tests and band.

    Raises:
        UsageError: too few reference values or measurements, or no scatter at all.
    """
    from scipy.special import stdtr, stdtrit  # noqa: PLC0415 - heavy

    valid = ~(np.isnan(values) | np.isnan(references))
    x, y = references[valid], values[valid] - references[valid]
    known = np.unique(x)
    if len(known) < MIN_LEVELS:
        raise UsageError(
            f"a linearity study needs {MIN_LEVELS} or more reference values (5 are usual), not {len(known)}"
        )
    few = [level for level in known if np.count_nonzero(x == level) < MIN_COUNT]
    if few:
        raise UsageError(
            f"a linearity study needs {MIN_COUNT} or more measurements at every reference; at {few[0]:g} are fewer"
        )
    levels = tuple(bias_study(values[valid][x == level], float(level), alpha) for level in known)
    freedom, center = len(x) - 2, float(x.mean())
    spread = float(np.sum((x - center) ** 2))
    slope = float(np.sum((x - center) * y)) / spread
    intercept = float(y.mean()) - slope * center
    residual = float(np.sum((y - intercept - slope * x) ** 2))
    sigma = math.sqrt(residual / freedom)

    def tested(value: float, u: float) -> Coefficient:
        return Coefficient(value, u, value / u, 2.0 * float(stdtr(freedom, -abs(value) / u)))

    return GaugeLinearity(
        x, y,
        tested(slope, sigma / math.sqrt(spread)),
        tested(intercept, sigma * math.sqrt(1.0 / len(x) + center**2 / spread)),
        sigma, 1.0 - residual / float(np.sum((y - y.mean()) ** 2)), levels,
        -float(stdtrit(freedom, alpha / 2.0)), alpha,
    )  # fmt: skip
