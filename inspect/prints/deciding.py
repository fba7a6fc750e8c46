"""The verdict on a print: guard-banded limits of colour, lobe, level, tilt and area, and all channels together.

Precedence: INVALID > FAIL > INCONCLUSIVE > PASS. Guard band after ISO 14253-1, conformance after JCGM 106:2012, §7, as
of ridged parts. c is not judged: between light and camera stand 10°, and Δc = 0.3 makes ΔE of about 1.
"""

from dataclasses import dataclass

import numpy as np

from anisoscope.prints.besidegolden import BesideGolden, beside_golden, linear_fit
from anisoscope.prints.expecting import PrintExpectation, rig_sources
from anisoscope.prints.fitting import PrintFit, fit_print
from anisoscope.prints.golden import GoldenPrints
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


NAMED = 3
"""Deviations that a reason names, at most."""


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
        d2: squared Mahalanobis distance of ln of all channels from the prediction; with golden prints Hotelling's T² of
            what is fitted, from their mean.
        dof: how many numbers that are.
        p_value: probability of a larger distance for a print as predicted; with golden prints of any of their tests.
        sources: of uncertainty, of prediction and measurement.
        golden: the print beside the golden prints, where these decide what deviates.
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
    golden: BesideGolden | None = None


def decide_print(
    expected: PrintExpectation,
    measured: MeasuredPrint,
    recipe: PrintRecipe,
    golden: GoldenPrints | None = None,
) -> PrintDecision:
    """Judge a print.

    Args:
        expected: the prediction.
        measured: the channels.
        recipe: limits and rule.
        golden: good prints, instead of the prediction, to tell what is a deviation.

    Raises:
        MeasurementError: the print cannot be fitted, its map is too noisy, or the golden prints do not vary enough.
    """
    from scipy.stats import chi2 as chi2_distribution  # noqa: PLC0415 - 1 s

    of_rig = (*measured.sources, *rig_sources(recipe, expected))
    logs = np.log(measured.channels).ravel()
    fit = fit_print(expected.scene, logs, (*expected.common, *of_rig))
    everything = (*expected.sources, *of_rig)
    covariance = total(everything, logs.size)
    off = logs - np.log(expected.channels).ravel()
    d2, dof = mahalanobis(off, covariance)
    p_value = float(chi2_distribution.sf(d2, dof))
    beside = None
    if golden is not None:
        linear = linear_fit(expected, (*expected.common, *of_rig))
        beside = beside_golden(golden, expected, logs, linear)
        d2, dof, p_value = beside.t2, len(beside.measured), beside.p_value
    colours = colours_of(expected, measured, fit, covariance)
    found = None
    if recipe.area is not None:
        found = map_of(measured, expected, fit, recipe.area, recipe.decision.coverage)
    judge = Judge(expected, fit, recipe, (*expected.common, *of_rig))
    quantities = (*judge.quantities(), judge.colour(colours))
    if found is not None:
        quantities = (*quantities, judge.curl(found))
    verdict, reasons = _combine(quantities, found, recipe, *_together(expected, p_value, beside, recipe))
    return PrintDecision(
        verdict, reasons, quantities, colours, fit, found, d2, dof, p_value, everything, beside
    )


def _together(
    expected: PrintExpectation, p_value: float, beside: BesideGolden | None, recipe: PrintRecipe
) -> tuple[bool, str]:
    """Whether all channels together deviate significantly, and what to say of it."""
    alpha = recipe.decision.alpha
    significant = p_value < alpha
    alike = "as predicted" if beside is None else f"like the {beside.count} golden prints"
    line = f"all channels together: p {said(p_value)} for a print {alike} (level {alpha:g})"
    if not significant:
        return False, line
    where = ""
    if beside is not None:
        named = ["lobe and level"] if beside.p_fitted < alpha else []
        named += [
            f"the colour at {pose.stage_deg:g}°, tilt {pose.tilt_deg:g}°"
            for pose, one in zip(expected.poses, beside.colours, strict=True)
            if one.p_value < alpha
        ]
        more = f" and {len(named) - NAMED} more" if len(named) > NAMED else ""
        where = f" of {', '.join(named[:NAMED])}{more}"
    return True, f"{line}, a significant deviation{where}"


def _combine(
    quantities: tuple[Quantity, ...],
    found: PrintMap | None,
    recipe: PrintRecipe,
    significant: bool,
    line: str,
) -> tuple[Verdict, tuple[str, ...]]:
    """Precedence FAIL > INCONCLUSIVE > PASS over all criteria, with a line for each that speaks."""
    rule = recipe.decision
    findings = [(one.verdict, sentence(one)) for one in quantities]
    if found is not None and recipe.area is not None:
        area = (
            f"{found.share:.1%} of the area is off by more than ΔE {recipe.area.cell_delta_e:g} from the rest (limit "
            f"{recipe.area.max_share:.1%})"
        )
        findings.append((found.verdict, area))
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
