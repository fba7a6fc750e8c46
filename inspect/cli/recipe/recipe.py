"""``anisoscope recipe``: new recipes, check of their capability, teaching from a good part, yield of a lot."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import MORE
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import (
    OF_WORKERS,
    USUAL_LAMP,
    Json,
    Lamp,
    LightAngleOption,
    named_numbers,
    parse_range,
)
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_lines, print_output, print_table
from anisoscope.parameters.detection import LotSize, PoseChoice
from anisoscope.parameters.inspecting import PartFrames, Teaching
from anisoscope.parameters.new_recipe import NewRecipe
from anisoscope.parameters.workers import Workers
from anisoscope.views.options import Given, Options, parse_numbers, with_options

if TYPE_CHECKING:
    from anisoscope.study.lot import Lot
    from anisoscope.study.part_yield import PartYield
    from anisoscope.study.statistics import Rate

app = App(name="recipe", help="Write, check and teach recipes: how a part is photographed and judged.")

PRODUCT = "ridged part"
SCATTER_NAMES = "ridge_angle [°], alpha [share], albedo [share], height_loss [share], edge_radius [µm]"
File = Annotated[Path, Parameter(help="Recipe file (TOML).")]
OF_FRAMES = Options(
    PartFrames,
    help={
        "frames": "Frames of a part in this folder (frames.csv) instead of devices; by default with rig.toml in it."
    },
    whole=True,
)


@app.command
@with_options(
    part=Options(
        NewRecipe, default={"product": PRODUCT}, without={"largest_mm": "that of the fixture"}, whole=True
    )
)
def new(
    *,
    out: Annotated[Path, Parameter(help="Recipe file to write; must not exist.")],
    part: Given[NewRecipe],
    rig: Annotated[Path | None, Parameter(name=["--rig", "-g"])] = None,
) -> int:
    """Write a recipe with comments, valid as written; then adapt it.

    With --ridge-angle and --height-map the height map decides, and the design is compared as well; with
    --u-ridge-angle the design decides. With --ink it is the recipe of a print. With --rig the region stays within the
    markers of its fixture.

    Args:
        rig: Rig file, for its geometry; its devices may be missing.

    Examples:
        anisoscope recipe new --ridge-angle 10 --pitch 100 --product "plate 7" --out plate.toml
        anisoscope recipe new --height-map good-part.x3p --out part.toml
        anisoscope recipe new --ink synthetic-red --out print.toml
    """
    from anisoscope.kinds.parts import beginning
    from anisoscope.kinds.registry import kind_of_new
    from anisoscope.rig.rigfile import read_replay_rig

    if out.exists():
        raise UsageError(f"{out} exists already: name another file, or change it with an editor")
    fixture = None if rig is None else read_replay_rig(rig).fixture
    if fixture is not None and not fixture.free_mm:
        raise UsageError(
            f"{rig}: fixture.markers leave no room about the rotation axis: print them farther out"
        )
    asked = part.made()
    requested = replace(
        asked,
        product=None if asked.product == PRODUCT else asked.product,
        largest_mm=None if fixture is None else fixture.free_mm,
    )
    tables = beginning(kind_of_new(requested)).new_recipe(out, requested)
    print_lines(f"{out}: written; adapt {tables}, then: anisoscope recipe check {out}")
    return 0


@app.command
@with_options(foreign=OF_FRAMES)
def check(
    file: File,
    /,
    *,
    rig: Annotated[
        Path | None,
        Parameter(name=["--rig", "-g"], help="Rig file, for its geometry; its devices may be missing."),
    ] = None,
    foreign: Given[PartFrames],
    light_angle: LightAngleOption = None,
    try_tilts: Annotated[str, Parameter(help="Tilts to try as additions, degrees; none: ''.")] = "10,20",
    json_: Json = False,
) -> int:
    """Predict the poses of a recipe, their uncertainties, and which causes it can distinguish; nothing moves.

    With --frames it also checks whether a part can be measured by these frames, and names what is not checked.

    Examples:
        anisoscope recipe check recipe.toml
        anisoscope recipe check recipe.toml --rig rig.toml --try-tilts 10,20
    """
    from anisoscope.operations.teaching import check_recipe

    tries = parse_numbers(try_tilts, "--try-tilts") if try_tilts.strip() else ()
    with progress(file.name, quiet=json_) as advance:
        found = check_recipe(
            file,
            rig,
            foreign=foreign.made(),
            light_angle_deg=light_angle,
            try_tilts_deg=tries,
            on_progress=advance,
        )
    print_output(found.output(), json_=json_)
    return 0


@app.command
@with_options(
    choice=Options(
        PoseChoice,
        names={"defects": "--defect"},
        default={"angles_deg": "0:345:15", "tilts_deg": "-20:20:5"},
        readers={"angles_deg": parse_range, "tilts_deg": parse_range},
        repeated=("defects", "ignore"),
        flags=("angle_map",),
        whole=True,
    )
)
def suggest(
    file: File,
    /,
    *,
    choice: Given[PoseChoice],
    lamp: Lamp = USUAL_LAMP,
    json_: Json = False,
) -> int:
    """Choose poses that show defects best among good parts that differ ([scatter]).

    The defects are those of the recipe ([defects]), or of --defect. Printed: poses, exposures, frames and golden parts
    with which each is found, or that optics cannot.

    Examples:
        anisoscope recipe suggest recipe.toml --poses 6 --tilts=-20:20:5
        anisoscope recipe suggest recipe.toml --defect ridge-angle=0.5 --defect roughness=20%
    """
    from anisoscope.operations.teaching import suggest_poses

    asked = choice.made()
    with lamp.angle() as angle, progress(file.name, quiet=json_) as advance:
        suggested = suggest_poses(
            file, choice=asked, rig=lamp.rig, light_angle_deg=angle, on_progress=advance
        )
    if json_:
        return print_json(suggested)
    found, reached = suggested.suggestion, suggested.reached
    counts = sorted(found.shown[0].power)
    columns = [
        "defect",
        "d' [σ]",
        "AUC",
        *(f"found, {n} golden" for n in counts),
        f"found in 90 %, {counts[-1]} golden",
    ]
    rows = [
        [
            one.defect,
            f"{one.distance:.1f}",
            f"{one.area:.3f}",
            *(f"{one.power[n]:.0%}" for n in counts),
            f"{one.detectable[counts[-1]]:.2f} × the size",
        ]
        for one in found.shown
    ]
    print_table(f"{file.name}: {asked.poses} poses", columns, rows)
    enough = (
        f"every defect{' of --defect' if asked.defects else ''} is found in {asked.power:.0%} of parts with "
        + ", or ".join(f"{n} golden parts and {frames} frames per pose" for n, frames in reached)
        if reached
        else f"no exposure and no golden parts reach {asked.power:.0%}: good parts differ as the defects do. Allow "
        "more poses, seat the parts better ([scatter] seating_tilt_deg), or accept a larger size ([defects])"
    )
    print_lines(enough, "in the recipe:", *suggested.in_recipe)
    return 0


@app.command
@with_options(
    by=Options(
        Teaching,
        names={"serial": ("--serial", "-s")},
        flags=("golden",),
        whole=True,
    ),
    foreign=OF_FRAMES,
)
def teach(
    file: File,
    /,
    *,
    rig: Annotated[Path | None, Parameter(name=["--rig", "-g"])] = None,
    by: Given[Teaching],
    foreign: Given[PartFrames],
    out: Annotated[Path, Parameter(help="Folder that receives the inspection folder.")] = Path("inspections"),
    json_: Json = False,
) -> int:
    """Photograph a good part, and set exposure, region and tolerances of a recipe by it.

    --frames uses existing frames and their exposure. --golden sets only the tolerances of a print by its golden
    prints, or the scatter of ridged parts by theirs; --limits only the tolerances of contrasts. The recipe becomes a
    new version; the old one is saved as NAME.v1.toml and so on.

    Args:
        rig: Rig file (TOML); with --golden or --frames without devices, too.

    Examples:
        anisoscope recipe teach recipe.toml --rig rig.toml --serial GOOD-1
        anisoscope recipe teach upright.toml --rig rig.toml --golden --golden-of tilted.toml
        anisoscope recipe teach recipe.toml --rig rig.toml --limits part.dfq
    """
    from anisoscope.operations.teaching import teach as taught_by

    asked = by.made()
    with progress(asked.serial or file.name, quiet=json_) as advance:
        found = taught_by(file, rig, by=asked, foreign=foreign.made(), out=out, on_progress=advance)
    if json_:
        return print_json(found)
    print_table(
        f"{file}: version {found.version}",
        ["value", "was", "is", "because"],
        [[change.key, str(change.old), str(change.new), change.why] for change in found.changes],
    )
    lines = [f"the version before: {found.kept}"]
    lines += [] if found.folder is None else [f"the inspection: {found.folder}"]
    print_lines(*(*lines, *found.notes))
    return 0


@app.command(name="yield")
@with_options(
    size=Options(LotSize, groups=dict.fromkeys(("rigs", "u_pose", "seed"), MORE), whole=True),
    workers=OF_WORKERS,
)
def yield_command(
    file: File,
    /,
    *,
    size: Given[LotSize],
    scatter: Annotated[
        str | None,
        Parameter(
            help=f"Standard deviations between the parts, NAME=SD,…: {SCATTER_NAMES}, seating [°]; left out, those of "
            "good parts in the recipe's table scatter."
        ),
    ] = None,
    shift: Annotated[
        str | None,
        Parameter(help=f"How far the lot's mean is off the nominal part, NAME=VALUE,…: {SCATTER_NAMES}."),
    ] = None,
    lamp: Lamp = USUAL_LAMP,
    workers: Given[Workers],
    json_: Json = False,
) -> int:
    """Predict how many parts of a lot pass a recipe, and the risks of producer and consumer; nothing moves.

    Every part is predicted in a state of its own, measured without pictures, and judged by the recipe's rule.

    Examples:
        anisoscope recipe yield recipe.toml --scatter ridge_angle=0.3,alpha=0.1
        anisoscope recipe yield recipe.toml --golden-parts 3 --shift ridge_angle=0.5
    """
    from anisoscope.operations.detecting import recipe_yield
    from anisoscope.study.lot import Shift, Spread

    spread = None if scatter is None else named_numbers(scatter, "--scatter", "NAME=SD,…", Spread)
    off = None if shift is None else named_numbers(shift, "--shift", "NAME=VALUE,…", Shift)
    with lamp.angle() as angle, progress(file.name, quiet=json_) as advance:
        found = recipe_yield(
            file,
            size=size.made(),
            scatter=spread,
            shift=off,
            rig=lamp.rig,
            light_angle_deg=angle,
            workers=workers.made(),
            on_progress=advance,
        )
    if json_:
        return print_json(found)
    _print_yield(file.name, found.lot, found.found)
    return 0


def _share(found: "Rate") -> list[str]:
    shares = (found.value, found.low, found.high)
    return [f"{found.count} of {found.of}", *(f"{one:.1%}" if found.of else "–" for one in shares)]


def _print_yield(name: str, lot: "Lot", found: "PartYield") -> None:
    """Verdicts, risks, contrasts, and what is not in them."""
    rows = [[verdict, *_share(one)] for verdict, one in found.verdicts.items()]
    rows.append(["significant deviation", *_share(found.significant)])
    risks = (
        ("within all tolerances", found.conforming),
        ("of these FAIL (producer's risk)", found.producer_risk),
        ("of the others PASS (consumer's risk)", found.consumer_risk),
    )
    rows += [[words, *_share(one)] for words, one in risks if one is not None]
    print_table(f"{name}: {lot.parts} parts", ["", "parts", "share", "95 % from", "to"], rows)
    rows = [
        [
            f"{one.from_deg:g}°/{one.to_deg:g}° @ {one.tilt_deg:g}°",
            *(f"{value:+.4f}" for value in (one.predicted, one.mean)),
            *(f"{value:.4f}" for value in (one.sd, one.u)),
            "–" if one.tolerance is None else f"±{one.tolerance:g}",
            "–" if one.outside is None else f"{one.outside.value:.1%}",
        ]
        for one in found.contrasts
    ]
    print_table(
        lot.recipe.decision.contrast,
        ["pair", "predicted", "mean of the lot", "sd", "stated u", "tolerance", "parts outside"],
        rows,
    )
    reference = f"{lot.golden} golden parts a rig" if lot.golden else "the prediction"
    lines = [
        f"{lot.rigs} rigs; reference: {reference}; one measurement of every part, without a contrast map."
    ]
    if found.conforming is None:
        lines.append("The recipe has no decision.tolerance: risks of producer and consumer are not defined.")
    print_lines(*lines)
