"""ln L over the tail of the lobe where it is uncertain: from no tail on, along a curve.

The tail of an unmeasured lobe lies anywhere between Beckmann's (0) and GGX (1), which changes ln L by tenths,
more than any other input, and not in proportion. The response to the other inputs is therefore known at several tails,
and interpolated between them in τ/(1 + τ), where ln L of ridges is a cubic within .003.

A calibrated tail is correlated with the roughness and the albedo. The curve is then that of the material whose other
parameters follow their regression on the tail, and what the covariance leaves at a given tail is independent of it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.parameters.material import LONGEST_TAIL, Material
from anisoscope.prediction.second_order import Response, RowResponses, response_of
from anisoscope.prediction.sensitivity import DARK, State, Surface, evaluate

UNKNOWN_TAILS = (0.0, 1.0)
"""Shortest and longest tail of a plastic with an unmeasured lobe: Beckmann's and GGX."""
LIKELY_TAILS = (0.0, 0.5, 1.0)
"""Tails over which the scatter of such parts is averaged."""
_PLACES = np.array([0.0, 0.25, 0.5, 1.0])  # of the known tails, as shares of the range
_RANGE = 3.0  # standard uncertainties of a stated tail
_EVENLY = float(np.sqrt(1.5))  # three equally likely values at −1, 0, 1 times this have a variance of 1


@dataclass(frozen=True, eq=False)
class LobeDoubt:
    """ln L of P poses as a function of the tail of the lobe and of K other inputs.

    Attributes:
        tails: (T,) tails at which it is known, ascending.
        shifts: (T, P) change of ln L from the nominal tail.
        responses: T responses to the other inputs.
        nominal: tail of the prediction.
        u: its standard uncertainty; infinite where every tail between the first and the last is as likely.
    """

    tails: FloatArray
    shifts: FloatArray
    responses: tuple[Response, ...]
    nominal: float
    u: float

    @cached_property
    def _arrays(self) -> tuple[FloatArray, FloatArray]:
        """(T, P, K) slopes and (T, P, K, K) bends of the responses."""
        return np.array([one.slope for one in self.responses]), np.array([one.bend for one in self.responses])

    def along(self, tails: FloatArray) -> tuple[FloatArray, RowResponses]:
        """(N, P) change of ln L at N tails between the first and the last, and the responses there."""
        weights = weights_between(self.tails, tails)
        slopes, bends = (np.tensordot(weights, one, 1) for one in self._arrays)
        return np.asarray(weights @ self.shifts), RowResponses(self.responses[0].sources, slopes, bends)

    def at(self, tail: float) -> tuple[FloatArray, Response]:
        """(P,) change of ln L at a tail between the first and the last, and the response to the other inputs there."""
        shifts, responses = self.along(np.array([tail]))
        return shifts[0], responses.row(0)

    def penalty(self, tails: FloatArray) -> FloatArray:
        """(N,) squared distances of tails from the nominal one in standard uncertainties."""
        return np.asarray(((tails - self.nominal) / self.u) ** 2)

    def contribution(self, u: float) -> FloatArray:
        """(P,) change of ln L over ``u`` of the tail: half of that to either side, or that to the only side."""
        low, high = self.tails[0], self.tails[-1]
        below, above = max(self.nominal - u, low), min(self.nominal + u, high)
        return np.asarray(u * (self.at(above)[0] - self.at(below)[0]) / (above - below))

    def within(self, basis: FloatArray) -> "LobeDoubt":
        """The doubt of combinations (m, P) of ln L."""
        responses = tuple(one.within(basis) for one in self.responses)
        return replace(self, shifts=self.shifts @ basis.T, responses=responses)


def weights_between(known: FloatArray, tails: FloatArray) -> FloatArray:
    """(N, T) weights of values known at T tails for their values at N tails: Lagrange's polynomials in τ/(1 + τ)."""
    place, nodes = tails / (1.0 + tails), known / (1.0 + known)
    others = [np.delete(nodes, k) for k in range(len(nodes))]
    return np.column_stack(
        [
            np.prod((place[:, None] - rest) / (node - rest), axis=1)
            for node, rest in zip(nodes, others, strict=True)
        ]
    )


def likely_tails(nominal: float, u: float | None) -> tuple[float, ...]:
    """Equally likely tails that stand for the doubt of a lobe; one where there is none.

    Args:
        nominal: tail of the prediction.
        u: its standard uncertainty; None where it is unmeasured.
    """
    if u is None:
        return LIKELY_TAILS
    if u == 0.0:
        return (nominal,)
    return tuple(float(np.clip(nominal + u * z, 0.0, LONGEST_TAIL)) for z in (-_EVENLY, 0.0, _EVENLY))


def lobe_doubt(
    surface: Surface,
    nominal: State,
    poses: tuple[Pose, ...],
    convention: Convention,
    inputs: InputUncertainty,
    straight: Mapping[str, FloatArray],
    u: float | None,
    common: Response | None = None,
    along: Callable[[float], Material] | None = None,
) -> LobeDoubt:
    """Ln L over the tails that a recipe leaves possible.

    Args:
        surface: predictor of a shape for any lobe.
        nominal: the state in which the prediction is made.
        poses: P poses.
        convention: how the angles are counted.
        inputs: standard uncertainties of the other inputs.
        straight: (P,) change of ln L per u of every other uncertain input.
        u: standard uncertainty of the tail, above 0; None where it is unmeasured.
        common: response that holds at every tail; None: it is determined at each.
        along: the material at a tail; None: that of ``nominal`` with another tail.

    Raises:
        ModelError: a pose so close to the horizon that a probe leads below it.
    """
    tail = nominal.material.tail
    low, high = UNKNOWN_TAILS if u is None else (tail - _RANGE * u, tail + _RANGE * u)
    low, high = max(min(low, tail), 0.0), min(max(high, tail), LONGEST_TAIL)
    tails = low + (high - low) * _PLACES
    of_tail = along or (lambda one: replace(nominal.material, tail=one))
    states = [replace(nominal, material=of_tail(float(one))) for one in tails]
    light = np.log(np.maximum(evaluate(surface, [nominal, *states], poses, convention), DARK))
    count = len(straight)
    slopes = np.column_stack([*straight.values()]) if straight else np.zeros((len(poses), 0))
    linear = Response(tuple(straight), slopes, np.zeros((len(poses), count, count)))
    responses = [
        common
        or (response_of(surface, state, poses, convention, inputs, dict(straight)) if straight else None)
        or linear
        for state in states
    ]
    return LobeDoubt(tails, light[1:] - light[0], tuple(responses), tail, np.inf if u is None else u)
