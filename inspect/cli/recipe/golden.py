"""``anisoscope golden``: parts that are known to be good, against which others are compared."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.tables import console, print_output

if TYPE_CHECKING:
    from anisoscope.kinds.kind import Reference

app = App(name="golden", help="Manage the golden parts of a recipe: parts that are known to be good.")

RecipeFile = Annotated[Path, Parameter(name=["--recipe", "-r"], help="Recipe file (TOML).")]


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
    json_: Json = False,
) -> int:
    """Add inspected parts that are known to be good; all of them or none.

    Examples:
        anisoscope golden add --recipe recipe.toml inspections/GOOD-1-20260115T101500Z
    """
    from anisoscope.decision.reference_parts import golden_path, write_golden
    from anisoscope.kinds.registry import kind_of
    from anisoscope.record.schema import read_record

    if not folders:
        raise UsageError("name the folders of one or more finished inspections")
    kind, path = kind_of(recipe), golden_path(recipe)
    rules = kind.read_recipe(recipe)
    failed = []
    with _as_usage():
        known: Any = kind.read_reference(path, rules)
        for folder in folders:
            record = read_record(folder)
            if record.verdict == "FAIL":
                failed.append(record.serial)
            if record.kind != kind.name:
                raise CalibrationError(
                    f"{record.serial} was inspected as a part of the kind '{record.kind}', and {recipe} is a recipe of "
                    f"the kind '{kind.name}': add it with the recipe by which it was inspected"
                )
            known = kind.add_reference(known, rules, record)
    assert known is not None
    write_golden(path, known)
    if failed:
        console(stderr=True).print(
            f"note: the verdict of {', '.join(failed)} was FAIL: make sure that these parts are good, or take them out "
            "with `anisoscope golden remove`",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
    return _print_change(path, len(folders), "added", known, json_=json_)


@app.command
def remove(*serials: str, recipe: RecipeFile, json_: Json = False) -> int:
    """Remove parts from the set by serial number; an empty set is deleted.

    Examples:
        anisoscope golden remove --recipe recipe.toml GOOD-1
    """
    from anisoscope.decision.reference_parts import golden_path, write_golden
    from anisoscope.kinds.registry import kind_of

    if not serials:
        raise UsageError("name the serial numbers of one or more golden parts")
    path, kind = golden_path(recipe), kind_of(recipe)
    with _as_usage():
        known: Any = kind.read_reference(path, kind.read_recipe(recipe))
        if known is None:
            raise CalibrationError(f"{path}: there are no golden parts of this recipe")
        before = len(known.parts)
        for serial in serials:
            known = known.without(serial)
    if known.parts:
        write_golden(path, known)
    else:
        path.unlink()
    return _print_change(path, before - len(known.parts), "removed", known, json_=json_)


@app.command
def show(
    *,
    recipe: RecipeFile,
    rig: Annotated[
        Path | None, Parameter(name=["--rig", "-g"], help="Rig file, for its light angle.")
    ] = None,
    light_angle: Annotated[float, Parameter(help="Without --rig: angle of the light, degrees.")] = 10.0,
    json_: Json = False,
) -> int:
    """List the golden parts, their scatter, and the defects that can be found with them.

    Examples:
        anisoscope golden show --recipe recipe.toml
    """
    from anisoscope.decision.reference_parts import golden_path
    from anisoscope.kinds.registry import kind_of
    from anisoscope.rig.rigfile import read_rig

    path, kind = golden_path(recipe), kind_of(recipe)
    rules = kind.read_recipe(recipe)
    with _as_usage():
        known = kind.read_reference(path, rules)
        if known is None:
            raise CalibrationError(
                f"{path}: there are no golden parts of this recipe: add some with `anisoscope golden add`"
            )
    channel = rules.acquisition.light_channel
    angle = light_angle if rig is None else read_rig(rig, channel=channel).light.angle_deg
    output = kind.show_reference(known, rules, angle)
    measured_with = getattr(known, "equipment", None)
    content = _content(path, known.lacking, len(known.parts)) | {"equipment": measured_with} | output.content
    line = f"measured with: {measured_with or 'not recorded by the version that collected them'}"
    print_output(replace(output, content=content, lines=(*output.lines, line)), json_=json_)
    return 0


def _content(path: Path, lacking: str | None, count: int) -> dict[str, Any]:
    return {
        "file": str(path),
        "count": count,
        "compared_with": lacking is None and count > 0,
        "lacking": lacking,
    }


def _print_change(path: Path, number: int, what: str, known: "Reference", *, json_: bool) -> int:
    from anisoscope.decision.reference_parts import counted

    lacking, count = known.lacking, len(known.parts)
    if json_:
        print_json(_content(path, lacking if count else None, count) | {what: number})
        return 0
    out = console()
    out.print(
        f"{path}: {number} {what}, {counted(count, known.noun)}",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )
    if lacking and count:
        out.print(lacking, markup=False, highlight=False, soft_wrap=True)
    return 0
