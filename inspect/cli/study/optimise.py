"""``anisoscope optimise``: the ridge design with the most contrast, nominal or under tolerances."""

import math
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import OF_LIGHT, OF_PLASTIC, OF_RIDGES, Json, RecipeOption, parse_numbers
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_lines, print_table
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.views.options import Given, with_options

if TYPE_CHECKING:
    from anisoscope.report.study_page import Chart, Map, Table
    from anisoscope.study.objective import Noise, Scoring, Tolerances
    from anisoscope.study.optimum import Optimum


LABELS = {
    "ridge_angle": "ridge angle [°]",
    "pitch": "pitch [µm]",
    "alpha_along": "alpha along [1]",
    "alpha_across": "alpha across [1]",
}


CONTRAST_UNITS = {"difference": "1/sr", "michelson": "1", "log_ratio": "1"}


def scoring_text(scoring: "Scoring") -> str:
    """Objective in words."""
    pairs = ", ".join(f"{a:g}° / {b:g}°" for a, b in scoring.pairs_deg)
    tilts = ", ".join(f"{t:g}°" for t in scoring.tilts_deg)
    text = f"{scoring.over} |{scoring.contrast}| [{CONTRAST_UNITS[scoring.contrast]}], pairs {pairs}, tilts {tilts}"
    text += ", direct light" if scoring.bounces == 1 else f", {scoring.bounces} reflections"
    if scoring.score == "snr":
        text += ", over its standard deviation"
    if scoring.tolerances is not None:
        sizes = ", ".join(f"{name} {value:g}" for name, value in asdict(scoring.tolerances).items() if value)
        rule = "" if scoring.score == "snr" else f", mean − {scoring.z:g} sd"
        if scoring.quantile is not None:
            rule = f", quantile {scoring.quantile:g}"
        text += f"{rule}; sd: {sizes or 'none'}; {scoring.samples} parts"
    return text


def _optimum_as_json(found: "Optimum") -> dict[str, Any]:
    return {
        "part": found.part,
        "score": found.scored.score,
        "mean": found.scored.mean,
        "sd": found.scored.sd,
        "nominal_contrast": found.nominal.mean,
        "parameters": found.slices,
        "hills": found.hills,
        "evaluations": found.evaluations,
    }


def best_as_json(best: "Optimum", plain: "Optimum | None", scoring: "Scoring") -> dict[str, Any]:
    """The optimum as a table for JSON."""
    shape = best.landscape
    return {
        "scoring": scoring,
        "unit": CONTRAST_UNITS[scoring.contrast],
        "optimum": _optimum_as_json(best),
        "nominal_optimum": None if plain is None else _optimum_as_json(plain),
        "landscape": {
            "names": shape.names,
            "axes": shape.axes,
            "scores": shape.scores.ravel(),
        },
    }


def tables(best: "Optimum", plain: "Optimum | None", scoring: "Scoring") -> "list[Table]":
    """The tables of terminal and page."""
    from anisoscope.report.study_page import Table
    from anisoscope.study.objective import score

    unit = CONTRAST_UNITS[scoring.contrast]
    rows = []
    for one in best.slices:
        remark = (
            "flat: it hardly matters" if one.flat else f"at the {one.at_bound} bound" if one.at_bound else ""
        )
        spread = "–" if one.sampling_sd is None else f"{one.sampling_sd:.2g}"
        value = getattr(best.part, one.name)
        rows.append(
            (LABELS[one.name], f"{value:.4g}", f"{one.kept[0]:.4g} … {one.kept[1]:.4g}", spread, remark)
        )
    columns = ("parameter", "optimum", "keeps 99 % of the score", "sd between samples", "remark")
    tables = [Table("Optimum", columns, tuple(rows))]
    parts = [("optimum", best.part, best.scored, best.nominal)]
    if plain is not None:
        under = score(plain.part, scoring)
        parts = [("robust", *parts[0][1:]), ("nominal", plain.part, under, plain.nominal)]
    names = [one.name for one in best.slices]
    tables.append(
        Table(
            "What it gives",
            (
                "design",
                *(LABELS[n] for n in names),
                f"contrast, nominal [{unit}]",
                f"mean [{unit}]",
                f"sd [{unit}]",
                "score",
            ),
            tuple(
                (
                    label,
                    *(f"{getattr(part, n):.4g}" for n in names),
                    f"{ideal.mean:.5g}",
                    f"{scored.mean:.5g}",
                    f"{scored.sd:.3g}",
                    f"{scored.score:.5g}",
                )
                for label, part, scored, ideal in parts
            ),
        )
    )
    around = [
        (LABELS[one.name], f"{value:.4g}", f"{at:.5g}" if math.isfinite(at) else "–")
        for one in best.slices
        for value, at in zip(one.values[::6], one.scores[::6], strict=True)
    ]
    tables.append(Table("Around the optimum", ("parameter, others held", "value", "score"), tuple(around)))
    return tables


def notes(best: "Optimum", scoring: "Scoring") -> list[str]:
    """Notes on an optimum."""
    light = {1: "direct light; reflections between facet and wall are left out", "all": "all reflections"}
    found = [f"Model: corrected, {light.get(scoring.bounces, f'up to {scoring.bounces} reflections')}."]
    if best.scored.score <= 0.0:
        found.append(
            "The score is not positive: the tolerances exceed the contrast everywhere within these bounds."
        )
    if len(best.hills) > 1:
        heights = ", ".join(f"{value:.4g}" for value in best.hills)
        found.append(f"Hills climbed: {len(best.hills)}; scores at their tops: {heights}.")
    if any(one.name == "pitch" for one in best.slices):
        found.append(
            "The pitch enters through the edge radius alone: light knows angles only. Wall width, roughness and "
            "camera pixels beside the pitch, and what the eye resolves, are not part of the score."
        )
    return found


def print_best(best: "Optimum", plain: "Optimum | None", scoring: "Scoring") -> None:
    """Print the optimum."""
    for table in tables(best, plain, scoring):
        print_table(table.title, list(table.columns), [list(row) for row in table.rows])
    print_lines(*(scoring_text(scoring), *notes(best, scoring)))


def charts(best: "Optimum", scoring: "Scoring") -> "list[Chart | Map]":
    """The pictures of the page."""
    import numpy as np

    from anisoscope.report.study_page import Chart, Curve, Map

    shape = best.landscape
    unit = "1" if scoring.score == "snr" else CONTRAST_UNITS[scoring.contrast]
    charts: list[Chart | Map] = []
    if len(shape.names) > 1:
        rest = tuple(range(2, len(shape.names)))
        filled = np.where(np.isfinite(shape.scores), shape.scores, np.nanmin(shape.scores))
        x, y = shape.names[:2]
        charts.append(
            Map(
                "Score" + (", best over the other parameters" if rest else ""),
                LABELS[x],
                LABELS[y],
                f"score [{unit}]",
                shape.axes[0],
                shape.axes[1],
                filled.max(axis=rest).T if rest else filled.T,
                (getattr(best.part, x), getattr(best.part, y)),
                x != "ridge_angle",
                y != "ridge_angle",
            )
        )
    for number, one in enumerate(best.slices):
        values, scores = np.array(one.values), np.array(one.scores)
        if len(shape.names) == 1:
            values, scores = shape.axes[0], shape.scores
        finite = np.isfinite(scores)
        curve = Curve(f"{number}", values[finite], scores[finite])
        title = f"Score by {one.name.replace('_', ' ')}" + (
            "" if len(shape.names) == 1 else ", others at the optimum"
        )
        mark = getattr(best.part, one.name)
        charts.append(Chart(title, LABELS[one.name], f"score [{unit}]", (curve,), mark_x=mark, points=False))
    return charts


TOLERANCES = "ridge_angle=0.3,alpha=0.1,height_loss=0.03,seating=0.3,stage=0.2"

JobsOption = Annotated[int | None, Parameter(help="Processes on this machine; left out, one for every core.")]
SchedulerOption = Annotated[
    str | None, Parameter(help="Address of a Dask scheduler (tcp://host:8786) that computes instead.")
]
HtmlOption = Annotated[Path | None, Parameter(help="Write a self-contained HTML page to this file.")]
PlotOption = Annotated[Path | None, Parameter(help="Write the charts as a picture, *.png or *.svg.")]


@with_options(ridges=OF_RIDGES, plastic=OF_PLASTIC, rig=OF_LIGHT)
@everyday(
    *("vary", "contrast", "pair", "tilts", "robust", "scatter", "recipe", "ridges", "plastic", "rig"),
    *("json_", "html", "plot"),
)
def optimise(
    *,
    recipe: RecipeOption = None,
    vary: Annotated[
        str, Parameter(help="NAME=FROM:TO,…; names: ridge_angle, pitch, alpha_along, alpha_across.")
    ] = "ridge_angle=3:20",
    ridges: Given[RidgeDesign],
    plastic: Given[Material],
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
    scatter: Annotated[
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
    seed: Annotated[int, Parameter(help="Seed of the sample.")] = 1,
    bounces: Annotated[
        int | Literal["all"],
        Parameter(
            help="Most reflections; 1: direct light; 2 holds most of what 'all' adds, in half of its time."
        ),
    ] = "all",
    rig: Given[Convention],
    jobs: Annotated[
        int, Parameter(help="Processes on this machine; several help with many poses or samples.")
    ] = 1,
    scheduler: SchedulerOption = None,
    json_: Json = False,
    html: HtmlOption = None,
    plot: PlotOption = None,
) -> int:
    """Find the ridge design with the most contrast, nominal or under tolerances.

    The box of --vary is searched on a grid, then refined at the highest maxima. --bounces adds light that ridges
    reflect onto each other. The pitch matters only if something has an absolute size (--edge-radius, or a tolerance of
    it).

    Examples:
        anisoscope optimise --vary ridge_angle=3:20
        anisoscope optimise --vary ridge_angle=3:20 --robust --scatter ridge_angle=0.3,stage=0.2
        anisoscope optimise --vary ridge_angle=3:20,alpha_across=.05:.2 --plot landscape.png
    """
    from anisoscope.operations.optimising import optimise as search
    from anisoscope.operations.stated import stated
    from anisoscope.report.study_page import check_picture, write_picture, write_study_page
    from anisoscope.study.objective import Scoring
    from anisoscope.study.sweep import Workers

    check_picture(plot)
    if not robust and (scatter is not None or quantile is not None):
        raise UsageError("--scatter and --quantile belong to --robust")
    base = stated(recipe)
    design = ridges.over(base.design or RidgeDesign(base.pitch_um or 100.0, 10.0))
    scoring = Scoring(
        contrast,
        tuple(_pair(text) for text in pair or ["0,90"]),
        parse_numbers(tilts, "--tilts"),
        over,
        rig.over(base.convention),
        score,
        _noise(noise),
        _tolerances(scatter or TOLERANCES) if robust else None,
        z,
        quantile,
        samples,
        seed,
        bounces,
    )
    with progress("optimise", quiet=json_) as advance:
        found = search(
            _bounds(vary),
            design=design,
            material=plastic.over(base.material),
            scoring=scoring,
            workers=Workers(jobs, scheduler),
            on_progress=advance,
        )
    best, plain = found.optimum, found.nominal
    if json_:
        print_json(best_as_json(best, plain, scoring))
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
            notes(best, scoring),
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


def named_numbers(text: str, option: str, form: str, kind: type) -> dict[str, float]:
    """Numbers by name from ``NAME=VALUE,…``; names are fields of a dataclass, every one once.

    Raises:
        UsageError: another form, an unknown name, or no number.
    """
    values, known = _pairs_of(text, option, form), [one.name for one in fields(kind)]
    unknown = [name for name in values if name not in known]
    if unknown:
        raise UsageError(f"{option} does not know {unknown[0]!r}; it knows {', '.join(known)}")
    return {name: _number(value, option) for name, value in values.items()}


def _noise(text: str | None) -> "Noise":
    from anisoscope.study.objective import Noise

    return (
        Noise() if text is None else Noise(**named_numbers(text, "--noise", "floor=VALUE,share=VALUE", Noise))
    )


def _tolerances(text: str) -> "Tolerances":
    from anisoscope.study.objective import Tolerances

    return Tolerances(**named_numbers(text, "--scatter", "NAME=SD,…", Tolerances))
