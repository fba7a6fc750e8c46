"""``anisoscope golden``: parts that are known to be good, against which others are compared."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import USUAL_LAMP, Flag, Html, Json, Lamp, RecipeFile
from anisoscope.cli.tables import answer, print_lines, print_output, print_table

if TYPE_CHECKING:
    from anisoscope.operations.teaching import GoldenParts

app = App(name="golden", help="Manage the golden parts of a recipe: parts that are known to be good.")


@contextmanager
def _as_usage() -> Iterator[None]:
    """No part is judged here, so no exit code may look like a verdict."""
    try:
        yield
    except CalibrationError as error:
        raise UsageError(str(error)) from error


@app.command
def add(
    *folders: Annotated[Path, Parameter(help="Folders of finished inspections of good parts.")],
    recipe: RecipeFile,
    unlabelled: Flag = False,
    json_: Json = False,
) -> int:
    """Add inspected parts that are known to be good; all of them or none.

    Args:
        unlabelled: Parts of a lot of unknown quality: those that deviate from the others are left out.

    Examples:
        anisoscope golden add --recipe recipe.toml inspections/GOOD-1-20260115T101500Z
        anisoscope golden add --recipe recipe.toml --unlabelled inspections/LOT-7-*
    """
    from anisoscope.operations.teaching import add_golden

    with _as_usage():
        found = add_golden(recipe, folders, unlabelled=unlabelled)
    if unlabelled:
        odd = (
            f"left out, as they deviate from the others: {', '.join(found.left_out)}; "
            if found.left_out
            else ""
        )
        print_lines(
            f"note: {odd}what all of these parts have in common is not seen",
            stderr=True,
        )
    if found.failed:
        print_lines(
            f"note: the verdict of {', '.join(found.failed)} was FAIL: make sure that these parts are good, or take "
            "them out with `anisoscope golden remove`",
            stderr=True,
        )
    return _print_change(found, json_=json_)


@app.command
def remove(*serials: str, recipe: RecipeFile, json_: Json = False) -> int:
    """Remove parts from the set by serial number; an empty set is deleted.

    Examples:
        anisoscope golden remove --recipe recipe.toml GOOD-1
    """
    from anisoscope.operations.teaching import remove_golden

    with _as_usage():
        return _print_change(remove_golden(recipe, serials), json_=json_)


@app.command
def show(
    *,
    recipe: RecipeFile,
    lamp: Lamp = USUAL_LAMP,
    json_: Json = False,
) -> int:
    """List the golden parts, their scatter, and the defects that can be found with them.

    Examples:
        anisoscope golden show --recipe recipe.toml
    """
    from anisoscope.decision.reference_parts import golden_path
    from anisoscope.kinds.parts import collecting
    from anisoscope.kinds.registry import kind_of
    from anisoscope.operations.teaching import GoldenParts
    from anisoscope.rig.rigfile import read_rig

    path, kind = golden_path(recipe), kind_of(recipe)
    rules = kind.read_recipe(recipe)
    with _as_usage():
        known = collecting(kind, rules).read_reference(path, rules)
        if known is None:
            raise CalibrationError(
                f"{path}: there are no golden parts of this recipe: add some with `anisoscope golden add`"
            )
    channel = rules.acquisition.light_channel
    with lamp.angle() as usual:
        angle = usual if lamp.rig is None else read_rig(lamp.rig, channel=channel).light.angle_deg
        output = collecting(kind, rules).show_reference(known, rules, angle)
    measured_with = getattr(known, "equipment", None)
    content = fields_of(GoldenParts.of(path, known)) | {"equipment": measured_with} | output.content
    line = f"measured with: {measured_with or 'not recorded by the version that collected them'}"
    print_output(replace(output, content=content, lines=(*output.lines, line)), json_=json_)
    return 0


@app.command
def certify(
    *folders: Annotated[
        Path, Parameter(help="Folders of finished inspections of good parts that are not golden.")
    ],
    recipe: RecipeFile,
    false_alarms: Annotated[float, Parameter(help="Largest rate of false alarms that is wanted.")] = 0.01,
    confidence: Annotated[float, Parameter(help="One-sided confidence.")] = 0.95,
    html: Html = None,
    for_reports: Annotated[
        bool,
        Parameter(negative="", help="Store it next to the recipe: reports of later inspections print it."),
    ] = False,
    json_: Json = False,
) -> int:
    """Certify the rate of false alarms from inspections of good parts, whatever their distribution.

    Every folder is of another part, judged by this recipe and its golden parts as they are now, and none is golden.

    Exit codes: 0 certified, 1 not, 64 and above nothing can be said.

    Examples:
        anisoscope golden certify --recipe recipe.toml --false-alarms 0.02 --for-reports inspections/OK-*
    """
    from anisoscope.operations.teaching import certify_golden
    from anisoscope.report.study_page import StudyPage, Table

    with _as_usage():
        done = certify_golden(
            recipe, folders, false_alarms=false_alarms, confidence=confidence, for_reports=for_reports
        )
    found = done.certificate
    level = "too few parts" if found.level is None else f"{found.level:.3g}"
    rows = (
        ("good parts with a verdict", str(found.parts)),
        ("of these FAIL", str(found.alarms)),
        ("of these INCONCLUSIVE", str(found.undecided)),
        (f"false alarms at most, {confidence:.0%} confidence", f"{found.highest:.2%}"),
        ("stated by the model: level of the recipe", "–" if found.stated is None else f"{found.stated:.2%}"),
        (f"level that holds {false_alarms:.2%}, whatever the distribution", level),
    )
    notes = [found.verdict]
    if done.invalid:
        notes.append(f"{done.invalid} INVALID inspections say nothing and are left out")
    if done.stored is not None:
        notes.append(f"stored in {done.stored}, for this recipe and these golden parts alone")
    if html is not None:
        table = Table("False alarms", ("", "value"), rows)
        StudyPage("Certificate of false alarms", str(recipe), [], [table], notes).write(html)
    if json_:
        print_json(done)
    else:
        print_table("False alarms", ["", "value"], [list(row) for row in rows])
        print_lines(*notes)
    return 0 if found.certified else 1


def _print_change(found: "GoldenParts", *, json_: bool) -> int:
    from anisoscope.decision.reference_parts import counted

    what, number = next(iter(found.changed.items()))
    lines = [f"{found.file}: {number} {what}, {counted(found.count, found.noun)}"]
    answer(found, [*lines, found.lacking] if found.lacking else lines, json_=json_)
    return 0
