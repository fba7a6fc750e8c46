"""``anisoscope history``, ``show``, ``compare``, ``export``: what has been inspected, and what became of it."""

from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.console import progress
from anisoscope.cli.history.options import ALL, Json, Place, Which, opened

app = App(name="history", help="List past inspections; add, check and decide about them.")
Selection = Annotated[Which, Parameter(name="*")]
One = Annotated[str, Parameter(help="Serial number, id, or folder of an inspection.")]
_LIMIT = 50


@app.default
def history(
    *,
    which: Selection = ALL,
    limit: Annotated[int, Parameter(help="At most so many, the latest ones; 0 for all.")] = _LIMIT,
    place: Place = None,
    json_: Json = False,
) -> int:
    """List past inspections, the oldest first. All filters that are given must hold."""
    from anisoscope.cli.history.output import print_history

    filters = which.filters(limit)
    with opened(place) as found:
        rows = found.rows(filters)
        decided = found.dispositions_of([row.id for row in rows])
        total = found.count(filters) if len(rows) == limit else len(rows)
    print_history(rows, decided, total, json_=json_)
    return 0


@app.command
def add(
    *folders: Annotated[Path, Parameter(help="Inspection folders, or folders above them.")],
    place: Place = None,
    json_: Json = False,
) -> int:
    """Add finished inspections that are not in the history yet; those that are, are passed over.

    Exit codes: 0 all of them are in the history now, 1 a record is damaged, 64 and above nothing could be added.
    """
    from anisoscope.cli.history.output import print_added
    from anisoscope.history.adding import add_folders

    if not folders:
        raise UsageError("name one or more folders of inspections, or a folder above them")
    with opened(place, create=True) as found, progress("history", quiet=json_) as advance:
        added = add_folders(found, folders, advance)
        where = str(found.address)
    print_added(added, where, json_=json_)
    return 1 if added.refused else 0


@app.command
def dispose(
    inspection: One,
    decision: Annotated[str, Parameter(help="accept, reject, rework, remeasure or hold.")],
    /,
    *,
    reviewer: Annotated[str, Parameter(name=["--by", "--reviewer"], help="Who decides.")],
    comment: Annotated[str, Parameter(name=["--comment", "-m"], help="Why.")] = "",
    place: Place = None,
    json_: Json = False,
) -> int:
    """Write down what a reviewer decides about an inspection. Its verdict, and earlier decisions, stay as they are."""
    from anisoscope.cli.history.output import print_disposed
    from anisoscope.history.store import find

    with opened(place) as found:
        row = find(found, inspection)
        made = found.dispose(row.id, reviewer=reviewer, decision=decision, comment=comment)
    print_disposed(row, made, json_=json_)
    return 0


@app.command
def verify(
    *,
    head: Annotated[
        str | None,
        Parameter(help="A head that was noted earlier: fails if the history was cut or rewritten since."),
    ] = None,
    place: Place = None,
    json_: Json = False,
) -> int:
    """Compute the hash of every row again, and name the rows that were changed, exchanged or removed.

    Exit codes: 0 everything is as it was written, 1 not, 64 and above there is no history to be read.
    """
    from anisoscope.cli.history.output import print_verified

    if head is not None and not _is_hash(head):
        raise UsageError(
            f"--head takes the 64 hexadecimal digits that this command prints, not {head[:80]!r}"
        )
    with opened(place) as found:
        damage = [str(one) for one in found.verify_chain()]
        if head is not None and not found.holds(head):
            damage.append("no inspection has the head that was noted: the history was cut or rewritten since")
        print_verified(damage, found.count(), found.head(), json_=json_)
    return 1 if damage else 0


def _is_hash(text: str) -> bool:
    return len(text) == 64 and not set(text.lower()) - set("0123456789abcdef")


def show(inspection: One, /, *, place: Place = None, json_: Json = False) -> int:
    """Show one inspection: verdict, numbers, what reviewers decided, and whether its folder still agrees.

    Of a part that was inspected several times, the latest. `id:7` and `serial:7` tell ids and serial numbers apart.
    """
    from anisoscope.cli.history.output import print_shown
    from anisoscope.history.store import find

    with opened(place) as found:
        row = find(found, inspection)
        print_shown(row, found.dispositions(row.id), json_=json_)
    return 0


def compare(first: One, second: One, /, *, place: Place = None, json_: Json = False) -> int:
    """Compare two inspections: contrasts side by side, and what changed in recipe, rig, calibrations and software."""
    from anisoscope.cli.history.output import print_comparison
    from anisoscope.history.comparing import compare as compared
    from anisoscope.history.store import find

    with opened(place) as found:
        comparison = compared(find(found, first), find(found, second))
    print_comparison(comparison, json_=json_)
    return 0


def export(
    *,
    which: Selection = ALL,
    csv: Annotated[Path | None, Parameter(help="Write a table (CSV, UTF-8).")] = None,
    json: Annotated[Path | None, Parameter(name="--json", help="Write JSON.")] = None,
    junit: Annotated[
        Path | None, Parameter(help="Write JUnit XML, for servers of continuous integration.")
    ] = None,
    limit: Annotated[int, Parameter(help="At most so many, the latest ones; 0 for all.")] = 0,
    place: Place = None,
) -> int:
    """Write past inspections for other programs, into one or several files. Filters are those of `history`."""
    from anisoscope.base.atomic_write import write_text
    from anisoscope.cli.history.output import say
    from anisoscope.history.export import to_csv, to_json, to_junit

    wanted = [(csv, to_csv), (json, to_json), (junit, to_junit)]
    files = [(path, make) for path, make in wanted if path is not None]
    if not files:
        raise UsageError("name a file: --csv FILE, --json FILE or --junit FILE")
    with opened(place) as found:
        rows = found.rows(which.filters(limit))
        decided = found.dispositions_of([row.id for row in rows])
    for path, make in files:
        write_text(path, make(rows, decided))
        say(f"{len(rows)} inspections: {path}")
    return 0
