"""Log kernel compilation to stderr, and remove stale compiled kernels.

Kernels are compiled once per machine. Numba caches them next to their source file and compiles them again when that
file changes. Kernels also inline those of other files, so that a cached one can be stale: such ones are removed here.
"""

import logging
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from numba import njit
from numba.core import event

NO_REFERENCE_COUNT: dict[str, Any] = {"_nrt": False}
"""Option of kernels that allocate nothing: references to the arrays given are not counted."""

Function = TypeVar("Function", bound=Callable[..., Any])


def jit_kernel(**options: Any) -> Callable[[Function], Function]:  # noqa: ANN401 - numba's options
    """`numba.njit`, cached on disk, for kernels that allocate nothing: what they are given they only borrow.

    Otherwise numba counts references to every array at every call and return, and threads that share arrays wait
    for each other's counts, which is most of the time of short kernels.
    """
    decorator: Callable[[Function], Function] = njit(cache=True, **options, **NO_REFERENCE_COUNT)
    return decorator


_log = logging.getLogger("anisoscope.compiled")


class _Announcer(event.Listener):
    """Logs the first compilation of a kernel of ours; kernels that are read from disk compile nothing."""

    def __init__(self) -> None:
        self.listening = False
        self.announced = False

    def on_start(self, event: Any) -> None:  # noqa: ANN401 - numba has no types
        dispatcher = event.data["dispatcher"]
        if not self.announced and dispatcher.py_func.__module__.startswith("anisoscope."):
            self.announced = True
            _log.warning("compiling kernels for this machine: once, up to a minute; they are kept on disk")

    def on_end(self, event: Any) -> None:  # noqa: ANN401 - numba has no types
        """No action."""


_announcer = _Announcer()
_looked_through: set[Path] = set()


def log_compilation(source: str) -> None:
    """Log a warning at the first compilation from now on, and remove stale kernels next to a source file.

    Asking twice changes nothing.
    """
    folder = Path(source).parent
    if folder not in _looked_through:
        _looked_through.add(folder)
        remove_stale(folder)
    if not _announcer.listening:
        _announcer.listening = True
        event.register("numba:compile", _announcer)  # type: ignore[no-untyped-call]


def remove_stale(folder: Path) -> None:
    """Forget kernels that were compiled before the newest source file of a folder was written.

    Where the folder cannot be written, numba keeps its kernels elsewhere; sources do not change there one by one.
    """
    with suppress(OSError):
        newest = max((source.stat().st_mtime for source in folder.glob("*.py")), default=0.0)
        for index in (folder / "__pycache__").glob("*.nbi"):
            if index.stat().st_mtime < newest:
                index.unlink(missing_ok=True)
