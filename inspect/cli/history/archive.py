"""``anisoscope archive``: finished inspections on a share or in an object store."""

import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.cli.history.history import plain, write_line
from anisoscope.cli.history.options import DEFAULT_OUT
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Flag, Json, TrustFile
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import answer, print_table

if TYPE_CHECKING:
    from anisoscope.inspection.archive_store import Store

app = App(name="archive", help="Archive finished inspections on a share or in an object store, by rules.")

Url = Annotated[
    str | None,
    Parameter(
        name="--store",
        help="Store of the archive: a folder, or s3://bucket/folder?endpoint=https://host; by default that of the "
        "project file.",
    ),
]
Which = Annotated[str, Parameter(help="Serial number, or name of the inspection's folder.")]


def _store(url: str | None) -> "Store":
    from anisoscope.inspection.archive_store import open_store

    if url is None:
        raise UsageError(
            'no archive is meant: name its store with --store, or with store = "…" in anisoscope.toml'
        )
    return open_store(url)


@app.command
def push(
    *places: Path,
    archive: Url = None,
    remove: Flag = False,
    every: float | None = None,
    json_: Json = False,
) -> int:
    """Archive every finished inspection in some folders and below; what is there already is not sent again.

    A folder that is not as it was is not archived. After an interruption, or when the network was away, the same
    command goes on. Exit codes: 0 all are archived, 74 some could not be, 69 the archive does not answer.

    Args:
        remove: Remove local folders whose files were all read back with right hashes.
        every: Go on, every so many seconds, until Ctrl-C; for a station's background.

    Examples:
        anisoscope archive push inspections --store s3://inspections/line-2
        anisoscope archive push inspections --remove --every 300
    """
    from anisoscope.inspection.archive_store import ArchiveError
    from anisoscope.operations.archiving import PushedAll
    from anisoscope.operations.archiving import push as pushed

    store, given = _store(archive), list(places) or [DEFAULT_OUT]
    if every is not None and not every > 0.0:
        raise UsageError(f"--every takes seconds above 0, not {every:g}")
    while True:
        told: list[Any] = []
        try:
            with progress("archive", quiet=json_) as advance:
                found = pushed(store, given, remove=remove, told=told, on_progress=advance)
        except ArchiveError as error:
            if every is None:
                raise
            found = PushedAll.of(told)
            write_line(f"{error}; again in {every:g} s")
        words = f"{_counted(found.archived, 'inspection')} in {store.url}, {found.new} of them new, "
        words += f"{found.sent_bytes / 1e6:.1f} MB sent"
        words += f", {_counted(found.removed, 'local folder')} removed" if found.removed else ""
        words += f", {found.refused} refused" if found.refused else ""
        answer(found, map(plain, (*found.failed, words)), json_=json_)
        if every is None:
            return RecordError.exit_code if found.refused else 0
        threading.Event().wait(every)


def _counted(number: int, word: str) -> str:
    return f"{number} {word}" + ("" if number == 1 else "s")


@app.command
def pull(
    inspection: Which,
    /,
    *,
    archive: Url = None,
    out: Annotated[Path, Parameter(help="Folder that receives the inspection folders.")] = DEFAULT_OUT,
    json_: Json = False,
) -> int:
    """Fetch inspections of a part, or one, from the archive; every file is hashed.

    Examples:
        anisoscope archive pull A-0001 --out restored
    """
    from anisoscope.operations.archiving import pull as fetched

    with progress("archive", quiet=json_) as advance:
        folders = [str(one) for one in fetched(_store(archive), inspection, out, on_progress=advance)]
    answer({"folders": folders}, map(plain, folders), json_=json_)
    return 0


@app.command(name="list")
def list_(
    inspection: Annotated[str | None, Parameter(help="Serial number or folder; all without.")] = None,
    /,
    *,
    archive: Url = None,
    json_: Json = False,
) -> int:
    """List archived inspections.

    Examples:
        anisoscope archive list
        anisoscope archive list A-0001
    """
    from anisoscope.operations.archiving import archived_inspections

    store = _store(archive)
    with progress("archive", quiet=json_) as advance:
        found = archived_inspections(store, inspection, on_progress=advance)
    if json_:
        return print_json(
            {
                "archive": store.url,
                "inspections": [one.model_dump(mode="json", exclude={"files"}) for one in found],
            }
        )
    rows = [
        [
            f"{one.created_at:%Y-%m-%d %H:%M}",
            one.serial,
            one.product,
            one.verdict,
            f"{one.bytes / 1e6:.1f}",
            one.name,
        ]
        for one in found
    ]
    print_table(store.url, ["UTC", "serial", "product", "verdict", "MB", "folder"], rows)
    return 0


@app.command
def verify(
    *,
    archive: Url = None,
    damaged: Annotated[
        float, Parameter(help="Share of damaged files in % that is to be excluded; 0 hashes all.")
    ] = 0.1,
    confidence: Annotated[float, Parameter(help="With this confidence in %.")] = 95.0,
    seed: Annotated[int | None, Parameter(help="Seed of the sample; a new one every time without.")] = None,
    trust: TrustFile = None,
    json_: Json = False,
) -> int:
    """Check that the archive holds what its inspections need, and hash a sample that is large enough for a statement.

    With --trust every record has to be signed by the key of its station, and to follow one that is archived or noted as
    deleted.
    Exit codes: 0 nothing is wrong, 1 files are damaged, missing or not trusted, 69 the archive does not answer.

    Examples:
        anisoscope archive verify
        anisoscope archive verify --damaged 0
    """
    import numpy as np

    from anisoscope.base.signature import read_trust
    from anisoscope.inspection.archive import prove

    if not 0.0 <= damaged < 100.0:
        raise UsageError(f"--damaged takes a share from 0 to below 100 %, not {damaged:g}")
    if not 0.0 < confidence < 100.0:
        raise UsageError(f"--confidence lies between 0 and 100 %, not {confidence:g}")
    store = _store(archive)
    with progress("archive", quiet=json_) as advance:
        trusted = None if trust is None else read_trust(trust)
        rng = np.random.default_rng(seed)
        found = prove(store, damaged / 100.0, confidence / 100.0, rng, advance, trusted)
    lines = [
        f"{'missing' if name in found.missing else 'damaged'}: {name}"
        for name in (*found.missing, *found.damaged)
    ]
    lines += [
        *found.unread,
        *found.distrust,
        f"{_counted(found.inspections, 'inspection')}, {_counted(found.objects, 'file')}, {found.hashed} hashed: "
        + ("none damaged; " if found.intact else "")
        + f"at most {100.0 * found.share:.2g} % of the files are damaged ({confidence:g} % confidence)",
    ]
    answer(found, map(plain, lines), json_=json_)
    return 0 if found.intact else 1


@app.command
def retain(
    *,
    rule: list[str] | None = None,
    archive: Url = None,
    dry_run: Flag = False,
    json_: Json = False,
) -> int:
    """Delete inspections from the archive whose time is over by the rules; what no rule fits stays.

    Inspections under legal hold stay. Every deletion leaves a note under `deleted/` with the whole manifest, the rule,
    the time and the user.

    Args:
        rule: WHAT:DAYS, such as FAIL:3650, PASS:365, product=lid,PASS:90, all:ever; the first that fits counts.
        dry_run: Only print what would be deleted; nothing is.

    Examples:
        anisoscope archive retain --rule FAIL:3650 --rule PASS:365 --dry-run
    """
    from anisoscope.inspection.archive import parse_rule
    from anisoscope.operations.archiving import retain as retained

    if not rule:
        raise UsageError("no rule: name one or more with --rule WHAT:DAYS, such as --rule PASS:365")
    rules = [parse_rule(text) for text in rule]
    with progress("archive", quiet=json_) as advance:
        found = retained(_store(archive), rules, dry_run=dry_run, on_progress=advance)
    lines = [
        f"{one.inspection.name} ({one.inspection.verdict}): "
        + (
            f"stays, held: {one.held}"
            if one.held is not None
            else "would be deleted"
            if dry_run
            else "deleted"
        )
        + f"; rule {one.rule}"
        for one in found.due
    ]
    lines.append(
        f"{len(found.due)} inspections are due, {len(found.deleted)} deleted; "
        f"{found.objects} files of {found.bytes / 1e6:.1f} MB cleared away"
    )
    answer(found, map(plain, lines), json_=json_)
    return 0


@app.command
def hold(
    inspection: Which,
    /,
    *,
    reason: Annotated[str | None, Parameter(help="Reason of the hold, or of its end.")] = None,
    release: Annotated[bool, Parameter(negative="", help="End the hold.")] = False,
    archive: Url = None,
) -> int:
    """Put inspections under legal hold, so that no rule deletes them, or end that; a note of either stays.

    Examples:
        anisoscope archive hold A-0001 --reason "claim 2026-17"
        anisoscope archive hold A-0001 --release --reason "claim 2026-17 is settled"
    """
    from anisoscope.operations.archiving import hold as held

    for name, was in held(_store(archive), inspection, reason or "", release=release).items():
        write_line(f"{name}: {'held' if not release else 'no longer held' if was else 'was not held'}")
    return 0
