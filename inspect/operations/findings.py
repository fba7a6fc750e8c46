"""Verdict and findings of a record in the operator's words, for terminals, pages and controllers."""

from anisoscope.base.language import message, translated
from anisoscope.kinds.parts import reporting
from anisoscope.kinds.registry import kind_named
from anisoscope.record.schema import CauseRecord, ConclusionRecord, Record
from anisoscope.report.wording import cause_text, weight_text


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
    return [*lines, *map(translated, reporting(kind_named(record.kind)).summary(record).lines)]


def _cause_line(cause: CauseRecord) -> str:
    return f"  {cause_text(cause)}, {message('weight')} {weight_text(cause.weight)}"
