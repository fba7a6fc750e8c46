"""``anisoscope archive``: finished inspections on a share or in an object store."""

import getpass
import threading
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.cli.history.history import write_line
from anisoscope.cli.history.options import DEFAULT_OUT
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.inspection.archive import Archived, Pushed
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


def _opened(url: str | None) -> "Store":
    from anisoscope.inspection.archive import check_format

    store = _store(url)
    check_format(store)
    return store


def _found(store: "Store", wanted: str) -> "list[Archived]":
    from anisoscope.inspection.archive import archived, fits_name, read_manifest

    names = [name for name in archived(store) if fits_name(name, wanted)]
    if not names:
        raise UsageError(f"{store.url} holds no inspection of {wanted!r}")
    return [read_manifest(store, name) for name in names]


@app.command
def push(
    *places: Path,
    archive: Url = None,
    remove: Annotated[
        bool,
        Parameter(
            name="--remove",
            negative="",
            help="Remove local folders whose files were all read back with right hashes.",
        ),
    ] = False,
    every: Annotated[
        float | None,
        Parameter(help="Go on, every so many seconds, until Ctrl-C; for a station's background."),
    ] = None,
    json_: Json = False,
) -> int:
    """Archive every finished inspection in some folders and below; what is there already is not sent again.

    A folder that is not as it was is not archived. After an interruption, or when the network was away, the same
    command goes on. Exit codes: 0 all are archived, 74 some could not be, 69 the archive does not answer.

    Examples:
        anisoscope archive push inspections --store s3://inspections/line-2
        anisoscope archive push inspections --remove --every 300
    """
    from anisoscope.inspection.archive import push_all
    from anisoscope.inspection.archive_store import ArchiveError

    store, given = _store(archive), list(places) or [DEFAULT_OUT]
    if every is not None and not every > 0.0:
        raise UsageError(f"--every takes seconds above 0, not {every:g}")
    while True:
        lines: list[Any] = []
        try:
            with progress("archive", quiet=json_) as advance:
                done, failed = push_all(store, given, remove=remove, tell=lines.append, advance=advance)
        except ArchiveError as error:
            if every is None:
                raise
            write_line(f"{error}; again in {every:g} s")
            done = failed = 0
        _tell_pushed(lines, done, failed, store.url, json_=json_)
        if every is None:
            return RecordError.exit_code if failed else 0
        threading.Event().wait(every)


def _tell_pushed(lines: "list[Pushed | str]", done: int, failed: int, url: str, *, json_: bool) -> None:
    problems = [one for one in lines if isinstance(one, str)]
    pushed = [one for one in lines if not isinstance(one, str)]
    new = [one for one in pushed if one.new]
    sent = sum(one.sent_bytes for one in pushed)
    removed = sum(one.removed for one in pushed)
    if json_:
        print_json(
            {"archived": done, "new": len(new), "failed": problems, "sent_bytes": sent, "removed": removed}
        )
        return
    for one in problems:
        write_line(one)
    words = f"{_counted(done, 'inspection')} in {url}, {len(new)} of them new, {sent / 1e6:.1f} MB sent"
    write_line(
        words
        + (f", {_counted(removed, 'local folder')} removed" if removed else "")
        + (f", {failed} refused" if failed else "")
    )


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
    from anisoscope.inspection.archive import pull as fetched

    store = _opened(archive)
    folders = []
    with progress("archive", quiet=json_) as advance:
        wanted = _found(store, inspection)
        for number, one in enumerate(wanted):
            advance(one.name, number, len(wanted))
            folders.append(str(fetched(store, one, out)))
    if json_:
        print_json({"folders": folders})
    else:
        for folder in folders:
            write_line(folder)
    return 0


@app.command(name="ls")
def list_(
    inspection: Annotated[str | None, Parameter(help="Serial number or folder; all without.")] = None,
    /,
    *,
    archive: Url = None,
    json_: Json = False,
) -> int:
    """List archived inspections.

    Examples:
        anisoscope archive ls
        anisoscope archive ls A-0001
    """
    from anisoscope.inspection.archive import archived, fits_name, manifests

    store = _opened(archive)
    names = [name for name in archived(store) if inspection is None or fits_name(name, inspection)]
    with progress("archive", quiet=json_) as advance:
        found = list(manifests(store, names, advance))
    if json_:
        print_json(
            {
                "archive": store.url,
                "inspections": [one.model_dump(mode="json", exclude={"files"}) for one in found],
            }
        )
        return 0
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
    json_: Json = False,
) -> int:
    """Check that the archive holds what its inspections need, and hash a sample that is large enough for a statement.

    Exit codes: 0 nothing is wrong, 1 files are damaged or missing, 69 the archive does not answer.

    Examples:
        anisoscope archive verify
        anisoscope archive verify --damaged 0
    """
    import numpy as np

    from anisoscope.inspection.archive import prove

    if not 0.0 <= damaged < 100.0:
        raise UsageError(f"--damaged takes a share from 0 to below 100 %, not {damaged:g}")
    if not 0.0 < confidence < 100.0:
        raise UsageError(f"--confidence lies between 0 and 100 %, not {confidence:g}")
    store = _store(archive)
    with progress("archive", quiet=json_) as advance:
        found = prove(store, damaged / 100.0, confidence / 100.0, np.random.default_rng(seed), advance)
    if json_:
        print_json(found)
        return 0 if found.intact else 1
    for name in (*found.missing, *found.damaged):
        write_line(f"{'missing' if name in found.missing else 'damaged'}: {name}")
    for line in found.unread:
        write_line(line)
    write_line(
        f"{_counted(found.inspections, 'inspection')}, {_counted(found.objects, 'file')}, {found.hashed} hashed: "
        + ("none damaged; " if found.intact else "")
        + f"at most {100.0 * found.share:.2g} % of the files are damaged ({confidence:g} % confidence)"
    )
    return 0 if found.intact else 1


@app.command
def retain(
    *,
    rule: Annotated[
        list[str] | None,
        Parameter(
            help="WHAT:DAYS, such as FAIL:3650, PASS:365, product=lid,PASS:90, all:ever; the first that fits counts."
        ),
    ] = None,
    archive: Url = None,
    dry_run: Annotated[
        bool, Parameter(negative="", help="Only print what would be deleted; nothing is.")
    ] = False,
    json_: Json = False,
) -> int:
    """Delete inspections from the archive whose time is over by the rules; what no rule fits stays.

    Inspections under legal hold stay. Every deletion leaves a note under `deleted/` with the whole manifest, the rule,
    the time and the user.

    Examples:
        anisoscope archive retain --rule FAIL:3650 --rule PASS:365 --dry-run
    """
    from anisoscope.inspection.archive import check_clock, clear, due, let_go, parse_rule

    if not rule:
        raise UsageError("no rule: name one or more with --rule WHAT:DAYS, such as --rule PASS:365")
    rules, store, now = [parse_rule(text) for text in rule], _opened(archive), datetime.now(UTC)
    if not dry_run:
        check_clock(store, now)
    deleted, objects, size = [], 0, 0
    with progress("archive", quiet=json_) as advance:
        found = due(store, rules, now, advance)
        for one in found:
            if not dry_run and one.held is None:
                let_go(store, one, getpass.getuser(), now)
                deleted.append(one.inspection.name)
        if not dry_run:
            objects, size = clear(store, now, advance)
    if json_:
        lines = [{"name": one.inspection.name, "rule": one.rule, "held": one.held} for one in found]
        print_json({"due": lines, "deleted": deleted, "objects": objects, "bytes": size, "dry_run": dry_run})
        return 0
    for one in found:
        what = (
            f"stays, held: {one.held}"
            if one.held is not None
            else "would be deleted"
            if dry_run
            else "deleted"
        )
        write_line(f"{one.inspection.name} ({one.inspection.verdict}): {what}; rule {one.rule}")
    write_line(
        f"{len(found)} inspections are due, {len(deleted)} deleted; {objects} files of {size / 1e6:.1f} MB cleared away"
    )
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
    from anisoscope.inspection.archive import hold as held
    from anisoscope.inspection.archive import release as released

    if not (reason or "").strip():
        raise UsageError(f"a legal hold {'ends' if release else 'begins'} for a reason: --reason TEXT")
    store = _opened(archive)
    for one in _found(store, inspection):
        if not release:
            held(store, one, str(reason), getpass.getuser())
            write_line(f"{one.name}: held")
        else:
            was = released(store, one, str(reason), getpass.getuser())
            write_line(f"{one.name}: {'no longer held' if was else 'was not held'}")
    return 0
