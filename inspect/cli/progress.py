"""Progress of a command on standard error: a bar in a terminal, one line for each step without one."""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from anisoscope.base.language import translated
from anisoscope.base.progress import Advance, silent
from anisoscope.cli import log
from anisoscope.cli.tables import console

PATIENCE_S = 2.0
"""What ends earlier prints no lines."""
GAP_S = 1.0
"""Least time between two lines."""


@contextmanager
def progress(label: str, *, quiet: bool = False) -> Iterator[Advance]:
    """Progress of a job on standard error, and in the log file; yields the function that moves it.

    Args:
        label: name of the job, such as the serial number of a part.
        quiet: print nothing, as with --quiet; the log file gets the steps all the same.
    """
    if quiet or log.quiet():
        with _logged(label, silent) as advance:
            yield advance
    elif console(stderr=True).is_terminal:
        with _bar(label) as bar, _logged(label, bar) as advance:
            yield advance
    else:
        lines = Lines(label, PATIENCE_S, GAP_S)
        try:
            with _logged(label, lines) as advance:
                yield advance
        finally:
            lines.close()


class Lines:
    """An `Advance` that prints steps as lines on stderr; steps that are over sooner are left out.

    Args:
        label: name of the job.
        patience_s: time without lines at the start, in s.
        gap_s: least time between two lines, in s.
    """

    def __init__(self, label: str, patience_s: float, gap_s: float) -> None:
        self._label, self._step, self._printed = label, "", ""
        self._gap_s, self._next = gap_s, time.monotonic() + patience_s
        self._lock = threading.Lock()
        self._timer: threading.Timer | None = None

    def __call__(self, doing: str, done: int, total: int) -> None:
        """Print a new step: now, or at the next time at which a line may be printed, if it lasts until then."""
        del done, total
        self._step = doing
        with self._lock:
            waiting = self._timer is not None
        if waiting or doing == self._printed:
            return
        left = self._next - time.monotonic()
        if left <= 0.0:
            self._print()
            return
        with self._lock:
            self._timer = threading.Timer(left, self._print)
            self._timer.daemon = True
            self._timer.start()

    def _print(self) -> None:
        with self._lock:
            self._timer = None
            self._next = time.monotonic() + self._gap_s
            if self._step != self._printed:
                self._printed = self._step
                print(f"{self._label}: {translated(self._step)}", file=sys.stderr, flush=True)  # noqa: T201

    def close(self) -> None:
        """End without a further line."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()


@contextmanager
def _logged(label: str, shown: Advance) -> Iterator[Advance]:
    """An `Advance` that writes new steps into the log file as well."""
    last = ""

    def advance(doing: str, done: int, total: int) -> None:
        nonlocal last
        if doing != last:
            last = doing
            log.PROGRESS.info("%s: %s", label, doing)
        shown(doing, done, total)

    yield advance


@contextmanager
def _bar(label: str) -> Iterator[Advance]:
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.fields[label]}"),
        BarColumn(),
        TextColumn("{task.description}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console(stderr=True)) as bar:
        task = bar.add_task("", total=None, label=escape(label))

        def advance(doing: str, done: int, total: int) -> None:
            bar.update(task, description=escape(translated(doing)), completed=done, total=total)

        yield advance
