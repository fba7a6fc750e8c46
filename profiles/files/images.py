"""Height maps as pictures: TIFF and PNG with one channel of 16 bits or more.

A picture knows no heights: the pixel size, and the height of one count of an integer picture, are asked for.
Resolution tags are made for printers and are never used. TIFF files that :func:`write_tiff` wrote note pixel
and unit in their description, and only those need no options. The first row is the top of the picture.

Decoding is done by tifffile and OpenCV in the guarded process; before that, every chunk checksum of a PNG is
compared and its data inflated to the length that its header claims, because decoders fill what is missing.
"""

import re
import struct
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.checks import DEFLATE_LIMIT, check_claim, checked_map, refuse
from anisoscope.profiles.files.content import DAMAGED, Content, load_content, scaled
from anisoscope.profiles.files.decoder_process import decode
from anisoscope.profiles.files.units import Given, micrometres_per, require_pixel
from anisoscope.profiles.heightmap import HeightMap

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
GREY = 0
NOTE = re.compile(r"heights in um; pixel_um \(y, x\): ([0-9.eE+-]+), ([0-9.eE+-]+)")


def _chunks(content: Content) -> tuple[bytes, bytes]:
    """Header and joined image data of a PNG whose every chunk has the right checksum."""
    header, data, position = b"", [], len(PNG_MAGIC)
    while True:
        length, kind = content.numbers(">I4s", position)
        body = content.data[position + 8 : position + 8 + length]
        (checksum,) = content.numbers(">I", position + 8 + length)
        if zlib.crc32(kind + body) != checksum:
            refuse(content.name, f"checksum of chunk {kind!r}", "is wrong", DAMAGED)
        if kind == b"IHDR":
            header = body
        elif kind == b"IDAT":
            data.append(body)
        elif kind == b"IEND":
            return header, b"".join(data)
        position += 12 + length


def check_png(content: Content) -> None:
    """Compare checksums and size of a PNG before it is decoded.

    Raises:
        HeightMapError: no PNG, truncated, damaged, interlaced, coloured, or of 8 bits and less.
    """
    name = content.name
    if not content.data.startswith(PNG_MAGIC):
        refuse(name, "content", "is no PNG", DAMAGED)
    header, packed = _chunks(content)
    if len(header) != 13:
        refuse(name, "header", f"of {len(header)} bytes", DAMAGED)
    cols, rows, bits, colour, _, _, interlaced = struct.unpack(">IIBBBBB", header)
    if (bits, colour, interlaced) != (16, GREY, 0):
        found = f"{bits} bits, colour type {colour}, interlace {interlaced}"
        refuse(name, "picture", found, "a height map needs one grey channel of 16 bits, not interlaced")
    check_claim(name, rows, cols, 2, len(packed) * DEFLATE_LIMIT)
    due = rows * (1 + 2 * cols)
    try:
        unpacked = len(zlib.decompressobj().decompress(packed, due + 1))
    except zlib.error as error:
        refuse(name, "image data", str(error), DAMAGED)
    if unpacked != due:
        refuse(name, "image data", f"{unpacked} bytes instead of {due}", DAMAGED)


def _factor(name: str, kind: str, given: Given) -> float:
    """µm per number of the picture."""
    unit = micrometres_per(given.z_unit or "um")
    if given.height_per_count is not None:
        if not (np.isfinite(given.height_per_count) and given.height_per_count != 0):
            refuse(name, "height per count", given.height_per_count, "give a number other than 0")
        return given.height_per_count * unit
    if given.z_unit is None:
        refuse(
            name,
            "height scale",
            "a picture has none",
            "say what one count is with --height-per-count (height_per_count= in Python)"
            + (", or the unit of its numbers with --z-unit" if kind == "f" else ""),
        )
    if kind != "f":
        refuse(name, "height scale", "counts have no unit", "say what one count is with --height-per-count")
    return unit


def _noted_pixel(description: str) -> tuple[float, float] | None:
    """Pixel size (y, x) in µm that our own writer left in the description."""
    found = NOTE.search(description)
    try:
        return (float(found[1]), float(found[2])) if found else None
    except ValueError:
        return None


def read_image(path: Path | str, given: Given | None = None) -> HeightMap:
    """Read a TIFF or PNG picture of heights.

    Args:
        path: the picture: one grey channel of 16 or 32 bits, or of floating-point numbers.
        given: pixel size, and height per count (integers) or unit (floating point).

    Returns:
        (rows, cols) heights in µm, first row at the top of the picture (``origin["first_row"]``).

    Raises:
        HeightMapError: no such picture, damaged, scales not given, or implausible.
    """
    path = Path(path)
    given = given or Given()
    content = load_content(path)
    if content.data.startswith(PNG_MAGIC):
        check_png(content)
        kind = "png"
    else:
        kind = "tiff"
    answer, raw = decode(kind, path)
    noted = _noted_pixel(str(answer.get("description", "")))
    if noted and raw.dtype.kind == "f" and given == Given():
        given = replace(given, pixel_um=noted, z_unit="um")
    pixel = require_pixel(path.name, given.pixel_um)
    factor = _factor(path.name, raw.dtype.kind, given)
    origin: dict[str, Any] = {"format": kind, "first_row": "top", "um_per_count": factor}
    return checked_map(path.name, scaled(raw, factor), pixel, origin)


def write_tiff(surface: HeightMap, path: Path | str) -> None:
    """Write the heights in µm as a float32 TIFF, first row at the top; pixel and unit stand in its description.

    Raises:
        HeightMapError: the file cannot be written.
    """
    import tifffile  # noqa: PLC0415 - only this command needs it

    note = f"heights in um; pixel_um (y, x): {surface.pixel_y_um!r}, {surface.pixel_x_um!r}"
    try:
        tifffile.imwrite(
            path, surface.height_um[::-1].astype(np.float32), description=note, metadata=None, software=""
        )
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be written ({error.strerror})") from None
