"""Limits of the named defects of surfaces (`exclusion`): against the prediction, and against good parts.

Against the prediction, with the tail τ of the lobe and the uncertain inputs z free within what is known of them,

    T_c(x) = min over τ, z of ((τ − τ₀)/u)² + |z|² + (y − f(τ, z) − x s_c(τ))ᵀV⁻¹(y − f(τ, z) − x s_c(τ)),

y being ln L of all poses over the predicted one, with the absolute scale as one more uncertain input. Against good
parts, y is the distance from their mean, the scatter between parts is V, and x has a normal likelihood with each lobe.
Of a model that is evaluated itself the contrasts alone count: reflectances of mirrors have no stated uncertainty.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.significance import log_basis
from anisoscope.decision.consistency import (
    contrast_covariance,
    from_prediction,
    nearest_lobe,
    own_components,
    regular,
    scatter_of,
)
from anisoscope.decision.exclusion import (
    EXTENTS,
    MORE_POSES,
    MORE_TILTS,
    ONE_SIDED,
    Exclusion,
    PlannedLimit,
    excluded_by_model,
    of_curve,
    of_normal,
    planned,
)
from anisoscope.decision.lot_reference import LEAST_PARTS as LEAST_OF_LOT
from anisoscope.decision.predictive import PredictiveTest, Scatter, assumed_size
from anisoscope.decision.reference_parts import GoldenSet
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.prediction.expectation import Component, Expectation, part_uncertainty
from anisoscope.prediction.part_scatter import PartScatter, named_defects
from anisoscope.prediction.profile_likelihood import Combined, DefectCurves, nearest_states
from anisoscope.prediction.second_order import Response
from anisoscope.recipe.named_defect import NamedDefect
from anisoscope.recipe.surface import SurfaceRecipe

DOUBT = 0.1
"""Relative standard uncertainty of the change of ln L by a defect: it depends on the state of the other inputs."""
CONTRADICTED = 0.05
"""p value of a part against the prediction below which golden parts alone say what is excluded."""
_FOUR_OF_FIVE = 0.8416212335729143  # 80 % of the standard normal distribution
_KNOWN = 4.0  # standard uncertainties of an input up to which the response to second order serves
_ROUNDS, _CLOSE = 2, 1e-4  # a limit needs T_c to .01 only


def excluded_of(
    expected: Expectation,
    measured: Measured,
    recipe: SurfaceRecipe,
    golden: GoldenSet | None,
    parts: PartScatter | None,
    predictive: PredictiveTest | None,
) -> tuple[tuple[Exclusion, ...], tuple[Exclusion, ...]]:
    """Limits of the named defects, and those by the prediction alone.

    Each is by the reference that shows it best, which does not depend on the part.

    Args:
        expected: the prediction.
        measured: the part.
        recipe: with the smallest interesting sizes.
        golden: good parts that the part is compared with, or None.
        parts: scatter between good parts and changes by the defects; None where only the model itself has states.
        predictive: the test against the golden parts by the stated scatter, or None.
    """
    errors = measured.components
    if expected.states is not None:
        held = golden is None or from_prediction(expected, measured)[2] >= CONTRADICTED
        by_states = excluded_by_states(expected, measured.radiance, errors) if held else ()
        return by_states, by_states
    if parts is None:
        return (), ()
    by_prediction = excluded_by_prediction(expected, measured.radiance, errors, parts, recipe)
    if golden is None or predictive is None:
        return by_prediction, by_prediction
    by_parts = excluded_by_parts(parts, measured, recipe, golden.contrasts(), predictive.size, golden.batches)
    if not by_prediction or from_prediction(expected, measured)[2] < CONTRADICTED:
        return by_parts, by_prediction
    nominal = excluded_by_prediction(expected, expected.radiance, errors, parts, recipe)
    best = tuple(
        of_parts if of_parts.limit - of_parts.best <= planned.limit else of_prediction
        for of_parts, of_prediction, planned in zip(by_parts, by_prediction, nominal, strict=True)
    )
    return best, by_prediction


def remedy_text(
    expected: Expectation, reference: GoldenSet | None, needed: int | None, *, of_lot: bool, compares: bool
) -> str:
    """The cheapest way to smaller limits: of a model that is evaluated itself good parts are none.

    Args:
        expected: the prediction.
        reference: parts that the part was compared with.
        needed: number of good parts that exclude the open defects (`parts_needed`).
        of_lot: the part is compared with its lot, or will be.
        compares: it would be if its lot were named.
    """
    if expected.states is not None:
        return MORE_TILTS
    present = 0 if reference is None else reference.batches
    if needed is None or needed <= present:
        return f"good parts do not show all of them, {MORE_POSES}"
    more, part = needed - present, max(needed + 1, LEAST_OF_LOT)
    parts = "1 golden part" if more == 1 else f"{more} golden parts"
    added = f"add {parts} (anisoscope golden add), {MORE_POSES}"
    if of_lot:
        return f"inspect the lot up to part {part}, {added}"
    if present:
        return f"add {parts} of other lots (anisoscope golden add), {MORE_POSES}"
    if compares:
        return f"name the lot (--lot), whose parts show them from part {part} on, {added}"
    return added


def lacking_text(expected: Expectation, golden: GoldenSet | None, *, deviates: bool) -> str:
    """Reason why no defect has a limit."""
    if deviates:
        return "no defect is excluded, because the part deviates within its tolerance"
    if expected.states is not None and golden is not None:
        return "no defect is excluded, because the part is like the golden parts, but not as predicted"
    return (
        "no defect is excluded: this surface or recipe has no response to them; state decision.unexcluded = "
        '"note"'
    )


def excluded_by_states(
    expected: Expectation, radiance: FloatArray, errors: tuple[Component, ...]
) -> tuple[Exclusion, ...]:
    """Limits of the named defects by a model that is evaluated itself; none where nothing else is uncertain.

    Args:
        expected: the prediction, with its states.
        radiance: (P,) of the part, 1/sr.
        errors: of the measurement.
    """
    assert expected.states is not None
    basis = log_basis(len(radiance))
    own = contrast_covariance(expected.outside_states + errors, basis)
    if not regular(own):
        return ()
    contrasts = _Contrasts(expected.states, basis)
    return excluded_by_model(contrasts, basis @ np.log(radiance / expected.radiance), own)


@dataclass(frozen=True, eq=False)
class _Contrasts:
    """Curves of the contrasts of parts with defects."""

    states: DefectCurves
    basis: FloatArray

    @property
    def defects(self) -> tuple[NamedDefect, ...]:
        return self.states.defects

    def with_defect(self, defect: NamedDefect, extent: float) -> Combined:
        return Combined(self.states.with_defect(defect, extent), self.basis)


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
    # a lobe without a tail stands for those with less than none as well
    tails, first = np.unique(parts.tails, return_index=True)
    changes = np.array([change[first] * (name not in states) for name, change in parts.changes.items()])
    shifts = np.array([states.get(name, np.zeros(len(sources))) for name in parts.changes])
    tried = (EXTENTS[:, None, None] * changes[:, None]).reshape(-1, *changes.shape[1:])
    middle = (EXTENTS[:, None] * shifts[:, None]).reshape(-1, len(sources))
    off = np.tile(y, (len(tried), 1))
    doubted = DOUBT * EXTENTS[:, None] * np.mean(list(parts.changes.values()), axis=1)[:, None]
    metric = own + np.einsum("np,pq->npq", doubted.reshape(-1, len(y)) ** 2, np.eye(len(y)))
    if expected.lobes is not None:
        found = nearest_lobe(
            expected.lobes, off, metric, tried, tails, middle, rounds=_ROUNDS, settled=_CLOSE
        )
    else:
        found, _ = nearest_states(expected.response, off - tried.mean(axis=1), metric, middle, middle=middle)
    curves = found.reshape(len(changes), len(EXTENTS))
    named = {one.name: one for one in named_defects(recipe)}
    return tuple(of_curve(named[name], curve) for name, curve in zip(parts.changes, curves, strict=True))


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


def planned_limits(
    expected: Expectation, parts: PartScatter | None, recipe: SurfaceRecipe, share: float
) -> tuple[PlannedLimit, ...]:
    """Sizes that the poses of a recipe exclude, without golden parts: of parts as designed with every likely lobe.

    Args:
        expected: the prediction.
        parts: changes of ln L by the named defects; None where only the model itself has states.
        recipe: with the smallest interesting sizes.
        share: relative standard uncertainty of a pose by camera and lamp.
    """
    count = len(expected.poses)
    errors = (Component("camera and lamp", "measurement", np.full(count, share), shared=False),)
    if expected.states is not None:
        return planned([excluded_by_states(expected, expected.radiance, errors)])
    if parts is None:
        return ()
    lobes = expected.lobes
    tried = [expected.radiance]
    if lobes is not None:
        within = np.clip(parts.tails, lobes.tails[0], lobes.tails[-1])
        tried = [expected.radiance * np.exp(lobes.at(float(tail))[0]) for tail in within]
    found = [excluded_by_prediction(expected, radiance, errors, parts, recipe) for radiance in tried]
    return planned(found)


def excluded_by_parts(
    parts: PartScatter,
    measured: Measured,
    recipe: SurfaceRecipe,
    golden: FloatArray,
    size: float,
    batches: int | None = None,
) -> tuple[Exclusion, ...]:
    """Limits of the named defects against good parts: the largest of all lobes that are as likely.

    A part with a defect that is a state of one input scatters as the response bends there, not as good parts do.

    Args:
        parts: scatter and changes of ln L by the named defects.
        measured: the part.
        recipe: with the smallest interesting sizes.
        golden: (n, P − 1) contrasts of the good parts in the basis of `log_basis`.
        size: variance of good parts over the stated one, as of `predictive.size_of`.
        batches: number of lots or days of the good parts; None: they are independent.
    """
    d = log_basis(len(measured.radiance)) @ np.log(measured.radiance) - golden.mean(axis=0)
    count = min(batches or len(golden), len(golden))
    taken = float(assumed_size(size, len(d), len(golden), 0.05, count))
    return _by_parts(parts, scatter_of(parts, measured), recipe, d, taken, count)


PLANNED = (1, 2, 3, 5, 10, 25)
"""Numbers of good parts that a remedy names."""


def parts_needed(
    names: Collection[str], scatter: Scatter | None, parts: PartScatter | None, recipe: SurfaceRecipe
) -> int | None:
    """Smallest number of good parts, of `PLANNED`, that exclude the open defects in four of five parts like them.

    Args:
        names: of the open defects.
        scatter: of good parts; None where none is stated.
        parts: with the changes of ln L by the named defects, likewise.
        recipe: with the smallest interesting sizes.

    Returns:
        The number; None where none of them does, or nothing is open.
    """
    if parts is None or scatter is None or not names:
        return None
    at_mean = np.zeros(len(scatter.errors))
    for count in PLANNED:
        each = _by_parts(parts, scatter, recipe, at_mean, 1.0, count)
        limits = [one.limit for one in each if one.defect.name in names]
        if max(limits) * (1.0 + _FOUR_OF_FIVE / ONE_SIDED) <= 1.0:
            return count
    return None


def _by_parts(
    parts: PartScatter, scatter: Scatter, recipe: SurfaceRecipe, d: FloatArray, size: float, count: int
) -> tuple[Exclusion, ...]:
    """Limits of a part whose (P − 1,) contrasts are ``d`` off the mean of ``count`` good ones.

    Good parts have ``size`` times the variance that is stated.
    """
    basis = log_basis(len(d) + 1)
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in parts.changes}
    for turn, lobe in enumerate(scatter.lobes):
        good, rest = lobe.slope * scatter.own, _bending(lobe, scatter.own) + scatter.errors
        of_mean = (good @ good.T + rest) / count
        for name, change in parts.changes.items():
            source, extent = parts.states.get(name, ("", 0.0))
            bent = lobe.tangent(extent * (np.array(lobe.sources) == source)) * scatter.own
            doubted = (basis * (DOUBT * change.mean(axis=0)) ** 2) @ basis.T
            weight = np.linalg.inv((bent @ bent.T + rest + of_mean) * size + doubted)
            s = basis @ change[turn]
            information = float(s @ weight @ s)
            found[name].append((float(s @ weight @ d) / information, 1.0 / float(np.sqrt(information))))
    named = {one.name: one for one in named_defects(recipe)}
    return tuple(
        of_normal(named[name], *max(each, key=lambda one: one[0] + ONE_SIDED * one[1]))
        for name, each in found.items()
    )


def _bending(lobe: Response, own: FloatArray) -> FloatArray:
    """(m, m) covariance of the contrasts by the second order of the response to normal inputs of (K,) scatter."""
    bend = lobe.bend * own[:, None] * own
    return np.asarray(0.5 * np.einsum("ikl,jkl->ij", bend, bend))
