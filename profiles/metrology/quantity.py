"""Measured numbers with their standard uncertainty, and means of unequal replicates."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray


@dataclass(frozen=True)
class Quantity:
    """A number with its standard uncertainty, or a bound where the map does not resolve it.

    Attributes:
        value: the number; None where only a bound is known, or nothing.
        u: standard uncertainty (coverage factor 1); None without a value.
        at_least: lower bound, where only that is known.
        at_most: upper bound, where only that is known.
    """

    value: float | None
    u: float | None = None
    at_least: float | None = None
    at_most: float | None = None

    @property
    def known(self) -> bool:
        """Whether there is a value."""
        return self.value is not None


def as_text(quantity: Quantity) -> tuple[str, str]:
    """A value to the second place of its uncertainty, and the uncertainty; or a bound and a dash."""
    if quantity.value is None:
        if quantity.at_least is not None:
            return f"≥ {quantity.at_least:.4g}", "–"
        return (f"≤ {quantity.at_most:.3g}" if quantity.at_most is not None else "–"), "–"
    if not quantity.u:
        return f"{quantity.value:.6g}", "–"
    places = min(9, max(0, 1 - int(np.floor(np.log10(quantity.u)))))
    return f"{quantity.value:.{places}f}".replace("-", "−"), f"{quantity.u:.{places}f}"


def few(degrees_of_freedom: float) -> float:
    """Factor by which few replicates widen a standard uncertainty: √(ν/(ν − 2)), with ν at least 3.

    It is the standard deviation of Student's distribution. Source: JCGM 101:2008, 6.4.9.4.
    """
    nu = max(3.0, degrees_of_freedom)
    return float(np.sqrt(nu / (nu - 2.0)))


def weighted_mean(values: FloatArray, weights: FloatArray) -> Quantity:
    """Mean of n replicates whose variances are as 1/weight, its uncertainty from their scatter.

    Args:
        values: (n,) replicates.
        weights: (n,) above 0.
    """
    total = float(weights.sum())
    mean = float(weights @ values) / total
    count = values.size
    if count < 2:
        return Quantity(mean, float("inf"))
    scatter = float(weights @ (values - mean) ** 2) / ((count - 1) * total)
    return Quantity(mean, few(count - 1) * float(np.sqrt(scatter)))


def jackknife(
    parts: FloatArray, estimate: Callable[[FloatArray], FloatArray], weights: FloatArray, fitted: int = 1
) -> tuple[FloatArray, FloatArray]:
    """An estimate from the sum of parts, and its standard uncertainty from leaving out one part after the other.

    Args:
        parts: (n, ...) sums over each part; a single one leaves every uncertainty infinite.
        estimate: turns the sum over parts into (m,) numbers.
        weights: (n,) size of every part.
        fitted: numbers that the parts determine together; n − ``fitted`` degrees of freedom are left.

    Returns:
        (m,) estimates and (m,) standard uncertainties.

    Source: Busing, Meijer and van der Leeden 1999, delete-m jackknife for unequal m; equal parts give the usual one.
    """
    total = parts.sum(axis=0)
    whole = estimate(total)
    count = parts.shape[0]
    if count < 2:
        return whole, np.full(whole.shape, np.inf)
    without = np.stack([estimate(total - part) for part in parts])
    share = weights.sum() / weights
    pseudo = share[:, None] * whole - (share[:, None] - 1.0) * without
    centre = count * whole - ((1.0 - 1.0 / share)[:, None] * without).sum(axis=0)
    variance = np.mean((pseudo - centre) ** 2 / (share - 1.0)[:, None], axis=0)
    return whole, few(count - fitted) * np.sqrt(variance)


def variation(values: list[Quantity]) -> Quantity:
    """Standard deviation between ridges beyond what the uncertainty of each explains, at least 0.

    Its uncertainty is that of a standard deviation from n values, of the scatter as seen.
    """
    known = [(q.value, q.u) for q in values if q.value is not None and q.u is not None and np.isfinite(q.u)]
    if len(known) < 3:
        return Quantity(None)
    numbers, errors = np.array(known).T
    seen = float(np.var(numbers, ddof=1))
    own = float(np.mean(errors**2))
    u = np.sqrt(seen / (2.0 * (len(known) - 1))) * few(len(known) - 1)
    return Quantity(float(np.sqrt(max(0.0, seen - own))), float(u))
