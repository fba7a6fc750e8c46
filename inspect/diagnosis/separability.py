"""Separability of causes under a recipe's poses, predicted before any part is measured.

Two causes are separated at an extent if no extent of the other is nearer than 3σ by the likelihood of the diagnosis:
the Fisher information of the poses along the curved signatures instead of their tangents, with the doubt of the
signatures.
"""

from dataclasses import dataclass, field

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import whitening
from anisoscope.base.json_fields import in_json, json_field
from anisoscope.diagnosis.evidence import Inputs, covariance_of, inputs_of, share_variance
from anisoscope.diagnosis.signatures import Signature, Signatures
from anisoscope.prediction.expectation import Component, Expectation
from anisoscope.recipe.surface import SurfaceRecipe

SIGMAS = 3.0
GRID = 121


@dataclass(frozen=True)
class Separability:
    """Detectability of one cause, and its separability from the others.

    Attributes:
        cause: its name.
        title: for people.
        unit: of its extents.
        group: of the cause.
        detection_extent: least extent (by size) 3σ from a good part, or None within the extents computed.
        separation_extents: for every other cause, the least extent 3σ from all its extents, or None.
        greatest: greatest extent computed.
    """

    cause: str
    title: str
    unit: str
    group: str
    detection_extent: float | None = field(metadata=json_field("shows_from"))
    separation_extents: dict[str, float | None] = field(metadata=json_field("told_from"))
    greatest: float

    @property
    @in_json("never_told_from")
    def inseparable_causes(self) -> tuple[str, ...]:
        """Causes that cannot be separated from this one at any extent computed."""
        return tuple(name for name, extent in self.separation_extents.items() if extent is None)

    @property
    @in_json("told_apart_from")
    def separation_extent(self) -> float | None:
        """Least extent at which the cause is separated from all others, or None if there is none."""
        extents = [abs(extent) for extent in self.separation_extents.values() if extent is not None]
        if (
            self.inseparable_causes
            or self.detection_extent is None
            or len(extents) < len(self.separation_extents)
        ):
            return None
        return max([abs(self.detection_extent), *extents])


def planned_components(recipe: SurfaceRecipe, expected: Expectation) -> tuple[Component, ...]:
    """Measurement components that an inspection by this recipe will add and the recipe states.

    Noise of the pictures is negligible and left out; the lamp is assumed to drift by a quarter of its limit. The names
    are those of a measurement.
    """
    rig, even = recipe.uncertainty, np.ones(len(expected.poses))
    drift = 0.25 * recipe.limits.drift / np.sqrt(3.0)
    return (
        Component("flat field", "measurement", rig.flat_share * even, shared=False),
        Component("linearity of the camera", "measurement", rig.linearity_share * even, shared=False),
        Component("drift of the lamp", "measurement", drift * even, shared=False),
        Component("stray light", "measurement", rig.stray_radiance / expected.radiance, shared=True),
        Component("stage angle", "measurement", rig.stage_deg * expected.per_degree, shared=False),
    )


def planned_covariance(recipe: SurfaceRecipe, expected: Expectation) -> FloatArray:
    """(P, P) covariance of ln L that an inspection of a good part by this recipe will have."""
    planned = expected.components + planned_components(recipe, expected)
    return covariance_of(planned, recipe.uncertainty.scale_share, len(expected.poses))


def planned_inputs(recipe: SurfaceRecipe, expected: Expectation) -> Inputs | None:
    """The uncertain inputs of such an inspection, or None where the second-order response is unknown."""
    return inputs_of(recipe, expected, planned_components(recipe, expected))


def separability(
    known: Signatures,
    covariance: FloatArray,
    *,
    with_map: bool,
    u_background: float = 0.0,
    inputs: Inputs | None = None,
) -> tuple[Separability, ...]:
    """Detectability and separability of every cause.

    Args:
        known: the signatures.
        covariance: (P, P) of ln L.
        with_map: use the share of deviating cells as well.
        u_background: standard uncertainty of that share on good parts.
        inputs: the uncertain inputs, whose effect depends on the cause; None: as on the good part.
    """
    whitener = whitening(covariance if inputs is None else inputs.covariance())
    u_map = u_background if with_map else None
    curves = [_curve(signature, whitener, u_map, inputs) for signature in known.found]
    leads = [_lead(curve, _good_part(whitener, u_map)) for curve in curves]
    rows = []
    for signature, curve, lead in zip(known.found, curves, leads, strict=True):
        cause = signature.cause
        others = {
            other.cause.name: _least(curve, _lead(curve, other_curve))
            for other, other_curve in zip(known.found, curves, strict=True)
            if other is not signature
        }
        greatest = float(np.abs(signature.extents).max())
        rows.append(
            Separability(
                cause.name, cause.title, cause.unit, cause.group, _least(curve, lead), others, greatest
            )
        )
    return tuple(rows)


@dataclass(frozen=True, eq=False)
class _Curve:
    """A signature in units of σ: S extents, (S, P) whitened changes, (S,) shares of cells.

    ``scaled`` (S, P, P), ``variance`` (S,) and ``size`` (S,) are what the likelihood of every point needs: the root of
    its weight, the variance of the share (None without a map), and ln of the determinant.
    """

    extents: FloatArray
    whitened: FloatArray
    share: FloatArray
    scaled: FloatArray
    variance: FloatArray | None
    size: FloatArray


def _curve(
    signature: Signature, whitener: FloatArray, u_background: float | None, inputs: Inputs | None
) -> _Curve:
    low, high = signature.bounds
    extents = np.linspace(low, high, GRID)
    change, share = signature.at(extents)
    scaled, size = _doubted(signature, extents, change, whitener, inputs)
    variance = None if u_background is None else share_variance(share, 0.0, u_background)
    size = size if variance is None else size + np.log(variance)
    return _Curve(extents, change @ whitener.T, share, scaled, variance, size)


def _doubted(
    signature: Signature,
    extents: FloatArray,
    changes: FloatArray,
    whitener: FloatArray,
    inputs: Inputs | None,
) -> tuple[FloatArray, FloatArray]:
    """Likelihood weights of whitened deviations along a signature, from inputs and doubt.

    Args:
        signature: of the cause.
        extents: (E,) extents.
        changes: (E, P) changes of ln L there.
        whitener: (P, P) whitening of V.
        inputs: the uncertain inputs, or None.

    Returns:
        (E, P, P) L with LᵀL the inverse of their covariance, and (E,) its ln determinant.
    """
    own = (signature.cause.doubt * changes) ** 2
    covariance = np.eye(len(whitener)) + np.einsum("ip,ep,jp->eij", whitener, own, whitener, optimize=True)
    if inputs is not None and signature.tangents is not None:
        deviating = inputs.covariance(causes=[(extents, signature.tangents)])
        covariance += whitener @ (deviating - inputs.covariance()) @ whitener.T
    root = np.linalg.cholesky(covariance)
    size = 2.0 * np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
    return np.linalg.inv(root), np.asarray(size)


def _good_part(whitener: FloatArray, u_background: float | None) -> _Curve:
    """A good part, as a curve of one point."""
    zero, poses = np.zeros(1), len(whitener)
    variance = None if u_background is None else share_variance(zero, 0.0, u_background)
    size = zero if variance is None else np.log(variance)
    return _Curve(zero, np.zeros((1, poses)), zero, np.eye(poses)[None], variance, size)


def _lead(curve: _Curve, other: _Curve) -> FloatArray:
    """(S,) excess of the likelihood of every point of a curve over the best of another one, as a χ²."""
    off = (curve.whitened - other.whitened[:, None]) @ other.scaled.transpose(0, 2, 1)
    cost = np.sum(off**2, axis=2) + other.size[:, None]
    if other.variance is not None:
        cost += (curve.share - other.share[:, None]) ** 2 / other.variance[:, None]
    return np.asarray(cost.min(axis=0) - curve.size)


def _least(curve: _Curve, lead: FloatArray) -> float | None:
    """Least extent beyond which a curve leads by 3σ throughout."""
    separated = lead >= SIGMAS**2
    best = None
    for side in (1.0, -1.0):
        chosen = np.flatnonzero(np.sign(curve.extents) == side)
        chosen = chosen[np.argsort(np.abs(curve.extents[chosen]))]
        clear = np.logical_and.accumulate(separated[chosen][::-1])[::-1]
        if clear.any():
            extent = float(curve.extents[chosen[int(np.argmax(clear))]])
            best = extent if best is None or abs(extent) < abs(best) else best
    return best
