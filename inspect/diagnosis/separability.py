"""What a recipe's poses can tell, before any part is measured: from which extent a cause shows, beside which others.

Two causes are told apart at an extent where no extent of the other comes nearer than 3σ in the metric of V⁻¹: the
Fisher information of the poses, taken along the curves that the signatures are instead of along their tangents.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.diagnosis.diagnosing import GRID, share_spread, whitening
from anisoscope.diagnosis.signatures import Signature, Signatures
from anisoscope.expectation import Expectation
from anisoscope.recipe import Recipe

FloatArray = npt.NDArray[np.float64]

SIGMAS = 3.0
_STEPS = 60


@dataclass(frozen=True)
class Separability:
    """What the poses tell of one cause.

    Attributes:
        cause: its name.
        title: what it is.
        unit: of its extents.
        group: of the cause.
        shows_from: least extent (by size) that lies 3σ from a good part, or None within what was looked at.
        told_from: for every other cause, the least extent that lies 3σ from all its extents, or None.
        greatest: greatest extent that was looked at.
    """

    cause: str
    title: str
    unit: str
    group: str
    shows_from: float | None
    told_from: dict[str, float | None]
    greatest: float

    @property
    def never_told_from(self) -> tuple[str, ...]:
        """Causes that look the same at every extent that was looked at."""
        return tuple(name for name, extent in self.told_from.items() if extent is None)

    @property
    def told_apart_from(self) -> float | None:
        """Least extent at which no other cause looks the same, or None if there is none."""
        extents = [abs(extent) for extent in self.told_from.values() if extent is not None]
        if self.never_told_from or self.shows_from is None or len(extents) < len(self.told_from):
            return None
        return max([abs(self.shows_from), *extents])


def planned_covariance(recipe: Recipe, expected: Expectation) -> FloatArray:
    """(P, P) covariance of ln L that an inspection by this recipe will have, as far as the recipe says.

    Noise of the pictures is small against the rest and left out; the lamp drifts by a quarter of its limit.
    """
    rig, poses = recipe.uncertainty, len(expected.poses)
    total = np.full((poses, poses), rig.scale_share**2)
    for component in expected.components:
        total += component.covariance()
    stray = rig.stray_radiance / expected.radiance
    total += np.outer(stray, stray)
    alone = rig.flat_share**2 + rig.linearity_share**2 + (0.25 * recipe.limits.drift) ** 2 / 3.0
    return np.asarray(total + np.diag(alone + (rig.stage_deg * expected.per_degree) ** 2))


def separability(known: Signatures, covariance: FloatArray, *, with_map: bool) -> tuple[Separability, ...]:
    """What can be told, cause by cause.

    Args:
        known: the signatures.
        covariance: (P, P) of ln L.
        with_map: the share of deviating cells counts too.
    """
    weigh = whitening(covariance)
    curves = [_curve(signature, weigh, with_map=with_map) for signature in known.found]
    good = _Curve(np.zeros(1), np.zeros((1, len(weigh))), np.array([known.share]), with_map)
    rows = []
    for signature, curve in zip(known.found, curves, strict=True):
        cause = signature.cause
        others = {
            other.cause.name: _least(curve, beside)
            for other, beside in zip(known.found, curves, strict=True)
            if other is not signature
        }
        greatest = float(np.abs(signature.extents).max())
        rows.append(
            Separability(
                cause.name, cause.title, cause.unit, cause.group, _least(curve, good), others, greatest
            )
        )
    return tuple(rows)


@dataclass(frozen=True, eq=False)
class _Curve:
    """A signature in units of σ: extents (S,), whitened changes (S, rank), shares of cells (S,)."""

    extents: FloatArray
    whitened: FloatArray
    share: FloatArray
    with_map: bool


def _curve(signature: Signature, weigh: FloatArray, *, with_map: bool) -> _Curve:
    low, high = signature.bounds
    extents = np.linspace(low, high, GRID)
    change, share = signature.at(extents)
    return _Curve(extents, change @ weigh.T, share, with_map)


def _least(curve: _Curve, other: _Curve) -> float | None:
    """The extent of least size from which on a curve keeps 3σ from all points of another."""
    apart = np.array([_distance(curve, k, other) >= SIGMAS for k in range(len(curve.extents))])
    best = None
    for side in (1.0, -1.0):
        chosen = np.flatnonzero(np.sign(curve.extents) == side)
        chosen = chosen[np.argsort(np.abs(curve.extents[chosen]))]
        clear = np.logical_and.accumulate(apart[chosen][::-1])[::-1]
        if clear.any():
            extent = float(curve.extents[chosen[int(np.argmax(clear))]])
            best = extent if best is None or abs(extent) < abs(best) else best
    return best


def _distance(curve: _Curve, k: int, other: _Curve) -> float:
    squared = np.sum((other.whitened - curve.whitened[k]) ** 2, axis=1)
    if curve.with_map:
        spread = share_spread(float(curve.share[k]), 0.0)
        squared = squared + ((other.share - curve.share[k]) / spread) ** 2
    return float(np.sqrt(squared.min()))
