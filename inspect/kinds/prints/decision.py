"""The verdict on a print: guard-banded limits of colour, lobe, level, tilt and area, and all channels together.

Precedence: INVALID > FAIL > INCONCLUSIVE > PASS. Guard band after ISO 14253-1, conformance after JCGM 106:2012, §7, as
of ridged parts. c is not judged: between light and camera stand 10°, and Δc = 0.3 makes ΔE of about 1.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import root
from anisoscope.base.errors import MeasurementError, ModelError
from anisoscope.base.notation import p_value_text
from anisoscope.base.rejection import Misfit, misfit
from anisoscope.base.significance import chi2_tail, mahalanobis
from anisoscope.decision.exclusion import MORE_TILTS, Exclusion, with_exclusions
from anisoscope.kinds.kind import Results
from anisoscope.kinds.prints.colour_map import PrintMap, map_of
from anisoscope.kinds.prints.excluded_defects import deviation_of, excluded_of
from anisoscope.kinds.prints.expectation import (
    OF_ONE_INSPECTION,
    PrintExpectation,
    misfit_of,
    rig_sources,
    scatter_of_prints,
)
from anisoscope.kinds.prints.lobe_fit import PARAMETERS, NoLobe, PrintFit, fit_print
from anisoscope.kinds.prints.measurement import MeasuredPrint
from anisoscope.kinds.prints.missing_ink import Bare, sheet_description, without_ink
from anisoscope.kinds.prints.pose_colours import colours_of
from anisoscope.kinds.prints.quantities import Judge, Quantity, sentence
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.record import ColourRecord, PrintDetails, PrintMapRecord, triple
from anisoscope.kinds.prints.reference_comparison import (
    GoldenComparison,
    compare_with_golden,
    linear_fit,
    lot_scatter,
)
from anisoscope.kinds.prints.reference_prints import GoldenPrints
from anisoscope.kinds.prints.sources import Source, total
from anisoscope.record.schema import BudgetRecord
from anisoscope.record.verdict import Verdict
from anisoscope.sim.light.ink.ink import UNKNOWN, InkUncertainty

NOT_JUDGED = (
    "c of the ink is not judged: this rig hardly sees it, because light and camera stand close together "
    "(a change of 0.3 makes ΔE of about 1)"
)


NONE_EXCLUDED = "no defect is excluded, because the print deviates within its limits, or [defects] names none"
NOT_DESCRIBED = (
    "the ink file does not describe this print (chi² {chi2:.3g} for {dof:g} degrees of freedom): teach golden prints, "
    "or measure the ink"
)
TOO_UNCERTAIN = (
    "the ink file knows its prints too badly for these limits: teach golden prints, or measure the ink"
)
OF_THE_INK = ("alpha x", "alpha y", "gain", "chromaticity", "delta_e")
"""Quantities that are counted from the ink file; the others compare poses, or places of the print."""
_MISFITS = tuple(
    replace(UNKNOWN, misfit_at_deg=(0.0,), misfit_share=(share,), misfit_colour_share=(0.2 * share,))
    for share in (0.02, 0.04, 0.08, 0.15, 0.3, 0.6)
)
"""Misfits that are tried, the same at all angles, with a fifth that differs between the channels."""
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
        d2: squared Mahalanobis distance of ln of all channels from the prediction; with golden prints T² of what is
            fitted, from their mean.
        dof: how many numbers that are.
        p_value: probability of a larger distance for a print as predicted; with golden prints of any of their tests.
        sources: of uncertainty, of prediction and measurement.
        golden: comparison with the golden prints, where these decide what deviates.
        bare: how much of the ink is missing, where there is no lobe.
        exclusions: largest sizes of the named defects that the print may have; none where it deviates.
        misfit: of the ink file, where it does not describe the print; None where it does, and with golden prints.
        not_described: why the ink file leaves the print undecided; "" where it does not.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    quantities: tuple[Quantity, ...]
    colours: tuple[ColourRecord, ...]
    fit: PrintFit | None
    map: PrintMap | None
    d2: float
    dof: int
    p_value: float
    sources: tuple[Source, ...]
    golden: GoldenComparison | None = None
    bare: Bare | None = None
    exclusions: tuple[Exclusion, ...] = ()
    misfit: Misfit | None = None
    not_described: str = ""


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
        golden: good prints that replace the prediction as the reference of a deviation; or the other prints of its
            lot, which show how it differs from most of them, while the ink file judges what all have in common: the
            tests by either have half of the level.

    Raises:
        MeasurementError: the print cannot be fitted, its map is too noisy, or the golden prints do not vary enough.
    """
    if golden is None or not golden.unjudged:
        return _decided(expected, measured, recipe, golden)
    if golden.lot is None:
        found = _decided(expected, measured, recipe, golden)
        return replace(found, reasons=(*found.reasons, golden.of_the_lot((), ())))
    logs = np.vstack([golden.logs(), np.log(measured.channels).ravel()])
    others, left_out = golden.alike(lot_scatter(logs, recipe, expected))
    rule = recipe.decision.model_copy(update={"alpha": 0.5 * recipe.decision.alpha})
    recipe = recipe.model_copy(update={"decision": rule})
    found = alone = _decided(expected, measured, recipe, None)
    if alone.verdict is not Verdict.FAIL and len(others.parts) >= others.needed:
        found = _decided(expected, measured, recipe, others)
    return replace(found, reasons=(*found.reasons, others.of_the_lot(left_out, alone.exclusions)))


def _decided(
    expected: PrintExpectation,
    measured: MeasuredPrint,
    recipe: PrintRecipe,
    golden: GoldenPrints | None,
) -> PrintDecision:
    """The verdict by the ink file, or by these prints."""
    of_rig = (*measured.sources, *rig_sources(recipe, expected))
    logs = np.log(measured.channels).ravel()
    everything = (*expected.sources, *of_rig)
    covariance = total(everything, logs.size)
    d2, dof, p_value = _from_prediction(expected, logs, covariance)
    try:
        fit = fit_print(expected.scene, logs, (*expected.common, *expected.misfit, *of_rig))
    except NoLobe as problem:
        return _without_lobe(expected, measured, recipe, str(problem))
    lacks = None
    if golden is None:
        expected, fit, lacks = _by_ink(expected, recipe, fit, logs, of_rig)
        everything = (*expected.sources, *of_rig)
        covariance = total(everything, logs.size)
    found, comparison = None, None
    if recipe.area is not None:
        found = map_of(measured, expected, fit, recipe.area, recipe.decision.coverage)
    if golden is not None:
        linear, alpha = linear_fit(expected, (*expected.common, *of_rig)), recipe.decision.alpha
        known = golden.known_shares(recipe)
        area = None if known is None or found is None else (known, found.record.share)
        stated = scatter_of_prints(recipe, expected)
        comparison = compare_with_golden(golden, expected, logs, linear, stated, area, alpha)
        d2, dof, p_value = comparison.t2, len(comparison.measured), comparison.p_value
        if found is not None and comparison.area is not None:
            found = found.with_learnt_limit(comparison.area, alpha)
    colours = colours_of(expected, measured, fit, covariance)
    if golden is not None:
        judge, colours = _from_golden(expected, measured, recipe, golden, colours)
    else:
        judge = Judge(expected, fit, recipe, (*expected.common, *expected.misfit, *of_rig))
    quantities = (*judge.quantities(), judge.colour(colours))
    if found is not None:
        quantities = (*quantities, judge.curl(found))
    unfit = "" if golden is not None else _unfit(lacks, quantities)
    verdict, reasons = _combine(
        quantities, found, recipe, comparison, *_together(p_value, comparison, recipe), unfit
    )
    exclusions: tuple[Exclusion, ...] = ()
    if p_value >= recipe.decision.alpha:
        off, spread, _ = deviation_of(expected, logs, everything, comparison)
        exclusions = excluded_of(recipe, expected, fit, off, spread, golden=comparison is not None)
    verdict, reasons = with_exclusions(
        verdict, reasons, exclusions, recipe.decision.unexcluded, MORE_TILTS, NONE_EXCLUDED
    )
    return PrintDecision(
        verdict,
        reasons,
        quantities,
        colours,
        fit,
        found,
        d2,
        dof,
        p_value,
        everything,
        comparison,
        exclusions=exclusions,
        misfit=lacks,
        not_described=unfit if verdict is Verdict.INCONCLUSIVE else "",
    )


def _by_ink(
    expected: PrintExpectation,
    recipe: PrintRecipe,
    fit: PrintFit,
    logs: FloatArray,
    of_rig: tuple[Source, ...],
) -> tuple[PrintExpectation, PrintFit, Misfit | None]:
    """Prediction and fit with the misfit of the ink file, or the one that this print shows, and the test of it."""
    rest = (*expected.common, *of_rig)
    if expected.misfit:
        stated = recipe.print.of_ink(expected.scene.ink)
        expected, fit = _with_misfit(expected, fit, logs, rest, (stated,))
    lacks = _not_described(expected, recipe, fit, logs, (*rest, *expected.misfit))
    if lacks is not None:
        expected, fit = _with_misfit(expected, fit, logs, rest, _MISFITS)
    return expected, fit, lacks


def _not_described(
    expected: PrintExpectation,
    recipe: PrintRecipe,
    fit: PrintFit,
    logs: FloatArray,
    sources: tuple[Source, ...],
) -> Misfit | None:
    """The test of a fitted lobe that the print rejects, also with film, missing ink or another ink free; else None."""
    found = misfit(expected.scene.ink.name, fit.chi2, logs.size, len(PARAMETERS))
    scene = expected.scene
    mixed = [(replace(scene, other=ink), "other") for ink in recipe.print.read_wrong_inks()]
    for shown_by, cause in ((scene, "shift_nm"), (scene, "missing"), *mixed):
        if not found.rejected:
            return None
        try:
            wider = fit_print(shown_by, logs, sources, start=fit.state, more=(cause,))
        except (MeasurementError, ModelError):  # the poses do not tell it, or it leads nowhere
            continue
        rival = misfit(cause, wider.chi2, logs.size, len(PARAMETERS) + 1)
        found = found if rival.rejected else rival
    return found if found.rejected else None


def _with_misfit(
    expected: PrintExpectation,
    fit: PrintFit,
    logs: FloatArray,
    sources: tuple[Source, ...],
    tried: Iterable[InkUncertainty],
) -> tuple[PrintExpectation, PrintFit]:
    """Prediction and fit with the first misfit of the ink file under which χ² is no more than its freedom."""
    for known in tried:
        wider = replace(expected, misfit=misfit_of(expected.scene, known, fit.state))
        try:
            again = fit_print(expected.scene, logs, (*sources, *wider.misfit), start=fit.state)
        except NoLobe:  # nothing is known of the lobe any more
            break
        expected, fit = wider, again
        if fit.chi2 <= fit.dof:
            break
    return expected, fit


def _from_golden(
    expected: PrintExpectation,
    measured: MeasuredPrint,
    recipe: PrintRecipe,
    golden: GoldenPrints,
    alone: tuple[ColourRecord, ...],
) -> tuple[Judge, tuple[ColourRecord, ...]]:
    """The fit and the colours of a print from the mean of the golden prints: errors common to all prints cancel.

    The print is compared as if the golden mean were what the ink file predicts.
    """
    of_rig = rig_sources(recipe, expected)
    base, mean = np.log(expected.channels).ravel(), golden.logs().mean(axis=0)
    logs = np.log(measured.channels).ravel() - mean + base
    own = (*measured.sources, *(one for one in of_rig if one.name in OF_ONE_INSPECTION))
    scatter = np.cov(golden.logs(), rowvar=False) / len(golden.parts)
    whose = "golden prints" if golden.lot is None else "other prints of the lot"
    sources = (*own, Source(f"mean of the {whose}", "prediction", root(scatter).T))
    weights = (*expected.common, *measured.sources, *of_rig)
    fit = fit_print(expected.scene, logs, weights)
    origin = fit_print(expected.scene, mean, weights).state
    moved = replace(measured, channels=np.exp(logs).reshape(-1, 3))
    differences = colours_of(expected, moved, fit, total(sources, logs.size))
    colours = tuple(
        one.model_copy(update={"delta_e": other.delta_e, "u_delta_e": other.u_delta_e})
        for one, other in zip(alone, differences, strict=True)
    )
    return Judge(expected, fit, recipe, sources, origin), colours


def _without_lobe(
    expected: PrintExpectation, measured: MeasuredPrint, recipe: PrintRecipe, problem: str
) -> PrintDecision:
    """FAIL where the ink is missing.

    Raises:
        MeasurementError: the pictures show something else.
    """
    bare = without_ink(expected, measured, recipe)
    if bare is None:
        raise MeasurementError(f"{problem}{sheet_description(expected, measured, recipe)}")
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
    d2, dof = mahalanobis(logs - np.log(expected.channels).ravel(), covariance)
    return d2, dof, float(chi2_tail(d2, dof))


def _together(p_value: float, comparison: GoldenComparison | None, recipe: PrintRecipe) -> tuple[bool, str]:
    """Whether all channels together deviate significantly, and the line of the reasons about it."""
    alpha = recipe.decision.alpha
    significant = p_value < alpha
    alike = "as predicted" if comparison is None else comparison.words
    text = p_value_text(p_value)
    line = (
        f"all channels together: p {text} for a print {alike} (level {alpha:g})"
        if comparison is None or comparison.area is None
        else f"all channels together: p {text} for a print {alike} (level {alpha:g}, shared with the area)"
    )
    if not significant:
        return False, line
    where = ""
    if comparison is not None:
        named = ["lobe and level"] if comparison.p_fitted < alpha else []
        named += [
            f"the colour at {one.stage_deg:g}°, tilt {one.tilt_deg:g}°"
            for one in comparison.colours
            if one.p_value < alpha
        ]
        more = f" and {len(named) - NAMED} more" if len(named) > NAMED else ""
        where = f" of {', '.join(named[:NAMED])}{more}"
    return True, f"{line}, a significant deviation{where}"


def _combine(
    quantities: tuple[Quantity, ...],
    found: PrintMap | None,
    recipe: PrintRecipe,
    comparison: GoldenComparison | None,
    significant: bool,
    line: str,
    unfit: str,
) -> tuple[Verdict, tuple[str, ...]]:
    """Precedence FAIL > INCONCLUSIVE > PASS over all criteria, with the lines of the decisive ones.

    A print that the ink file does not describe (``unfit``) fails by what needs no ink file alone.
    """
    rule = recipe.decision
    findings = [(one.verdict, sentence(one)) for one in quantities]
    described = not unfit or unfit == TOO_UNCERTAIN
    if not described:
        findings = [
            (one.verdict, sentence(one))
            for one in quantities
            if one.name not in OF_THE_INK or one.verdict is Verdict.INCONCLUSIVE
        ]
    if unfit:
        findings.insert(0, (Verdict.INCONCLUSIVE, unfit))
    if found is not None and recipe.area is not None:
        findings.append((found.record.verdict, _of_area(found.record, comparison)))
    stated = comparison is None or "deviation" in rule.model_fields_set
    fails = significant and described and (rule.deviation == "fail" or not stated)
    findings.append((Verdict.FAIL if fails else Verdict.PASS, line))
    order = [Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.PASS]
    findings.sort(key=lambda finding: order.index(finding[0]))
    verdict = findings[0][0]
    decisive = tuple(line for one, line in findings if one is verdict)
    if verdict is Verdict.PASS:
        decisive = (f"all {len(quantities)} quantities lie within their limits", decisive[-1])
    warn = significant and verdict is Verdict.PASS
    return verdict, (("warning: significant deviation within the limits",) if warn else ()) + decisive


def _unfit(lacks: Misfit | None, quantities: tuple[Quantity, ...]) -> str:
    """Why the ink file cannot judge a print: it does not describe it, or no print could pass; "" where it can."""
    if lacks is not None:
        return NOT_DESCRIBED.format(**vars(lacks))
    open_ = (one for one in quantities if one.name in OF_THE_INK and one.verdict is Verdict.INCONCLUSIVE)
    return TOO_UNCERTAIN if any(one.guard >= one.limit for one in open_) else ""


def _of_area(found: PrintMapRecord, comparison: GoldenComparison | None) -> str:
    """The deviating area with its limit, and where that comes from."""
    cell = found.threshold
    if comparison is None or comparison.area is None:
        return (
            f"{found.share:.1%} of the area is off by more than ΔE {cell:.3g} from the rest (limit "
            f"{found.max_share:.1%})"
        )
    return (
        f"{found.share:.2%} of the area is off by more than ΔE {cell:.3g} from the rest (limit {found.max_share:.2%}, "
        f"learnt from {comparison.area.prints} golden prints)"
    )


def print_results(
    expected: PrintExpectation,
    decision: PrintDecision,
    names: tuple[str, str],
    notes: tuple[str, ...] = (),
) -> Results:
    """Results of a print for its record.

    Args:
        expected: the prediction.
        decision: the verdict.
        names: of the sensitivities, and of the camera's filters.
        notes: for the user.
    """
    luminance, predicted = (
        np.array([getattr(one, name)[1] for one in decision.colours]) / np.pi
        for name in ("xyz", "xyz_predicted")
    )
    return Results(
        luminance,
        predicted,
        _details(expected, decision, names),
        _budget(decision.quantities),
        decision.d2,
        decision.dof,
        decision.p_value,
        notes=notes,
    )


def _budget(quantities: tuple[Quantity, ...]) -> tuple[BudgetRecord, ...]:
    """Contributions to every quantity that has some, largest share of a limit first; 0 where a source has none."""
    budgeted = [one for one in quantities if one.contributions]
    sources = dict.fromkeys((name, kind) for one in budgeted for name, kind, _ in one.contributions)
    rows = []
    for source, kind in sources:
        values = tuple(
            float(np.linalg.norm([u for name, _, u in one.contributions if name == source]))
            for one in budgeted
        )
        rows.append(BudgetRecord(source=source, kind=kind, contributions=values))
    limits = [one.limit for one in budgeted]
    return tuple(
        sorted(
            rows, key=lambda row: -max(u / limit for u, limit in zip(row.contributions, limits, strict=True))
        )
    )


def _details(expected: PrintExpectation, decision: PrintDecision, names: tuple[str, str]) -> PrintDetails:
    eye, ink = expected.eye, expected.scene.ink
    matrix = [triple(row) for row in eye.to_xyz]
    return PrintDetails(
        ink=ink.name,
        lamp=eye.lamp,
        sensitivities=names[0],
        filters=names[1],
        to_xyz=(matrix[0], matrix[1], matrix[2]),
        white=triple(eye.white),
        exposure=eye.exposure,
        matrix_residual=eye.residual,
        matrix_residual_changed=eye.residual_changed,
        colours=decision.colours,
        quantities=decision.quantities,
        lobe=None if decision.fit is None else decision.fit.record(ink),
        map=None if decision.map is None else decision.map.record,
        exclusions=tuple(one.record() for one in decision.exclusions),
        not_described=decision.not_described,
        not_judged=(NOT_JUDGED,),
        golden=None if decision.golden is None else decision.golden.record(),
    )


def nothing_wrong(decision: PrintDecision, alpha: float) -> bool:
    """Whether the print passes without a significant deviation, so that no cause is sought."""
    return decision.verdict is Verdict.PASS and decision.p_value >= alpha
