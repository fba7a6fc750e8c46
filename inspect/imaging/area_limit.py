"""Limit of the deviating area, learnt from golden parts: one limit for all products is too wide for most.

The deviating area of a good part is the sum of a few small marks, so the shares are modelled as gamma distributed;
cube roots of a gamma variate are nearly normal whatever its shape (Wilson and Hilferty 1931). The limit is the upper
prediction limit for one more part (Krishnamoorthy, Mathew and Mukherjee, Technometrics 50, 2008): over all sets of n
good parts, the next good part exceeds it with probability alpha. Where hardly any cell deviates, the Poisson prediction
limit for one more part applies (Jeffreys' prior). The scatter of the shares includes that of the measurement, so no
guard band is added.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray

MIN_PARTS = 10
"""Number of parts from which their limit replaces the usual one."""
LEAST_PARTS = 3
"""Number of parts from which a limit is defined; of a few it counts where it is the narrower one."""


def learnt_limit(shares: Sequence[float], cells: int, alpha: float) -> float | None:
    """Upper prediction limit of the deviating share of one more good part, exceeded with probability alpha.

    Args:
        shares: of golden parts, 0 to 1.
        cells: how many cells the contrast map has.
        alpha: chance that a good part exceeds the limit.

    Returns:
        The limit; None for fewer than `LEAST_PARTS` parts. Never less than the largest share of a golden part.
    """
    if len(shares) < LEAST_PARTS:
        return None
    found = np.asarray(shares, dtype=np.float64)
    limit = max(_gamma_limit(found, alpha), _counting_limit(found, cells, alpha), float(found.max()))
    return min(limit, 1.0)


@dataclass(frozen=True)
class KnownShares:
    """Shares of deviating cells of the golden parts.

    Attributes:
        shares: one a part, 0 to 1; at least `LEAST_PARTS`.
        cells: how many cells the contrast map has.
    """

    shares: tuple[float, ...]
    cells: int

    def limit(self, alpha: float) -> float:
        """The share that one more good part exceeds with probability alpha."""
        found = learnt_limit(self.shares, self.cells, alpha)
        assert found is not None
        return found

    def chance(self, share: float) -> float:
        """P value of a share: probability that one more good part reaches it, the alpha whose limit it just exceeds."""
        found = np.asarray(self.shares, dtype=np.float64)
        if share <= found.max():
            return 1.0
        return max(_gamma_chance(found, share), _counting_chance(found, self.cells, share))


def _gamma_chance(shares: FloatArray, share: float) -> float:
    from scipy.special import stdtr  # noqa: PLC0415 - heavy

    roots, count = np.cbrt(shares), len(shares)
    spread = float(roots.std(ddof=1)) * np.sqrt(1.0 + 1.0 / count)
    return float(stdtr(count - 1, (roots.mean() - np.cbrt(share)) / spread)) if spread > 0.0 else 0.0


def _counting_chance(shares: FloatArray, cells: int, share: float) -> float:
    from scipy.special import betainc  # noqa: PLC0415 - heavy

    deviating, count = float(shares.sum()) * cells, len(shares)
    # the share of a print is not a whole number of cells: more than k of them exceeds a limit of k
    more = max(int(np.ceil(share * cells - 1e-6)), 1)
    return float(betainc(more, deviating + 0.5, 1.0 / (count + 1.0)))


def _gamma_limit(shares: FloatArray, alpha: float) -> float:
    from scipy.special import stdtrit  # noqa: PLC0415 - heavy

    roots, count = np.cbrt(shares), len(shares)
    factor = float(stdtrit(count - 1, 1.0 - alpha)) * np.sqrt(1.0 + 1.0 / count)
    return float((roots.mean() + factor * roots.std(ddof=1)) ** 3)


def _counting_limit(shares: FloatArray, cells: int, alpha: float) -> float:
    """Smallest share exceeded with probability below alpha by one more part, if cells deviate independently."""
    from scipy.special import betainc  # noqa: PLC0415 - heavy

    deviating, count = float(shares.sum()) * cells, len(shares)
    # tail of the negative binomial distribution that a gamma-distributed rate gives
    more = betainc(np.arange(1, cells + 1), deviating + 0.5, 1.0 / (count + 1.0))
    return float(np.argmax(more < alpha)) / cells if more[-1] < alpha else 1.0
