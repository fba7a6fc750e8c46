"""``anisoscope experiment``: the published experiment, predicted, and beside it what was measured."""

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, Parameter

from anisoscope.cli.experiment_output import (
    _findings_text,
    _scale_text,
    _unit,
    experiment_as_json,
    maps_as_json,
    print_csv,
    print_experiment,
    print_maps,
    say,
)
from anisoscope.errors import UsageError

if TYPE_CHECKING:
    from anisoscope.findingsmap import FindingsMap

Model = Literal["printed", "corrected"]
ModelOption = Annotated[Model, Parameter(help="The model as published, or corrected.")]
AlbedoOption = Annotated[float, Parameter(help="Diffuse albedo, 0 to 1; only scales the printed model.")]
IndexOption = Annotated[float, Parameter(help="Refractive index; only scales the printed model.")]
FacetOption = Annotated[float, Parameter(help="Azimuth toward which the facets lean at 0°, in degrees.")]
LightOption = Annotated[float, Parameter(help="Angle between light and camera in degrees.")]
FrameOption = Annotated[
    Literal["pitch-normal", "half-vector"],
    Parameter(help="Axis from which the printed model counts its shadowing."),
]
JsonOption = Annotated[bool, Parameter(name="--json", negative="", help="Print JSON.")]
HtmlOption = Annotated[Path | None, Parameter(help="Write a self-contained HTML page to this file.")]

app = App(name="experiment", help="Repeat the published experiment on ridges.")


@app.command
def ridges(
    *,
    model: ModelOption = "printed",
    measured: Annotated[
        Path | None,
        Parameter(help="CSV: ridge_angle_deg,tilt_deg,from_deg,to_deg,contrast; the scale k is fitted."),
    ] = None,
    alpha_along: Annotated[float, Parameter(help="Beckmann roughness along the ridges.")] = 0.06,
    alpha_across: Annotated[float, Parameter(help="Beckmann roughness across the ridges.")] = 0.10,
    albedo: AlbedoOption = 0.2,
    index: IndexOption = 1.5,
    tilt_plane: Annotated[
        Literal["perpendicular", "in-plane"], Parameter(help="Plane in which camera and light tilt.")
    ] = "perpendicular",
    facet_azimuth: FacetOption = 0.0,
    light_angle: LightOption = 10.0,
    shadow_frame: FrameOption = "pitch-normal",
    json_: JsonOption = False,
    csv_: Annotated[
        bool, Parameter(name="--csv", negative="", help="Print CSV, as --measured reads it.")
    ] = False,
    html: HtmlOption = None,
) -> int:
    """Predict the contrasts of the ridge experiment and their marginal means (Luongo et al. 2017, Fig. 8)."""
    from anisoscope.experiment import Setup, run_experiment
    from anisoscope.measuredtable import read_measured
    from anisoscope.sim.light.geometry import Convention
    from anisoscope.sim.light.material import Material

    _at_most_one({"--json": json_, "--csv": csv_, "--html": html is not None})
    _check_finite(facet_azimuth)
    setup = Setup(
        model,
        Material(alpha_along, alpha_across, albedo, index),
        Convention(light_angle, tilt_plane, facet_azimuth),
        shadow_frame,
    )
    result = run_experiment(setup, None if measured is None else read_measured(measured))
    if json_:
        _print_json(experiment_as_json(result))
    elif csv_:
        print_csv(result)
    elif html is not None:
        from anisoscope.report.experiment_page import write_experiment_page

        write_experiment_page(result, _unit(result), html)
        say(f"{html}: {_findings_text(result.findings)}; {_scale_text(result)}")
    else:
        print_experiment(result)
    return 0


@app.command
def findings(
    *,
    model: ModelOption = "printed",
    grid: Annotated[int, Parameter(help="Roughnesses a side of the grid, 2 to 100.")] = 24,
    alpha_from: Annotated[float, Parameter(help="Smallest roughness of the grid.")] = 0.03,
    alpha_to: Annotated[float, Parameter(help="Largest roughness of the grid.")] = 0.3,
    albedo: AlbedoOption = 0.2,
    index: IndexOption = 1.5,
    facet_azimuth: FacetOption = 0.0,
    light_angle: LightOption = 10.0,
    shadow_frame: FrameOption = "pitch-normal",
    json_: JsonOption = False,
    html: HtmlOption = None,
    svg: Annotated[Path | None, Parameter(help="Write the map as an SVG picture to this file.")] = None,
) -> int:
    """Map the roughnesses at which the published findings come out, for both planes of tilt.

    The grid is even in the logarithm. The corrected model takes about half a minute, the printed one a second.
    """
    import numpy as np

    from anisoscope.experiment import Setup
    from anisoscope.findingsmap import findings_share
    from anisoscope.sim.light.geometry import Convention
    from anisoscope.sim.light.material import Material

    _at_most_one({"--json": json_, "--html": html is not None, "--svg": svg is not None})
    _check_finite(facet_azimuth)
    if not 2 <= grid <= 100:
        raise UsageError(f"--grid takes 2 to 100, not {grid}")
    if not 0.0 < alpha_from < alpha_to:
        raise UsageError(f"--alpha-from {alpha_from} must lie above 0 and below --alpha-to {alpha_to}")
    Material(alpha_from, alpha_to)
    alphas = np.geomspace(alpha_from, alpha_to, grid)
    alphas[[0, -1]] = alpha_from, alpha_to
    maps = [
        findings_share(
            Setup(
                model,
                Material(albedo=albedo, index=index),
                Convention(light_angle, plane, facet_azimuth),
                shadow_frame,
            ),
            alphas,
            alphas,
        )
        for plane in ("perpendicular", "in-plane")
    ]
    if json_:
        _print_json(maps_as_json(maps))
    elif html is not None or svg is not None:
        _write_maps(maps, html, svg)
    else:
        print_maps(maps)
    return 0


def _at_most_one(given: dict[str, bool]) -> None:
    names = [name for name, used in given.items() if used]
    if len(names) > 1:
        raise UsageError(f"{' and '.join(names)} exclude each other")


def _check_finite(facet_azimuth: float) -> None:
    if not math.isfinite(facet_azimuth):
        raise UsageError(f"--facet-azimuth takes a finite number, not {facet_azimuth}")


def _print_json(table: dict[str, Any]) -> None:
    json.dump(table, sys.stdout, indent=2, allow_nan=False)
    sys.stdout.write("\n")


def _write_maps(maps: "list[FindingsMap]", html: Path | None, svg: Path | None) -> None:
    from anisoscope.atomicfile import write_text
    from anisoscope.report.experiment_page import findings_svg, write_findings_page

    shares = "; ".join(f"tilt {m.setup.convention.tilt_plane} {m.share:.1%}" for m in maps)
    if html is not None:
        write_findings_page(maps, html)
    if svg is not None:
        write_text(svg, findings_svg(maps))
    say(f"{html or svg}: all three findings hold on: {shares} of the grid")
