"""Atomic writing: a file appears whole or not at all."""

import contextlib
import os
from pathlib import Path

from anisoscope.base.errors import RecordError


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file so that a reader, or a crash, finds the old one or the new one.

    Raises:
        RecordError: the folder cannot be written.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        with partial.open("wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        partial.replace(path)
    except OSError as error:
        raise RecordError(f"cannot write {path}: {error.strerror}") from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """The same for text, in UTF-8; its errors are those of :func:`write_bytes`."""
    write_bytes(path, text.encode())
