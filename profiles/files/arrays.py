"""Height maps as numpy files: npy, and npz with one two-dimensional array.

The header of an npy file is compared with the size of the file before anything is allocated, and arrays of
Python objects are never unpickled.
"""

import tokenize
import zipfile
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.lib import format as npy_format

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.checks import DEFLATE_LIMIT, check_claim, check_packing, checked_map, refuse
from anisoscope.profiles.files.content import scaled
from anisoscope.profiles.files.units import micrometres_per, require_pixel
from anisoscope.profiles.files.x3p import DAMAGED, ZIP_TROUBLE
from anisoscope.profiles.heightmap import HeightMap

MAX_ENTRY_BYTES = 2**31
HEADER_TROUBLE = (*ZIP_TROUBLE, SyntaxError, TypeError, RecursionError, MemoryError, tokenize.TokenError)


def _read_array(name: str, stream: BinaryIO, size: int, factor: float) -> FloatArray:
    """The two-dimensional array of an npy stream of ``size`` bytes, as float64 times a factor."""
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
    if len(shape) != 2:
        refuse(name, "shape", shape, "a height map has two dimensions: rows along y, columns along x")
    check_claim(name, shape[0], shape[1], dtype.itemsize, size - stream.tell())
    count = shape[0] * shape[1]
    raw = np.frombuffer(stream.read(count * dtype.itemsize), dtype, count)
    return scaled(raw.reshape(shape, order="F" if fortran else "C"), factor)


def _npy(path: Path, factor: float) -> tuple[FloatArray, None, str]:
    with path.open("rb") as stream:
        return _read_array(path.name, stream, path.stat().st_size, factor), None, ""


def _npz(path: Path, factor: float) -> tuple[FloatArray, tuple[float, float] | None, str]:
    """The only two-dimensional array of an archive, ``pixel_um`` (y, x) where it has one, and its comment."""
    found: dict[str, FloatArray] = {}
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
                numbers = np.load(BytesIO(content), allow_pickle=False)
                pixel = (float(numbers[0]), float(numbers[1]))
            else:
                found[info.filename] = _read_array(
                    f"{path.name}/{info.filename}", BytesIO(content), len(content), factor
                )
    if len(found) != 1:
        refuse(path.name, "arrays", ", ".join(found)[:80] or "none", "one array of heights is expected")
    return next(iter(found.values())), pixel, comment


def read_array(
    path: Path | str, *, pixel_um: tuple[float, float] | None = None, z_unit: str = "um"
) -> HeightMap:
    """Read an npy or npz file: (rows, cols) heights, rows along y; NaN and infinity are missing.

    Args:
        path: the file. An npz archive holds one array, and may hold ``pixel_um`` (y, x).
        pixel_um: (y, x) pixel size in µm; needed for npy.
        z_unit: unit of the heights: um, nm, mm or m.

    Raises:
        HeightMapError: not readable, pickled objects, no pixel size, or implausible values.
    """
    path = Path(path)
    factor = micrometres_per(z_unit)
    packed = _starts_with_zip(path)
    try:
        height, noted, comment = _npz(path, factor) if packed else _npy(path, factor)
    except HeightMapError:
        raise
    except HEADER_TROUBLE as error:
        refuse(path.name, "numpy file", f"cannot be read ({error or type(error).__name__})", DAMAGED)
    pixel = require_pixel(path.name, pixel_um or noted)
    origin = {"format": "npz" if packed else "npy", "z_unit": z_unit}
    if comment:
        origin["comment"] = comment
    return checked_map(path.name, height, pixel, origin)


def _starts_with_zip(path: Path) -> bool:
    with path.open("rb") as stream:
        return stream.read(2) == b"PK"


def _add_comment(stream: BinaryIO, comment: str) -> None:
    if comment:
        with zipfile.ZipFile(stream, "a") as archive:
            archive.comment = comment.encode()


def write_array(surface: HeightMap, path: Path | str) -> None:
    """Write the heights in µm: npz with ``height_um`` and ``pixel_um`` (y, x), or npy without a pixel size.

    ``comment`` of the origin becomes the comment of the npz archive.

    Raises:
        HeightMapError: the file cannot be written.
    """
    path = Path(path)
    try:
        with path.open("w+b") as stream:
            if path.suffix.lower() == ".npz":
                pixel_um = np.array([surface.pixel_y_um, surface.pixel_x_um])
                np.savez_compressed(stream, height_um=surface.height_um, pixel_um=pixel_um)
                _add_comment(stream, str(surface.origin.get("comment", "")))
            else:
                np.save(stream, surface.height_um, allow_pickle=False)
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be written ({error.strerror})") from None
