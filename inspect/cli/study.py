"""``anisoscope study``: what imperfect surfaces do to the contrast, by simulation."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, Parameter

from anisoscope.cli.console import console, print_table, progress
from anisoscope.cli.optimise import HtmlOption, JobsOption, JsonOption, PlotOption, SchedulerOption
from anisoscope.cli.study_output import (
    angle_charts,
    angle_json,
    angle_tables,
    convergence_charts,
    convergence_json,
    convergence_tables,
)
from anisoscope.errors import UsageError

if TYPE_CHECKING:
    from anisoscope.report.study_page import Chart, Table

Quality = Annotated[
    Literal["quick", "normal", "fine"],
    Parameter(help="Size of the height maps and number of random surfaces; fine takes many times as long."),
]
AlongOption = Annotated[float, Parameter(help="Beckmann roughness along the ridges.")]
AcrossOption = Annotated[float, Parameter(help="Beckmann roughness across the ridges.")]
AlbedoOption = Annotated[float, Parameter(help="Diffuse albedo, 0 to 1.")]
SeedOption = Annotated[int, Parameter(help="Seed of the random surfaces.")]

app = App(name="study", help="What imperfect surfaces do to the contrast, by simulation.")
app.command("anisoscope.cli.study_detection:detection_command", name="detection")


@app.command(name="convergence")
def convergence_command(
    *,
    defects: Annotated[
        str,
        Parameter(help="Comma-separated: roughness, burrs, angle-error, height-loss, edge-rounding; or all."),
    ] = "all",
    ridge_angle: Annotated[float, Parameter(help="Ridge angle in degrees.")] = 10.0,
    alpha_along: AlongOption = 0.06,
    alpha_across: AcrossOption = 0.10,
    albedo: AlbedoOption = 0.2,
    severities: Annotated[
        int, Parameter(help="Sizes of each defect, each half the one before; 3 to 10.")
    ] = 6,
    quality: Quality = "normal",
    seed: SeedOption = 1,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    json_: JsonOption = False,
    html: HtmlOption = None,
    plot: PlotOption = None,
) -> int:
    """Follow how contrasts approach the ideal prediction as defects vanish, and at which order."""
    from anisoscope.profiles.ideal import RidgeDesign
    from anisoscope.report.study_page import check_picture
    from anisoscope.sim.light.material import Material
    from anisoscope.study.convergence import DEFECTS, PITCH_UM, QUALITIES, convergence
    from anisoscope.study.sweep import Workers

    check_picture(plot)
    if not 3 <= severities <= 10:
        raise UsageError(f"--severities takes 3 to 10, not {severities}")
    chosen: Any = DEFECTS if defects == "all" else tuple(dict.fromkeys(defects.split(",")))
    with progress("convergence", quiet=json_) as advance:
        found = convergence(
            chosen,
            RidgeDesign(PITCH_UM, ridge_angle),
            Material(alpha_along, alpha_across, albedo),
            QUALITIES[quality],
            Workers(jobs, scheduler),
            severities=severities,
            seed=seed,
            advance=advance,
        )
    title = "Convergence to the ideal prediction"
    subtitle = (
        f"ridge angle {ridge_angle:g}°, unresolved roughness {alpha_along:g}/{alpha_across:g}, albedo {albedo:g}; "
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
def best_angle_command(
    *,
    imperfections: Annotated[
        str,
        Parameter(
            help="Comma-separated: roughness, roughness-along, roughness-across, height-loss, edge-radius, burrs, "
            "seating, noise, bounces, albedo; or all."
        ),
    ] = "all",
    alpha_along: AlongOption = 0.06,
    alpha_across: AcrossOption = 0.10,
    albedo: AlbedoOption = 0.2,
    step: Annotated[float, Parameter(help="Step of the ridge angles in degrees, 0.1 to 1.")] = 0.5,
    quality: Quality = "quick",
    seed: SeedOption = 1,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    json_: JsonOption = False,
    html: HtmlOption = None,
    plot: PlotOption = None,
) -> int:
    """Ask whether an imperfection moves the best ridge angle of the published experiment from 5° to 10°."""
    from anisoscope.report.study_page import check_picture
    from anisoscope.sim.light.material import Material
    from anisoscope.study.best_angle import IMPERFECTIONS, best_angle
    from anisoscope.study.convergence import QUALITIES
    from anisoscope.study.sweep import Workers

    check_picture(plot)
    if not 0.1 <= step <= 1.0:
        raise UsageError(f"--step takes 0.1 to 1 degree, not {step:g}")
    names = tuple(IMPERFECTIONS) if imperfections == "all" else tuple(dict.fromkeys(imperfections.split(",")))
    with progress("best angle", quiet=json_) as advance:
        found = best_angle(
            names,
            Material(alpha_along, alpha_across, albedo),
            QUALITIES[quality],
            Workers(jobs, scheduler),
            step_deg=step,
            seed=seed,
            advance=advance,
        )
    title = "Best ridge angle of the published experiment"
    subtitle = (
        f"roughness {alpha_along:g}/{alpha_across:g}, albedo {albedo:g}, but for the imperfection; quality {quality}, "
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
        json.dump(as_json, sys.stdout, indent=2, allow_nan=False)
        sys.stdout.write("\n")
        return
    for table in tables:
        print_table(table.title, list(table.columns), [list(row) for row in table.rows], table.note or None)
    for text in (subtitle, *notes):
        console().print(text, markup=False, highlight=False, soft_wrap=True)
