"""Content of JSON files, with limits of size and depth: a hostile or damaged file is one line, never a crash."""

import errno
import json
from pathlib import Path
from typing import Any

MOST_BYTES = 64 << 20
"""Size in bytes; the largest records of inspections take one million."""
MOST_LEVELS = 64
"""Lists and objects within each other; records have nine."""


def bounded_bytes(path: Path) -> bytes:
    """The bytes of a file of ours, at most 64 MiB.

    Raises:
        OSError: it cannot be read, or is larger.
    """
    with path.open("rb") as file:
        content = file.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise OSError(errno.EFBIG, f"more than {MOST_BYTES >> 20} MiB: this is no file of anisoscope's")
    return content


def parsed_json(text: str | bytes) -> Any:  # noqa: ANN401 - JSON holds anything
    """The content of a JSON text.

    Raises:
        ValueError: it is no JSON, or nested more than 64 deep.
    """
    try:
        found = json.loads(text)
        if not is_deeper(found, MOST_LEVELS):
            return found
    except RecursionError:
        pass
    raise ValueError(f"lists or objects nested more than {MOST_LEVELS} deep")


def is_deeper(content: Any, levels: int) -> bool:  # noqa: ANN401
    """Whether lists and tables are nested more than so many levels deep."""
    level = [content] if isinstance(content, dict | list) else []
    for _ in range(levels):
        level = [
            item
            for value in level
            for item in (value.values() if isinstance(value, dict) else value)
            if isinstance(item, dict | list)
        ]
    return bool(level)
