"""Which cause explains what was measured: greatest likelihood along every signature, ranked.

d = ln L measured − predicted has the covariance V of measurement and prediction together, with the scale of the white
reference as one more shared term, and what is not known of the signature itself, in every pose for itself. Along each
signature g(e) the extent e minimises (d − g)ᵀV⁻¹(d − g), V as at the extent before, to which the share of deviating
cells adds one more datum; its uncertainty follows from the curvature there. Causes are ranked by the Bayesian
information criterion (Schwarz 1978). What lies within 3σ of the best is a tie, and is said to be one. An extent that is
an input of the prediction too, such as a roughness, is then fitted again without the uncertainty of that input in V.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.diagnosis.signatures import Signature, Signatures
from anisoscope.expectation import Component, Expectation
from anisoscope.recipe import Recipe
from anisoscope.response import Response

FloatArray = npt.NDArray[np.float64]

NOTHING = "nothing"
TIE = 9.0  # 3σ in χ² for one parameter
FINE, FINER = 33, 2  # points of every finer grid between the best point's neighbours, and such grids
SHARE_FLOOR = 0.003  # cells that deviate on one good part and not on another
REWEIGHED = 3  # the first without the doubt of the signature, which is nil where nothing changes
FARTHEST = 6.0  # u from the nominal state to which the second order is trusted
_SAME = 1e-9
SHARE_RELATIVE = 0.3  # how well a share of deviating cells is predicted: size and form of real marks vary


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a diagnosis rests on.

    Attributes:
        deviation: (P,) ln L measured − ln L predicted.
        covariance: (P, P) of it, the scale included.
        share: share of cells that deviate in the contrast map, or None.
        u_share: its standard uncertainty.
        background: share of cells that deviate on good parts.
        u_background: its standard uncertainty.
        inputs: of the prediction, that may be causes too, or None.
    """

    deviation: FloatArray
    covariance: FloatArray
    share: float | None = None
    u_share: float = 0.0
    background: float = 0.0
    u_background: float = 0.0
    inputs: "Inputs | None" = None


@dataclass(frozen=True)
class Finding:
    """How well one cause explains a part.

    Attributes:
        cause: its name; "nothing" is the part as predicted.
        title: what it is, for people.
        unit: of the extent.
        extent: fitted extent; 0 for nothing.
        u: its standard uncertainty; infinite where the data do not determine it.
        at_bound: the fit ended at the end of what was looked at.
        chi2: what remains unexplained.
        weight: share of the belief, exp(−BIC/2) over all causes.
        tie: no data tell it from the best cause.
    """

    cause: str
    title: str
    unit: str
    extent: float
    u: float
    at_bound: bool
    chi2: float
    weight: float
    tie: bool


@dataclass(frozen=True)
class Diagnosis:
    """All causes, the best first.

    Attributes:
        findings: ranked causes, "nothing" among them.
        unexplained_p: probability of the χ² that the best leaves; small: none of the causes explains the part.
    """

    findings: tuple[Finding, ...]
    unexplained_p: float

    @property
    def ties(self) -> tuple[Finding, ...]:
        """The best cause and those that cannot be told from it."""
        return tuple(finding for finding in self.findings if finding.tie)


def covariance_of(components: tuple[Component, ...], scale_share: float, poses: int) -> FloatArray:
    """(P, P) covariance of ln L from all sources, and a scale that all poses share."""
    total = np.full((poses, poses), scale_share**2)
    for component in components:
        total += component.covariance()
    return total


@dataclass(frozen=True, eq=False)
class Inputs:
    """Uncertain inputs of the prediction that may be causes themselves.

    Attributes:
        response: of ln L to the inputs.
        u: standard uncertainties of inputs by name, in the unit of the cause's extent.
        rest: (P, P) covariance of everything else.
    """

    response: Response
    u: Mapping[str, float]
    rest: FloatArray

    def covariance(self, source: str, extent: float) -> FloatArray:
        """(P, P) covariance of ln L where one input is off by an extent, and not uncertain itself."""
        k = self.response.sources.index(source)
        z = np.zeros(len(self.response.sources))
        z[k] = np.clip(extent / self.u[source], -FARTHEST, FARTHEST)
        others = np.arange(len(z)) != k
        tangent = self.response.tangent(z)[:, others]
        bend = self.response.bend[:, others][:, :, others]
        return np.asarray(self.rest + tangent @ tangent.T + 0.5 * np.einsum("pab,qab->pq", bend, bend))


def inputs_of(recipe: Recipe, expected: Expectation, measured: tuple[Component, ...]) -> Inputs | None:
    """The uncertain inputs of a recipe's prediction that may be causes, in the units of their extents."""
    if expected.response is None:
        return None
    part, rig = recipe.material, recipe.uncertainty
    u = {
        "roughness along the ridges": part.u_alpha_share,
        "roughness across the ridges": part.u_alpha_share,
        "albedo of the plastic": part.u_albedo / part.albedo if part.albedo > 0.0 else 0.0,
        "seating tilt about x": rig.seating_tilt_deg,
        "seating tilt about y": rig.seating_tilt_deg,
        "light angle": rig.light_angle_deg,
    }
    known = {source: value for source, value in u.items() if source in expected.response.sources and value}
    rest = covariance_of(expected.alone + measured, rig.scale_share, len(expected.poses))
    return Inputs(expected.response, known, rest)


def background_of(max_share: float) -> tuple[float, float]:
    """Share of deviating cells on good parts, and its uncertainty.

    All that the limit allows, the less likely the nearer to it: a triangular distribution that falls to 0 at the limit
    (JCGM 100:2008, 4.3.9, one side of it).
    """
    return max_share / 3.0, float(max_share / np.sqrt(18.0))


@dataclass(frozen=True)
class Fitted:
    """How well one extent of one cause explains a part.

    Attributes:
        extent: the extent.
        u: its standard uncertainty.
        chi2: what remains unexplained.
        cost: −2 ln of the likelihood, but for what all causes share.
    """

    extent: float
    u: float
    chi2: float
    cost: float


def diagnose(known: Signatures, evidence: Evidence) -> Diagnosis:
    """Rank the causes.

    Args:
        known: the signatures of the recipe's poses.
        evidence: what was measured.

    Returns:
        The diagnosis; without any deviation "nothing" comes first.
    """
    from scipy.stats import chi2 as chi2_distribution  # noqa: PLC0415 - 1 s

    weigh = whitening(evidence.covariance)
    data = len(weigh) + (evidence.share is not None)
    rows: list[tuple[Signature | None, Fitted]] = [(None, _nothing(evidence, weigh))]
    rows += [(signature, _fitted(signature, evidence, weigh)) for signature in known.found]
    bic = np.array([fit.cost + (one is not None) * np.log(data) for one, fit in rows])
    weight = np.exp(-0.5 * (bic - bic.min()))
    weight /= weight.sum()
    order = np.argsort(bic, kind="stable")
    best, nothing = rows[order[0]], rows[0][1]
    findings = tuple(_finding(rows[k][0], rows[k][1], float(weight[k]), best[1], nothing) for k in order)
    dof = max(data - (best[0] is not None), 1)
    return Diagnosis(findings, float(chi2_distribution.sf(best[1].chi2, dof)))


def _finding(
    signature: Signature | None, fit: Fitted, weight: float, best: Fitted, nothing: Fitted
) -> Finding:
    # what fits no better than nothing at all is no cause, however little the best one explains
    explains = signature is None or nothing.cost - fit.cost > _SAME
    tie = fit is best or (fit.cost - best.cost < TIE and explains)
    if signature is None:
        return Finding(NOTHING, "as predicted", "", 0.0, 0.0, False, fit.chi2, weight, tie)
    at_bound = fit.extent in signature.bounds and fit.extent != 0.0
    cause = signature.cause
    return Finding(cause.name, cause.title, cause.unit, fit.extent, fit.u, at_bound, fit.chi2, weight, tie)


def whitening(covariance: FloatArray) -> FloatArray:
    """W with WᵀW = V⁻¹ within the range of V: (rank, P)."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > max(values[-1], 0.0) * values.size * np.finfo(np.float64).eps
    return np.asarray((vectors[:, kept] / np.sqrt(values[kept])).T)


def _nothing(evidence: Evidence, weigh: FloatArray) -> Fitted:
    chi2 = float(np.sum((weigh @ evidence.deviation) ** 2))
    cost = chi2
    if evidence.share is not None:
        variance = share_variance(np.zeros(1), evidence.u_share, evidence.u_background)[0]
        off = float((evidence.share - evidence.background) ** 2 / variance)
        chi2, cost = chi2 + off, cost + off + float(np.log(variance))
    return Fitted(0.0, 0.0, chi2, cost)


def doubted(signature: Signature, changes: FloatArray, weigh: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What the doubt of a signature makes of whitened deviations.

    Args:
        signature: of the cause.
        changes: (E, P) changes of ln L.
        weigh: (r, P) whitening of V.

    Returns:
        (E, r, r) L with LᵀL the inverse of their covariance, and (E,) its ln determinant.
    """
    own = (signature.cause.doubt * changes) ** 2
    covariance = np.eye(len(weigh)) + np.einsum("ip,ep,jp->eij", weigh, own, weigh, optimize=True)
    root = np.linalg.cholesky(covariance)
    size = 2.0 * np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
    return np.linalg.inv(root), np.asarray(size)


def share_variance(shares: FloatArray, u_share: float, u_background: float) -> FloatArray:
    """Variances of a share of deviating cells against the (E,) shares that causes predict."""
    return np.asarray(u_share**2 + u_background**2 + SHARE_FLOOR**2 + (SHARE_RELATIVE * shares) ** 2)


def _fitted(signature: Signature, evidence: Evidence, weigh: FloatArray) -> Fitted:
    found = fit_extent(signature, evidence, weigh)
    source = signature.cause.source
    if evidence.inputs is None or source not in evidence.inputs.u:
        return found
    alone = found
    for _ in range(REWEIGHED):
        alone = fit_extent(signature, evidence, whitening(evidence.inputs.covariance(source, alone.extent)))
    return replace(found, extent=alone.extent, u=alone.u)


def fit_extent(signature: Signature, evidence: Evidence, weigh: FloatArray) -> Fitted:
    """Best extent of a cause.

    Args:
        signature: of the cause.
        evidence: what was measured.
        weigh: (r, P) whitening of its covariance.
    """
    final, size, variance = _weight(signature, evidence, weigh, 0.0)
    extent, chi2 = _least(signature, evidence, final, variance)
    known = signature.cause.doubt == 0.0 and not signature.share.any()
    for _ in range(0 if known else REWEIGHED - 1):
        final, size, variance = _weight(signature, evidence, weigh, extent)
        extent, chi2 = _least(signature, evidence, final, variance)
    slope, share_slope = signature.slope(extent)
    curvature = float(np.sum((final @ slope) ** 2))
    if evidence.share is not None:
        size += float(np.log(variance))
        curvature += share_slope**2 / variance
    u = float(1.0 / np.sqrt(curvature)) if curvature > 0.0 else float("inf")
    return Fitted(extent, u, chi2, chi2 + size)


def _weight(
    signature: Signature, evidence: Evidence, weigh: FloatArray, extent: float
) -> tuple[FloatArray, float, float]:
    """(r, P) whitening with the doubt of a cause at an extent, ln determinant, and variance of the share."""
    change, share = signature.at(np.array([extent]))
    scaled, sizes = doubted(signature, change, weigh)
    variance = share_variance(share, evidence.u_share, evidence.u_background)
    return scaled[0] @ weigh, float(sizes[0]), float(variance[0])


def _least(
    signature: Signature, evidence: Evidence, weigh: FloatArray, variance: float
) -> tuple[float, float]:
    """Extent of least squares with one weight for all extents, and what it leaves."""

    def left(changes: FloatArray, shares: FloatArray) -> FloatArray:
        chi2 = np.sum(((evidence.deviation - changes) @ weigh.T) ** 2, axis=1)
        if evidence.share is not None:
            chi2 = chi2 + (evidence.share - evidence.background - shares) ** 2 / variance
        return np.asarray(chi2)

    extents, changes, shares = signature.table
    found = left(changes, shares)
    for _ in range(FINER):
        k = int(np.argmin(found))
        fine = np.linspace(extents[max(k - 1, 0)], extents[min(k + 1, len(extents) - 1)], FINE)
        extents = np.unique(np.append(fine, extents[k]))
        found = left(*signature.at(extents))
    k = int(np.argmin(found))
    return float(extents[k]), float(found[k])
