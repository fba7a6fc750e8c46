"""Parts of a lot of unknown quality as the reference: the parts that are alike.

Most parts of a lot are good, and good parts scatter in known proportions. A robust centre (the median, then the mean of
those near it) leaves out parts that lie farther from it than good parts do, at most half of the lot. What all parts of
the lot have in common cannot be seen by them.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray

LEAST_PARTS = 3
"""Smallest number of parts with a robust centre."""
_LEVEL = 0.01
_WIDER = 1.3  # the median of few parts is less certain than a mean
_ROUNDS = 20


@dataclass(frozen=True, eq=False)
class LotScatter:
    """What is compared of the parts of a lot.

    Attributes:
        values: (n, m) of the parts.
        covariance: (m, m) of good parts about their mean, of full rank.
        sized: the covariance has the size of the scatter of good parts; otherwise most parts of the lot show a greater
            one.
    """

    values: FloatArray
    covariance: FloatArray
    sized: bool = True


def alike(
    contrasts: FloatArray, covariance: FloatArray, *, sized: bool = True
) -> tuple[npt.NDArray[np.bool_], FloatArray]:
    """Parts of a lot that are alike.

    Args:
        contrasts: (n, m) of the parts, n ≥ `LEAST_PARTS`.
        covariance: (m, m) of good parts about their mean, of full rank.
        sized: as of `LotScatter`.

    Returns:
        (n,) True for the parts that are alike, at least half of them, and (n,) squared distances from their centre.
    """
    from scipy.special import chdtri  # noqa: PLC0415 - start-up time

    count, m = contrasts.shape
    weight, least = np.linalg.inv(covariance), (count + 1) // 2
    limit = _WIDER * float(chdtri(m, _LEVEL))
    if not sized:
        off = contrasts - np.median(contrasts, axis=0)
        middle = float(np.median(np.einsum("ni,ij,nj->n", off, weight, off)))
        limit *= max(1.0, middle / float(chdtri(m, 0.5)))
    centre = np.median(contrasts, axis=0)
    kept = np.zeros(count, dtype=bool)
    distances = np.zeros(count)
    for _ in range(_ROUNDS):
        off = contrasts - centre
        distances = np.einsum("ni,ij,nj->n", off, weight, off)
        near = distances <= max(limit, float(np.sort(distances)[least - 1]))
        if np.array_equal(near, kept):
            break
        kept, centre = near, contrasts[near].mean(axis=0)
    return kept, distances
