"""``anisoscope history``, ``show``, ``compare``: past inspections, their dispositions, covariates, and proofs."""

import contextlib
import dataclasses
import math
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING

from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import UNTRUSTED, Html, Json, Trusted, TrustFile, extra_packages
from anisoscope.cli.tables import answer, console, print_lines, print_table

if TYPE_CHECKING:
    from datetime import datetime

    from anisoscope.history.adding import Added
    from anisoscope.history.comparing import Compared, Comparison
    from anisoscope.history.dispositions import Disposition
    from anisoscope.history.rows import Row
    from anisoscope.operations.past import HistoryVerified
    from anisoscope.record.schema import ConclusionRecord, Record
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.language import decimal, message, translated
from anisoscope.base.notation import number_name, number_text
from anisoscope.cli.history.options import ALL, Place, Selection, filters_of, opened, opened_for
from anisoscope.cli.progress import progress

COLORS = {"PASS": "green", "FAIL": "red", "INCONCLUSIVE": "yellow", "INVALID": "magenta"}
_MAX_CELL = 24
_VERDICT = 3
"""Column of the verdict in the table of inspections."""
_SEVERAL = 5
"""Serial numbers of several inspections that are named."""
_SIDES = ("u ", "deviation ", "tolerance ")


def plain(text: str | None) -> str:
    """Text that cannot steer a terminal: control and formatting characters become visible."""
    if text is None:
        return ""
    return "".join(_visible(one) if unicodedata.category(one) in {"Cc", "Cf", "Cs"} else one for one in text)


def _visible(character: str) -> str:
    return character.encode("unicode_escape").decode()


def write_line(text: str) -> None:
    """Print a line as plain text: markup and control characters have no effect."""
    print_lines(plain(text))


def _local(moment: "datetime", *, zone: bool = False) -> str:
    return moment.astimezone().strftime("%Y-%m-%d %H:%M:%S %Z" if zone else "%Y-%m-%d %H:%M:%S")


def print_history(
    rows: "Sequence[Row]", decided: "Mapping[int, Sequence[Disposition]]", total: int, *, json_: bool
) -> None:
    """A table of inspections, or JSON with ``total``: how many the filters let through."""
    from anisoscope.history.export import with_dispositions

    if json_:
        listed = [with_dispositions(row, decided.get(row.id, ())) for row in rows]
        print_json({"total": total, "inspections": listed})
        return
    if not rows:
        write_line(message("no inspections"))
        return
    from rich.cells import cell_len
    from rich.table import Table
    from rich.text import Text

    table = Table(title=message("Inspections"), title_justify="left", caption_justify="left")
    optional = [
        name for name in ("lot", "cavity", "station", "operator") if any(getattr(r, name) for r in rows)
    ]
    if decided:
        optional.append("disposition")
    lines = [_cells(row, optional, decided.get(row.id, ())) for row in rows]
    for number, name in enumerate(("id", "time", "serial", "verdict", *optional, "product", "why")):
        column = translated(name)
        longest = max(len(column), *(cell_len(line[number]) for line in lines))
        wordy = name in {"product", "why"}
        table.add_column(
            column, no_wrap=not wordy, overflow="fold", min_width=16 if wordy else min(longest, _MAX_CELL)
        )
    for row, line in zip(rows, lines, strict=True):
        color = COLORS.get(row.verdict, "")
        table.add_row(
            *(Text(cell, style=color if number == _VERDICT else "") for number, cell in enumerate(line))
        )
    console().print(table)
    write_line(
        message("{count} inspections", count=total)
        if total == len(rows)
        else message("the last {count} of {total}; --limit 0 for all", count=len(rows), total=total)
    )


def _cells(row: "Row", optional: Sequence[str], decided: "Sequence[Disposition]") -> list[str]:
    details = {name: getattr(row, name, None) for name in optional}
    if "disposition" in details and decided:
        details["disposition"] = translated(decided[-1].decision)
    head = [str(row.id), _local(row.created_at), row.serial, translated(row.verdict)]
    why = translated(row.reasons[0]) if row.reasons else ""
    return [plain(cell) for cell in (*head, *details.values(), row.product, why)]


def print_added(added: "Added", where: str, *, json_: bool) -> None:
    """Print the result of adding folders."""
    if json_:
        print_json({**asdict(added), "history": where})
        return
    for line in added.refused:
        write_line(f"not added: {line}")
    for serial, count in list(added.repeated.items())[:_SEVERAL]:
        write_line(f"{plain(serial)} has {count} inspections with different frames: all of them are kept")
    if len(added.repeated) > _SEVERAL:
        write_line(f"so have {len(added.repeated) - _SEVERAL} more serial numbers")
    write_line(f"{added.added} added, {added.known} there already: {where}")


def print_disposed(row: "Row", disposition: "Disposition", *, json_: bool) -> None:
    """A decision that was written down."""
    if json_:
        print_json({**asdict(disposition), "created_at": disposition.created_at.isoformat()})
    else:
        write_line(
            message(
                "inspection {number} of {serial}, {verdict}: {decision} by {name}",
                number=row.id,
                serial=row.serial,
                verdict=row.verdict,
                decision=disposition.decision,
                name=disposition.reviewer,
            )
        )


def print_verified(found: "HistoryVerified", *, json_: bool) -> None:
    """Print the damage found in a history, and its heads: of inspections, dispositions, cycle data, and signed ones."""
    if json_:
        print_json(found)
        return
    signed = found.signed
    for line in (*found.damage, *(f"note: {one}" for one in found.remarks)):
        write_line(line)
    if found.intact:
        write_line(f"{found.inspections} inspections are as they were written")
    away = f", {found.rows.beyond} are out of reach" if found.rows.beyond else ""
    old = f", {found.rows.not_linked} not linked to the one before" if found.rows.not_linked else ""
    write_line(f"{found.rows.compared} compared with their records{old}{away}")
    if signed.signed_by is None:
        write_line("note: no head is signed")
    else:
        after = f"; {signed.unsigned} came later" if signed.unsigned else ""
        write_line(f"the first {signed.covered} are signed by {signed.signed_by}{after}")
    if signed.stamped_at is not None:
        write_line(f"time stamp: {signed.stamped_at:%Y-%m-%d %H:%M:%S} UTC")
    write_line(f"head: {found.head}")
    write_line(f"head of the dispositions: {found.disposition_head}")
    if found.covariate_head.strip("0"):
        write_line(f"head of the cycle data: {found.covariate_head}")


def print_inspection(row: "Row", decided: "Sequence[Disposition]", *, json_: bool) -> None:
    """Print one inspection with all its data in the history."""
    from anisoscope.history.export import with_dispositions
    from anisoscope.operations.findings import conclusion_lines, explained

    folder, record, conclusion = _folder_state(row)
    if json_:
        words = {} if conclusion is None else {"finding": conclusion.finding, "action": conclusion.action}
        print_json({**with_dispositions(row, decided), **words, "folder_state": folder})
        return
    console().print(f"[bold {COLORS.get(row.verdict, '')}]{plain(translated(row.verdict))}[/]")
    for line in () if conclusion is None else conclusion_lines(conclusion):
        write_line(line)
    for reason in row.reasons:
        write_line(f"  {translated(reason)}")
    for line in () if record is None else explained(record):
        write_line(f"  {line}")
    details = {
        name: getattr(row, name) for name in ("lot", "cavity", "station", "operator") if getattr(row, name)
    }
    facts = {
        "inspection": str(row.id) if row.id else message("in no history"),
        "serial": row.serial,
        "time": _local(row.created_at, zone=True),
        "recipe": row.recipe,
    }
    facts |= {**details, "software": row.software, "folder": f"{row.folder} ({translated(folder)})"}
    for name, value in facts.items():
        write_line(f"{translated(name)}: {value}")
    if row.numbers:
        columns = ["", message("value"), "u", message("deviation"), message("tolerance")]
        print_table(message("Numbers"), columns, _number_rows(row.numbers))
    for one in decided:
        comment = f": {one.comment}" if one.comment else ""
        decision = message("{decision} by {name}", decision=one.decision, name=one.reviewer)
        write_line(f"{_local(one.created_at, zone=True)} {decision}{comment}")


def _folder_state(row: "Row") -> "tuple[str, Record | None, ConclusionRecord | None]":
    """State of the folder, its record, and what that concludes; one of an earlier version is read by its kind."""
    from pathlib import Path

    from anisoscope.base.errors import AnisoscopeError
    from anisoscope.history.comparing import record_of
    from anisoscope.kinds.parts import reporting
    from anisoscope.kinds.registry import kind_named

    if not Path(row.folder).is_dir():
        return "gone", None, None
    try:
        record = record_of(row)
        conclusion = record.conclusion or reporting(kind_named(record.kind)).conclude(record)
    except AnisoscopeError as error:
        return str(error), None, None
    return "its record is the one in the history", record, conclusion


def _number_rows(numbers: Mapping[str, float]) -> list[list[str]]:
    def cell(label: str, form: str) -> str:
        return decimal(form.format(numbers[label])) if label in numbers else ""

    return [
        [
            plain(translated(number_name(label))),
            decimal(number_text(label, value)),
            cell(f"u {label}", "{:.2g}"),
            cell(f"deviation {label}", "{:+.4g}"),
            cell(f"tolerance {label}", "±{:g}"),
        ]
        for label, value in numbers.items()
        if not label.startswith(_SIDES)
    ]


def print_comparison(found: "Comparison", *, json_: bool) -> None:
    """Two inspections side by side."""
    if json_:
        print_json(found)
        return
    names = [f"{row.serial} ({row.id})" for row in (found.first, found.second)]
    table = [
        [message("verdict"), translated(found.first.verdict), translated(found.second.verdict), "", "", ""]
    ]
    table += [_compared_row(one) for one in (*found.contrasts, *found.numbers)]
    columns = ["", *map(plain, names), message("difference"), "u", f"{message('difference')}/u"]
    print_table(message("Compared"), columns, [[plain(cell) for cell in row] for row in table])
    for change in found.changes:
        write_line(f"{translated(change.what)}: {_text_of(change.first)} -> {_text_of(change.second)}")
    if not found.changes:
        write_line(
            message("Recipe, rig, calibrations and software are the same.")
            if not found.notes
            else message("Nothing else differs.")
        )
    for note in found.notes:
        write_line(message("note: {note}", note=note))


def _compared_row(one: "Compared") -> list[str]:
    values = ["" if value is None else number_text(one.label, value) for value in (one.first, one.second)]
    forms = [(one.difference, "+.4g"), (one.u, ".2g"), (one.ratio, "+.1f")]
    values += ["" if value is None else format(value, form) for value, form in forms]
    return [translated(number_name(one.label)), *map(decimal, values)]


def _text_of(text: str | None) -> str:
    return message("nothing") if text is None else text


app = App(name="history", help="List past inspections; add and check them, record reviewers' decisions.")
One = Annotated[str, Parameter(help="Serial number, id, or folder of an inspection.")]
_LIMIT = 50
MOST_ON_PAGE = 10_000
"""Inspections of a page; it takes 3 ms for each to make, and every browser shows it."""


@app.default
def history(
    *,
    which: Selection = ALL,
    limit: Annotated[int, Parameter(help="At most so many, the latest ones; 0 for all.")] = _LIMIT,
    place: Place = None,
    html: Html = None,
    json_: Json = False,
) -> int:
    """List past inspections, the oldest first. All filters that are given must hold.

    The page of --html has thumbnails, findings, links to the reports, and filters of its own.

    Examples:
        anisoscope history --since 7d --verdict FAIL
        anisoscope history --lot L42 --cavity 3 --limit 0
        anisoscope history --since 7d --html week.html
    """
    filters = filters_of(which, limit)
    with opened(place) as found:
        if html is not None and (count := min(limit or math.inf, found.count(filters))) > MOST_ON_PAGE:
            raise UsageError(
                f"{count} inspections are too many for a page (at most {MOST_ON_PAGE}): choose with --since or "
                "--limit, or write a table (anisoscope export)"
            )
        rows = found.rows(filters)
        decided = found.dispositions_of([row.id for row in rows])
        total = found.count(filters) if len(rows) == limit else len(rows)
        place_name = found.address.path.name if found.address.path else found.address
        source = message("history {path}", path=place_name)
    if html is not None:
        from anisoscope.inspection.past_pages import history_page

        with progress("history", quiet=json_) as advance:
            history_page(html, rows, decided, total, source, advance)
    print_history(rows, decided, total, json_=json_)
    return 0


@app.command
def add(
    *folders: Annotated[Path, Parameter(help="Inspection folders, or folders above them.")],
    place: Place = None,
    json_: Json = False,
) -> int:
    """Add finished inspections to the history; those that it has already are skipped.

    Exit codes: 0 all of them are in the history now, 1 a record is damaged, 64 and above nothing could be added.

    Examples:
        anisoscope history add inspections
    """
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
    reviewer: Annotated[str, Parameter(help="Who decides.")],
    comment: Annotated[str, Parameter(name=["--comment", "-m"], help="Why; required.")] = "",
    place: Place = None,
    json_: Json = False,
) -> int:
    """Record a reviewer's decision about an inspection. Its verdict and earlier decisions do not change.

    Examples:
        anisoscope history dispose A-0002 accept --reviewer "R. R." --comment "burrs are allowed here"
    """
    from anisoscope.history.store import find

    if not comment.strip():
        raise UsageError("a decision needs a reason: say why, with --comment TEXT")
    with opened(place) as found:
        row = find(found, inspection)
        disposition = found.dispose(row.id, reviewer=reviewer, decision=decision, comment=comment)
    print_disposed(row, disposition, json_=json_)
    return 0


@app.command
def covariates(
    *files: Annotated[
        Path, Parameter(help="CSV files with a column time or serial; all other columns are numbers.")
    ],
    machine: str = "",
    opcua: str | None = None,
    field: list[str] | None = None,
    cycles: Annotated[int | None, Parameter(help="With --opcua: end after so many cycles.")] = None,
    trusted: Trusted = UNTRUSTED,
    place: Place = None,
    json_: Json = False,
) -> int:
    """Add cycle data of machines to the history, by serial number or time; without files, list the numbers there are.

    A part takes the data with its serial number, else the last ones before its inspection, a day old at most.

    Args:
        machine: Name that is put before the names of the numbers, where there are several machines.
        opcua: Address of a machine with OPC 40077 (EUROMAP 77): add its cycles, until Ctrl-C.
        field: With --opcua: browse name of a field to take, such as CycleTime; may be repeated. Without it all that are
            real numbers.

    Examples:
        anisoscope history covariates cycles.csv
        anisoscope history covariates --opcua opc.tcp://press:4840
        anisoscope history covariates
    """
    if opcua is not None:
        if files:
            raise UsageError("history covariates: give files or --opcua, not both")
        if cycles is not None and cycles < 1:
            raise UsageError("history covariates: --cycles is at least 1")
        with extra_packages("OPC UA", "line"):
            from anisoscope.line.opcua_security import read_security
            from anisoscope.line.press import follow_press
        security = read_security(trusted.certificate, trusted.key, trusted.peers, write_line)
        opening = partial(opened, place, create=True)
        with contextlib.suppress(KeyboardInterrupt):
            follow_press(opcua, opening, write_line, field or [], machine.strip(), cycles, security)
        return 0
    if field or cycles is not None or trusted != UNTRUSTED:
        raise UsageError(
            "history covariates: --field, --cycles, --certificate, --key and --peers belong to --opcua"
        )
    if not files:
        with opened(place) as found:
            numbers = found.covariates().numbers
        known = {
            name: sum(not math.isnan(one) for one in column.tolist()) for name, column in numbers.items()
        }
        if json_:
            print_json({"numbers": known})
        else:
            write_line("no cycle data" if not known else f"{len(known)} numbers of machines")
            for name, count in known.items():
                write_line(f"  {name}: {count}")
        return 0
    from anisoscope.operations.past import add_cycles, read_cycles

    news = read_cycles(files, machine)  # before a history is made
    with opened(place, create=True) as found:
        added = add_cycles(found, news)
    answer(added, [f"{added.added} added, {added.known} there already: {added.history}"], json_=json_)
    return 0


@app.command
def verify(
    *,
    head: list[str] | None = None,
    trust: TrustFile = None,
    authorities: Annotated[Path | None, Parameter(name="--tsa")] = None,
    archive: str | None = None,
    place: Place = None,
    json_: Json = False,
) -> int:
    """Compute the hash of every row again, and name the rows that were changed, exchanged or removed.

    Rows are compared with the records within reach. Signed heads have to be in the history; with --trust there has to
    be one of every station, by its key, and no record may be missing between two others.
    Exit codes: 0 unchanged, 1 changed or not trusted, 64 and above no readable history.

    Args:
        head: A head that was noted earlier: fails if the history was cut or rewritten since. Repeatable.
        archive: Archive: its verdicts, and the heads that stations noted there.
        authorities: Certificates (PEM) of authorities whose time stamps count.

    Examples:
        anisoscope history verify
    """
    from anisoscope.operations.past import verify_history

    with opened(place) as history:
        found = verify_history(
            history, heads=head or (), trust=trust, authorities=authorities, archive=archive
        )
    print_verified(found, json_=json_)
    return 0 if found.intact else 1


@app.command
def sign(*, place: Place = None) -> int:
    """Sign the present end of the history with the key of this station; inspections do so every 100 rows and every day.

    Examples:
        anisoscope history sign
    """
    from anisoscope.base.signature import signer_in_use
    from anisoscope.history.heads import sign_head

    signer = signer_in_use()
    if signer is None:
        raise UsageError(
            "no key signs here: `anisoscope init` makes one, signing_key in anisoscope.toml names one"
        )
    with opened(place) as found:
        new = sign_head(found, signer, always=True)
        write_line(
            f"{found.count()} inspections, {'signed' if new else 'signed before: nothing is new'}: {found.head()}"
        )
    return 0


@app.command
def stamp(
    *,
    url: str | None = None,
    request: Path | None = None,
    response: Path | None = None,
    place: Place = None,
) -> int:
    """Have the time stamped on the last signed head by an authority, directly or by files.

    Args:
        url: Time-stamping authority (RFC 3161), http:// or https://.
        request: Write the request to this file; the answer comes by --response.
        response: Read the answer of an authority from this file.

    Examples:
        anisoscope history stamp --url https://tsa.example.org
        anisoscope history stamp --request head.tsq
        anisoscope history stamp --response head.tsr
    """
    from anisoscope.base.atomic_write import write_bytes
    from anisoscope.history.heads import add_time_stamp, asked_of, time_stamp_request

    if [url, request, response].count(None) != 2:
        raise UsageError("name one of --url, --request FILE and --response FILE")
    with opened(place) as found:
        if request is not None:
            write_bytes(request, time_stamp_request(found))
            write_line(f"{request}: send it to an authority, and give its answer to --response")
            return 0
        answer = b"" if response is None else _content(response)
        if url is not None:
            answer = asked_of(url, time_stamp_request(found))
        moment = add_time_stamp(found, answer)
    write_line(f"the last signed head existed at {moment:%Y-%m-%d %H:%M:%S} UTC, says the authority")
    return 0


def _content(path: Path) -> bytes:
    from anisoscope.base.errors import RecordError

    try:
        return bounded_bytes(path, MOST_PICTURE_BYTES)
    except OSError as error:
        raise RecordError(f"{path} cannot be read: {error.strerror}") from error


def show(
    inspection: One,
    /,
    *,
    place: Place = None,
    html: Html = None,
    refresh: Annotated[
        bool, Parameter(help="With --html: make the report again from the frames, as this version writes it.")
    ] = False,
    json_: Json = False,
) -> int:
    """Show one inspection: verdict, numbers, reviewers' decisions, and whether its folder is unchanged.

    The latest inspection of a part that was inspected several times. `id:7` and `serial:7` distinguish ids from serial
    numbers; a folder needs no history. --html writes its report, made again from the frames if it is missing or was
    changed.

    Examples:
        anisoscope show A-0001
        anisoscope show A-0001 --html A-0001.html
        anisoscope show A-0001 --history inspections/history.sqlite --json
    """
    from anisoscope.history.store import find

    if refresh and html is None:
        raise UsageError("--refresh goes with --html FILE")
    with opened_for(place, inspection) as (found, alone):
        row = find(found, inspection)
        decided = found.dispositions(row.id)
    if alone:
        row = dataclasses.replace(row, id=0)
    origin = None
    if html is not None:
        from anisoscope.inspection.past_pages import inspection_page

        with progress("report", quiet=json_) as advance:
            origin = inspection_page(html, row, refresh=refresh, advance=advance)
    print_inspection(row, decided, json_=json_)
    if origin is not None and not json_:
        write_line(message("report, {origin}: {path}", origin=origin, path=html))
    return 0


def compare(
    first: One, second: One, /, *, place: Place = None, html: Html = None, json_: Json = False
) -> int:
    """Compare two inspections: contrasts side by side, and what changed in recipe, rig, calibrations and software.

    The page of --html has the photographs of both, pose by pose.

    Examples:
        anisoscope compare A-0001 A-0002
        anisoscope compare A-0001 A-0002 --html compared.html
    """
    from anisoscope.history.comparing import compare as compared
    from anisoscope.history.store import find

    with opened_for(place, first, second) as (found, _):
        comparison = compared(find(found, first), find(found, second))
        decided = found.dispositions_of([comparison.first.id, comparison.second.id])
    if html is not None:
        from anisoscope.inspection.past_pages import compared_page

        compared_page(html, comparison, decided)
    print_comparison(comparison, json_=json_)
    return 0
