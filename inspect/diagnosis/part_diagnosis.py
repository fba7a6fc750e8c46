"""Diagnosis of a deviating part for its record. Where a fault of the rig explains the part as well, it is no FAIL.

A diagnosis that fails becomes a note: causes are computed from models and cached on disk, and neither may fail a part.
"""

from dataclasses import replace

import numpy as np

from anisoscope.base.errors import AnisoscopeError
from anisoscope.base.notation import p_value_text
from anisoscope.base.progress import Advance, silent
from anisoscope.decision.decision import Decision
from anisoscope.decision.reference_parts import GoldenSet
from anisoscope.diagnosis.cause_model import PLASTIC_CAUSES, CauseModel
from anisoscope.diagnosis.cell_levels import SMEAR_PX
from anisoscope.diagnosis.discriminating_poses import advice_for
from anisoscope.diagnosis.evidence import (
    Evidence,
    against,
    background_of,
    background_of_parts,
    covariance_of,
    inputs_of,
)
from anisoscope.diagnosis.ranking import NOTHING, OTHER, PLASTIC, TIE, Diagnosis, bare_title, diagnose
from anisoscope.diagnosis.rig_causes import Predict, RigFault, rig_faults
from anisoscope.diagnosis.signature_cache import cached_signatures
from anisoscope.imaging.defect_regions import form_of
from anisoscope.imaging.deviation_map import CellScatter
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.ridge_waves import measured_pitch
from anisoscope.prediction.expectation import Expectation
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.record.schema import DiagnosisRecord
from anisoscope.record.verdict import Verdict

MAX_LISTED_TIES = 3  # in one line; the table of causes lists all


def explain(
    recipe: SurfaceRecipe,
    expected: Expectation,
    measured: Measured,
    decision: Decision,
    advance: Advance = silent,
    golden: GoldenSet | None = None,
    causes: CauseModel = PLASTIC_CAUSES,
    *,
    predict: Predict | None = None,
    light_watched: bool = False,
) -> tuple[DiagnosisRecord, str | None]:
    """Rank the causes if the part deviates or did not pass.

    Args:
        recipe: the recipe.
        expected: the prediction that decided.
        measured: the measurement.
        decision: the verdict.
        advance: called at every signature that is not cached.
        golden: the golden parts used as the reference, or None.
        causes: of the kind of part.
        predict: predicts a recipe's poses; faults of the rig compete where the part fails. None: they do not.
        light_watched: lamp, exposure and stray light were measured in every frame, and were right.

    Returns:
        The diagnosis, and a note where it failed.
    """
    if decision.verdict is Verdict.PASS and decision.p_value >= recipe.decision.alpha:
        return DiagnosisRecord(says="nothing: the part is as it should be"), None
    try:
        light_angle_deg = expected.convention.light_angle_deg
        known = cached_signatures(recipe, light_angle_deg, advance, causes)
        if (area := decision.area) is not None:
            smear = SMEAR_PX * measured.grid.pixel_mm * 1000.0 / recipe.surface.pitch_um
            known = known.by_scatter(CellScatter.of(area), smear, area.cells)
        evidence = evidence_of(recipe, expected, measured, decision, golden)
        if any(one.cause.scales_pitch for one in known.found):
            evidence = replace(evidence, pitch=measured_pitch(measured, recipe))
        faults: tuple[RigFault, ...] = ()
        if predict is not None and decision.verdict is Verdict.FAIL:

            def seen_at(seat: Expectation) -> Evidence:
                turned = evidence_of(recipe, seat, measured, decision)
                return turned if golden is None else shifted(evidence, turned, expected, seat)

            faults = rig_faults(recipe, expected, evidence, seen_at, predict, light_watched=light_watched)
        found = diagnose(known, evidence, faults)
    except (AnisoscopeError, ArithmeticError, ValueError, np.linalg.LinAlgError) as problem:
        return DiagnosisRecord(says="not possible"), f"no diagnosis: {problem}"
    record = diagnosis_record(found, recipe.decision.alpha)
    try:
        advice = advice_for(recipe, light_angle_deg, found, advance, causes)
    except (AnisoscopeError, ArithmeticError, ValueError, np.linalg.LinAlgError) as problem:
        return record, f"not known what would tell the tied causes apart: {problem}"
    return record.model_copy(update={"tells": advice}), None


def evidence_of(
    recipe: SurfaceRecipe,
    expected: Expectation,
    measured: Measured,
    decision: Decision,
    golden: GoldenSet | None = None,
) -> Evidence:
    """Evidence of a part: ln L relative to golden parts or the prediction, and the deviating share of the area."""
    scale_share, predicted = recipe.uncertainty.scale_share, np.log(expected.radiance)
    deviation = np.log(measured.radiance) - predicted
    covariance = covariance_of(expected.components + measured.components, scale_share, len(deviation))
    found = Evidence(deviation, covariance, inputs=inputs_of(recipe, expected, measured.components))
    if (area := decision.area) is not None:
        mean, u = background_of(area.max_share)
        found = replace(found, share=area.share, u_share=area.u, background=mean, u_background=u)
    if decision.deviating is not None:
        found = replace(found, form=form_of(decision.deviating))
    if golden is None:
        return found
    if found.share is not None and (shares := golden.area_shares(recipe.area)):
        mean, u = background_of_parts(shares)
        found = replace(found, background=mean, u_background=u, share_floor=0.0)
    golden_deviations = np.array([part.log_radiance for part in golden.parts]) - predicted
    return against(found, golden_deviations, scale_share)


def diagnosis_record(found: Diagnosis, alpha: float, of: str = "part") -> DiagnosisRecord:
    """Record of the ranked causes.

    Args:
        found: the causes, ranked.
        alpha: level of significance: below it none of them explains what was inspected.
        of: noun for the inspected part.
    """
    record = DiagnosisRecord(
        says=_summary(found, alpha, of), causes=found.causes, unexplained_p=found.unexplained_p
    )
    if found.fault is None:
        return record
    verdict = Verdict.INVALID if found.ahead >= TIE else Verdict.INCONCLUSIVE
    return record.model_copy(update={"rig_fault": found.fault.name, "verdict": verdict})


def rig_reason(found: DiagnosisRecord) -> str:
    """Reason of a verdict that a fault of the rig decides, for the record."""
    fault = next(one for one in found.causes if one.cause == found.rig_fault)
    title = bare_title(fault.title)
    if found.verdict is Verdict.INVALID:
        return f"{title}: this explains the poses, and no defect of the part explains them as well"
    other = next(one for one in found.causes if one.cause not in {found.rig_fault, NOTHING, OTHER})
    return (
        f"{title}: this explains the poses as well as a defect of the part does ({bare_title(other.title)})"
    )


def shifted(evidence: Evidence, turned: Evidence, expected: Expectation, seat: Expectation) -> Evidence:
    """Evidence against golden parts for a part in another seat: their mean shifts as the prediction does."""
    shift = np.log(seat.radiance / expected.radiance)
    return replace(
        evidence,
        deviation=evidence.deviation - shift,
        covariance=turned.covariance,
        inputs=turned.inputs,
    )


def _summary(found: Diagnosis, alpha: float, of: str) -> str:
    best = found.causes[0]
    if found.unexplained_p < alpha:
        return f"none of the causes explains the {of} (p {p_value_text(found.unexplained_p)} for the best of them)"
    if best.cause == NOTHING:
        return f"nothing explains the {of} better than chance"
    if best.cause == PLASTIC:
        return (
            f"{best.title}, not this {of} alone: calibrate the material (anisoscope calibrate material), check the "
            "angle of the lamp, or collect golden parts"
        )
    ties = [bare_title(one.title) for one in found.ties if one is not best]
    if not ties:
        return bare_title(best.title)
    others, count = ", ".join(ties[:MAX_LISTED_TIES]), len(ties) - MAX_LISTED_TIES
    if count > 0:
        others = f"{others} and {count} more"
    return f"{bare_title(best.title)}; cannot be distinguished from: {others}"
