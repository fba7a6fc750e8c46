"""Readable file formats, and the recognition of a file's format."""

import zipfile
from functools import partial
from pathlib import Path

from anisoscope.base.errors import HeightMapError
from anisoscope.base.plugins import Registry
from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.files.checks import refuse
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.library import LIBRARY_FORMATS, read_library
from anisoscope.profiles.files.x3p import ZIP_TROUBLE
from anisoscope.profiles.heightmap import HeightMap

FORMATS = Registry("anisoscope.height_maps", "format of height maps", Format, HeightMapError)
"""Formats with a reader of their own, by name."""
_NUMPY = "npy"
_OF_LIBRARY = tuple(
    Format(
        entry.key,
        entry.name,
        entry.suffixes,
        partial(read_library, key=entry.key),
        entry.signatures,
        channels=True,
        zip_member="index.xml" if entry.key == "plux" else "",
    )
    for entry in LIBRARY_FORMATS
)


def all_formats() -> tuple[Format, ...]:
    """All formats that are read, those of the library behind the others."""
    return (*FORMATS.values(), *_OF_LIBRARY)


def readable() -> str:
    """Every extension that can be read, as a list for people."""
    return ", ".join(suffix for entry in all_formats() for suffix in entry.suffixes)


def _in_zip(path: Path) -> Format | None:
    """The format of a zip file by what is in it."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = [name.replace("\\", "/").rpartition("/")[2].lower() for name in archive.namelist()]
    except ZIP_TROUBLE:
        return None
    return next((entry for entry in all_formats() if entry.is_zip_of(names)), None)


def _by_suffix(suffix: str) -> Format | None:
    return next((entry for entry in all_formats() if suffix in entry.suffixes), None)


def _unknown(path: Path, given: FileScales) -> HeightMap:
    """Read a file of unknown extension if the library recognises its first bytes."""
    try:
        return read_library(path, given)
    except HeightMapError as error:
        if "not recognised" not in str(error):
            raise
    return refuse(
        path.name,
        "format",
        f"unknown extension {path.suffix!r}",
        f"read are {readable()}; the first bytes belong to none of those that can be told by them",
    )


def find_format(path: Path, head: bytes) -> Format:
    """The format by extension, compared with the first bytes; by them alone where the extension is unknown.

    Raises:
        HeightMapError: the extension promises a format, and the content is another one.
    """
    promised = _by_suffix(path.suffix.lower())
    found = next((entry for entry in all_formats() if entry.begins(head)), None)
    is_zip = head.startswith(b"PK")
    if promised is None:
        return (
            found
            or (_in_zip(path) if is_zip else None)
            or Format("unknown", "unknown", (), _unknown, channels=True)
        )
    if promised in _OF_LIBRARY or found is promised:
        return promised
    if is_zip and (promised.zip_member or promised.name == _NUMPY):
        return _in_zip(path) or promised
    if found is not None and promised.units_from_user == "scales" and (found.name == _NUMPY or found.header):
        return found
    if found is None and not promised.signatures and not promised.zip_member:
        return promised
    return refuse(
        path.name,
        "content",
        f"does not look like {path.suffix.lower()} ({promised.title})"
        + (f" but like {found.title}" if found else ""),
        "the file is misnamed, damaged, or of a version that is not read",
    )
