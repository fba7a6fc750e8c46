"""Which cause explains what was measured: least squares along every signature, ranked.

d = ln L measured − predicted has the covariance V of measurement and prediction together, with the scale of the white
reference as one more shared term. Along each signature g(e) the extent e minimises (d − g)ᵀV⁻¹(d − g), to which the
share of deviating cells adds one more datum; its uncertainty follows from the curvature there. Causes are ranked by
the Bayesian information criterion (Schwarz 1978). What lies within 3σ of the best fit and explains at least half of
what that explains is a tie, and is said to be one.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.diagnosis.signatures import Signature, Signatures
from anisoscope.expectation import Component

FloatArray = npt.NDArray[np.float64]

NOTHING = "nothing"
TIE = 9.0  # 3σ in χ² for one parameter
GRID = 201
FINE, FINER = 41, 4  # points of every finer grid between the best point's neighbours, and grids in all
SHARE_FLOOR = 0.003  # cells that deviate on one good part and not on another
SHARE_RELATIVE = 0.3  # how well a share of deviating cells is predicted: size and form of real marks vary


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a diagnosis rests on.

    Attributes:
        deviation: (P,) ln L measured − ln L predicted.
        covariance: (P, P) of it, the scale included.
        share: share of cells that deviate in the contrast map, or None.
        u_share: its standard uncertainty.
    """

    deviation: FloatArray
    covariance: FloatArray
    share: float | None = None
    u_share: float = 0.0


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
    data = len(evidence.deviation) + (evidence.share is not None)
    rows: list[tuple[Signature | None, float, float, float, int]] = [
        (None, 0.0, 0.0, _misfit(evidence, weigh, np.zeros_like(evidence.deviation), known.share), 0)
    ]
    for signature in known.found:
        extent, u, left = fit_extent(signature, evidence, weigh)
        rows.append((signature, extent, u, left, 1))
    bic = np.array([left + free * np.log(data) for *_, left, free in rows])
    weight = np.exp(-0.5 * (bic - bic.min()))
    weight /= weight.sum()
    order = np.argsort(bic, kind="stable")
    best = rows[order[0]]
    findings = tuple(_finding(rows[k], float(weight[k]), best, rows[0][3]) for k in order)
    dof = max(data - best[4], 1)
    return Diagnosis(findings, float(chi2_distribution.sf(best[3], dof)))


def _finding(
    row: tuple[Signature | None, float, float, float, int],
    weight: float,
    best: tuple[Signature | None, float, float, float, int],
    nothing: float,
) -> Finding:
    signature, extent, u, left, _ = row
    tie = row is best or (left - best[3] < TIE and nothing - left > 0.5 * (nothing - best[3]) > 0.0)
    if signature is None:
        return Finding(NOTHING, "as predicted", "", 0.0, 0.0, False, left, weight, tie)
    low, high = signature.bounds
    at_bound = extent in (low, high) and extent != 0.0
    cause = signature.cause
    return Finding(cause.name, cause.title, cause.unit, extent, u, at_bound, left, weight, tie)


def whitening(covariance: FloatArray) -> FloatArray:
    """W with WᵀW = V⁻¹ within the range of V: (rank, P)."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > max(values[-1], 0.0) * values.size * np.finfo(np.float64).eps
    return np.asarray((vectors[:, kept] / np.sqrt(values[kept])).T)


def _misfit(evidence: Evidence, weigh: FloatArray, change: FloatArray, share: float) -> float:
    chi2 = float(np.sum((weigh @ (evidence.deviation - change)) ** 2))
    if evidence.share is not None:
        chi2 += ((evidence.share - share) / share_spread(share, evidence.u_share)) ** 2
    return chi2


def _misfits(signature: Signature, evidence: Evidence, weigh: FloatArray, extents: FloatArray) -> FloatArray:
    """(E,) χ² that a cause leaves at each of several extents."""
    changes, shares = signature.at(extents)
    left = np.sum(((evidence.deviation - changes) @ weigh.T) ** 2, axis=1)
    if evidence.share is not None:
        spreads = np.sqrt(evidence.u_share**2 + SHARE_FLOOR**2 + (SHARE_RELATIVE * shares) ** 2)
        left = left + ((evidence.share - shares) / spreads) ** 2
    return np.asarray(left)


def share_spread(share: float | FloatArray, u_share: float) -> float:
    """Standard uncertainty of a share of deviating cells against the share that a cause predicts."""
    return float(np.sqrt(u_share**2 + SHARE_FLOOR**2 + (SHARE_RELATIVE * np.max(share)) ** 2))


def fit_extent(signature: Signature, evidence: Evidence, weigh: FloatArray) -> tuple[float, float, float]:
    """Best extent of a cause, its standard uncertainty, and the χ² that it leaves."""
    low, high = signature.bounds
    grid = np.unique(np.concatenate([np.linspace(low, high, GRID), signature.extents]))
    extent, best = float(grid[0]), float("inf")
    for _ in range(FINER):
        left = _misfits(signature, evidence, weigh, grid)
        k = int(np.argmin(left))
        extent, best = float(grid[k]), float(left[k])
        beside = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
        grid = np.unique(np.append(np.linspace(*beside, FINE), extent))
    slope, share_slope = signature.slope(extent)
    curvature = float(np.sum((weigh @ slope) ** 2))
    if evidence.share is not None:
        _, share = signature.at(extent)
        curvature += (share_slope / share_spread(float(share), evidence.u_share)) ** 2
    return extent, float(1.0 / np.sqrt(curvature)) if curvature > 0.0 else float("inf"), best
