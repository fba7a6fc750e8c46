"""The verdict on a print: guard-banded limits of colour, lobe, level, tilt and area, and all channels together.

Precedence: INVALID > FAIL > INCONCLUSIVE > PASS. Guard band after ISO 14253-1, conformance after JCGM 106:2012, §7, as
of ridged parts. c is not judged: between light and camera stand 10°, and Δc = 0.3 makes ΔE of about 1.
"""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError
from anisoscope.base.significance import mahalanobis, p_value_text
from anisoscope.kinds.prints.colour_map import PrintMap, map_of
from anisoscope.kinds.prints.expectation import PrintExpectation, rig_sources
from anisoscope.kinds.prints.lobe_fit import NoLobe, PrintFit, fit_print
from anisoscope.kinds.prints.measurement import MeasuredPrint
from anisoscope.kinds.prints.missing_ink import Bare, what_lies_there, without_ink
from anisoscope.kinds.prints.pose_colours import PoseColour, colours_of
from anisoscope.kinds.prints.quantities import Judge, Quantity, sentence
from anisoscope.kinds.prints.recipe import PrintArea, PrintRecipe
from anisoscope.kinds.prints.reference_prints import GoldenPrints
from anisoscope.kinds.prints.reference_test import BesideGolden, beside_golden, linear_fit
from anisoscope.kinds.prints.sources import Source, total
from anisoscope.record.verdict import Verdict

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
        fit: lobe, level and colour; None where there is no lobe.
        map: local differences, or None where the recipe asks for none.
        d2: squared Mahalanobis distance of ln of all channels from the prediction; with golden prints Hotelling's T² of
            what is fitted, from their mean.
        dof: how many numbers that are.
        p_value: probability of a larger distance for a print as predicted; with golden prints of any of their tests.
        sources: of uncertainty, of prediction and measurement.
        golden: the print beside the golden prints, where these decide what deviates.
        bare: how much of the ink is missing, where there is no lobe.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    quantities: tuple[Quantity, ...]
    colours: tuple[PoseColour, ...]
    fit: PrintFit | None
    map: PrintMap | None
    d2: float
    dof: int
    p_value: float
    sources: tuple[Source, ...]
    golden: BesideGolden | None = None
    bare: Bare | None = None


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
    of_rig = (*measured.sources, *rig_sources(recipe, expected))
    logs = np.log(measured.channels).ravel()
    everything = (*expected.sources, *of_rig)
    covariance = total(everything, logs.size)
    d2, dof, p_value = _from_prediction(expected, logs, covariance)
    try:
        fit = fit_print(expected.scene, logs, (*expected.common, *of_rig))
    except NoLobe as problem:
        return _without_lobe(expected, measured, recipe, str(problem))
    colours = colours_of(expected, measured, fit, covariance)
    found, beside = None, None
    if recipe.area is not None:
        found = map_of(measured, expected, fit, recipe.area, recipe.decision.coverage)
    if golden is not None:
        linear, alpha = linear_fit(expected, (*expected.common, *of_rig)), recipe.decision.alpha
        known = golden.known_shares(recipe)
        area = None if known is None or found is None else (known, found.share)
        beside = beside_golden(golden, expected, logs, linear, area, alpha)
        d2, dof, p_value = beside.t2, len(beside.measured), beside.p_value
        if found is not None and beside.area is not None:
            found = found.beside(beside.area, alpha)
    judge = Judge(expected, fit, recipe, (*expected.common, *of_rig))
    quantities = (*judge.quantities(), judge.colour(colours))
    if found is not None:
        quantities = (*quantities, judge.curl(found))
    verdict, reasons = _combine(
        quantities, found, recipe, beside, *_together(expected, p_value, beside, recipe)
    )
    return PrintDecision(
        verdict, reasons, quantities, colours, fit, found, d2, dof, p_value, everything, beside
    )


def _without_lobe(
    expected: PrintExpectation, measured: MeasuredPrint, recipe: PrintRecipe, problem: str
) -> PrintDecision:
    """FAIL where the ink is missing.

    Raises:
        MeasurementError: the pictures show something else.
    """
    bare = without_ink(expected, measured, recipe)
    if bare is None:
        raise MeasurementError(f"{problem}{what_lies_there(expected, measured, recipe)}")
    logs = np.log(measured.channels).ravel()
    sources = (*expected.sources, *measured.sources, *rig_sources(recipe, expected))
    covariance = total(sources, logs.size)
    d2, dof, p_value = _from_prediction(expected, logs, covariance)
    return PrintDecision(
        verdict=Verdict.FAIL,
        reasons=(bare.reason, sentence(bare.quantity)),
        quantities=(bare.quantity,),
        colours=colours_of(expected, measured, None, covariance),
        fit=None,
        map=None,
        d2=d2,
        dof=dof,
        p_value=p_value,
        sources=sources,
        bare=bare,
    )


def _from_prediction(
    expected: PrintExpectation, logs: FloatArray, covariance: FloatArray
) -> tuple[float, int, float]:
    """Squared Mahalanobis distance of ln of all channels from the prediction, how many they are, and its p value."""
    from scipy.stats import chi2  # noqa: PLC0415 - 1 s

    d2, dof = mahalanobis(logs - np.log(expected.channels).ravel(), covariance)
    return d2, dof, float(chi2.sf(d2, dof))


def _together(
    expected: PrintExpectation, p_value: float, beside: BesideGolden | None, recipe: PrintRecipe
) -> tuple[bool, str]:
    """Whether all channels together deviate significantly, and what to say of it."""
    alpha = recipe.decision.alpha
    significant = p_value < alpha
    alike = "as predicted" if beside is None else f"like the {beside.count} golden prints"
    shared = "" if beside is None or beside.area is None else ", shared with the area"
    line = f"all channels together: p {p_value_text(p_value)} for a print {alike} (level {alpha:g}{shared})"
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
    beside: BesideGolden | None,
    significant: bool,
    line: str,
) -> tuple[Verdict, tuple[str, ...]]:
    """Precedence FAIL > INCONCLUSIVE > PASS over all criteria, with a line for each that speaks."""
    rule = recipe.decision
    findings = [(one.verdict, sentence(one)) for one in quantities]
    if found is not None and recipe.area is not None:
        findings.append((found.verdict, _of_area(found, recipe.area, beside)))
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


def _of_area(found: PrintMap, rule: PrintArea, beside: BesideGolden | None) -> str:
    """The deviating area with its limit, and where that comes from."""
    line = f" of the area is off by more than ΔE {rule.cell_delta_e:g} from the rest (limit "
    if beside is None or beside.area is None:
        return f"{found.share:.1%}{line}{found.max_share:.1%})"
    return f"{found.share:.2%}{line}{found.max_share:.2%}, learnt from {beside.area.prints} golden prints)"
