"""Read x3p files: ISO 25178-72 (formerly ISO 5436-2), a zip container of ``main.xml`` and binary data.

Heights are metres in the file and µm here, rows in the order of the file, y rising with the row. Points are
missing where the validity mask says so (one bit a point, least significant bit first), where a float is not
finite, and where a text ``Datum`` is empty. Every size is checked against the file before it is allocated.
"""

import hashlib
import struct
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.checks import DEFLATE_LIMIT, check_claim, checked_map, equidistant_step, refuse
from anisoscope.profiles.files.x3p_header import Header, micrometres, read_header
from anisoscope.profiles.files.x3p_write import ULPS, add_ulps, listed_digest, write_x3p
from anisoscope.profiles.heightmap import HeightMap

__all__ = ["read_x3p", "write_x3p"]

MAX_DOCUMENT_BYTES = 2**29
MAX_CHECKSUM_BYTES = 4096
ZIP_TROUBLE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    OSError,
    EOFError,
    ValueError,
    KeyError,
    IndexError,
    OverflowError,
    NotImplementedError,
    RuntimeError,
)
DAMAGED = "the file is damaged; copy or export it again"


class Container:
    """The entries of an x3p zip, found also below a top-level folder, and read within their limits."""

    def __init__(self, archive: zipfile.ZipFile, name: str) -> None:
        self.archive = archive
        self.name = name
        self.entries = {
            info.filename.replace("\\", "/").removeprefix("./"): info for info in archive.infolist()
        }
        mains = [entry for entry in self.entries if PurePosixPath(entry).name.lower() == "main.xml"]
        if not mains:
            refuse(name, "container", "holds no main.xml", "this is a zip file but no x3p file")
        self.main = min(mains, key=lambda entry: (entry.count("/"), entry))
        self.folder = self.main[: -len("main.xml")]

    def find(self, link: str) -> zipfile.ZipInfo | None:
        """The entry behind a link of ``main.xml``, or None."""
        link = link.replace("\\", "/").removeprefix("./").lstrip("/")
        return self.entries.get(self.folder + link, self.entries.get(link))

    def capacity(self, info: zipfile.ZipInfo) -> float:
        """Bytes that an entry can deliver at most, whatever it claims."""
        stored = min(info.compress_size, Path(str(self.archive.filename)).stat().st_size)
        return min(
            info.file_size, stored * (1 if info.compress_type == zipfile.ZIP_STORED else DEFLATE_LIMIT)
        )

    def read(self, info: zipfile.ZipInfo, limit: int) -> bytes:
        """The bytes of an entry, never more than ``limit`` of them.

        Raises:
            HeightMapError: the entry is larger, encrypted, or packed by an unusual method.
        """
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or info.flag_bits & 0x1:
            refuse(
                self.name, info.filename, "is encrypted or packed in an unusual way", "pack it with deflate"
            )
        if info.file_size > limit:
            refuse(
                self.name,
                info.filename,
                f"claims {info.file_size} bytes",
                f"{limit} are plausible; {DAMAGED}",
            )
        with self.archive.open(info) as stream:
            content = stream.read(limit + 1)
        if len(content) != info.file_size:
            refuse(self.name, info.filename, f"{len(content)} bytes instead of {info.file_size}", DAMAGED)
        return content


def _compare_md5(name: str, entry: str, content: bytes, expected: str) -> None:
    found = hashlib.md5(content, usedforsecurity=False).hexdigest()
    if found != expected.strip().lower():
        refuse(name, f"MD5 of {entry}", f"{found} instead of {expected.strip().lower()[:40]}", DAMAGED)


def _is_md5(text: str) -> bool:
    return len(text) == 32 and all(letter in "0123456789abcdefABCDEF" for letter in text)


def _check_document(container: Container, document: bytes, header: Header) -> str:
    """Compare ``main.xml`` with its checksum file, and say how that went."""
    info = container.find(header.fields.get("Record4/ChecksumFile", "") or "md5checksum.hex")
    if info is None:
        return "no checksum file"
    content = container.read(info, MAX_CHECKSUM_BYTES).decode("ascii", "replace").split()
    if not content or not _is_md5(content[0]):
        refuse(container.name, info.filename, "holds no MD5 checksum", DAMAGED)
    _compare_md5(container.name, "main.xml", document, content[0])
    return "verified"


def _linked(container: Container, header: Header, link: str, checksum: str, size: int) -> bytes:
    """The content of a binary entry of exactly ``size`` bytes, its checksum compared."""
    name = container.name
    path = header.fields.get(f"Record3/DataLink/{link}", "")
    info = container.find(path)
    if info is None:
        refuse(name, link, f"{path[:80]!r} is not in the container", DAMAGED)
    check_claim(name, header.rows, header.cols, size / (header.rows * header.cols), container.capacity(info))
    content = container.read(info, size)
    if len(content) != size:
        refuse(name, info.filename, f"{len(content)} bytes where {size} are due", DAMAGED)
    expected = header.fields.get(f"Record3/DataLink/{checksum}", "")
    if _is_md5(expected):
        _compare_md5(name, info.filename, content, expected)
    return content


def _binary(
    container: Container, header: Header
) -> tuple[dict[str, FloatArray], np.ndarray[Any, np.dtype[np.bool_]]]:
    """Raw coordinates by axis, each (rows · cols,), and the valid points."""
    absolute = [(key, axis.data_type) for key, axis in zip("xyz", (header.x, header.y, header.z), strict=True)
                if axis.kind == "A"]  # fmt: skip
    record = np.dtype(absolute)
    count = header.rows * header.cols
    content = _linked(container, header, "PointDataLink", "MD5ChecksumPointData", count * record.itemsize)
    points = np.frombuffer(content, record)
    raw = {key: points[key].astype(np.float64) for key, _ in absolute}
    valid = np.isfinite(raw["z"])
    if header.fields.get("Record3/DataLink/ValidPointsLink"):
        packed = _linked(container, header, "ValidPointsLink", "MD5ChecksumValidPoints", (count + 7) // 8)
        valid &= np.unpackbits(np.frombuffer(packed, np.uint8), count=count, bitorder="little").astype(bool)
    return raw, valid


def _listed(name: str, header: Header) -> tuple[dict[str, FloatArray], np.ndarray[Any, np.dtype[np.bool_]]]:
    """The same from the ``Datum`` texts: ``z``, or ``x;y;z``; an empty one is a missing point."""
    count = header.rows * header.cols
    if len(header.datums) != count:
        refuse(
            name, "DataList", f"{len(header.datums)} points instead of {header.rows} × {header.cols}", DAMAGED
        )
    raw = {key: np.full(count, np.nan) for key in ("xyz" if header.x.kind == "A" else "z")}
    for index, text in enumerate(header.datums):
        if not text:
            continue
        parts = text.split(";")
        try:
            numbers = [float(part) for part in parts]
        except ValueError:
            refuse(name, f"Datum {index + 1}", repr(text[:40]), "numbers separated by ; are expected")
        if len(numbers) not in ({3} if "x" in raw else {1, 3}):
            refuse(name, f"Datum {index + 1}", repr(text[:40]), "z or x;y;z is expected")
        for key, number in zip(reversed(raw), reversed(numbers), strict=False):
            raw[key][index] = number
    return raw, np.isfinite(raw["z"])


def _heights_um(name: str, header: Header, raw: FloatArray) -> FloatArray:
    integer = header.z.data_type in ("<i2", "<i4")
    increment = header.z.increment
    if integer and (increment is None or increment == 0):
        refuse(name, "increment of CZ", increment, "integer heights need their step in metres")
    scale = float(increment) if increment else 1.0
    offset = float(header.z.offset)
    with np.errstate(over="ignore", invalid="ignore"):
        metres = raw if scale == 1.0 and offset == 0.0 else raw * scale + offset
        height: FloatArray = metres * 1e6
    return height


def _pixel_um(name: str, header: Header, raw: dict[str, FloatArray]) -> tuple[float, float]:
    """(y, x) pixel size in µm, from the increments, or from the positions of absolute axes."""
    found = []
    for key, axis, across in (("y", header.y, 1), ("x", header.x, 0)):
        if axis.increment is not None and axis.kind == "I":
            found.append(micrometres(name, f"increment of {key}", axis.increment))
            continue
        integer = axis.data_type in ("<i2", "<i4")
        scale = float(axis.increment) if integer and axis.increment else 1.0
        grid = raw[key].reshape(header.rows, header.cols) * scale * 1e6
        known = ~np.isnan(grid).all(axis=across)
        if not known.all():
            refuse(
                name, f"{key} axis", "a whole line has no positions", "export the map with incremental axes"
            )
        positions = np.nanmedian(grid, axis=across)
        found.append(equidistant_step(name, key, positions))
        spread = float(np.nanmax(np.abs(grid - np.expand_dims(positions, across))))
        if not spread <= 0.05 * found[-1]:
            refuse(name, f"{key} axis", f"positions spread by {spread:.4g} µm", "resample to a regular grid")
    return found[0], found[1]


def _ulps(container: Container, count: int) -> bytes:
    """What our writer notes beside the metres, or nothing."""
    info = container.find(ULPS)
    return b"" if info is None or info.file_size != count + 16 else container.read(info, count + 16)


def read_x3p(path: Path | str) -> HeightMap:
    """Read the surface of an x3p file.

    Returns:
        (rows, cols) heights in µm. ``origin`` holds instrument and date as far as given, and how the
        checksum of ``main.xml`` fared.

    Raises:
        HeightMapError: not readable, damaged (MD5, truncation), no surface, or implausible.
    """
    path = Path(path)
    name = path.name
    try:
        with zipfile.ZipFile(path) as archive:
            container = Container(archive, name)
            info = container.entries[container.main]
            document = container.read(info, int(min(MAX_DOCUMENT_BYTES, container.capacity(info) + 1)))
            header = read_header(name, document)
            checked = _check_document(container, document, header)
            check_claim(name, header.rows, header.cols, 0, 0)
            raw, valid = _listed(name, header) if header.datums else _binary(container, header)
            ulps = _ulps(container, raw["z"].size)
    except HeightMapError:
        raise
    except ZIP_TROUBLE as error:
        refuse(name, "container", f"cannot be read ({error or type(error).__name__})", DAMAGED)
    height = _heights_um(name, header, raw["z"])
    if ulps:
        checksum = header.fields.get("Record3/DataLink/MD5ChecksumPointData", "")
        linked = _is_md5(checksum) and not header.datums
        add_ulps(height, ulps, bytes.fromhex(checksum) if linked else listed_digest(raw["z"]))
    if not valid.all():
        height[~valid] = np.nan
    pixel = _pixel_um(name, header, raw)
    origin = {"format": "x3p", "checksum": checked, **header.metadata()}
    grid = height.reshape(header.rows, header.cols)
    return checked_map(name, grid, pixel, origin, stage_height=True)
