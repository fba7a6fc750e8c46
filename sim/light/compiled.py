"""Says when kernels are compiled: once on a machine, then they are read from disk."""

import logging
from typing import Any

from numba.core import event

_log = logging.getLogger("anisoscope.compiled")


class _Announcer(event.Listener):
    """Logs the first compilation of a kernel of ours; kernels that are read from disk compile nothing."""

    def __init__(self) -> None:
        self.listening = False
        self.said = False

    def on_start(self, event: Any) -> None:  # noqa: ANN401 - numba has no types
        dispatcher = event.data["dispatcher"]
        if not self.said and dispatcher.py_func.__module__.startswith("anisoscope."):
            self.said = True
            _log.warning("compiling kernels for this machine: once, up to a minute; they are kept on disk")

    def on_end(self, event: Any) -> None:  # noqa: ANN401 - numba has no types
        """Nothing to say."""


_announcer = _Announcer()


def announce() -> None:
    """Log a warning at the first compilation from now on; asking twice changes nothing."""
    if not _announcer.listening:
        _announcer.listening = True
        event.register("numba:compile", _announcer)  # type: ignore[no-untyped-call]
