"""Verdict and findings of a record in the operator's words, for terminals, pages and controllers."""

from typing import TYPE_CHECKING, Any

from anisoscope.base.language import message, translated
from anisoscope.record.schema import CauseRecord, ConclusionRecord, Record

if TYPE_CHECKING:  # a server hands these functions to the process that inspects, and does without the rest
    from anisoscope.inspection.run import Inspected
    from anisoscope.kinds.command_output import CommandOutput


def conclusion_lines(conclusion: ConclusionRecord) -> tuple[str, str]:
    """The verdict in plain words: what was found, and what to do next."""
    return translated(conclusion.finding), f"{message('What to do next')}: {translated(conclusion.action)}"


def explained(record: Record) -> list[str]:
    """What is wrong and where, in a line each; empty for a part as it should be."""
    lines = []
    diagnosis = record.diagnosis
    if diagnosis is not None and diagnosis.causes:
        lines.append(message("cause: {cause}", cause=diagnosis.says))
        lines += [_cause_line(cause) for cause in diagnosis.causes if cause.tie and cause.cause != "nothing"]
        lines += (
            [message("what would distinguish them: {what}", what=diagnosis.tells)] if diagnosis.tells else []
        )
    return [*lines, *map(translated, _summary(record).lines)]


def _summary(record: Record) -> "CommandOutput":
    from anisoscope.kinds.parts import reporting
    from anisoscope.kinds.registry import kind_named

    return reporting(kind_named(record.kind)).summary(record)


def _cause_line(cause: CauseRecord) -> str:
    from anisoscope.report.wording import cause_text, weight_text

    return f"  {cause_text(cause)}, {message('weight')} {weight_text(cause.weight)}"


def content_of(inspected: "Inspected", notes: tuple[str, ...] = ()) -> dict[str, Any]:
    """A finished inspection as the keys of its JSON.

    Args:
        inspected: the inspection.
        notes: on its report, besides its own.
    """
    record, diagnosis = inspected.record, inspected.record.diagnosis
    same = ("kind", "verdict", "d2", "dof", "p_value", "conformance_probability")
    common = {name: getattr(record, name) for name in same} | {
        "finding": None if record.conclusion is None else record.conclusion.finding,
        "action": None if record.conclusion is None else record.conclusion.action,
        "reasons": list(record.reasons),
        "budget": [row.model_dump() for row in record.budget],
        "diagnosis": [] if diagnosis is None else [cause.model_dump() for cause in diagnosis.causes],
    }
    common |= {name: getattr(diagnosis, name, None) for name in ("says", "tells", "unexplained_p")}
    last = {
        "origin": record.origin,
        "rounds": record.rounds,
        "dropped_markers": [list(pose.dropped) for pose in record.poses],
        "calibrations": [one.model_dump() for one in record.calibrations],
        "folder": str(inspected.folder),
        "report": str(inspected.report),
        "notes": [*inspected.notes, *notes],
    }
    own = _summary(record).content
    return common | own | common | last  # a kind adds keys, and overwrites none
