"""``anisoscope profile edit`` and a command for every single step: height maps in, height maps out."""

from collections.abc import Callable, Sequence
from inspect import Parameter as Argument
from inspect import Signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json, check_map, check_new
from anisoscope.cli.profile.many import (
    NO_TABLE,
    OutOptions,
    Values,
    check_table,
    write_each,
    written_suffix,
)
from anisoscope.cli.profile.profile import AS_STATED, Scales, note_lost_layers, reader
from anisoscope.cli.tables import print_lines, print_table
from anisoscope.profiles.editing import operations
from anisoscope.views.options import quantity

if TYPE_CHECKING:
    from anisoscope.profiles.heightmap import HeightMap

Out = Annotated[
    Path | None,
    Parameter(help="File to write: x3p, npz, gsf or exr (they keep the history), or another format."),
]
Format = Annotated[
    str, Parameter(name="--format", help="Format of the new files in --out-dir: an extension such as x3p.")
]
Several = Annotated[OutOptions, Parameter(name="*", group="Several files")]


def edit(
    *words: str,
    out: Out = None,
    format_: Format = "x3p",
    several: Several = NO_TABLE,
    json_: Json = False,
    scales: Scales = AS_STATED,
) -> int:
    """Edit height maps step by step; every step is written into the history of the new file.

    Args:
        words: A height map in a format of docs/height-maps.md, several or patterns with --out-dir; then steps such as
            level, form=poly2, crop=0,0,500,300, filter=gaussian,25,keep:short; parameters stand in the help of the
            command of the same name.

    Examples:
        anisoscope profile edit part.x3p level filter=gaussian,20 fill --out smooth.x3p
        anisoscope profile edit 'lot/*.x3p' level crop=0,0,500,300 --format npz --out-dir edited
    """
    from anisoscope.profiles.editing.steps import Step

    files, steps = _files_and_steps(words)
    if not steps:
        raise UsageError(
            f"profile edit needs at least one step after the file: {', '.join(operations.OPERATIONS)}"
        )
    chain = [Step.parse(text) for text in steps]
    return _run(files, chain, out, scales, format_=format_, several=several, as_json=json_)


def _files_and_steps(words: Sequence[str]) -> tuple[list[Path], Sequence[str]]:
    """Files come first: what has the extension of a map, is a pattern or exists, and names no step; then the steps."""
    from anisoscope.profiles.files.formats import all_formats

    suffixes = {suffix for one in all_formats() for suffix in one.suffixes}
    count = min(len(words), 1)
    while count < len(words):
        word = words[count]
        step = word.partition("=")[0] in operations.OPERATIONS
        named = "=" not in word and (Path(word).suffix.lower() in suffixes or "*" in word or "?" in word)
        if step or not (named or Path(word).exists()):
            break
        count += 1
    return [Path(word) for word in words[:count]], words[count:]


def _check_target(out: Path, sources: list[Path], *, overwrite: bool) -> None:
    check_map(out, "--out")
    if any(out.resolve() == source.resolve() for source in sources):
        raise UsageError(f"--out {out} is a file that is read; a map is never edited in place")
    check_new((out,), overwrite=overwrite)


def _run(
    given: list[Path],
    steps: list[Any],
    out: Path | None,
    scales: Scales,
    *,
    format_: str,
    several: OutOptions,
    as_json: bool,
) -> int:
    from anisoscope.operations.map_series import expanded, map_values
    from anisoscope.profiles.editing.steps import edit_map
    from anisoscope.profiles.files.load import WRITERS, write_height_map

    others = [Path(str(step.values["map"])) for step in steps if "map" in step.values]
    files = expanded(given)
    if several.out_dir is not None:
        if out is not None:
            raise UsageError("--out is one map, --out-dir one for each map; give one of them")
        suffix = written_suffix(format_, tuple(WRITERS))
        for other in others:
            if other.resolve().parent == several.out_dir.resolve() and other.suffix.lower() == suffix:
                raise UsageError(f"{other}, which a step reads, lies in --out-dir; give another one")

        def work(path: Path, target: Path) -> Values:
            edited = edit_map(reader(scales)(path), steps, read=reader(scales))
            write_height_map(edited, target)
            note_lost_layers(edited, target)
            return map_values(edited)

        return write_each(files, work, several, suffix, to_json=as_json)
    if out is None or len(files) != 1:
        raise UsageError("one map takes --out FILE, several take --out-dir FOLDER")
    check_table(several, alone="--out-dir")
    _check_target(out, [files[0], *others], overwrite=several.overwrite)
    edited = edit_map(reader(scales)(files[0]), steps, read=reader(scales))
    write_height_map(edited, out)
    note_lost_layers(edited, out)
    _show(edited, out, as_json=as_json)
    return 0


def _show(edited: "HeightMap", out: Path, *, as_json: bool) -> None:
    from anisoscope.profiles.editing.steps import described
    from anisoscope.profiles.provenance import keeps_provenance

    history, kept = edited.origin["history"], keeps_provenance(out)
    rows, cols = edited.shape
    if as_json:
        print_json(
            {
                "file": str(out),
                "rows": rows,
                "cols": cols,
                "pixel_um": [edited.pixel_y_um, edited.pixel_x_um],
                "missing_share": edited.missing_share,
                "history": history,
                "history_kept_in_file": kept,
            }
        )
        return
    lines = [described(entry) for entry in history]
    lines += [] if kept else [f"{out.suffix} has no place for this history; x3p, npz, gsf and exr keep it"]
    print_table(
        out.name,
        ["quantity", "value", "unit"],
        [
            ["rows, columns", f"{rows}, {cols}", ""],
            ["pixel along y, x", f"{edited.pixel_y_um:.6g}, {edited.pixel_x_um:.6g}", "µm"],
            ["missing", f"{100 * edited.missing_share:.3g}", "%"],
        ],
    )
    print_lines(*lines)


EXAMPLES = {
    "level": "part.x3p --out level.x3p",
    "form": "part.x3p sphere --out ball.x3p",
    "filter": "part.x3p gaussian --cutoff 25 --out smooth.x3p",
    "crop": "part.x3p 10 --y0 10 --x1 310 --y1 210 --out window.x3p",
    "rotate": "part.x3p 0.8 --out turned.x3p",
    "mask": "part.x3p mask.png --out masked.x3p",
    "fill": "part.x3p --out filled.x3p",
    "outliers": "part.x3p --out clean.x3p",
    "align-lines": "scan.x3p --out even.x3p",
    "scars": "scan.x3p --out clean.x3p",
    "resample": "part.x3p 2 --out coarse.x3p",
    "subtract": "part.x3p reference.x3p --align --out difference.x3p",
    "stitch": "left.x3p right.x3p --x 450 --align --out wide.x3p",
}
"""Arguments of one call of every command that an operation becomes."""
TYPES = {"number": float, "count": int, "flag": bool, "text": str, "map": Path}


def _argument(one: operations.Parameter, *, first: bool) -> Argument:
    """A parameter of an operation as an argument of its command: the first in its place, the others as options."""
    kind: Any = Literal[one.choices] if one.choices else TYPES[one.kind]
    if one.default is None and not one.required:
        kind = kind | None
    unit = f" [{one.unit}]" if one.unit else ""
    note = Parameter(
        help=f"{one.meaning[0].upper()}{one.meaning[1:]}{unit}.",
        negative="" if one.kind == "flag" and not one.default else None,
    )
    notes = (
        (quantity(f"{one.name}_{operations.UNITS.get(one.unit, '')}".rstrip("_")), note)
        if one.kind == "number"
        else (note,)
    )
    return Argument(
        one.name,
        Argument.POSITIONAL_ONLY if first else Argument.KEYWORD_ONLY,
        default=Argument.empty if one.required else one.default,
        annotation=Annotated[kind, *notes, one],
    )


def command(name: str) -> Callable[..., int]:
    """The command of one operation: file, values, --out."""
    operation = operations.OPERATIONS[name]

    def run(file: Path, /, *values: object, **options: Any) -> int:  # noqa: ANN401
        from anisoscope.profiles.editing.steps import Step

        out, scales = options.pop("out", None), options.pop("scales", AS_STATED)
        shared = {
            "format_": options.pop("format_", "x3p"),
            "several": options.pop("several", NO_TABLE),
            "as_json": options.pop("json_", False),
        }
        names = [one.name for one in operation.parameters]
        step = Step.of(name, **dict(zip(names, values, strict=False)), **options)
        return _run([file], [step], out, scales, **shared)

    own = [_argument(one, first=place == 0) for place, one in enumerate(operation.parameters)]
    needed = [one for one in own if one.kind is Argument.KEYWORD_ONLY and one.default is Argument.empty]
    other = [one for one in own if one.kind is Argument.KEYWORD_ONLY and one not in needed]
    shared = [
        Argument("format_", Argument.KEYWORD_ONLY, default="x3p", annotation=Format),
        Argument("several", Argument.KEYWORD_ONLY, default=NO_TABLE, annotation=Several),
        Argument("json_", Argument.KEYWORD_ONLY, default=False, annotation=Json),
        Argument(
            "scales",
            Argument.KEYWORD_ONLY,
            default=AS_STATED,
            annotation=Scales,
        ),
    ]
    arguments = [
        Argument(
            "file",
            Argument.POSITIONAL_ONLY,
            annotation=Annotated[
                Path,
                Parameter(help="Height map in a format of docs/height-maps.md; a pattern with --out-dir."),
            ],
        ),
        *(one for one in own if one.kind is Argument.POSITIONAL_ONLY),
        *needed,
        Argument("out", Argument.KEYWORD_ONLY, default=None, annotation=Out),
        *other,
        *shared,
    ]
    run.__name__ = name
    run.__doc__ = f"{operation.meaning}\n\nExamples:\n    anisoscope profile {name} {EXAMPLES[name]}"
    run.__signature__ = Signature(arguments)  # type: ignore[attr-defined]
    run.__annotations__ = {one.name: one.annotation for one in arguments}
    return run


level, form, filter_, crop, rotate = (command(name) for name in ("level", "form", "filter", "crop", "rotate"))
mask, fill, outliers, resample = (command(name) for name in ("mask", "fill", "outliers", "resample"))
subtract, stitch = command("subtract"), command("stitch")
align_lines, scars = command("align-lines"), command("scars")
