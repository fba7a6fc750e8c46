"""``anisoscope golden``: parts that are known to be good, against which others are compared."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.tables import console, print_lines, print_output, print_table

if TYPE_CHECKING:
    from anisoscope.kinds.parts import Reference
    from anisoscope.record.schema import Record

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
    from anisoscope.decision.reference_parts import golden_path
    from anisoscope.kinds.registry import add_golden

    if not folders:
        raise UsageError("name the folders of one or more finished inspections")
    path = golden_path(recipe)
    with _as_usage():
        known, failed = add_golden(recipe, folders)
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
    from anisoscope.kinds.parts import collecting
    from anisoscope.kinds.registry import kind_of

    if not serials:
        raise UsageError("name the serial numbers of one or more golden parts")
    path, kind = golden_path(recipe), kind_of(recipe)
    rules = kind.read_recipe(recipe)
    with _as_usage():
        known: Any = collecting(kind, rules).read_reference(path, rules)
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
    from anisoscope.kinds.parts import collecting
    from anisoscope.kinds.registry import kind_of
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
    angle = light_angle if rig is None else read_rig(rig, channel=channel).light.angle_deg
    output = collecting(kind, rules).show_reference(known, rules, angle)
    measured_with = getattr(known, "equipment", None)
    content = _content(path, known.lacking, len(known.parts)) | {"equipment": measured_with} | output.content
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
    html: Annotated[Path | None, Parameter(help="Write the certificate as a page.")] = None,
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
    from anisoscope.decision.certificate import StoredCertificate, certificate, certificate_path
    from anisoscope.decision.reference_parts import golden_path
    from anisoscope.kinds.parts import collecting
    from anisoscope.kinds.registry import kind_of
    from anisoscope.record.schema import sha256_of
    from anisoscope.report.study_page import StudyPage, Table

    if not folders:
        raise UsageError("name the folders of finished inspections of good parts")
    kind, path = kind_of(recipe), golden_path(recipe)
    rules = kind.read_recipe(recipe)
    with _as_usage():
        known = collecting(kind, rules).read_reference(path, rules)
    now = [(file.name, sha256_of(file)) for file in (recipe, path) if file.is_file()]
    judged = _judged(folders, set() if known is None else {one.serial for one in known.parts}, now)
    records = [one for one in judged if one.verdict != "INVALID"]
    invalid = len(judged) - len(records)
    stated = getattr(rules.decision, "alpha", None)
    found = certificate(
        [one.verdict for one in records], [one.p_value for one in records], false_alarms, confidence, stated
    )
    level = "too few parts" if found.level is None else f"{found.level:.3g}"
    rows = (
        ("good parts with a verdict", str(found.parts)),
        ("of these FAIL", str(found.alarms)),
        ("of these INCONCLUSIVE", str(found.undecided)),
        (f"false alarms at most, {confidence:.0%} confidence", f"{found.highest:.2%}"),
        ("stated by the model: level of the recipe", "–" if stated is None else f"{stated:.2%}"),
        (f"level that holds {false_alarms:.2%}, whatever the distribution", level),
    )
    notes = [
        found.verdict,
        *([f"{invalid} INVALID inspections say nothing and are left out"] if invalid else []),
    ]
    if for_reports:
        stored = StoredCertificate.of(
            recipe, found, [one.serial for one in records], f"{datetime.now(UTC):%Y-%m-%d}"
        )
        stored.write(certificate_path(recipe))
        notes.append(f"stored in {certificate_path(recipe)}, for this recipe and these golden parts alone")
    if html is not None:
        table = Table("False alarms", ("", "value"), rows)
        StudyPage("Certificate of false alarms", str(recipe), [], [table], notes).write(html)
    if json_:
        print_json(found)
    else:
        print_table("False alarms", ["", "value"], [list(row) for row in rows])
        print_lines(*notes)
    return 0 if found.certified else 1


def _judged(folders: Sequence[Path], golden: set[str], now: Sequence[tuple[str, str]]) -> list["Record"]:
    """Inspections of different parts, none golden, by the files (name and SHA-256) that are in use now."""
    from anisoscope.record.schema import read_record

    seen: dict[str, Path] = {}
    records = []
    for folder in folders:
        record = read_record(folder)
        if record.serial in golden:
            raise UsageError(
                f"{folder}: {record.serial} is a golden part: it made the rule and proves nothing about it"
            )
        if record.serial in seen:
            raise UsageError(
                f"{folder}: {record.serial} is the part of {seen[record.serial]}: name each part once"
            )
        seen[record.serial] = folder
        used = {one.sha256 for one in record.inputs}
        changed = next((name for name, digest in now if digest not in used), None)
        if changed is not None:
            raise UsageError(
                f"{folder}: was judged by another {changed} than the present one: inspect the part again"
            )
        records.append(record)
    return records


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
        print_lines(lacking)
    return 0
