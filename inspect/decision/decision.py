"""The verdict: guard-banded tolerances, significance over all contrasts, and the contrast map.

Precedence: INVALID > FAIL > INCONCLUSIVE > PASS. Guard band after ISO 14253-1, conformance probability after
JCGM 106:2012, §7. Whether the part deviates at all is decided by the means of all poses together; marks in the map by
the share of the area that they cover, because no two maps have the same scatter.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.notation import contrast_name, p_value_text, quantity_name
from anisoscope.base.significance import holm, joint_conformance, two_sided
from anisoscope.decision.consistency import from_prediction, golden_test, scatter_of
from anisoscope.decision.exclusion import Exclusion, open_defects, with_exclusions
from anisoscope.decision.predictive import Direction, PredictiveTest
from anisoscope.decision.reference_parts import GoldenSet, counted
from anisoscope.decision.surface_exclusion import excluded_of, lacking_text, parts_needed, remedy_text
from anisoscope.imaging.defect_regions import find_regions
from anisoscope.imaging.deviation_map import CROWDED, CellMap, cell_map, judge_area
from anisoscope.imaging.part_form import FormDeviation
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.parameters.geometry import Pose
from anisoscope.prediction.expectation import Component, Expectation
from anisoscope.prediction.part_scatter import PartScatter
from anisoscope.recipe.surface import ContrastKind, DecisionPart, SurfaceRecipe
from anisoscope.record.schema import (
    AreaRecord,
    BudgetRecord,
    ContrastRecord,
    FormRecord,
    RegionRecord,
    TiltContrastRecord,
)
from anisoscope.record.verdict import Verdict
from anisoscope.sim.light.contrasts import Contrast, consecutive_pairs, contrasts

Pairs = Sequence[tuple[int, int]]


@dataclass(frozen=True)
class Decision:
    """Verdict with its reasons and test results.

    Attributes:
        verdict: of the part.
        reasons: one line each, most important first.
        contrasts: the contrasts of consecutive stage angles.
        d2: squared Mahalanobis distance of all deviations from the prediction; with golden parts T² from their mean.
        dof: number of independent contrasts.
        p_value: probability of a larger distance for a part as predicted (or as the golden parts).
        reference: good parts compared with, or the parts of the lot that are alike; None for none.
        conformance_probability: that all deviations truly lie within their tolerances, or None.
        area: the result for the contrast map, or None.
        regions: groups of deviating cells, the least probable first.
        budget: sources of uncertainty, largest first.
        cells: the contrast map, or None without a limit of the area.
        deviating: (cell rows, cell cols) True where a cell deviates.
        between_tilts: the contrasts between tilts, informative: the joint test already includes them.
        predictive: the test against golden parts by the stated scatter, or None.
        exclusions: largest sizes of the named defects that the part may have, one at a time; none where no response is
            known, or the part deviates.
        form: largest lean of the facets over several ridges, judged; None where unknown or without a limit.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    contrasts: tuple[ContrastRecord, ...]
    d2: float
    dof: int
    p_value: float
    reference: GoldenSet | None
    conformance_probability: float | None
    area: AreaRecord | None
    regions: tuple[RegionRecord, ...]
    budget: tuple[BudgetRecord, ...]
    cells: CellMap | None
    deviating: npt.NDArray[np.bool_] | None
    between_tilts: tuple[TiltContrastRecord, ...]
    predictive: PredictiveTest | None = None
    exclusions: tuple[Exclusion, ...] = ()
    form: FormRecord | None = None

    @property
    def golden(self) -> int:
        """Number of parts compared with."""
        return 0 if self.reference is None else len(self.reference.parts)


def contrast_gradient(poses: tuple[Pose, ...], radiance: FloatArray, kind: ContrastKind) -> FloatArray:
    """(pairs, P) derivative of every contrast with respect to ln L of every pose."""
    return pair_gradient(consecutive_pairs(poses), radiance, kind)


def _values(found: tuple[Contrast, ...], kind: ContrastKind) -> FloatArray:
    return np.array([getattr(contrast, kind) for contrast in found])


def decide(
    expected: Expectation,
    measured: Measured,
    recipe: SurfaceRecipe,
    golden: GoldenSet | None = None,
    parts: PartScatter | None = None,
    *,
    exclude: bool = True,
    waiting: bool = False,
    left_out: tuple[str, ...] = (),
    form: FormDeviation | None = None,
) -> Decision:
    """Decide on a part.

    Args:
        expected: prediction with its uncertainty components.
        measured: measurement with its uncertainty components.
        recipe: the decision rule.
        golden: golden parts as the reference for the significance, instead of the prediction.
        parts: how good parts scatter, and what defects change; without it the golden parts' own scatter alone counts,
            and no defect is excluded.
        exclude: find out which defects are excluded of a part that does not deviate.
        waiting: the part is of a lot of which too few others are known.
        left_out: serial numbers of parts of the lot that deviate from the others.
        form: largest departure of the facets' lean from a plane, where it is known.

    Raises:
        MeasurementError: no uncertainty is stated, so that no distance is defined; or too few golden parts.
    """
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
    covariance = np.asarray(np.sum(variances, axis=0))
    u = np.sqrt(np.diag(covariance))
    predictive: PredictiveTest | None = None
    scatter = None if parts is None else scatter_of(parts, measured)
    if golden is None:
        d2, dof, p_value = from_prediction(expected, measured)
    else:
        d2, dof, p_value, predictive = golden_test(
            scatter, expected, measured, golden.contrasts(), rule.alpha, golden.batches, golden.varies
        )
    of_lot = golden is not None and golden.lot is not None
    decisive = golden
    if of_lot:  # a deviation of the whole lot shows against the prediction alone
        alone = from_prediction(expected, measured)[2]
        p_value, decisive = min(2.0 * min(p_value, alone), 1.0), golden if p_value <= alone else None
    pairs = _judge_pairs(found, predicted, deviation, u, recipe)
    cells = None if recipe.area is None else cell_map(measured, recipe)
    if cells is not None and golden is not None and not of_lot:
        cells = cells.by(golden.cell_limits)
    area, deviating = judge_area(measured, cells, recipe.area, rule.coverage)
    most = None if recipe.area is None else recipe.area.max_lean_deg
    shape = None if form is None or most is None else form.record(most, rule.coverage)
    regions = () if cells is None else find_regions(cells, measured.grid)
    where = "; ".join(_where(pairs, rule.alpha)) or ", ".join(
        deviating_between_tilts(expected, measured, rule.alpha)
    )
    named = predictive if decisive is not None else None
    like = None if named is None else named.strongest
    words = "as predicted" if decisive is None else decisive.words
    verdict, reasons = _combine(pairs, p_value, area, shape, rule, words, where, like)
    verdict, reasons = _with_marks(verdict, reasons, measured, cells)
    if verdict is Verdict.PASS and (
        blind := _blind(predictive, recipe, 0 if golden is None else len(golden.parts))
    ):
        verdict, reasons = Verdict.INCONCLUSIVE, (blind, *reasons)
    exclusions: tuple[Exclusion, ...] = ()
    common = exclusions
    if exclude:
        deviates = p_value < rule.alpha
        if not deviates:
            exclusions, common = excluded_of(expected, measured, recipe, golden, parts, predictive)
        still_open = {one.defect.name for one in open_defects(exclusions)}
        needed, compares = parts_needed(still_open, scatter, parts, recipe), rule.compare_with_lot
        verdict, reasons = with_exclusions(
            verdict,
            reasons,
            exclusions,
            rule.unexcluded,
            remedy_text(expected, golden, needed, of_lot=of_lot or waiting, compares=compares),
            lacking_text(expected, golden, deviates=deviates),
        )
    if golden is not None and golden.unjudged:
        reasons = (*reasons, golden.of_the_lot(left_out, common))
    tolerances = recipe.tolerances()
    conformance = (
        None if tolerances is None else joint_conformance(deviation, covariance, np.array(tolerances))
    )
    return Decision(
        verdict,
        reasons,
        pairs,
        d2,
        dof,
        p_value,
        golden,
        conformance,
        area,
        regions,
        _budget(components, variances),
        cells,
        deviating,
        between_tilts(expected, measured, rule.contrast),
        predictive,
        exclusions,
        shape,
    )


def _blind(predictive: PredictiveTest | None, recipe: SurfaceRecipe, golden: int) -> str | None:
    """Why a PASS would say too little: a defect that the recipe wants found is too likely to be missed."""
    power = recipe.defects.power
    if power is None:
        return None
    if predictive is None:
        return (
            f"defects.power = {power:g} is known only against golden parts by the stated scatter: add one, or "
            "leave the key out"
        )
    missed = [one for one in predictive.directions if one.power < power]
    if not missed:
        return None
    worst = min(missed, key=lambda one: one.power)
    return (
        f"{worst.defect} would be found in {worst.power:.0%} of parts only, {power:.0%} are required (defects.power): "
        f"{counted(golden, 'golden part')} and these poses find {worst.detectable:.1f} times that size in 9 of 10 parts"
    )


def _budget(components: tuple[Component, ...], variances: list[FloatArray]) -> tuple[BudgetRecord, ...]:
    rows = [
        BudgetRecord(
            source=c.source,
            kind=c.kind,
            contributions=tuple(np.sqrt(np.maximum(np.diag(variance), 0.0))),
        )
        for c, variance in zip(components, variances, strict=True)
    ]
    return tuple(sorted(rows, key=lambda row: -max(row.contributions)))


def guarded(deviation: float, u: float, tolerance: float, coverage: float) -> tuple[Verdict, float, float]:
    """Guard-banded decision on one deviation (ISO 14253-1).

    Returns:
        Verdict, guard band g = coverage·u, and the conformance probability of JCGM 106.
    """
    from scipy.special import ndtr  # noqa: PLC0415 - start-up time

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
    found: tuple[Contrast, ...],
    predicted: FloatArray,
    deviation: FloatArray,
    u: FloatArray,
    recipe: SurfaceRecipe,
) -> tuple[ContrastRecord, ...]:
    results = []
    tolerances = recipe.tolerances()
    z = np.divide(deviation, u, out=np.where(deviation == 0.0, 0.0, np.inf), where=u > 0.0)
    adjusted = holm(two_sided(z))
    for k, contrast in enumerate(found):
        tolerance = None if tolerances is None else tolerances[k]
        verdict, guard, conformance = Verdict.PASS, None, None
        if tolerance is not None:
            verdict, guard, conformance = guarded(
                float(deviation[k]), float(u[k]), tolerance, recipe.decision.coverage
            )
        results.append(
            ContrastRecord(
                from_deg=contrast.from_deg,
                to_deg=contrast.to_deg,
                tilt_deg=contrast.tilt_deg,
                kind=recipe.decision.contrast,
                measured=predicted[k] + deviation[k],
                predicted=predicted[k],
                u=u[k],
                tolerance=tolerance,
                guard=guard,
                conformance_probability=conformance,
                verdict=verdict,
                p_value=adjusted[k],
                tolerance_ratio=None if tolerance is None or u[k] == 0.0 else tolerance / (2.0 * u[k]),
            )
        )
    return tuple(results)


def _combine(
    pairs: tuple[ContrastRecord, ...],
    p_value: float,
    area: AreaRecord | None,
    form: FormRecord | None,
    rule: DecisionPart,
    alike: str,
    where: str,
    like: Direction | None,
) -> tuple[Verdict, tuple[str, ...]]:
    """Precedence FAIL > INCONCLUSIVE > PASS over all criteria, with a line for each that contributes.

    ``alike`` says what a good part is, ``where`` names the individually significant contrasts, ``like`` is the named
    defect whose score decides.
    """
    findings = [(pair.verdict, _of_tolerance(pair, rule)) for pair in pairs if pair.tolerance is not None]
    if area is not None:
        line = f"{area.share:.1%} of the area deviates in the contrast map (limit {area.max_share:.1%})"
        findings.append((area.verdict, line))
        if area.max_length_um is not None:
            findings.append((Verdict.FAIL if area.too_long else Verdict.PASS, _of_length(area)))
    if form is not None:
        findings.append((form.verdict, _of_form(form)))
    significant = p_value < rule.alpha
    fails = significant and (pairs[0].tolerance is None or rule.deviation == "fail")
    line = f"all contrasts together: p {p_value_text(p_value)} for a part {alike} (level {rule.alpha:g})"
    if significant and like is not None:
        line = f"{line}, a significant deviation like that of {like.defect} (score {like.score:.1f})"
    elif significant:
        off = where or "several together, of none by itself"
        line = f"{line}, a significant deviation of {off}"
    findings.append((Verdict.FAIL if fails else Verdict.PASS, line))
    order = [Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.PASS]
    findings.sort(key=lambda finding: order.index(finding[0]))
    verdict = findings[0][0]
    decisive = tuple(line for found, line in findings if found == verdict)
    warn = significant and verdict == Verdict.PASS
    return verdict, (("warning: significant deviation within the tolerance",) if warn else ()) + decisive


def _with_marks(
    verdict: Verdict, reasons: tuple[str, ...], measured: Measured, cells: CellMap | None
) -> tuple[Verdict, tuple[str, ...]]:
    """The same where marks cover much of the part, or saturate a pose."""
    if cells is not None and cells.over > CROWDED and verdict is Verdict.FAIL:
        crowded = (
            "so many cells deviate that only the calmest quarter of each pitch shows the texture of a good part: the "
            "share of the area is a lower bound"
        )
        reasons = (*reasons, crowded)
    if measured.mirroring is None:
        return verdict, reasons
    own = reasons if verdict is Verdict.FAIL else ()
    return Verdict.FAIL, (_of_mirroring(measured.mirroring), *own)


def _of_length(area: AreaRecord) -> str:
    length, limit = f"{area.longest_um:.0f}", f"{area.max_length_um:g}"
    if not area.too_long:
        return f"the longest mark is {length} µm long (limit {limit} µm)"
    x, y = area.longest_at or (0.0, 0.0)
    return f"a mark is {length} µm long (limit {limit} µm), at x {x:+.2f} mm, y {y:+.2f} mm"


def _of_form(form: FormRecord) -> str:
    lean, u, limit = f"{form.lean_deg:.2g}", f"{2.0 * form.u_deg:.1g}", f"{form.max_lean_deg:g}"
    where, depth = f"x {form.x:+.2f} mm, y {form.y:+.2f} mm", f"{abs(form.depth_um):.1f}"
    if form.verdict == Verdict.PASS:
        return (
            f"the facets of several ridges lean by {lean}° ± {u}° (k = 2) from those around (limit {limit}°)"
        )
    if form.depth_um == 0.0:
        return (
            f"over several ridges the facets lean by {lean}° ± {u}° (k = 2) from those around (limit {limit}°), at "
            f"{where}"
        )
    if form.depth_um > 0.0:
        return (
            f"over several ridges the facets lean by {lean}° ± {u}° (k = 2) from those around (limit {limit}°), at "
            f"{where}: the surface sinks in by about {depth} µm"
        )
    return (
        f"over several ridges the facets lean by {lean}° ± {u}° (k = 2) from those around (limit {limit}°), at "
        f"{where}: the surface stands out by about {depth} µm"
    )


def _of_mirroring(cells: npt.NDArray[np.bool_]) -> str:
    return (
        f"{np.mean(cells):.1%} of the area is saturated where the same flanks elsewhere are not: it mirrors, as where "
        "a ridge is missing or flat"
    )


def _of_tolerance(pair: ContrastRecord, rule: DecisionPart) -> str:
    where = quantity_name(rule.contrast, pair.from_deg, pair.to_deg, pair.tilt_deg)
    return f"{where} deviates by {pair.deviation:+.3f} (tolerance ±{pair.tolerance:g}, guard band {pair.guard:.3f})"


def _where(pairs: tuple[ContrastRecord, ...], alpha: float) -> tuple[str, ...]:
    """The individually significant pairs, at one level for all (Holm)."""
    return tuple(
        contrast_name(p.from_deg, p.to_deg, p.tilt_deg)
        for p in pairs
        if p.p_value is not None and p.p_value < alpha
    )


def pair_values(pairs: Pairs, radiance: FloatArray, kind: ContrastKind) -> FloatArray:
    """(N,) contrasts of N pairs of poses, first against second.

    Args:
        pairs: indices of the poses.
        radiance: (P,) of all poses, above 0.
        kind: ln ratio, Michelson contrast, or difference.
    """
    a, b = (radiance[list(side)] for side in zip(*pairs, strict=True))
    if kind == "log_ratio":
        return np.asarray(np.log(a / b))
    return np.asarray(a - b if kind == "difference" else (a - b) / (a + b))


def pair_gradient(pairs: Pairs, radiance: FloatArray, kind: ContrastKind) -> FloatArray:
    """(N, P) derivative of N contrasts with respect to ln L of every pose; arguments as for `pair_values`."""
    gradient = np.zeros((len(pairs), len(radiance)))
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


def between_tilts(
    expected: Expectation, measured: Measured, kind: ContrastKind
) -> tuple[TiltContrastRecord, ...]:
    """The contrasts of every stage angle between the first tilt and each other one, in the order of the poses.

    Args:
        expected: prediction with its uncertainty components.
        measured: measurement with its uncertainty components.
        kind: of contrast.
    """
    pairs = tuple(_tilted_pairs(expected.poses))
    if not pairs:
        return ()
    measured_values, predicted_values = (
        pair_values(pairs, side.radiance, kind) for side in (measured, expected)
    )
    components = expected.components + measured.components
    u_contrast = _spread(pairs, measured.radiance, kind, [c for c in components if c.kind == "measurement"])
    u_predicted = _spread(pairs, expected.radiance, kind, [c for c in components if c.kind != "measurement"])
    u = np.hypot(u_contrast, u_predicted)
    adjusted = holm(two_sided(_by_u(measured_values - predicted_values, u)))
    poses = expected.poses
    return tuple(
        TiltContrastRecord(
            stage_deg=poses[i].stage_deg,
            from_tilt_deg=poses[i].tilt_deg,
            to_tilt_deg=poses[j].tilt_deg,
            kind=kind,
            measured=measured_values[k],
            predicted=predicted_values[k],
            u_measured=u_contrast[k],
            u_predicted=u_predicted[k],
            u=u[k],
            p_value=adjusted[k],
        )
        for k, (i, j) in enumerate(pairs)
    )


def deviating_between_tilts(expected: Expectation, measured: Measured, alpha: float) -> tuple[str, ...]:
    """Names of the individually significant ln ratios between the first tilt and another one, at one level (Holm).

    Args:
        expected: prediction with its uncertainty components.
        measured: measurement with its uncertainty components.
        alpha: level of all together.
    """
    pairs = tuple(_tilted_pairs(expected.poses))
    if not pairs:
        return ()
    off = np.log(measured.radiance / expected.radiance)
    components = expected.components + measured.components
    covariance = np.sum([component.covariance() for component in components], axis=0)
    i, j = np.array(pairs).T
    variance = covariance[i, i] + covariance[j, j] - 2.0 * covariance[i, j]
    u, change = np.sqrt(np.maximum(variance, 0.0)), off[i] - off[j]
    adjusted = holm(two_sided(_by_u(change, u)))
    return tuple(
        f"{expected.poses[a].stage_deg:g}° between tilt {expected.poses[a].tilt_deg:g}° and "
        f"{expected.poses[b].tilt_deg:g}° (ln ratio off by {change[k]:+.3f}, u {u[k]:.3f})"
        for k, (a, b) in enumerate(pairs)
        if adjusted[k] < alpha
    )


def _spread(
    pairs: tuple[tuple[int, int], ...], radiance: FloatArray, kind: ContrastKind, components: list[Component]
) -> FloatArray:
    """(N,) standard uncertainties of contrasts from components."""
    gradient = pair_gradient(pairs, radiance, kind)
    total = np.zeros((len(radiance), len(radiance)))
    for component in components:
        total += component.covariance()
    return np.sqrt(np.maximum(np.diag(gradient @ total @ gradient.T), 0.0))


def _by_u(change: FloatArray, u: FloatArray) -> FloatArray:
    """Deviations in standard uncertainties; infinite where a deviating value has no uncertainty."""
    return np.divide(change, u, out=np.where(change == 0.0, 0.0, np.inf), where=u > 0.0)


def _tilted_pairs(poses: tuple[Pose, ...]) -> Iterator[tuple[int, int]]:
    """Pairs of every pose with the first one at its stage angle."""
    first: dict[float, int] = {}
    for number, pose in enumerate(poses):
        if pose.stage_deg in first:
            yield first[pose.stage_deg], number
        else:
            first[pose.stage_deg] = number
