"""From the verdict on a print to the part of its record that it rests on."""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.kinds.kind import Results
from anisoscope.kinds.prints.colour_map import PrintMap, Spot
from anisoscope.kinds.prints.decision import NOT_JUDGED, PrintDecision
from anisoscope.kinds.prints.expectation import PrintExpectation
from anisoscope.kinds.prints.lobe_fit import PARAMETERS, PrintFit
from anisoscope.kinds.prints.quantities import Quantity
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.record import (
    ColourRecord,
    GoldenColourRecord,
    GoldenFitRecord,
    GoldenPrintsRecord,
    LobeRecord,
    PrintDetails,
    PrintMapRecord,
    QuantityRecord,
    SpotRecord,
    Triple,
)
from anisoscope.kinds.prints.reference_test import BesideGolden
from anisoscope.record.schema import BudgetRecord
from anisoscope.record.verdict import Verdict
from anisoscope.sim.light.ink.ink import Ink

FIT_TITLES = {
    "alpha": ("ln of the roughness", ""),
    "ratio": ("ln of roughness at 90° over 0°", ""),
    "skew": ("ln of roughness at 135° over 45°", ""),
    "tilt_x_deg": ("lean toward +x", "°"),
    "tilt_y_deg": ("lean toward +y", "°"),
    "red": ("ln of the level of red", ""),
    "green": ("ln of the level of green", ""),
    "blue": ("ln of the level of blue", ""),
    "lobe": ("form of the lobe", ""),
}
"""Fitted parameters, with their units."""


def triple(values: FloatArray) -> Triple:
    """Three numbers as JSON holds them."""
    red, green, blue = (float(value) for value in values)
    return red, green, blue


def print_results(
    recipe: PrintRecipe,
    expected: PrintExpectation,
    decision: PrintDecision,
    names: tuple[str, str],
    notes: tuple[str, ...] = (),
) -> Results:
    """What the record holds of a print.

    Args:
        recipe: its recipe.
        expected: the prediction.
        decision: the verdict.
        names: of the sensitivities, and of the camera's filters.
        notes: what the user should know besides.
    """
    luminance, wanted = (
        np.array([getattr(one, name)[1] for one in decision.colours]) / np.pi
        for name in ("xyz", "xyz_predicted")
    )
    return Results(
        luminance,
        wanted,
        _print(recipe, expected, decision, names),
        _budget(decision.quantities),
        decision.d2,
        decision.dof,
        decision.p_value,
        notes=notes,
    )


def _budget(quantities: tuple[Quantity, ...]) -> tuple[BudgetRecord, ...]:
    """Contributions to every quantity that has some, largest share of a limit first; 0 where a source has none."""
    told = [one for one in quantities if one.contributions]
    sources = dict.fromkeys((name, kind) for one in told for name, kind, _ in one.contributions)
    rows = []
    for source, kind in sources:
        values = tuple(
            float(np.linalg.norm([u for name, _, u in one.contributions if name == source])) for one in told
        )
        rows.append(BudgetRecord(source=source, kind=kind, contributions=values))
    limits = [one.limit for one in told]
    return tuple(
        sorted(
            rows, key=lambda row: -max(u / limit for u, limit in zip(row.contributions, limits, strict=True))
        )
    )


def _print(
    recipe: PrintRecipe, expected: PrintExpectation, decision: PrintDecision, names: tuple[str, str]
) -> PrintDetails:
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
        colours=tuple(
            ColourRecord(
                stage_deg=pose.stage_deg,
                tilt_deg=pose.tilt_deg,
                measured=triple(one.measured),
                predicted=triple(one.predicted),
                wanted=triple(one.wanted),
                u=triple(one.u),
                xyz=triple(one.xyz),
                xyz_predicted=triple(one.xyz_predicted),
                delta_e=one.delta_e,
                u_delta_e=one.u_delta_e,
            )
            for pose, one in zip(expected.poses, decision.colours, strict=True)
        ),
        quantities=tuple(_quantity(one) for one in decision.quantities),
        lobe=None if decision.fit is None else _lobe(decision.fit, ink),
        map=None if decision.map is None else _map(decision.map, recipe),
        not_judged=(NOT_JUDGED,),
        golden=None if decision.golden is None else _golden(decision.golden, expected),
    )


def _lobe(fit: PrintFit, ink: Ink) -> LobeRecord:
    alpha = float(np.sqrt(ink.alpha * ink.across) * np.exp(fit.state.alpha))
    return LobeRecord(
        alpha=alpha,
        u_alpha=alpha * fit.u("alpha"),
        form=fit.value("lobe"),
        u_form=fit.u("lobe"),
        tilt_deg=(fit.state.tilt_x_deg, fit.state.tilt_y_deg),
        levels=triple(np.exp([fit.state.red, fit.state.green, fit.state.blue])),
        chi2=fit.chi2,
        dof=fit.dof,
    )


def _golden(beside: BesideGolden, expected: PrintExpectation) -> GoldenPrintsRecord:
    fitted = tuple(
        GoldenFitRecord(
            name=name,
            title=FIT_TITLES[name][0],
            unit=FIT_TITLES[name][1],
            measured=float(own),
            mean=float(known.mean()),
            s=float(known.std(ddof=1)),
            golden=tuple(known.tolist()),
        )
        for name, own, known in zip(PARAMETERS, beside.measured, beside.fitted.T, strict=True)
    )
    colours = tuple(
        GoldenColourRecord(
            stage_deg=pose.stage_deg,
            tilt_deg=pose.tilt_deg,
            delta_e=one.delta_e,
            spread=one.spread,
            t2=one.t2,
            p_value=one.p_value,
        )
        for pose, one in zip(expected.poses, beside.colours, strict=True)
    )
    return GoldenPrintsRecord(
        parts=beside.count, t2=beside.t2, p_value=beside.p_fitted, fitted=fitted, colours=colours
    )


def _quantity(one: Quantity) -> QuantityRecord:
    return QuantityRecord(
        name=one.name,
        title=one.title,
        unit=one.unit,
        value=one.value,
        nominal=one.nominal,
        deviation=one.deviation,
        u=one.u,
        limit=one.limit,
        guard=one.guard,
        conformance_probability=one.conformance,
        verdict=one.verdict.value,
    )


def _map(found: PrintMap, recipe: PrintRecipe) -> PrintMapRecord:
    assert recipe.area is not None
    (xx, xy), (yx, yy) = found.curl_deg.tolist()
    return PrintMapRecord(
        cell_mm=recipe.area.cell_mm,
        rows=found.local.shape[0],
        cols=found.local.shape[1],
        cell_delta_e=recipe.area.cell_delta_e,
        noise=found.noise,
        share=found.share,
        u=found.u_share,
        max_share=found.max_share,
        verdict=found.verdict.value,
        curl_deg=((xx, xy), (yx, yy)),
        u_curl_deg=found.u_curl_deg,
        spots=tuple(_spot(one) for one in found.spots),
        learnt=found.learnt,
        p_value=found.p_value,
    )


def _spot(one: Spot) -> SpotRecord:
    return SpotRecord(
        x=one.x_mm,
        y=one.y_mm,
        width=one.width_mm,
        length=one.length_mm,
        area_share=one.area_share,
        cells=one.cells,
        delta_e=one.delta_e,
    )


def nothing_wrong(decision: PrintDecision, alpha: float) -> bool:
    """Is there nothing to explain?"""
    return decision.verdict is Verdict.PASS and decision.p_value >= alpha
