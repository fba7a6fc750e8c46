"""``anisoscope optimise``: the ridge design with the most contrast, nominal or under tolerances."""

import math
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.options import (
    OF_LIGHT,
    OF_PLASTIC,
    OF_RIDGES,
    Json,
    MaterialOption,
    RecipeOption,
)
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import hand_out
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.views.options import Given, parse_numbers, with_options

if TYPE_CHECKING:
    from anisoscope.study.objective import Noise, Tolerances

TOLERANCES = "ridge_angle=0.3,alpha=0.1,height_loss=0.03,seating=0.3,stage=0.2"

JobsOption = Annotated[int | None, Parameter(help="Processes on this machine; left out, one for every core.")]
SchedulerOption = Annotated[
    str | None, Parameter(help="Address of a Dask scheduler (tcp://host:8786) that computes instead.")
]
HtmlOption = Annotated[Path | None, Parameter(help="Write a self-contained HTML page to this file.")]
PlotOption = Annotated[Path | None, Parameter(help="Write the charts as a picture, *.png or *.svg.")]


@with_options(ridges=OF_RIDGES, plastic=OF_PLASTIC, rig=OF_LIGHT)
@everyday(
    *("vary", "contrast", "pair", "tilts", "robust", "scatter", "recipe", "ridges", "plastic", "file", "rig"),
    *("json_", "html", "plot"),
)
def optimise(
    *,
    recipe: RecipeOption = None,
    vary: str = "ridge_angle=3:20",
    ridges: Given[RidgeDesign],
    plastic: Given[Material],
    file: MaterialOption = None,
    contrast: Literal["difference", "michelson", "log_ratio"] = "difference",
    pair: list[str] | None = None,
    tilts: Annotated[str, Parameter(help="Tilts in degrees, comma-separated (--tilts=-10,0,10).")] = "0",
    over: Literal["mean", "worst"] = "mean",
    score: Literal["contrast", "snr"] = "contrast",
    noise: str | None = None,
    robust: Annotated[bool, Parameter(negative="", help="Maximise under tolerances.")] = False,
    scatter: Annotated[
        str | None,
        Parameter(
            help="Standard deviations NAME=SD,…: ridge_angle [°], alpha [share], height_loss [share], edge_radius "
            f"[µm], seating [°], stage [°], light [°]. With --robust alone: {TOLERANCES}."
        ),
    ] = None,
    z: Annotated[float, Parameter(help="The robust score is mean − z · standard deviation.")] = 2.0,
    quantile: float | None = None,
    samples: Annotated[int, Parameter(help="Parts in the sample of tolerances, a power of two.")] = 64,
    seed: Annotated[int, Parameter(help="Seed of the sample.")] = 1,
    bounces: int | Literal["all"] = "all",
    rig: Given[Convention],
    jobs: int = 1,
    scheduler: SchedulerOption = None,
    json_: Json = False,
    html: HtmlOption = None,
    plot: PlotOption = None,
) -> int:
    """Find the ridge design with the most contrast, nominal or under tolerances.

    The box of --vary is searched on a grid, then refined at the highest maxima. --bounces adds light that ridges
    reflect onto each other. The pitch matters only if something has an absolute size (--edge-radius, or a tolerance of
    it).

    Args:
        vary: NAME=FROM:TO,…; names: ridge_angle, pitch, alpha_along, alpha_across.
        contrast: Contrast; its absolute value counts.
        pair: Two stage angles, 0,90 where left out; may be given more than once.
        over: Mean over pairs and tilts, or the worst of them.
        score: The contrast, or its ratio to its standard deviation.
        noise: Noise of a measured radiance: floor=1/sr,share=of it (floor=1e-4,share=.005).
        quantile: The robust score is this quantile of the contrast instead, up to 0.5.
        bounces: Most reflections; 1: direct light; 2 holds most of what 'all' adds, in half of its time.
        jobs: Processes on this machine; several help with many poses or samples.

    Examples:
        anisoscope optimise --vary ridge_angle=3:20
        anisoscope optimise --vary ridge_angle=3:20 --robust --scatter ridge_angle=0.3,stage=0.2
        anisoscope optimise --vary ridge_angle=3:20,alpha_across=.05:.2 --plot landscape.png
    """
    from anisoscope.operations.optimising import optimise as search
    from anisoscope.operations.stated import stated
    from anisoscope.report.study_page import check_picture
    from anisoscope.study.objective import Scoring
    from anisoscope.study.sweep import Workers

    check_picture(plot)
    if not robust and (scatter is not None or quantile is not None):
        raise UsageError("--scatter and --quantile belong to --robust")
    base = stated(recipe, file)
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
    hand_out(found, found.page(), json_=json_, html=html, plot=plot)
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
