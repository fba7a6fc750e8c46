"""A format of reflectance files that is read: an object that an entry point of ``anisoscope.bsdf_files`` names."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from anisoscope.bsdf.reflectance import Reflectance


@dataclass(frozen=True)
class BsdfFile:
    """A format of files that hold a reflectance.

    Attributes:
        name: that of its entry point.
        title: what it is called.
        begins: whether the first 4096 bytes of a file are those of this format.
        read: its reader; it raises `anisoscope.base.errors.UsageError` for a file that is damaged.
        place: in lists, and in the order in which a file is looked at; the same place is sorted by name.
    """

    name: str
    title: str
    begins: Callable[[bytes], bool]
    read: Callable[[Path], Reflectance]
    place: int = 100
