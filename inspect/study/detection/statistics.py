"""Statistics of a detection study: rates with their intervals, the area under the curve, thresholds from good parts."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray


@dataclass(frozen=True)
class Rate:
    """A rate with its 95 % interval (Clopper and Pearson 1934).

    Attributes:
        count: how often.
        of: of how many.
        low: lower limit.
        high: upper limit.
    """

    count: int
    of: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """Count by number; NaN of nothing."""
        return self.count / self.of if self.of else float("nan")


def rate(hits: npt.NDArray[np.bool_]) -> Rate:
    """The rate of True values, with its exact 95 % interval."""
    from scipy.stats import beta  # noqa: PLC0415 - 1 s

    k, n = int(np.count_nonzero(hits)), int(np.size(hits))
    low = 0.0 if k == 0 else float(beta.ppf(0.025, k, n - k + 1))
    high = 1.0 if k == n else float(beta.ppf(0.975, k + 1, n - k))
    return Rate(k, n, low, high)


@dataclass(frozen=True)
class Area:
    """Area under the ROC curve: the chance that a bad part scores above a good one; ties count half.

    Attributes:
        value: the area.
        u: standard error (DeLong et al. 1988).
    """

    value: float
    u: float

    @property
    def interval(self) -> tuple[float, float]:
        """95 %, on the logistic scale, so that it stays within 0 and 1."""
        inside = min(max(self.value, 1e-6), 1.0 - 1e-6)
        middle = np.log(inside / (1.0 - inside))
        half = 1.96 * self.u / (inside * (1.0 - inside))
        low, high = (float(1.0 / (1.0 + np.exp(-(middle + sign * half)))) for sign in (-1.0, 1.0))
        return low, high


def area_under_curve(bad: FloatArray, good: FloatArray) -> Area:
    """Area under the ROC curve of two samples of scores (high is bad), by ranks, with DeLong's error.

    Args:
        bad: (m,) scores.
        good: (n,) scores.
    """
    m, n = len(bad), len(good)
    both = _midranks(np.concatenate([bad, good]))
    of_bad = (both[:m] - _midranks(bad)) / n
    of_good = 1.0 - (both[m:] - _midranks(good)) / m
    variance = (np.var(of_bad, ddof=1) / m if m > 1 else 0.0) + (
        np.var(of_good, ddof=1) / n if n > 1 else 0.0
    )
    return Area(float(of_bad.mean()), float(np.sqrt(variance)))


def _midranks(values: FloatArray) -> FloatArray:
    from scipy.stats import rankdata  # noqa: PLC0415 - 1 s

    return np.asarray(rankdata(values), dtype=np.float64)


def threshold(good: FloatArray, level: float) -> float:
    """The score that at most a share ``level`` of the good parts exceed."""
    ordered = np.sort(good)
    return float(ordered[len(ordered) - 1 - int(np.floor(level * len(ordered)))])


def curve(bad: FloatArray, good: FloatArray, points: int = 60) -> tuple[FloatArray, FloatArray]:
    """ROC curve: false-alarm and detection rates, at about evenly spread thresholds."""
    cuts = np.unique(np.concatenate([bad, good]))
    if len(cuts) > points:
        tail = np.sort(good)[-max(points // 3, 1) :]  # where false alarms are rare
        cuts = np.unique(np.concatenate([np.quantile(cuts, np.linspace(0.0, 1.0, points)), tail]))
    false = np.array([1.0, *(np.mean(good > cut) for cut in cuts)])
    found = np.array([1.0, *(np.mean(bad > cut) for cut in cuts)])
    order = np.lexsort((found, false))
    return false[order], found[order]


def uniformity(p_values: FloatArray) -> tuple[float, float]:
    """Greatest distance of the distribution from the uniform one, and the chance of a greater one (Kolmogorov)."""
    from scipy.stats import kstest  # noqa: PLC0415 - 1 s

    found = kstest(p_values, "uniform")
    return float(found.statistic), float(found.pvalue)


def histogram(p_values: FloatArray, bins: int = 20) -> list[int]:
    """How many p values lie in each of equal bins from 0 to 1."""
    return [int(count) for count in np.histogram(p_values, bins=bins, range=(0.0, 1.0))[0]]
