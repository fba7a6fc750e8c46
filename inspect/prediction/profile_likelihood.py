"""Profile likelihood: distance of deviations from the nearest state of the uncertain inputs, along curves in ln L.

An uncertain input moves all poses together along a curve, and good parts scatter about that curve. The squared distance
of a part is that from the nearest state of the inputs: min over z of |z|² + (d − f(z))ᵀV⁻¹(d − f(z)), with V the
covariance of the independent errors. Where f is linear this is the Mahalanobis distance of the full covariance.
"""

from collections.abc import Hashable
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol, cast

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.recipe.named_defect import NamedDefect

_STEPS, _HALVINGS = 25, 6
_COSTLY_STEPS = 100
SETTLED = 1e-9
"""Relative change of a squared distance below which its search ends."""
_CONVERGENCE = 1e-4  # tolerance of a squared distance whose evaluations are costly
_INSIDE = 0.999  # of the range, where a search begins
_VAGUE = (1.0, 30.0, 300.0)  # variance of an expansion, over that of the errors, in turn
_GRIDDED, _NODES, _REACH = 3, 17, 3.2  # inputs that bend most; nodes along each, u to either side
_DARKEST = 0.02  # of the radiance: an expansion may fall below zero
_TRIED, _SEARCHED = 16, 4  # minima of the grid: by the model, and as starts
_ALONG = (0.0625, 0.125, 0.25, 0.375, 0.5, 0.75)  # of the range of an input, at which it is tried alone
_DRAWN, _SEED = 128, 3  # states that are drawn
_STARTS, _FEW_STEPS, _ROUGHLY = 10, 10, 1e-2  # searches that begin there, and how far all go
_FINISHED = 6  # of them go on

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
    """The same for one part with costly states, and the (K,) state itself: least squares within a trust region.

    Args:
        curve: of the m values, with K inputs.
        deviation: (m,).
        covariance: (m, m).
        start: (K,) state to start from.
        settled: relative change of the distance below which the search ends.
        farthest: range of the search for every input.
    """
    return _descent(
        curve,
        deviation,
        np.linalg.inv(np.linalg.cholesky(covariance)),
        start,
        settled,
        farthest,
        _COSTLY_STEPS,
    )


def _descent(
    curve: Curve,
    deviation: FloatArray,
    white: FloatArray,
    start: FloatArray,
    settled: float,
    farthest: float | FloatArray,
    steps: int,
) -> tuple[float, FloatArray]:
    """`nearest_costly` with whitened errors and a number of steps."""
    from scipy.optimize import least_squares  # noqa: PLC0415 - start-up time

    far = np.zeros(len(start)) + farthest

    def rest(z: FloatArray) -> FloatArray:
        return np.concatenate([z, white @ (deviation - curve.change(z))])

    def slopes(z: FloatArray) -> FloatArray:
        return np.vstack([np.eye(len(z)), -white @ curve.tangent(z)])

    found = least_squares(
        rest,
        np.clip(start, -_INSIDE * far, _INSIDE * far),
        slopes,
        bounds=(-far, far),
        ftol=settled,
        max_nfev=steps,
    )
    return float(2.0 * found.cost), np.asarray(found.x)


def nearest_anywhere(
    states: BoundedCurve, basis: FloatArray, deviation: FloatArray, covariance: FloatArray
) -> tuple[float, FloatArray]:
    """The same for one part with costly states and several minima, and the (K,) state itself.

    Radiance is nearly quadratic in what turns amplitudes of waves (edges, widths, depths), and the distance has a
    minimum for each phase of theirs. About a state the radiances are therefore expanded to second order; the inputs
    that bend most lie on a grid, with the others by linear least squares at every node; a search with the model itself
    begins at the best minima of the grid. The expansion is repeated about the state that was found. Of a part that is
    farther than half of the good ones, searches begin at the nearest of drawn states and of single inputs as well.

    Args:
        states: change of ln L of P poses, with K inputs.
        basis: (m, P) combinations that are compared.
        deviation: (m,).
        covariance: (m, m).
    """
    arrays = (np.ascontiguousarray(one, dtype=np.float64) for one in (basis, deviation, covariance))
    known = cast("Hashable", states)
    left, state = _nearest_anywhere(known, *(one.tobytes() for one in arrays), len(deviation))
    return left, np.array(state)


@lru_cache(maxsize=64)
def _nearest_anywhere(
    known: Hashable, basis: bytes, deviation: bytes, covariance: bytes, m: int
) -> tuple[float, tuple[float, ...]]:
    states = cast("BoundedCurve", known)
    off, metric = np.frombuffer(deviation), np.frombuffer(covariance).reshape(m, m)
    curve, count = Combined(states, np.frombuffer(basis).reshape(m, -1)), len(states.sources)
    white = np.linalg.inv(np.linalg.cholesky(metric))
    far, tried = states.farthest, [(np.inf, np.zeros(count))]

    def search(starts: FloatArray) -> None:
        tried.extend(_descent(curve, off, white, one, _ROUGHLY, far, _FEW_STEPS) for one in starts)
        tried.sort(key=lambda one: one[0])

    for vague in _VAGUE:
        search(_starts(curve, off, metric, tried[0][1], vague))
        if tried[0][0] < m:  # as near as good parts are
            break
    else:
        search(_drawn_starts(curve, off, white, far))
    ended = [
        _descent(curve, off, white, one, _CONVERGENCE, far, _COSTLY_STEPS) for _, one in tried[:_FINISHED]
    ]
    least, best = min(ended, key=lambda one: one[0])
    return least, tuple(best.tolist())


def _drawn_starts(curve: Combined, off: FloatArray, white: FloatArray, farthest: FloatArray) -> FloatArray:
    """(n, K) states from which the model is searched too: the nearest of states along every input and of drawn ones.

    Orders of a tile that come into the lens, or leave it, make minima that no expansion about one state knows.
    """
    count = len(farthest)
    alone = np.vstack([side * share * np.eye(count) * farthest for side in (-1.0, 1.0) for share in _ALONG])
    drawn = np.random.default_rng(_SEED).standard_normal((_DRAWN, count))
    slope = white @ curve.tangent(np.zeros(count))
    tried = np.vstack([alone, drawn])
    missed = (off - curve.change(tried)) @ white.T
    moved = tried + np.linalg.solve(np.eye(len(off)) + slope @ slope.T, missed.T).T @ slope
    moved = np.clip(moved, -farthest, farthest)
    left = np.sum(tried**2, axis=1) + np.sum(missed**2, axis=1)
    again = np.sum(moved**2, axis=1) + np.sum(((off - curve.change(moved)) @ white.T) ** 2, axis=1)
    both, cost = np.vstack([tried, moved]), np.concatenate([left, again])
    return np.asarray(both[np.argsort(cost)[:_STARTS]])


def _starts(
    curve: Combined, off: FloatArray, metric: FloatArray, centre: FloatArray, vague: float
) -> FloatArray:
    """(n, K) states from which the model is searched; errors of the expansion are ``vague`` times those of a part."""
    from scipy.ndimage import minimum_filter  # noqa: PLC0415 - start-up time

    count, basis = len(centre), curve.basis
    ends = curve.curve.change(centre + np.vstack([np.zeros(count), np.eye(count), -np.eye(count)]))
    here, up, down = ends[0], np.exp(ends[1 : count + 1] - ends[0]), np.exp(ends[count + 1 :] - ends[0])
    white = np.linalg.inv(np.linalg.cholesky(metric))
    bends = np.linalg.norm((0.5 * np.log(up * down)) @ basis.T @ white.T, axis=1)
    turning = np.argsort(-bends)[: min(_GRIDDED, count)]
    slope, bend = 0.5 * (up - down).T, np.zeros((len(here), count, count))
    bend[:, range(count), range(count)] = (up + down - 2.0).T
    pairs = [(i, j) for i in turning for j in range(count) if j not in turning or j > i]
    paired = np.array([centre + np.eye(count)[i] + np.eye(count)[j] for i, j in pairs])
    both = np.exp(curve.curve.change(paired) - here)
    for (i, j), radiance in zip(pairs, both, strict=True):
        bend[:, i, j] = bend[:, j, i] = radiance - up[i] - up[j] + 1.0
    axis, rest = np.linspace(-_REACH, _REACH, _NODES), np.setdiff1d(np.arange(count), turning)
    nodes = np.stack(np.meshgrid(*[axis] * len(turning), indexing="ij"), axis=-1).reshape(-1, len(turning))
    z = np.tile(centre, (len(nodes), 1))
    z[:, turning] = nodes
    step = z - centre
    half = np.tensordot(step, 0.5 * bend, axes=(-1, 2))
    radiance = np.maximum(1.0 + ((half + slope) @ step[..., None])[..., 0], _DARKEST)
    tangent = ((slope + 2.0 * half) / radiance[..., None])[..., rest]
    gap = off - (here + np.log(radiance)) @ basis.T
    pull = basis @ tangent
    gap += pull @ centre[rest]
    weighed = np.linalg.solve(vague * metric + pull @ np.swapaxes(pull, 1, 2), gap[..., None])
    left = np.sum(nodes**2, axis=1) + np.einsum("ni,ni->n", gap, weighed[..., 0])
    z[:, rest] = (np.swapaxes(pull, 1, 2) @ weighed)[..., 0]
    grid = left.reshape((_NODES,) * len(turning))
    lowest = np.flatnonzero((grid == minimum_filter(grid, 3)).ravel())
    tried = np.vstack([centre, z[lowest[np.argsort(left[lowest])][:_TRIED]]])
    tried = np.clip(tried, -FARTHEST, FARTHEST)
    missed = (off - curve.change(tried)) @ white.T
    return np.asarray(
        tried[np.argsort(np.sum(tried**2, axis=1) + np.sum(missed**2, axis=1) / vague)[:_SEARCHED]]
    )
