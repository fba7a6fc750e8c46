"""A format of height maps that is read: an object that an entry point of ``anisoscope.height_maps`` names."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from anisoscope.profiles.files.units import Given
from anisoscope.profiles.heightmap import HeightMap


@dataclass(frozen=True)
class Format:
    """A format that can be read.

    Attributes:
        name: that of its entry point.
        title: what it is called.
        suffixes: its extensions.
        read: its reader; it gets the file, and what the user stated of units.
        signatures: (position, bytes) by which a file is known, one of them.
        zip_member: name of a file, or its extension, by which a zip archive is known to be of this format; "" for no
            archive.
        units_from_user: what the user may state: "scales" (pixel and units of x, y, z), "counts" (pixel and height of a
            count), or "" where the file states its own units.
        place: in lists; the same place is sorted by name.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    read: Callable[[Path, Given], HeightMap]
    signatures: tuple[tuple[int, bytes], ...] = ()
    zip_member: str = ""
    units_from_user: str = ""
    place: int = 100

    def begins(self, head: bytes) -> bool:
        """Whether the first bytes of a file are those of this format."""
        return any(head[at : at + len(sign)] == sign for at, sign in self.signatures)

    def is_zip_of(self, members: Iterable[str]) -> bool:
        """Whether a zip archive with members of these names, in small letters, is of this format."""
        own = self.zip_member
        return bool(own) and any(name == own or (own[0] == "." and name.endswith(own)) for name in members)
