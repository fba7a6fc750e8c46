"""The verdict on a print: guard-banded limits of colour, lobe, level, tilt and area, and all channels together.

Precedence: INVALID > FAIL > INCONCLUSIVE > PASS. Guard band after ISO 14253-1, conformance after JCGM 106:2012, §7, as
of ridged parts. c is not judged: between light and camera stand 10°, and Δc = 0.3 makes ΔE of about 1.
"""

from dataclasses import dataclass

import numpy as np

from anisoscope.prints.expecting import PrintExpectation, rig_sources
from anisoscope.prints.fitting import PrintFit, fit_print
from anisoscope.prints.mapping import PrintMap, map_of
from anisoscope.prints.measuring import MeasuredPrint
from anisoscope.prints.posecolours import PoseColour, colours_of
from anisoscope.prints.quantities import Judge, Quantity, sentence
from anisoscope.prints.recipe import PrintRecipe
from anisoscope.prints.sources import Source, total
from anisoscope.significance import mahalanobis, said
from anisoscope.verdict import Verdict

NOT_JUDGED = (
    "c of the ink is not judged: this rig hardly sees it, because light and camera stand close together "
    "(a change of 0.3 makes ΔE of about 1)"
)


@dataclass(frozen=True, eq=False)
class PrintDecision:
    """Verdict on a print with everything that led to it.

    Attributes:
        verdict: of the print.
        reasons: one line each, most important first.
        quantities: what was judged.
        colours: one a pose.
        fit: lobe, level and colour.
        map: local differences, or None where the recipe asks for none.
        d2: squared Mahalanobis distance of ln of all channels from the prediction.
        dof: how many they are.
        p_value: probability of a larger distance for a print as predicted.
        sources: of uncertainty, of prediction and measurement.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    quantities: tuple[Quantity, ...]
    colours: tuple[PoseColour, ...]
    fit: PrintFit
    map: PrintMap | None
    d2: float
    dof: int
    p_value: float
    sources: tuple[Source, ...]


def decide_print(expected: PrintExpectation, measured: MeasuredPrint, recipe: PrintRecipe) -> PrintDecision:
    """Judge a print.

    Raises:
        MeasurementError: the print cannot be fitted, or its map is too noisy.
    """
    from scipy.stats import chi2 as chi2_distribution  # noqa: PLC0415 - 1 s

    of_rig = (*measured.sources, *rig_sources(recipe, expected))
    logs = np.log(measured.channels).ravel()
    fit = fit_print(expected.scene, logs, (*expected.common, *of_rig))
    everything = (*expected.sources, *of_rig)
    covariance = total(everything, logs.size)
    off = logs - np.log(expected.channels).ravel()
    d2, dof = mahalanobis(off, covariance)
    colours = colours_of(expected, measured, fit, covariance)
    found = None
    if recipe.area is not None:
        found = map_of(measured, expected, fit, recipe.area, recipe.decision.coverage)
    judge = Judge(expected, fit, recipe, (*expected.common, *of_rig))
    quantities = (*judge.quantities(), judge.colour(colours))
    if found is not None:
        quantities = (*quantities, judge.curl(found))
    p_value = float(chi2_distribution.sf(d2, dof))
    verdict, reasons = _combine(quantities, found, p_value, recipe)
    return PrintDecision(verdict, reasons, quantities, colours, fit, found, d2, dof, p_value, everything)


def _combine(
    quantities: tuple[Quantity, ...], found: PrintMap | None, p_value: float, recipe: PrintRecipe
) -> tuple[Verdict, tuple[str, ...]]:
    """Precedence FAIL > INCONCLUSIVE > PASS over all criteria, with a line for each that speaks."""
    rule = recipe.decision
    findings = [(one.verdict, sentence(one)) for one in quantities]
    if found is not None and recipe.area is not None:
        line = (
            f"{found.share:.1%} of the area is off by more than ΔE {recipe.area.cell_delta_e:g} from the rest (limit "
            f"{recipe.area.max_share:.1%})"
        )
        findings.append((found.verdict, line))
    significant = p_value < rule.alpha
    line = f"all channels together: p {said(p_value)} for a print as predicted (level {rule.alpha:g})"
    if significant:
        line += ", a significant deviation"
    fails = significant and rule.deviation == "fail"
    findings.append((Verdict.FAIL if fails else Verdict.PASS, line))
    order = [Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.PASS]
    findings.sort(key=lambda finding: order.index(finding[0]))
    verdict = findings[0][0]
    decisive = tuple(line for one, line in findings if one is verdict)
    if verdict is Verdict.PASS:
        decisive = (f"all {len(quantities)} quantities lie within their limits", decisive[-1])
    warn = significant and verdict is Verdict.PASS
    return verdict, (("warning: significant deviation within the limits",) if warn else ()) + decisive
