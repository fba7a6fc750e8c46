"""What the ``main.xml`` of an x3p file says.

ISO 25178-72 (formerly ISO 5436-2): Record1 describes the axes, Record2 the measurement, Record3 the size
and the place of the data, Record4 the checksum of this document. Lengths are metres.

The document is read as a stream, so that a list of millions of ``Datum`` elements costs its text only.
A document type declaration is refused: it is the door to external entities and to entity bombs.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import Any
from xml.parsers import expat

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.checks import MAX_POINTS, refuse

DATA_TYPES = {"I": "<i2", "L": "<i4", "F": "<f4", "D": "<f8"}
SAY_NOTHING = {"", "n/a", "na", "none", "unknown", "not available", "nan"}
MAX_DEPTH = 32
MAX_FIELDS = 10_000


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
    """

    rows: int
    cols: int
    x: Axis
    y: Axis
    z: Axis
    fields: Mapping[str, str]
    datums: list[str]

    def metadata(self) -> dict[str, Any]:
        """Instrument, date and the like, as far as the file says anything about them."""
        instrument = {
            key.lower(): text
            for key in ("Manufacturer", "Model", "Serial", "Version")
            if (text := self.fields.get(f"Record2/Instrument/{key}", "")).lower() not in SAY_NOTHING
        }
        found: dict[str, Any] = {"instrument": instrument} if instrument else {}
        for key, path in (
            ("date", "Date"),
            ("creator", "Creator"),
            ("comment", "Comment"),
            ("probing", "ProbingSystem/Type"),
        ):
            text = self.fields.get(f"Record2/{path}", "")
            if text.lower() not in SAY_NOTHING:
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

    def start(self, tag: str, _attributes: object) -> None:
        self.path.append(tag.rpartition(":")[2])
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
    if key == "SizeZ" and text.lower() in SAY_NOTHING:
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
    collector = _parse(name, document)
    fields = collector.fields
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
        _size(name, fields, "SizeY"), _size(name, fields, "SizeX"), x, y, z, fields, collector.datums
    )


def micrometres(name: str, what: str, metres: Decimal) -> float:
    """Metres as a decimal number in float64 µm; ``1.25E-6`` gives exactly 1.25.

    Raises:
        HeightMapError: the number is beyond float64.
    """
    try:
        return float(metres.scaleb(6))
    except (ArithmeticError, ValueError):
        raise HeightMapError(f"{name}: {what}: {metres} m is out of range; export the file again") from None
