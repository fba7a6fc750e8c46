"""The adapter to SurfaceTopography (MIT licence), which reads the formats that we do not.

The library runs in the guarded process only, and what comes back passes the same checks as our own readers'
results. Which of its formats were tried on real files stands in ``docs/height-maps.md``.
"""

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy.typing as npt

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.files.checks import check_packing, checked_map, refuse
from anisoscope.profiles.files.content import Content, load_content, scaled
from anisoscope.profiles.files.decoder_process import decode
from anisoscope.profiles.files.units import stated_micrometres_per, stated_or_given_pixel
from anisoscope.profiles.heightmap import INTENSITY, HeightMap

PROBES = ("di", "jpk", "ps", "wsxm", "ezd", "ibw", "mdt", "mi")
"""Formats of scanning probe microscopes."""
KEYENCE_MAGICS = (b"VK3_", b"VK4_")
KEYENCE_MEMBER = "Vk4File"
KEYENCE_LIGHT = 24
KEYENCE_PALETTE_END = 7 * 4 + 768
"""Place of the light picture in the table of places, and of its numbers behind its header (OSTI report 1419732)."""


@dataclass(frozen=True)
class LibraryFormat:
    """A format of the library: what it is called there and here, and its extensions."""

    key: str
    name: str
    suffixes: tuple[str, ...]
    signatures: tuple[tuple[int, bytes], ...] = ()


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
    LibraryFormat("di", "Nanoscope spm, di, 000 to 999", (".spm", ".di"), ((0, b"\\*File list"),)),
    LibraryFormat("jpk", "JPK", (".jpk",)),
    LibraryFormat("ps", "Park Systems TIFF", ()),
    LibraryFormat("wsxm", "WSxM", (".stp", ".top", ".cur")),
    LibraryFormat("qep", "Mahr MarWin qep", (".qep",)),
    LibraryFormat("ezd", "Nanosurf ezd/nid", (".ezd", ".nid")),
    LibraryFormat("ibw", "Igor ibw", (".ibw",)),
    LibraryFormat("mdt", "NT-MDT mdt", (".mdt",)),
    LibraryFormat("mi", "Molecular Imaging mi", (".mi",)),
)


def read_library(path: Path | str, given: FileScales | None = None, key: str | None = None) -> HeightMap:
    """Read a file through SurfaceTopography.

    Args:
        path: the file.
        given: the pixel size, only for a file that states none, and the channel.
        key: the library's name of the format; None lets it look at the first bytes.

    Returns:
        (rows, cols) heights in µm of the channel that was chosen, or that the library takes first; the other channels
        are named in ``origin["other_channels"]``. The library, as Gwyddion, turns every format so that the first row is
        the top of the picture (``origin["first_row"]``).

    Raises:
        HeightMapError: not readable, no height map, not scaled in lengths, or implausible.
    """
    path = Path(path)
    answer, raw = decode("library", path, format=key, channel=given.channel if given else None)
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
    layers = {}
    try:
        if (values := _intensity(path, origin["format"])) is not None:
            layers[INTENSITY] = values
    except HeightMapError as error:  # the heights are read without it
        origin["not_read"] = [f"intensity ({str(error).removeprefix(f'{name}: ')})"]
    if layers and layers[INTENSITY].shape != raw.shape:
        rows, cols = layers.pop(INTENSITY).shape
        origin["not_read"] = [f"intensity of {rows} × {cols} points"]
    return checked_map(
        name,
        scaled(raw, factor),
        pixel,
        origin,
        stage_height=True,
        layers=layers,
        probe=origin["format"] in PROBES,
    )


def _intensity(path: Path, kind: str) -> npt.NDArray[Any] | None:
    """(rows, cols) intensities in the order of the file; None where it has none."""
    if kind == "datx":
        answer, raw = decode("datx-intensity", path)
        return None if answer.get("none") else raw
    return _keyence_intensity(path) if kind == "vk" else None


def _keyence_intensity(path: Path) -> npt.NDArray[Any] | None:
    """The first light picture of a vk3, vk4, vk6 or vk7 file; the last two hold a vk4 in a zip archive."""
    content = load_content(path)
    if not content.data.startswith(KEYENCE_MAGICS):
        with zipfile.ZipFile(path) as archive:
            info = archive.getinfo(KEYENCE_MEMBER)
            check_packing(path.name, KEYENCE_MEMBER, info.file_size, len(content))
            content = Content(path.name, archive.read(info))
    (start,) = content.numbers("<I", KEYENCE_LIGHT)
    if not start:
        return None
    cols, rows, bits, packed, _size = content.numbers("<5I", start)
    if bits not in (8, 16) or packed:
        refuse(path.name, "picture", f"{bits} bits, compression {packed}", "8 or 16 plain bits are read")
    return content.grid(f"<u{bits // 8}", rows, cols, start + KEYENCE_PALETTE_END)
