"""Likelihood of the extents of a cause: best extent, its uncertainty, and its 95 % interval.

The covariance depends on the extent: it includes the response of the deviating part to the uncertain inputs and the
doubt of the signature, which grows with the change; for a cause that is also an input of the prediction it excludes
that input's uncertainty. −2 ln of the likelihood is then the sum of χ² and the ln determinant. The interval contains
all extents that the likelihood ratio does not reject (Wilks 1938): where a signature is curved, or an extent can only
be positive, the curvature at the best point is not sufficient, because a part may look good despite some of the
defect.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import ROUNDING, root, whitening
from anisoscope.diagnosis.evidence import Evidence
from anisoscope.diagnosis.signatures import Signature, Signatures

QUANTILE = 3.841458820694124
"""95 % of χ² with one degree of freedom."""
"""The cause of which the extent is measured in the pictures."""
OTHER_TEXTURE = 0.2
"""Probability that a texture that was guessed is another one."""
PLASTIC_SPREADS = {"roughness-along": 0.3, "roughness-across": 0.3, "colour": 0.5, "light-angle": 1.0}
"""Standard deviations by which another plastic and another lamp differ: shares, and degrees."""
FAMILY = 0.015
"""Standard deviation of ln L of every pose that a lobe with a tail leaves of a real one."""
FORM_GROUPS = 20.0
"""How many groups of cells a predicted form of the marks is worth: real marks have other forms than the model's."""
FORM_OF_GOOD = (0.7, 0.4, 0.05)
"""Form of the few cells that deviate on good parts."""
_LEAST_BACKGROUND = 0.001
_ODD = 0.05  # share of the cells of a mark that lie otherwise than its form says
_STEPS_OF_PLASTIC = 8
Act = tuple[Signature, FloatArray]
"""A cause and its (E,) extents."""
Costs = tuple[FloatArray, FloatArray]
"""(E,) χ² and (E,) −2 ln of a likelihood."""
_COARSE = 6  # the coarse search takes every sixth extent of a signature's table
_FINE = 17  # points between the best point's neighbours
_NEAR, _NEAR_POINTS = 4.0, 25  # u to both sides of the best extent, and points there
# The grid of a pair has the square of the extents of one cause: every 16th extent of the tables finds the valley that
# two similar causes share, and three rounds of 9 × 9 points between neighbours narrow it to 1/64 of that step.
_PAIR_COARSE, _PAIR_FINE, _PAIR_ROUNDS = 16, 9, 3


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
    chi2, cost = joint_costs((), evidence)
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
    unknown = np.full((1, len(FORM_OF_GOOD)), np.nan)
    for off, more in (
        _share_costs(evidence, np.zeros(1), 0.0, spread / 3.0),
        _form_costs(evidence, np.ones(1), unknown, 0.0),
        _pitch_costs(evidence, 0.0),
    ):
        chi2, cost = chi2 + off, cost + more
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
    information = _information(((signature, extent),), evidence, as_input=as_input)[0, 0]
    return float(1.0 / np.sqrt(information)) if information > 0.0 else float("inf")


def _information(
    acting: Sequence[tuple[Signature, float]], evidence: Evidence, *, as_input: bool
) -> FloatArray:
    """(K, K) information of the data about the extents of K causes, at their best ones."""
    acts = [(signature, np.array([extent])) for signature, extent in acting]
    _, shares, covariance = _joint(acts, evidence, as_input=as_input)
    slopes = [signature.slope(extent) for signature, extent in acting]
    change = np.stack([slope for slope, _ in slopes])
    white = change @ whitening(covariance[0])
    found = white @ white.T
    if evidence.share is not None:
        share = np.array([slope for _, slope in slopes])
        counted = sum(float(one.share_scatter(extent)) for one, extent in acting)
        found = found + np.outer(share, share) / (float(evidence.share_variance(shares)[0]) + counted)
    if evidence.pitch is not None:
        pitch = np.array([signature.cause.scales_pitch for signature, _ in acting], dtype=np.float64)
        found = found + np.outer(pitch, pitch) / evidence.pitch[1] ** 2
    return np.asarray(found)


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
    return _ends(extents, cost, signature.bounds)


@dataclass(frozen=True)
class FittedPair:
    """Fit of two causes that act together.

    Attributes:
        extents: of both.
        u: their standard uncertainties, from the curvature; infinite where the data do not determine them.
        chi2: of the residual.
        cost: −2 ln of the likelihood, up to a constant common to all causes.
    """

    extents: tuple[float, float]
    u: tuple[float, float]
    chi2: float
    cost: float


def fit_pair(pair: tuple[Signature, Signature], evidence: Evidence, *, as_input: bool = False) -> FittedPair:
    """Best extents of two causes that act together, on grids that close in.

    Args:
        pair: the causes.
        evidence: what was measured.
        as_input: the covariance excludes the inputs of the prediction that are causes here.
    """
    axes = [np.unique(np.append(one.table[0][::_PAIR_COARSE], [*one.bounds, 0.0])) for one in pair]
    extents, chi2, cost, axes = _best_of(pair, axes, evidence, as_input=as_input)
    for _ in range(_PAIR_ROUNDS):
        extents, chi2, cost, axes = _best_of(pair, axes, evidence, as_input=as_input)
    information = _information(tuple(zip(pair, extents, strict=True)), evidence, as_input=as_input)
    u = np.full(2, np.inf)
    if np.linalg.det(information) > 1e-12 * float(np.prod(np.diag(information))):
        u = np.sqrt(np.diag(np.linalg.inv(information)))
    return FittedPair(extents, (float(u[0]), float(u[1])), chi2, cost)


def _best_of(
    pair: tuple[Signature, Signature], axes: Sequence[FloatArray], evidence: Evidence, *, as_input: bool
) -> tuple[tuple[float, float], float, float, list[FloatArray]]:
    """The best extents on a grid, their χ² and cost, and the axes of a closer grid about them."""
    meshed = [axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")]
    chi2, cost = joint_costs(tuple(zip(pair, meshed, strict=True)), evidence, as_input=as_input)
    best = int(np.argmin(cost))
    closer = []
    for axis, k in zip(axes, divmod(best, len(axes[1])), strict=True):
        closer.append(np.linspace(axis[max(k - 1, 0)], axis[min(k + 1, len(axis) - 1)], _PAIR_FINE))
    extents = float(meshed[0][best]), float(meshed[1][best])
    return extents, float(chi2[best]), float(cost[best]), closer


def pair_interval(
    pair: tuple[Signature, Signature], evidence: Evidence, fit: FittedPair, which: int
) -> tuple[float | None, float | None]:
    """Ends of the 95 % interval of one extent of two: the other one is at its likeliest (profile likelihood).

    Args:
        pair: the causes.
        evidence: what was measured.
        fit: the best extents.
        which: 0 or 1, the extent.

    Returns:
        As of `interval`.
    """
    axes = []
    for one, extent, u in zip(pair, fit.extents, fit.u, strict=True):
        looked = [one.table[0][::_PAIR_COARSE], np.array([*one.bounds, extent])]
        if u < np.inf:
            looked.append(extent + u * np.linspace(-_NEAR, _NEAR, _NEAR_POINTS))
        axes.append(np.unique(np.clip(np.concatenate(looked), *one.bounds)))
    meshed = [axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")]
    _, cost = joint_costs(tuple(zip(pair, meshed, strict=True)), evidence, as_input=True)
    profile = cost.reshape(len(axes[0]), len(axes[1])).min(axis=1 - which)
    return _ends(axes[which], profile, pair[which].bounds)


def _ends(
    extents: FloatArray, cost: FloatArray, bounds: tuple[float, float]
) -> tuple[float | None, float | None]:
    """Least and greatest extent that the likelihood ratio does not reject; None at the end of what was looked at."""
    limit = float(cost.min()) + QUANTILE
    within = np.flatnonzero(cost <= limit)
    first, last = int(within[0]), int(within[-1])
    return (
        _crossing(extents, cost, first, first - 1, limit) if first else (0.0 if bounds[0] == 0.0 else None),
        _crossing(extents, cost, last, last + 1, limit)
        if last + 1 < len(extents)
        else (0.0 if bounds[1] == 0.0 else None),
    )


def _crossing(extents: FloatArray, cost: FloatArray, inside: int, outside: int, limit: float) -> float:
    part = (limit - cost[inside]) / (cost[outside] - cost[inside])
    return float(extents[inside] + part * (extents[outside] - extents[inside]))


def costs(
    signature: Signature, evidence: Evidence, extents: FloatArray, *, as_input: bool
) -> tuple[FloatArray, FloatArray]:
    """(E,) χ² and (E,) −2 ln of the likelihood of (E,) extents, up to a constant common to all causes."""
    return joint_costs(((signature, extents),), evidence, as_input=as_input)


def joint_costs(acting: Sequence[Act], evidence: Evidence, *, as_input: bool = False) -> Costs:
    """(E,) χ² and (E,) −2 ln of the likelihood of causes that act together, up to a constant common to all.

    Args:
        acting: every cause with its (E,) extents; none: the part is as predicted.
        evidence: what was measured.
        as_input: the covariance excludes the inputs of the prediction that are causes here.
    """
    changes, shares, covariances = _joint(acting, evidence, as_input=as_input)
    counted = np.sqrt(sum((one.share_scatter(extents) for one, extents in acting), np.zeros(1)))
    chi2, size = _quadratic(covariances, evidence.deviation - changes)
    cost = _minus_two_ln(chi2, evidence) + size
    guessed, percent = np.zeros(1), np.zeros(1)
    for signature, extents in acting:
        guessed = guessed + signature.cause.guessed * np.abs(extents)
        percent = percent + (extents if signature.cause.scales_pitch else 0.0)
    for off, more in (
        _share_costs(evidence, shares, guessed, counted),
        _form_costs(evidence, shares, _form_of(acting, len(shares)), guessed),
        _pitch_costs(evidence, percent),
    ):
        chi2, cost = chi2 + off, cost + more
    return chi2, cost


def _form_of(acting: Sequence[Act], count: int) -> FloatArray:
    """(E, 3) form of the cells that deviate by causes that act together, each by its share; NaN where it is unknown."""
    total, weights = np.zeros((count, len(FORM_OF_GOOD))), np.zeros((count, 1))
    for signature, extents in acting:
        _, share = signature.at(extents)
        known = np.where(share > 0.0, share, 0.0)[:, None]
        total = total + np.where(known > 0.0, known * signature.form_at(extents), 0.0)
        weights = weights + known
    return np.asarray(np.where(weights > 0.0, total / np.maximum(weights, 1e-12), 0.0))


def _form_costs(
    evidence: Evidence, shares: FloatArray, forms: FloatArray, guessed: float | FloatArray
) -> Costs:
    """(E,) −2 ln of the likelihood of the form of the deviating cells, above its least, and with the normalisation.

    The groups of cells are draws of the form that cause and background have together, beta-binomial with a form that is
    known as from `FORM_GROUPS` groups; where a form is unknown or a texture was guessed any other is as likely.
    """
    seen = evidence.form
    if seen is None:
        return np.zeros(1), np.zeros(1)
    from scipy.special import betaln  # noqa: PLC0415 - start-up time

    background = max(evidence.background, _LEAST_BACKGROUND)
    weight = (shares / (shares + background))[:, None]
    expected = _within(weight * forms + (1.0 - weight) * np.array(FORM_OF_GOOD))
    hits = seen.groups * np.array([seen.in_line, seen.along, seen.aligned])

    def density(share: FloatArray) -> FloatArray:
        a, b = FORM_GROUPS * share, FORM_GROUPS * (1.0 - share)
        return np.asarray(np.exp(betaln(hits + a, seen.groups - hits + b) - betaln(a, b)))

    any_form = np.exp(betaln(hits + 1.0, seen.groups - hits + 1.0))
    other = np.where(np.asarray(guessed) > 0.0, OTHER_TEXTURE, 0.0)[..., None]
    known = (1.0 - other) * density(expected) + other * any_form
    found = np.where(np.isfinite(expected), known, any_form)
    best = np.maximum(density(np.clip(hits / seen.groups, _ODD, 1.0 - _ODD)), found.max(axis=0))
    cost = -2.0 * np.sum(np.log(np.maximum(found, 1e-300)), axis=-1)
    return cost + 2.0 * float(np.sum(np.log(best))), cost


def _joint(
    acting: Sequence[Act], evidence: Evidence, *, as_input: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(E, P) changes of ln L, (E,) shares of deviating cells, and (E, P, P) covariance of the deviation.

    Changes and shares of causes that act together add.
    """
    poses = len(evidence.deviation)
    changes, shares, doubted = np.zeros((1, poses)), np.zeros(1), np.zeros((1, poses))
    for signature, extents in acting:
        change, share = signature.at(extents)
        changes, shares = changes + change, shares + share
        doubted = doubted + (signature.cause.doubt * change) ** 2
    inputs, learnt = evidence.inputs, evidence.learnt
    own = {name for signature, _ in acting for name in signature.cause.sources}
    own = own & set(inputs.u) if as_input and inputs is not None else set()
    stated = evidence.stated(own, [(extents, signature.tangents) for signature, extents in acting])
    if learnt is not None:
        stated, doubted = learnt.applied(stated), doubted + (learnt.misfit * changes) ** 2
    return changes, shares, np.asarray(stated + doubted[:, :, None] * np.eye(poses))


def _share_costs(
    evidence: Evidence, shares: FloatArray, guessed: float | FloatArray, spread: float | FloatArray = 0.0
) -> Costs:
    """(E,) −2 ln of the likelihood of the share of deviating cells, above its least, and with the normalisation.

    The texture of a cause that was guessed may be another one: then the share is anything up to that of the area that
    it touches, or as much again as predicted.
    """
    if evidence.share is None:
        return np.zeros(1), np.zeros(1)
    known = evidence.share_variance(shares) + np.square(spread)
    squared = (evidence.share - evidence.background - shares) ** 2
    wide = known + np.asarray(guessed) ** 2 + shares**2
    other = np.where(np.asarray(guessed) > 0.0, OTHER_TEXTURE, 0.0)

    def density(square: FloatArray | float) -> FloatArray:
        return np.asarray(
            (1.0 - other) * np.exp(-0.5 * square / known) / np.sqrt(known)
            + other * np.exp(-0.5 * square / wide) / np.sqrt(wide)
        )

    cost = -2.0 * np.log(np.maximum(density(squared), 1e-300))
    return cost + 2.0 * np.log(density(0.0)), cost


def _pitch_costs(evidence: Evidence, percent: float | FloatArray) -> Costs:
    """(E,) χ² of the pitch that was measured in the pictures, twice."""
    if evidence.pitch is None:
        return np.zeros(1), np.zeros(1)
    measured, u = evidence.pitch
    chi2 = np.square((np.atleast_1d(percent) - measured) / u)
    return chi2, chi2


def _within(share: FloatArray) -> FloatArray:
    """Shares as real marks have them: of none of them all or no cells are alike."""
    return np.asarray(_ODD + (1.0 - 2.0 * _ODD) * share)


def _minus_two_ln(chi2: FloatArray, evidence: Evidence) -> FloatArray:
    """−2 ln of the density at a squared distance: normal, or Student's if golden parts estimate the covariance."""
    if evidence.learnt is None:
        return chi2
    freedom = evidence.learnt.freedom
    return np.asarray((freedom + len(evidence.deviation)) * np.log1p(chi2 / freedom))


def _quadratic(covariances: FloatArray, off: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(E,) dᵀV⁻¹d and (E,) ln |V| of deviations (E, P) with covariances (E, P, P)."""
    try:
        factor = np.linalg.cholesky(covariances)
    except np.linalg.LinAlgError:  # some direction is without uncertainty
        half = root(covariances, least=ROUNDING)
        covariances = half @ half
        factor = np.linalg.cholesky(covariances)
    chi2 = np.einsum("ep,ep->e", off, np.linalg.solve(covariances, off[..., None])[..., 0])
    return chi2, 2.0 * np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1)


@dataclass(frozen=True)
class FittedPlastic:
    """Fit of the hypothesis that another plastic or lamp than that of the prediction was looked at.

    Attributes:
        names: causes of which it is made up, the tail of the lobe last.
        extents: their likeliest extents.
        u: their standard uncertainties.
        chi2: of the residual, priors included.
        cost: −2 ln of the evidence, comparable with other costs.
    """

    names: tuple[str, ...]
    extents: FloatArray
    u: FloatArray
    chi2: float
    cost: float


def another_plastic(known: Signatures, evidence: Evidence) -> FittedPlastic | None:
    """Fit of another plastic or lamp; None where the tail of the lobe has no signature.

    Roughnesses, albedo, light angle and tail of the lobe may all differ from the recipe, with normal priors of the
    widths `PLASTIC_SPREADS` and equal ones for every tail. The integral over them is Laplace's about the likeliest
    extents for each tail (MacKay 1992, Bayesian interpolation), so that a hypothesis of many extents is not preferred
    for their number. What a family of lobes leaves of a real one is `FAMILY` in ln L of every pose.
    """
    tail = known.tail
    acting = [one for one in known.found if one.cause.name in PLASTIC_SPREADS]
    if tail is None or not acting:
        return None
    spread = np.array([PLASTIC_SPREADS[one.cause.name] for one in acting])
    found = [_with_tail(acting, spread, tail, float(extent), evidence) for extent in tail.extents]
    cost = np.array([one.cost for one in found])
    best = found[int(np.argmin(cost))]
    weight = np.exp(-0.5 * (cost - cost.min()))
    mean = float(np.average(tail.extents, weights=weight))
    u_tail = float(np.sqrt(np.average((tail.extents - mean) ** 2, weights=weight)))
    integral = float(cost.min() - 2.0 * np.log(weight.mean()))
    return FittedPlastic(
        best.names, np.append(best.extents, mean), np.append(best.u, u_tail), best.chi2, integral
    )


def _with_tail(
    acting: Sequence[Signature], spread: FloatArray, tail: Signature, longer: float, evidence: Evidence
) -> FittedPlastic:
    """The same for one tail of the lobe; extents without it."""
    shift = tail.at(longer)[0]
    base = evidence.good + np.diag((tail.cause.doubt * shift) ** 2) + FAMILY**2 * np.eye(len(shift))
    prior, doubts = np.diag(spread**-2.0), np.array([one.cause.doubt for one in acting])
    low, high = np.array([one.bounds for one in acting]).T

    def at(extents: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Residual of the deviation, its covariance, gradient and curvature of the extents."""
        changes = np.stack([one.at(extent)[0] for one, extent in zip(acting, extents, strict=True)])
        slopes = np.stack([one.slope(extent)[0] for one, extent in zip(acting, extents, strict=True)])
        covariance = base + np.diag(np.sum((doubts[:, None] * changes) ** 2, axis=0))
        change = shift + changes.sum(axis=0)
        if evidence.learnt is not None:
            covariance = covariance + np.diag((evidence.learnt.misfit * change) ** 2)
        left = evidence.deviation - change
        weight = whitening(covariance)
        weighted = slopes @ weight @ weight
        return left, covariance, weighted @ left - prior @ extents, weighted @ slopes.T + prior

    extents = np.zeros(len(acting))
    for _ in range(_STEPS_OF_PLASTIC):
        _, _, gradient, curvature = at(extents)
        step = np.linalg.solve(curvature, gradient)
        extents = np.clip(extents + np.clip(step, -spread, spread), low, high)
    left, covariance, _, curvature = at(extents)
    squared, size = _quadratic(covariance[None], left[None])
    chi2 = float(squared[0]) + float(extents @ prior @ extents)
    cost = float(_minus_two_ln(np.array([chi2]), evidence)[0] + size[0])
    cost += float(np.linalg.slogdet(curvature)[1]) + 2.0 * float(np.sum(np.log(spread)))
    for off, more in (
        _share_costs(evidence, np.zeros(1), 0.0),
        _form_costs(evidence, np.zeros(1), np.zeros((1, len(FORM_OF_GOOD))), 0.0),
        _pitch_costs(evidence, 0.0),
    ):
        chi2, cost = chi2 + float(off[0]), cost + float(more[0])
    names = (*(one.cause.name for one in acting), tail.cause.name)
    return FittedPlastic(names, extents, np.sqrt(np.diag(np.linalg.inv(curvature))), chi2, cost)
