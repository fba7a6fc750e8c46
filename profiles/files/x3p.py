"""Read x3p files: ISO 25178-72 (formerly ISO 5436-2), a zip container of ``main.xml`` and binary data.

Heights are metres in the file and µm here, rows in the order of the file, y rising with the row. Points are
missing where the validity mask says so (one bit a point, least significant bit first), where a float is not
finite, and where a text ``Datum`` is empty. Every size is checked against the file before it is allocated.

In ``main.xml`` Record1 describes the axes, Record2 the measurement, Record3 the size
and the place of the data, Record4 the checksum of this document. Lengths are metres.

A ``mask.png`` beside the data is not of the standard: programs for forensic surfaces (x3ptools, x3p.js) name regions by
its colours. It says nothing about validity, and only regions that the user names become missing points.

The document is read as a stream, so that a list of millions of ``Datum`` elements costs its text only.
A document type declaration is refused: it is the door to external entities and to entity bombs.
"""

import hashlib
import re
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path, PurePosixPath
from typing import Any
from xml.parsers import expat

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.files.checks import (
    DEFLATE_LIMIT,
    MAX_POINTS,
    check_claim,
    check_packing,
    checked_map,
    equidistant_step,
    passes,
    refuse,
)
from anisoscope.profiles.files.decoder_process import decode
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.x3p_write import MAX_DOCUMENT_BYTES, ULPS, add_ulps, listed_digest, write_x3p
from anisoscope.profiles.heightmap import HeightMap

DATA_TYPES = {"I": "<i2", "L": "<i4", "F": "<f4", "D": "<f8"}
EMPTY_TEXTS = {"", "n/a", "na", "none", "unknown", "not available", "nan"}
MAX_DEPTH = 32
MAX_FIELDS = 10_000
MAX_REGIONS = 1000


@dataclass(frozen=True)
class Axis:
    """One axis: incremental ("I": position = offset + index · increment) or absolute ("A").

    Increment and offset are metres; ``data_type`` is the numpy type of an absolute axis.
    """

    kind: str
    data_type: str
    increment: Decimal | None
    offset: Decimal


@dataclass(frozen=True)
class Header:
    """The content of ``main.xml`` that matters for a surface.

    Attributes:
        rows: number of points along y.
        cols: number of points along x.
        x: the x axis.
        y: the y axis.
        z: the z axis, always absolute.
        fields: all texts by their path, such as ``Record2/Instrument/Model``.
        datums: texts of the ``Datum`` elements where the data are in the document itself.
        annotations: (colour, name) of the regions of a ``mask.png``, as ``Record3/Mask/Annotations`` lists them.
    """

    rows: int
    cols: int
    x: Axis
    y: Axis
    z: Axis
    fields: Mapping[str, str]
    datums: list[str]
    annotations: Sequence[tuple[str, str]] = ()

    def metadata(self) -> dict[str, Any]:
        """Instrument, date and other metadata of the file."""
        instrument = {
            key.lower(): text
            for key in ("Manufacturer", "Model", "Serial", "Version")
            if (text := self.fields.get(f"Record2/Instrument/{key}", "")).lower() not in EMPTY_TEXTS
        }
        found: dict[str, Any] = {"instrument": instrument} if instrument else {}
        for key, path in (
            ("date", "Date"),
            ("calibration_date", "CalibrationDate"),
            ("creator", "Creator"),
            ("comment", "Comment"),
            ("probing", "ProbingSystem/Type"),
        ):
            text = self.fields.get(f"Record2/{path}", "")
            if text.lower() not in EMPTY_TEXTS:
                found[key] = text
        return found


class _Collector:
    """Gathers the text of every element by its path below the root, without namespaces."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.path: list[str] = []
        self.text: list[str] = []
        self.fields: dict[str, str] = {}
        self.datums: list[str] = []
        self.colour = ""
        self.annotations: list[tuple[str, str]] = []

    def start(self, tag: str, attributes: Mapping[str, str]) -> None:
        self.path.append(tag.rpartition(":")[2])
        self.colour = attributes.get("color", "")
        self.text.clear()
        if len(self.path) > MAX_DEPTH:
            refuse(self.name, "main.xml", f"nested deeper than {MAX_DEPTH} levels", "this is no x3p document")

    def characters(self, text: str) -> None:
        self.text.append(text)

    def end(self, _tag: str) -> None:
        text = "".join(self.text).strip()
        self.text.clear()
        path = "/".join(self.path[1:])
        self.path.pop()
        if path == "Record3/DataList/Datum":
            self.datums.append(text)
            if len(self.datums) > MAX_POINTS:
                refuse(self.name, "main.xml", "too many Datum elements", "crop the map")
        elif path == "Record3/Mask/Annotations/Annotation":
            if text and self.colour and len(self.annotations) < MAX_REGIONS:
                self.annotations.append((self.colour, text))
        elif len(self.fields) < MAX_FIELDS:
            self.fields.setdefault(path, text)

    def doctype(self, *_arguments: object) -> None:
        refuse(
            self.name,
            "main.xml",
            "has a document type declaration",
            "x3p files have none; not read for safety",
        )


def _parse(name: str, document: bytes) -> _Collector:
    collector = _Collector(name)
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = collector.start
    parser.EndElementHandler = collector.end
    parser.CharacterDataHandler = collector.characters
    parser.StartDoctypeDeclHandler = collector.doctype
    try:
        parser.Parse(document, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        refuse(name, "main.xml", f"is not well-formed XML ({error})", "the file is damaged; export it again")
    return collector


DATUM = re.compile(rb"<((?:[\w.-]+:)?)Datum>([^<&]*)</\1Datum>|<(?:[\w.-]+:)?Datum */>")
LIST = re.compile(rb"<(?:[\w.-]+:)?DataList>|</(?:[\w.-]+:)?DataList>")


def _cut_datums(document: bytes) -> tuple[bytes, list[str]]:
    """The document without its list of heights, and their texts; the whole document where the list is anything else.

    A million elements take a parser of XML ten seconds.
    """
    marks = list(LIST.finditer(document))
    if len(marks) != 2:
        return document, []
    start, end = marks[0].end(), marks[1].start()
    section = document[start:end]
    if not section.isascii() or DATUM.sub(b"", section).strip():
        return document, []
    texts = [found[1].decode("ascii").strip() for found in DATUM.findall(section)]
    return document[:start] + document[end:], texts


def _number(text: str) -> Decimal | None:
    try:
        number = Decimal(text)
    except InvalidOperation:
        return None
    return number if number.is_finite() else None


def _axis(name: str, fields: Mapping[str, str], key: str) -> Axis:
    path = f"Record1/Axes/{key}"
    kind = fields.get(f"{path}/AxisType", "A" if key == "CZ" else "I").upper()
    code = fields.get(f"{path}/DataType", "D").upper()
    if kind == "A" and code not in DATA_TYPES:
        refuse(name, f"data type of {key}", repr(code[:20]), "ISO 25178-72 knows I, L, F and D")
    if kind not in ("A", "I"):
        refuse(name, f"axis type of {key}", repr(kind[:20]), "ISO 25178-72 knows I and A")
    increment = _number(fields.get(f"{path}/Increment", ""))
    if kind == "I" and (key == "CZ" or increment is None or increment <= 0):
        shown = fields.get(f"{path}/Increment", "")[:40] or "none"
        refuse(
            name,
            f"increment of {key}",
            shown,
            "x and y need a positive one in metres, and z must be absolute",
        )
    return Axis(
        kind, DATA_TYPES.get(code, "<f8"), increment, _number(fields.get(f"{path}/Offset", "")) or Decimal(0)
    )


def _size(name: str, fields: Mapping[str, str], key: str) -> int:
    text = fields.get(f"Record3/MatrixDimension/{key}", "")
    if key == "SizeZ" and text.lower() in EMPTY_TEXTS:
        return 1
    if not (text.isascii() and text.isdigit() and len(text) <= 18):
        refuse(
            name, key, repr(text[:40]), "the number of points must be a whole number; export the file again"
        )
    return int(text)


def _check_rotation(name: str, fields: Mapping[str, str]) -> None:
    for row in "123":
        for column in "123":
            text = fields.get(f"Record1/Axes/Rotation/r{row}{column}")
            value = _number(text) if text is not None else Decimal(int(row == column))
            if value is None or abs(value - int(row == column)) > Decimal("1e-6"):
                refuse(
                    name,
                    f"rotation r{row}{column}",
                    text,
                    "rotated data are not read; export without a rotation",
                )


def read_header(name: str, document: bytes) -> Header:
    """Parse ``main.xml``.

    Args:
        name: name of the file, for messages.
        document: the bytes of ``main.xml``.

    Raises:
        HeightMapError: not XML, not an x3p document, no surface, or a description that cannot be used.
    """
    rest, datums = _cut_datums(document)
    collector = _parse(name, rest)
    fields = collector.fields
    if datums and "Record3/DataList" not in fields:  # the list stands in a comment
        collector = _parse(name, document)
        fields = collector.fields
    elif datums:
        collector.datums = datums
    if "Record1" not in fields or "Record3" not in fields:
        refuse(name, "main.xml", "Record1 or Record3 is missing", "this is no ISO 25178-72 file")
    feature = fields.get("Record1/FeatureType", "SUR")
    if feature != "SUR":
        refuse(
            name,
            "feature type",
            repr(feature[:20]),
            "only surfaces (SUR) are height maps, no profiles or clouds",
        )
    layers = _size(name, fields, "SizeZ")
    if layers != 1:
        refuse(name, "SizeZ", layers, "only single-layer surfaces are read; export one layer")
    _check_rotation(name, fields)
    x, y, z = (_axis(name, fields, key) for key in ("CX", "CY", "CZ"))
    if x.kind != y.kind:
        refuse(name, "axis types", f"{x.kind} for x and {y.kind} for y", "both must be I, or both A")
    return Header(
        _size(name, fields, "SizeY"), _size(name, fields, "SizeX"), x, y, z, fields, collector.datums,
        collector.annotations,
    )  # fmt: skip


def micrometres(name: str, what: str, metres: Decimal) -> float:
    """Metres as a decimal number in float64 µm; ``1.25E-6`` gives exactly 1.25.

    Raises:
        HeightMapError: the number is beyond float64.
    """
    try:
        return float(metres.scaleb(6))
    except (ArithmeticError, ValueError):
        raise HeightMapError(f"{name}: {what}: {metres} m is out of range; export the file again") from None


__all__ = ["read_x3p", "write_x3p"]

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


PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
MOST_PICTURES = 4


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

    def pictures(self, mask: zipfile.ZipInfo | None) -> list[str]:
        """Names of further pictures, such as a texture or a thumbnail, which are not of the standard."""
        return [
            "picture " + "".join(letter for letter in PurePosixPath(entry).name if letter.isprintable())[-60:]
            for entry, info in self.entries.items()
            if info is not mask and PurePosixPath(entry).suffix.lower() in PICTURES
        ][:MOST_PICTURES]

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
        check_packing(self.name, info.filename, info.file_size, info.compress_size)
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


MASK = "bindata/mask.png"
EVERY_POINT = "every point is read"
MASK_BACKGROUND = "#cd7f32"
MASK_BYTES_PER_POINT = 8
MASK_LEAST_BYTES = 2**20
STALE = "differs; the heights have a right one of their own"


def _check_document(container: Container, document: bytes, header: Header) -> str:
    """Compare ``main.xml`` with its checksum file and return the result.

    Programs that edit ``main.xml`` (a comment, a name) often leave its checksum as it was. Where the heights have one
    of their own, which is compared in any case, the user may let the stale one pass.
    """
    info = container.find(header.fields.get("Record4/ChecksumFile", "") or "md5checksum.hex")
    if info is None:
        return "no checksum file"
    content = container.read(info, MAX_CHECKSUM_BYTES).decode("ascii", "replace").split()
    if not content or not _is_md5(content[0]):
        refuse(container.name, info.filename, "holds no MD5 checksum", DAMAGED)
    found = hashlib.md5(document, usedforsecurity=False).hexdigest()
    if found == content[0].lower():
        return "verified"
    own = header.fields.get("Record3/DataLink/MD5ChecksumPointData", "")
    if _is_md5(own) and not header.datums:
        if passes("checksum", f"the MD5 of main.xml {STALE}"):
            return STALE
        advice = (
            "if main.xml was edited, read it with --trust checksum: the heights have a checksum of their own"
        )
    else:
        advice = DAMAGED
    return refuse(container.name, "MD5 of main.xml", f"{found} instead of {content[0].lower()}", advice)


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
    """Corrections in units in the last place that our writer adds to the heights in metres, or nothing."""
    info = container.find(ULPS)
    return b"" if info is None or info.file_size != count + 16 else container.read(info, count + 16)


def _colour(text: str) -> int | None:
    """A colour such as ``#1f376c`` or ``red`` as a number; None where it is none."""
    from PIL import ImageColor  # noqa: PLC0415 - slow to import

    try:
        red, green, blue = ImageColor.getrgb(text.strip())[:3]
    except ValueError:
        return None
    return red << 16 | green << 8 | blue


def _masked(
    container: Container, header: Header, link: zipfile.ZipInfo, regions: Sequence[str]
) -> tuple[npt.NDArray[np.bool_], str]:
    """(rows, cols) points of the named regions of a ``mask.png``, and what is noted about them.

    Its first row is the first row of the heights. ``all`` is whatever is neither background nor transparent.
    """
    name, count = container.name, header.rows * header.cols
    content = container.read(link, MASK_LEAST_BYTES + MASK_BYTES_PER_POINT * count)
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "mask.png"
        picture.write_bytes(content)
        raw = decode("colours", picture)[1]
    if raw.shape != (header.rows, header.cols):
        found = f"{raw.shape[0]} × {raw.shape[1]} points for {header.rows} × {header.cols}"
        refuse(name, link.filename, found, "leave --mask-from-x3p out, or write the mask anew")
    seen, colours = (raw & 0xFF) > 0, raw >> 8
    known = {text.casefold(): _colour(colour) for colour, text in header.annotations}
    background = _colour(header.fields.get("Record3/Mask/Background", "") or MASK_BACKGROUND)
    chosen = np.zeros(raw.shape, dtype=np.bool_)
    for region in regions:
        if region.casefold() == "all":
            here = seen & (colours != background)
        else:
            wanted = known.get(region.casefold(), _colour(region))
            here = seen & (colours == wanted) if wanted is not None else np.zeros_like(seen)
        if not here.any():
            listed = ", ".join(dict.fromkeys(text for _, text in header.annotations)) or "colours alone"
            advice = f"the mask has {listed}; name one of them, a colour such as #1f376c, or all"
            refuse(name, "mask", f"no point of a region {region!r}", advice)
        chosen |= here
    return chosen, f"{np.count_nonzero(chosen)} points of {', '.join(regions)} are missing points"


def read_x3p(path: Path | str, regions: Sequence[str] = ()) -> HeightMap:
    """Read the surface of an x3p file.

    Args:
        path: the file.
        regions: names or colours of regions of its ``mask.png`` that become missing points; "all" for every region.

    Returns:
        (rows, cols) heights in µm. ``origin`` holds instrument and date as far as given, and how the
        checksum of ``main.xml`` fared.

    Raises:
        HeightMapError: not readable, damaged (MD5, truncation), no surface, or implausible; no such region.
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
            link = container.find(header.fields.get("Record3/Mask/Link", "") or MASK)
            pictures = container.pictures(link)
            if regions and link is None:
                refuse(name, "mask", "the file has no mask.png", "leave --mask-from-x3p out")
            chosen, note = (
                (None, "") if not regions or link is None else _masked(container, header, link, regions)
            )
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
    if chosen is not None:
        height[chosen.ravel()] = np.nan
    pixel = _pixel_um(name, header, raw)
    origin = {"format": "x3p", "checksum": checked, **header.metadata()}
    if pictures:
        origin["not_read"] = pictures
    if endless := int(np.count_nonzero(np.isinf(raw["z"]))):
        origin["corrected"] = [f"{endless} infinite heights are missing points"]
    if link is not None:
        names = ", ".join(dict.fromkeys(text for _, text in header.annotations))
        origin["mask"] = (
            f"regions are marked in colours{f' ({names})' if names else ''}; {note or EVERY_POINT}"
        )
    grid = height.reshape(header.rows, header.cols)
    return checked_map(name, grid, pixel, origin, stage_height=True)


def _read(path: Path, given: FileScales) -> HeightMap:
    if given.pixel_um is not None:
        refuse(path.name, "units", "an x3p file states its own", "leave the pixel size and the unit out")
    return read_x3p(path, given.mask_regions)


X3P = Format("x3p", "ISO 25178-72 x3p", (".x3p",), _read, zip_member="main.xml", place=1)
