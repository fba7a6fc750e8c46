"""Errors that nothing foresaw: the traceback goes to a file, one line names it."""

import contextlib
from collections.abc import Callable
from importlib.metadata import version
from typing import TypeVar

from anisoscope.base.errors import AnisoscopeError, UsageError

Found = TypeVar("Found")


def crash_line(error: Exception, during: str) -> str:
    """Write the traceback of an error to a new file in the folder for temporary files; one line names both.

    Args:
        error: the error.
        during: what was being done: a command line, a folder.
    """
    import tempfile  # noqa: PLC0415 - errors are rare
    import traceback  # noqa: PLC0415 - errors are rare

    lines = [during, f"version {version('anisoscope')}", "", "".join(traceback.format_exception(error))]
    try:
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", prefix="anisoscope-crash-", suffix=".log", delete=False
        ) as file:
            file.write("\n".join(lines))
        where = f"the details are in {file.name}; report it with that file"
    except OSError:
        where = "run the command again with --debug, and report it with what that prints"
    return f"internal error ({type(error).__name__}: {error}): this is no verdict; {where}"


def as_foreseen(error: Exception, during: str) -> AnisoscopeError:
    """An error itself if it is one of ours; else one whose text is that of `crash_line`, so that the next item begins.

    Args:
        error: the error.
        during: what was being done: a slot, a folder.
    """
    if isinstance(error, AnisoscopeError):
        return error
    if isinstance(error, RuntimeError) and str(error).startswith("Symlink loop from "):  # of Path.resolve
        return UsageError(f"{str(error).removeprefix('Symlink loop from ')}: a link that leads to itself")
    return AnisoscopeError(crash_line(error, during))


class Steady:
    """Steps of a service that ends by a signal only: what one raises is a line, said once, and the next one begins.

    Args:
        service: its name, for the file of an error that nothing foresaw.
        say: called with the line; where it raises, nobody hears, and the service goes on.
    """

    def __init__(self, service: str, say: Callable[[str], object]) -> None:
        self._service, self._say, self._last = service, say, ""

    def __call__(self, step: Callable[[], Found], otherwise: Found) -> Found:
        """What a step returns, or the other value where it failed."""
        try:
            found = step()
        except Exception as error:  # noqa: BLE001 - a signal ends a service, no error does
            kind = f"{type(error).__name__}: {error}"
            if kind != self._last:
                self._last = kind
                with contextlib.suppress(Exception):
                    self._say(" ".join(str(as_foreseen(error, self._service)).split()))
            return otherwise
        self._last = ""
        return found
