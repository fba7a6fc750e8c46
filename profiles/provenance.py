"""Provenance of height maps, stored in the comment of their file.

Design and seed of a synthetic map, its defects and the editing steps of any map are one line of JSON in the comment of
an x3p, gsf, npz or exr file. Other formats have no place for it.
"""

import json
from pathlib import Path
from typing import Any

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.heightmap import HeightMap

MARK = "anisoscope made "
SUFFIXES = (".x3p", ".npz", ".gsf", ".exr")
MAX_COMMENT_BYTES = 60_000
LISTS = ("defects", "history")
ENTRIES = ("made", *LISTS)


def keeps_provenance(path: Path | str) -> bool:
    """Whether the format of a file has a place for the provenance."""
    return Path(path).suffix.lower() in SUFFIXES


def with_comment(surface: HeightMap, path: Path | str) -> HeightMap:
    """The map with its provenance as the comment that a writer puts into the file.

    A comment that the map has already is part of it. A map without provenance is returned as it is.

    Raises:
        HeightMapError: the provenance is too long for a file that has a place for it.
    """
    entries = {key: surface.origin[key] for key in ENTRIES if surface.origin.get(key)}
    if not entries or not keeps_provenance(path):
        return surface
    if comment := str(surface.origin.get("comment", "")):
        entries["comment"] = comment
    text = MARK + json.dumps(entries, allow_nan=False)
    if len(text.encode()) > MAX_COMMENT_BYTES:
        raise HeightMapError(
            f"{Path(path).name}: the list of defects and editing steps is too long to be kept "
            f"({len(text)} bytes, at most {MAX_COMMENT_BYTES}); add fewer to one map"
        )
    return surface.with_height(surface.height_um, comment=text)


def provenance_of(origin: dict[str, Any]) -> dict[str, Any]:
    """The origin of a map just read, with provenance taken out of the comment of its file."""
    text = str(origin.get("comment", ""))
    if not text.startswith(MARK):
        return origin
    try:
        entries: object = json.loads(text[len(MARK) :])
    except ValueError:
        return origin
    if not isinstance(entries, dict) or not all(isinstance(entries.get(key, []), list) for key in LISTS):
        return origin
    rest = {key: value for key, value in origin.items() if key != "comment"}
    kept = {key: entries[key] for key in (*ENTRIES, "comment") if key in entries}
    return {**rest, **kept}
