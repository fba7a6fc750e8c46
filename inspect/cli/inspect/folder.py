"""``anisoscope resume``, ``recompute``, ``verify``: what can be done with the folder of an inspection."""

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from anisoscope.cli.inspect.history_entry import HistoryOption, history_place, remember
from anisoscope.cli.inspect.lot_mates import lot_mates
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import console

Folder = Annotated[Path, Parameter(help="Folder of an inspection.")]


def resume(folder: Folder, /, *, history: HistoryOption = None, json_: Json = False) -> int:
    """Take up an inspection that was interrupted: photograph what is missing, judge, write record and report.

    Exit codes are those of `inspect`.
    """
    from anisoscope.cli.inspect.inspection import show
    from anisoscope.inspection.run import resume_part

    place = history_place(history, folder.resolve().parent)
    with progress(folder.name, quiet=json_) as advance:
        inspected = resume_part(folder, advance, lot_mates=lambda lot: lot_mates(place, lot))
    try:
        return show(inspected, json_=json_)
    finally:
        remember(inspected, place)


def recompute(folder: Folder, /, *, json_: Json = False) -> int:
    """Judge an inspection again from its raw frames, and compare with its record; nothing is written.

    Exit codes: 0 the same verdict and numbers, 1 not, 64 and above the folder cannot be used.
    """
    from anisoscope.inspection.recompute import recompute as again

    with progress(folder.name, quiet=json_) as advance:
        found = again(folder, advance)
    verdict = found.recorded.verdict
    content: dict[str, Any] = {
        "folder": str(found.folder),
        "same": not found.differences,
        "recorded": verdict,
        "recomputed": found.verdict,
        "differences": list(found.differences),
        "notes": list(found.notes),
    }
    if found.differences:
        lines = [f"{len(found.differences)} values differ:", *(f"  {line}" for line in found.differences)]
    else:
        lines = [f"{verdict}, and every number, as recorded"]
    _print(content, [*lines, *(f"note: {note}" for note in found.notes)], json_=json_)
    return 1 if found.differences else 0


def verify(folder: Folder, /, *, json_: Json = False) -> int:
    """Hash every file of an inspection folder again, and name those that were changed, are missing, or were added.

    Exit codes: 0 everything is as it was, 1 not, 64 and above this is no inspection folder.
    """
    from anisoscope.inspection.integrity import verify as hashed

    found = hashed(folder)
    names = {"changed": found.changed, "missing": found.missing, "additional": found.additional}
    content = {
        "folder": str(folder),
        "intact": found.intact,
        "finished": found.finished,
        "files": found.files,
    }
    content |= {what: list(files) for what, files in names.items()}
    lines = [f"{what}: {name}" for what, files in names.items() for name in files]
    if found.intact:
        lines.append(f"{found.files} files are as they were")
    if not found.finished:
        lines.append("note: the inspection is not finished")
    _print(content, lines, json_=json_)
    return 0 if found.intact else 1


def _print(content: dict[str, Any], lines: list[str], *, json_: bool) -> None:
    if json_:
        print_json(content)
        return
    for line in lines:
        console().print(line, markup=False, highlight=False, soft_wrap=True)
