"""Read opd files of Wyko (Veeco, Bruker) interferometers.

Two bytes, then a directory of 24-byte entries (name, type, length, attribute), the first of which is the
directory itself; the blocks follow in its order. Heights are an array block of (columns, rows): each column
from the bottom of the picture up; times Wavelength nm over Mult. Pixel_size is mm, and Aspect times it along
y. An array "Image" of bytes is the intensity. Structure as in Gwyddion's ``opdfile.c`` and SurfaceTopography's
``IO/OPD.py`` (MIT licence). Types other than arrays and plain numbers are passed over by their length.
"""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.profiles.files.checks import check_claim, checked_map, refuse
from anisoscope.profiles.files.content import DAMAGED, Content, load_content, scaled
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.units import Given, stated_or_given_pixel
from anisoscope.profiles.heightmap import INTENSITY, HeightMap

ENTRY = "<16shlH"
ENTRY_BYTES = 24
ARRAY = 3
PICTURE = "Image"
HEIGHTS = ("RAW DATA", "RAW_DATA", "OPD", "Raw", "SAMPLE_DATA")
KINDS = {1: "u1", 2: "<i2", 4: "<f4"}
NOT_MEASURED = {2: 32766, 4: 1e38}
NUMBERS = {(6, 2): "<h", (6, 4): "<i", (7, 2): "<h", (7, 4): "<f", (8, 8): "<d", (12, 4): "<i"}
MAX_ENTRIES = 100_000


@dataclass(frozen=True)
class _Block:
    kind: int
    start: int
    length: int


def _blocks(content: Content) -> dict[str, _Block]:
    """The blocks by name; of two with the same name, the first."""
    name, _, length, _ = content.numbers(ENTRY, 2)
    count, rest = divmod(length, ENTRY_BYTES)
    if not name.startswith(b"Directory") or rest or not 1 < count < MAX_ENTRIES:
        refuse(content.name, "directory", f"{length} bytes", "this is no opd file, or it is damaged")
    found: dict[str, _Block] = {}
    start = 2 + length
    for entry in range(1, count):
        offset = 2 + ENTRY_BYTES * entry
        _, kind, size, _ = content.numbers(ENTRY, offset)
        if size > 0:
            found.setdefault(content.text(offset, 16), _Block(kind, start, size))
            start += size
    return found


def _number(content: Content, blocks: dict[str, _Block], key: str) -> float | None:
    """The number in a block, or None where there is no such block."""
    if key not in blocks:
        return None
    block = blocks[key]
    layout = NUMBERS.get((block.kind, block.length))
    if layout is None:
        refuse(content.name, key, f"type {block.kind} with {block.length} bytes", DAMAGED)
    value = float(content.numbers(layout, block.start)[0])
    if not (np.isfinite(value) and value > 0):
        refuse(content.name, key, f"{value:.6g}", "a positive number is expected")
    return value


def _date(content: Content, blocks: dict[str, _Block]) -> str:
    texts = [
        content.text(blocks[key].start, min(blocks[key].length, 40)) if key in blocks else ""
        for key in ("Date", "Time")
    ]
    try:
        return datetime.strptime(" ".join(texts), "%m/%d/%Y %H:%M:%S").isoformat()  # noqa: DTZ007 - no zone
    except ValueError:
        return ""


def read_opd(path: Path | str, given: Given | None = None) -> HeightMap:
    """Read the first height array of an opd file.

    Returns:
        (rows, cols) heights in µm, first row at the bottom of the picture.

    Raises:
        HeightMapError: no heights, no wavelength, damaged, or implausible.
    """
    content = load_content(Path(path))
    name = content.name
    blocks = _blocks(content)
    key = next((key for key in HEIGHTS if key in blocks and blocks[key].kind == ARRAY), None)
    if key is None:
        refuse(name, "height array", "none", f"known names are {', '.join(HEIGHTS)}; export x3p")
    block = blocks[key]
    cols, rows, itemsize = content.numbers("<HHH", block.start)
    if itemsize not in KINDS or 6 + rows * cols * itemsize > block.length:
        refuse(name, key, f"{rows} × {cols} numbers of {itemsize} bytes in {block.length}", DAMAGED)
    check_claim(name, rows, cols, itemsize, len(content) - block.start - 6)
    raw = content.grid(KINDS[itemsize], cols, rows, block.start + 6).T
    missing = raw >= NOT_MEASURED[itemsize] if itemsize in NOT_MEASURED else None
    wavelength_nm = _number(content, blocks, "Wavelength")
    if wavelength_nm is None:
        refuse(name, "Wavelength", "none", "without it the heights have no scale; export x3p")
    factor = wavelength_nm * 1e-3 / (_number(content, blocks, "Mult") or 1.0)
    size_mm, aspect = _number(content, blocks, "Pixel_size"), _number(content, blocks, "Aspect") or 1.0
    stated = None if size_mm is None else (size_mm * 1e3 * aspect, size_mm * 1e3)
    pixel = stated_or_given_pixel(name, stated, given.pixel_um if given else None)
    origin: dict[str, Any] = {"format": "opd", "array": key, "instrument": {"manufacturer": "Wyko"}}
    if date := _date(content, blocks):
        origin["date"] = date
    layers = {}
    picture = blocks.get(PICTURE)
    if picture is not None and picture.kind == ARRAY:
        size = content.numbers("<HHH", picture.start)
        if size == (cols, rows, 1) and picture.length >= 6 + rows * cols:
            layers[INTENSITY] = content.grid("u1", cols, rows, picture.start + 6).T
        else:
            origin["not_read"] = [f"picture of {size[1]} × {size[0]} points, {size[2]} bytes each"]
    return checked_map(name, scaled(raw, factor, missing), pixel, origin, layers=layers)


OPD = Format("opd", "Wyko opd", (".opd",), read_opd, ((2, b"Directory\0"),), place=8)
