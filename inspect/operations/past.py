"""Past inspections: cycle data of machines, proofs, exports, signed bundles, and judging them by another recipe."""

import json
import math
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path

from anisoscope.base.atomic_write import appearing
from anisoscope.base.errors import RecordError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.base.signature import read_trust, signer_in_use
from anisoscope.history.aqdef import MARK, TIME, AqdefFile, description_lines
from anisoscope.history.aqdef import value_lines as aqdef_values
from anisoscope.history.comparing import record_of
from anisoscope.history.covariates import CycleData
from anisoscope.history.evidence import RowsCompared, compare_rows, last_missing
from anisoscope.history.export import (
    characteristics,
    csv_lines,
    json_lines,
    junit_lines,
    unit_of,
    value_lines,
    write_lines,
)
from anisoscope.history.filters import Filters
from anisoscope.history.heads import MOST_COMPARED, HeadsVerified, cut, gone, rows_to_head, verify_heads
from anisoscope.history.rows import Row, seal_of
from anisoscope.history.store import History, find
from anisoscope.inspection.archive import archived_verdicts, noted_heads
from anisoscope.inspection.archive_store import open_store
from anisoscope.inspection.folder import files_in
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.past_pages import thumbnail_of
from anisoscope.parameters.exporting import ExportFiles
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.workers import Workers
from anisoscope.quality.capability import specification
from anisoscope.quality.readings import history_readings, read_readings
from anisoscope.record.schema import RECORD_NAME, REPORT_NAME
from anisoscope.report.past_pages import MOST_PICTURES, FlippedPart, RiskLine
from anisoscope.report.past_pages import write_whatif_page as write_page
from anisoscope.study.statistics import Rate
from anisoscope.study.whatif import VERDICTS, Costs, WhatIf, what_if


@dataclass(frozen=True)
class CyclesAdded:
    """Cycle data that were added to a history, those that it had, and its place."""

    added: int
    known: int
    history: str


def add_cycles(history: History, cycles: Sequence[CycleData]) -> CyclesAdded:
    """Add cycle data of machines, those of `read_cycles`, to a history; all of them or none.

    Raises:
        HistoryError: the history cannot be written.
    """
    added = history.add_covariates(cycles)
    return CyclesAdded(added, len(cycles) - added, str(history.address))


def read_cycles(files: Sequence[Path | str], machine: str = "") -> list[CycleData]:
    """Cycle data of machines in CSV files.

    Args:
        files: with a column time or serial; all other columns are numbers.
        machine: put before the names of the numbers.

    Raises:
        UsageError: a file cannot be read, or a line of it says neither a time nor a serial number.
    """
    return [one for path in files for one in _cycles(Path(path), machine.strip())]


def _cycles(path: Path, machine: str) -> list[CycleData]:
    readings = read_readings(path)
    others = sorted(set(readings.texts) - {"time", "serial"})
    if others or not readings.numbers:
        what = f"the column {others[0]} holds words" if others else "there is no column of numbers"
        raise UsageError(f"{path}: {what}: cycle data are time or serial, and numbers")
    news = []
    for place in range(len(readings)):
        said, serial = (
            readings.texts[name][place] if name in readings.texts else "" for name in ("time", "serial")
        )
        at = readings.moment(place)
        if (said and at is None) or not (said or serial):
            wrong = (
                f"the time {said[:40]!r} is none, write 2026-11-01T14:30"
                if said
                else "neither time nor serial"
            )
            raise UsageError(f"{path}, entry {place + 1}: {wrong}")
        numbers = {
            f"{machine} {name}".strip(): float(column[place])
            for name, column in readings.numbers.items()
            if not math.isnan(column[place])
        }
        if numbers:
            news.append(CycleData(at=at, serial=serial or None, source=path.name, numbers=numbers))
    return news


@dataclass(frozen=True)
class HistoryVerified:
    """Outcome of checking a history.

    Attributes:
        intact: nothing is damaged.
        inspections: number of inspections.
        damage: a line for each.
        head: hash of the last inspection; one that was noted shows later that nothing was cut.
        disposition_head, covariate_head: the same of decisions and cycle data.
        signed: the signed heads.
        rows: the rows compared with their records.
        remarks: what a clock that was set back signed, a line each: no damage, for a clock may have been wrong before.
    """

    intact: bool
    inspections: int
    damage: tuple[str, ...]
    head: str
    disposition_head: str
    covariate_head: str
    signed: HeadsVerified
    rows: RowsCompared
    remarks: tuple[str, ...] = ()


def verify_history(
    history: History,
    *,
    heads: Sequence[str] = (),
    trust: Path | None = None,
    authorities: Path | None = None,
    archive: str | None = None,
) -> HistoryVerified:
    """Compute the hash of every row again, compare rows with records within reach, and check the signed heads.

    Where the key of the station is at hand, the last head and record that it signed have to be there.

    Args:
        history: open.
        heads: hashes that were noted earlier and have to be in it, 64 hexadecimal digits each.
        trust: file of keys that have to have signed.
        authorities: certificates (PEM) of authorities whose time stamps count.
        archive: where stations noted which head they signed last; rows whose folder is gone are compared with it.

    Raises:
        ArchiveError: the archive does not answer.
        UsageError: a head that is none.
        HistoryError, ConfigError: the history or a file cannot be read.
    """
    for one in heads:
        if len(one) != 64 or set(one.lower()) - set("0123456789abcdef"):
            raise UsageError(
                f"--head takes the 64 hexadecimal digits that this command prints, not {one[:80]!r}"
            )
    damage = [str(one) for one in history.verify_chain()]
    trusted = None if trust is None else read_trust(trust)
    signed = verify_heads(history, trusted, authorities)
    store = None if archive is None else open_store(archive)
    kept = None if store is None else archived_verdicts(store)
    rows = compare_rows(history, trusted, signed_since=signed.signed_since, elsewhere=kept)
    damage += (*signed.problems, *rows.problems)
    signer = None if trust is None else signer_in_use()
    if signer is not None:
        damage += (*cut(history, signer), *last_missing(history, signer))
    if store is not None:
        for where, note in noted_heads(store, str(history.address)):
            damage += gone(history, where, note)
    damage += [
        f"nothing has the head {one[:12].lower()}… that was noted: the history was cut or rewritten since"
        for one in heads
        if not history.holds(one)
    ]
    count = history.count()
    if count == 0:
        damage.append("the history holds no inspection: there is nothing to verify")
    ends = history.head(), history.disposition_head(), history.covariate_head()
    return HistoryVerified(
        not damage, count, tuple(damage), *ends, signed, rows, (*signed.remarks, *rows.remarks)
    )


@by_keywords(files=ExportFiles)
def export_history(history: History, filters: Filters | None = None, *, files: ExportFiles) -> int:
    """Write past inspections to files; how many.

    Args:
        history: open.
        filters: which inspections; all by default.
        files: `ExportFiles`.

    Raises:
        HistoryError: the history cannot be read.
    """
    csv, values, json, junit = files.csv, files.values, files.json, files.junit
    with history.selection(filters or Filters()) as selected:
        if csv is not None:
            write_lines(csv, csv_lines(selected.decided(), selected.labels()))
        if values is not None:
            write_lines(values, value_lines(selected.decided()))
        if json is not None:
            write_lines(json, json_lines(selected.decided()))
        verdicts = selected.verdicts()
        if junit is not None:
            write_lines(junit, junit_lines(verdicts, selected.decided))
    return sum(sum(one.values()) for one in verdicts.values())


def unlike_records(history: History, filters: Filters | None = None) -> list[str]:
    """Inspections whose row is not that of the record in their folder, a line each; of the latest 1000 within reach.

    Args:
        history: open.
        filters: which inspections; all by default.

    Raises:
        HistoryError: the history cannot be read.
    """
    chosen, found = filters or Filters(), list[str]()
    most = MOST_COMPARED if chosen.limit is None else min(chosen.limit, MOST_COMPARED)
    for row in history.rows(replace(chosen, limit=most)):
        if (Path(row.folder) / RECORD_NAME).is_file():
            try:
                record_of(row)
            except RecordError as error:
                found.append(f"inspection {row.id} ({row.serial}): {error}")
    return found


def export_aqdef(place: str | Path, path: Path, filters: Filters | None = None) -> int:
    """Write measured values, limits and catalogues of one product and recipe as AQDEF, the oldest first; how many.

    Args:
        place: history, as for `anisoscope.history.store.open_history`.
        path: ``*.dfq``, or ``*.dfd`` for a description with the values in ``*.dfx`` next to it.
        filters: which inspections; all by default.

    Raises:
        UsageError: another ending, no inspection, or several recipes.
        HistoryError: the history cannot be read.
    """
    if path.suffix.lower() not in (".dfq", ".dfd"):
        raise UsageError(f"--aqdef {path}: name a file *.dfq, or *.dfd for a description and values apart")
    readings = history_readings(place, filters or Filters())
    kinds = sorted(set(readings.column("recipe")))
    if len(kinds) > 1:
        raise UsageError(
            f"{readings.source}: {len(kinds)} recipes ({', '.join(kinds[:3])} …): an AQDEF file holds one, choose it "
            "with --recipe"
        )
    pairs = {}
    numbers = {name: readings.numbers[name] for name in characteristics(readings.numbers)}
    for name in numbers:
        try:
            found = specification(readings, name)
        except UsageError:  # predicted or tolerated differently: no one pair of limits holds
            found = None
        if found is not None:
            pairs[name] = (found.lower, found.upper)
    middle = {
        name: 0.5 * (low + high)
        for name, (low, high) in pairs.items()
        if low is not None and high is not None
    }
    units = {name: unit_of(name) for name in numbers}
    content = AqdefFile(readings.column("product")[0], readings.texts, numbers, pairs, middle, units)
    if path.suffix.lower() == ".dfq":
        write_lines(path, chain(description_lines(content), aqdef_values(content, _local_time)))
    else:
        values = path.with_suffix(".DFX" if path.suffix.isupper() else ".dfx")
        write_lines(values, chain((MARK,), aqdef_values(content, _local_time)))
        write_lines(path, description_lines(content))
    return len(readings)


def _local_time(moment: str) -> str:
    """A time of the history, UTC, as AQDEF has those of this computer."""
    return f"{datetime.fromisoformat(moment).replace(tzinfo=UTC).astimezone():{TIME}}"


def bundle(history: History, inspection: str, path: Path) -> Row:
    """Write the files of a signed inspection, and the rows from it to a signed head, into a ZIP file.

    docs/verify_bundle.py verifies it without anisoscope.

    Args:
        history: open.
        inspection: serial number, or ``id:7``.
        path: file to write.

    Raises:
        UsageError: there is no such inspection.
        RecordError: its record is not signed, or it was changed.
        HistoryError: no signed head covers it.
    """
    row = find(history, inspection)
    folder = Path(row.folder)
    state = verify(folder)
    if not state.intact or state.signed_by is None or seal_of(folder) != row.seal:
        wrong = "its record is not signed" if state.intact and state.signed_by is None else "was changed"
        raise RecordError(
            f"{folder}: {wrong}: a bundle would prove nothing; `anisoscope verify {folder}` says more"
        )
    record_of(row)  # which says the same as the row
    rows, head = rows_to_head(history, row.id)
    with (
        appearing(path) as stream,
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as packed,
    ):
        for file in sorted(files_in(folder)):
            packed.write(folder / file, file)
        packed.writestr("history.json", json.dumps({"rows": rows, "head": head}, indent=1))
    return row


def whatif(
    history: History,
    recipe: Path | str,
    filters: Filters | None = None,
    *,
    costs: Costs | None = None,
    workers: Workers | None = None,
    html: Path | None = None,
    on_progress: Advance = silent,
) -> WhatIf:
    """Judge past inspections by another recipe: verdicts that change, escapes, false rejects and their cost.

    Args:
        history: open; it and the folders stay as they are.
        recipe: the other recipe; its golden parts are those next to it.
        filters: which inspections; all by default.
        costs: what wrong verdicts cost.
        workers: processes; one by default.
        html: page to write, with pictures of the parts whose verdict changes.
        on_progress: called with the work being done, steps done and steps in all.

    Raises:
        UsageError: no inspection is selected.
        RecipeError, HeightMapError, CalibrationError: the recipe, or its golden parts.
        SweepError: the processes end again and again.
    """
    rows = history.rows(filters or Filters())
    decided = {
        key: one[-1].decision for key, one in history.dispositions_of([row.id for row in rows]).items() if one
    }
    used = Workers(1) if workers is None else workers
    found = what_if(Path(recipe), rows, decided, used, costs, on_progress)
    if html is not None:
        write_whatif_page(html, found, {row.id: row for row in rows})
    return found


def write_whatif_page(path: Path, found: WhatIf, rows: Mapping[int, Row]) -> None:
    """Write the page of a what-if, with pictures of the parts whose verdict changes.

    Args:
        path: file to write.
        found: the what-if.
        rows: of the history, by id.
    """
    parts = []
    for number, one in enumerate(found.flipped):
        report = Path(one.folder) / REPORT_NAME
        parts.append(
            FlippedPart(
                one.serial,
                one.before,
                str(one.after),
                one.reasons[0] if one.reasons else "",
                one.disposition,
                "frames" if one.judged_from == "frames" else "kept numbers",
                thumbnail_of(rows[one.id]) if number < MOST_PICTURES else None,
                report.as_uri() if report.is_file() else None,
            )
        )
    changes = [(one.before, one.after) for one in found.inspections]
    table = [(before, [changes.count((before, after)) for after in VERDICTS]) for before in VERDICTS]
    write_page(
        path,
        f"What if: {len(found.flipped)} of {len(found.inspections)} verdicts change",
        [("recipe", f"{found.product}: {Path(found.recipe).name}"), ("inspections", judged_text(found))],
        VERDICTS,
        table,
        [RiskLine(*one) for one in risk_texts(found)],
        parts,
        [(one.serial, one.reasons[0]) for one in found.unjudged],
    )


def judged_text(found: WhatIf) -> str:
    """Number of inspections, and what they were judged from, in words."""
    kept, frames = found.count("kept"), found.count("frames")
    words = [f"{len(found.inspections)}"]
    words += [f"{kept} judged from kept numbers"] if kept else []
    words += [f"{frames} from frames"] if frames else []
    words += [f"{len(found.unjudged)} could not be judged"] if found.unjudged else []
    why = next((one.frames_because for one in found.inspections if one.frames_because), None)
    return ", ".join(words) + (f" ({why})" if why else "")


def risk_texts(found: WhatIf) -> list[tuple[str, str, str]]:
    """Escapes, false rejects and cost in words: name, then and now."""
    then, now = found.before, found.after
    if not then.escapes.of + then.false_rejects.of:
        return [
            ("escapes, false rejects and cost", *2 * ("unknown: no reviewer has decided about these parts",))
        ]
    lines = [
        ("escapes: bad parts that PASS", _rate_text(then.escapes), _rate_text(now.escapes)),
        (
            "false rejects: good parts that FAIL",
            _rate_text(then.false_rejects),
            _rate_text(now.false_rejects),
        ),
    ]
    if then.cost is not None and now.cost is not None:
        lines.append(("cost of both", f"{then.cost:g}", f"{now.cost:g}"))
    return lines


def _rate_text(one: Rate) -> str:
    if not one.of:
        return "no such part was decided by a reviewer"
    share, low, high = (f"{100.0 * value:.2g}" for value in (one.value, one.low, one.high))
    return f"{one.count} of {one.of}: {share} % (95 %: {low} to {high} %)"
