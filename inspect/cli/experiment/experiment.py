"""``anisoscope research experiment``: the published experiment as predicted, with the measured contrasts."""

import math
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from anisoscope.base.csv_style import csv_text, number_text
from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import OF_LIGHT, OF_PLASTIC, Json, RecipeOption
from anisoscope.cli.tables import print_lines, print_table
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.views.options import Given, with_options

if TYPE_CHECKING:
    from anisoscope.experiment.experiment import Experiment, Findings, Mean, Setup
    from anisoscope.experiment.findings_map import FindingsMap


def _unit(result: "Experiment") -> str:
    return "1/sr" if result.measured is None else "as measured"


def _setup_as_json(setup: "Setup") -> dict[str, Any]:
    found: dict[str, Any] = {"model": setup.model, "convention": asdict(setup.convention)}
    if setup.model == "printed":
        found["shadow_frame"] = setup.shadow_frame
    return found


def experiment_as_json(result: "Experiment") -> dict[str, Any]:
    """The experiment as a table for JSON."""
    from anisoscope.experiment.experiment import COLUMNS, combinations

    rows = []
    for place, row in combinations():
        entry: dict[str, Any] = dict(zip(COLUMNS, (*row, float(result.predicted[place])), strict=True))
        if result.measured is not None and math.isfinite(result.measured[place]):
            entry["measured"] = float(result.measured[place])
        rows.append(entry)
    found = _setup_as_json(result.setup) | {"material": asdict(result.setup.material), "k": result.k}
    if result.measured is not None:
        found["rms_residual"] = result.rms_residual
    found |= {
        "unit": _unit(result),
        "rows": rows,
        "means": {
            name: [_mean_as_json(m, with_measured=result.measured is not None) for m in means]
            for name, means in result.means.items()
        },
        "findings": asdict(result.findings),
    }
    if result.measured_findings is not None:
        found["measured_findings"] = asdict(result.measured_findings)
    return found


def _mean_as_json(mean: "Mean", *, with_measured: bool) -> dict[str, Any]:
    level = mean.level_deg[0] if len(mean.level_deg) == 1 else list(mean.level_deg)
    found: dict[str, Any] = {"level_deg": level, "predicted": mean.predicted}
    if with_measured:
        found["measured"] = mean.measured
        found["measured_rows"] = mean.measured_rows
        found["predicted_same_rows"] = mean.predicted_same_rows
    return found


def print_csv(result: "Experiment") -> None:
    """Print one line a combination."""
    from anisoscope.experiment.experiment import COLUMNS, combinations

    with_measured = result.measured is not None
    rows: list[list[str]] = [[*COLUMNS, *["measured"][:with_measured]]]
    for place, row in combinations():
        values = [*(f"{value:g}" for value in row), repr(float(result.predicted[place]))]
        if result.measured is not None:
            mean = float(result.measured[place])
            values.append(repr(mean) if math.isfinite(mean) else "")
        rows.append([number_text(value) for value in values])
    sys.stdout.write(csv_text(rows, file=False))


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def _best(found: "Findings") -> str:
    return "none" if found.best_ridge_angle_deg is None else f"{found.best_ridge_angle_deg:g}°"


def _findings_text(found: "Findings") -> str:
    return (
        f"largest at zero tilt: {_yes(found.max_at_zero_tilt)} (falling on both sides: "
        f"{_yes(found.falls_on_both_sides)}); 0° / 90° larger than 90° / 180°: {_yes(found.first_pair_larger)}; "
        f"best ridge angle: {_best(found)}"
    )


def _scale_text(result: "Experiment") -> str:
    if result.measured is None:
        return "k = 1"
    return f"k = {result.k:.6g} (least squares), rms residual {result.rms_residual:.3g}"


def _number(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:.5g}"


def print_experiment(result: "Experiment") -> None:
    """Print means and findings."""
    from anisoscope.experiment.experiment import combinations
    from anisoscope.report.experiment_page import AXIS_NAMES, convention_text, level_text

    measured = result.measured
    head = [f"predicted [{_unit(result)}]"] + ([] if measured is None else ["measured"])
    print_table(
        "Absolute contrasts of radiant exposure",
        ["ridge angle [°]", "tilt [°]", "from [°]", "to [°]", *head],
        [
            [f"{value:g}" for value in row]
            + [_number(float(result.predicted[place]))]
            + ([] if measured is None else [_number(float(measured[place]))])
            for place, row in combinations()
        ],
    )
    # With rows missing, means over all rows and over the measured ones differ: only the latter compare with the
    # measured means, so both are shown.
    if measured is not None and not result.complete:
        head.insert(1, "predicted, measured rows")
    rows = []
    for name in AXIS_NAMES:
        for m in result.means[name]:
            values = [m.predicted] + ([] if measured is None else [m.measured])
            if measured is not None and not result.complete:
                values.insert(1, m.predicted_same_rows)
            rows.append(
                [f"{AXIS_NAMES[name]} {level_text(m.level_deg)}", *(_number(value) for value in values)]
            )
    print_table("Mean contrasts", ["mean over all others", *head], rows)
    setup = result.setup
    frame = f", shadow frame {setup.shadow_frame}" if setup.model == "printed" else ""
    print_lines(f"model {setup.model}{frame}; {convention_text(setup.convention)}; {_scale_text(result)}")
    print_lines(f"predicted: {_findings_text(result.findings)}")
    if result.measured_findings is not None:
        print_lines(f"measured: {_findings_text(result.measured_findings)}")


def maps_as_json(maps: "list[FindingsMap]") -> dict[str, Any]:
    """The maps of the findings as a table for JSON."""
    return {
        "model": maps[0].setup.model,
        "alpha_along": maps[0].alpha_along.tolist(),
        "alpha_across": maps[0].alpha_across.tolist(),
        "maps": [
            _setup_as_json(m.setup)
            | {
                "share": m.share,
                "share_falling_too": float(m.falling_too.mean()),
                "shares": {
                    "max_at_zero_tilt": float(m.max_at_zero_tilt.mean()),
                    "falls_on_both_sides": float(m.falls_on_both_sides.mean()),
                    "first_pair_larger": float(m.first_pair_larger.mean()),
                    "best_at_five": float(m.best_at_five.mean()),
                },
                "extent": m.extent and {"alpha_along": m.extent[0], "alpha_across": m.extent[1]},
                "all_three": m.all_three.tolist(),
            }
            for m in maps
        ],
    }


def print_maps(maps: "list[FindingsMap]") -> None:
    """Print on which share of the grid the findings hold."""
    from anisoscope.report.experiment_page import convention_text

    extents = [m.extent or (None, None) for m in maps]
    rows = [
        ["mean contrast is largest at zero tilt", *(f"{m.max_at_zero_tilt.mean():.1%}" for m in maps)],
        ["0° / 90° exceeds 90° / 180°", *(f"{m.first_pair_larger.mean():.1%}" for m in maps)],
        ["5° is the best ridge angle", *(f"{m.best_at_five.mean():.1%}" for m in maps)],
        ["all three", *(f"{m.share:.1%}" for m in maps)],
        ["  within alpha along", *(_range(along) for along, _ in extents)],
        ["  within alpha across", *(_range(across) for _, across in extents)],
        ["all three, and falling on both sides", *(f"{m.falling_too.mean():.1%}" for m in maps)],
    ]
    print_table(
        "Share of the grid on which the published findings hold",
        ["finding", *(f"tilt {m.setup.convention.tilt_plane}" for m in maps)],
        rows,
    )
    side, setup = maps[0].alpha_along, maps[0].setup
    frame = f", shadow frame {setup.shadow_frame}" if setup.model == "printed" else ""
    print_lines(
        f"model {setup.model}{frame}; {side.size} × {side.size} roughnesses from {side[0]:g} to {side[-1]:g}, "
        "even in the logarithm"
    )
    for m in maps:
        print_lines(f"tilt {m.setup.convention.tilt_plane}: {convention_text(m.setup.convention)}")


def _range(ends: tuple[float, float] | None) -> str:
    return "–" if ends is None else f"{ends[0]:.3g}…{ends[1]:.3g}"


Model = Literal["printed", "corrected"]
ModelOption = Annotated[Model, Parameter(help="The model as published, or corrected.")]


FrameOption = Annotated[
    Literal["pitch-normal", "half-vector"],
    Parameter(help="Axis from which the printed model counts its shadowing."),
]
HtmlOption = Annotated[Path | None, Parameter(help="Write a self-contained HTML page to this file.")]


@with_options(plastic=OF_PLASTIC, rig=OF_LIGHT)
@everyday("recipe", "model", "measured", "plastic", "rig", "json_", "csv_", "html")
def experiment(
    *,
    recipe: RecipeOption = None,
    model: ModelOption = "printed",
    measured: Annotated[
        Path | None,
        Parameter(help="CSV: ridge_angle_deg,tilt_deg,from_deg,to_deg,contrast; the scale k is fitted."),
    ] = None,
    plastic: Given[Material],
    rig: Given[Convention],
    shadow_frame: FrameOption = "pitch-normal",
    json_: Json = False,
    csv_: Annotated[
        bool, Parameter(name="--as-csv", negative="", help="Print CSV, as --measured reads it.")
    ] = False,
    html: HtmlOption = None,
) -> int:
    """Predict the contrasts of the ridge experiment and their marginal means (Luongo et al. 2017, Fig. 8).

    Examples:
        anisoscope research experiment
        anisoscope research experiment --measured table.csv --html fig8.html
    """
    from anisoscope.experiment.experiment import Setup, run_experiment
    from anisoscope.experiment.measured_table import read_measured
    from anisoscope.operations.stated import stated

    _at_most_one({"--json": json_, "--as-csv": csv_, "--html": html is not None})
    base = stated(recipe)
    setup = Setup(model, plastic.over(base.material), rig.over(base.convention), shadow_frame)
    result = run_experiment(setup, None if measured is None else read_measured(measured))
    if json_:
        print_json(experiment_as_json(result))
    elif csv_:
        print_csv(result)
    elif html is not None:
        from anisoscope.report.experiment_page import write_experiment_page

        write_experiment_page(result, _unit(result), html)
        print_lines(f"{html}: {_findings_text(result.findings)}; {_scale_text(result)}")
    else:
        print_experiment(result)
    return 0


@with_options(
    plastic=replace(OF_PLASTIC, without=dict.fromkeys(("alpha_along", "alpha_across"), "the map's axes")),
    rig=replace(OF_LIGHT, without={"tilt_plane": "both planes are mapped"}),
)
@everyday(
    *("recipe", "model", "grid_points", "alpha_from", "alpha_to"), *("plastic", "rig", "json_", "html", "svg")
)
def findings(
    *,
    recipe: RecipeOption = None,
    model: ModelOption = "printed",
    grid_points: Annotated[int, Parameter(help="Roughnesses per side of the grid, 2 to 100.")] = 24,
    alpha_from: Annotated[float, Parameter(help="Smallest roughness of the grid.")] = 0.03,
    alpha_to: Annotated[float, Parameter(help="Largest roughness of the grid.")] = 0.3,
    plastic: Given[Material],
    rig: Given[Convention],
    shadow_frame: FrameOption = "pitch-normal",
    json_: Json = False,
    html: HtmlOption = None,
    svg: Annotated[Path | None, Parameter(help="Write the map as an SVG picture to this file.")] = None,
) -> int:
    """Map the roughnesses at which the published findings come out, for both planes of tilt.

    The grid is even in the logarithm. The corrected model takes about half a minute, the printed one a second.

    Examples:
        anisoscope research findings --model corrected
    """
    import numpy as np

    from anisoscope.experiment.experiment import Setup
    from anisoscope.experiment.findings_map import findings_share
    from anisoscope.operations.stated import stated

    _at_most_one({"--json": json_, "--html": html is not None, "--svg": svg is not None})
    base = stated(recipe)
    material, convention = plastic.over(base.material), rig.over(base.convention)
    if not 2 <= grid_points <= 100:
        raise UsageError(f"--grid-points takes 2 to 100, not {grid_points}")
    if not 0.0 < alpha_from < alpha_to:
        raise UsageError(f"--alpha-from {alpha_from} must lie above 0 and below --alpha-to {alpha_to}")
    replace(material, alpha_along=alpha_from, alpha_across=alpha_to)
    alphas = np.geomspace(alpha_from, alpha_to, grid_points)
    alphas[[0, -1]] = alpha_from, alpha_to
    maps = [
        findings_share(
            Setup(model, material, replace(convention, tilt_plane=plane), shadow_frame),
            alphas,
            alphas,
        )
        for plane in ("perpendicular", "in-plane")
    ]
    if json_:
        print_json(maps_as_json(maps))
    elif html is not None or svg is not None:
        _write_maps(maps, html, svg)
    else:
        print_maps(maps)
    return 0


def _at_most_one(given: dict[str, bool]) -> None:
    names = [name for name, used in given.items() if used]
    if len(names) > 1:
        raise UsageError(f"{' and '.join(names)} exclude each other")


def _write_maps(maps: "list[FindingsMap]", html: Path | None, svg: Path | None) -> None:
    from anisoscope.base.atomic_write import write_text
    from anisoscope.report.experiment_page import findings_svg, write_findings_page

    shares = "; ".join(f"tilt {m.setup.convention.tilt_plane} {m.share:.1%}" for m in maps)
    if html is not None:
        write_findings_page(maps, html)
    if svg is not None:
        write_text(svg, findings_svg(maps))
    print_lines(f"{html or svg}: all three findings hold on: {shares} of the grid")
