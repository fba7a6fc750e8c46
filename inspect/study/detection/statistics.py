"""Statistics of a detection study: rates, ROC area, thresholds, and the coverage of the intervals of extents.

Coverage: do 95 % intervals of extents contain the truth in 95 % of the parts, once everything that varies is stated?
The diagnosis assumes signature errors as real parts need them, and a recipe need not state how much the ridge angle of
good parts varies. In the same world both are known: the spread is stated, and the errors of the signatures, the scatter
of the shares of deviating cells, and the spread of good parts are counted on one half of the parts. The intervals of
the other half are then tried, and the halves change places. What then still misses 95 % is due to the fit itself.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.diagnosis.evidence import Evidence
from anisoscope.diagnosis.likelihood import costs, fit_extent, interval
from anisoscope.diagnosis.signatures import Signature
from anisoscope.study.detection.diagnosis import evidence, signatures_of, true_extents
from anisoscope.study.detection.product import BY_NAME, RecipeName, Size


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
        """Count over number; NaN for an empty sample."""
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
    """Area under the ROC curve: probability that a bad part scores above a good one; ties count half.

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
    """Counts of p values in equal bins from 0 to 1."""
    return [int(count) for count in np.histogram(p_values, bins=bins, range=(0.0, 1.0))[0]]


Columns = dict[str, npt.NDArray[Any]]

MOST = 1.0
"""Relative doubt up to which one is looked for."""


@dataclass(frozen=True)
class Doubt:
    """Signature errors in the study's own world.

    Attributes:
        change: relative standard uncertainty of the change of ln L.
        share: relative standard uncertainty of the share of deviating cells.
        background: share of deviating cells on good parts.
        u_background: its standard deviation from part to part, what the measurement knows of it left out.
    """

    change: float
    share: float
    background: float
    u_background: float


@dataclass(frozen=True, eq=False)
class Part:
    """One part: evidence of its diagnosis, and the true extent of its defect."""

    evidence: Evidence
    truth: float


@dataclass(frozen=True)
class Held:
    """Coverage of the intervals of one class.

    Attributes:
        stated: by a recipe that states the spread of the ridge angle, with the doubts of real parts.
        doubted: the same with the doubts of the study's world.
        doubts: these doubts, from either half of the parts.
    """

    stated: Rate
    doubted: Rate
    doubts: tuple[Doubt, ...]


def intervals_held(kind: str, data: dict[str, Columns], name: RecipeName, size: Size) -> Held | None:
    """Coverage of the intervals of a class; None for fewer than two parts or a cause without a signature.

    Args:
        kind: the class.
        data: columns of the class and of good parts, valid ones only.
        name: of the recipe.
        size: of the study.
    """
    known = {one.cause.name: one for one in signatures_of(name, size, stated=True).found}
    signature, columns = known.get(BY_NAME[kind].cause), data[kind]
    count = len(columns["extent"])
    if signature is None or count < 2:
        return None
    truth = true_extents(kind, columns, size)
    parts = [Part(evidence(columns, name, size, n, None, stated=True), float(truth[n])) for n in range(count)]
    halves = parts[::2], parts[1::2]
    doubts = tuple(
        doubt_of(signature, half, *background_of_good(data["good"], name, first))
        for first, half in enumerate(halves)
    )
    doubted = [
        holds(*doubting(signature, part, doubt))
        for doubt, half in zip(doubts, halves[::-1], strict=True)
        for part in half
    ]
    stated = [holds(signature, part) for part in parts]
    return Held(rate(np.array(stated)), rate(np.array(doubted)), doubts)


def background_of_good(good: Columns, name: RecipeName, first: int) -> tuple[float, float]:
    """Share of deviating cells on every second good part, and its scatter beyond that of the measurement."""
    share = np.asarray(good[f"{name}/share"][first::2], dtype=np.float64)
    known = np.asarray(good[f"{name}/u_share"][first::2], dtype=np.float64)
    return float(share.mean()), float(np.sqrt(max(share.var(ddof=1) - np.mean(known**2), 0.0)))


def doubt_of(signature: Signature, parts: list[Part], background: float, u_background: float) -> Doubt:
    """Maximum-likelihood doubts of parts at their true extents."""
    means = [replace(part.evidence, share=None) for part in parts]

    def of_change(doubt: float) -> float:
        one = replace(signature, cause=replace(signature.cause, doubt=doubt))
        return sum(
            float(costs(one, mean, np.array([part.truth]), as_input=True)[1][0])
            for mean, part in zip(means, parts, strict=True)
        )

    shares = signature.at(np.array([part.truth for part in parts]))[1]
    off = np.array([part.evidence.share for part in parts], dtype=np.float64) - background - shares
    known = np.array([part.evidence.u_share for part in parts])

    def of_share(doubt: float) -> float:
        variance = known**2 + u_background**2 + (doubt * shares) ** 2
        return float(np.sum(off**2 / variance + np.log(variance)))

    return Doubt(_least(of_change), _least(of_share), background, u_background)


def _least(cost: Callable[[float], float]) -> float:
    """Minimum of a cost between 0 and `MOST`; 0 if no doubt reduces it."""
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - 0.3 s

    found = minimize_scalar(cost, bounds=(0.0, MOST), method="bounded", options={"xatol": 1e-3})
    return float(found.x) if found.fun < cost(0.0) else 0.0


def doubting(signature: Signature, part: Part, doubt: Doubt) -> tuple[Signature, Part]:
    """Signature and part with the doubts of the study's world in place of those of real parts."""
    doubted = replace(
        part.evidence,
        background=doubt.background,
        u_background=doubt.u_background,
        share_relative=doubt.share,
        share_floor=0.0,
    )
    return replace(signature, cause=replace(signature.cause, doubt=doubt.change)), replace(
        part, evidence=doubted
    )


def holds(signature: Signature, part: Part) -> bool:
    """Whether the interval of a part contains its true extent. An open end contains everything beyond."""
    low, high = interval(signature, part.evidence, fit_extent(signature, part.evidence))
    return not (low is not None and part.truth < low) and not (high is not None and part.truth > high)
