"""Height maps as numpy files: npy, and npz with one two-dimensional array and layers.

The header of an npy file is compared with the size of the file before anything is allocated, and arrays of
Python objects are never unpickled.
"""

import tokenize
import zipfile
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.lib import format as npy_format

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.base.regular_file import regular_file
from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.files.checks import DEFLATE_LIMIT, check_claim, check_packing, checked_map, refuse
from anisoscope.profiles.files.content import scaled
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.units import micrometres_per, require_pixel
from anisoscope.profiles.files.x3p import DAMAGED, ZIP_TROUBLE
from anisoscope.profiles.heightmap import COLOUR, INTENSITY, INTERPOLATED, HeightMap

MAX_ENTRY_BYTES = 2**31
HEIGHT = "height_um.npy"
LAYERS: dict[str, tuple[int, ...]] = {INTENSITY: (), COLOUR: (3,), INTERPOLATED: ()}
HEADER_TROUBLE = (*ZIP_TROUBLE, SyntaxError, TypeError, RecursionError, MemoryError, tokenize.TokenError)


def _read_array(
    name: str, stream: BinaryIO, size: int, factor: float, channels: tuple[int, ...] = ()
) -> FloatArray:
    """The array (rows, cols, *channels) of an npy stream of ``size`` bytes, as float64 times a factor."""
    try:
        version = npy_format.read_magic(stream)
        read = {(1, 0): npy_format.read_array_header_1_0, (2, 0): npy_format.read_array_header_2_0}[version]
        shape, fortran, dtype = read(stream)
    except HEADER_TROUBLE as error:
        refuse(name, "npy header", f"cannot be read ({error or type(error).__name__})", DAMAGED)
    if dtype.hasobject:
        refuse(
            name,
            "data type",
            str(dtype)[:40],
            "pickled objects are never read; save a plain array of numbers",
        )
    if dtype.kind not in "iuf":
        refuse(name, "data type", str(dtype)[:40], "integers or floating-point numbers are expected")
    if channels and shape[2:] != channels:
        refuse(name, "shape", shape, f"a colour has {channels[0]} numbers for every point")
    if len(shape) != 2 + len(channels):
        refuse(name, "shape", shape, "a height map has two dimensions: rows along y, columns along x")
    each = int(np.prod(channels, dtype=int))
    check_claim(name, shape[0], shape[1], dtype.itemsize * each, size - stream.tell())
    count = shape[0] * shape[1] * each
    raw = np.frombuffer(stream.read(count * dtype.itemsize), dtype, count)
    return scaled(raw.reshape(shape, order="F" if fortran else "C"), factor)


@dataclass(frozen=True)
class _Arrays:
    """Heights, pixel (y, x) in µm where it is noted, comment, and layers by name."""

    height: FloatArray
    pixel: tuple[float, float] | None = None
    comment: str = ""
    layers: dict[str, FloatArray] = field(default_factory=dict)


def _npy(path: Path, factor: float) -> _Arrays:
    with regular_file(path) as stream:
        return _Arrays(_read_array(path.name, stream, path.stat().st_size, factor))


def _npz(path: Path, factor: float) -> _Arrays:
    """The array of heights of an archive, and with it ``pixel_um`` (y, x), ``intensity`` and ``colour``."""
    found: dict[str, FloatArray] = {}
    layers: dict[str, FloatArray] = {}
    pixel: tuple[float, float] | None = None
    with zipfile.ZipFile(path) as archive:
        whole = sum(info.file_size for info in archive.infolist())
        check_packing(path.name, "all arrays", whole, path.stat().st_size)
        comment = archive.comment.decode("utf-8", "replace")
        for info in archive.infolist():
            limit = min(info.compress_size, path.stat().st_size) * DEFLATE_LIMIT
            if info.file_size > min(limit, MAX_ENTRY_BYTES):
                refuse(path.name, info.filename, f"claims {info.file_size} bytes", DAMAGED)
            with archive.open(info) as entry:
                content = entry.read(info.file_size + 1)
            if info.filename == "pixel_um.npy":
                y, x = np.broadcast_to(np.load(BytesIO(content), allow_pickle=False), 2).tolist()
                pixel = (float(y), float(x))
                continue
            key, name = info.filename.removesuffix(".npy"), f"{path.name}/{info.filename}"
            layer = key in LAYERS and HEIGHT in archive.namelist()
            into, scale = (layers, 1.0) if layer else (found, factor)
            channels = LAYERS[key] if layer else ()
            into[key] = _read_array(name, BytesIO(content), len(content), scale, channels)
    if len(found) != 1:
        refuse(path.name, "arrays", ", ".join(found)[:80] or "none", "one array of heights is expected")
    return _Arrays(next(iter(found.values())), pixel, comment, layers)


def read_array(
    path: Path | str, *, pixel_um: tuple[float, float] | None = None, z_unit: str = "um"
) -> HeightMap:
    """Read an npy or npz file: (rows, cols) heights, rows along y; NaN and infinity are missing.

    Args:
        path: the file. An npz archive holds one array, and may hold ``pixel_um`` (y, x) or one number; with
            ``height_um`` it may hold the layers ``intensity`` (rows, cols) and ``colour`` (rows, cols, 3) too.
        pixel_um: (y, x) pixel size in µm; needed for npy.
        z_unit: unit of the heights: um, nm, mm or m.

    Raises:
        HeightMapError: not readable, pickled objects, no pixel size, or implausible values.
    """
    path = Path(path)
    factor = micrometres_per(z_unit)
    packed = _starts_with_zip(path)
    try:
        read = _npz(path, factor) if packed else _npy(path, factor)
    except HeightMapError:
        raise
    except HEADER_TROUBLE as error:
        refuse(path.name, "numpy file", f"cannot be read ({error or type(error).__name__})", DAMAGED)
    pixel = require_pixel(path.name, pixel_um or read.pixel)
    origin = {"format": "npz" if packed else "npy", "z_unit": z_unit}
    if read.comment:
        origin["comment"] = read.comment
    return checked_map(path.name, read.height, pixel, origin, layers=read.layers)


def _starts_with_zip(path: Path) -> bool:
    with regular_file(path) as stream:
        return stream.read(2) == b"PK"


def _add_comment(stream: BinaryIO, comment: str) -> None:
    if comment:
        with zipfile.ZipFile(stream, "a") as archive:
            archive.comment = comment.encode()


def write_array(surface: HeightMap, path: Path | str) -> None:
    """Write the heights in µm: npz with ``height_um``, ``pixel_um`` (y, x) and layers, or npy with the heights alone.

    ``comment`` of the origin becomes the comment of the npz archive.

    Raises:
        HeightMapError: the file cannot be written.
    """
    path = Path(path)
    try:
        with path.open("w+b") as stream:
            if path.suffix.lower() == ".npz":
                pixel_um = np.array([surface.pixel_y_um, surface.pixel_x_um])
                arrays = {"height_um": surface.height_um, "pixel_um": pixel_um, **surface.layers}
                np.savez_compressed(stream, allow_pickle=False, **arrays)
                _add_comment(stream, str(surface.origin.get("comment", "")))
            else:
                np.save(stream, surface.height_um, allow_pickle=False)
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be written ({error.strerror})") from None


def _read(path: Path, given: FileScales) -> HeightMap:
    return read_array(path, pixel_um=given.pixel_um, z_unit=given.z_unit or "um")


NPY = Format("npy", "numpy array", (".npy",), _read, ((0, b"\x93NUMPY"),), units_from_user="scales", place=11)
NPZ = Format("npz", "numpy archive", (".npz",), _read, (), ".npy", "scales", place=12)
