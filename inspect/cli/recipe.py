"""``anisoscope recipe``: begin a recipe, see what it can tell, and teach it a good part."""

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from anisoscope.cli.console import console, parse_numbers, print_table, progress
from anisoscope.cli.recipe_causes import print_causes
from anisoscope.errors import UsageError

if TYPE_CHECKING:
    from anisoscope.recipecheck import RecipeCheck

app = App(name="recipe", help="Recipes: what a part should look like, how it is photographed and judged.")

PRODUCT = "ridged part"
File = Annotated[Path, Parameter(help="Recipe file (TOML).")]
Json = Annotated[bool, Parameter(name="--json", negative="", help="Print JSON.")]


@app.command
def new(
    *,
    out: Annotated[Path, Parameter(help="Recipe file to write; must not exist.")],
    product: Annotated[str, Parameter(help="Name of the product.")] = PRODUCT,
    pitch: Annotated[float, Parameter(help="Pitch of the ridges in µm.")] = 100.0,
    ridge_angle: Annotated[
        float | None, Parameter(help="Ridge angle of the ideal design in degrees.")
    ] = None,
    height_map: Annotated[Path | None, Parameter(help="Height map of a good part or of the tool.")] = None,
    ink: Annotated[
        str | None,
        Parameter(help="For a print instead: its ink, a file or one of the package, such as synthetic-red."),
    ] = None,
) -> int:
    """Write a recipe with comments, valid as written; then adapt it.

    With --ridge-angle and --height-map the height map decides, and the design is compared with as well. With --ink it
    is the recipe of a print.
    """
    import os

    from anisoscope.atomicfile import write_text
    from anisoscope.recipe import read_recipe
    from anisoscope.recipetext import new_recipe

    if out.exists():
        raise UsageError(f"{out} exists already: name another file, or change it with an editor")
    if ink is not None:
        if ridge_angle is not None or height_map is not None:
            raise UsageError("--ink makes the recipe of a print: leave --ridge-angle and --height-map out")
        return _new_print(out, "print" if product == PRODUCT else product, ink)
    if ridge_angle is None and height_map is None:
        ridge_angle = 10.0
    if height_map is not None and not height_map.is_file():
        raise UsageError(f"{height_map}: there is no such file")
    beside = None if height_map is None else os.path.relpath(height_map.resolve(), out.resolve().parent)
    text = new_recipe(
        product, pitch, ridge_angle_deg=ridge_angle, height_map=beside and Path(beside).as_posix()
    )
    write_text(out, text)
    try:
        read_recipe(out)
    except BaseException:
        out.unlink()
        raise
    console().print(
        f"{out}: written; adapt [material] and [region], then: anisoscope recipe check {out}",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )
    return 0


def _new_print(out: Path, product: str, ink: str) -> int:
    """Write the recipe of a print; a file of an ink is named as seen from the recipe."""
    import os

    from anisoscope.atomicfile import write_text
    from anisoscope.inkfile import SYNTHETIC, find_ink
    from anisoscope.prints.recipe import read_print_recipe
    from anisoscope.prints.recipetext import new_print_recipe

    find_ink(ink)
    if ink not in SYNTHETIC:
        ink = Path(os.path.relpath(Path(ink).resolve(), out.resolve().parent)).as_posix()
    others = tuple(name for name in SYNTHETIC if name != ink) if ink in SYNTHETIC else ()
    write_text(out, new_print_recipe(product, ink, others))
    try:
        read_print_recipe(out)
    except BaseException:
        out.unlink()
        raise
    console().print(
        f"{out}: written; adapt [print], [acquisition] and [region], then: anisoscope recipe check {out}",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )
    return 0


@app.command
def check(
    file: File,
    /,
    *,
    rig: Annotated[
        Path | None, Parameter(name=["--rig", "-g"], help="Rig file, for its light angle.")
    ] = None,
    light_angle: Annotated[float, Parameter(help="Without --rig: angle of the light, degrees.")] = 10.0,
    try_tilts: Annotated[str, Parameter(help="Tilts that might be added, degrees; none: ''.")] = "10,20",
    json_: Json = False,
) -> int:
    """Predict what a recipe's poses show, and say what it can and cannot tell apart; nothing moves."""
    from anisoscope.cli.recipe_print import check_print
    from anisoscope.recipe import is_print, read_recipe
    from anisoscope.recipecheck import check_recipe
    from anisoscope.rig.rigfile import read_rig

    if is_print(file):
        return check_print(file, rig, light_angle, json_=json_)
    tries = parse_numbers(try_tilts, "--try-tilts") if try_tilts.strip() else ()
    recipe = read_recipe(file)
    angle = read_rig(rig).light.angle_deg if rig is not None else light_angle
    with progress(file.name, quiet=json_) as advance:
        found = check_recipe(recipe, angle, tries, advance)
    if json_:
        content = asdict(found)
        for row, cause in zip(content["causes"], found.causes, strict=True):
            row |= {"told_apart_from": cause.told_apart_from, "never_told_from": list(cause.never_told_from)}
        json.dump(content | {"contrast": recipe.decision.contrast}, sys.stdout, indent=2, allow_nan=False)
        sys.stdout.write("\n")
    else:
        _print(found, recipe.product)
    return 0


def _print(found: "RecipeCheck", product: str) -> None:
    names = [f"{p.from_deg:g}°/{p.to_deg:g}° @ {p.tilt_deg:g}°" for p in found.pairs]
    print_table(
        product,
        ["pair", "predicted", "u", "tolerance", "T/U"],
        [
            [
                name,
                f"{pair.predicted:+.4f}",
                f"{pair.u:.4f}",
                "–" if pair.tolerance is None else f"±{pair.tolerance:g}",
                "–" if pair.ratio is None else f"{pair.ratio:.1f}",
            ]
            for name, pair in zip(names, found.pairs, strict=True)
        ],
    )
    print_table(
        "uncertainty budget",
        ["source", *(f"u({name})" for name in names)],
        [[row.source, *(f"{value:.4f}" for value in row.contributions)] for row in found.budget],
    )
    print_causes(found.causes)
    out = console()
    for cause, reason in found.left_out:
        out.print(f"not looked at: {cause}: {reason}", markup=False, highlight=False, soft_wrap=True)
    for one in found.advice:
        apart = ", ".join(f"{a} from {b}" for a, b in one.tells_apart[:6])
        more = f" and {len(one.tells_apart) - 6} more" if len(one.tells_apart) > 6 else ""
        told = [f"show {', '.join(one.shows)}"] if one.shows else []
        told += [f"tell {apart}{more}"] if apart else []
        out.print(
            f"a tilt of {one.tilt_deg:g}° besides would {' and '.join(told)}",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
    for line in found.complaints:
        out.print(line, markup=False, highlight=False, soft_wrap=True)


@app.command
def teach(
    file: File,
    /,
    *,
    rig: Annotated[Path, Parameter(name=["--rig", "-g"], help="Rig file (TOML).")],
    serial: Annotated[str, Parameter(name=["--serial", "-s"], help="Serial number of the good part.")],
    out: Annotated[Path, Parameter(help="Folder that receives the inspection folder.")] = Path("inspections"),
    json_: Json = False,
) -> int:
    """Photograph a good part; set exposure, region and tolerances of a recipe by it.

    The recipe becomes a new version; the old one is kept beside it as NAME.v1.toml and so on.
    """
    from anisoscope.teaching import teach as by_part

    with progress(serial, quiet=json_) as advance:
        found = by_part(file, rig, serial, out, advance)
    if json_:
        json.dump(found.as_json(), sys.stdout, indent=2, allow_nan=False)
        sys.stdout.write("\n")
        return 0
    print_table(
        f"{file}: version {found.version}",
        ["value", "was", "is", "because"],
        [[change.key, str(change.old), str(change.new), change.why] for change in found.changes],
    )
    lines = [f"the version before: {found.kept}", f"the inspection: {found.folder}", *found.notes]
    for line in lines:
        console().print(line, markup=False, highlight=False, soft_wrap=True)
    return 0
