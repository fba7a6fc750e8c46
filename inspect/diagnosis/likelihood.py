"""Likelihood of the extents of a cause: best extent, its uncertainty, and its 95 % interval.

The covariance depends on the extent: it includes the response of the deviating part to the uncertain inputs and the
doubt of the signature, which grows with the change; for a cause that is also an input of the prediction it excludes
that input's uncertainty. −2 ln of the likelihood is then the sum of χ² and the ln determinant. The interval contains
all extents that the likelihood ratio does not reject (Wilks 1938): where a signature is curved, or an extent can only
be positive, the curvature at the best point is not sufficient, because a part may look good despite some of the
defect.
"""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.diagnosis.evidence import Evidence
from anisoscope.diagnosis.signatures import Signature

QUANTILE = 3.841458820694124
"""95 % of χ² with one degree of freedom."""
_COARSE = 6  # the coarse search takes every sixth extent of a signature's table
_FINE = 17  # points between the best point's neighbours
_NEAR, _NEAR_POINTS = 4.0, 25  # u to both sides of the best extent, and points there


@dataclass(frozen=True)
class Fitted:
    """Fit of one cause to a part.

    Attributes:
        extent: the extent.
        u: its standard uncertainty, from the curvature; infinite where the data do not determine it.
        chi2: of the residual.
        cost: −2 ln of the likelihood, up to a constant common to all causes.
    """

    extent: float
    u: float
    chi2: float
    cost: float


def nothing(evidence: Evidence) -> Fitted:
    """Fit of the hypothesis that the part is as predicted."""
    chi2, cost = _chi2_and_cost(
        evidence, evidence.good[None], np.zeros((1, len(evidence.deviation))), np.zeros(1)
    )
    return Fitted(0.0, 0.0, float(chi2[0]), float(cost[0]))


def unspecific(evidence: Evidence, spread: float) -> Fitted:
    """Fit of a cause that changes every pose by itself, and the share of deviating cells, by an unknown amount.

    Args:
        evidence: what was measured.
        spread: standard deviation of ln L of each pose by it; of the share a third of that.
    """
    poses = len(evidence.deviation)
    covariance = evidence.good + spread**2 * np.eye(poses)
    chi2, size = _quadratic(covariance[None], evidence.deviation[None])
    cost = _minus_two_ln(chi2, evidence) + size
    if evidence.share is not None:
        variance = evidence.share_variance(np.zeros(1)) + (spread / 3.0) ** 2
        off = (evidence.share - evidence.background) ** 2 / variance
        chi2, cost = chi2 + off, cost + off + np.log(variance)
    return Fitted(0.0, float("inf"), float(chi2[0]), float(cost[0]))


def fit_extent(signature: Signature, evidence: Evidence, *, as_input: bool = False) -> Fitted:
    """Best extent of a cause.

    Args:
        signature: of the cause.
        evidence: what was measured.
        as_input: if the cause is an input of the prediction, the covariance excludes that input.
    """
    extents = np.unique(np.append(signature.table[0][::_COARSE], [*signature.bounds, 0.0]))
    extents = extents[(extents >= signature.bounds[0]) & (extents <= signature.bounds[1])]
    chi2, cost = costs(signature, evidence, extents, as_input=as_input)
    for _ in range(2):
        k = int(np.argmin(cost))
        between = np.linspace(extents[max(k - 1, 0)], extents[min(k + 1, len(extents) - 1)], _FINE)
        extents = np.unique(np.append(between, extents[k]))
        chi2, cost = costs(signature, evidence, extents, as_input=as_input)
    k = int(np.argmin(cost))
    extent = _vertex(extents, cost, k)
    chi2, cost = costs(signature, evidence, np.array([extent]), as_input=as_input)
    return Fitted(extent, _u(signature, evidence, extent, as_input=as_input), float(chi2[0]), float(cost[0]))


def _vertex(extents: FloatArray, cost: FloatArray, k: int) -> float:
    """Minimum of the parabola through the least cost and its neighbours."""
    if k in (0, len(extents) - 1):
        return float(extents[k])
    left, right = extents[k] - extents[k - 1], extents[k + 1] - extents[k]
    down, up = cost[k - 1] - cost[k], cost[k + 1] - cost[k]
    bend = down * right + up * left
    if bend <= 0.0:
        return float(extents[k])
    return float(extents[k] + 0.5 * (down * right**2 - up * left**2) / bend)


def _u(signature: Signature, evidence: Evidence, extent: float, *, as_input: bool) -> float:
    at = np.array([extent])
    change, share = signature.at(at)
    covariance = _covariances(signature, evidence, at, change, as_input=as_input)[0]
    slope, share_slope = signature.slope(extent)
    curvature = float(_quadratic(covariance[None], slope[None])[0][0])
    if evidence.share is not None:
        curvature += share_slope**2 / float(evidence.share_variance(share)[0])
    return float(1.0 / np.sqrt(curvature)) if curvature > 0.0 else float("inf")


def interval(signature: Signature, evidence: Evidence, fit: Fitted) -> tuple[float | None, float | None]:
    """Ends of the 95 % interval of an extent.

    Args:
        signature: of the cause.
        evidence: what was measured.
        fit: the best extent with its uncertainty, which set the search range.

    Returns:
        Least and greatest extent; None where the interval reaches the end of the signature, unless that is 0.
    """
    low, high = signature.bounds
    looked = [signature.table[0][::_COARSE], np.array([low, high, fit.extent])]
    if 0.0 < fit.u < np.inf:
        looked.append(fit.extent + fit.u * np.linspace(-_NEAR, _NEAR, _NEAR_POINTS))
    extents = np.unique(np.clip(np.concatenate(looked), low, high))
    _, cost = costs(signature, evidence, extents, as_input=True)
    limit = float(cost.min()) + QUANTILE
    within = np.flatnonzero(cost <= limit)
    first, last = int(within[0]), int(within[-1])
    return (
        _crossing(extents, cost, first, first - 1, limit) if first else (0.0 if low == 0.0 else None),
        _crossing(extents, cost, last, last + 1, limit)
        if last + 1 < len(extents)
        else (0.0 if high == 0.0 else None),
    )


def _crossing(extents: FloatArray, cost: FloatArray, inside: int, outside: int, limit: float) -> float:
    part = (limit - cost[inside]) / (cost[outside] - cost[inside])
    return float(extents[inside] + part * (extents[outside] - extents[inside]))


def costs(
    signature: Signature, evidence: Evidence, extents: FloatArray, *, as_input: bool
) -> tuple[FloatArray, FloatArray]:
    """(E,) χ² and (E,) −2 ln of the likelihood of (E,) extents, up to a constant common to all causes."""
    changes, shares = signature.at(extents)
    covariances = _covariances(signature, evidence, extents, changes, as_input=as_input)
    return _chi2_and_cost(evidence, covariances, changes, shares)


def _chi2_and_cost(
    evidence: Evidence, covariances: FloatArray, changes: FloatArray, shares: FloatArray
) -> tuple[FloatArray, FloatArray]:
    chi2, size = _quadratic(covariances, evidence.deviation - changes)
    cost = _minus_two_ln(chi2, evidence) + size
    if evidence.share is not None:
        variance = evidence.share_variance(shares)
        off = (evidence.share - evidence.background - shares) ** 2 / variance
        chi2, cost = chi2 + off, cost + off + np.log(variance)
    return chi2, cost


def _minus_two_ln(chi2: FloatArray, evidence: Evidence) -> FloatArray:
    """−2 ln of the density at a squared distance: normal, or Student's if golden parts estimate the covariance."""
    if evidence.learnt is None:
        return chi2
    freedom = evidence.learnt.freedom
    return np.asarray((freedom + len(evidence.deviation)) * np.log1p(chi2 / freedom))


def _quadratic(covariances: FloatArray, off: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(E,) dᵀV⁻¹d and (E,) ln |V| of deviations (E, P) with covariances (E, P, P)."""
    try:
        root = np.linalg.cholesky(covariances)
    except (
        np.linalg.LinAlgError
    ):  # singular covariance: avoids division by zero along directions without uncertainty
        values, vectors = np.linalg.eigh(covariances)
        values = np.maximum(values, values[:, -1:] * values.shape[-1] * np.finfo(np.float64).eps)
        along = np.einsum("epk,ep->ek", vectors, off)
        return np.sum(along**2 / values, axis=1), np.sum(np.log(values), axis=1)
    chi2 = np.einsum("ep,ep->e", off, np.linalg.solve(covariances, off[..., None])[..., 0])
    return chi2, 2.0 * np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)


def _covariances(
    signature: Signature, evidence: Evidence, extents: FloatArray, changes: FloatArray, *, as_input: bool
) -> FloatArray:
    """(E, P, P) covariance of the deviation at every extent."""
    source, inputs, learnt = signature.cause.source, evidence.inputs, evidence.learnt
    alone = source if as_input and inputs is not None and source in inputs.u else None
    stated = evidence.stated(alone, extents, signature.tangents)
    doubt = np.square(signature.cause.doubt)
    if learnt is not None:
        stated, doubt = learnt.applied(stated), doubt + learnt.misfit**2
    own = doubt * changes**2
    return np.asarray(stated + own[:, :, None] * np.eye(own.shape[1]))
