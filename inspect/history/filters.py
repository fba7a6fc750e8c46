"""Selection of inspections in a history, and the moments that bound it as people write them."""

import re
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta

from anisoscope.base.errors import UsageError

MOST_IDS = 5000
"""More would be too many parameters of a statement."""


@dataclass(frozen=True)
class Filters:
    """Conditions that must all hold; texts are compared whole and case-sensitively, moments have a time zone.

    Attributes:
        since: not earlier than 2026-11-01, 2026-11-01T14:30, today, or how long ago: 12h, 7d, 2w.
        until: not later than this; a date includes its day.
        serial: of the part with this serial number.
        product: of this product.
        recipe: by this recipe: as the history shows it, or four or more digits of its SHA-256.
        lot: of this lot.
        cavity: of this cavity.
        verdict: PASS, FAIL, INCONCLUSIVE or INVALID.
        station: of this station.
        operator: of this operator.
        limit: at most so many, the latest ones.
        ids: only those with one of these ids, `MOST_IDS` at most.
    """

    since: datetime | None = None
    until: datetime | None = None
    serial: str | None = None
    product: str | None = None
    recipe: str | None = None
    lot: str | None = None
    cavity: str | None = None
    verdict: str | None = None
    station: str | None = None
    operator: str | None = None
    limit: int | None = None
    ids: tuple[int, ...] | None = None


class _EitherError(ValueError):
    """Both meanings of a date with strokes whose day and month are ambiguous."""


MONTHS = 12
_AGO = re.compile(r"(\d{1,6})\s*([mhdw])")
_NUMBERS = re.compile(r"(\d{1,4})([./-])(\d{1,2})\2(\d{1,4})")
_NAMED = ("%d %b %Y", "%d %B %Y", "%b %d %Y", "%B %d %Y")
_UNITS = {"m": "minutes", "h": "hours", "d": "days", "w": "weeks"}
_FORMS = "2026-11-01, 01.11.2026, 1 Nov 2026, 2026-11-01T14:30, today, yesterday, or how long ago: 90m, 12h, 7d, 2w"


def parse_moment(text: str, option: str, *, now: datetime, at_end: bool = False) -> datetime:
    """A moment, in UTC.

    Args:
        text: a date, a date with a time of day, ``today``, ``yesterday``, or how long ago. Where no zone is said, it is
            that of this computer.
        option: for the message.
        now: the present, with a time zone.
        at_end: a whole day means its end, not its beginning.

    Raises:
        UsageError: it is none of these.
    """
    words = text.strip()
    try:
        ago = _AGO.fullmatch(words)
        if ago is not None:
            return (now - timedelta(**{_UNITS[ago[2]]: int(ago[1])})).astimezone(UTC)
        day = _day(words, now)
        if day is not None:
            return _local(datetime.combine(day + timedelta(days=1 if at_end else 0), time()))
        return _local(datetime.fromisoformat(words))
    except _EitherError as either:
        first, second = either.args
        raise UsageError(f"{option} {words} could be two days: write {first} or {second}") from None
    except (ValueError, OverflowError, OSError):
        raise UsageError(f"{option} takes {_FORMS}, not {text[:40]!r}") from None


def _day(words: str, now: datetime) -> date | None:
    if words in {"today", "yesterday"}:
        return now.astimezone().date() - timedelta(days=1 if words == "yesterday" else 0)
    written = _NUMBERS.fullmatch(words)
    if written is None:
        spaced = " ".join(re.split(r"[\s,.-]+", words))
        for form in _NAMED if spaced[:1].isalnum() and re.search("[a-zA-Z]{3}", spaced) else ():
            with suppress(ValueError):
                return datetime.strptime(spaced, form).astimezone().date()
        return date.fromisoformat(words) if len(words) == len("20261128") and words.isdigit() else None
    first, middle, last = (int(written[part]) for part in (1, 3, 4))
    if len(written[1]) == len("2026"):
        return date(first, middle, last)
    if written[2] == "/" and first != middle and max(first, middle) <= MONTHS:
        raise _EitherError(date(last, first, middle), date(last, middle, first))
    day, month = (middle, first) if written[2] == "/" and middle > MONTHS else (first, middle)
    return date(last, month, day)


def _local(moment: datetime) -> datetime:
    # a moment without a zone is taken for local time
    return moment.astimezone(UTC)
