"""``anisoscope research detection`` and ``research pod``: how often good parts fail and bad ones pass."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.study.optimise import HtmlOption, JobsOption, SchedulerOption
from anisoscope.cli.tables import console, print_table

if TYPE_CHECKING:
    from anisoscope.study.detection.product import RecipeName, World


@everyday(
    "world", "rigs", "recipe", "poses", "diagnose", "jobs", "seed", "folder", "json_", "html", "markdown"
)
def detection_command(
    *,
    world: Annotated[
        tuple[
            Literal[
                "same",
                "reflections",
                "ggx",
                "student",
                "two-scale",
                "camera",
                "lamp",
                "other",
                "mitsuba",
                "all",
            ],
            ...,
        ],
        Parameter(
            help="How parts are rendered, repeatable; light reflects between facets and walls in all. By the "
            "predictor's own model (same); by a path tracer that shares nothing with it, with the predictor's lobe "
            "(reflections), other lobes (ggx, student, two-scale), a non-linear camera or a near lamp (camera, lamp), "
            "or GGX lobes with both (other); mitsuba judges stored frames of parts that Mitsuba 3 rendered. "
            "All leaves out other.",
            negative=(),
        ),
    ] = ("all",),
    rigs: Annotated[
        int,
        Parameter(
            help="Rigs of every world, each with its own golden and judged parts; 2 give a quick look."
        ),
    ] = 24,
    pictured: Annotated[
        int,
        Parameter(
            help="Of these, how many are photographed (in the worlds same, reflections, ggx and two-scale): of the "
            "others only the means of the poses are computed, which local defects need more than."
        ),
    ] = 4,
    recipe: Annotated[
        Literal["standard", "tilted", "suggested", "all"],
        Parameter(
            name="--pose-set",
            help="Poses: 0/90/180° upright, the same at tilts of -10, 0 and 10°, six of quarter turns as suggested by "
            "`recipe suggest`, or all three.",
        ),
    ] = "all",
    diagnose: Annotated[
        bool, Parameter(help="Also diagnose bad parts; takes half a minute more per world.")
    ] = False,
    archive: Annotated[
        Path | None,
        Parameter(
            help="Parts that Mitsuba rendered, for the world mitsuba; tests/data/mitsuba/parts.tar.xz."
        ),
    ] = None,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    seed: Annotated[int, Parameter(help="Seed of parts, rigs and cameras.")] = 1,
    folder: Annotated[
        Path | None, Parameter(help="Folder for surfaces and parts, so that a study can continue.")
    ] = None,
    json_: Json = False,
    html: HtmlOption = None,
    markdown: Annotated[
        Path | None,
        Parameter(
            help="Markdown page with marks for the results; the numbers are written next to it as JSON."
        ),
    ] = None,
) -> int:
    """Inspect thousands of good and bad parts on virtual rigs: false alarms, power, diagnosis, coverage.

    Stored rigs are not simulated again: the same call continues where it stopped.

    Examples:
        anisoscope research detection --world same --rigs 2
    """
    from anisoscope.report.detection_page import tables_of, write_detection_page
    from anisoscope.report.detection_text import write_results
    from anisoscope.study.detection.mitsuba import ARCHIVE
    from anisoscope.study.detection.product import RECIPES
    from anisoscope.study.detection.run import Plan, study_results
    from anisoscope.study.sweep import Workers

    usual = ("same", "reflections", "ggx", "student", "two-scale", "camera", "lamp", "mitsuba")
    named = tuple(dict.fromkeys(name for one in world for name in (usual if one == "all" else (one,))))
    worlds = cast("tuple[World, ...]", tuple(name for name in named if name != "mitsuba"))
    recipes: tuple[RecipeName, ...] = RECIPES if recipe == "all" else (recipe,)
    folder_option: dict[str, Any] = {} if folder is None else {"folder": folder.resolve()}
    plan = Plan(worlds, recipes, rigs, pictured, seed, diagnose, **folder_option)
    rendered = (archive or ARCHIVE) if "mitsuba" in named else None
    with progress("detection", quiet=json_) as advance:
        found = study_results(plan, Workers(jobs, scheduler), advance, rendered)
    if html is not None:
        write_detection_page(html, found)
    if markdown is not None:
        write_results(markdown, found)
    if json_:
        print_json(found)
        return 0
    for table in tables_of(found):
        print_table(table.title, list(table.columns), [list(row) for row in table.rows], table.note or None)
    for note in found["notes"]:
        console().print(note, markup=False, highlight=False, soft_wrap=True)
    return 0


Scaled = Literal["linear", "log"]


@everyday("recipe", "defect", "csv", "parts", "golden_parts", "threshold", "rig", "json_", "html")
def pod_command(
    *,
    recipe: Annotated[
        Path | None, Parameter(name=["--recipe", "-r"], help="Recipe file of simulated parts (TOML).")
    ] = None,
    defect: Annotated[
        str,
        Parameter(
            help="Defect of simulated parts: height_loss, edge_radius [µm], ridge_angle [°], alpha, albedo."
        ),
    ] = "height_loss",
    csv: Annotated[
        Path | None,
        Parameter(
            name="--csv",
            help="CSV file of master parts instead: size,hit (1 or 0) or size,signal.",
        ),
    ] = None,
    parts: Annotated[int, Parameter(help="Simulated parts with a defect.")] = 400,
    largest: Annotated[
        float | None, Parameter(help="Largest simulated size; else found by a short series of trials.")
    ] = None,
    golden_parts: Annotated[
        int, Parameter(help="Golden parts of every rig; with 0 the prediction is the reference.")
    ] = 3,
    rig: Annotated[
        Path | None, Parameter(name=["--rig", "-g"], help="Rig file, for its light angle.")
    ] = None,
    light_angle: Annotated[float, Parameter(help="Without --rig: angle of the light, degrees.")] = 10.0,
    threshold: Annotated[
        float | None, Parameter(help="Of signals: a defect counts as found from this signal on.")
    ] = None,
    noise: Annotated[
        float | None, Parameter(help="Noise: signals at or below this are known to be so only.")
    ] = None,
    saturation: Annotated[
        float | None, Parameter(help="Saturation: signals at or above this are known to be so only.")
    ] = None,
    size_scale: Annotated[Scaled, Parameter(help="The curve is over the size or its logarithm.")] = "log",
    signal_scale: Annotated[Scaled, Parameter(help="Of signals: the signal or its logarithm.")] = "log",
    link: Annotated[
        Literal["logit", "probit"], Parameter(help="Of hits: logistic or normal curve.")
    ] = "logit",
    confidence: Annotated[float, Parameter(help="Confidence of intervals and of a90/95.")] = 0.95,
    seed: Annotated[int, Parameter(help="Seed of parts, rigs and errors.")] = 1,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    json_: Json = False,
    html: HtmlOption = None,
) -> int:
    """Probability of detection over the size of a defect: a50, a90, a90/95 (MIL-HDBK-1823A).

    From simulated parts of a recipe, each on a rig of its own and found by the verdict FAIL, or from master parts.

    Examples:
        anisoscope research pod --recipe recipe.toml --defect height_loss --html pod.html
        anisoscope research pod --csv scratches.csv
    """
    from anisoscope.quality.detection_probability import Trials, hit_miss, read_trials, signal_over_size
    from anisoscope.report.detection_page import detection_curve_tables, write_detection_curve

    if (recipe is None) == (csv is None):
        raise UsageError("name the parts: --recipe FILE for simulated ones, or --csv FILE for master parts")
    if csv is not None:
        sizes, signal, hit = read_trials(csv)
        name, what = csv.stem, str(csv)
        if signal is None:
            assert hit is not None
            found = hit_miss(Trials(sizes, hit), size_scale, link, confidence)
        elif threshold is None:
            raise UsageError(f"{csv}: signals need --threshold, from which on a defect counts as found")
        else:
            found = signal_over_size(
                sizes, signal, threshold, (size_scale, signal_scale), noise=noise, saturation=saturation,
                confidence=confidence,
            )  # fmt: skip
    else:
        from anisoscope.rig.rigfile import read_rig
        from anisoscope.study.lot import lot_of
        from anisoscope.study.part_yield import detection_trials
        from anisoscope.study.sweep import Workers

        assert recipe is not None
        angle = light_angle if rig is None else read_rig(rig).light.angle_deg
        lot = lot_of(recipe, angle, parts=parts, rigs=2, golden=golden_parts)
        with progress(defect, quiet=json_) as advance:
            trials = detection_trials(lot, defect, largest, Workers(jobs, scheduler), seed, advance)
        found = hit_miss(trials, size_scale, link, confidence)
        reference = f"{golden_parts} golden parts" if golden_parts else "the prediction"
        name, what = defect, f"{recipe.name}: simulated parts, each on a rig of its own, against {reference}"
    if html is not None:
        write_detection_curve(html, name, what, found)
    if json_:
        print_json(found)
        return 0
    for table in detection_curve_tables(found):
        print_table(table.title, list(table.columns), [list(row) for row in table.rows], table.note or None)
    for line in (what, f"{name}: {found.verdict}"):
        console().print(line, markup=False, highlight=False, soft_wrap=True)
    return 0
