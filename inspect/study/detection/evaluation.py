"""Evaluation of the parts of a detection study: diagnosis, fitted shapes, rates, ROC areas, and coverage of intervals.

Everything is computed from the radiances stored with a chunk.

Coverage: do 95 % intervals of extents contain the truth in 95 % of the parts, once every source of variation is stated?
The diagnosis assumes signature errors as real parts need them, and a recipe need not state how much the ridge angle of
good parts varies. In the study both are known. The spread is stated. The errors of the signatures, the scatter of the
shares of deviating cells and the spread of good parts are estimated from one half of the parts; the intervals are
evaluated on the other half, and the halves are exchanged. A remaining difference from 95 % is due to the fit itself.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.diagnosis.evidence import Evidence, against, background_of, covariance_of, inputs_of
from anisoscope.diagnosis.likelihood import costs, fit_extent, interval
from anisoscope.diagnosis.ranking import NOTHING, diagnose
from anisoscope.diagnosis.separability import Separability, planned_covariance, planned_inputs, separability
from anisoscope.diagnosis.shape_fit import fit_shape
from anisoscope.diagnosis.signature_cache import cached_signatures
from anisoscope.diagnosis.signatures import Signature, Signatures, signatures
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.prediction.expectation import Component
from anisoscope.record.schema import CauseRecord
from anisoscope.study.detection.chunk import MEASURED_SOURCES
from anisoscope.study.detection.product import (
    BY_NAME,
    LIGHT_DEG,
    RIDGE_ANGLE_DEG,
    WHOLE,
    RecipeName,
    Size,
    expected_of,
    recipe_of,
)

Columns = dict[str, npt.NDArray[Any]]

SHARED_SOURCES = ("stray light",)
COVERAGE = 1.959964
FITTED = 60
"""Good parts to which shapes are fitted, a second each."""


@lru_cache(maxsize=8)
def signatures_of(name: RecipeName, size: Size, *, stated: bool = False) -> Signatures:
    """Signatures of the causes for the poses of a recipe; arguments as for `recipe_of`."""
    recipe = recipe_of(name, size, stated=stated)
    if size.causes is None:
        return cached_signatures(recipe, LIGHT_DEG)
    return signatures(recipe, LIGHT_DEG, names=size.causes)


def separability_of(name: RecipeName, size: Size) -> dict[str, Separability]:
    """Separability of the causes under a recipe."""
    recipe = recipe_of(name, size)
    assert recipe.area is not None
    u_background = background_of(recipe.area.max_share)[1]
    covariance = planned_covariance(recipe, expected_of(name, size))
    inputs = planned_inputs(recipe, expected_of(name, size))
    known = signatures_of(name, size)
    rows = separability(known, covariance, with_map=True, u_background=u_background, inputs=inputs)
    return {row.cause: row for row in rows}


def components_of(data: Columns, name: RecipeName, number: int) -> tuple[Component, ...]:
    """Components of the measurement of one part."""
    return tuple(
        Component(source, "measurement", relative, source in SHARED_SOURCES)
        for source, relative in zip(MEASURED_SOURCES, data[f"{name}/own"][number], strict=True)
    )


def evidence(
    data: Columns,
    name: RecipeName,
    size: Size,
    number: int,
    golden: FloatArray | None,
    *,
    stated: bool = False,
) -> Evidence:
    """Evidence for the diagnosis of one part, as in ``inspect``.

    Args:
        data: columns of a class.
        name: of the recipe.
        size: of the study.
        number: of the part.
        golden: (n, P) ln L over the prediction of golden parts, whose mean is the reference; None: the prediction is.
        stated: the recipe states the spread of the ridge angle of good parts.
    """
    recipe, expected = recipe_of(name, size, stated=stated), expected_of(name, size, stated=stated)
    components = components_of(data, name, number)
    deviation = np.asarray(data[f"{name}/deviation"][number], dtype=np.float64)
    scale_share = recipe.uncertainty.scale_share
    covariance = covariance_of(expected.components + components, scale_share, len(deviation))
    assert recipe.area is not None
    background = background_of(recipe.area.max_share)
    inputs = inputs_of(recipe, expected, components)
    share, u_share = float(data[f"{name}/share"][number]), float(data[f"{name}/u_share"][number])
    found = Evidence(deviation, covariance, share, u_share, *background, inputs)
    return found if golden is None else against(found, golden, scale_share)


def diagnosed(
    kind: str, data: Columns, name: RecipeName, size: Size, count: int, golden: FloatArray | None = None
) -> Columns:
    """First causes of the first parts of a class, their ties, and the extent of the true cause.

    ``wrong`` is a confident wrong diagnosis: neither the true cause nor "nothing" ties, and the best cause explains the
    part.
    """
    known, cause = signatures_of(name, size), BY_NAME[kind].cause
    alpha = recipe_of(name, size).decision.alpha
    rows = []
    for number in range(min(count, len(data["extent"]))):
        diagnosis = diagnose(known, evidence(data, name, size, number, golden))
        ties = {one.cause for one in diagnosis.ties}
        first = diagnosis.causes[0].cause
        right = next((one for one in diagnosis.causes if one.cause == cause), None)
        wrong = not ties & {cause, NOTHING} and diagnosis.unexplained_p >= alpha
        rows.append((first, diagnosis.causes[1].cause, cause in ties, wrong, len(ties), *_fit_of(right)))
    names = ("first", "second", "tied", "wrong", "ties", "extent", "u", "low", "high")
    return {title: np.array(values) for title, values in zip(names, zip(*rows, strict=True), strict=True)}


def _fit_of(found: CauseRecord | None) -> tuple[float, float, float, float]:
    """Severity, u (infinite where undetermined) and 95 % interval (NaN where open); NaN without the cause."""
    if found is None:
        return np.nan, np.nan, np.nan, np.nan
    low, high = (np.nan if end is None else end for end in found.interval or (None, None))
    return found.severity, np.inf if found.u is None else found.u, low, high


def true_extents(kind: str, data: Columns, size: Size) -> FloatArray:
    """Extents as they truly are: the scatter of good parts adds to some; ridges may be missing in part."""
    if kind == "ridge-angle":
        return np.asarray(data["ridge_angle_deg"] - RIDGE_ANGLE_DEG)
    if kind == "roughness":
        return np.asarray(np.exp(data["across"]) - 1.0)
    if kind == "missing-ridges":  # of the area that is cut out, half a pitch wider on both sides
        return np.asarray(data["spoiled"] * (size.ridges + 1) / size.ridges)
    return np.asarray(data["extent"], dtype=np.float64)


def fitted_shapes(data: Columns, name: RecipeName, size: Size) -> dict[str, npt.NDArray[np.bool_]]:
    """Whether the 95 % interval of every shape parameter that was determined holds the truth, by its name."""
    recipe, expected = recipe_of(name, size), expected_of(name, size)
    nowhere = Grid((0.0, 0.0), 1.0, (1, 1))
    held: dict[str, list[bool]] = {}
    for number in range(min(FITTED, len(data["extent"]))):
        radiance = expected.radiance * np.exp(data[f"{name}/deviation"][number])
        cells = np.zeros((len(radiance), 1, 1))
        components = components_of(data, name, number)
        measured = Measured(radiance, components, (), cells, np.zeros(len(radiance)), nowhere, None)
        shape, _ = fit_shape(recipe, expected, measured)
        truth = {
            "ridge_angle_deg": data["ridge_angle_deg"][number],
            "alpha_along": WHOLE.alpha_along * np.exp(data["along"][number]),
            "alpha_across": WHOLE.alpha_across * np.exp(data["across"][number]),
        }
        for one in () if shape is None else shape.estimates:
            if one.value is not None and one.u is not None and not one.at_bound and one.name in truth:
                off = abs(one.value - float(truth[one.name]))
                held.setdefault(one.name, []).append(off <= COVERAGE * one.u)
    return {parameter: np.array(values) for parameter, values in held.items()}


@dataclass(frozen=True)
class Rate:
    """A rate with its 95 % interval (Clopper and Pearson 1934).

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


MOST = 1.0
"""Largest relative doubt that is considered."""


@dataclass(frozen=True)
class Doubt:
    """Signature errors in the study's own world.

    Attributes:
        change: relative standard uncertainty of the change of ln L.
        share: relative standard uncertainty of the share of deviating cells.
        background: share of deviating cells on good parts.
        u_background: its standard deviation from part to part, without the uncertainty of the measurement.
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
        stated: under a recipe that states the spread of the ridge angle, with the signature errors of real parts.
        doubted: the same with the signature errors of the study's world.
        doubts: these errors, from either half of the parts.
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
