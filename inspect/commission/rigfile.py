"""Put found values into a rig file: line by line where that is possible, so that comments stay."""

import copy
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from anisoscope.atomicfile import write_bytes, write_text
from anisoscope.errors import RigFileError
from anisoscope.rig.rigfile import read_rig

Value = str | int | float
Changes = Mapping[tuple[str, str], Value]

_HEADER = re.compile(r"^\s*\[(?P<name>[^\[\]]+)\]\s*(#.*)?$")
_ANY_HEADER = re.compile(r"^\s*\[")


@dataclass(frozen=True)
class Written:
    """What became of the rig file: the backup of the old one, and whether its comments were kept."""

    backup: Path
    comments_kept: bool


def update_rig_file(path: Path, changes: Changes) -> Written:
    """Change values of a rig file, all or nothing; the old file stays beside it with its date in the name.

    Args:
        path: the rig file.
        changes: new values by (table, key).

    Raises:
        RigFileError: the file cannot be read, or would no longer be a rig file.
        RecordError: it cannot be written.
    """
    read_rig(path)
    before = path.read_bytes()
    text = before.decode("utf-8-sig")
    wanted = _changed(tomllib.loads(text), changes)
    edited = _edited(text, changes)
    kept = edited is not None and tomllib.loads(edited) == wanted
    backup = path.with_name(f"{path.name}.{datetime.now(UTC):%Y%m%dT%H%M%S%f}.bak")
    write_bytes(backup, before)
    write_text(path, edited if edited is not None and kept else _dumped(wanted))
    try:
        read_rig(path)
    except RigFileError:
        write_bytes(path, before)
        raise
    return Written(backup, kept)


def _dumped(tables: dict[str, Any]) -> str:
    import tomli_w  # noqa: PLC0415

    return tomli_w.dumps(tables)


def _changed(tables: dict[str, Any], changes: Changes) -> dict[str, Any]:
    found = copy.deepcopy(tables)
    for (table, key), value in changes.items():
        found.setdefault(table, {})[key] = value
    return found


def _edited(text: str, changes: Changes) -> str | None:
    """The text with changed values; None where it is written in a way that this does not understand."""
    lines = text.splitlines(keepends=True)
    for (table, key), value in changes.items():
        block = _block(lines, table)
        if block is None:
            return None
        shown = _shown(value)
        pattern = re.compile(rf"^(\s*{re.escape(key)}\s*=\s*)([^#\n\r]*?)(\s*(#[^\n\r]*)?)(\r?\n|$)")
        for number in block:
            if match := pattern.match(lines[number]):
                lines[number] = f"{match[1]}{shown}{match[3]}{match[5]}"
                break
        else:
            end = "\r\n" if "\r\n" in text else "\n"
            lines.insert(block.start, f"{key} = {shown}{end}")
    try:
        edited = "".join(lines)
        tomllib.loads(edited)
    except tomllib.TOMLDecodeError:
        return None
    return edited


def _block(lines: list[str], table: str) -> range | None:
    """The lines of a table without its header."""
    starts = [
        n for n, line in enumerate(lines) if (match := _HEADER.match(line)) and match["name"].strip() == table
    ]
    if len(starts) != 1 or not lines[starts[0]].endswith(("\n", "\r\n")):
        return None
    first = starts[0] + 1
    end = next((n for n in range(first, len(lines)) if _ANY_HEADER.match(lines[n])), len(lines))
    return range(first, end)


def _shown(value: Value) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    return repr(value)
