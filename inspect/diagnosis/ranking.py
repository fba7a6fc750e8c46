"""Ranking of the causes of a deviation by the maximum likelihood along every signature.

d = ln L measured − predicted has the covariance V of measurement and prediction together, with the scale of the white
reference as one more shared term, and the error of the signature, independent in every pose. Along each signature g(e)
the extent e of maximum likelihood is found (`anisoscope.diagnosis.likelihood`); the share of deviating cells adds one
more datum. Causes are ranked by the Bayesian information criterion (Schwarz 1978). Causes within 3σ of the best are
reported as ties. An extent that is also an input of the prediction, such as a roughness, is then fitted again without
the uncertainty of that input in V. With golden parts d is the distance from their mean, and V combines their scatter
with the budget (`anisoscope.diagnosis.evidence.Learnt`).

A position of part or lamp that the recipe bounds by a standard uncertainty u has a prior: Cauchy's distribution of
scale u, whose tails allow a part that is not pressed home, but rank it behind a defect that explains the poses as
well. Ties are by the likelihood alone. One more hypothesis, "something else", changes every pose by itself, normally
with `SOMETHING_ELSE` in ln L: where it is likelier than all causes, none of them has a large weight.
"""

from dataclasses import dataclass, replace

import numpy as np

from anisoscope.diagnosis.evidence import Evidence
from anisoscope.diagnosis.likelihood import Fitted, fit_extent, interval, nothing, unspecific
from anisoscope.diagnosis.signatures import Signature, Signatures
from anisoscope.record.schema import CauseRecord

NOTHING = "nothing"
OTHER = "something-else"
SOMETHING_ELSE = 0.3
"""Standard deviation of ln L in each pose by an unknown cause; of the share of deviating cells a third of it."""
TIE = 9.0  # 3σ in χ² for one parameter
_SAME = 1e-9


@dataclass(frozen=True)
class Diagnosis:
    """All causes, the best first.

    Attributes:
        causes: ranked causes, "nothing" among them.
        unexplained_p: p value of the residual χ² of the best; small: none of the causes explains the part.
    """

    causes: tuple[CauseRecord, ...]
    unexplained_p: float

    @property
    def ties(self) -> tuple[CauseRecord, ...]:
        """The best cause and those that cannot be separated from it."""
        return tuple(cause for cause in self.causes if cause.tie)


def diagnose(known: Signatures, evidence: Evidence) -> Diagnosis:
    """Rank the causes.

    Args:
        known: the signatures of the recipe's poses.
        evidence: what was measured.

    Returns:
        The diagnosis; without any deviation "nothing" comes first.
    """
    data = len(evidence.deviation) + (evidence.share is not None)
    rows: list[tuple[Signature | None, Fitted]] = [(None, nothing(evidence))]
    rows += [(signature, _fitted(signature, evidence)) for signature in known.found]
    bic = np.array([fit.cost + _penalty(one, fit, evidence, data) for one, fit in rows])
    other = unspecific(evidence, SOMETHING_ELSE)
    weight = np.exp(-0.5 * (np.append(bic, other.cost) - min(bic.min(), other.cost)))
    weight /= weight.sum()
    order = np.argsort(bic, kind="stable")
    best, good = rows[order[0]], rows[0][1]
    nearest = min((rows[k][1] for k in order), key=lambda fit: fit.cost)
    causes = [_cause(rows[k], weight[k], best[1], nearest, good, evidence) for k in order]
    place = int(np.count_nonzero(bic <= other.cost))
    causes.insert(max(place, 1), _something_else(other, weight[-1]))
    dof = max(data - (best[0] is not None), 1)
    return Diagnosis(tuple(causes), _chance(best[1].chi2, dof, evidence))


def _penalty(signature: Signature | None, fit: Fitted, evidence: Evidence, data: int) -> float:
    """Penalty of a free extent by BIC, and −2 ln of the prior of a position that the recipe bounds."""
    if signature is None:
        return 0.0
    penalty = float(np.log(data))
    if signature.cause.group == "rig" and evidence.inputs is not None:
        u = evidence.inputs.u.get(signature.cause.source, 0.0)
        penalty += 2.0 * float(np.log1p((fit.extent / u) ** 2)) if u > 0.0 else 0.0
    return penalty


def _something_else(fit: Fitted, weight: float) -> CauseRecord:
    return CauseRecord(
        cause=OTHER,
        title="something else: none of these causes",
        unit="",
        severity=0.0,
        u=None,
        interval=None,
        weight=weight,
        chi2=fit.chi2,
        at_bound=False,
        tie=False,
    )


def _chance(left: float, dof: int, evidence: Evidence) -> float:
    """Probability of a greater distance: χ², or Hotelling's T² if golden parts estimate the covariance."""
    from scipy.stats import chi2, f  # noqa: PLC0415 - 1 s

    if evidence.learnt is None:
        return float(chi2.sf(left, dof))
    free = evidence.learnt.freedom
    return float(f.sf(left * (free - dof + 1.0) / (free * dof), dof, free - dof + 1.0))


def _cause(
    row: tuple[Signature | None, Fitted],
    weight: float,
    first: Fitted,
    nearest: Fitted,
    good: Fitted,
    evidence: Evidence,
) -> CauseRecord:
    signature, fit = row
    # a cause that fits no better than "nothing" is excluded, however little the best one explains
    explains = signature is None or good.cost - fit.cost > _SAME
    tie = fit is first or (fit.cost - nearest.cost < TIE and explains)
    if signature is None:
        return CauseRecord(
            cause=NOTHING,
            title="as predicted",
            unit="",
            severity=0.0,
            u=0.0,
            interval=(0.0, 0.0),
            weight=weight,
            chi2=fit.chi2,
            at_bound=False,
            tie=tie,
        )
    return CauseRecord(
        cause=signature.cause.name,
        title=signature.cause.title,
        unit=signature.cause.unit,
        severity=fit.extent,
        u=fit.u if np.isfinite(fit.u) else None,
        interval=interval(signature, evidence, fit),
        weight=weight,
        chi2=fit.chi2,
        at_bound=fit.extent in signature.bounds and fit.extent != 0.0,
        tie=tie,
    )


def _fitted(signature: Signature, evidence: Evidence) -> Fitted:
    """Likelihood with the full covariance, so that causes compare; extent without the input identical with it."""
    found = fit_extent(signature, evidence)
    if evidence.inputs is None or signature.cause.source not in evidence.inputs.u:
        return found
    alone = fit_extent(signature, evidence, as_input=True)
    return replace(found, extent=alone.extent, u=alone.u)
