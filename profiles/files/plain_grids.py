"""Read files of one header and one block of numbers: NanoFocus nms, TrueMap and GelSight tmd.

nms, of µsurf confocal microscopes, version ``OM_MS_2.0``. Positions and meaning of the fields:
https://github.com/drocheam/musurf-reader, an independent reader of this version. Steps are nanometres there;
SurfaceTopography takes the same numbers for millimetres. Numbers below or above the range that the header names are
points without a height; so are points without intensity, which is a byte for each point after the heights.

tmd, ``Binary TrueMap Data File v2.0``. After 32 bytes of magic come a comment that ends with NUL (24 bytes of TrueMap
v6, a single NUL of GelSight), columns and rows, lengths and offsets in mm, and float32 heights in mm, row after row.
Nothing may follow: a comment of another length than it seems would shift everything.
"""

from pathlib import Path

import numpy as np

from anisoscope.profiles.files.checks import checked_map, refuse
from anisoscope.profiles.files.content import DAMAGED, load_content, scaled
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.units import Given, stated_or_given_pixel
from anisoscope.profiles.heightmap import INTENSITY, HeightMap

HEADER_BYTES = 3468
VERSION = "OM_MS_2.0"


def read_nms(path: Path | str, given: Given | None = None) -> HeightMap:
    """Read an nms file.

    Returns:
        (rows, cols) heights in µm in the order of the file, first row at the top of the picture.

    Raises:
        HeightMapError: another version, damaged, or implausible.
    """
    content = load_content(Path(path))
    name = content.name
    if content.text(32, 9) != VERSION:
        refuse(name, "version", repr(content.text(32, 9)), f"only {VERSION} is known; export x3p")
    kind, dimensions = content.numbers("<BxxxB", 0)
    if (kind, dimensions) != (2, 1):
        refuse(name, "data type", f"{kind}, {dimensions}", "an area of 16-bit numbers is expected")
    low, high, bottom, top = content.numbers("<iidd", 8)
    cols, rows, step_x, step_y = content.numbers("<iidd", 1368)
    if not (0 <= low < high <= 65535 and np.isfinite(bottom) and np.isfinite(top) and bottom < top):
        refuse(
            name, "range of heights", f"{low} to {high} for {bottom:.6g} to {top:.6g} µm", "damaged header"
        )
    raw = content.grid("<u2", rows, cols, HEADER_BYTES)
    missing = (raw < low) | (raw > high)
    layers = {}
    if content.numbers("<i", 1416)[0] > 0:
        layers[INTENSITY] = content.grid("u1", rows, cols, HEADER_BYTES + raw.nbytes)
        missing |= layers[INTENSITY] == 0
    per_count = (top - bottom) / (high - low)
    height = scaled(raw, per_count, missing)
    height += bottom - low * per_count
    pixel = stated_or_given_pixel(name, (step_y * 1e-3, step_x * 1e-3), given.pixel_um if given else None)
    origin = {
        "format": "nms",
        "first_row": "top",
        "instrument": {"manufacturer": "NanoFocus"},
        "corrected": ["steps read as nanometres, as the independent reader has them"],
    }
    return checked_map(name, height, pixel, origin, layers=layers)


TMD_MAGIC = b"Binary TrueMap Data File v2.0"
COMMENT = 32
MOST_COMMENT_BYTES = 256
MICROMETRES = 1e3
TMD_HEADER_BYTES = 24


def read_tmd(path: Path | str, given: Given | None = None) -> HeightMap:
    """Read a tmd file.

    Returns:
        (rows, cols) heights in µm in the order of the file, first row at the top of the picture.

    Raises:
        HeightMapError: another version or layout, truncated, or implausible.
    """
    content = load_content(Path(path))
    name = content.name
    if given and given.pixel_um is not None:
        refuse(name, "units", "a tmd file states its own pixel", "leave the pixel size out")
    end = content.data.find(b"\0", COMMENT, COMMENT + MOST_COMMENT_BYTES)
    if not content.data.startswith(TMD_MAGIC) or end < 0:
        refuse(name, "header", "no TrueMap file of version 2.0", "export it as such, or as x3p")
    at = end + 1
    cols, rows, length_x, length_y = content.numbers("<IIff", at)
    raw = content.grid("<f4", rows, cols, at + TMD_HEADER_BYTES)
    if at + TMD_HEADER_BYTES + raw.nbytes != len(content):
        left = len(content) - at - TMD_HEADER_BYTES - raw.nbytes
        refuse(
            name,
            "layout",
            f"{left} bytes after the last height",
            f"this is another kind of tmd, or {DAMAGED}",
        )
    comment = content.text(COMMENT, end - COMMENT)
    origin = {"format": "tmd", "first_row": "top"} | ({"comment": comment} if comment else {})
    pixel = float(length_y) / rows * MICROMETRES, float(length_x) / cols * MICROMETRES
    return checked_map(name, scaled(raw, MICROMETRES), pixel, origin, stage_height=True)


TMD = Format("tmd", "TrueMap tmd", (".tmd",), read_tmd, ((0, TMD_MAGIC),), place=6)
NMS = Format("nms", "NanoFocus nms", (".nms",), read_nms, ((32, VERSION.encode()),), place=10)
