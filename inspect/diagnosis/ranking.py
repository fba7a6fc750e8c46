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
well. Ties are by the likelihood alone.

Where no single cause explains the part, pairs of the likeliest ones are fitted together, with the penalty of two
extents and the prior probability `PAIR_PRIOR` of two causes at once. Another plastic or lamp than the recipe's is one
more hypothesis: roughnesses, albedo, light angle and tail of the lobe all differ somewhat
(`anisoscope.diagnosis.likelihood.another_plastic`). So is "something else", which changes every pose by itself,
normally with `SOMETHING_ELSE` in ln L: where it is likelier than all causes, none of them has a large weight. All
causes together have no larger weight than the best of them is believable: 1 where what it leaves unexplained is
likely, and in proportion to its probability below `BELIEVABLE`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from anisoscope.base.significance import chi2_tail, f_tail
from anisoscope.diagnosis.evidence import Evidence
from anisoscope.diagnosis.likelihood import (
    Fitted,
    FittedPair,
    FittedPlastic,
    another_plastic,
    fit_extent,
    fit_pair,
    interval,
    nothing,
    pair_interval,
    unspecific,
)
from anisoscope.diagnosis.rig_causes import RigFault
from anisoscope.diagnosis.signatures import Signature, Signatures
from anisoscope.record.schema import CauseRecord, ComponentRecord

NOTHING = "nothing"
OTHER = "something-else"
PLASTIC = "plastic-or-lamp"
SOMETHING_ELSE = 0.3
"""Standard deviation of ln L in each pose by an unknown cause; of the share of deviating cells a third of it."""
BELIEVABLE = 0.01
"""Probability of what a cause leaves unexplained below which it is doubted."""
PAIR_PRIOR = 0.1
"""Prior probability that a second cause acts together with a first one."""
PAIRED = 6
"""The likeliest causes of which pairs are made."""
PAIRS_SHOWN = 3
TIE = 9.0  # 3σ in χ² for one parameter
_SAME = 1e-9


@dataclass(frozen=True)
class Diagnosis:
    """All causes, the best first.

    Attributes:
        causes: ranked causes, "nothing" among them.
        unexplained_p: p value of the residual χ² of the best; small: none of the causes explains the part.
        fault: the fault of the rig that explains the part as well as the best cause or better, or None.
        ahead: −2 ln of the likelihoods by which it explains the part better than the best cause.
    """

    causes: tuple[CauseRecord, ...]
    unexplained_p: float
    fault: RigFault | None = None
    ahead: float = 0.0

    @property
    def ties(self) -> tuple[CauseRecord, ...]:
        """The best cause and those that cannot be separated from it."""
        return tuple(cause for cause in self.causes if cause.tie)


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """A hypothesis with its fit: none, one or two causes, another plastic, or a fault of the rig.

    ``cost`` is −2 ln of the likelihood, ``bic`` with the penalty of its extents and the prior, ``compared`` what ties
    are counted by: the likelihood, and of a pair with the penalty of its second extent.
    """

    causes: tuple[Signature, ...]
    fit: Fitted | FittedPair | FittedPlastic
    bic: float
    compared: float
    extents: int
    fault: RigFault | None = None


def diagnose(
    known: Signatures, evidence: Evidence, faults: Sequence[RigFault] = (), *, together: bool = True
) -> Diagnosis:
    """Rank the causes.

    Args:
        known: the signatures of the recipe's poses.
        evidence: what was measured.
        faults: of the rig, fitted, that compete.
        together: consider two causes together; not where causes are so alike that two of them explain anything.

    Returns:
        The diagnosis; without any deviation "nothing" comes first.
    """
    data = evidence.data
    good = nothing(evidence)
    rows = [_Hypothesis((), good, good.cost, good.cost, 0)]
    rows += [_single(signature, evidence, data) for signature in known.found]
    rows += [_of_rig(fault, data) for fault in faults]
    rows.sort(key=lambda row: row.bic)
    if together and _left(rows[0], data, evidence) < BELIEVABLE:
        rows += _pairs(rows, evidence, data)
    if (plastic := another_plastic(known, evidence)) is not None:
        rows.append(_Hypothesis((), plastic, plastic.cost, plastic.cost, 0))
    rows.sort(key=lambda row: row.bic)
    bic = np.array([row.bic for row in rows])
    other = unspecific(evidence, SOMETHING_ELSE)
    left = _left(rows[0], data, evidence)
    weight = np.exp(-0.5 * (np.append(bic, other.cost) - min(bic[0], other.cost)))
    weight /= weight.sum()
    weight[:-1] *= min(1.0, left / BELIEVABLE / max(weight[:-1].sum(), 1e-300))
    weight[-1] = 1.0 - weight[:-1].sum()
    nearest = min(row.compared for row in rows)
    causes = [
        _record(row, share, tie=_ties(row, rows[0], nearest, good.cost), known=known, evidence=evidence)
        for row, share in zip(rows, weight[:-1], strict=True)
    ]
    place = int(np.count_nonzero(bic <= other.cost))
    causes.insert(max(place, 1), _without_severity(OTHER, _OTHER_TITLE, weight[-1], other.chi2))
    return Diagnosis(tuple(causes), left, *_rival(rows, good.cost, data, evidence))


def _of_rig(fault: RigFault, data: int) -> _Hypothesis:
    compared = fault.fit.cost + fault.penalty
    bic = compared + fault.extents * float(np.log(data))
    return _Hypothesis((), fault.fit, bic, compared, fault.extents, fault)


def _rival(
    rows: Sequence[_Hypothesis], good: float, data: int, evidence: Evidence
) -> tuple[RigFault | None, float]:
    """The fault of the rig that ties with the best cause or beats it, and by how much; it must explain the part."""
    others = min((row.compared for row in rows if row.fault is None), default=good)
    for row in sorted((row for row in rows if row.fault is not None), key=lambda row: row.compared):
        ahead = others - row.compared
        if ahead > -TIE and good - row.compared > TIE and _left(row, data, evidence) >= BELIEVABLE:
            return row.fault, ahead
    return None, 0.0


_OTHER_TITLE = "something else: none of these causes"


def _single(signature: Signature, evidence: Evidence, data: int) -> _Hypothesis:
    fit = _fitted(signature, evidence)
    bic = fit.cost + float(np.log(data)) + _prior_cost(signature, fit.extent, evidence)
    return _Hypothesis((signature,), fit, bic, fit.cost, 1)


def _pairs(rows: Sequence[_Hypothesis], evidence: Evidence, data: int) -> list[_Hypothesis]:
    """The likeliest pairs of the best single causes, where none of these explains the part."""
    single = [row.causes[0] for row in rows if row.causes][:PAIRED]
    found = []
    for pair in combinations(single, 2):
        fit = fit_pair(pair, evidence)
        second = float(np.log(data)) - 2.0 * float(np.log(PAIR_PRIOR))
        bic = fit.cost + float(np.log(data)) + second
        bic += sum(_prior_cost(one, extent, evidence) for one, extent in zip(pair, fit.extents, strict=True))
        found.append(_Hypothesis(pair, fit, bic, fit.cost + second, 2))
    return sorted(found, key=lambda row: row.bic)[:PAIRS_SHOWN]


def _prior_cost(signature: Signature, extent: float, evidence: Evidence) -> float:
    """−2 ln of the prior of a position that the recipe bounds."""
    if signature.cause.group != "rig" or evidence.inputs is None:
        return 0.0
    u = next((evidence.inputs.u.get(source, 0.0) for source in signature.cause.sources), 0.0)
    return 2.0 * float(np.log1p((extent / u) ** 2)) if u > 0.0 else 0.0


def _left(row: _Hypothesis, data: int, evidence: Evidence) -> float:
    """Probability that chance leaves more than a hypothesis does."""
    return _chance(row.fit.chi2, max(data - row.extents, 1), evidence)


def _chance(left: float, dof: int, evidence: Evidence) -> float:
    """Probability of a greater distance: χ², or F if golden parts estimate the covariance."""
    if evidence.learnt is None:
        return float(chi2_tail(left, dof))
    free = max(evidence.learnt.freedom, float(dof))
    return float(f_tail(left * (free - dof + 1.0) / (free * dof), dof, free - dof + 1.0))


def _ties(row: _Hypothesis, best: _Hypothesis, nearest: float, good: float) -> bool:
    """Whether the data separate a hypothesis from the best one.

    A cause that fits no better than "nothing" is excluded, however little the best one explains.
    """
    return row is best or (row.compared - nearest < TIE and (not row.extents or good - row.compared > _SAME))


def _record(
    row: _Hypothesis, weight: float, *, tie: bool, known: Signatures, evidence: Evidence
) -> CauseRecord:
    fit = row.fit
    if isinstance(fit, FittedPlastic):
        titles = {
            one.cause.name: one for one in (*known.found, *(() if known.tail is None else (known.tail,)))
        }
        parts = tuple(
            _component(
                titles[name], float(extent), float(u), (float(extent - 2.0 * u), float(extent + 2.0 * u))
            )
            for name, extent, u in zip(fit.names, fit.extents, fit.u, strict=True)
        )
        title = _PLASTIC_TITLE if evidence.learnt is None else _PLASTIC_OF_PARTS
        return _without_severity(PLASTIC, title, weight, fit.chi2, tie=tie, components=parts)
    if isinstance(fit, FittedPair):
        one, other = row.causes
        alone = fit_pair((one, other), evidence, as_input=True)
        parts = tuple(
            _component(
                signature,
                alone.extents[k],
                alone.u[k],
                pair_interval((one, other), evidence, alone, k),
            )
            for k, signature in enumerate(row.causes)
        )
        name, title = (
            f"{one.cause.name}+{other.cause.name}",
            " and ".join(bare_title(s.cause.title) for s in row.causes),
        )
        return _without_severity(name, title, weight, fit.chi2, tie=tie, components=parts)
    if row.fault is not None:
        found = _without_severity(row.fault.name, row.fault.title, weight, fit.chi2, tie=tie)
        return found.model_copy(update={"severity": row.fault.fit.extent})
    if not row.causes:
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
    signature = row.causes[0]
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


_PLASTIC_TITLE = "the plastic or the lamp differs from the recipe"
_PLASTIC_OF_PARTS = "the plastic or the lamp differs from that of the parts compared with"


def bare_title(title: str) -> str:
    """Title of a cause without its severity."""
    return title.removesuffix(" by").removesuffix(",")


def _component(
    signature: Signature, extent: float, u: float, within: tuple[float | None, float | None]
) -> ComponentRecord:
    cause = signature.cause
    return ComponentRecord(
        cause=cause.name,
        title=cause.title,
        unit=cause.unit,
        severity=extent,
        u=u if np.isfinite(u) else None,
        interval=within,
    )


def _without_severity(
    name: str,
    title: str,
    weight: float,
    chi2: float,
    *,
    tie: bool = False,
    components: tuple[ComponentRecord, ...] = (),
) -> CauseRecord:
    """Hypothesis without an extent."""
    return CauseRecord(
        cause=name,
        title=title,
        unit="",
        severity=0.0,
        u=None,
        interval=None,
        weight=weight,
        chi2=chi2,
        at_bound=False,
        tie=tie,
        components=components,
    )


def _fitted(signature: Signature, evidence: Evidence) -> Fitted:
    """Likelihood with the full covariance, so that causes compare; extent without the inputs identical with it."""
    found = fit_extent(signature, evidence)
    if evidence.inputs is None or not set(signature.cause.sources) & set(evidence.inputs.u):
        return found
    alone = fit_extent(signature, evidence, as_input=True)
    return replace(found, extent=alone.extent, u=alone.u)
