"""Read opd files, and texts, of Wyko (Veeco, Bruker) interferometers.

Two bytes, then a directory of 24-byte entries (name, type, length, attribute), the first of which is the
directory itself; the blocks follow in its order. Heights are an array block of (columns, rows): each column
from the bottom of the picture up; times Wavelength nm over Mult. Pixel_size is mm, and Aspect times it along
y. An array "Image" of bytes is the intensity. Structure as in Gwyddion's ``opdfile.c`` and SurfaceTopography's
``IO/OPD.py`` (MIT licence). Types other than arrays and plain numbers are passed over by their length.
"""

import re
from dataclasses import dataclass
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.files.cells import grid_of, number_of, numbers_of, text_of
from anisoscope.profiles.files.checks import check_claim, checked_map, refuse
from anisoscope.profiles.files.content import DAMAGED, Content, load_content, scaled
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.units import stated_or_given_pixel
from anisoscope.profiles.heightmap import INTENSITY, HeightMap

WYKO_TEXT = re.compile(r"\A\W*Wyko ASCII Data File Format\s+\d+\s+(?P<nanometres>\d+)")
HEADER_LINES = 60
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


def read_opd(path: Path | str, given: FileScales | None = None) -> HeightMap:
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


def read_wyko_text(path: Path, given: FileScales) -> HeightMap:
    """Read a "Wyko ASCII Data File".

    Blocks by name as in an opd file, then one line for each x, from the bottom of the picture up, in wavelengths over
    ``Mult`` or in nm, as the second number of the first line says.

    Args:
        path: the file.
        given: the pixel size, only for a file that states none.

    Raises:
        HeightMapError: header and data do not fit each other, or the heights are implausible.
    """
    name, lines = path.name, text_of(path).splitlines()
    blocks: dict[str, str] = {}
    begin = None
    for k, line in enumerate(islice(lines, HEADER_LINES)):
        cells = [cell.strip() for cell in line.split("\t")]
        if cells[0] in ("RAW_DATA", "RAW DATA", "OPD"):
            begin = k + 1
            break
        if len(cells) > 1:
            blocks[cells[0]] = cells[-1]
    if begin is None:
        refuse(name, "header", "no RAW_DATA", "export the heights of the map")

    def number(key: str, default: float | None = None) -> float:
        if key not in blocks and default is None:
            refuse(name, "header", f"no {key}", DAMAGED)
        value = number_of(name, 1, blocks[key]) if key in blocks else float(default or 0.0)
        if not (np.isfinite(value) and value > 0.0):
            refuse(name, key, f"{value:g}", "a positive number is expected")
        return value

    cols, rows = int(number("X Size")), int(number("Y Size"))
    across = numbers_of(name, begin + 1, lines[begin : begin + cols])
    found = WYKO_TEXT.match(lines[0])
    in_nm = found is not None and found["nanometres"] == "1"
    factor = 1e-3 * (1.0 if in_nm else number("Wavelength") / number("Mult", 1.0))
    pixel_um = number("Pixel_size") * 1e3 if "Pixel_size" in blocks else None
    stated = None if pixel_um is None else (pixel_um * number("Aspect", 1.0), pixel_um)
    pixel = stated_or_given_pixel(name, stated, given.pixel_um)
    origin = {"format": "Wyko text", "instrument": {"manufacturer": "Wyko"}}
    return checked_map(name, scaled(grid_of(name, across, cols, rows).T, factor), pixel, origin)


OPD = Format("opd", "Wyko opd", (".opd",), read_opd, ((2, b"Directory\0"),), place=8)
TEXT = Format("wyko-text", "Wyko text", (), read_wyko_text, header=WYKO_TEXT, place=16)
