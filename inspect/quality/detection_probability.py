"""Probability of detection over the size of a defect: hit/miss and â-against-a analysis (MIL-HDBK-1823A, 2009).

Hit/miss: logistic regression of found or not found on the size or its logarithm (appendix G.3.4). â against a: a
straight line of the signal over the size, each or its logarithm, with normal scatter, and the signals below noise or in
saturation as censored (appendix G.3.3); a defect is found where its signal reaches a threshold. a_p is the size that is
found with the probability p; a90/95 is the upper 95 % confidence limit of a90.

All limits are those of the profile likelihood ratio, pointwise by χ² with one degree of freedom, as appendix G.4
advises; the handbook's own for â against a are those of normal theory, which agree with them for many parts.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.csv_table import read_table
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json
from anisoscope.base.significance import proportion_interval

Scale = Literal["linear", "log"]
LEVELS = (0.5, 0.9)
CONFIDENCE = 0.95
LEAST = 20
_STEPS = 60
POINTS = 41


@dataclass(frozen=True, eq=False)
class Trials:
    """Inspections of parts with defects of known size.

    Attributes:
        size: (N,) of the defects; 0 for parts without one.
        hit: (N,) whether each was found.
    """

    size: FloatArray
    hit: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class SizeLimit:
    """The size found with a probability.

    Attributes:
        probability: of detection.
        size: estimate.
        low, high: two-sided interval.
        bound: upper one-sided limit (for 0.9: a90/95).
    """

    probability: float
    size: float
    low: float
    high: float
    bound: float


@dataclass(frozen=True, eq=False)
class DetectionCurve:
    """Probability of detection over size.

    Attributes:
        method: "hit/miss" or "â against a".
        size_scale: of the size.
        parameters: of the model by name.
        sizes: a50 and a90 with their limits.
        count: parts with a defect.
        found: of them found.
        false_calls: parts without a defect: found, number, and the interval of the rate.
        grid: (G,) sizes.
        probability, low, high: (G,) the curve and its two-sided band.
        confidence: of intervals and bounds.
        deviance: twice the logarithm of the likelihood ratio to a model that knows every part.
    """

    method: str
    size_scale: Scale
    parameters: Mapping[str, float]
    sizes: tuple[SizeLimit, ...]
    count: int
    found: int
    false_calls: tuple[int, int, float, float] | None
    grid: FloatArray
    probability: FloatArray
    low: FloatArray
    high: FloatArray
    confidence: float
    deviance: float = field(default=math.nan, metadata=LEFT_OUT)

    @property
    @in_json()
    def verdict(self) -> str:
        """a50, a90 and a90/95 in a sentence."""
        half, most = self.sizes
        bound = "beyond every size" if math.isinf(most.bound) else f"{most.bound:.4g}"
        return f"a50 {half.size:.4g}, a90 {most.size:.4g}, a90/95 {bound}"


def hit_miss(
    trials: Trials,
    scale: Scale = "log",
    link: Literal["logit", "probit"] = "logit",
    confidence: float = CONFIDENCE,
    points: int = POINTS,
) -> DetectionCurve:
    """Fit found or not found over size.

    Args:
        trials: with defects of several sizes, some found and some not.
        scale: of the size.
        link: logistic or normal curve.
        confidence: of intervals and bounds.
        points: sizes at which the curve is given.

    Raises:
        UsageError: too few parts, all or none found, sizes that separate both exactly, or no growth with the size.
    """
    some = trials.size > 0.0
    x, hit = _scaled(trials.size[some], scale), trials.hit[some]
    _check(len(x), confidence)
    if hit.all() or not hit.any():
        raise UsageError(
            f"{'all' if hit.any() else 'none'} of the defects were found: other sizes are needed"
        )
    if x[hit].min() > x[~hit].max() or x[hit].max() < x[~hit].min():
        raise UsageError(
            "one size separates all found defects from all others: the curve has no scatter; add sizes near "
            f"{trials.size[some][hit].min():g}"
        )
    family = _LOGIT if link == "logit" else _PROBIT
    sign = np.where(hit, 1.0, -1.0)
    center, spread = float(x.mean()), float(x.std()) or 1.0
    z = (x - center) / spread
    top, (slope, start) = _largest(
        family, sign[:, None] * np.column_stack([z, np.ones_like(z)]), 0.0, np.zeros(2)
    )
    if slope <= 0.0:
        raise UsageError("larger defects were not found more often: no curve of detection")

    def profile(eta: float, at: float) -> float:
        return _largest(family, (sign * (z - at))[:, None], sign * eta, np.array([slope]))[0]

    quantile = _LOGISTIC if link == "logit" else _NORMAL
    grid = _grid(x, points)
    curve = _curve(profile, top, (slope, start), quantile, (grid - center) / spread, confidence)
    limits = tuple(
        _limit(partial(profile, quantile[0](p)), top, (quantile[0](p) - start) / slope, confidence)
        for p in LEVELS
    )
    sizes = tuple(
        SizeLimit(p, *(_unscaled(center + spread * end, scale) for end in ends))
        for p, ends in zip(LEVELS, limits, strict=True)
    )
    names = {"intercept": start - slope * center / spread, "slope": slope / spread}
    return DetectionCurve(
        "hit/miss", scale, names, sizes, len(x), int(hit.sum()), _false_calls(trials, some), _unscaled_all(grid, scale),
        *curve, confidence, -2.0 * top,
    )  # fmt: skip


def signal_over_size(
    size: FloatArray,
    signal: FloatArray,
    threshold: float,
    scales: tuple[Scale, Scale] = ("log", "log"),
    *,
    noise: float | None = None,
    saturation: float | None = None,
    confidence: float = CONFIDENCE,
    points: int = POINTS,
) -> DetectionCurve:
    """Fit signals over sizes (â against a).

    Args:
        size: (N,) sizes; of parts without a defect, 0.
        signal: (N,) signals.
        threshold: signal from which a defect counts as found.
        scales: of size and signal.
        noise: signals at or below this are only known to be so (left-censored); None: none.
        saturation: signals at or above this likewise (right-censored).
        confidence: of intervals and bounds.
        points: sizes at which the curve is given.

    Raises:
        UsageError: too few parts, signals that cannot be scaled, or no growth with the size.
    """
    some = size > 0.0
    x, y = _scaled(size[some], scales[0]), _scaled(signal[some], scales[1])
    _check(len(x), confidence)
    limit = float(_scaled(np.array([threshold]), scales[1])[0])
    low = signal[some] <= (-math.inf if noise is None else noise)
    high = signal[some] >= (math.inf if saturation is None else saturation)
    known = ~(low | high)
    if np.count_nonzero(known) < 3 or float(np.ptp(x[known])) == 0.0:
        raise UsageError("too few signals between noise and saturation for a line over the size")
    center, spread = float(x.mean()), float(x.std())
    z = (x - center) / spread
    slope, start = np.polyfit(z[known], y[known], 1)
    sigma = float(np.std(y[known] - start - slope * z[known])) or 1e-9
    if slope <= 0.0:
        raise UsageError("larger defects have no larger signals: no curve of detection")

    side = np.where(low, 1.0, -1.0)

    def family(residual: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Logarithm of the density of known signals, of the probability of censored ones, of residuals in sigma."""
        tail = _PROBIT(side * residual)
        return (
            np.where(known, -0.5 * residual**2 - 0.5 * math.log(2.0 * math.pi), tail[0]),
            np.where(known, -residual, side * tail[1]),
            np.where(known, -1.0, tail[2]),
        )

    # concave in 1/sigma, slope/sigma and (line - threshold)/sigma (R. J. Olsen, Econometrica 46 (1978) 1211)
    begin, count = np.array([1.0, slope, start - limit]) / sigma, int(np.count_nonzero(known))
    top, best = _largest(family, np.column_stack([y - limit, -z, -np.ones_like(z)]), 0.0, begin, count)
    if best[1] <= 0.0:
        raise UsageError("larger defects have no larger signals: no curve of detection")

    def profile(eta: float, at: float) -> float:
        return _largest(family, np.column_stack([y - limit, at - z]), -eta, best[:2], count)[0]

    sigma, fit = 1.0 / float(best[0]), (float(best[1]), float(best[2]))
    grid = _grid(x, points)
    curve = _curve(profile, top, fit, _NORMAL, (grid - center) / spread, confidence)
    limits = [
        _limit(partial(profile, _NORMAL[0](p)), top, (_NORMAL[0](p) - fit[1]) / fit[0], confidence)
        for p in LEVELS
    ]
    sizes = tuple(
        SizeLimit(p, *(_unscaled(center + spread * end, scales[0]) for end in ends))
        for p, ends in zip(LEVELS, limits, strict=True)
    )
    rise = fit[0] * sigma / spread
    names = {"intercept": limit + fit[1] * sigma - rise * center, "slope": rise, "sigma": sigma}
    hit = signal >= threshold
    return DetectionCurve(
        "â against a", scales[0], names, sizes, len(x), int(hit[some].sum()), _false_calls(Trials(size, hit), some),
        _unscaled_all(grid, scales[0]), *curve, confidence, -2.0 * top,
    )  # fmt: skip


_Family = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
_Quantile = tuple[Callable[[float], float], Callable[[FloatArray], FloatArray]]


def _LOGIT(eta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:  # noqa: N802 - a family, not an action
    """Logarithm of the logistic curve, its slope and bend."""
    p = 1.0 / (1.0 + np.exp(-np.clip(eta, -700.0, 700.0)))
    return -np.logaddexp(0.0, -eta), 1.0 - p, -p * (1.0 - p)


def _PROBIT(eta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:  # noqa: N802
    """Logarithm of the normal curve, its slope and bend."""
    from scipy.special import log_ndtr  # noqa: PLC0415 - heavy

    log_p = log_ndtr(eta)
    ratio = np.exp(-0.5 * eta**2 - 0.5 * math.log(2.0 * math.pi) - log_p)
    return log_p, ratio, -ratio * (eta + ratio)


def _normal_quantile(p: float) -> float:
    from scipy.special import ndtri  # noqa: PLC0415 - heavy

    return float(ndtri(p))


def _normal_curve(eta: FloatArray) -> FloatArray:
    from scipy.special import ndtr  # noqa: PLC0415 - heavy

    return np.asarray(ndtr(eta))


_LOGISTIC: _Quantile = (lambda p: math.log(p / (1.0 - p)), lambda eta: np.exp(_LOGIT(eta)[0]))
_NORMAL: _Quantile = (_normal_quantile, _normal_curve)


def _largest(
    family: _Family, columns: FloatArray, offset: FloatArray | float, begin: FloatArray, logs: int = 0
) -> tuple[float, FloatArray]:
    """Largest of the concave sum of family(columns b + offset) + logs ln b[0] over b, by Newton's steps; and b."""

    def value_at(b: FloatArray) -> float:
        if logs and b[0] <= 0.0:
            return -math.inf
        return float(family(columns @ b + offset)[0].sum()) + (logs * math.log(b[0]) if logs else 0.0)

    b, value = begin, value_at(begin)
    for _ in range(_STEPS):
        _, slope, bend = family(columns @ b + offset)
        gradient, curvature = columns.T @ slope, (columns.T * bend) @ columns
        if logs:
            gradient[0] += logs / b[0]
            curvature[0, 0] -= logs / b[0] ** 2
        step, share = np.linalg.solve(curvature, -gradient), 1.0
        while not (new := value_at(b + share * step)) >= value and share > 1e-9:
            share /= 2.0
        if not new > value:
            break
        b, gain, value = b + share * step, new - value, new
        if gain < 1e-12 * (1.0 + abs(value)):
            break
    return value, b


def _drop(confidence: float, *, two_sided: bool) -> float:
    """Half the χ² by which the profile falls at a limit."""
    tail = (1.0 - confidence) / 2.0 if two_sided else 1.0 - confidence
    return _normal_quantile(1.0 - tail) ** 2 / 2.0


def _limit(
    profile: Callable[[float], float], top: float, best: float, confidence: float
) -> tuple[float, float, float, float]:
    """Estimate, ends of the interval and upper bound of a standardised size; infinite where there is none."""
    both, one = (_drop(confidence, two_sided=two) for two in (True, False))
    return (
        best,
        _crossing(profile, top - both, best, -1.0),
        _crossing(profile, top - both, best, 1.0),
        _crossing(profile, top - one, best, 1.0),
    )


_FARTHEST = 64.0


def _crossing(profile: Callable[[float], float], level: float, best: float, side: float) -> float:
    """Where a profile falls to a level on one side of its top; infinite where it stays above."""
    from scipy.optimize import brentq  # noqa: PLC0415 - heavy

    step, inner = 0.05, best
    while profile(best + side * step) > level:
        inner, step = best + side * step, 2.0 * step
        if step > _FARTHEST:
            return side * math.inf
    return float(brentq(lambda at: profile(at) - level, inner, best + side * step, xtol=1e-7))


def _curve(
    profile: Callable[[float, float], float],
    top: float,
    fit: tuple[float, float],
    quantile: _Quantile,
    grid: FloatArray,
    confidence: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The curve over standardised sizes and its band."""
    eta, drop = fit[0] * grid + fit[1], _drop(confidence, two_sided=True)

    def end(at: float, own: float, side: float) -> float:
        return _crossing(lambda e: profile(e, at), top - drop, own, side)

    pairs = list(zip(grid.tolist(), eta.tolist(), strict=True))
    ends = [[end(at, own, side) for at, own in pairs] for side in (-1.0, 1.0)]
    low, high = (quantile[1](np.clip(np.array(one), -700.0, 700.0)) for one in ends)
    return quantile[1](eta), low, high


def _check(count: int, confidence: float) -> None:
    if count < LEAST:
        raise UsageError(
            f"a curve of detection needs {LEAST} parts with a defect or more (MIL-HDBK-1823A: 60 for hit/miss, 40 for "
            f"signals), not {count}"
        )
    if not 0.5 < confidence < 1.0:
        raise UsageError(f"the confidence lies between 0.5 and 1, not at {confidence:g}")


def _scaled(values: FloatArray, scale: Scale) -> FloatArray:
    if scale == "log" and (values <= 0.0).any():
        raise UsageError(f"a value of {values.min():g} has no logarithm: use a linear scale")
    return np.asarray(np.log(values)) if scale == "log" else values


def _unscaled(value: float, scale: Scale) -> float:
    return value if scale == "linear" else math.inf if value == math.inf else math.exp(value)


def _unscaled_all(values: FloatArray, scale: Scale) -> FloatArray:
    return values if scale == "linear" else np.exp(values)


def _grid(x: FloatArray, points: int) -> FloatArray:
    return np.linspace(float(x.min()), float(x.max()), points)


def _false_calls(trials: Trials, some: npt.NDArray[np.bool_]) -> tuple[int, int, float, float] | None:
    count = int(np.count_nonzero(~some))
    if not count:
        return None
    found = int(np.count_nonzero(trials.hit[~some]))
    return found, count, *proportion_interval(found, count)


def read_trials(path: Path) -> tuple[FloatArray, FloatArray | None, npt.NDArray[np.bool_] | None]:
    """Sizes with signals or with hits of a CSV file: ``size,hit`` (1 or 0) or ``size,signal``; size 0 without a defect.

    Returns:
        Sizes, signals or None, hits or None.

    Raises:
        UsageError: the file cannot be read, or a line of it cannot be used.
    """
    table = read_table(path, (("size", "hit"), ("size", "signal")), not_negative=("size",), what="parts")
    if "signal" in table.columns:
        return table.column("size"), table.column("signal"), None
    hit = table.column("hit")
    wrong = np.flatnonzero(~np.isin(hit, (0.0, 1.0)))
    if wrong.size:
        raise UsageError(f"{table.place(int(wrong[0]))}: hit is 1 or 0, not {hit[wrong[0]]:g}")
    return table.column("size"), None, hit == 1.0
