"""Pages of past inspections: a table that filters itself, two side by side, and all of them under another recipe."""

import base64
import hashlib
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from anisoscope.base.language import message, translated
from anisoscope.base.notation import number_name, number_text, true_minus
from anisoscope.history.comparing import Compared, Comparison
from anisoscope.history.rows import Row
from anisoscope.record.schema import REPORT_NAME, ConclusionRecord
from anisoscope.report.page import template_text, write_page
from anisoscope.report.provenance import when

FOLDERS = re.compile(r"(?<![\w:/\\])(?:[A-Za-z]:)?[\\/](?:[^\\/?&\n]+[\\/])+")
"""Folders of an absolute path, in a text or in the address of a port."""
FAR = 2.0  # standard uncertainties


@dataclass(frozen=True)
class Past:
    """One inspection of the history as a page shows it.

    Attributes:
        row: its row.
        conclusion: finding and action, or None where its record is gone.
        disposition: the last decision of a reviewer, or None.
        thumbnail: the part at the first pose as a data URI, or None.
        has_report: whether the report is in its folder.
    """

    row: Row
    conclusion: ConclusionRecord | None = None
    disposition: str | None = None
    thumbnail: str | None = None
    has_report: bool = False

    @property
    def finding(self) -> str:
        """The finding, or the first reason where no record is left."""
        if self.conclusion is not None:
            return self.conclusion.finding
        return self.row.reasons[0] if self.row.reasons else ""

    @property
    def cause(self) -> str:
        """The cause or outcome from which the conclusion follows, in words."""
        return "" if self.conclusion is None else self.conclusion.follows_from.replace("-", " ")

    @property
    def day(self) -> str:
        """The day of the inspection, local time."""
        return f"{self.row.created_at.astimezone():%Y-%m-%d}"

    @property
    def time(self) -> str:
        """The time of the inspection with its zone, local time."""
        return when(self.row.created_at.isoformat())


@dataclass(frozen=True)
class PosePair:
    """One pose of two inspections: its name, and both photographs as data URIs; None where one has none."""

    name: str
    first: str | None
    second: str | None


def report_link(folder: str, page: Path) -> str:
    """Address of the report in the folder of an inspection, relative to a page."""
    report = Path(folder) / REPORT_NAME
    try:
        return quote(Path(os.path.relpath(report, page.resolve().parent)).as_posix(), safe="/.")
    except ValueError:  # another drive
        return report.as_uri()


def write_history_page(path: Path, inspections: Sequence[Past], total: int, source: str) -> None:
    """Write the table of inspections, atomically; it filters itself without a server.

    Args:
        path: file to write; links to reports are relative to it.
        inspections: the oldest first; the page begins with the latest.
        total: number of inspections that the selection lets through.
        source: of the inspections, in words.

    Raises:
        RecordError: the file cannot be written.
    """
    script = template_text("history.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    content = {
        "title": "Inspections",
        "source": source,
        "total": total,
        "inspections": [
            (one, report_link(one.row.folder, path) if one.has_report else None)
            for one in reversed(inspections)
        ],
        "verdicts": sorted({one.row.verdict for one in inspections}),
        "recipes": sorted({one.row.recipe for one in inspections}),
        "details": [
            name
            for name in ("lot", "cavity", "station", "operator")
            if any(getattr(one.row, name) for one in inspections)
        ],
        "reviewed": any(one.disposition for one in inspections),
        "script": script,
        "script_hash": f"sha256-{digest}",
    }
    write_page(path, "history.html", content, {"typeset": true_minus})


def write_compared_page(
    path: Path, found: Comparison, sides: tuple[Past, Past], pairs: Sequence[PosePair]
) -> None:
    """Write the page of two inspections, atomically.

    Args:
        path: file to write; links to reports are relative to it.
        found: their comparison.
        sides: both inspections.
        pairs: photographs of their poses.

    Raises:
        RecordError: the file cannot be written.
    """
    both = (found.first, found.second)
    same = both[0].serial == both[1].serial
    names = [f"{one.serial} ({one.id})" if same else one.serial for one in both]
    content = {
        "title": f"{names[1]} against {names[0]}",
        "found": found,
        "names": names,
        "answer": _answer(found, names),
        "changes": [
            (one.what, first, second)
            for one in found.changes
            if (first := _bare(one.first)) != (second := _bare(one.second))
        ],
        "sides": [(one, report_link(one.row.folder, path) if one.has_report else None) for one in sides],
        "pairs": pairs,
        "contrasts": [(true_minus(number_name(one.label)), _cells(one)) for one in found.contrasts],
        "numbers": [(true_minus(number_name(one.label)), _cells(one)) for one in found.numbers],
    }
    write_page(path, "compared.html", content, {"typeset": true_minus})


def _answer(found: Comparison, names: Sequence[str]) -> str:
    """What differs most of what was judged, in a sentence."""
    verdicts = message(
        "{second} is {after}, {first} is {before}.",
        first=names[0],
        second=names[1],
        before=message(found.first.verdict),
        after=message(found.second.verdict),
    )
    most = max(
        (one for one in found.contrasts if one.ratio is not None),
        key=lambda one: abs(one.ratio or 0.0),
        default=None,
    )
    if most is None or most.difference is None or most.u is None:
        return verdicts
    if abs(most.ratio or 0.0) < FAR:
        none = message(
            "No number of the table differs by more than twice its uncertainty; the findings say what else does."
        )
        return f"{verdicts} {none}"
    differs = message(
        "Most different: {name}, by {difference} ± {reach} (k = 2).",
        name=translated(true_minus(number_name(most.label))),
        difference=true_minus(f"{most.difference:+.3g}"),
        reach=f"{2.0 * most.u:.2g}",
    )
    return f"{verdicts} {differs}"


def _bare(value: str | None) -> str:
    """A value with files by their names: pages are passed on, folders of a computer are not."""
    return "–" if value is None else FOLDERS.sub("", value)


def _cells(one: Compared) -> tuple[str, ...]:
    values = ["–" if value is None else number_text(one.label, value) for value in (one.first, one.second)]
    forms = ((one.difference, "+.3g"), (one.u, ".2g"), (one.ratio, "+.1f"))
    values += ["–" if value is None else format(value, form) for value, form in forms]
    return tuple(map(true_minus, values))


MOST_PICTURES = 48


@dataclass(frozen=True)
class FlippedPart:
    """A part whose verdict changes.

    Attributes:
        serial: its serial number.
        before, after: verdicts.
        reason: first reason of the new verdict.
        disposition: the last decision of a reviewer, or None.
        judged_from: "kept" numbers, or "frames".
        picture: at the first pose, as a data URI, or None.
        report: address of its report, or None.
    """

    serial: str
    before: str
    after: str
    reason: str
    disposition: str | None
    judged_from: str
    picture: str | None
    report: str | None


@dataclass(frozen=True)
class RiskLine:
    """A risk before and after, as texts with intervals."""

    name: str
    before: str
    after: str


def write_whatif_page(
    path: Path,
    title: str,
    facts: Sequence[tuple[str, str]],
    verdicts: Sequence[str],
    table: Sequence[tuple[str, Sequence[int]]],
    risks: Sequence[RiskLine],
    parts: Sequence[FlippedPart],
    unjudged: Sequence[tuple[str, str]],
) -> None:
    """Write the page, atomically.

    Args:
        path: file to write.
        title: of the page.
        facts: names and values of what belongs to all.
        verdicts: column names of the table, verdicts by the other recipe.
        table: a line a verdict before, with the numbers of inspections.
        risks: escapes, false rejects, cost.
        parts: whose verdict changes.
        unjudged: serial numbers and reasons of those that could not be judged.

    Raises:
        RecordError: the file cannot be written.
    """
    content = {
        "title": title,
        "facts": facts,
        "verdicts": verdicts,
        "table": table,
        "risks": risks,
        "parts": parts,
        "unjudged": unjudged,
    }
    write_page(path, "whatif.html", content)
