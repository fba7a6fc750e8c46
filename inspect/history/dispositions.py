"""Dispositions: decisions of a reviewer about an inspection, as rows of their own; the verdict is unchanged."""

from dataclasses import dataclass, field
from datetime import datetime
from typing import Literal, get_args

from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, json_field
from anisoscope.history.rows import storable, utc_text

Decision = Literal["accept", "reject", "rework", "remeasure", "hold"]
DECISIONS: tuple[str, ...] = get_args(Decision)
MAX_COMMENT = 500


@dataclass(frozen=True, kw_only=True)
class Disposition:
    """One decision of a reviewer.

    Attributes:
        id: counts from 1 without a gap.
        inspection: id of the inspection it is about.
        created_at: UTC.
        reviewer: who decided.
        decision: accept, reject, rework, remeasure or hold.
        comment: why, may be empty.
        hash: chains it to the disposition before.
    """

    id: int
    inspection: int = field(metadata=LEFT_OUT)
    created_at: datetime = field(metadata=json_field(by=utc_text))
    reviewer: str
    decision: str
    comment: str
    hash: str = ""


def checked_disposition(reviewer: str, decision: str, comment: str) -> tuple[str, str, str]:
    """Reviewer, decision and comment as they are stored.

    Raises:
        UsageError: nobody decides, or something that is no decision, or the comment is longer than 500 characters.
    """
    if not reviewer.strip():
        raise UsageError("a disposition needs a reviewer: say who decides")
    if decision not in DECISIONS:
        raise UsageError(f"a decision is one of {', '.join(DECISIONS)}, not {decision[:40]!r}")
    if len(comment) > MAX_COMMENT:
        raise UsageError(f"the comment has {len(comment)} characters; {MAX_COMMENT} are kept")
    return storable(reviewer.strip()), decision, storable(comment, MAX_COMMENT)
