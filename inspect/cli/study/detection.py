"""``anisoscope study detection``: how often good parts fail and bad ones pass, on the virtual rig."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

from cyclopts import Parameter

from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.study.optimise import HtmlOption, JobsOption, SchedulerOption
from anisoscope.cli.tables import console, print_table

if TYPE_CHECKING:
    from anisoscope.study.detection.product import RecipeName, World


def detection_command(
    *,
    world: Annotated[
        tuple[
            Literal["same", "ggx", "student", "two-scale", "reflections", "camera", "lamp", "other", "both"],
            ...,
        ],
        Parameter(
            help="How parts are rendered, repeatable: as the predictor does (same); by a path tracer that shares "
            "nothing with it, with other lobes and reflections (ggx, student, two-scale), with the predictor's lobe "
            "and reflections, a non-linear camera or a near lamp (reflections, camera, lamp), or with GGX lobes and "
            "all of these (other); both is same and other.",
            negative=(),
        ),
    ] = ("both",),
    parts: Annotated[int, Parameter(help="Good parts; 100 gives a quick look.")] = 2000,
    defective: Annotated[
        int | None, Parameter(help="Parts of every class of defects; 300, or 3 in 20 of fewer good parts.")
    ] = None,
    recipe: Annotated[
        Literal["standard", "tilted", "both"],
        Parameter(help="Poses: 0/90/180° upright, the same at tilts of -10, 0 and 10°, or both."),
    ] = "both",
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    seed: Annotated[int, Parameter(help="Seed of parts, rigs and cameras.")] = 1,
    folder: Annotated[
        Path | None, Parameter(help="Where surfaces and parts are kept, so that a study can go on.")
    ] = None,
    json_: Json = False,
    html: HtmlOption = None,
    markdown: Annotated[
        Path | None,
        Parameter(help="Markdown page with marks for the results; the numbers go beside it as JSON."),
    ] = None,
) -> int:
    """Inspect thousands of good and bad parts on the virtual rig: false alarms, detection, diagnosis, coverage.

    Parts that are kept already are not made again: the same call goes on where it was stopped.
    """
    from anisoscope.report.detection_page import tables_of, write_detection_page
    from anisoscope.report.detection_text import write_results
    from anisoscope.study.detection.run import Plan, study_results
    from anisoscope.study.sweep import Workers

    named = [name for one in world for name in (("same", "other") if one == "both" else (one,))]
    worlds = cast("tuple[World, ...]", tuple(dict.fromkeys(named)))
    recipes: tuple[RecipeName, ...] = ("standard", "tilted") if recipe == "both" else (recipe,)
    count = defective if defective is not None else min(300, max(1, 3 * parts // 20))
    folder_option: dict[str, Any] = {} if folder is None else {"folder": folder.resolve()}
    plan = Plan(worlds, recipes, parts, count, seed, **folder_option)
    with progress("detection", quiet=json_) as advance:
        found = study_results(plan, Workers(jobs, scheduler), advance)
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
