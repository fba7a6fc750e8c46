"""Tensor files: the container of RGL's ``.bsdf`` files. Named arrays, little-endian, one after another.

Layout as read by Mitsuba 3 and by RGL's loader (rgl-epfl/brdf-loader): ``tensor_file`` and a zero, version (1, 0),
number of fields; per field the length of its name, the name, dimensions, type, offset of the data and shape; then the
data.
"""

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import UsageError

MAGIC = b"tensor_file\0"
_TYPES: dict[int, npt.DTypeLike] = {
    1: "<u1", 2: "<i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<u8", 8: "<i8", 9: "<f2", 10: "<f4", 11: "<f8",
}  # fmt: skip
_CODES = {np.dtype(name): code for code, name in _TYPES.items()}
_ALIGNMENT = 8
_MOST_FIELDS = 1000


def write_tensors(fields: Mapping[str, npt.NDArray[Any]], path: Path) -> None:
    """Write arrays under their names.

    Raises:
        RecordError: the file cannot be written.
    """
    arrays = {
        name: np.ascontiguousarray(array, array.dtype.newbyteorder("<")) for name, array in fields.items()
    }
    size = len(MAGIC) + 6 + sum(2 + len(n.encode()) + 2 + 1 + 8 + 8 * a.ndim for n, a in arrays.items())
    head, body = [MAGIC, bytes((1, 0)), struct.pack("<I", len(arrays))], []
    for name, array in arrays.items():
        gap = -size % _ALIGNMENT
        head.append(struct.pack("<H", len(name.encode())) + name.encode())
        head.append(struct.pack("<HBQ", array.ndim, _CODES[array.dtype], size + gap))
        head.append(struct.pack(f"<{array.ndim}Q", *array.shape))
        body += [bytes(gap), array.tobytes()]
        size += gap + array.nbytes
    write_bytes(path, b"".join(head + body))


def read_tensors(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Read all arrays of a tensor file.

    Raises:
        UsageError: it cannot be read, is none, or is damaged.
    """
    try:
        data = path.read_bytes()
    except OSError as problem:
        raise UsageError(f"cannot read {path}: {problem.strerror or problem}") from problem
    if not data.startswith(MAGIC):
        raise UsageError(f"{path}: no tensor file: it does not begin with 'tensor_file'")
    try:
        return _fields(data)
    except (struct.error, ValueError, KeyError, UnicodeDecodeError) as problem:
        raise UsageError(f"{path}: damaged or cut off: copy it again ({problem})") from problem


def _fields(data: bytes) -> dict[str, npt.NDArray[Any]]:
    at = len(MAGIC)
    if data[at] != 1:
        raise ValueError(f"version {data[at]}, known is 1")
    (count,) = struct.unpack_from("<I", data, at + 2)
    if count > _MOST_FIELDS:
        raise ValueError(f"{count} fields")
    at += 6
    found = {}
    for _ in range(count):
        (length,) = struct.unpack_from("<H", data, at)
        name = data[at + 2 : at + 2 + length].decode()
        at += 2 + length
        dimensions, code, offset = struct.unpack_from("<HBQ", data, at)
        at += 11
        shape = struct.unpack_from(f"<{dimensions}Q", data, at)
        at += 8 * dimensions
        if code not in _TYPES:
            raise ValueError(f"field {name} has the unknown type {code}")
        number = 1
        for extent in shape:
            number *= extent
        if offset + number * np.dtype(_TYPES[code]).itemsize > len(data):
            raise ValueError(f"field {name} ends beyond the file")
        found[name] = np.frombuffer(data, _TYPES[code], number, offset).reshape(shape)
    return found
