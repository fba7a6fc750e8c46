"""Areas under ROC curves, the ideal observer, uniformity of p values."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.stats import kstest, rankdata

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import whitening

FOLDS = 5
PRIOR_PARTS = 30
"""Number of bad parts that the covariance of good ones is worth as theirs."""


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
    weight = whitening(scatter)
    at = values @ weight
    least = [
        np.min(np.sum((at[:, None] - (curve @ weight)[None]) ** 2, axis=-1) + cost, axis=1)
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
    found = kstest(p_values, "uniform")
    return float(found.statistic), float(found.pvalue)
