"""Files that a user or another program hands over: regular ones only, opened without waiting, read up to a size."""

import contextlib
import errno
import os
import stat
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path

MOST_BYTES = 64 << 20
"""Size of a text file, in bytes; the largest records of inspections take one million."""
MOST_PICTURE_BYTES = 1 << 30
"""Size of the file of a picture, in bytes."""
_NO_WAIT = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
_CHUNK = 1 << 20
NO_FILE = "it is a pipe or a device, not a file"


@contextlib.contextmanager
def regular_file(path: Path, most: int | None = None) -> Iterator[BufferedReader]:
    """Open a file to read; a pipe without a writer, or a device, would block or never end.

    Args:
        path: the file.
        most: largest size in bytes.

    Raises:
        OSError: it cannot be opened, is no regular file, or is larger.
    """
    descriptor = os.open(path, os.O_RDONLY | _NO_WAIT)
    found = os.fstat(descriptor)
    if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
        os.close(descriptor)
        raise OSError(errno.EINVAL, NO_FILE, str(path))
    if most is not None and found.st_size > most:
        os.close(descriptor)
        raise _too_large(path, most)
    with open(descriptor, "rb") as stream:  # noqa: PTH123 - a folder is refused here
        yield stream


def bounded_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """The bytes of a regular file.

    Args:
        path: the file.
        most: largest size in bytes.

    Raises:
        OSError: it cannot be read, is no regular file, or is larger.
    """
    pieces, left = [], most + 1
    with regular_file(path, most) as file:
        ahead = os.fstat(file.fileno()).st_size + 1  # a read takes the memory that it asks for
        while left > 0 and (piece := file.read(min(ahead, left))):
            pieces.append(piece)
            left, ahead = left - len(piece), _CHUNK
    content = b"".join(pieces)
    if len(content) > most:
        raise _too_large(path, most)
    return content


def _too_large(path: Path, most: int) -> OSError:
    return OSError(errno.EFBIG, f"more than {most >> 20} MiB: this is no file of anisoscope's", str(path))


def bounded_text(path: Path, most: int = MOST_BYTES) -> str:
    """The text of a regular file in UTF-8, with line ends as Python has them.

    Raises:
        OSError: as for `bounded_bytes`.
        UnicodeDecodeError: it is not UTF-8.
    """
    return bounded_bytes(path, most).decode("utf-8").replace("\r\n", "\n")
