"""Read and write sur files of Digital Surf's MountainsMap, plain and compressed.

A file is a sequence of objects: 512 bytes of header, comment, private zone, and heights as integers of 16 or 32 bits.
``DSCOMPRESSED`` objects have, instead of the integers, a directory (number of blocks, then the plain and the packed
size of each) and the blocks, each a zlib stream. The first object is the surface; its colours (red, green, blue) and
intensities follow as grey images, objects of their own. Height = integer · z step (step unit);
zmin − 2 was not measured.

Source: the positions are those of Digital Surf's surface format as RosettaSciIO, SurfaceTopography and Gwyddion
document them; compressed files of MountainsMap (RosettaSciIO's test data) were read with it.
"""

import struct
import zlib
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.files.checks import DEFLATE_LIMIT, check_claim, checked_map, refuse
from anisoscope.profiles.files.content import DAMAGED, Content, load_content, scaled
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.units import stated_micrometres_per
from anisoscope.profiles.heightmap import COLOUR, INTENSITY, HeightMap

PLAIN, PACKED = b"DIGITAL SURF", b"DSCOMPRESSED"
LAYOUT = "<12sHHHh30s30sHHHHHfIHiiiiIfff16s16s16s16s16s16s16s16s16sfffHHH12sHHHHHHHfI6sHH128sfffff13s13s"
HEADER_BYTES = struct.calcsize(LAYOUT)
MOST_BLOCKS = 4096
PC_ORDER = 0
LAYERS = {11: (INTENSITY,), 13: (COLOUR,), 16: (COLOUR, INTENSITY)}
SURFACES = (2, *LAYERS)
"""Kinds of object whose first layer is a surface: alone, or with the layers named above."""
OTHERS = {
    1: "a profile", 3: "a binary image", 4: "a series of profiles", 5: "a series of surfaces", 6: "a meridian disc",
    7: "a multilayer profile", 8: "a multilayer surface", 9: "a parallel disc", 10: "a grey image", 12: "an RGB image",
    14: "a force curve", 15: "a series of force curves", 17: "a contour", 18: "a series of RGB images",
    20: "a spectrum", 21: "a spectral map",
}  # fmt: skip
MOSTLY_LEFT, UPSIDE = 2, 3
MICRO = {"\u00e6m": "µm"}  # the micro sign of DOS code page 850


class _Header(NamedTuple):
    """The fields of an object's header, in the order of the file."""

    signature: bytes
    order: int
    objects: int
    version: int
    kind: int
    name: bytes
    operator: bytes
    channels: int
    acquisition: int
    range: int
    special: int
    absolute: int
    resolution: float
    spectral: int
    bits: int
    lowest: int
    highest: int
    cols: int
    rows: int
    points: int
    step_x: float
    step_y: float
    step_z: float
    name_x: bytes
    name_y: bytes
    name_z: bytes
    unit_step_x: bytes
    unit_step_y: bytes
    unit_step_z: bytes
    unit_x: bytes
    unit_y: bytes
    unit_z: bytes
    ratio_x: float
    ratio_y: float
    ratio_z: float
    imprint: int
    inverted: int
    levelled: int
    unused: bytes
    second: int
    minute: int
    hour: int
    day: int
    month: int
    year: int
    weekday: int
    duration: float
    packed_bytes: int
    unused_too: bytes
    comment_bytes: int
    private_bytes: int
    client: bytes
    offset_x: float
    offset_y: float
    offset_z: float
    step_t: float
    offset_t: float
    name_t: bytes
    unit_t: bytes


def _text(raw: bytes) -> str:
    text = raw.split(b"\0", 1)[0].decode("latin-1")
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())


def _unit(raw: bytes) -> str:
    text = _text(raw)
    return MICRO.get(text, text)


def _header(content: Content) -> _Header:
    header = _Header(*content.numbers(LAYOUT, 0))
    name = content.name
    if header.signature not in (PLAIN, PACKED):
        refuse(name, "header", "does not begin as it should", "this is no sur file")
    if header.order != PC_ORDER:
        refuse(
            name, "number format", header.order, "only files of the PC's byte order are read; export again"
        )
    if header.kind not in SURFACES:
        kind = OTHERS.get(header.kind, f"an object of type {header.kind}")
        refuse(name, "content", f"{kind}, no surface", "export the topography as a surface")
    _check_numbers(name, header)
    if header.spectral > 1:
        refuse(
            name, "content", f"{header.spectral} values at each point", "export the topography as a surface"
        )
    return header


def _check_numbers(name: str, header: _Header) -> None:
    if header.bits not in (16, 32) or header.points != header.rows * header.cols:
        size = f"{header.rows} × {header.cols} points of {header.bits} bits, {header.points} in all"
        refuse(name, "header", size, DAMAGED)


def _unpacked(content: Content, start: int, size: int) -> tuple[bytes, int]:
    """The plain bytes of the blocks whose directory begins at ``start``, exactly ``size`` of them, and their end."""
    name = content.name
    (count,) = content.numbers("<I", start)
    if not 1 <= count <= MOST_BLOCKS:
        refuse(name, "compressed blocks", count, DAMAGED)
    sizes = np.array(content.numbers(f"<{2 * count}I", start + 4), dtype=np.int64).reshape(-1, 2)
    at = start + 4 + 8 * count
    plain, packed = (int(total) for total in sizes.sum(axis=0))
    if plain != size or at + packed > len(content) or (sizes[:, 0] > DEFLATE_LIMIT * sizes[:, 1]).any():
        refuse(name, "compressed blocks", f"{plain} bytes from {packed}, {size} are due", DAMAGED)
    parts = []
    for due, length in sizes.tolist():
        stream = zlib.decompressobj()
        try:
            part = stream.decompress(content.data[at : at + length], due + 1)
        except zlib.error as error:
            refuse(name, "compressed block", str(error)[:60], DAMAGED)
        if len(part) != due or not stream.eof:
            refuse(name, "compressed block", f"{len(part)} bytes where {due} are due", DAMAGED)
        parts.append(part)
        at += length
    return b"".join(parts), at


def _origin(content: Content, header: _Header) -> dict[str, Any]:
    packed = header.signature == PACKED
    origin: dict[str, Any] = {"format": "sur, compressed" if packed else "sur", "first_row": "top"}
    origin["instrument"] = {"manufacturer": "Digital Surf"}
    if model := _text(header.operator):
        origin["instrument"]["model"] = model
    try:
        when = datetime(header.year, header.month, header.day, header.hour, header.minute, header.second)  # noqa: DTZ001 - no zone stored
        origin["date"] = when.isoformat()
    except ValueError:
        pass
    if comment := content.text(HEADER_BYTES, min(header.comment_bytes, 200)):
        origin["comment"] = comment
    return origin


def read_sur(path: Path | str, given: FileScales | None = None) -> HeightMap:
    """Read the surface of a sur file.

    Returns:
        (rows, cols) heights in µm in the order of the file, first row at the top of the picture.

    Raises:
        HeightMapError: an image, a spectral map or a profile, no lengths, damaged, or implausible.
    """
    content = load_content(Path(path))
    name = content.name
    if given and given.pixel_um is not None:
        refuse(name, "units", "a sur file states its own pixel", "leave the pixel size out")
    header = _header(content)
    raw, end = _numbers(content, header, 0)
    origin = _origin(content, header)
    layers = {}
    if wanted := LAYERS.get(header.kind):
        try:
            layers = _layers(content, header, end, wanted)
        except HeightMapError as error:  # the heights stand before them
            origin["not_read"] = [f"{' and '.join(wanted)} ({str(error).removeprefix(f'{name}: ')})"]
    return checked_map(
        name,
        _heights(name, header, raw),
        _pixel_um(name, header),
        origin,
        stage_height=True,
        layers=layers,
    )


def _numbers(content: Content, header: _Header, at: int) -> tuple[npt.NDArray[Any], int]:
    """(rows, cols) integers of the object that begins at a byte, and where the next one begins."""
    start = at + HEADER_BYTES + header.comment_bytes + header.private_bytes
    size = header.bits // 8
    if header.signature == PACKED:
        capacity = DEFLATE_LIMIT * max(len(content) - start, 0)
        check_claim(content.name, header.rows, header.cols, size, capacity)
        plain, end = _unpacked(content, start, header.points * size)
        return Content(content.name, plain).grid(f"<i{size}", header.rows, header.cols, 0), end
    return content.grid(f"<i{size}", header.rows, header.cols, start), start + header.points * size


def _layers(content: Content, first: _Header, at: int, wanted: Sequence[str]) -> dict[str, npt.NDArray[Any]]:
    """Layers from the grey images that follow the surface: one for an intensity, three for a colour."""
    found = {}
    for layer in wanted:
        pictures = []
        for _ in range(3 if layer == COLOUR else 1):
            header = _Header(*content.numbers(LAYOUT, at))
            if (header.signature, header.rows, header.cols) != (first.signature, first.rows, first.cols):
                refuse(content.name, f"image of the {layer}", "is no object of the surface's size", DAMAGED)
            _check_numbers(content.name, header)
            raw, at = _numbers(content, header, at)
            pictures.append(
                scaled(raw, header.step_z, raw == header.lowest - 2 if header.special == 1 else None)
            )
        values = np.stack(pictures, axis=2) if layer == COLOUR else pictures[0]
        found[layer] = _turned(values, first.inverted)
    return found


def _pixel_um(name: str, header: _Header) -> tuple[float, float]:
    x = header.step_x * stated_micrometres_per(name, "x", _unit(header.unit_step_x))
    y = header.step_y * stated_micrometres_per(name, "y", _unit(header.unit_step_y))
    return y, x


def _heights(name: str, header: _Header, raw: npt.NDArray[Any]) -> FloatArray:
    """Heights in µm; inverted surfaces are turned back as the header says."""
    factor = header.step_z * stated_micrometres_per(name, "heights", _unit(header.unit_step_z))
    if not (np.isfinite(factor) and factor != 0.0):
        refuse(name, "step of the heights", f"{header.step_z:g}", DAMAGED)
    missing = raw == header.lowest - 2 if header.special == 1 else None
    height = scaled(raw, -factor if header.inverted else factor, missing)
    return np.ascontiguousarray(_turned(height, header.inverted))


def _turned(values: npt.NDArray[Any], inverted: int) -> npt.NDArray[Any]:
    """Numbers (rows, cols, ...) of an inverted surface as it was before."""
    if inverted in (MOSTLY_LEFT, UPSIDE):
        return values[:, ::-1] if inverted == MOSTLY_LEFT else values[::-1]
    return values


LARGEST = 2**31 - 8


def write_sur(surface: HeightMap, path: Path | str) -> None:
    """Write a map as an uncompressed sur file, which every program that knows the format reads.

    Heights are integers of 32 bits times a power of two of a µm; the pixel has 24 bits.

    Raises:
        HeightMapError: the file cannot be written.
    """
    height = surface.height_um[::-1]
    known = np.isfinite(height)
    largest = float(np.abs(height[known]).max(initial=0.0))
    step = float(2.0 ** np.ceil(np.log2(max(largest, 1e-9) / LARGEST)))
    raw = np.rint(np.where(known, height, 0.0) / step).astype(np.int64)
    low = int(raw[known].min(initial=0)) if not known.all() else int(raw.min())
    high = int(raw[known].max(initial=0))
    raw[~known] = low - 2
    rows, cols = surface.shape
    unit = "µm".encode("latin-1")
    when = _date(surface.origin.get("date"))
    head = _Header(
        PLAIN, PC_ORDER, 1, 1, 2, b"", b"anisoscope", 1, 0, 0, int(not known.all()), 0, 0.0, 0, 32, low, high,
        cols, rows, rows * cols, surface.pixel_x_um, surface.pixel_y_um, step, b"X", b"Y", b"Z",
        unit, unit, unit, unit, unit, unit, 1.0, 1.0, 1.0, 0, 0, 0, b"",
        *when, 0.0, 0, b"", 0, 0, b"", 0.0, 0.0, low * step, 0.0, 0.0, b"", b"",
    )  # fmt: skip
    try:
        Path(path).write_bytes(struct.pack(LAYOUT, *head) + raw.astype("<i4").tobytes())
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be written ({error.strerror})") from None


def _date(text: object) -> tuple[int, int, int, int, int, int, int]:
    """Second, minute, hour, day, month, year and weekday (Sunday is 0); zeros where nothing is known."""
    try:
        when = datetime.fromisoformat(str(text))
    except ValueError:
        return 0, 0, 0, 0, 0, 0, 0
    return when.second, when.minute, when.hour, when.day, when.month, when.year, when.isoweekday() % 7


SUR = Format("sur", "Digital Surf sur", (".sur",), read_sur, ((0, PLAIN), (0, PACKED)), place=5)
