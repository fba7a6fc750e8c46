"""Provenance of synthetic surfaces, stored in the file of the height map.

The origin of a synthetic map (design, defects, seeds) is written as one line of JSON: into the comment of an x3p
file, or into the archive comment of an npz file. Other formats have no place for it.
"""

import json
import zipfile
from pathlib import Path

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap

MARK = "anisoscope made "
SUFFIXES = (".x3p", ".npz")
MAX_COMMENT_BYTES = 60_000
ENTRIES = ("made", "defects")


def write_with_provenance(surface: HeightMap, path: Path | str) -> bool:
    """Write a map with ``made`` and ``defects`` of its origin; False if the format has no place for them.

    Raises:
        HeightMapError: unknown extension, the file cannot be written, or the origin is too long.
    """
    path = Path(path)
    entries = {key: surface.origin[key] for key in ENTRIES if key in surface.origin}
    text = MARK + json.dumps(entries, allow_nan=False)
    suffix = path.suffix.lower()
    if suffix in SUFFIXES and len(text.encode()) > MAX_COMMENT_BYTES:
        raise HeightMapError(f"{path.name}: the list of defects is too long to be kept; add fewer to one map")
    write_height_map(surface.with_height(surface.height_um, comment=text), path)
    if suffix == ".npz":
        with zipfile.ZipFile(path, "a") as archive:
            archive.comment = text.encode()
    return suffix in SUFFIXES


def with_provenance(surface: HeightMap, path: Path | str) -> HeightMap:
    """Add ``made`` and ``defects`` from a file to the origin of the map just read from it."""
    path = Path(path)
    text = str(surface.origin.get("comment", ""))
    if zipfile.is_zipfile(path) and not text.startswith(MARK):
        with zipfile.ZipFile(path) as archive:
            text = archive.comment.decode(errors="replace")
    if not text.startswith(MARK):
        return surface
    try:
        entries: object = json.loads(text[len(MARK) :])
    except ValueError:
        return surface
    if not isinstance(entries, dict) or not isinstance(entries.get("defects", []), list):
        return surface
    return surface.with_height(surface.height_um, **{key: entries[key] for key in ENTRIES if key in entries})
