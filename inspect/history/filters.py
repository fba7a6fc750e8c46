"""Which inspections of a history are meant."""

from dataclasses import dataclass
from datetime import datetime


@dataclass(frozen=True)
class Filters:
    """All that is given must hold; texts are compared as a whole, letter by letter.

    Attributes:
        since: not earlier than this; with a time zone.
        until: earlier than this; with a time zone.
        lot, cavity, product, station, operator, serial, verdict: equal to this.
        recipe: identity of a recipe as rows bear it, or the first digits of its SHA-256 (four or more).
        limit: at most so many, the latest ones.
    """

    since: datetime | None = None
    until: datetime | None = None
    lot: str | None = None
    cavity: str | None = None
    product: str | None = None
    recipe: str | None = None
    station: str | None = None
    operator: str | None = None
    serial: str | None = None
    verdict: str | None = None
    limit: int | None = None
