"""Locks between processes. A lock ends with its process at the latest, whatever becomes of it."""

import contextlib
import errno
import hashlib
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

POLL_S = 0.01


@contextlib.contextmanager
def locked(path: Path, *, waits: bool = False) -> Iterator[None]:
    """Lock a file or folder that is there for exclusive work.

    Args:
        path: the file or folder; a file that others replace as a whole is locked by its folder.
        waits: wait until others have ended, rather than fail.

    Raises:
        BlockingIOError: somebody else has the lock.
        OSError: there is no such file or folder, or it cannot be opened.
    """
    descriptor, lock = _open(path)
    try:
        while True:
            try:
                lock(descriptor)
                break
            except (BlockingIOError, PermissionError) as taken:  # what POSIX says, and what Windows says
                if not waits:
                    raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN)) from taken
            time.sleep(POLL_S)
        yield
    finally:
        os.close(descriptor)


def _open(path: Path) -> tuple[int, Callable[[int], None]]:
    """A descriptor and what locks it: of the path itself; on Windows, which locks files only, of one elsewhere."""
    try:
        import fcntl  # noqa: PLC0415 - POSIX only
    except ImportError:
        import msvcrt  # noqa: PLC0415 - Windows only

        if not path.exists():
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT)) from None
        name = hashlib.sha256(os.path.normcase(path.resolve()).encode()).hexdigest()[:24]
        place = Path(tempfile.gettempdir()) / f"anisoscope-{name}.lock"
        take = cast("Any", msvcrt)  # whose types exist on Windows only
        return os.open(place, os.O_RDWR | os.O_CREAT), lambda one: take.locking(one, take.LK_NBLCK, 1)
    how = os.O_RDONLY | os.O_NONBLOCK  # a pipe would wait for its writer
    return os.open(path, how), lambda one: fcntl.flock(one, fcntl.LOCK_EX | fcntl.LOCK_NB)
