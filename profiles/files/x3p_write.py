"""Write x3p files: ISO 25178-72 (formerly ISO 5436-2).

Heights are stored as float64 metres. Metres cannot hold every float64 number of µm, so the writer picks, of
the neighbours of z · 10⁻⁶, the one that reads back as z where there is one. Where there is none, metres read
back 1 unit in the last place off; those units go into an entry of our own, ``anisoscope/ulps.bin``, which
other programs ignore and :func:`~anisoscope.profiles.files.x3p.read_x3p` adds. Pixel sizes are decimal text.
"""

import contextlib
import hashlib
import html
import zipfile
import zlib
from datetime import datetime
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.base.parallel import for_each
from anisoscope.profiles.heightmap import HeightMap, row_blocks

NAMESPACE = "http://www.opengps.eu/2008/ISO5436_2"
ULPS = "anisoscope/ulps.bin"
PACKING_LEVEL = 1
BLOCK_BYTES = 2**22
SAMPLE_BYTES = 2**18
SAMPLED = (0.1, 0.3, 0.5, 0.7, 0.9)
WORTH = 0.7
UNKNOWN = "not available"
Buffer = bytes | memoryview
INSTRUMENT = ("manufacturer", "model", "serial", "version")
MAX_DOCUMENT_BYTES = 2**24
ENTRY_DATE = (1980, 1, 1, 0, 0, 0)


def to_metres(height_um: FloatArray) -> FloatArray:
    """Metres that read back (times 10⁶) as the given µm, bit for bit where float64 allows it."""
    metres = np.empty(height_um.shape)
    for block in row_blocks(height_um.shape):
        given, part = height_um[block], metres[block]
        np.divide(given, 1e6, out=part)
        for toward in (np.inf, -np.inf):
            wrong = part * 1e6 != given
            neighbour = np.nextafter(part[wrong], toward)
            part[wrong] = np.where(neighbour * 1e6 == given[wrong], neighbour, part[wrong])
    return metres


def _known(metres: FloatArray) -> FloatArray:
    return np.where(np.isfinite(metres), metres, 0.0)


def ulps_entry(height_um: FloatArray, metres: FloatArray, digest: bytes) -> dict[str, bytes]:
    """Archive entry for :func:`add_ulps`: checksum of the data, and for each height int8 units in the last place."""
    found = np.empty(height_um.shape, dtype=np.int8)
    for block in row_blocks(height_um.shape):
        read_back, target = _known(metres[block]) * 1e6, _known(height_um[block])
        ulps = target.view(np.int64) - read_back.view(np.int64)
        ulps[np.abs(ulps) > 127] = 0
        found[block] = ulps
    return {ULPS: digest + found.tobytes()} if found.any() else {}


def add_ulps(height_um: FloatArray, entry: bytes, digest: bytes) -> None:
    """Add the units in the last place to heights just read, in place, if they belong to these data."""
    if len(entry) == 16 + height_um.size and entry[:16] == digest:
        bits = height_um.view(np.int64)
        bits += np.frombuffer(entry, np.int8, height_um.size, 16).reshape(height_um.shape)


def listed_digest(metres: FloatArray) -> bytes:
    """Checksum of heights within ``main.xml``."""
    return hashlib.md5(_known(metres).tobytes(), usedforsecurity=False).digest()


def _element(tag: str, *content: str) -> str:
    return f"<{tag}>{''.join(content)}</{tag}>"


def _text(tag: str, value: object) -> str:
    printable = "".join(letter if letter.isprintable() else " " for letter in str(value))
    return _element(tag, html.escape(" ".join(printable.split()), quote=False))


def _axes(surface: HeightMap) -> str:
    def incremental(key: str, pixel_um: float) -> str:
        step = Decimal(repr(float(pixel_um))).scaleb(-6)
        return _element(
            key,
            _text("AxisType", "I"),
            _text("DataType", "D"),
            _text("Increment", f"{step:E}"),
            _text("Offset", 0),
        )

    height = _element("CZ", _text("AxisType", "A"), _text("DataType", "D"))
    return _element(
        "Axes", incremental("CX", surface.pixel_x_um), incremental("CY", surface.pixel_y_um), height
    )


def _dates(origin: dict[str, Any], key: str, tag: str) -> str:
    try:
        return _text(tag, datetime.fromisoformat(str(origin.get(key))).isoformat())
    except ValueError:
        return ""


def _record2(origin: dict[str, Any]) -> str:
    """Known data of the measurement; unknown ones are left out or marked, and never made up."""
    given = origin.get("instrument")
    instrument = given if isinstance(given, dict) else {}
    probing = origin.get("probing")
    known = [_text(key.capitalize(), instrument.get(key, UNKNOWN)) for key in INSTRUMENT]
    return _element(
        "Record2",
        _dates(origin, "date", "Date"),
        _text("Creator", origin["creator"]) if origin.get("creator") else "",
        _element("Instrument", *known),
        _dates(origin, "calibration_date", "CalibrationDate"),
        _element("ProbingSystem", _text("Type", probing), _text("Identification", UNKNOWN))
        if probing
        else "",
        _text("Comment", origin.get("comment", "")),
    )


def _record3(surface: HeightMap, data: str) -> str:
    rows, cols = surface.shape
    size = _element("MatrixDimension", _text("SizeX", cols), _text("SizeY", rows), _text("SizeZ", 1))
    return _element("Record3", size, data)


def _md5(content: Buffer) -> str:
    return hashlib.md5(content, usedforsecurity=False).hexdigest()


def _linked(metres: FloatArray) -> tuple[str, dict[str, Buffer], bytes]:
    """Reference to binary data, the entries that it points to, and the checksum of the data."""
    valid = np.isfinite(metres)
    points = metres.astype("<f8", copy=False).data.cast("B")
    mask = np.packbits(valid.ravel(), bitorder="little").tobytes()
    checksum = _md5(points)
    link = _element(
        "DataLink",
        _text("PointDataLink", "bindata/data.bin"),
        _text("MD5ChecksumPointData", checksum.upper()),
        *([] if valid.all() else [_text("ValidPointsLink", "bindata/valid.bin")]),
        *([] if valid.all() else [_text("MD5ChecksumValidPoints", _md5(mask).upper())]),
    )
    entries: dict[str, Buffer] = {"bindata/data.bin": points}
    return link, entries | ({} if valid.all() else {"bindata/valid.bin": mask}), bytes.fromhex(checksum)


def _listed(metres: FloatArray) -> tuple[str, dict[str, Buffer], bytes]:
    """The heights as numbers in the document, no entries, and a checksum; a missing point is an empty element."""
    texts = np.where(np.isfinite(metres), metres, 0.0).ravel().tolist()
    known = np.isfinite(metres).ravel().tolist()
    datums = (_text("Datum", repr(z) if valid else "") for z, valid in zip(texts, known, strict=True))
    return _element("DataList", *datums), {}, listed_digest(metres)


def write_x3p(surface: HeightMap, path: Path | str, *, text: bool = False) -> None:
    """Write a map, (rows, cols) in µm, as x3p; missing points are NaN and marked in the validity mask.

    Args:
        surface: the map; ``instrument``, ``date`` and ``comment`` of its origin go into the file.
        path: file to write.
        text: put the heights into ``main.xml`` as a list of numbers instead of binary data.

    Raises:
        HeightMapError: the file cannot be written.
    """
    metres = to_metres(surface.height_um)
    data, entries, digest = (_listed if text else _linked)(metres)
    entries |= ulps_entry(surface.height_um, metres, digest)
    document = (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<p:ISO5436_2 xmlns:p="{NAMESPACE}" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" '
        f'xsi:schemaLocation="{NAMESPACE} {NAMESPACE}/ISO5436_2.xsd">\n'
        + "\n".join(
            (
                _element(
                    "Record1",
                    _text("Revision", "ISO5436 - 2000"),
                    _text("FeatureType", "SUR"),
                    _axes(surface),
                ),
                _record2(surface.origin),
                _record3(surface, data),
                _element("Record4", _text("ChecksumFile", "md5checksum.hex")),
            )
        )
        + "\n</p:ISO5436_2>\n"
    ).encode()
    if len(document) > MAX_DOCUMENT_BYTES:
        raise HeightMapError(
            f"{path}: main.xml with all heights as text takes {len(document)} bytes, and more than "
            f"{MAX_DOCUMENT_BYTES} are not read again; write them as binary data"
        )
    entries = {"main.xml": document, "md5checksum.hex": f"{_md5(document)} *main.xml\n".encode(), **entries}
    path = Path(path)
    partial = path.with_name(f".{path.name}.partial")
    try:
        with zipfile.ZipFile(partial, "w") as archive:
            for name, content in entries.items():
                if _worth_packing(content):
                    _add_packed(archive, name, content)
                else:
                    archive.writestr(zipfile.ZipInfo(name, ENTRY_DATE), content)
        partial.replace(path)
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be written ({error.strerror})") from None
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


def _add_packed(archive: zipfile.ZipFile, name: str, content: Buffer) -> None:
    """Add an entry that is packed by several threads: zipfile itself packs in one.

    Blocks of the content are packed alone and end at a whole byte; one after the other they are one deflate stream.
    """
    starts = range(0, max(len(content), 1), BLOCK_BYTES)

    def packed(start: int) -> bytes:
        packer = zlib.compressobj(PACKING_LEVEL, zlib.DEFLATED, -zlib.MAX_WBITS)
        part = packer.compress(content[start : start + BLOCK_BYTES])
        return part + packer.flush(
            zlib.Z_FINISH if start + BLOCK_BYTES >= len(content) else zlib.Z_FULL_FLUSH
        )

    parts = for_each(packed, starts)
    info = zipfile.ZipInfo(name, ENTRY_DATE)
    info.compress_type, info.CRC = zipfile.ZIP_DEFLATED, zlib.crc32(content)
    info.file_size, info.compress_size = len(content), sum(map(len, parts))
    info.header_offset, info.external_attr = archive.start_dir, 0o600 << 16
    assert archive.fp is not None
    archive.fp.seek(archive.start_dir)
    for part in (info.FileHeader(), *parts):
        archive.fp.write(part)
    archive.start_dir = archive.fp.tell()
    archive.filelist.append(info)
    archive.NameToInfo[name] = info


def _worth_packing(content: Buffer) -> bool:
    """Whether pieces of a long content pack to less than 70 %; the last places of measured heights do not."""
    if len(content) <= len(SAMPLED) * SAMPLE_BYTES:
        return True
    starts = (int(share * (len(content) - SAMPLE_BYTES)) for share in SAMPLED)
    sample = b"".join(content[start : start + SAMPLE_BYTES] for start in starts)
    return len(zlib.compress(sample, PACKING_LEVEL)) < WORTH * len(sample)
