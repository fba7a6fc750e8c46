"""``anisoscope inspect``, ``resume``, ``recompute``, ``verify``: inspect a part, and work with its folder."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.language import message, translated
from anisoscope.cli.help_page import MORE, everyday
from anisoscope.cli.inspect.batch_operator import ask_serial
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import INTO, Flag, HistoryOption, Into, Json, TrustFile
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import answer, console, print_lines, print_table
from anisoscope.parameters.inspecting import ForeignFrames, PartLabels
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.inspection.recompute import Recomputed
    from anisoscope.inspection.reports import Reports
    from anisoscope.inspection.run import Inspected


@with_options(
    part=Options(
        PartLabels,
        names={"serial": ("--serial", "-s")},
        without={"at_mm": "two words: an option of its own"},
        whole=True,
    ),
    foreign=Options(ForeignFrames, groups=dict.fromkeys(("reflectance", "reuse"), MORE), whole=True),
)
@everyday("recipe", "rig", "part", "at", "into", "json_")
def inspect(
    *,
    recipe: Annotated[Path | None, Parameter(name=["--recipe", "-r"], help="Recipe file (TOML).")] = None,
    rig: Annotated[Path | None, Parameter(name=["--rig", "-g"])] = None,
    part: Given[PartLabels],
    foreign: Given[ForeignFrames],
    init: Flag = False,
    at: Annotated[tuple[float, float] | None, Parameter(negative="")] = None,
    into: Into = INTO,
    json_: Json = False,
) -> int:
    """Photograph a part, compare its contrasts (of a print: its colours) with the prediction, and decide.

    Exit codes: 0 PASS, 1 FAIL, 2 INCONCLUSIVE, 3 INVALID, 64 and above usage or hardware.

    Args:
        init: With --frames: write a first frames.csv for the pictures there, and end.
        rig: Rig file (TOML); with --frames rig.toml beside them by default.
        at: Place of the part on the plate for the axes x and y: mm right and up of the stage's axis, at sample angle 0.

    Examples:
        anisoscope inspect --recipe recipe.toml --rig rig.toml --serial A-0001
        anisoscope inspect --frames photographed --init
        anisoscope inspect --recipe recipe.toml --frames photographed --serial A-0002 --lot L42 --json
    """
    from anisoscope.inspection.reports import Reports
    from anisoscope.operations.inspecting import Surroundings
    from anisoscope.operations.inspecting import inspect as inspect_one
    from anisoscope.operations.remembering import history_place, lot_mates, used_before

    labels, taken = part.made(), foreign.made()
    if init:
        return _draft(taken.frames, json_=json_)
    if recipe is None:
        raise UsageError("--recipe is missing")
    if rig is None and taken.frames is None:
        raise UsageError("name a rig file with --rig, or a folder of frames with --frames")
    if labels.serial is None:
        serial, lot = ask_serial(labels.lot)
        labels = replace(labels, serial=serial, lot=lot)
    if at is not None and taken.frames is not None:
        raise UsageError(
            "--at says where axes bring a part from; with --frames nothing moves: leave one of them out"
        )
    place = history_place(into.history, into.out)
    with Reports() as reports:
        with progress(str(labels.serial), quiet=json_) as advance:
            inspected = inspect_one(
                recipe,
                rig,
                labels=replace(labels, at_mm=at),
                foreign=taken,
                out=into.out,
                known=Surroundings(lot_mates(place, labels.lot), used_before(place), reports),
                on_progress=advance,
            )
        return _concluded(inspected, reports, place, json_=json_)


def _draft(frames: Path | None, *, json_: bool) -> int:
    """Write a first table of frames; print what is still to be filled in, and what each column means."""
    from anisoscope.rig.framefolder import MEANINGS, draft_table

    if frames is None:
        raise UsageError("--init writes the table of a folder of pictures: name it with --frames")
    draft = draft_table(frames)
    lines = [f"{draft.table}: {draft.frames} frames, in the order of their names; look at every line"]
    lines += [f"  {name}: {words}" for name, words in MEANINGS.items()]
    lines += [f"fill in {name} of {', '.join(files)}" for name, files in draft.missing.items()]
    answer(draft, lines, json_=json_)
    return 0


def _concluded(inspected: "Inspected", reports: "Reports", place: str | Path | None, *, json_: bool) -> int:
    """Print the verdict and enter it into the history, then wait for the report; JSON waits for all of it."""
    from anisoscope.operations.findings import content_of
    from anisoscope.operations.remembering import judge_lot, remember

    try:
        if not json_:
            _print(inspected)
    finally:
        remember(inspected, place)
    anew = judge_lot(inspected, place, reports=reports)
    notes = (*(one.anew_text for one in anew), *reports.finish())
    if json_:
        print_json(content_of(inspected, notes))
    else:
        _print_notes(inspected, notes)
    return _exit_code(inspected)


def _exit_code(inspected: "Inspected") -> int:
    from anisoscope.record.verdict import Verdict

    return Verdict(inspected.record.verdict).exit_code


def _print(inspected: "Inspected") -> None:
    from anisoscope.kinds.parts import reporting
    from anisoscope.kinds.registry import kind_named
    from anisoscope.operations.findings import conclusion_lines, explained

    record = inspected.record
    for table in reporting(kind_named(record.kind)).summary(record).tables:
        cells = [[translated(cell) for cell in row] for row in table.rows]
        caption = table.caption and translated(table.caption)
        print_table(translated(table.title), [translated(one) for one in table.columns], cells, caption)
    out = console()
    color = {"PASS": "green", "FAIL": "red", "INCONCLUSIVE": "yellow", "INVALID": "magenta"}[record.verdict]
    out.print(f"[bold {color}]{message(record.verdict)}[/]")
    if record.conclusion is not None:
        print_lines(*conclusion_lines(record.conclusion))
    print_lines(*(f"  {translated(reason)}" for reason in record.reasons))
    print_lines(*(f"  {line}" for line in explained(record)))


def _print_notes(inspected: "Inspected", notes: tuple[str, ...] = ()) -> None:
    """Notes, those on the report included, and where the report is."""
    print_lines(*(message("note: {note}", note=note) for note in (*inspected.notes, *notes)))
    print_lines(f"{message('report')}: {inspected.report}")


Folder = Annotated[Path, Parameter(help="Folder of an inspection.")]


def resume(folder: Folder, /, *, history: HistoryOption = None, json_: Json = False) -> int:
    """Continue an interrupted inspection: photograph what is missing, judge, write record and report.

    Exit codes are those of `inspect`.

    Examples:
        anisoscope resume inspections/A-0001-20260115T101500Z
    """
    from anisoscope.inspection.reports import Reports
    from anisoscope.inspection.run import resume_part
    from anisoscope.operations.remembering import history_place, lot_mates, used_before

    place = history_place(history, folder.resolve().parent)
    with Reports() as reports:
        with progress(folder.name, quiet=json_) as advance:
            inspected = resume_part(
                folder,
                advance,
                lot_mates=lambda lot: lot_mates(place, lot),
                used_before=used_before(place),
                reports=reports,
            )
        return _concluded(inspected, reports, place, json_=json_)


def report(folder: Folder, /, *, json_: Json = False) -> int:
    """Write the report of a finished inspection into its folder, where it is missing: the program was killed.

    It is made from the frames, with the numbers of the record; without the comparison with the lot. A report that is
    there, as it was written, stays. `show --html FILE --refresh` makes one elsewhere.

    Examples:
        anisoscope report inspections/A-0001-20260115T101500Z
    """
    from anisoscope.inspection.run import write_report_again
    from anisoscope.record.schema import REPORT_NAME

    with progress(folder.name, quiet=json_) as advance:
        done = write_report_again(folder, advance)
    path = folder / REPORT_NAME
    answer({"report": str(path), "origin": done}, [f"report, {done}: {path}"], json_=json_)
    return 0


def recompute(
    folder: Folder,
    /,
    *more: Path,
    jobs: Annotated[
        int | None, Parameter(help="Processes for several folders; left out, one a core.")
    ] = None,
    scheduler: Annotated[
        str | None, Parameter(help="Address of a Dask scheduler (tcp://host:8786) for several folders.")
    ] = None,
    json_: Json = False,
) -> int:
    """Judge inspections again from their raw frames and compare with their records; nothing is written.

    Exit codes: 0 the same verdict and numbers, 1 different ones, 64 and above an unusable folder.

    Examples:
        anisoscope recompute inspections/A-0001-20260115T101500Z
        anisoscope recompute inspections/A-*
    """
    if more:
        return _recompute_all([folder, *more], jobs, scheduler, json_=json_)
    from anisoscope.inspection.recompute import recompute as again

    with progress(folder.name, quiet=json_) as advance:
        found = again(folder, advance)
    answer(found, _compared(found), json_=json_)
    return 1 if found.differences else 0


def _recompute_all(folders: list[Path], jobs: int | None, scheduler: str | None, *, json_: bool) -> int:
    from anisoscope.base.errors import RecordError
    from anisoscope.operations.inspecting import recompute_all
    from anisoscope.parameters.workers import Workers

    with progress("inspections", quiet=json_) as advance:
        found = recompute_all(folders, Workers(jobs, scheduler), advance)
    lines: list[str] = []
    for folder, one in zip(folders, found, strict=True):
        first, *rest = [one] if isinstance(one, str) else _compared(one)
        lines += [f"{folder}: {first}", *rest]
    unusable = sum(isinstance(one, str) for one in found)
    same = sum(not isinstance(one, str) and one.same for one in found)
    differing = len(found) - same - unusable
    lines.append(f"{same} of {len(found)} as recorded, {differing} differ, {unusable} cannot be judged again")
    contents = [
        {"folder": str(folder), "same": None, "problem": one} if isinstance(one, str) else one
        for folder, one in zip(folders, found, strict=True)
    ]
    answer({"inspections": contents}, lines, json_=json_)
    return 1 if differing else RecordError.exit_code if unusable else 0


def _compared(found: "Recomputed") -> list[str]:
    if found.same:
        lines = [f"{found.recorded.verdict}, and every number, as recorded"]
    else:
        lines = [f"{len(found.differences)} values differ:", *(f"  {line}" for line in found.differences)]
    return [*lines, *(f"note: {note}" for note in found.notes)]


def verify(folder: Folder, /, *, trust: TrustFile = None, json_: Json = False) -> int:
    """Check the hashes of an inspection folder: name files that were changed, removed or added.

    Exit codes: 0 unchanged, 1 changed or, with --trust, not signed by one of its keys, 64 and above no inspection
    folder.

    Examples:
        anisoscope verify inspections/A-0001-20260115T101500Z
        anisoscope verify inspections/A-0001-20260115T101500Z --trust keys.toml
    """
    from anisoscope.base.signature import read_trust
    from anisoscope.inspection.integrity import verify as hashed

    found = hashed(folder, None if trust is None else read_trust(trust))
    names = {"changed": found.changed, "missing": found.missing, "additional": found.additional}
    lines = [f"{what}: {name}" for what, files in names.items() for name in files]
    lines += found.distrust
    if found.intact:
        lines.append(f"{found.files} files are as they were")
    if found.origin:
        anew = f", judged anew after {found.judged_anew}" if found.judged_anew else ""
        lines.append(
            ("the rig took the frames" if found.origin == "rig" else "the frames were imported") + anew
        )
    if found.signed_by is not None:
        number = "" if found.number is None else f", record {found.number}"
        lines.append(f"signed by {found.signed_by}{number}")
        lines += [] if found.number is not None else ["note: not linked to the record before it"]
        if found.report_signed is False and not found.distrust:
            lines.append(
                "note: the report is not covered by a signature: rely on record.json, or write it again"
            )
    elif found.finished and not found.distrust:
        lines.append("note: the record is not signed")
    if found.finished and not found.report_written and "report.html" not in found.missing:
        lines.append(f"note: the report is not written yet: `anisoscope report {folder}` writes it")
    if not found.finished:
        lines.append("note: the inspection is not finished")
    answer({"folder": folder} | fields_of(found), lines, json_=json_)
    return 0 if found.intact else 1
