"""Read files of one header and one block of numbers: NanoFocus nms, TrueMap and GelSight tmd, Keyence and ESRI text.

nms, of µsurf confocal microscopes, version ``OM_MS_2.0``. Positions and meaning of the fields:
https://github.com/drocheam/musurf-reader, an independent reader of this version. Steps are nanometres there;
SurfaceTopography takes the same numbers for millimetres. Numbers below or above the range that the header names are
points without a height; so are points without intensity, which is a byte for each point after the heights.

tmd, ``Binary TrueMap Data File v2.0``. After 32 bytes of magic come a comment that ends with NUL (24 bytes of TrueMap
v6, a single NUL of GelSight), columns and rows, lengths and offsets in mm, and float32 heights in mm, row after row.
Nothing may follow: a comment of another length than it seems would shift everything.
"""

import csv
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.files.cells import grid_of, number_of, numbers_of, text_of
from anisoscope.profiles.files.checks import check_claim, checked_map, refuse
from anisoscope.profiles.files.content import DAMAGED, load_content, scaled
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.units import micrometres_per, stated_micrometres_per, stated_or_given_pixel
from anisoscope.profiles.heightmap import INTENSITY, HeightMap

ESRI_HEADER = re.compile(r"\A\s*ncols\s+\d+\s*[\r\n]", re.IGNORECASE)
KEYENCE = {
    "width": ("Horizontal", "Horizont."),
    "height": ("Vertical", "Vertikal"),
    "pixel": ("XY Calibration", "XY-Justierung"),
    "unit": ("Unit", "Einheit"),
}
KEYENCE_HEADER = re.compile(r"^\"?(XY Calibration|XY-Justierung)\"?\s*[,;]", re.MULTILINE)
KEYENCE_TITLES = ("height", "höhe")
HEADER_BYTES = 3468
VERSION = "OM_MS_2.0"


def read_nms(path: Path | str, given: FileScales | None = None) -> HeightMap:
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


def read_tmd(path: Path | str, given: FileScales | None = None) -> HeightMap:
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


def read_keyence_text(path: Path, given: FileScales) -> HeightMap:
    """Read a CSV export of heights of Keyence VK and VR microscopes.

    Lines of a key and its value, the title of the block, then its rows, quoted.

    Args:
        path: the file.
        given: units are stated by the file.

    Raises:
        HeightMapError: a block of something else, or header and data do not fit each other.
    """
    name, lines = path.name, text_of(path).splitlines()
    rows_of_cells: Iterator[list[str]] = csv.reader(lines)
    header: dict[str, list[str]] = {}
    title = ""
    for cells in rows_of_cells:
        key, *values = [cell.strip() for cell in cells] or [""]
        if values:
            header[key] = values
        elif key and header:
            title = key
            break
    if title.casefold() not in KEYENCE_TITLES:
        refuse(name, "block", repr(title[:40]), "a block of heights is read; export the height")

    def value(key: str) -> list[str]:
        found = next((header[word] for word in KEYENCE[key] if word in header), None)
        if found is None:
            refuse(name, "header", f"no {KEYENCE[key][0]}", DAMAGED)
        return found

    cols, rows = (int(number_of(name, 1, value(key)[0])) for key in ("width", "height"))
    check_claim(name, rows, cols, 0, 0)
    side, unit, *_ = *value("pixel"), ""
    step = number_of(name, 1, side) * stated_micrometres_per(name, "pixel (XY Calibration)", unit)
    factor = stated_micrometres_per(name, "heights (Unit)", value("unit")[0])
    numbers = [
        number_of(name, rows_of_cells.line_num, cell.strip())  # type: ignore[attr-defined]
        for cells in rows_of_cells
        for cell in cells[:cols]
    ]
    pixel = stated_or_given_pixel(name, (step, step), given.pixel_um)
    origin = {"format": "Keyence text", "first_row": "top", "instrument": {"manufacturer": "Keyence"}}
    return checked_map(name, scaled(grid_of(name, numbers, rows, cols), factor), pixel, origin)


def read_esri_text(path: Path, given: FileScales) -> HeightMap:
    """Read an ESRI grid (ARC/INFO ASCII GRID): ``ncols``, ``nrows``, ``cellsize``, ``NODATA_value``, then the heights.

    Args:
        path: the file.
        given: units of the cells and heights, which the file does not state.

    Raises:
        HeightMapError: no unit, or header and data do not fit each other.
    """
    name, lines = path.name, text_of(path).splitlines()
    header: dict[str, float] = {}
    for k, line in enumerate(lines, 1):
        key, *rest = line.split() or [""]
        if not key[:1].isalpha() or not rest:
            begin = k - 1
            break
        header[key.lower()] = number_of(name, k, rest[0])
    else:
        refuse(name, "text", "holds no heights", DAMAGED)
    if not {"ncols", "nrows"} <= header.keys() or not ("cellsize" in header or {"dx", "dy"} <= header.keys()):
        refuse(name, "header", ", ".join(header)[:80], "ncols, nrows and cellsize are expected")
    unit = given.xy_unit or given.z_unit
    if unit is None:
        refuse(
            name,
            "units",
            "an ESRI grid states none",
            "say that of cellsize with --xy-unit, of heights with --z-unit",
        )
    if given.pixel_um is not None:
        refuse(name, "pixel size", "the header has cellsize", "leave the pixel size out")
    side = micrometres_per(unit)
    pixel = (
        header.get("dy", header.get("cellsize", 0.0)) * side,
        header.get("dx", header.get("cellsize", 0.0)) * side,
    )
    raw = grid_of(
        name, numbers_of(name, begin + 1, lines[begin:]), int(header["nrows"]), int(header["ncols"])
    )
    codes = [header["nodata_value"]] if "nodata_value" in header else []
    height = scaled(raw, micrometres_per(given.z_unit or unit), np.isin(raw, [*codes, *given.missing]))
    origin = {"format": "ESRI grid", "first_row": "top", "z_unit": given.z_unit or unit, "xy_unit": unit}
    return checked_map(name, height, pixel, origin)


NMS = Format("nms", "NanoFocus nms", (".nms",), read_nms, ((32, VERSION.encode()),), place=10)
KEYENCE_TEXT = Format("keyence-text", "Keyence text", (), read_keyence_text, header=KEYENCE_HEADER, place=16)
ESRI_TEXT = Format(
    "esri", "ESRI grid", (), read_esri_text, header=ESRI_HEADER, units_from_user="scales", place=16
)
