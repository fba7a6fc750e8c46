"""Defects that a part excludes: one-sided 95 % limits of their sizes (ISO 14253-1 on the state of the part).

A part that does not deviate need not be good: the poses may be blind to a defect. Each named defect c, at x times its
smallest interesting size, is therefore tried against what was measured: T_c(x) is −2 ln of the profile likelihood, all
else that is uncertain free within what is known of it. The limit is the largest x at which T_c exceeds its minimum by
no more than 1.645² (a likelihood ratio, one side 5 %): what lies beyond it is excluded. Where it is at most 1 a defect
of the smallest interesting size would have shown.

This is the part that all kinds share: limits of curves, sentences, and what an open defect does to a verdict.
`surface_exclusion` has the curves of surfaces.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.prediction.profile_likelihood import BoundedCurve, DefectCurves, nearest_costly
from anisoscope.recipe.named_defect import NamedDefect
from anisoscope.record.exclusion import ExclusionRecord
from anisoscope.record.verdict import Verdict

ONE_SIDED = 1.6448536269514722
"""95 % of the standard normal distribution."""
EXTENTS = np.array([0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0])
"""Extents that are tried, in smallest interesting sizes; beyond the last one no limit is stated."""
FINE = np.array([0.0, 0.25, 0.5, 0.75, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0, 3.0, 5.0])
"""The same where a defect of interest is large against what the poses show."""
COSTLY = (0.0, 0.5, 1.0, 1.5, 2.0)
"""The same where every state is evaluated by the model itself: up to 1, and farther while nothing is excluded."""
_CLOSE = 3e-3  # a limit needs T_c to .01 only
_ASIDE = 1.5  # standard uncertainties
_HALVED = 2  # times that the interval of the limit is halved
MORE_POSES = "photograph more poses (anisoscope recipe suggest)"
MORE_TILTS = "photograph further tilts (anisoscope recipe check)"


@dataclass(frozen=True)
class Exclusion:
    """Largest size of a named defect that a part may have.

    Attributes:
        defect: with its smallest interesting size.
        best: likeliest size as a multiple of that, at least 0.
        limit: largest size that is not excluded, likewise; infinite where none of those tried is.
        where: place of the part that may have the largest one; empty where the defect is of the whole part.
    """

    defect: NamedDefect
    best: float
    limit: float
    where: str = ""

    @property
    def excluded(self) -> bool:
        """Whether the defect at its smallest interesting size is excluded."""
        return self.limit <= 1.0

    @property
    def limit_text(self) -> str:
        """The largest size that is not excluded, with its unit."""
        return self.defect.text(self.limit).strip() if np.isfinite(self.limit) else "any size"

    def record(self) -> ExclusionRecord:
        """The limit as records have it."""
        return ExclusionRecord(
            words=self.defect.words,
            size=self.defect.size,
            unit=self.defect.unit,
            best=self.best,
            limit=self.limit if np.isfinite(self.limit) else None,
            where=self.where,
        )


@dataclass(frozen=True)
class PlannedLimit:
    """Largest size of a defect that is not excluded of a part exactly as designed.

    Attributes:
        defect: with its smallest interesting size.
        best: the size with its unit, in the best case, such as the lobe that shows it best.
        worst: in the worst case.
        excluded: whether the smallest interesting size is excluded in every case.
    """

    defect: str
    best: str
    worst: str
    excluded: bool


def planned(cases: Sequence[tuple[Exclusion, ...]]) -> tuple[PlannedLimit, ...]:
    """Limits of parts as designed, the best and the worst of several cases that are as likely.

    Args:
        cases: limits of the same defects in each.
    """
    found = []
    for each in zip(*cases, strict=True):
        best, worst = (chosen(each, key=_limit) for chosen in (min, max))
        found.append(
            PlannedLimit(worst.defect.name, best.limit_text, worst.limit_text, excluded=worst.excluded)
        )
    return tuple(found)


def planned_text(limits: tuple[PlannedLimit, ...], remedy: str) -> tuple[str, ...]:
    """What a part as designed excludes, in a line; none where there are no limits.

    Args:
        limits: of a part as designed.
        remedy: what makes them smaller.
    """
    if not limits:
        return ()
    closed = [one.defect for one in limits if one.excluded]
    left = [f"{one.defect} (up to {one.worst})" for one in limits if not one.excluded]
    said = f"a part as designed excludes {', '.join(closed)}" if closed else "no defect is excluded"
    if not left:
        return (f"{said}: good parts can PASS by the prediction alone",)
    return (f"{said}; not excluded, in the worst case: {', '.join(left)}: {remedy}",)


def _limit(one: Exclusion) -> float:
    return one.limit


def of_curve(defect: NamedDefect, curve: FloatArray, extents: FloatArray = EXTENTS) -> Exclusion:
    """Limit from −2 ln of the profile likelihood at some extents, a cubic spline between them.

    Args:
        defect: with its smallest interesting size.
        curve: (n,) T_c.
        extents: (n,) in smallest interesting sizes, ascending from 0.
    """
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - start-up time

    fine = np.linspace(extents[0], extents[-1], 1001)
    return _of_values(defect, fine, CubicSpline(extents, curve)(fine))


def _of_values(defect: NamedDefect, fine: FloatArray, values: FloatArray) -> Exclusion:
    best = int(np.argmin(values))
    within = np.flatnonzero(values <= values[best] + ONE_SIDED**2)
    last = int(within[-1])
    limit = float("inf") if last == len(fine) - 1 else float(fine[last])
    return Exclusion(defect, float(fine[best]), limit)


def of_normal(defect: NamedDefect, best: float, u: float, where: str = "") -> Exclusion:
    """Limit of a size whose likelihood is normal.

    Args:
        defect: with its smallest interesting size.
        best: likeliest size as a multiple of that.
        u: standard uncertainty, likewise.
        where: place of the part.
    """
    least = max(best, 0.0)
    return Exclusion(defect, least, least + ONE_SIDED * u, where)


@dataclass(frozen=True, eq=False)
class Change:
    """What a named defect changes of m values.

    Attributes:
        defect: with its smallest interesting size.
        shown: (E, m) change at `FINE`.
        covariance: (E, m, m) of the values of parts with it, by all that is uncertain besides.
    """

    defect: NamedDefect
    shown: FloatArray
    covariance: FloatArray


def _between(extents: FloatArray, curve: FloatArray) -> float:
    """Limit where the root of the curve above its least value is linear between the sizes: for steep curves."""
    above = np.sqrt(np.maximum(curve - curve.min(), 0.0))
    last = int(np.flatnonzero(above <= ONE_SIDED)[-1])
    if last + 1 == len(extents):
        return float("inf")
    share = (ONE_SIDED - above[last]) / (above[last + 1] - above[last])
    return float(extents[last] + share * (extents[last + 1] - extents[last]))


def excluded_by_changes(changes: Sequence[Change], deviation: FloatArray) -> tuple[Exclusion, ...]:
    """Limits of named defects whose change is known at every size, all else that is uncertain being linear.

    T_c(x) = (d − s_c(x))ᵀV_c(x)⁻¹(d − s_c(x)) + ln |V_c(x)|.

    Args:
        changes: of each defect.
        deviation: (m,) d, from a part as designed.
    """
    found = []
    for one in changes:
        rest = deviation - one.shown
        squares = np.einsum("em,em->e", rest, np.linalg.solve(one.covariance, rest[..., None])[..., 0])
        curve = squares + np.linalg.slogdet(one.covariance)[1]
        smooth = of_curve(one.defect, curve, FINE)
        found.append(replace(smooth, limit=max(smooth.limit, _between(FINE, curve))))
    return tuple(found)


def excluded_by_model(
    curves: DefectCurves, deviation: FloatArray, covariance: FloatArray
) -> tuple[Exclusion, ...]:
    """Limits of the named defects of a model that is evaluated itself with each of them, whatever else is uncertain.

    T_c(x) = min over z of |z|² + (d − f_c(x, z))ᵀV⁻¹(d − f_c(x, z)). A search begins where that of the size before
    ended; of a size of interest that would be excluded also aside, because a model may have several minima.

    Args:
        curves: of the m values, for every defect and size.
        deviation: (m,).
        covariance: (m, m) of the errors that are no input of the curves, of full rank.
    """
    found = []
    for defect in curves.defects:
        profile = _Profile(partial(curves.with_defect, defect), deviation, covariance)
        for extent in COSTLY:
            if profile.search(extent) and extent >= 1.0:
                break
        for _ in range(_HALVED):
            profile.halve()
        found.append(profile.limit(defect))
    return tuple(found)


class _Profile:
    """−2 ln of the profile likelihood of one defect, at the sizes searched so far."""

    def __init__(
        self, curve_of: Callable[[float], BoundedCurve], deviation: FloatArray, covariance: FloatArray
    ) -> None:
        self._curve_of, self._deviation, self._covariance = curve_of, deviation, covariance
        self._known: dict[float, tuple[float, dict[str, float]]] = {}

    def search(self, extent: float) -> bool:
        """Search at a size; whether it is excluded."""
        curve = self._curve_of(extent)
        smaller = [one for one in self._known if one < extent]
        near = self._known[max(smaller)][1] if smaller else {}
        begin = np.array([near.get(source, 0.0) for source in curve.sources])
        self._known[extent] = self._nearest(curve, begin)
        if extent >= 1.0 and self._excluded(extent):
            again = self._nearest(curve, self._aside(curve, begin))
            self._known[extent] = min(self._known[extent], again, key=lambda one: one[0])
        return self._excluded(extent)

    def halve(self) -> None:
        """Search in the middle of the last size that is not excluded and the next one."""
        sizes = sorted(self._known)
        last = max(number for number, one in enumerate(sizes) if not self._excluded(one))
        if last + 1 < len(sizes):
            self.search(0.5 * (sizes[last] + sizes[last + 1]))

    def limit(self, defect: NamedDefect) -> Exclusion:
        """The limit, with monotone cubics between the sizes."""
        from scipy.interpolate import PchipInterpolator  # noqa: PLC0415 - start-up time

        sizes = np.array(sorted(self._known))
        values = np.array([self._known[float(one)][0] for one in sizes])
        fine = np.linspace(0.0, sizes[-1], 1001)
        found = _of_values(defect, fine, PchipInterpolator(sizes, values)(fine))
        return replace(found, best=_vertex(sizes, values))

    def _excluded(self, extent: float) -> bool:
        return self._known[extent][0] > min(one for one, _ in self._known.values()) + ONE_SIDED**2

    def _aside(self, curve: BoundedCurve, state: FloatArray) -> FloatArray:
        """The best of the nominal state and those with one input displaced; no step may lead from one to another."""
        aside = _ASIDE * np.eye(len(state))
        tried = np.vstack([0.0 * state, state + aside, state - aside])
        rest = self._deviation - curve.change(tried)
        weight = np.linalg.inv(self._covariance)
        misfit = np.sum(tried**2, axis=1) + np.einsum("ni,ij,nj->n", rest, weight, rest)
        return np.asarray(tried[int(np.argmin(misfit))])

    def _nearest(self, curve: BoundedCurve, begin: FloatArray) -> tuple[float, dict[str, float]]:
        """Squared distance from the nearest state of the inputs, and that state by their names."""
        left, z = nearest_costly(
            curve, self._deviation, self._covariance, begin, settled=_CLOSE, farthest=curve.farthest
        )
        return left, dict(zip(curve.sources, z.tolist(), strict=True))


def _vertex(sizes: FloatArray, values: FloatArray) -> float:
    """Size of the least value by a parabola through the least one and its neighbours; not below 0."""
    middle = min(max(int(np.argmin(values)), 1), len(sizes) - 2)
    near = slice(middle - 1, middle + 2)
    square, slope, _ = np.polyfit(sizes[near], values[near], 2)
    if square <= 0.0:
        return float(sizes[np.argmin(values)])
    return float(np.clip(-0.5 * slope / square, sizes[middle - 1], sizes[middle + 1]))


def open_defects(found: tuple[Exclusion, ...]) -> tuple[Exclusion, ...]:
    """Those that are not excluded, the least excluded first."""
    return tuple(sorted((one for one in found if not one.excluded), key=lambda one: -one.limit))


def with_exclusions(
    verdict: Verdict,
    reasons: tuple[str, ...],
    found: tuple[Exclusion, ...],
    unexcluded: Literal["inconclusive", "note"],
    remedy: str,
    lacking: str = "",
) -> tuple[Verdict, tuple[str, ...]]:
    """Verdict and reasons of a part whose named defects have limits: a PASS that could not have failed is none.

    Args:
        verdict: by all other criteria.
        reasons: of it.
        found: limits of the named defects; none where they are not known.
        unexcluded: of the recipe.
        remedy: cheapest way to smaller limits.
        lacking: reason why there are no limits.
    """
    if verdict is not Verdict.PASS:
        return verdict, reasons
    left = open_defects(found)
    if unexcluded == "inconclusive" and (left or not found):
        return Verdict.INCONCLUSIVE, (open_text(found, remedy) if left else lacking, *reasons)
    if found and not left:
        return verdict, (*reasons, excluded_text(found))
    return verdict, reasons


def excluded_text(found: tuple[Exclusion, ...]) -> str:
    """The sizes beyond which defects are excluded, in a line; empty where none is."""
    closed = [one.defect.of_size(one.limit) for one in found if one.excluded]
    return f"excluded with 95% confidence: {', '.join(closed)}" if closed else ""


def open_sizes(found: tuple[Exclusion, ...]) -> str:
    """The defects that are not excluded, with the largest sizes that are possible."""
    several = []
    for one in open_defects(found):
        largest = f"up to {one.limit_text}" if np.isfinite(one.limit) else one.limit_text
        place = f" at {one.where}" if one.where else ""
        several.append(f"{one.defect.name} ({largest}{place})")
    return ", ".join(several)


def open_text(found: tuple[Exclusion, ...], remedy: str) -> str:
    """The defects that are not excluded, and the cheapest remedy.

    Args:
        found: limits of the named defects, one of them open.
        remedy: what makes the limits smaller.
    """
    return f"not excluded: {open_sizes(found)}: {remedy}, or state larger sizes in [defects]"
