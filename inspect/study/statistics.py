"""Statistics of studies: rates with intervals over rigs, areas under ROC curves, the ideal observer, uniformity."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.significance import proportion_interval

FOLDS = 5
PRIOR_PARTS = 30
"""Number of bad parts that the covariance of good ones is worth as theirs."""


@dataclass(frozen=True)
class Rate:
    """A rate with its 95 % interval.

    Attributes:
        count: number of hits.
        of: size of the sample.
        low: lower limit.
        high: upper limit.
    """

    count: int
    of: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """Count over number; NaN for an empty sample."""
        return self.count / self.of if self.of else float("nan")


def rate(hits: npt.NDArray[np.bool_], groups: npt.NDArray[np.int_] | None = None) -> Rate:
    """The rate of True values, with the interval of Clopper and Pearson (1934).

    Parts of one rig share its state and its golden parts, so that they count as fewer than they are: the size of the
    sample is divided by the ratio of the variance between rigs to that of independent parts (design effect, Kish 1965),
    where that is above 1.

    Args:
        hits: (N,) of parts.
        groups: (N,) rig of every part; None: parts are independent.
    """
    k, n = int(np.count_nonzero(hits)), int(np.size(hits))
    share = _effective_share(hits, groups) if 0 < k < n and groups is not None else 1.0
    return Rate(k, n, *proportion_interval(k * share, n * share))


def _effective_share(hits: npt.NDArray[np.bool_], groups: npt.NDArray[np.int_]) -> float:
    """Effective over true size of a sample in groups; at most 1."""
    names, number = np.unique(groups, return_inverse=True)
    if len(names) < 2:
        return 1.0
    size, sums = np.bincount(number), np.bincount(number, weights=hits)
    p, n, g = float(hits.mean()), len(hits), len(names)
    between = g / (g - 1.0) * float(np.sum((sums - p * size) ** 2)) / n**2
    return min(1.0, p * (1.0 - p) / n / max(between, 1e-300))


@dataclass(frozen=True)
class Area:
    """Area under the ROC curve: probability that a bad part scores above a good one; ties count half.

    Attributes:
        value: the area.
        u: standard error (DeLong et al. 1988).
    """

    value: float
    u: float


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


def ideal_scores(
    bad: FloatArray, good: FloatArray, classes: npt.NDArray[np.int_]
) -> tuple[FloatArray, FloatArray]:
    """Scores of an observer who knows how good and bad parts scatter on their rig: ln of the likelihood ratio.

    Both kinds are taken as normal, with means and covariances from four fifths of the parts; the others are scored. The
    covariance of few bad parts is drawn toward that of good ones. A class whose defect has either sign is a mixture of
    two. A true ideal observer scores as well as this or better.

    Args:
        bad: (m, k) contrasts of bad parts from the mean of the good parts of their rig.
        good: (n, k) of good ones.
        classes: (m,) sign of the defect.

    Returns:
        (m,) and (n,) scores, high is bad.
    """
    scores = [np.empty(len(bad)), np.empty(len(good))]
    for fold in range(FOLDS):
        rest = [np.arange(len(values)) % FOLDS != fold for values in (bad, good)]
        mean, scatter = good[rest[1]].mean(axis=0), np.cov(good[rest[1]], rowvar=False)
        odd = [_normal(bad[rest[0] & (classes == one)], scatter) for one in np.unique(classes)]
        for values, kept, out in zip((bad, good), rest, scores, strict=True):
            new = values[~kept]
            alternative = np.logaddexp.reduce([_log_density(new, *one) for one in odd], axis=0)
            out[~kept] = alternative - _log_density(new, mean, scatter)
    return scores[0], scores[1]


def nearest_curves(
    values: FloatArray, scatter: FloatArray, curves: Sequence[FloatArray], costs: Sequence[FloatArray]
) -> npt.NDArray[np.int_]:
    """The curve that an observer who knows the scatter of good parts finds nearest to each part.

    Args:
        values: (N, k) contrasts of parts from the mean of good ones.
        scatter: (k, k) covariance of good parts.
        curves: (E, k) changes by every cause over its extents.
        costs: (E,) −2 ln of the prior probability of the extents of every cause.

    Returns:
        (N,) numbers of the curves: the causes of maximum posterior probability.
    """
    root = np.linalg.inv(np.linalg.cholesky(scatter))
    at = values @ root.T
    least = [
        np.min(np.sum((at[:, None] - (curve @ root.T)[None]) ** 2, axis=-1) + cost, axis=1)
        for curve, cost in zip(curves, costs, strict=True)
    ]
    return np.asarray(np.argmin(least, axis=0))


def _normal(values: FloatArray, scatter: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of parts, with that of good ones as a prior."""
    mean = values.mean(axis=0)
    squares = (values - mean).T @ (values - mean)
    return mean, np.asarray((squares + PRIOR_PARTS * scatter) / (max(len(values) - 1, 0) + PRIOR_PARTS))


def _log_density(values: FloatArray, mean: FloatArray, covariance: FloatArray) -> FloatArray:
    off = values - mean
    square = np.einsum("ni,ni->n", off, np.linalg.solve(covariance, off.T).T)
    return np.asarray(-0.5 * (square + np.linalg.slogdet(covariance)[1]))


def uniformity(p_values: FloatArray) -> tuple[float, float]:
    """Greatest distance of the distribution from the uniform one, and the chance of a greater one (Kolmogorov)."""
    from scipy.stats import kstest  # noqa: PLC0415 - 1 s

    found = kstest(p_values, "uniform")
    return float(found.statistic), float(found.pvalue)
