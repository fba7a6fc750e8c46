"""The detection study: how often good parts fail and bad ones pass, on virtual rigs.

    python tests/evidence/detection.py --world same --rigs 2

It is a command beside those of `anisoscope`, with their ways: interruption, `--verbose`, `--debug`, errors in one line.
"""

import sys
from pathlib import Path
from typing import Annotated, Any, Literal, cast

from cyclopts import Parameter

from anisoscope.cli import app, main
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import OF_WORKERS, Json
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import console
from anisoscope.parameters.workers import Workers
from anisoscope.views.options import Given, with_options
from detection_study.mitsuba import ARCHIVE
from detection_study.product import RECIPES, WORLDS, RecipeName, World
from detection_study.run import Plan, study_results
from detection_study.text import block_of, causes_block, causes_of, numbers_of, write_results


@with_options(workers=OF_WORKERS)
@everyday("world", "rigs", "recipe", "poses", "diagnose", "seed", "folder", "json_", "markdown")
def detection_command(
    *,
    world: Annotated[
        tuple[
            World | Literal["mitsuba", "all"],
            ...,
        ],
        Parameter(
            help="How parts are rendered, repeatable; light reflects between facets and walls in all. By the "
            "predictor's own model (same); by a path tracer that shares nothing with it, with the predictor's lobe "
            "(reflections), other lobes (ggx, two-scale, wide-base), a near lamp (lamp), bent parts (curved), or GGX "
            "lobes with both and a non-linear camera (other); mitsuba judges stored frames of parts that Mitsuba 3 "
            "rendered.",
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
    diagnose: Annotated[bool, Parameter(help="Diagnose bad parts instead of judging them.")] = False,
    archive: Annotated[
        Path | None,
        Parameter(
            help="Parts that Mitsuba rendered, for the world mitsuba; tests/data/mitsuba/parts.tar.xz."
        ),
    ] = None,
    workers: Given[Workers],
    seed: Annotated[int, Parameter(help="Seed of parts, rigs and cameras.")] = 1,
    folder: Annotated[
        Path | None, Parameter(help="Folder for surfaces and parts, so that a study can continue.")
    ] = None,
    json_: Json = False,
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
        python tests/evidence/detection.py --world same --rigs 2
    """
    named = (*WORLDS, "mitsuba") if "all" in world else tuple(dict.fromkeys(world))
    worlds = cast("tuple[World, ...]", tuple(name for name in named if name != "mitsuba"))
    recipes: tuple[RecipeName, ...] = RECIPES if recipe == "all" else (recipe,)
    folder_option: dict[str, Any] = {} if folder is None else {"folder": folder.resolve()}
    plan = Plan(worlds, recipes, rigs, pictured, seed, diagnose, **folder_option)
    rendered = (archive or ARCHIVE) if "mitsuba" in named else None
    with progress("detection", quiet=json_) as advance:
        found = study_results(plan, workers.made(), advance, rendered)
    if markdown is not None:
        write_results(markdown, found)
    if json_:
        print_json(found)
        return 0
    shown = causes_block(causes_of(found)) if diagnose else block_of(numbers_of(found))
    console().print(shown, *found["notes"], sep="\n\n", markup=False, highlight=False, soft_wrap=True)
    return 0


if __name__ == "__main__":
    app.command(detection_command, name="detection")
    sys.argv.insert(1, "detection")
    main()
