"""Consistency test of a part with the prediction or the golden parts: squared distance, degrees of freedom, p value.

Both account for the nonlinear response of ln L to the inputs shared by all poses (`response`, or `states` of the model
itself): the distance from the prediction is that from the nearest state of the inputs, and the distribution of T² of
good parts is simulated by drawing golden sets and parts from the stated uncertainties instead of from a normal
distribution.
"""

from collections.abc import Hashable
from functools import lru_cache
from typing import cast

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import root
from anisoscope.base.significance import chi2_tail, like_sample, log_basis, mahalanobis
from anisoscope.decision.predictive import PredictiveTest, Scatter, predictive_test
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.prediction.expectation import Component, Expectation
from anisoscope.prediction.lobe_doubt import LobeDoubt, weights_between
from anisoscope.prediction.part_scatter import PartScatter
from anisoscope.prediction.profile_likelihood import (
    SETTLED,
    States,
    nearest,
    nearest_anywhere,
    nearest_states,
)
from anisoscope.prediction.propagation import TAIL

_SINGULAR = 1e-9
_RIGS, _OF_A_RIG, _SEED = 16, 64, 11  # simulated good parts of models that are evaluated themselves
_TAILS = 9  # of the lobe that are looked at together
_TOGETHER = 200  # parts
_NARROWED = 4  # times that their range becomes that between the neighbours of the best: to a 1/256 of it
OF_THE_RIG = ("stray light", "linearity of the camera")
"""Sources of the measurement that all inspections on one rig share."""


def from_prediction(expected: Expectation, measured: Measured) -> tuple[float, int, float]:
    """D² of all contrasts, its degrees of freedom, and its p value for a part as predicted.

    Raises:
        MeasurementError: no uncertainty is stated, so that no distance is defined.
    """
    basis = log_basis(len(expected.poses))
    off = basis @ np.log(measured.radiance / expected.radiance)
    if expected.states is not None:
        own = contrast_covariance(expected.outside_states + measured.components, basis)
        if regular(own):
            d2, _ = nearest_anywhere(expected.states, basis, off, own)
            return d2, len(basis), float(chi2_tail(d2, len(basis)))
    alone = own_covariance(expected, measured)
    if (expected.lobes is not None or expected.response is not None) and regular(alone):
        d2 = float(distances(expected, off[None], alone[None])[0])
        return d2, len(basis), float(chi2_tail(d2, len(basis)))
    d2, dof = mahalanobis(off, contrast_covariance(expected.components + measured.components, basis))
    return d2, dof, float(chi2_tail(d2, dof))


def distances(expected: Expectation, deviation: FloatArray, covariance: FloatArray) -> FloatArray:
    """(N,) squared distances D² of parts from a prediction whose response or lobes are known.

    Args:
        expected: the prediction.
        deviation: (N, m) contrasts of the parts less the predicted ones, in the basis of `log_basis`.
        covariance: (N, m, m) of the errors not covered by the response or the lobes, of full rank.
    """
    basis = log_basis(len(expected.poses))
    if expected.lobes is not None:
        return nearest_lobe(expected.lobes.within(basis), deviation, covariance)
    assert expected.response is not None
    return nearest(expected.response.within(basis), deviation, covariance)


def nearest_lobe(
    lobes: LobeDoubt,
    deviation: FloatArray,
    covariance: FloatArray,
    changes: FloatArray | None = None,
    tails: FloatArray | None = None,
    middle: FloatArray | None = None,
    rounds: int = _NARROWED,
    settled: float = SETTLED,
) -> FloatArray:
    """(N,) squared distances of parts from the nearest tail of the lobe and state of the other inputs.

    min over τ and z of ((τ − τ₀)/u)² + |z|² + (d − f(τ, z))ᵀV⁻¹(d − f(τ, z)), τ within its range. Where every tail of
    the range is as likely, the first term is nil: χ² with m degrees of freedom then states the distance of good parts
    from above.

    Args:
        lobes: ln ratios over the tail.
        deviation: (N, m) from the prediction.
        covariance: (N, m, m) of the independent errors, of full rank.
        changes: (N, L, m) change of each part that is known beforehand, at L tails; None: of none.
        tails: (L,) those tails.
        middle: (N, K) states near which the other inputs are; None: the nominal one.
        rounds: times that the range of tails is narrowed.
        settled: relative change of the distance below which its search ends.
    """
    known = np.zeros((len(deviation), 1, deviation.shape[1])) if changes is None else changes
    nodes = np.zeros(1) if tails is None else tails
    centre = np.zeros((len(deviation), len(lobes.responses[0].sources))) if middle is None else middle
    blocks = [slice(first, first + _TOGETHER) for first in range(0, len(deviation), _TOGETHER)]
    found = [
        _nearest_lobe(lobes, deviation[one], covariance[one], known[one], nodes, centre[one], rounds, settled)
        for one in blocks
    ]
    return np.concatenate([np.zeros(0), *found])


def _nearest_lobe(
    lobes: LobeDoubt,
    deviation: FloatArray,
    covariance: FloatArray,
    changes: FloatArray,
    nodes: FloatArray,
    centre: FloatArray,
    rounds: int,
    settled: float,
) -> FloatArray:
    """The same of a few parts, each with `_TAILS` tails at a time."""
    parts, k = len(deviation), len(lobes.responses[0].sources)
    low, high = (np.full(parts, float(end)) for end in (lobes.tails[0], lobes.tails[-1]))
    off, metric = (np.repeat(one, _TAILS, axis=0) for one in (deviation, covariance))
    middle, each = np.repeat(centre, _TAILS, axis=0), np.arange(parts)
    start = middle
    least = np.full(parts, np.inf)
    for _ in range(rounds):
        tails = np.linspace(low, high, _TAILS, axis=1)
        shifts, responses = lobes.along(tails.ravel())
        weights = weights_between(nodes, tails.ravel()).reshape(*tails.shape, -1)
        known = np.einsum("ntl,nlm->ntm", weights, changes).reshape(shifts.shape)
        rest, states = nearest_states(
            responses, off - shifts - known, metric, start, settled=settled, middle=middle
        )
        found = rest.reshape(tails.shape) + lobes.penalty(tails)
        best = np.argmin(found, axis=1)
        least = np.minimum(least, found[each, best])
        low, high = (tails[each, np.clip(best + step, 0, _TAILS - 1)] for step in (-1, 1))
        start = np.repeat(states.reshape(parts, _TAILS, k)[each, best], _TAILS, axis=0)
    return least


def scatter_of(parts: PartScatter, measured: Measured) -> Scatter:
    """Scatter of the contrasts of good parts on one rig, with the errors of this inspection.

    Errors of the rig that all its inspections share cancel against golden parts, and are left out.
    """
    single = tuple(one for one in measured.components if one.source not in OF_THE_RIG)
    return _contrast_scatter(parts, np.asarray(sum(one.covariance() for one in single)).tobytes())


def contrast_scatter(parts: PartScatter, share: float) -> Scatter:
    """The same with errors of camera and lamp alone: ``share`` of every pose, independent."""
    return _contrast_scatter(parts, (share**2 * np.eye(len(parts.response.slope))).tobytes())


@lru_cache(maxsize=16)
def _contrast_scatter(parts: PartScatter, errors: bytes) -> Scatter:
    """Scatter by the (P, P) covariance of the errors of one inspection: what is drawn of it is drawn once."""
    basis, own = log_basis(len(parts.response.slope)), np.frombuffer(errors)
    return Scatter(
        parts.response.within(basis),
        parts.common,
        parts.own,
        basis @ own.reshape(basis.shape[1], -1) @ basis.T,
        {name: basis @ change for name, change in parts.defects.items()},
        tuple(one.within(basis) for one in parts.lobes),
        parts.states,
        parts.prior_parts,
    )


def golden_test(
    scatter: Scatter | None,
    expected: Expectation,
    measured: Measured,
    golden: FloatArray,
    alpha: float,
    batches: int | None = None,
    varies: tuple[str, ...] = (),
) -> tuple[float, int, float, PredictiveTest | None]:
    """T² from the mean of golden parts, the number of contrasts, the p value, and the predictive test behind it.

    Where no scatter between parts is stated, its form is that of the budget (`base.significance.like_sample`), and
    good parts are drawn from the states of the model where it has them.

    Args:
        scatter: stated scatter of good parts, or None.
        varies: beginnings of the names of sources that differ from part to part, where no scatter is stated; none for
            all.
        expected: the prediction.
        measured: the part.
        golden: (n, P − 1) contrasts of the golden parts in the basis of `log_basis`.
        alpha: level of significance.
        batches: number of lots or days of the golden parts; None: they are independent.

    Raises:
        MeasurementError: too few golden parts for the test, or nothing is stated as uncertain.
    """
    basis = log_basis(len(expected.poses))
    value = basis @ np.log(measured.radiance)
    if scatter is None:
        single, stated = of_one_part(expected, measured.components, varies)
        alike = None
        if expected.states is not None:
            rng, errors = np.random.default_rng(_SEED), root(contrast_covariance(single, basis))
            good = _good_parts(cast("Hashable", expected.states), varies) @ basis.T
            alike = good + rng.standard_normal(good.shape) @ errors
        t2, p_value = like_sample(value, golden, stated, alike)
        return t2, len(basis), p_value, None
    found = predictive_test(scatter, golden, value, alpha, batches)
    return found.t2, found.dof, found.p_value, found


def of_one_part(
    expected: Expectation, measured: tuple[Component, ...], varies: tuple[str, ...]
) -> tuple[tuple[Component, ...], FloatArray]:
    """Sources that the rig's other inspections do not share, and the (P − 1, P − 1) form in which parts scatter.

    Args:
        expected: the prediction.
        measured: sources of the measurement.
        varies: as of `golden_test`.
    """
    single = tuple(one for one in measured if one.source not in OF_THE_RIG)
    own = tuple(one for one in expected.components if not varies or one.source.startswith(varies))
    return single, contrast_covariance(own + single, log_basis(len(expected.poses)))


@lru_cache(maxsize=4)
def _good_parts(known: Hashable, varies: tuple[str, ...]) -> FloatArray:
    """(G, N, P) change of ln L of good parts: on one of G rigs they share all but the sources that vary."""
    states = cast("States", known)
    drawn = np.random.default_rng(_SEED).standard_normal((_RIGS, _OF_A_RIG, len(states.sources)))
    shared = np.array([bool(varies) and not source.startswith(varies) for source in states.sources])
    drawn[..., shared] = drawn[:, :1, shared]
    return states.change(drawn)


def own_covariance(expected: Expectation, measured: Measured) -> FloatArray:
    """(P − 1, P − 1) covariance of the contrasts from the components not covered by the response or the lobes."""
    return contrast_covariance(own_components(expected, measured.components), log_basis(len(expected.poses)))


def own_components(expected: Expectation, errors: tuple[Component, ...]) -> tuple[Component, ...]:
    """Components of the prediction that response and lobes do not cover, and the errors of the measurement."""
    alone = tuple(one for one in expected.alone if expected.lobes is None or one.source != TAIL)
    return alone + errors


def contrast_covariance(components: tuple[Component, ...], basis: FloatArray) -> FloatArray:
    """(m, m) covariance of combinations (m, P) of ln L by components."""
    total = np.zeros((basis.shape[1], basis.shape[1]))
    for component in components:
        total += component.covariance()
    return np.asarray(basis @ total @ basis.T)


def regular(covariance: FloatArray) -> bool:
    """Whether no combination of the values is without uncertainty."""
    values = np.linalg.eigvalsh(covariance)
    return bool(values[0] > _SINGULAR * values[-1])
