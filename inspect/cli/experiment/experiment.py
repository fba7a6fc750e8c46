"""``anisoscope research experiment``: the published experiment as predicted, with the measured contrasts."""

import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import NO_BASE, OF_LIGHT, OF_PLASTIC, PRINTED, Base, Output
from anisoscope.cli.tables import print_lines, print_table
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.roughness_grid import RoughnessGrid
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.experiment.experiment import Experiment
    from anisoscope.experiment.findings_map import FindingsMap


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
    head = [f"predicted [{result.unit}]"] + ([] if measured is None else ["measured"])
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
    print_lines(f"{setup.model_text}; {convention_text(setup.convention)}; {_scale_text(result)}")
    print_lines(f"predicted: {result.findings.text}")
    if result.measured_findings is not None:
        print_lines(f"measured: {result.measured_findings.text}")


def print_maps(maps: "Sequence[FindingsMap]") -> None:
    """Print on which share of the grid the findings hold."""
    from anisoscope.report.experiment_page import convention_text

    ends = [m.extent or {} for m in maps]
    labels = {
        "max_at_zero_tilt": "mean contrast is largest at zero tilt",
        "first_pair_larger": "0° / 90° exceeds 90° / 180°",
        "best_at_five": "5° is the best ridge angle",
    }
    rows = [
        *([label, *(f"{m.shares[name]:.1%}" for m in maps)] for name, label in labels.items()),
        ["all three", *(f"{m.share:.1%}" for m in maps)],
        ["  within alpha along", *(_range(one.get("alpha_along")) for one in ends)],
        ["  within alpha across", *(_range(one.get("alpha_across")) for one in ends)],
        ["all three, and falling on both sides", *(f"{m.share_falling_too:.1%}" for m in maps)],
    ]
    print_table(
        "Share of the grid on which the published findings hold",
        ["finding", *(f"tilt {m.setup.convention.tilt_plane}" for m in maps)],
        rows,
    )
    side = maps[0].alpha_along
    print_lines(
        f"{maps[0].setup.model_text}; {side.size} × {side.size} roughnesses from {side[0]:g} to {side[-1]:g}, "
        "even in the logarithm"
    )
    for m in maps:
        print_lines(f"tilt {m.setup.convention.tilt_plane}: {convention_text(m.setup.convention)}")


def _range(ends: tuple[float, float] | None) -> str:
    return "–" if ends is None else f"{ends[0]:.3g}…{ends[1]:.3g}"


ModelOption = Annotated[
    Literal["printed", "corrected"], Parameter(help="The model as published, or corrected.")
]


FrameOption = Annotated[
    Literal["pitch-normal", "half-vector"],
    Parameter(help="Axis from which the printed model counts its shadowing."),
]


@with_options(plastic=OF_PLASTIC, rig=OF_LIGHT)
@everyday("base", "model", "measured", "plastic", "rig", "output", "csv_")
def experiment(
    *,
    base: Base = NO_BASE,
    model: ModelOption = "printed",
    measured: Path | None = None,
    plastic: Given[Material],
    rig: Given[Convention],
    shadow_frame: FrameOption = "pitch-normal",
    output: Output = PRINTED,
    csv_: Annotated[bool, Parameter(name="--as-csv", negative="")] = False,
) -> int:
    """Predict the contrasts of the ridge experiment and their marginal means (Luongo et al. 2017, Fig. 8).

    Args:
        measured: CSV: ridge_angle_deg,tilt_deg,from_deg,to_deg,contrast; the scale k is fitted.
        csv_: Print CSV, as --measured reads it.

    Examples:
        anisoscope research experiment
        anisoscope research experiment --measured table.csv --html fig8.html
    """
    from anisoscope.experiment.experiment import Setup, run_experiment

    _at_most_one({"--json": output.json_, "--as-csv": csv_, "--html": output.html is not None})
    known, html = base.stated(), output.html
    setup = Setup(model, plastic.over(known.material), rig.over(known.convention), shadow_frame)
    result = run_experiment(setup, measured)
    if output.json_:
        print_json(result)
    elif csv_:
        sys.stdout.write(result.csv())
    elif html is not None:
        from anisoscope.report.experiment_page import write_experiment_page

        write_experiment_page(result, html)
        print_lines(f"{html}: {result.findings.text}; {_scale_text(result)}")
    else:
        print_experiment(result)
    return 0


@with_options(
    grid=Options(RoughnessGrid, whole=True),
    plastic=replace(OF_PLASTIC, without=dict.fromkeys(("alpha_along", "alpha_across"), "the map's axes")),
    rig=replace(OF_LIGHT, without={"tilt_plane": "both planes are mapped"}),
)
@everyday(
    *("base", "model", "grid", "plastic", "rig", "output", "svg"),
)
def findings(
    *,
    base: Base = NO_BASE,
    model: ModelOption = "printed",
    grid: Given[RoughnessGrid],
    plastic: Given[Material],
    rig: Given[Convention],
    shadow_frame: FrameOption = "pitch-normal",
    output: Output = PRINTED,
    svg: Annotated[Path | None, Parameter(help="Write the map as an SVG picture to this file.")] = None,
) -> int:
    """Map the roughnesses at which the published findings come out, for both planes of tilt.

    The grid is even in the logarithm. The corrected model takes about half a minute, the printed one a second.

    Examples:
        anisoscope research findings --model corrected
    """
    from anisoscope.experiment.experiment import Setup
    from anisoscope.experiment.findings_map import findings_maps

    _at_most_one({"--json": output.json_, "--html": output.html is not None, "--svg": svg is not None})
    known, html = base.stated(), output.html
    setup = Setup(model, plastic.over(known.material), rig.over(known.convention), shadow_frame)
    found = findings_maps(setup, grid=grid.made())
    if output.json_:
        print_json(found)
    elif html is not None or svg is not None:
        _write_maps(found.maps, html, svg)
    else:
        print_maps(found.maps)
    return 0


def _at_most_one(given: dict[str, bool]) -> None:
    names = [name for name, used in given.items() if used]
    if len(names) > 1:
        raise UsageError(f"{' and '.join(names)} exclude each other")


def _write_maps(maps: "Sequence[FindingsMap]", html: Path | None, svg: Path | None) -> None:
    from anisoscope.base.atomic_write import write_text
    from anisoscope.report.experiment_page import findings_svg, write_findings_page

    shares = "; ".join(f"tilt {m.setup.convention.tilt_plane} {m.share:.1%}" for m in maps)
    if html is not None:
        write_findings_page(maps, html)
    if svg is not None:
        write_text(svg, findings_svg(maps))
    print_lines(f"{html or svg}: all three findings hold on: {shares} of the grid")
