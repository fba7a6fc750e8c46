"""Is a deviation more than chance? Distances in the metric of their covariance, and which of many deviations count.

Contrasts of pairs of angles depend on each other: (0°, 90°), (90°, 180°) and (0°, 180°) are three numbers and two
facts. All deviations together are weighed in the basis ln L − ln L of the first pose, of which there are poses − 1.
"""

from functools import lru_cache

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import rank, whitening
from anisoscope.base.errors import MeasurementError


def log_basis(poses: int) -> FloatArray:
    """(P − 1, P) matrix that takes ln L to its differences from the first pose; the scale k cancels."""
    return np.asarray(np.hstack([-np.ones((poses - 1, 1)), np.eye(poses - 1)]))


def chi2_tail(d2: FloatArray | float, dof: float) -> FloatArray:
    """P values of squared distances by χ²; by the special function, as importing scipy.stats takes a second."""
    from scipy.special import chdtrc  # noqa: PLC0415 - start-up time

    return np.asarray(chdtrc(dof, d2))


def f_tail(ratio: FloatArray | float, m: float, freedom: float) -> FloatArray:
    """P values of ratios ≥ 0 by the F distribution with m and ``freedom`` degrees of freedom."""
    from scipy.special import fdtrc  # noqa: PLC0415 - start-up time

    return np.asarray(fdtrc(m, freedom, ratio))


def proportion_interval(hits: float, tries: float, confidence: float = 0.95) -> tuple[float, float]:
    """Two-sided interval of a probability after C. J. Clopper and E. S. Pearson, Biometrika 26 (1934) 404.

    Its coverage is never below the stated one. One-sided limits of confidence c are the ends for 2c − 1.

    Args:
        hits: number of successes, 0 to ``tries``; a fraction for a sample that counts as fewer than it is.
        tries: size of the sample; for 0 everything is possible.
        confidence: of the interval.
    """
    from scipy.special import betaincinv  # noqa: PLC0415 - start-up time

    tail = (1.0 - confidence) / 2.0
    low = float(betaincinv(hits, tries - hits + 1.0, tail)) if hits > 0 else 0.0
    high = float(betaincinv(hits + 1.0, tries - hits, 1.0 - tail)) if hits < tries else 1.0
    return low, high


def mahalanobis(deviation: FloatArray, covariance: FloatArray) -> tuple[float, int]:
    """Squared distance dᵀV⁺d within the range of V, and the rank of V.

    Args:
        deviation: (m,).
        covariance: (m, m).

    Raises:
        MeasurementError: V is zero: nothing would be uncertain.
    """
    dof = rank(covariance)
    if not dof:
        raise MeasurementError(
            "no source of uncertainty is left, so that no deviation can be weighed: "
            "state some under [uncertainty] in the recipe"
        )
    return float(np.sum((whitening(covariance) @ deviation) ** 2)), dof


LEAST_SAMPLE = 3
"""Smallest number of earlier observations with which a new one is compared."""
PRIOR_FREEDOM = 0.5
"""Degrees of freedom as which a stated size of a scatter counts."""
DOUBT = 0.5
"""Standard deviation of ln of how far the scatter in each direction is off its stated form."""
_DRAWN, _BLOCK, _SEED = 20000, 2000, 11


def like_sample(
    value: FloatArray, sample: FloatArray, stated: FloatArray, alike: FloatArray | None = None
) -> tuple[float, float]:
    """T² of one new observation from n earlier ones, and its p value; the form of their scatter is stated before.

    The size of the scatter is that of the sample: s² = (ν₀ + q)/(ν₀ + m(n − 1)) with q = Σ (xᵢ − x̄)ᵀS₀⁻¹(xᵢ − x̄) and
    ν₀ = `PRIOR_FREEDOM` (scaled inverse χ² prior; Gelman et al., Bayesian Data Analysis, 2.6). Its form is the stated
    one, which counts as m observations (inverse Wishart prior; ibid., 3.6), so that three observations serve, and many
    have a scatter of their own: S = (m s² S₀ + Σ (xᵢ − x̄)(xᵢ − x̄)ᵀ)/(m + n − 1), T² = n/(n + 1)·(x − x̄)ᵀS⁻¹(x − x̄).
    Its distribution is drawn for normal observations that scatter in the stated form, and with a doubt of it
    (`DOUBT`), and for observations of ``alike``; the greatest probability counts.

    Args:
        value: (m,) of the new observation.
        sample: (n, m) of the earlier ones, n ≥ `LEAST_SAMPLE`.
        stated: (m, m) S₀, in any unit.
        alike: (G, N, m) of simulated good parts that are not normal, N of each of G rigs.

    Raises:
        MeasurementError: too few earlier observations, or no scatter is stated in some direction.
    """
    n, m = sample.shape
    if n < LEAST_SAMPLE:
        raise MeasurementError(f"{n} good parts do not show how good parts vary: at least {LEAST_SAMPLE} do")
    if rank(stated) < m:
        raise MeasurementError(
            "some value of good parts is stated without any uncertainty or scatter: state some under [uncertainty] in "
            "the recipe"
        )
    white = whitening(stated)
    t2 = float(_t_squared((white @ value)[None], (sample @ white.T)[None])[0])
    freedom = m + n - 1.0
    theory = _theory(np.array([t2]), m, freedom)
    nulls = [_drawn(m, n, doubt) for doubt in (0.0, DOUBT)]
    if alike is not None:
        nulls.append(_drawn_from(alike @ white.T, n))
    chances = [float(calibrated_at(theory, null, _COUNTED)[0]) for null in nulls]
    return t2, min(max(chances), 1.0)


def _t_squared(value: FloatArray, sample: FloatArray) -> FloatArray:
    """(N,) T² of (N, m) whitened observations from (N, n, m) earlier ones."""
    n, m = sample.shape[1:]
    off = sample - sample.mean(axis=1, keepdims=True)
    size = (PRIOR_FREEDOM + np.sum(off**2, axis=(1, 2))) / (PRIOR_FREEDOM + m * (n - 1.0))
    squares = np.swapaxes(off, 1, 2) @ off
    scatter = (m * size[:, None, None] * np.eye(m) + squares) / (m + n - 1.0) * (1.0 + 1.0 / n)
    away = value - sample.mean(axis=1)
    return np.asarray(np.einsum("ni,ni->n", away, np.linalg.solve(scatter, away[..., None])[..., 0]))


def _theory(t2: FloatArray, m: int, freedom: float) -> FloatArray:
    """P values of T² as of a scatter known to these degrees of freedom."""
    rest = freedom - m + 1.0
    return np.maximum(f_tail(t2 * rest / (freedom * m), m, rest), 1e-300)


@lru_cache(maxsize=64)
def _drawn(m: int, n: int, doubt: float) -> FloatArray:
    """Quantiles, at `_COUNTED`, of the theoretical p values of drawn observations."""
    rng, found = np.random.default_rng(_SEED), []
    for _ in range(_DRAWN // _BLOCK):
        each = rng.standard_normal((_BLOCK, n + 1, m)) * np.exp(doubt * rng.standard_normal((_BLOCK, 1, m)))
        found.append(_theory(_t_squared(each[:, 0], each[:, 1:]), m, m + n - 1.0))
    return quantiles(np.concatenate(found), _COUNTED)


def _drawn_from(alike: FloatArray, n: int) -> FloatArray:
    """The same of n + 1 whitened observations of one rig, at most as many as are simulated of it."""
    rigs, parts, m = alike.shape
    rng, found, count = np.random.default_rng(_SEED), [], min(n + 1, parts)
    for _ in range(_DRAWN // _BLOCK):
        rig = rng.integers(rigs, size=(_BLOCK, 1))
        each = alike[rig, rng.random((_BLOCK, parts)).argsort(axis=1)[:, :count]]
        found.append(_theory(_t_squared(each[:, 0], each[:, 1:]), m, m + count - 2.0))
    return quantiles(np.concatenate(found), _COUNTED)


def holm(p_values: FloatArray) -> FloatArray:
    """P values adjusted for multiple testing (Holm 1979): (m,) in the order given."""
    order = np.argsort(p_values, kind="stable")
    stepped = np.asarray(p_values)[order] * np.arange(len(p_values), 0, -1)
    adjusted = np.empty(len(p_values))
    adjusted[order] = np.minimum(np.maximum.accumulate(stepped), 1.0)
    return adjusted


def two_sided(z: FloatArray) -> FloatArray:
    """Two-sided p values of standard normal scores."""
    from scipy.special import erfc  # noqa: PLC0415 - start-up time

    return np.asarray(erfc(np.abs(z) / np.sqrt(2.0)))


def two_sided_score(p_value: float) -> float:
    """Standard normal score of a two-sided p value."""
    from scipy.special import ndtri  # noqa: PLC0415 - start-up time

    return -float(ndtri(0.5 * p_value))


def joint_conformance(deviation: FloatArray, covariance: FloatArray, tolerances: FloatArray) -> float:
    """Probability that all true deviations lie within their tolerances at once (JCGM 106:2012, 7.2, for several).

    Args:
        deviation: (m,) measured deviations.
        covariance: (m, m) of them.
        tolerances: (m,) largest allowed ones.
    """
    if not np.any(covariance):
        return float(np.all(np.abs(deviation) <= tolerances))
    low, high = -tolerances - deviation, tolerances - deviation
    if deviation.size <= 2 and np.all(np.diag(covariance) > 0.0):
        scale = np.sqrt(np.diag(covariance))
        rho = float(covariance[0, -1] / (scale[0] * scale[-1])) if deviation.size == 2 else 0.0
        if abs(rho) < _NEARLY_ONE:
            low, high = (np.clip(limits / scale, -_FAR, _FAR) for limits in (low, high))
            return _rectangle(low, high, rho)
    from scipy.stats import multivariate_normal  # noqa: PLC0415 - 1 s

    found = multivariate_normal.cdf(
        high, mean=np.zeros_like(deviation), cov=covariance, allow_singular=True, lower_limit=low, rng=0
    )
    return float(np.clip(found, 0.0, 1.0))


_NEARLY_ONE, _FAR = 1.0 - 1e-9, 40.0


def _rectangle(low: FloatArray, high: FloatArray, rho: float) -> float:
    """Probability that one or two standard normal numbers of correlation ρ lie between limits."""
    from scipy.special import ndtr  # noqa: PLC0415 - start-up time

    if low.size == 1:
        return float(ndtr(high[0]) - ndtr(low[0]))
    found = _below(high[0], high[1], rho) + _below(low[0], low[1], rho)
    found -= _below(low[0], high[1], rho) + _below(high[0], low[1], rho)
    return float(np.clip(found, 0.0, 1.0))


def _below(h: float, k: float, rho: float) -> float:
    """Φ₂(h, k; ρ) by Owen's T function (Owen 1956, equation 3.6), |ρ| < 1."""
    from scipy.special import ndtr, owens_t  # noqa: PLC0415 - start-up time

    if h == 0.0 and k == 0.0:
        return float(0.25 + np.arcsin(rho) / (2.0 * np.pi))
    root = np.sqrt(1.0 - rho * rho)
    found = 0.5 * (ndtr(h) + ndtr(k))
    for one, other in ((h, k), (k, h)):
        slope = (other - rho * one) / (one * root) if one else np.copysign(np.inf, other)
        found -= owens_t(one, slope)
    return float(found - (0.5 if h * k < 0.0 or (h * k == 0.0 and h + k < 0.0) else 0.0))


LEVELS = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0])
"""Probabilities at which p values are counted."""
_COUNTED = np.concatenate([[0.001, 0.003], LEVELS])


def calibrated(p_values: FloatArray, drawn: FloatArray, levels: FloatArray = LEVELS) -> FloatArray:
    """Calibrated p values: the share of good parts whose normal-theory p value is as small.

    Between and below the counted levels ln p is interpolated and extrapolated linearly in ln p.

    Args:
        p_values: p values by the normal theory.
        drawn: those of drawn good parts.
        levels: ascending probabilities at which they are counted, 0.1 among them and 1 the last.
    """
    return calibrated_at(p_values, quantiles(drawn, levels), levels)


def quantiles(drawn: FloatArray, levels: FloatArray = LEVELS) -> FloatArray:
    """(L,) p values by the normal theory that good parts are below with the probabilities ``levels``, the last is 1."""
    return np.append(np.quantile(drawn, levels[:-1]), 1.0)


def calibrated_at(p_values: FloatArray, at: FloatArray, levels: FloatArray = LEVELS) -> FloatArray:
    """As `calibrated`, by the quantiles of the drawn p values."""
    small = np.log(np.maximum(p_values, 1e-300))
    found = np.interp(small, np.log(at), np.log(levels))
    low, high = 0, int(np.flatnonzero(levels == 0.1)[0])
    slope = np.log(levels[high] / levels[low]) / np.log(at[high] / at[low])
    beyond = np.log(levels[low]) + slope * (small - np.log(at[low]))
    return np.asarray(np.exp(np.where(p_values < at[low], beyond, found)))
