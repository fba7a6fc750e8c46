"""Profile likelihood: distance of deviations from the nearest state of the uncertain inputs, along curves in ln L.

An uncertain input moves all poses together along a curve, and good parts scatter about that curve. The squared distance
of a part is that from the nearest state of the inputs: min over z of |z|² + (d − f(z))ᵀV⁻¹(d − f(z)), with V the
covariance of the independent errors. Where f is linear this is the Mahalanobis distance of the full covariance.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.recipe.named_defect import NamedDefect

_STEPS, _HALVINGS = 25, 6
_COSTLY_STEPS = 100
SETTLED = 1e-9
"""Relative change of a squared distance below which its search ends."""
_CONVERGENCE = 1e-4  # tolerance of a squared distance whose evaluations are costly
_ASIDE = 1.5  # u

FARTHEST = 8.0
"""Standard uncertainties to which states are looked at where a model does not know all; no good part is beyond."""


class Curve(Protocol):
    """Change of P values with K inputs, every input in units of its standard uncertainty."""

    @property
    def sources(self) -> tuple[str, ...]:
        """K names of the inputs."""
        ...

    def change(self, z: FloatArray) -> FloatArray:
        """(…, P) change at inputs (…, K)."""
        ...

    def tangent(self, z: FloatArray) -> FloatArray:
        """(…, P, K) derivative at inputs (…, K)."""
        ...


class BoundedCurve(Curve, Protocol):
    """A curve whose inputs are known to a range."""

    @property
    def farthest(self) -> FloatArray:
        """(K,) range of the search for every input, in standard uncertainties."""
        ...


class DefectCurves(Protocol):
    """Curves of parts with the named defects of a recipe."""

    @property
    def defects(self) -> tuple[NamedDefect, ...]:
        """The defects with their smallest interesting sizes."""
        ...

    def with_defect(self, defect: NamedDefect, extent: float) -> BoundedCurve:
        """Change from a part as designed, with a multiple of that size, and all that is uncertain besides."""
        ...


class States(BoundedCurve, DefectCurves, Protocol):
    """Change of ln L of the poses with all uncertain inputs, evaluated by the model itself."""

    def holds(self, source: str) -> bool:
        """Whether the source of this name in the budget is an input of these states."""
        ...


@dataclass(frozen=True, eq=False)
class Combined:
    """Combinations (m, P) of the values of a curve."""

    curve: BoundedCurve
    basis: FloatArray

    @property
    def sources(self) -> tuple[str, ...]:
        """K names of the inputs."""
        return self.curve.sources

    @property
    def farthest(self) -> FloatArray:
        """(K,) range of the search for every input, in standard uncertainties."""
        return self.curve.farthest

    def change(self, z: FloatArray) -> FloatArray:
        """(…, m) change at inputs (…, K)."""
        return np.asarray(self.curve.change(z) @ self.basis.T)

    def tangent(self, z: FloatArray) -> FloatArray:
        """(…, m, K) derivative at inputs (…, K)."""
        return np.asarray(self.basis @ self.curve.tangent(z))


def nearest(
    curve: Curve,
    deviation: FloatArray,
    covariance: FloatArray,
    *,
    start: FloatArray | None = None,
) -> FloatArray:
    """Squared distance of deviations, minimised over the inputs: min |z|² + (d − f(z))ᵀV⁻¹(d − f(z)).

    Args:
        curve: of the m values, with K inputs.
        deviation: (N, m) of N parts.
        covariance: (N, m, m) of the independent errors, of full rank.
        start: (N, K) states to start from; None: the nominal one.

    Returns:
        (N,) squared distances, χ² with m degrees of freedom for parts that are as predicted.
    """
    begin = np.zeros((len(deviation), len(curve.sources))) if start is None else start
    return nearest_states(curve, deviation, covariance, begin)[0]


def nearest_states(
    curve: Curve,
    deviation: FloatArray,
    covariance: FloatArray,
    start: FloatArray,
    *,
    settled: float = SETTLED,
    farthest: float | FloatArray = np.inf,
    middle: float | FloatArray = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """The same within ``farthest`` of every input, and the (N, K) states themselves.

    With ``middle``, (N, K), the inputs are near another state than the nominal one: |z − middle|² in place of |z|².

    Gauss-Newton steps, halved until the distance decreases; the first one is along the tangent at the start. A row
    that is settled waits for no other.
    """
    weight = np.linalg.inv(covariance)
    z = start

    def misfit(at: FloatArray) -> FloatArray:
        rest = deviation - curve.change(at)
        return np.asarray(np.sum((at - middle) ** 2, axis=1) + np.einsum("ni,nij,nj->n", rest, weight, rest))

    left = misfit(z)
    moving = np.ones(len(left), dtype=bool)
    for _ in range(_STEPS):
        tangent, rest = curve.tangent(z), deviation - curve.change(z)
        pull = np.einsum("nia,nij->naj", tangent, weight)
        curvature = np.eye(z.shape[1]) + pull @ tangent
        down = np.linalg.solve(curvature, (np.einsum("naj,nj->na", pull, rest) - (z - middle))[..., None])[
            ..., 0
        ]
        before, share = left, 1.0
        for _ in range(_HALVINGS):
            trial = np.clip(z + share * down, -farthest, farthest)
            found = misfit(trial)
            better = found < left
            z, left = np.where(better[:, None], trial, z), np.where(better, found, left)
            share *= 0.5
            if (better | ~moving).all():
                break
        moving &= before - left > settled * (1.0 + before)
        if not moving.any():
            break
    return left, z


def nearest_costly(
    curve: Curve,
    deviation: FloatArray,
    covariance: FloatArray,
    start: FloatArray,
    *,
    settled: float,
    farthest: float | FloatArray,
) -> tuple[float, FloatArray]:
    """The same for one part with costly states, and the (K,) state itself.

    The tangent follows the steps (Broyden 1965), and is computed anew where they no longer help.

    Args:
        curve: of the m values, with K inputs.
        deviation: (m,).
        covariance: (m, m).
        start: (K,) state to start from.
        settled: relative change of the distance below which the search ends.
        farthest: range of the search for every input.
    """
    weight = np.linalg.inv(covariance)

    def misfit(z: FloatArray, value: FloatArray) -> float:
        return float(z @ z + (deviation - value) @ weight @ (deviation - value))

    z, value, tangent, fresh = start, curve.change(start), curve.tangent(start), True
    left = misfit(z, value)
    for _ in range(_COSTLY_STEPS):
        pull = tangent.T @ weight
        down = np.linalg.solve(np.eye(len(z)) + pull @ tangent, pull @ (deviation - value) - z)
        before, share, was_fresh = left, 1.0, fresh
        for _ in range(_HALVINGS if fresh else 2):
            trial = np.clip(z + share * down, -farthest, farthest)
            there = curve.change(trial)
            if (found := misfit(trial, there)) < left:
                step = trial - z
                tangent = tangent + np.outer(there - value - tangent @ step, step) / (step @ step)
                z, value, left, fresh = trial, there, found, False
                break
            share *= 0.5
        if before - left <= settled * (1.0 + before):
            if was_fresh:
                break
            tangent, fresh = curve.tangent(z), True
    return left, z


def nearest_anywhere(
    curve: Curve, deviation: FloatArray, covariance: FloatArray, farthest: float | FloatArray = FARTHEST
) -> float:
    """The same for one part with costly states, where an input may act by its square alone.

    Such an input has no tangent at its nominal value, and a step would never leave it: the search is repeated from its
    end with one such input displaced to either side.

    Args:
        curve: of the m values, with K inputs.
        deviation: (m,).
        covariance: (m, m).
        farthest: range of the search in standard uncertainties, for all inputs or (K,) for each.
    """
    count = len(curve.sources)
    ends = curve.change(np.vstack([np.eye(count), -np.eye(count)]))
    slope, bend = 0.5 * (ends[:count] - ends[count:]), 0.5 * (ends[:count] + ends[count:])
    turning = np.flatnonzero(np.abs(bend).max(axis=1) > np.abs(slope).max(axis=1))

    def search(start: FloatArray) -> tuple[FloatArray, FloatArray]:
        one, metric = deviation[None], covariance[None]
        return nearest_states(curve, one, metric, start, settled=_CONVERGENCE, farthest=farthest)

    left, z = search(np.zeros((1, count)))
    if not turning.size:
        return float(left[0])
    aside = np.repeat(z, 2 * turning.size, axis=0)
    aside[np.arange(len(aside)), np.repeat(turning, 2)] = np.tile([-_ASIDE, _ASIDE], turning.size)
    rest = deviation - curve.change(aside)
    misfit = np.sum(aside**2, axis=1) + np.einsum("ni,ij,nj->n", rest, np.linalg.inv(covariance), rest)
    again, _ = search(aside[[int(np.argmin(misfit))]])
    return float(min(left[0], again[0]))
