"""Defects that a part excludes: one-sided 95 % limits of their sizes (ISO 14253-1 on the state of the part).

A part that does not deviate need not be good: the poses may be blind to a defect. Each named defect c, at x times its
smallest interesting size, is therefore tried against what was measured. Against the prediction, with the tail τ of the
lobe and the uncertain inputs z free within what is known of them,

    T_c(x) = min over τ, z of ((τ − τ₀)/u)² + |z|² + (y − f(τ, z) − x s_c(τ))ᵀV⁻¹(y − f(τ, z) − x s_c(τ)),

y being ln L of all poses over the predicted one, with the absolute scale as one more uncertain input. Against good
parts, y is the distance from their mean, the scatter between parts is V, and x has a normal likelihood with each lobe.
The limit is the largest x at which T_c exceeds its minimum by no more than 1.645² (a likelihood ratio, one side 5 %):
what lies beyond it is excluded. Where it is at most 1 a defect of the smallest interesting size would have shown.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.significance import log_basis
from anisoscope.decision.consistency import nearest_lobe, own_components, regular, scatter_of
from anisoscope.decision.predictive import assumed_size
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.prediction.expectation import Component, Expectation, part_uncertainty
from anisoscope.prediction.part_scatter import NamedDefect, PartScatter, named_defects
from anisoscope.prediction.profile_likelihood import nearest_states
from anisoscope.recipe.surface import SurfaceRecipe

ONE_SIDED = 1.6448536269514722
"""95 % of the standard normal distribution."""
_EXTENTS = np.array([0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0])
"""Extents that are tried, in smallest interesting sizes; beyond the last one no limit is stated."""

DOUBT = 0.1
"""Relative standard uncertainty of the change of ln L by a defect: it depends on the state of the other inputs."""
_KNOWN = 4.0  # standard uncertainties of an input up to which the response to second order serves
_ROUNDS, _CLOSE = 2, 1e-4  # a limit needs T_c to .01 only


@dataclass(frozen=True)
class Exclusion:
    """Largest size of a named defect that a part may have.

    Attributes:
        defect: with its smallest interesting size.
        best: likeliest size as a multiple of that, at least 0.
        limit: largest size that is not excluded, likewise; infinite where none of those tried is.
    """

    defect: NamedDefect
    best: float
    limit: float

    @property
    def excluded(self) -> bool:
        """Whether the defect at its smallest interesting size is excluded."""
        return self.limit <= 1.0

    @property
    def limit_text(self) -> str:
        """The largest size that is not excluded, with its unit."""
        return self.defect.text(self.limit).strip() if np.isfinite(self.limit) else "any size"


def excluded_by_prediction(
    expected: Expectation,
    radiance: FloatArray,
    errors: tuple[Component, ...],
    parts: PartScatter,
    recipe: SurfaceRecipe,
) -> tuple[Exclusion, ...]:
    """Limits of the named defects against the prediction; none where ln L has no response, or nothing is uncertain.

    Args:
        expected: the prediction.
        radiance: (P,) of the part, 1/sr.
        errors: of the measurement.
        parts: changes of ln L by the named defects.
        recipe: with the smallest interesting sizes and the uncertainty of the absolute radiance.
    """
    if expected.response is None or not parts.changes:
        return ()
    y = np.log(radiance / expected.radiance)
    own = np.full((len(y), len(y)), recipe.uncertainty.scale_share**2)
    for one in own_components(expected, errors):
        own = own + one.covariance()
    if not regular(own):
        return ()
    sources = (expected.response if expected.lobes is None else expected.lobes.responses[0]).sources
    states = _states(recipe, sources)
    changes = np.array([change * (name not in states) for name, change in parts.changes.items()])
    shifts = np.array([states.get(name, np.zeros(len(sources))) for name in parts.changes])
    tried = (_EXTENTS[:, None, None] * changes[:, None]).reshape(-1, *changes.shape[1:])
    middle = (_EXTENTS[:, None] * shifts[:, None]).reshape(-1, len(sources))
    off = np.tile(y, (len(tried), 1))
    doubted = DOUBT * _EXTENTS[:, None] * np.mean(list(parts.changes.values()), axis=1)[:, None]
    metric = own + np.einsum("np,pq->npq", doubted.reshape(-1, len(y)) ** 2, np.eye(len(y)))
    if expected.lobes is not None:
        found = nearest_lobe(
            expected.lobes, off, metric, tried, parts.tails, middle, rounds=_ROUNDS, settled=_CLOSE
        )
    else:
        found, _ = nearest_states(expected.response, off - tried.mean(axis=1), metric, middle, middle=middle)
    curves = found.reshape(len(changes), len(_EXTENTS))
    named = {one.name: one for one in named_defects(recipe)}
    return tuple(_of_curve(named[name], curve) for name, curve in zip(parts.changes, curves, strict=True))


def _states(recipe: SurfaceRecipe, sources: Sequence[str]) -> dict[str, FloatArray]:
    """(K,) state of the inputs with each defect that is the state of one within its known range, by name.

    The response to second order then holds for the part with the defect as for a good one.
    """
    u = part_uncertainty(recipe).alpha_share
    extent = recipe.defects.roughness_share / u if u > 0.0 else np.inf
    named = (("roughness along the ridges", 3), ("roughness across the ridges", 4))
    defects = named_defects(recipe)
    return {
        defects[place].name: extent * (np.array(sources) == source)
        for source, place in named
        if source in sources and extent <= _KNOWN
    }


@dataclass(frozen=True)
class PlannedLimit:
    """Largest size of a defect that is not excluded of a part exactly as designed.

    Attributes:
        defect: with its smallest interesting size.
        best: the size with its unit, with the lobe that shows it best.
        worst: with the lobe that shows it worst.
        excluded: whether the smallest interesting size is excluded with every lobe.
    """

    defect: str
    best: str
    worst: str
    excluded: bool


def planned_limits(
    expected: Expectation, parts: PartScatter, recipe: SurfaceRecipe, share: float
) -> tuple[PlannedLimit, ...]:
    """Sizes that the poses of a recipe exclude, without golden parts: of parts as designed with every likely lobe.

    Args:
        expected: the prediction.
        parts: changes of ln L by the named defects.
        recipe: with the smallest interesting sizes.
        share: relative standard uncertainty of a pose by camera and lamp.
    """
    count = len(expected.poses)
    errors = (Component("camera and lamp", "measurement", np.full(count, share), shared=False),)
    lobes = expected.lobes
    tried = [expected.radiance]
    if lobes is not None:
        within = np.clip(parts.tails, lobes.tails[0], lobes.tails[-1])
        tried = [expected.radiance * np.exp(lobes.at(float(tail))[0]) for tail in within]
    found = [excluded_by_prediction(expected, radiance, errors, parts, recipe) for radiance in tried]
    planned = []
    for each in zip(*found, strict=True):
        best, worst = (min(each, key=_limit), max(each, key=_limit))
        planned.append(
            PlannedLimit(worst.defect.name, best.limit_text, worst.limit_text, excluded=worst.excluded)
        )
    return tuple(planned)


def _limit(one: Exclusion) -> float:
    return one.limit


def _of_curve(defect: NamedDefect, curve: FloatArray) -> Exclusion:
    """Limit from −2 ln of the profile likelihood at `_EXTENTS`, a cubic spline between them."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - start-up time

    fine = np.linspace(_EXTENTS[0], _EXTENTS[-1], 1001)
    values = CubicSpline(_EXTENTS, curve)(fine)
    best = int(np.argmin(values))
    within = np.flatnonzero(values <= values[best] + ONE_SIDED**2)
    last = int(within[-1])
    limit = float("inf") if last == len(fine) - 1 else float(fine[last])
    return Exclusion(defect, float(fine[best]), limit)


def excluded_by_parts(
    parts: PartScatter,
    measured: Measured,
    recipe: SurfaceRecipe,
    golden: FloatArray,
    size: float,
    batches: int | None = None,
) -> tuple[Exclusion, ...]:
    """Limits of the named defects against good parts: the largest of all lobes that are as likely.

    Args:
        parts: scatter and changes of ln L by the named defects.
        measured: the part.
        recipe: with the smallest interesting sizes.
        golden: (n, P − 1) contrasts of the good parts in the basis of `log_basis`.
        size: variance of good parts over the stated one, as of `predictive.size_of`.
        batches: number of lots or days of the good parts; None: they are independent.
    """
    scatter = scatter_of(parts, measured)
    basis = log_basis(len(measured.radiance))
    d = basis @ np.log(measured.radiance) - golden.mean(axis=0)
    count = min(batches or len(golden), len(golden))
    taken = float(assumed_size(size, len(d), len(golden), 0.05)) * (1.0 + 1.0 / count)
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in parts.changes}
    for turn, lobe in enumerate(scatter.lobes):
        tangent = lobe.slope * scatter.own
        weight = np.linalg.inv((tangent @ tangent.T + scatter.errors) * taken)
        for name, change in parts.changes.items():
            s = basis @ change[turn]
            information = float(s @ weight @ s)
            found[name].append((float(s @ weight @ d) / information, 1.0 / float(np.sqrt(information))))
    named = {one.name: one for one in named_defects(recipe)}
    return tuple(_of_lobes(named[name], each) for name, each in found.items())


def _of_lobes(defect: NamedDefect, each: list[tuple[float, float]]) -> Exclusion:
    best, u = max(each, key=lambda one: one[0] + ONE_SIDED * one[1])
    return Exclusion(defect, max(best, 0.0), max(best, 0.0) + ONE_SIDED * u)


def open_defects(found: tuple[Exclusion, ...]) -> tuple[Exclusion, ...]:
    """Those that are not excluded, the least excluded first."""
    return tuple(sorted((one for one in found if not one.excluded), key=lambda one: -one.limit))


def excluded_text(found: tuple[Exclusion, ...]) -> str:
    """The sizes beyond which defects are excluded, in a line; empty where none is."""
    closed = [one.defect.of_size(one.limit) for one in found if one.excluded]
    return f"excluded: more than {', '.join(closed)}" if closed else ""


def open_text(found: tuple[Exclusion, ...], golden: int) -> str:
    """The defects that are not excluded, with the largest sizes that are possible, and the cheapest remedy.

    Args:
        found: limits of the named defects, one of them open.
        golden: number of good parts that the part was compared with.
    """
    several = []
    for one in open_defects(found):
        largest = f"up to {one.limit_text}" if np.isfinite(one.limit) else one.limit_text
        several.append(f"{one.defect.name} ({largest})")
    remedy = "add golden parts of several lots" if golden else "add three golden parts"
    return (
        f"not excluded: {', '.join(several)}: {remedy} (anisoscope golden add), photograph more poses (anisoscope "
        "recipe suggest), or state larger sizes in [defects]"
    )
