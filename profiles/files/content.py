"""The bytes of a binary file, read by position and never past their end."""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.profiles.files.checks import check_claim, refuse

MAX_BYTES = 2**33
DAMAGED = "the file is truncated or damaged; copy or export it again"


@dataclass(frozen=True)
class Content:
    """All bytes of a file, and its name for messages."""

    name: str
    data: bytes

    def __len__(self) -> int:
        return len(self.data)

    def numbers(self, layout: str, offset: int) -> tuple[Any, ...]:
        """Numbers at an offset, in the notation of :mod:`struct`.

        Raises:
            HeightMapError: the file ends before them.
        """
        if offset < 0 or offset + struct.calcsize(layout) > len(self.data):
            refuse(self.name, "header", f"ends after {len(self.data)} bytes", DAMAGED)
        return struct.unpack_from(layout, self.data, offset)

    def text(self, offset: int, size: int) -> str:
        """Text of at most ``size`` bytes up to a NUL, printable letters only."""
        raw = self.data[offset : offset + size].split(b"\0", 1)[0].decode("latin-1")
        return " ".join("".join(letter if letter.isprintable() else " " for letter in raw).split())

    def grid(self, kind: str, rows: int, cols: int, offset: int) -> npt.NDArray[Any]:
        """A view of (rows, cols) numbers of a numpy type at an offset.

        Raises:
            HeightMapError: the size is implausible, or the file ends before its last number.
        """
        dtype = np.dtype(kind)
        check_claim(self.name, rows, cols, dtype.itemsize, len(self.data) - offset)
        return np.frombuffer(self.data, dtype, rows * cols, offset).reshape(rows, cols)


def check_size(path: Path) -> None:
    """Refuse a file of more than 8 GiB before it is read.

    Raises:
        HeightMapError: it is larger.
        OSError: there is no such file.
    """
    size = path.stat().st_size
    if size > MAX_BYTES:
        refuse(path.name, "size", f"{size} bytes", f"at most {MAX_BYTES} are read; crop the map")


def load_content(path: Path) -> Content:
    """Read a file.

    Raises:
        HeightMapError: it cannot be read, or is larger than 8 GiB.
    """
    try:
        check_size(path)
        return Content(path.name, bounded_bytes(path, MAX_BYTES))
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be read ({error.strerror}); check the path") from None


def scaled(raw: npt.NDArray[Any], factor: float, missing: npt.NDArray[np.bool_] | None = None) -> FloatArray:
    """Heights from the numbers of a file, in an array of their own: times a factor, NaN where missing.

    Args:
        raw: (rows, cols) numbers as stored.
        factor: µm per number.
        missing: (rows, cols), True where the format says that nothing was measured.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        height: FloatArray = raw.astype(np.float64, order="C")
        if factor != 1.0:
            height *= factor
    if missing is not None and missing.any():
        height[missing] = np.nan
    return height
