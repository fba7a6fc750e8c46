"""A format of height maps that is read: an object that an entry point of ``anisoscope.height_maps`` names."""

import codecs
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.heightmap import HeightMap


def _as_text(head: bytes) -> str:
    """The first bytes of a file as text, where they are text of UTF-16 with its mark, or of one byte a letter."""
    utf_16 = head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return head.decode("utf-16" if utf_16 else "latin-1", "ignore")


@dataclass(frozen=True)
class Format:
    """A format that can be read.

    Attributes:
        name: that of its entry point.
        title: what it is called.
        suffixes: its extensions.
        read: its reader; it gets the file, and what the user stated of units.
        signatures: (position, bytes) by which a file is known, one of them.
        header: what the first bytes of a text of this format hold, whatever its extension.
        zip_member: name of a file, or its extension, by which a zip archive is known to be of this format; "" for no
            archive.
        units_from_user: what the user may state: "scales" (pixel and units of x, y, z), "counts" (pixel and height of a
            count), or "" where the file states its own units.
        channels: whether the user may choose one of several channels.
        place: in lists; the same place is sorted by name.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    read: Callable[[Path, FileScales], HeightMap]
    signatures: tuple[tuple[int, bytes], ...] = ()
    zip_member: str = ""
    units_from_user: str = ""
    channels: bool = False
    header: re.Pattern[str] | None = None
    place: int = 100

    def begins(self, head: bytes) -> bool:
        """Whether the first bytes of a file are those of this format."""
        if self.header is not None and self.header.search(_as_text(head)):
            return True
        return any(head[at : at + len(sign)] == sign for at, sign in self.signatures)

    def is_zip_of(self, members: Iterable[str]) -> bool:
        """Whether a zip archive with members of these names, in small letters, is of this format."""
        own = self.zip_member
        return bool(own) and any(name == own or (own[0] == "." and name.endswith(own)) for name in members)
