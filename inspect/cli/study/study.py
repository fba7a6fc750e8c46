"""``anisoscope research``: published results repeated, and effects of imperfect surfaces by simulation."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import OF_PLASTIC, OF_RIDGES, Json, RecipeOption
from anisoscope.cli.progress import progress
from anisoscope.cli.study.optimise import HtmlOption, JobsOption, PlotOption, SchedulerOption
from anisoscope.cli.tables import print_lines, print_table
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.views.options import Given, with_options

if TYPE_CHECKING:
    from anisoscope.report.study_page import Chart, Table
    from anisoscope.study.best_angle import AngleStudy
    from anisoscope.study.convergence import ConvergenceStudy


def _share(value: float) -> str:
    return f"{value:.3%}" if math.isfinite(value) else "–"


def convergence_json(found: "ConvergenceStudy") -> dict[str, Any]:
    """The study as a table for JSON."""
    from dataclasses import asdict

    from anisoscope.study.convergence import IMPERFECTIONS

    return {
        "design": asdict(found.design),
        "material": asdict(found.material),
        "sampling": asdict(found.sampling),
        "defects": [
            {
                "defect": curve.defect,
                "unit": IMPERFECTIONS[curve.defect].unit,
                "severity": curve.severity,
                "total": curve.total,
                "bias": curve.bias,
                "scatter": curve.scatter,
                "mean_contrast": curve.mean_contrast,
                "sampling_bias": curve.sampling_bias,
                "orders": {name: asdict(order) for name, order in curve.orders.items()},
            }
            for curve in found.curves
        ],
    }


def convergence_tables(found: "ConvergenceStudy") -> "list[Table]":
    """Its tables."""
    from anisoscope.report.study_page import Table
    from anisoscope.study.convergence import IMPERFECTIONS

    rows: list[tuple[str, ...]] = []
    orders: list[tuple[str, ...]] = []
    for curve in found.curves:
        unit = IMPERFECTIONS[curve.defect].unit
        rows += [
            (
                curve.defect,
                f"{curve.severity[number]:.4g} {unit}",
                _share(curve.total[number]),
                _share(curve.bias[number]),
                _share(curve.scatter[number]),
                f"{curve.mean_contrast[number]:.4f}",
            )
            for number in reversed(range(len(curve.severity)))
        ]
        orders += [
            (curve.defect, name, f"{order.slope:.2f}", f"{order.low:.2f} … {order.high:.2f}")
            for name, order in curve.orders.items()
        ]
    return [
        Table(
            "Order of convergence", ("defect", "deviation", "order [1]", "95 % interval [1]"), tuple(orders)
        ),
        Table(
            "Deviation by severity",
            ("defect", "severity", "total [%]", "bias [%]", "scatter [%]", "mean |C| / ideal [1]"),
            tuple(rows),
        ),
    ]


def convergence_charts(found: "ConvergenceStudy") -> "list[Chart]":
    """Its pictures."""
    import numpy as np

    from anisoscope.report.study_page import Chart, Curve
    from anisoscope.study.convergence import IMPERFECTIONS

    charts = []
    for curve in found.curves:
        lines = [Curve("total", curve.severity, curve.total)]
        if "scatter" in curve.orders:
            lines += [
                Curve("bias", curve.severity, curve.bias),
                Curve("scatter", curve.severity, curve.scatter),
            ]
        for order in (1, 2):
            guide = curve.total[-1] * (curve.severity / curve.severity[-1]) ** order
            lines.append(Curve(f"order {order}", curve.severity, np.asarray(guide), dashed=True))
        unit = IMPERFECTIONS[curve.defect].unit
        charts.append(
            Chart(curve.defect, f"severity [{unit}]", "deviation / ideal [1]", tuple(lines), log=True)
        )
    return charts


def angle_json(found: "tuple[AngleStudy, ...]") -> dict[str, Any]:
    """The study as a table for JSON."""
    return {
        "imperfections": [
            {
                "imperfection": study.imperfection.name,
                "severity_is": study.imperfection.what,
                "ten_overtakes_five_at": study.turns_at,
                "curves": [
                    {
                        "severity": curve.severity,
                        "best_deg": curve.best_deg,
                        "best_sd_deg": curve.best_sd_deg,
                        "best_published_deg": curve.best_published_deg,
                        "at_edge": curve.at_edge,
                        "ten_over_five": curve.ten_over_five,
                        "max_at_zero_tilt": curve.findings.max_at_zero_tilt,
                        "first_pair_larger": curve.findings.first_pair_larger,
                        "angles_deg": curve.angles_deg,
                        "contrast": curve.contrast,
                        "contrast_sd": curve.sd,
                    }
                    for curve in study.curves
                ],
            }
            for study in found
        ]
    }


def angle_tables(found: "tuple[AngleStudy, ...]") -> "list[Table]":
    """Its tables."""
    from anisoscope.report.study_page import Table

    tables = []
    for study in found:
        turns = study.turns_at
        always = study.curves[0].ten_over_five > 1.0
        note = (
            f"10° overtakes 5° at {turns:.3g}"
            if turns is not None and not always
            else f"5° overtakes 10° at {turns:.3g}"
            if turns is not None
            else "10° exceeds 5° throughout"
            if always
            else "5° exceeds 10° throughout"
        )
        rows = []
        for curve in study.curves:
            best = f"{curve.best_deg:.2f}" + (f" ± {curve.best_sd_deg:.2f}" if curve.best_sd_deg else "")
            rows.append(
                (
                    f"{curve.severity:g}",
                    best + (" (edge)" if curve.at_edge else ""),
                    f"{curve.best_published_deg:g}",
                    *(f"{value:.5f}" for value in curve.published),
                    f"{curve.ten_over_five:.3f}",
                    "yes" if curve.findings.max_at_zero_tilt else "no",
                )
            )
        columns = (
            study.imperfection.what, "best [°]", "best of the four [°]",
            "5° [1/sr]", "10° [1/sr]", "15° [1/sr]", "20° [1/sr]", "10° / 5° [1]", "most at zero tilt",
        )  # fmt: skip
        tables.append(Table(study.imperfection.name, columns, tuple(rows), note))
    return tables


def angle_charts(found: "tuple[AngleStudy, ...]") -> "list[Chart]":
    """Its pictures."""
    from anisoscope.report.study_page import Chart, Curve

    charts = []
    for study in found:
        lines = tuple(
            Curve(
                f"{curve.severity:g}",
                curve.angles_deg,
                curve.contrast / curve.contrast.max(),
                *(
                    ()
                    if not curve.sd.any()
                    else (
                        (curve.contrast - curve.sd) / curve.contrast.max(),
                        (curve.contrast + curve.sd) / curve.contrast.max(),
                    )
                ),
            )
            for curve in study.curves
        )
        charts.append(
            Chart(
                study.imperfection.what, "ridge angle [°]", "mean |C| / its maximum [1]", lines, points=False
            )
        )
    return charts


Quality = Annotated[
    Literal["quick", "normal", "fine"],
    Parameter(help="Size of the height maps and number of random surfaces; fine takes many times as long."),
]


SeedOption = Annotated[int, Parameter(help="Seed of the random surfaces.")]

app = App(
    name="research", help="Repeat published results, and simulate how defects change contrasts and verdicts."
)
app.command("anisoscope.cli.experiment.experiment:experiment", name="experiment")
app.command("anisoscope.cli.experiment.experiment:findings", name="findings")
app.command("anisoscope.cli.study.pod:pod_command", name="pod")
app.command("anisoscope.cli.study.papers:papers", name="papers")


@app.command(name="convergence")
@with_options(
    ridges=replace(
        OF_RIDGES,
        without={
            "pitch_um": "the study's own, 100 µm",
            **dict.fromkeys(("height_loss", "edge_radius_um"), "defects that the study adds"),
            "wall": "the study's surfaces have walls perpendicular to the facet",
        },
    ),
    plastic=OF_PLASTIC,
)
@everyday(
    *("defects", "ridges", "plastic", "recipe", "severities", "quality", "seed", "jobs"),
    *("json_", "html", "plot"),
)
def convergence_command(
    *,
    recipe: RecipeOption = None,
    defects: Annotated[
        str,
        Parameter(help="Comma-separated: roughness, burrs, angle-error, height-loss, edge-rounding; or all."),
    ] = "all",
    ridges: Given[RidgeDesign],
    plastic: Given[Material],
    severities: Annotated[
        int, Parameter(help="Sizes of each defect, each half the one before; 3 to 10.")
    ] = 6,
    quality: Quality = "normal",
    seed: SeedOption = 1,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    json_: Json = False,
    html: HtmlOption = None,
    plot: PlotOption = None,
) -> int:
    """Show how contrasts approach the ideal prediction as defects vanish, and at which order.

    Examples:
        anisoscope research convergence --plot convergence.png
    """
    from anisoscope.operations.stated import stated
    from anisoscope.report.study_page import check_picture
    from anisoscope.study.convergence import IMPERFECTIONS, PITCH_UM, QUALITIES, convergence
    from anisoscope.study.sweep import Workers

    check_picture(plot)
    base = stated(recipe)
    material = plastic.over(base.material)
    angle_deg = 10.0 if base.design is None else base.design.ridge_angle_deg
    design = ridges.over(RidgeDesign(PITCH_UM, angle_deg))
    if not 3 <= severities <= 10:
        raise UsageError(f"--severities takes 3 to 10, not {severities}")
    chosen = tuple(IMPERFECTIONS) if defects == "all" else tuple(dict.fromkeys(defects.split(",")))
    with progress("convergence", quiet=json_) as advance:
        found = convergence(
            chosen,
            design,
            material,
            QUALITIES[quality],
            Workers(jobs, scheduler),
            severities=severities,
            seed=seed,
            advance=advance,
        )
    title = "Convergence to the ideal prediction"
    subtitle = (
        f"ridge angle {design.ridge_angle_deg:g}°, unresolved roughness "
        f"{material.alpha_along:g}/{material.alpha_across:g}, albedo {material.albedo:g}; "
        f"published poses; quality {quality}, seed {seed}"
    )
    notes = [
        (
            "Deviation: rms of C − C(ideal) over the 10 signed differences, relative to the rms of C(ideal); both by "
            "the relief predictor on the same points, direct light."
        ),
        (
            "Bias is what all surfaces have in common, scatter what differs between pieces of "
            f"{found.sampling.ridges * PITCH_UM:g} × {found.sampling.length_um:g} µm; order: slope of the four mildest "
            "sizes in the logarithm, 95 % interval."
        ),
        (
            "Sampling itself, relief of the unspoiled surface against the corrected model: "
            f"{max(curve.sampling_bias for curve in found.curves):.3%}."
        ),
    ]
    _hand_out(
        title,
        subtitle,
        convergence_json(found),
        convergence_charts(found),
        convergence_tables(found),
        notes,
        json_=json_,
        html=html,
        plot=plot,
    )
    return 0


@app.command(name="best-angle")
@with_options(plastic=OF_PLASTIC)
@everyday(*("recipe", "imperfections", "plastic", "step", "quality", "seed"), *("json_", "html", "plot"))
def best_angle_command(
    *,
    recipe: RecipeOption = None,
    imperfections: Annotated[
        str,
        Parameter(
            help="Comma-separated: roughness, roughness-along, roughness-across, height-loss, edge-radius, burrs, "
            "seating, noise, bounces, albedo; or all."
        ),
    ] = "all",
    plastic: Given[Material],
    step: Annotated[float, Parameter(help="Step of the ridge angles in degrees, 0.1 to 1.")] = 0.5,
    quality: Quality = "quick",
    seed: SeedOption = 1,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    json_: Json = False,
    html: HtmlOption = None,
    plot: PlotOption = None,
) -> int:
    """Test whether an imperfection moves the best ridge angle of the published experiment from 5° to 10°.

    Examples:
        anisoscope research best-angle --step 1
    """
    from anisoscope.operations.stated import stated
    from anisoscope.report.study_page import check_picture
    from anisoscope.study.best_angle import IMPERFECTIONS, best_angle
    from anisoscope.study.convergence import QUALITIES
    from anisoscope.study.sweep import Workers

    check_picture(plot)
    material = plastic.over(stated(recipe).material)
    if not 0.1 <= step <= 1.0:
        raise UsageError(f"--step takes 0.1 to 1 degree, not {step:g}")
    names = tuple(IMPERFECTIONS) if imperfections == "all" else tuple(dict.fromkeys(imperfections.split(",")))
    with progress("best angle", quiet=json_) as advance:
        found = best_angle(
            names,
            material,
            QUALITIES[quality],
            Workers(jobs, scheduler),
            step_deg=step,
            seed=seed,
            advance=advance,
        )
    title = "Best ridge angle of the published experiment"
    subtitle = (
        f"roughness {material.alpha_along:g}/{material.alpha_across:g}, albedo {material.albedo:g}, "
        f"but for the imperfection; quality {quality}, "
        f"seed {seed}"
    )
    notes = [
        (
            "Contrast: mean of |C| over the 5 tilts and 2 pairs of the published experiment, 1/sr; corrected model in "
            "direct light, with burrs the relief predictor, reflections where they are what grows."
        ),
        (
            "Best angle: over 2° to 25°, not only the four published ones; ± is the standard deviation of the mean by "
            "the pieces of surface."
        ),
    ]
    _hand_out(
        title,
        subtitle,
        angle_json(found),
        angle_charts(found),
        angle_tables(found),
        notes,
        json_=json_,
        html=html,
        plot=plot,
    )
    return 0


def _hand_out(
    title: str,
    subtitle: str,
    as_json: dict[str, Any],
    charts: "list[Chart]",
    tables: "list[Table]",
    notes: list[str],
    *,
    json_: bool,
    html: Path | None,
    plot: Path | None,
) -> None:
    from anisoscope.report.study_page import write_picture, write_study_page

    if html is not None:
        write_study_page(html, title, subtitle, charts, tables, notes)
    if plot is not None:
        write_picture(plot, charts)
    if json_:
        print_json(as_json)
        return
    for table in tables:
        print_table(table.title, list(table.columns), [list(row) for row in table.rows], table.note or None)
    print_lines(*(subtitle, *notes))
