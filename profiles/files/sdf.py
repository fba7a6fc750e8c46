"""Read sdf files: ISO 25178-71, text (aISO) and binary (bISO), and their predecessor BCR (EUNA 15178).

Record 1 is the header, record 2 the heights, profile after profile along y, record 3 free text. Lengths are
metres; a height is the stored number times Zscale. Not measured is ``BAD`` in text, and in binary data the
smallest number of the type in ISO, the largest in BCR (which alone has unsigned types). The first profile lies
at y = 0 in ISO, at the top in BCR. Binary numbers are little-endian; the counts of points take two bytes each,
four in ISO-2.0. These rules agree with those of ``sdfio`` 2.0 (MIT licence, github.com/aschet/sdfio).
"""

import struct
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.files.checks import check_claim, checked_map, refuse
from anisoscope.profiles.files.content import DAMAGED, Content, load_content, scaled
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.units import stated_or_given_pixel
from anisoscope.profiles.heightmap import HeightMap

VERSIONS = ("ISO-1.0", "ISO-2.0", "BCR-1.0")
COUNTS = {"ISO-1.0": "<HH", "ISO-2.0": "<II", "BCR-1.0": "<HH"}
KINDS = {0: "<u1", 1: "<u2", 2: "<u4", 3: "<f4", 4: "<i1", 5: "<i2", 6: "<i4", 7: "<f8"}
MAX_HEADER_TEXT = 65536
LARGE = 1e300
LARGE_SINGLE = 3e38


@dataclass(frozen=True)
class _Header:
    """Record 1; the scales are metres."""

    cols: int
    rows: int
    scale_x: float
    scale_y: float
    scale_z: float
    compression: int
    data_type: int
    check_type: int
    manufacturer: str
    date: str


def _binary_header(content: Content, version: str) -> tuple[_Header, int]:
    """The header, and where record 2 begins."""
    layout = COUNTS[version]
    cols, rows = content.numbers(layout, 42)
    end = 42 + struct.calcsize(layout)
    x, y, z, _resolution, compression, data_type, check = content.numbers("<4dBBB", end)
    manufacturer, date = content.text(8, 10), content.text(18, 12)
    header = _Header(cols, rows, x, y, z, compression, data_type, check, manufacturer, date)
    return header, end + struct.calcsize("<4dBBB")


def _text_header(content: Content) -> tuple[_Header, int]:
    """The header, and where record 2 begins."""
    end = content.data.find(b"*", 0, MAX_HEADER_TEXT)
    if end < 0:
        refuse(content.name, "header", "has no end mark *", DAMAGED)
    fields: dict[str, str] = {}
    for line in content.data[:end].decode("latin-1").splitlines()[1:]:
        key, _, value = line.partition(";")[0].partition("=")
        if not value:
            key, _, value = line.strip().partition(" ")
        fields[key.strip().lower()] = value.strip()

    def number(key: str, kind: type[int] | type[float]) -> Any:  # noqa: ANN401 - int or float as asked
        text = fields.get(key.lower(), "")
        try:
            return kind(text)
        except ValueError:
            refuse(content.name, key, repr(text[:40]), DAMAGED)

    header = _Header(
        number("NumPoints", int), number("NumProfiles", int),
        number("Xscale", float), number("Yscale", float), number("Zscale", float),
        number("Compression", int), number("DataType", int), number("CheckType", int),
        fields.get("manufacid", "")[:80], fields.get("createdate", ""),
    )  # fmt: skip
    return header, end + 1


def _heights(raw: npt.NDArray[Any], header: _Header, version: str) -> FloatArray:
    """Heights in µm from the stored numbers; of floating-point types, marks of missing points are left in."""
    kind, missing = np.dtype(KINDS[header.data_type]), None
    if kind.kind != "f":
        limits = np.iinfo(kind)
        smallest = kind.kind == "i" and version.startswith("ISO")
        missing = raw == (limits.min if smallest else limits.max)
    return scaled(raw, header.scale_z * 1e6, missing)


def _binary_heights(content: Content, header: _Header, start: int, version: str) -> FloatArray:
    raw = content.grid(KINDS[header.data_type], header.rows, header.cols, start)
    return _heights(raw, header, version)


def _text_heights(content: Content, header: _Header, start: int, version: str) -> FloatArray:
    check_claim(content.name, header.rows, header.cols, 2, len(content) - start)
    end = content.data.find(b"*", start)
    if end < 0:
        refuse(content.name, "record 2", "has no end mark *", DAMAGED)
    tokens = content.data[start:end].split()
    if len(tokens) != header.rows * header.cols:
        found = f"{len(tokens)} heights instead of {header.rows} × {header.cols}"
        refuse(content.name, "record 2", found, DAMAGED)
    try:
        raw = np.array([np.nan if token.upper() == b"BAD" else float(token) for token in tokens])
    except ValueError as error:
        refuse(content.name, "record 2", str(error), DAMAGED)
    raw[np.abs(raw) > LARGE] = np.nan
    return _heights(raw.reshape(header.rows, header.cols), header, version)


def _check_header(name: str, header: _Header) -> None:
    if header.compression != 0 or header.check_type != 0:
        refuse(
            name,
            "compression and check type",
            f"{header.compression} and {header.check_type}",
            "ISO 25178-71 knows only 0",
        )
    if header.data_type not in KINDS:
        refuse(name, "data type", header.data_type, "ISO 25178-71 knows 0 to 7")
    if not (np.isfinite(header.scale_z) and header.scale_z > 0):
        refuse(name, "Zscale", header.scale_z, "it must be a positive number")


def _iso_date(text: str) -> str:
    try:
        return datetime.strptime(text, "%d%m%Y%H%M").isoformat()  # noqa: DTZ007 - the format has no zone
    except ValueError:
        return ""


def read_sdf(path: Path | str, given: FileScales | None = None) -> HeightMap:
    """Read an sdf file.

    Returns:
        (rows, cols) heights in µm, rows in the order of the profiles.

    Raises:
        HeightMapError: not sdf, damaged, or implausible.
    """
    path = Path(path)
    content = load_content(path)
    text, version = content.text(0, 1), content.text(1, 7)
    if text not in ("a", "b") or version not in VERSIONS:
        refuse(content.name, "version", repr(text + version), "this is no ISO 25178-71 file")
    header, start = _text_header(content) if text == "a" else _binary_header(content, version)
    _check_header(content.name, header)
    read = _text_heights if text == "a" else _binary_heights
    height = read(content, header, start, version)
    stated = (header.scale_y * 1e6, header.scale_x * 1e6)
    pixel = stated_or_given_pixel(content.name, stated, given.pixel_um if given else None)
    origin: dict[str, Any] = {"format": "sdf", "version": text + version}
    if version.startswith("BCR"):
        origin["first_row"] = "top"
    if header.manufacturer:
        origin["instrument"] = {"manufacturer": header.manufacturer}
    if date := _iso_date(header.date):
        origin["date"] = date
    single = KINDS[header.data_type] == "<f4"
    beyond_um = (LARGE_SINGLE if single else LARGE) * header.scale_z * 1e6
    return checked_map(content.name, height, pixel, origin, stage_height=True, beyond_um=beyond_um)


_SIGNATURES = tuple((0, f"{kind}{version}".encode()) for version in VERSIONS for kind in "ab")
SDF = Format("sdf", "ISO 25178-71 sdf", (".sdf",), read_sdf, _SIGNATURES, place=2)
