"""Signs of life of stations: what each does now, given by the program that holds its rig, read by the fleet page.

A station has one row, which is replaced at every sign; it is no part of the chains. A program that ends in order says
so. One that is killed or cut off from the history is known by its silence, and nothing is guessed about it.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Literal, Self, cast

from anisoscope.base.crash import Steady
from anisoscope.base.printable import check_printable
from anisoscope.history.rows import storable

if TYPE_CHECKING:  # a server gives its first sign in a thread, when its first page is there
    from sqlalchemy import Connection

    from anisoscope.history.store import History

Doing = Literal["idle", "running", "fault", "off"]
State = Literal["idle", "running", "fault", "off", "no sign"]
BEAT_S = 10.0
SILENT_S = 35.0
"""After so long without a sign a station is not called idle or running: three signs have not come."""
MOST_WORDS = 240
_END_S = 5.0


@dataclass(frozen=True)
class Sign:
    """The last sign of a station, by the clock of the database.

    Attributes:
        station: its name.
        doing: what it did then.
        since: when it began to do that.
        seen: when it was given.
        age_s: how long ago that is.
        words: serial number of the part, or what is wrong.
    """

    station: str
    doing: Doing
    since: datetime
    seen: datetime
    age_s: float
    words: str

    def now(self, last: datetime | None = None) -> tuple[State, datetime]:
        """State of the station, and since when; for a silent one, when it was heard of last.

        Args:
            last: when it made its last inspection, which other programs than the one with the signs may have done.
        """
        latest = self.seen if last is None else max(self.seen, last)
        if self.doing == "off" and latest == self.seen:
            return "off", self.since
        if self.doing != "off" and self.age_s <= SILENT_S:
            return self.doing, self.since
        return "no sign", latest


def give_sign(history: "History", station: str, doing: Doing, words: str = "") -> None:
    """Replace the sign of a station.

    Raises:
        HistoryError: the history cannot be written.
    """
    from sqlalchemy import insert, select, update

    from anisoscope.history.schema import stations

    with history.writing() as connection:
        moment = moment_us(connection)
        here = stations.c.station == storable(station)
        before = connection.scalar(select(stations.c.doing).where(here))
        values = {"doing": doing, "words": storable(words, MOST_WORDS), "seen_us": moment}
        values |= {"since_us": moment} if before != doing else {}
        if before is None:
            connection.execute(insert(stations).values(station=storable(station), **values))
        else:
            connection.execute(update(stations).where(here).values(values))


def read_signs(history: "History") -> list[Sign]:
    """The last signs of all stations by name; none of a history of an earlier version.

    Raises:
        HistoryError: the history cannot be read.
    """
    from sqlalchemy import select

    from anisoscope.history import schema
    from anisoscope.history.columns import us_to_datetime

    with history.reading() as connection:
        if schema.version_of(connection) < schema.WITH_STATIONS:
            return []
        moment = moment_us(connection)
        rows = (
            connection.execute(select(schema.stations).order_by(schema.stations.c.station)).mappings().all()
        )
    return [
        Sign(
            row["station"],
            cast("Doing", row["doing"]),
            us_to_datetime(row["since_us"]),
            us_to_datetime(row["seen_us"]),
            1e-6 * (moment - row["seen_us"]),
            row["words"],
        )
        for row in rows
    ]


def moment_us(connection: "Connection") -> int:
    """Microseconds since 1970 by the one clock that all stations of a history share: that of its server."""
    if connection.dialect.name == "postgresql":
        from sqlalchemy import text

        now = text("SELECT CAST(extract(epoch FROM clock_timestamp()) * 1000000 AS bigint)")
        return int(connection.scalar(now) or 0)
    return time.time_ns() // 1000


class Beacon:
    """Gives signs of a station while it is entered: at once when something changes, and every ten seconds.

    A history that cannot be reached holds nothing up: a thread tries again at the next sign.

    Args:
        place: the history; None gives no signs.
        station: name of the station; None gives no signs.
        complain: called with a line when signs begin to fail.
        beat_s: time between two signs, in seconds.

    Raises:
        UsageError: a name that cannot be used.
    """

    def __init__(
        self,
        place: str | Path | None,
        station: str | None,
        complain: Callable[[str], None] = lambda _: None,
        beat_s: float = BEAT_S,
    ) -> None:
        check_printable({"station": station})
        self._place, self._station, self._beat_s = place, station, beat_s
        self._steady = Steady("signs of the station", complain)
        self._now: tuple[Doing, str] = ("idle", "")
        self._woken, self._over = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="signs of the station", daemon=True)

    def __enter__(self) -> Self:
        if self._place is not None and self._station is not None:
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self.show("off")
        if self._thread.ident is not None:
            self._thread.join(_END_S)

    def show(self, doing: Doing, words: str = "") -> None:
        """Say what the station does from now on; waits for nothing."""
        if self._now != (doing, words):
            self._now = (doing, words)
            self._woken.set()

    def _run(self) -> None:
        while True:
            over = self._over.is_set()
            self._woken.clear()
            self._steady(self._give, None)
            if over:
                return
            self._woken.wait(self._beat_s)

    def _give(self) -> None:
        assert self._place is not None
        assert self._station is not None
        from anisoscope.history.store import open_history

        with open_history(self._place) as history:
            give_sign(history, self._station, *self._now)
