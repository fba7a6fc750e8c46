"""Stops a rig the moment that somebody asks for it, whatever the acquisition is waiting for."""

import threading
from collections.abc import Callable
from types import TracebackType
from typing import Self

from anisoscope.rig.acquisition.interruptions import undisturbed

POLL_S = 0.02
REPEAT_S = 0.1


class Watch:
    """While its context lasts, stops the rig as soon as a cancel or trouble is seen.

    The stop is repeated until the acquisition has ended, because a move may be starting in this moment.

    Args:
        stop: stops all axes; called in the thread of the watch.
        cancel: set by whoever wants the acquisition to end.

    Attributes:
        halted: set once the rig was told to stop; long waits of the acquisition wait for it.
    """

    def __init__(self, stop: Callable[[], object], cancel: threading.Event) -> None:
        self.halted = threading.Event()
        self._stop, self._cancel = stop, cancel
        self._trouble = threading.Event()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._work, name="rig watch", daemon=True)

    def trouble(self) -> None:
        """Stop the rig because something failed; may be called from any thread."""
        self._trouble.set()

    @property
    def wanted(self) -> bool:
        """Whether the acquisition is to end, even if the rig was not told yet."""
        return self._cancel.is_set() or self._trouble.is_set()

    def _work(self) -> None:
        while not self._over.is_set():
            if self._cancel.wait(POLL_S) or self.wanted:
                self.halted.set()
                self._stop()
                self._over.wait(REPEAT_S)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        with undisturbed():
            self._over.set()
            self._thread.join()
