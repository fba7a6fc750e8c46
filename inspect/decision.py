"""The verdict: guard-banded tolerances, significance over all contrasts, and the contrast map.

Precedence: INVALID > FAIL > INCONCLUSIVE > PASS. Guard band after ISO 14253-1, conformance probability after
JCGM 106:2012, §7.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.area import AreaResult, judge_area
from anisoscope.errors import MeasurementError
from anisoscope.expectation import Component, Expectation
from anisoscope.measurement import Measured
from anisoscope.recipe import ContrastKind, DecisionPart, Recipe
from anisoscope.sim.light.contrasts import Contrast, consecutive_pairs, contrasts
from anisoscope.sim.light.geometry import Pose
from anisoscope.verdict import Verdict

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PairResult:
    """One contrast, measured beside predicted.

    Attributes:
        from_deg: first stage angle.
        to_deg: second stage angle.
        tilt_deg: tilt of camera and light.
        measured: the measured contrast.
        predicted: the predicted contrast.
        u: standard uncertainty of their difference.
        tolerance: largest allowed deviation, or None.
        guard: guard band, or None.
        conformance: probability that the deviation truly lies within the tolerance, or None.
        verdict: of this pair alone; without a tolerance PASS.
    """

    from_deg: float
    to_deg: float
    tilt_deg: float
    measured: float
    predicted: float
    u: float
    tolerance: float | None
    guard: float | None
    conformance: float | None
    verdict: Verdict

    @property
    def deviation(self) -> float:
        """Measured − predicted."""
        return self.measured - self.predicted


@dataclass(frozen=True)
class BudgetRow:
    """One source of uncertainty, as its contribution to every contrast."""

    source: str
    kind: str
    contributions: tuple[float, ...]


@dataclass(frozen=True)
class Decision:
    """Verdict with everything that led to it.

    Attributes:
        verdict: of the part.
        reasons: one line each, most important first.
        pairs: the contrasts.
        d2: squared Mahalanobis distance of all deviations.
        dof: number of independent contrasts.
        p_value: probability of a larger distance for a part as predicted.
        area: the contrast map judged, or None.
        budget: sources of uncertainty, largest first.
        deviating: (cell rows, cell cols) True where a cell deviates.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    pairs: tuple[PairResult, ...]
    d2: float
    dof: int
    p_value: float
    area: AreaResult | None
    budget: tuple[BudgetRow, ...]
    deviating: npt.NDArray[np.bool_] | None


def contrast_gradient(poses: tuple[Pose, ...], radiance: FloatArray, kind: ContrastKind) -> FloatArray:
    """(pairs, P) derivative of every contrast with respect to ln L of every pose."""
    pairs = consecutive_pairs(poses)
    gradient = np.zeros((len(pairs), len(poses)))
    for row, (i, j) in enumerate(pairs):
        a, b = radiance[i], radiance[j]
        if kind == "log_ratio":
            gradient[row, [i, j]] = 1.0, -1.0
        elif kind == "difference":
            gradient[row, [i, j]] = a, -b
        else:
            slope = 2.0 * a * b / (a + b) ** 2
            gradient[row, [i, j]] = slope, -slope
    return gradient


def _values(found: tuple[Contrast, ...], kind: ContrastKind) -> FloatArray:
    return np.array([getattr(contrast, kind) for contrast in found])


def decide(expected: Expectation, measured: Measured, recipe: Recipe) -> Decision:
    """Judge a part.

    Args:
        expected: prediction with its uncertainty components.
        measured: measurement with its uncertainty components.
        recipe: the decision rule.

    Raises:
        MeasurementError: nothing is uncertain, so that nothing can be weighed.
    """
    from scipy.stats import chi2  # noqa: PLC0415 - 1 s

    rule = recipe.decision
    found = contrasts(expected.poses, measured.radiance)
    predicted = _values(contrasts(expected.poses, expected.radiance), rule.contrast)
    deviation = _values(found, rule.contrast) - predicted
    gradient = {
        "prediction": contrast_gradient(expected.poses, expected.radiance, rule.contrast),
        "measurement": contrast_gradient(expected.poses, measured.radiance, rule.contrast),
    }
    components = expected.components + measured.components
    variances = [gradient[c.kind] @ c.covariance() @ gradient[c.kind].T for c in components]
    covariance = np.sum(variances, axis=0)
    u = np.sqrt(np.diag(covariance))
    d2, dof = mahalanobis(deviation, covariance)
    p_value = float(chi2.sf(d2, dof))
    pairs = _judge_pairs(found, predicted, deviation, u, recipe)
    area, deviating = judge_area(measured, expected.poses, recipe.area, rule.coverage)
    verdict, reasons = _combine(pairs, p_value, area, rule)
    return Decision(
        verdict, reasons, pairs, d2, dof, p_value, area, _budget(components, variances), deviating
    )


def mahalanobis(deviation: FloatArray, covariance: FloatArray) -> tuple[float, int]:
    """Squared distance dᵀV⁺d within the range of V, and the rank of V.

    Raises:
        MeasurementError: V is zero: nothing would be uncertain.
    """
    values, vectors = np.linalg.eigh(covariance)
    kept = values > max(values[-1], 0.0) * values.size * np.finfo(np.float64).eps
    if not kept.any():
        raise MeasurementError(
            "no source of uncertainty is left, so that no deviation can be weighed: "
            "state some under [uncertainty] in the recipe"
        )
    return float(np.sum((deviation @ vectors[:, kept]) ** 2 / values[kept])), int(kept.sum())


def _budget(components: tuple[Component, ...], variances: list[FloatArray]) -> tuple[BudgetRow, ...]:
    rows = [
        BudgetRow(c.source, c.kind, tuple(float(v) for v in np.sqrt(np.maximum(np.diag(variance), 0.0))))
        for c, variance in zip(components, variances, strict=True)
    ]
    return tuple(sorted(rows, key=lambda row: -max(row.contributions)))


def guarded(deviation: float, u: float, tolerance: float, coverage: float) -> tuple[Verdict, float, float]:
    """Guard-banded decision on one deviation (ISO 14253-1).

    Returns:
        Verdict, guard band g = coverage·u, and the conformance probability of JCGM 106.
    """
    from scipy.special import ndtr  # noqa: PLC0415

    guard = coverage * u
    if u > 0.0:
        conformance = float(ndtr((tolerance - deviation) / u) - ndtr((-tolerance - deviation) / u))
    else:
        conformance = float(abs(deviation) <= tolerance)
    if abs(deviation) <= tolerance - guard:
        return Verdict.PASS, guard, conformance
    if abs(deviation) >= tolerance + guard:
        return Verdict.FAIL, guard, conformance
    return Verdict.INCONCLUSIVE, guard, conformance


def _judge_pairs(
    found: tuple[Contrast, ...], predicted: FloatArray, deviation: FloatArray, u: FloatArray, recipe: Recipe
) -> tuple[PairResult, ...]:
    results = []
    tolerances = recipe.tolerances()
    for k, contrast in enumerate(found):
        tolerance = None if tolerances is None else tolerances[k]
        verdict, guard, conformance = Verdict.PASS, None, None
        if tolerance is not None:
            verdict, guard, conformance = guarded(
                float(deviation[k]), float(u[k]), tolerance, recipe.decision.coverage
            )
        results.append(
            PairResult(
                contrast.from_deg,
                contrast.to_deg,
                contrast.tilt_deg,
                float(predicted[k] + deviation[k]),
                float(predicted[k]),
                float(u[k]),
                tolerance,
                guard,
                conformance,
                verdict,
            )
        )
    return tuple(results)


def _combine(
    pairs: tuple[PairResult, ...], p_value: float, area: AreaResult | None, rule: DecisionPart
) -> tuple[Verdict, tuple[str, ...]]:
    """Precedence FAIL > INCONCLUSIVE > PASS over all criteria, with a line for each that speaks."""
    name = {"log_ratio": "ln ratio", "michelson": "Michelson contrast", "difference": "difference"}[
        rule.contrast
    ]
    findings: list[tuple[Verdict, str]] = []
    for pair in pairs:
        if pair.tolerance is None or pair.guard is None:
            continue
        where = f"{name} {pair.from_deg:g}°/{pair.to_deg:g}° at tilt {pair.tilt_deg:g}°"
        line = f"{where} deviates by {pair.deviation:+.3f} (tolerance ±{pair.tolerance:g}, guard band {pair.guard:.3f})"
        findings.append((pair.verdict, line))
    if area is not None:
        line = f"{area.share:.1%} of the area deviates in the contrast map (limit {area.max_share:.1%})"
        findings.append((area.verdict, line))
    significant = p_value < rule.alpha
    line = f"all contrasts together: p = {p_value:.2g} for a part as predicted (level {rule.alpha:g})"
    fails = significant and (pairs[0].tolerance is None or rule.deviation == "fail")
    findings.append(
        (Verdict.FAIL if fails else Verdict.PASS, line + (", a significant deviation" if significant else ""))
    )
    order = [Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.PASS]
    findings.sort(key=lambda finding: order.index(finding[0]))
    verdict = findings[0][0]
    decisive = tuple(line for found, line in findings if found == verdict)
    warning = (
        ("warning: significant deviation within the tolerance",)
        if significant and verdict == Verdict.PASS
        else ()
    )
    return verdict, warning + decisive
