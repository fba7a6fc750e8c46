"""Read and write gsf files: Gwyddion Simple Field 1.0.

A line of magic, lines ``name = value``, one to four NUL bytes up to a multiple of four, then float32 numbers,
little-endian, row after row from the top of the picture down. Format:
https://gwyddion.net/documentation/user-guide-en/gsf.html.
"""

from pathlib import Path
from typing import Any

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.files.checks import checked_map, refuse
from anisoscope.profiles.files.content import DAMAGED, Content, load_content, scaled
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.units import stated_micrometres_per, stated_or_given_pixel
from anisoscope.profiles.heightmap import HeightMap

MAGIC = b"Gwyddion Simple Field 1.0\n"
MAX_HEADER_BYTES = 2**20


def _fields(content: Content) -> tuple[dict[str, str], int]:
    """Header fields, and where the numbers begin."""
    end = content.data.find(b"\0", 0, MAX_HEADER_BYTES)
    if not content.data.startswith(MAGIC) or end < 0:
        refuse(content.name, "header", "does not begin or end as it should", "this is no gsf file")
    lines = content.data[len(MAGIC) : end].decode("utf-8", "replace").split("\n")
    pairs = (line.partition("=") for line in lines)
    return {key.strip(): value.strip() for key, sign, value in pairs if sign}, end + 4 - end % 4


def _count(name: str, fields: dict[str, str], key: str) -> int:
    text = fields.get(key, "")
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        refuse(name, key, repr(text[:40]), DAMAGED)
    return int(text)


def _real_um(name: str, fields: dict[str, str], key: str) -> float | None:
    """Length of the field in µm, or None where the file does not give it."""
    if key not in fields:
        return None
    factor = stated_micrometres_per(name, "x and y (XYUnits)", fields.get("XYUnits"))
    try:
        return float(fields[key]) * factor
    except ValueError:
        return refuse(name, key, repr(fields[key][:40]), DAMAGED)


def read_gsf(path: Path | str, given: FileScales | None = None) -> HeightMap:
    """Read a gsf file.

    Returns:
        (rows, cols) heights in µm in the order of the file, first row at the top of the picture
        (``origin["first_row"]``).

    Raises:
        HeightMapError: no gsf file, truncated, units that are no lengths, or implausible.
    """
    content = load_content(Path(path))
    name = content.name
    fields, start = _fields(content)
    rows, cols = _count(name, fields, "YRes"), _count(name, fields, "XRes")
    factor = stated_micrometres_per(name, "heights (ZUnits)", fields.get("ZUnits"))
    raw = content.grid("<f4", rows, cols, start)
    real_y, real_x = _real_um(name, fields, "YReal"), _real_um(name, fields, "XReal")
    stated = None if real_x is None or real_y is None else (real_y / rows, real_x / cols)
    pixel = stated_or_given_pixel(name, stated, given.pixel_um if given else None)
    origin: dict[str, Any] = {"format": "gsf", "first_row": "top"}
    if comment := fields.get("Comment", fields.get("Title", "")[:200]):
        origin["comment"] = comment
    return checked_map(name, scaled(raw, factor), pixel, origin)


def _line(text: object) -> str:
    return "".join(letter for letter in str(text) if letter.isprintable())


def write_gsf(surface: HeightMap, path: Path | str) -> None:
    """Write a map as gsf: float32 metres, so that heights keep 24 bits; the pixel keeps all of them.

    ``comment`` of the origin stands in the field ``Comment``.

    Raises:
        HeightMapError: the file cannot be written.
    """
    rows, cols = surface.shape
    field_y, field_x = surface.extent_um
    title = _line(surface.origin.get("file", "height map"))
    comment = _line(surface.origin.get("comment", ""))
    lines = (
        f"XRes = {cols}",
        f"YRes = {rows}",
        f"XReal = {field_x * 1e-6!r}",
        f"YReal = {field_y * 1e-6!r}",
        "XYUnits = m",
        "ZUnits = m",
        f"Title = {title}",
        *([f"Comment = {comment}"] if comment else []),
    )
    head = MAGIC + "\n".join(lines).encode() + b"\n"
    numbers = (surface.height_um[::-1] * 1e-6).astype("<f4").tobytes()
    try:
        Path(path).write_bytes(head + bytes(4 - len(head) % 4) + numbers)
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be written ({error.strerror})") from None


GSF = Format("gsf", "Gwyddion simple field", (".gsf",), read_gsf, ((0, MAGIC),), place=3)
