"""Rates with intervals, of parts that share rigs."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.significance import proportion_interval


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
