"""The adapter to SurfaceTopography (MIT licence), which reads the formats that we do not.

The library runs in the guarded process only, and what comes back passes the same checks as our own readers'
results. Which of its formats were tried on real files stands in ``docs/height-maps.md``.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from anisoscope.profiles.files.checks import checked_map
from anisoscope.profiles.files.content import scaled
from anisoscope.profiles.files.decoder_process import decode
from anisoscope.profiles.files.units import Given, stated_micrometres_per, stated_or_given_pixel
from anisoscope.profiles.heightmap import HeightMap


@dataclass(frozen=True)
class LibraryFormat:
    """A format of the library: what it is called there and here, and its extensions."""

    key: str
    name: str
    suffixes: tuple[str, ...]


LIBRARY_FORMATS = (
    LibraryFormat("mnt", "Digital Surf mnt", (".mnt",)),
    LibraryFormat("al3d", "Alicona al3d", (".al3d",)),
    LibraryFormat("plux", "Sensofar plux", (".plux",)),
    LibraryFormat("opdx", "Bruker opdx", (".opdx",)),
    LibraryFormat("datx", "Zygo datx", (".datx",)),
    LibraryFormat("frt", "FRT MicroProf frt", (".frt",)),
    LibraryFormat("vk", "Keyence vk3/4/6/7", (".vk3", ".vk4", ".vk6", ".vk7")),
    LibraryFormat("zon", "Keyence zon", (".zon",)),
    LibraryFormat("zmg", "KLA Zeta zmg", (".zmg",)),
    LibraryFormat("lext", "Olympus lext", (".lext",)),
    LibraryFormat("oir", "Olympus oir", (".oir",)),
    LibraryFormat("poir", "Olympus poir", (".poir",)),
    LibraryFormat("os3d", "OmniSurf3D os3d", (".os3d",)),
    LibraryFormat("bcr", "BCR-STM bcr/bcrf", (".bcr", ".bcrf")),
    LibraryFormat("di", "Nanoscope spm", (".spm",)),
    LibraryFormat("ezd", "Nanosurf ezd/nid", (".ezd", ".nid")),
    LibraryFormat("ibw", "Igor ibw", (".ibw",)),
    LibraryFormat("mdt", "NT-MDT mdt", (".mdt",)),
    LibraryFormat("mi", "Molecular Imaging mi", (".mi",)),
)


def read_library(path: Path | str, given: Given | None = None, key: str | None = None) -> HeightMap:
    """Read a file through SurfaceTopography.

    Args:
        path: the file.
        given: the pixel size, only for a file that states none.
        key: the library's name of the format; None lets it look at the first bytes.

    Returns:
        (rows, cols) heights in µm of the channel that the library takes first; the other channels are named in
        ``origin["other_channels"]``. The library, as Gwyddion, turns every format so that the first row is
        the top of the picture (``origin["first_row"]``).

    Raises:
        HeightMapError: not readable, no height map, not scaled in lengths, or implausible.
    """
    path = Path(path)
    answer, raw = decode("library", path, format=key)
    name = path.name
    factor = stated_micrometres_per(name, f"channel {answer['channel']!r}", answer["unit"])
    stated = answer["pixel"]
    pixel = stated_or_given_pixel(
        name,
        None if stated is None else (stated[0] * factor, stated[1] * factor),
        given.pixel_um if given else None,
    )
    origin: dict[str, Any] = {"format": answer["format"], "reader": answer["reader"], "first_row": "top"}
    for entry in ("channel", "other_channels", "instrument", "date"):
        if answer.get(entry):
            origin[entry] = answer[entry]
    return checked_map(name, scaled(raw, factor), pixel, origin, stage_height=True)
