"""Reports in the background: the record is written, the next part may start, and the report follows.

What waits is known from the folders alone: a folder with a record and without a report is one whose report is still to
be written. So nothing is lost with the process; `anisoscope report` writes it later, and so do a batch that is resumed
and a watch that is started again.
"""

import contextlib
import logging
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

from anisoscope.base.errors import AnisoscopeError
from anisoscope.inspection.folder import working_in
from anisoscope.inspection.report_seal import write_report_sealed

WAITING = 2
"""Reports that may wait for the one at work; a further part waits for the first of them, which bounds the memory."""
Wanted = Literal["all", "not-pass", "none"]
"""Parts that get a report by themselves; `anisoscope report` writes that of any other one later."""
_log = logging.getLogger("anisoscope.reports")


def gets_report(wanted: Wanted, verdict: str) -> bool:
    """Whether a part with this verdict gets a report by itself."""
    return wanted == "all" or (wanted == "not-pass" and verdict != "PASS")


@dataclass(frozen=True, eq=False)
class PendingReport:
    """A report that is still to be written.

    Attributes:
        folder: the inspection folder, which has its record.
        make: makes the page, and notes for the user on what it lacks.
        discard: ends what was begun for it; called once it is written, or given up.
    """

    folder: Path
    make: Callable[[], tuple[str, tuple[str, ...]]]
    discard: Callable[[], None] = lambda: None

    def write(self) -> tuple[str, ...]:
        """Write the report; record and verdict are safe, whatever goes wrong here.

        Returns:
            Notes for the user; one that says so where there is no report.
        """
        try:
            with working_in(self.folder):
                page, notes = self.make()
                write_report_sealed(self.folder, page)
        except Exception as error:  # noqa: BLE001 - the verdict is given, and its record written
            _log.debug("report of %s", self.folder, exc_info=True)
            own = isinstance(error, AnisoscopeError | OSError)
            problem = " ".join(str(error).split()) if own else f"{type(error).__name__}: {error}"
            return (f"no report: {problem}; `anisoscope report {self.folder}` writes it",)
        finally:
            self.discard()
        return notes


class Reports:
    """Writes reports one after the other in a thread.

    Leaving the context waits for all of them; after an error or an interruption only for the one at work, and the
    others are given up.

    Args:
        tell: called, in the thread, with each note for the user; without it `finish` returns them.
        wanted: parts whose reports are handed over by who inspects them.
    """

    def __init__(self, tell: Callable[[str], None] | None = None, wanted: Wanted = "all") -> None:
        self.wanted: Wanted = wanted
        self._notes: list[str] = []
        self._tell = tell or self._notes.append
        self._pool = ThreadPoolExecutor(1, "anisoscope reports")
        self._room = threading.Semaphore(1 + WAITING)
        self._handed: deque[tuple[PendingReport, Future[None]]] = deque()

    def add(self, report: PendingReport) -> None:
        """Hand over a report; waits where too many wait already."""
        try:
            self._room.acquire()
            future = self._pool.submit(self._write, report)
        except BaseException:
            report.discard()
            raise
        future.add_done_callback(lambda _: self._room.release())
        self._handed.append((report, future))
        while self._handed[0][1].done() and len(self._handed) > 1:
            self._handed.popleft()

    def _write(self, report: PendingReport) -> None:
        for note in report.write():
            try:
                self._tell(f"{report.folder.name}: {note}")
            except Exception:  # noqa: BLE001 - nobody hears of it; the next report is written all the same
                _log.debug("note on %s", report.folder, exc_info=True)

    def wait(self) -> None:
        """Wait for all reports that were handed over; until then their folders are locked."""
        for _, future in tuple(self._handed):
            future.result()

    def finish(self) -> tuple[str, ...]:
        """Wait for all reports that were handed over; notes for the user since, each after the name of its folder."""
        while self._handed:
            self._handed[0][1].result()
            self._handed.popleft()
        notes, self._notes[:] = tuple(self._notes), []
        return notes

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.ExitStack() as cleanup:
            cleanup.callback(self._give_up)
            if kind is None:
                self.finish()

    def _give_up(self) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)
        for report, future in self._handed:
            if future.cancelled():
                report.discard()
        self._handed.clear()
