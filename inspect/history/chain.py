"""Hash chain of the rows: each hash covers all content of its row and the hash of the row before it."""

import hashlib
import json
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

START = bytes(32)
"""What the first row has for the hash of the row before it."""
KEPT, DIGITS = 1e-6, 7
"""Numbers of a row are kept to this share of themselves, and shown with so many digits."""
_SINGLE, _DOUBLE = struct.Struct("<f"), struct.Struct("<d")
INSPECTION_FIELDS = (
    "id",
    "created_us",
    "serial",
    "product",
    "recipe",
    "lot",
    "cavity",
    "station",
    "operator",
    "verdict",
    "reasons",
    "folder",
    "seal",
    "software",
    "labels",
    "numbers",
    "previous",
)
DISPOSITION_FIELDS = ("id", "inspection", "created_us", "reviewer", "decision", "comment", "previous")


def hash_of(kind: str, fields: Sequence[str], row: Mapping[str, Any]) -> bytes:
    """SHA-256 over a row as a JSON list: its kind, then its columns in a fixed order, bytes as hexadecimal digits.

    The hash of the row before is one of the columns. Numbers and texts are told apart, so are nothing and an empty
    text; what two databases return differently (bytes and views of them) is not.
    """
    content = [kind, *(_plain(row[field]) for field in fields)]
    return hashlib.sha256(json.dumps(content, separators=(",", ":")).encode()).digest()


def _plain(value: object) -> object:
    if isinstance(value, bytes | memoryview):
        return {"bytes": bytes(value).hex()}
    return value


def pack(values: Sequence[float]) -> bytes:
    """Numbers, little-endian: single precision where that is exact to `KEPT`, else double.

    An uncertainty is known to two digits; seven are kept of every number. The record in the folder holds all.
    """
    try:
        single = struct.pack(f"<{len(values)}f", *values)
    except OverflowError:
        single = b""
    if single and all(
        one == stored or abs(one - stored) <= KEPT * abs(one)
        for one, stored in zip(values, unpack(single, len(values)), strict=True)
    ):
        return single
    return struct.pack(f"<{len(values)}d", *values)


def unpack(data: bytes, count: int) -> tuple[float, ...]:
    """The numbers that `pack` took; of single precision those that a person would write.

    Args:
        data: what `pack` returned; rows of versions 1 and 2 of the tables are always double.
        count: how many numbers there are.
    """
    if len(data) == 8 * count:
        return struct.unpack(f"<{count}d", data)
    return tuple(float(f"{value:.{DIGITS}g}") for value in struct.unpack(f"<{count}f", data))


def unpack_one(data: bytes, count: int, place: int) -> float:
    """The number at a place, counted from 0, as `unpack` gives it."""
    if len(data) == 8 * count:
        return float(_DOUBLE.unpack_from(data, 8 * place)[0])
    return float(f"{_SINGLE.unpack_from(data, 4 * place)[0]:.{DIGITS}g}")


def unpack_rows(rows: Sequence[bytes], count: int) -> npt.NDArray[np.float64]:
    """The numbers of many rows at once, (rows, count), as `unpack` gives them."""
    found = np.full((len(rows), count), np.nan)
    lengths = np.fromiter(map(len, rows), dtype=np.int64, count=len(rows))
    for size in (4, 8) if count else ():
        at = np.flatnonzero(lengths == size * count)
        block = np.frombuffer(b"".join(rows[k] for k in at.tolist()), dtype=f"<f{size}").reshape(-1, count)
        found[at] = block if size == 8 else _written(block.astype(np.float64))
    return found


def _written(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Numbers to `DIGITS` digits, each the double that is nearest to what would be written."""
    size = np.abs(values)
    usual = (size > 0.0) & np.isfinite(values)
    places = DIGITS - 1 - np.floor(np.log10(np.where(usual, size, 1.0)))
    scale = 10.0 ** np.abs(places)
    with np.errstate(over="ignore", invalid="ignore"):
        rounded = np.where(places >= 0.0, np.round(values * scale) / scale, np.round(values / scale) * scale)
    return np.where(usual, rounded, values)


def digest_of(labels: str) -> bytes:
    """SHA-256 of a list of labels."""
    return hashlib.sha256(labels.encode()).digest()
