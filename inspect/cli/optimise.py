"""``anisoscope optimise``: the ridge design with the most contrast, nominal or under tolerances."""

import json
import math
import sys
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from anisoscope.cli.console import parse_numbers, progress
from anisoscope.cli.optimise_output import best_as_json, charts, notes, print_best, scoring_text, tables
from anisoscope.errors import UsageError

if TYPE_CHECKING:
    from anisoscope.study.objective import Noise, Tolerances

TOLERANCES = "ridge_angle=0.3,alpha=0.1,height_loss=0.03,seating=0.3,stage=0.2"

JobsOption = Annotated[int | None, Parameter(help="Processes on this machine; left out, one for every core.")]
SchedulerOption = Annotated[
    str | None, Parameter(help="Address of a Dask scheduler (tcp://host:8786) that computes instead.")
]
JsonOption = Annotated[bool, Parameter(name="--json", negative="", help="Print JSON.")]
HtmlOption = Annotated[Path | None, Parameter(help="Write a self-contained HTML page to this file.")]
PlotOption = Annotated[Path | None, Parameter(help="Write the charts as a picture, *.png or *.svg.")]


def optimise(
    *,
    vary: Annotated[
        str, Parameter(help="NAME=FROM:TO,…; names: ridge_angle, pitch, alpha_along, alpha_across.")
    ] = "ridge_angle=3:20",
    ridge_angle: Annotated[float, Parameter(help="Ridge angle in degrees, where it is not varied.")] = 10.0,
    pitch: Annotated[float, Parameter(help="Pitch in µm, where it is not varied.")] = 100.0,
    alpha_along: Annotated[float, Parameter(help="Roughness along the ridges, where not varied.")] = 0.06,
    alpha_across: Annotated[float, Parameter(help="Roughness across the ridges, where not varied.")] = 0.10,
    edge_radius: Annotated[float, Parameter(help="Radius of the crests in µm; 0 is sharp.")] = 0.0,
    height_loss: Annotated[float, Parameter(help="Share of the ridge height missing at the crests.")] = 0.0,
    albedo: Annotated[float, Parameter(help="Diffuse albedo of the plastic, 0 to 1.")] = 0.2,
    index: Annotated[float, Parameter(help="Refractive index of the plastic.")] = 1.5,
    wall: Annotated[
        Literal["perpendicular", "vertical"], Parameter(help="Wall of the ridge.")
    ] = "perpendicular",
    contrast: Annotated[
        Literal["difference", "michelson", "log_ratio"],
        Parameter(help="Contrast; its absolute value counts."),
    ] = "difference",
    pair: Annotated[
        list[str] | None,
        Parameter(help="Two stage angles, 0,90 where left out; may be given more than once."),
    ] = None,
    tilts: Annotated[str, Parameter(help="Tilts in degrees, comma-separated (--tilts=-10,0,10).")] = "0",
    over: Annotated[
        Literal["mean", "worst"], Parameter(help="Mean over pairs and tilts, or the worst of them.")
    ] = "mean",
    score: Annotated[
        Literal["contrast", "snr"], Parameter(help="The contrast, or its ratio to its standard deviation.")
    ] = "contrast",
    noise: Annotated[
        str | None,
        Parameter(help="Noise of a measured radiance: floor=1/sr,share=of it (floor=1e-4,share=.005)."),
    ] = None,
    robust: Annotated[bool, Parameter(negative="", help="Maximise under tolerances.")] = False,
    tolerance: Annotated[
        str | None,
        Parameter(
            help="Standard deviations NAME=SD,…: ridge_angle [°], alpha [share], height_loss [share], edge_radius "
            f"[µm], seating [°], stage [°], light [°]. With --robust alone: {TOLERANCES}."
        ),
    ] = None,
    z: Annotated[float, Parameter(help="The robust score is mean − z · standard deviation.")] = 2.0,
    quantile: Annotated[
        float | None, Parameter(help="The robust score is this quantile of the contrast instead, up to 0.5.")
    ] = None,
    samples: Annotated[int, Parameter(help="Parts in the sample of tolerances, a power of two.")] = 64,
    seed: Annotated[int, Parameter(help="Seed of that sample.")] = 1,
    light_angle: Annotated[float, Parameter(help="Angle between light and camera in degrees.")] = 10.0,
    tilt_plane: Annotated[
        Literal["perpendicular", "in-plane"], Parameter(help="Plane in which camera and light tilt.")
    ] = "perpendicular",
    facet_azimuth: Annotated[float, Parameter(help="Azimuth toward which the facets lean at 0°.")] = 0.0,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    json_: JsonOption = False,
    html: HtmlOption = None,
    plot: PlotOption = None,
) -> int:
    """Find the ridge design with the most contrast, by the corrected model in direct light.

    The whole box of --vary is searched on a grid, and the highest hills are climbed. The pitch takes part only
    where something has an absolute size (--edge-radius, or a tolerance of it).
    """
    from anisoscope.report.study_page import check_picture, write_picture, write_study_page
    from anisoscope.sim.light.geometry import Convention, directions
    from anisoscope.study.box import check_bounds
    from anisoscope.study.objective import Part, Scoring
    from anisoscope.study.optimum import optimum
    from anisoscope.study.sweep import Workers

    check_picture(plot)
    if not robust and (tolerance is not None or quantile is not None):
        raise UsageError("--tolerance and --quantile belong to --robust")
    part = Part(ridge_angle, pitch, alpha_along, alpha_across, edge_radius, height_loss, albedo, index, wall)
    scoring = Scoring(
        contrast,
        tuple(_pair(text) for text in pair or ["0,90"]),
        parse_numbers(tilts, "--tilts"),
        over,
        Convention(light_angle, tilt_plane, facet_azimuth),
        score,
        _noise(noise),
        _tolerances(tolerance or TOLERANCES) if robust else None,
        z,
        quantile,
        samples,
        seed,
    )
    directions(scoring.poses, scoring.convention)
    bounds = _bounds(vary)
    check_bounds(bounds, part, scoring)
    workers = Workers(jobs, scheduler)
    with progress("optimise", quiet=json_) as advance:
        best = optimum(part, bounds, scoring, workers, advance)
        plain = None
        if robust and ("pitch" not in bounds or part.edge_radius > 0.0):
            plain = optimum(part, bounds, scoring.nominal, workers, advance)
    if json_:
        json.dump(best_as_json(best, plain, scoring), sys.stdout, indent=2, allow_nan=False)
        sys.stdout.write("\n")
    else:
        print_best(best, plain, scoring)
    drawn = charts(best, scoring)
    if html is not None:
        write_study_page(
            html,
            "Best ridge design",
            scoring_text(scoring),
            drawn,
            tables(best, plain, scoring),
            notes(best),
        )
    if plot is not None:
        write_picture(plot, drawn)
    return 0


def _pairs_of(text: str, option: str, form: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for piece in text.split(","):
        name, equals, value = piece.partition("=")
        name = name.strip().replace("-", "_")
        if not equals or not name or name in found:
            raise UsageError(f"{option} takes {form}, every name once, not {text!r}")
        found[name] = value.strip()
    return found


def _number(text: str, option: str) -> float:
    return parse_numbers(text, option)[0] if "," not in text else math.nan


def _bounds(text: str) -> dict[str, tuple[float, float]]:
    found = {}
    for name, ends in _pairs_of(text, "--vary", "NAME=FROM:TO,…").items():
        low, colon, high = ends.partition(":")
        if not colon:
            raise UsageError(f"--vary takes NAME=FROM:TO, such as ridge_angle=3:20, not {name}={ends}")
        found[name] = (_number(low, "--vary"), _number(high, "--vary"))
    return found


def _pair(text: str) -> tuple[float, float]:
    numbers = parse_numbers(text, "--pair")
    if len(numbers) != 2 or numbers[0] == numbers[1]:
        raise UsageError(f"--pair takes two different stage angles, such as 0,90, not {text!r}")
    return numbers[0], numbers[1]


def _known(values: dict[str, str], known: list[str], option: str) -> dict[str, float]:
    unknown = [name for name in values if name not in known]
    if unknown:
        raise UsageError(f"{option} does not know {unknown[0]!r}; it knows {', '.join(known)}")
    return {name: _number(value, option) for name, value in values.items()}


def _noise(text: str | None) -> "Noise":
    from anisoscope.study.objective import Noise

    if text is None:
        return Noise()
    return Noise(
        **_known(_pairs_of(text, "--noise", "floor=VALUE,share=VALUE"), ["floor", "share"], "--noise")
    )


def _tolerances(text: str) -> "Tolerances":
    from anisoscope.study.objective import Tolerances

    known = [one.name for one in fields(Tolerances)]
    return Tolerances(**_known(_pairs_of(text, "--tolerance", "NAME=SD,…"), known, "--tolerance"))
