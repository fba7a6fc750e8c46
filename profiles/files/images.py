"""Height maps for programs that know no heights: pictures (TIFF, PNG), and the writing of meshes (STL, PLY).

A picture knows no heights: the pixel size, and the height of one count of an integer picture, are asked for.
Resolution tags are made for printers and are never used. TIFF and PNG files that we wrote note pixel and heights in
their description or text, and only those need no options. The first row is the top of the picture.

Decoding is done by tifffile and OpenCV in the guarded process; before that, every chunk checksum of a PNG is
compared and its data inflated to the length that its header claims, because decoders fill what is missing.

In a mesh every square of four measured points is two triangles, seen counter-clockwise from +z; squares with a missing
point are left out. STL has no unit: millimetres are what programs take its numbers for, and its header says so, as
the comment of the PLY does. x and y begin at 0, z is the height.
"""

import re
import struct
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.files.checks import DEFLATE_LIMIT, check_claim, checked_map, refuse
from anisoscope.profiles.files.content import DAMAGED, Content, load_content, scaled
from anisoscope.profiles.files.decoder_process import decode
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.library import read_library
from anisoscope.profiles.files.units import micrometres_per, require_pixel
from anisoscope.profiles.heightmap import COLOUR, HeightMap

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
GREY = 0
PNG_NOTE = re.compile(
    r"height_um = count \* ([0-9.eE+-]+) \+ ([0-9.eE+-]+), 0 is missing; "
    r"pixel_um \(y, x\): ([0-9.eE+-]+), ([0-9.eE+-]+)"
)
PNG_KEYWORD = b"Height map\0"
MOST_COUNTS = 65535
NOTE = re.compile(r"heights in um; pixel_um \(y, x\): ([0-9.eE+-]+), ([0-9.eE+-]+)")


def _chunks(content: Content) -> tuple[bytes, bytes, str]:
    """Header, joined image data and our note of a PNG whose every chunk has the right checksum."""
    header, note, data, position = b"", "", [], len(PNG_MAGIC)
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
        elif kind == b"tEXt" and body.startswith(PNG_KEYWORD):
            note = body[len(PNG_KEYWORD) :].decode("latin-1")
        elif kind == b"IEND":
            return header, b"".join(data), note
        position += 12 + length


def check_png(content: Content) -> str:
    """Compare checksums and size of a PNG before it is decoded; return what our own writer noted in it, if anything.

    Raises:
        HeightMapError: no PNG, truncated, damaged, interlaced, coloured, or of 8 bits and less.
    """
    name = content.name
    if not content.data.startswith(PNG_MAGIC):
        refuse(name, "content", "is no PNG", DAMAGED)
    header, packed, note = _chunks(content)
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
    return note


def _factor(name: str, kind: str, given: FileScales) -> float:
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


def read_image(path: Path | str, given: FileScales | None = None) -> HeightMap:
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
    given = given or FileScales()
    content = load_content(path)
    png_note = check_png(content) if content.data.startswith(PNG_MAGIC) else None
    kind = "tiff" if png_note is None else "png"
    answer, raw = decode(kind, path)
    if answer.get("park"):
        if given.z_unit or given.height_per_count is not None:
            refuse(
                path.name,
                "units",
                "a file of Park Systems states its own",
                "leave --z-unit and --height-per-count out",
            )
        return read_library(path, given, "ps")
    unscaled = replace(given, rows="auto", role="part", trust=()) == FileScales()
    if png_note and unscaled and (scales := PNG_NOTE.fullmatch(png_note)):
        return _counted(path.name, raw, [_real(path.name, text) for text in scales.groups()])
    noted = _noted_pixel(str(answer.get("description", "")))
    if noted and raw.dtype.kind == "f" and unscaled:
        given = replace(given, pixel_um=noted, z_unit="um")
    pixel = require_pixel(path.name, given.pixel_um)
    factor = _factor(path.name, raw.dtype.kind, given)
    origin: dict[str, Any] = {"format": kind, "first_row": "top", "um_per_count": factor}
    return checked_map(path.name, scaled(raw, factor), pixel, origin)


def _real(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return refuse(name, "note", repr(text[:40]), DAMAGED)


def _counted(name: str, raw: npt.NDArray[Any], scales: list[float]) -> HeightMap:
    """The map of a PNG that we wrote: step and zero of the heights, pixel (y, x) in µm."""
    step, zero, pixel_y, pixel_x = scales
    height = scaled(raw, step, raw == 0)
    height += zero
    origin = {"format": "png", "first_row": "top", "um_per_count": step}
    return checked_map(name, height, (pixel_y, pixel_x), origin)


def write_png(surface: HeightMap, path: Path | str) -> None:
    """Write a map as a grey PNG of 16 bits, first row at the top; 0 is missing, 1 the lowest, 65535 the highest point.

    Step and zero of the heights and the pixel stand in a text chunk, in words and numbers; :func:`read_image` finds
    them there.

    Raises:
        HeightMapError: the file cannot be written.
    """
    height = surface.height_um[::-1]
    known = np.isfinite(height)
    low, high = float(height[known].min(initial=np.inf)), float(height[known].max(initial=-np.inf))
    step = (high - low) / (MOST_COUNTS - 1) if high > low else 1.0
    zero = (low if known.any() else 0.0) - step
    counts = np.where(known, np.rint((np.where(known, height, zero) - zero) / step), 0.0).astype(">u2")
    rows, cols = counts.shape
    lines = np.zeros((rows, 1 + 2 * cols), dtype=np.uint8)  # each begins with 0: no filter
    lines[:, 1:] = counts.view(np.uint8).reshape(rows, 2 * cols)
    note = f"height_um = count * {step!r} + {zero!r}, 0 is missing; pixel_um (y, x): "
    note += f"{surface.pixel_y_um!r}, {surface.pixel_x_um!r}"
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", cols, rows, 16, GREY, 0, 0, 0)),
        (b"tEXt", PNG_KEYWORD + note.encode("latin-1")),
        (b"IDAT", zlib.compress(lines.tobytes(), 6)),
        (b"IEND", b""),
    )
    parts = (struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
             for kind, body in chunks)  # fmt: skip
    try:
        Path(path).write_bytes(PNG_MAGIC + b"".join(parts))
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be written ({error.strerror})") from None


def write_layer(surface: HeightMap, name: str, path: Path | str) -> None:
    """Write a layer of a map as a PNG, first row at the top, missing points 0.

    Whole numbers up to 255 have 8 bits, up to 65535 16 bits; others are stretched from 1 to 65535. A colour has 8 bits.

    Raises:
        HeightMapError: the map has no such layer, or the file cannot be written.
    """
    import cv2  # noqa: PLC0415 - slow to import

    if name not in surface.layers:
        source, known = surface.origin.get("file", "the map"), " and ".join(surface.layers)
        raise HeightMapError(
            f"{source}: layer: there is no {name}" + (f"; there is {known}" if known else "")
        )
    values = surface.layers[name][::-1]
    numbers = np.where(np.isfinite(values), values, 0.0)
    most = float(numbers.max(initial=0.0))
    if name == COLOUR:
        picture = np.clip(np.rint(numbers), 0, 255).astype(np.uint8)[
            ..., ::-1
        ]  # OpenCV's order: blue, green, red
    elif numbers.min(initial=0.0) < 0.0 or most > MOST_COUNTS or (numbers != np.rint(numbers)).any():
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        scale = (MOST_COUNTS - 1) / (high - low) if high > low else 0.0
        picture = np.where(np.isfinite(values), 1.0 + np.rint((values - low) * scale), 0.0).astype(np.uint16)
    else:
        picture = numbers.astype(np.uint8 if most <= 255 else np.uint16)
    _write(Path(path), cv2.imencode(".png", np.ascontiguousarray(picture))[1].tobytes())


def write_tiff(surface: HeightMap, path: Path | str) -> None:
    """Write the heights in µm as a float32 TIFF, first row at the top; pixel and unit are in its description.

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


MOST_POINTS = 5_000_000
MILLIMETRES = 1e-3
STL_HEADER_BYTES = 80
TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def _mesh(surface: HeightMap, path: Path) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Points (n, 3) in mm, and triangles (m, 3) of their numbers."""
    rows, cols = surface.shape
    if rows * cols > MOST_POINTS:
        raise HeightMapError(
            f"{path}: a mesh of {rows} × {cols} points would be of little use to other programs; at most "
            f"{MOST_POINTS // 10**6} million are written: crop the map, or write it as sur or x3p"
        )
    known = np.isfinite(surface.height_um)
    number = np.cumsum(known.ravel()).reshape(known.shape) - 1
    i, j = np.nonzero(known)
    x, y, z = j * surface.pixel_x_um, i * surface.pixel_y_um, surface.height_um[known]
    whole = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    if not whole.any():
        raise HeightMapError(f"{path}: no four neighbouring points were measured; there is nothing to mesh")
    a, b, c, d = (one[whole] for one in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.stack([x, y, z], axis=1) * MILLIMETRES, triangles


def write_stl(surface: HeightMap, path: Path | str) -> None:
    """Write a map as a binary STL in mm, float32.

    Raises:
        HeightMapError: more than five million points, nothing to mesh, or the file cannot be written.
    """
    path = Path(path)
    points, triangles = _mesh(surface, path)
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    records = np.zeros(len(triangles), TRIANGLE)
    records["normal"] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    records["corners"] = corners
    head = b"height map, unit mm".ljust(STL_HEADER_BYTES)
    _write(path, head + np.uint32(len(triangles)).astype("<u4").tobytes() + records.tobytes())


def write_ply(surface: HeightMap, path: Path | str) -> None:
    """Write a map as a binary PLY in mm, float64 points.

    Raises:
        HeightMapError: more than five million points, nothing to mesh, or the file cannot be written.
    """
    path = Path(path)
    points, triangles = _mesh(surface, path)
    faces = np.empty(len(triangles), FACE)
    faces["count"], faces["corners"] = 3, triangles
    head = (
        "ply\nformat binary_little_endian 1.0\ncomment height map, unit mm\n"
        f"element vertex {len(points)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    _write(path, head.encode() + points.astype("<f8").tobytes() + faces.tobytes())


def _write(path: Path, content: bytes) -> None:
    try:
        path.write_bytes(content)
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be written ({error.strerror})") from None


_TIFF = (0, b"II*\0"), (0, b"MM\0*")
TIFF = Format(
    "tiff", "TIFF picture", (".tif", ".tiff"), read_image, _TIFF, units_from_user="counts", place=15
)
PNG = Format(
    "png", "PNG picture", (".png",), read_image, ((0, PNG_MAGIC),), units_from_user="counts", place=17
)
