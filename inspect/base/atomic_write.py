"""Atomic writing: a file appears whole or not at all."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from anisoscope.base.errors import RecordError


@contextlib.contextmanager
def appearing(path: Path) -> Iterator[BinaryIO]:
    """Open a file for writing that appears when the context is left without an error, whole and on disk.

    Its mode is that of any new file, as the umask says.

    Raises:
        RecordError: the folder cannot be written.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        with partial.open("wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        partial.replace(path)
    except OSError as error:
        raise RecordError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file so that a reader, or a crash, finds the old one or the new one.

    Raises:
        RecordError: the folder cannot be written.
    """
    with appearing(path) as stream:
        stream.write(data)


def write_text(path: Path, text: str) -> None:
    """The same for text, in UTF-8; its errors are those of :func:`write_bytes`."""
    write_bytes(path, text.encode())
