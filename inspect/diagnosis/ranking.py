"""Ranking of the causes of a deviation by the maximum likelihood along every signature.

d = ln L measured − predicted has the covariance V of measurement and prediction together, with the scale of the white
reference as one more shared term, and the doubt of the signature, independent in every pose. Along each signature g(e)
the extent e of maximum likelihood is found (`anisoscope.diagnosis.likelihood`), to which the share of deviating cells
adds one more datum. Causes are ranked by the Bayesian information criterion (Schwarz 1978). Causes within 3σ of the
best are reported as ties. An extent that is an input of the prediction too, such as a roughness, is then fitted again
without the uncertainty of that input in V. With golden parts d is the distance from their mean, and V combines their
scatter with the budget (`anisoscope.diagnosis.evidence.Learnt`).
"""

from dataclasses import dataclass, replace

import numpy as np

from anisoscope.diagnosis.evidence import Evidence
from anisoscope.diagnosis.likelihood import Fitted, fit_extent, interval, nothing
from anisoscope.diagnosis.signatures import Signature, Signatures
from anisoscope.record.schema import CauseRecord

NOTHING = "nothing"
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
    bic = np.array([fit.cost + (one is not None) * np.log(data) for one, fit in rows])
    weight = np.exp(-0.5 * (bic - bic.min()))
    weight /= weight.sum()
    order = np.argsort(bic, kind="stable")
    best, good = rows[order[0]], rows[0][1]
    causes = tuple(_cause(rows[k], weight[k], best[1], good, evidence) for k in order)
    dof = max(data - (best[0] is not None), 1)
    return Diagnosis(causes, _chance(best[1].chi2, dof, evidence))


def _chance(left: float, dof: int, evidence: Evidence) -> float:
    """Probability of a greater distance: χ², or Hotelling's T² if golden parts estimate the covariance."""
    from scipy.stats import chi2, f  # noqa: PLC0415 - 1 s

    if evidence.learnt is None:
        return float(chi2.sf(left, dof))
    free = evidence.learnt.freedom
    return float(f.sf(left * (free - dof + 1.0) / (free * dof), dof, free - dof + 1.0))


def _cause(
    row: tuple[Signature | None, Fitted], weight: float, best: Fitted, good: Fitted, evidence: Evidence
) -> CauseRecord:
    signature, fit = row
    # a cause that fits no better than "nothing" is excluded, however little the best one explains
    explains = signature is None or good.cost - fit.cost > _SAME
    tie = fit is best or (fit.cost - best.cost < TIE and explains)
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
