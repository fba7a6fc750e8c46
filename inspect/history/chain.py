"""How rows hang together: each one's hash covers all its content and the hash of the row before it."""

import hashlib
import json
import struct
from collections.abc import Mapping, Sequence
from typing import Any

START = bytes(32)
"""What the first row has for the hash of the row before it."""
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
    """Numbers as little-endian doubles."""
    return struct.pack(f"<{len(values)}d", *values)


def unpack(data: bytes) -> tuple[float, ...]:
    """The numbers that `pack` took."""
    return struct.unpack(f"<{len(data) // 8}d", data)


def digest_of(labels: str) -> bytes:
    """SHA-256 of a list of labels."""
    return hashlib.sha256(labels.encode()).digest()
