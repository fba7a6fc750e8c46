"""Content of a code: text of a scanner or a camera without scanner prefixes, and GS1 element strings.

Scanners that act as keyboards may put an AIM symbology identifier in front (``]d2``), control characters around, and
the group separator of GS1 between. AIM identifiers: ISO/IEC 15424. Element strings and application identifiers, among
them 10 (batch or lot) and 21 (serial number): GS1 General Specifications, section 3 and 7.8.
"""

import re
from dataclasses import dataclass

from anisoscope.base.errors import UsageError

LOT, SERIAL = "10", "21"
GROUP = "\x1d"
_AIM = re.compile(r"\][A-Za-z][0-9A-Za-z]")
_GS1_MARKS = frozenset({"]d2", "]d5", "]C1", "]Q3", "]Q5", "]e0", "]J1"})
_SPELT_GROUP = re.compile(r"<GS>|\{GS\}|␝", re.IGNORECASE)
_PRINTED = re.compile(r"(?:\(\d{2,4}\)[^()]+)+")
_PRINTED_ELEMENT = re.compile(r"\((\d{2,4})\)([^()]+)")
# Length of the identifier by its first two digits; two where nothing else is said.
_IDENTIFIER_DIGITS = {
    **dict.fromkeys(("23", "24", "25", "40", "41", "42", "71"), 3),
    **dict.fromkeys(("31", "32", "33", "34", "35", "36", "39", "43", "70", "72", "80", "81", "82"), 4),
}
# Length of identifier and value together, where it is predefined; all others end at a group separator.
_WHOLE_LENGTH = {
    "00": 20,
    **dict.fromkeys(("01", "02", "03"), 16),
    "04": 18,
    **dict.fromkeys(("11", "12", "13", "14", "15", "16", "17", "18", "19"), 8),
    "20": 4,
    **dict.fromkeys(("31", "32", "33", "34", "35", "36"), 10),
    "41": 16,
}


@dataclass(frozen=True)
class Scan:
    """Parsed content of a code.

    Attributes:
        text: for people: without control characters; of GS1 with the identifiers in brackets.
        serial: the serial number: of GS1 that of identifier 21, else the whole text; None where there is none.
        lot: of GS1 that of identifier 10, else None.
        gs1: whether it was an element string of GS1.
    """

    text: str
    serial: str | None
    lot: str | None = None
    gs1: bool = False


def read_scan(raw: str) -> Scan:
    """Parse the text of a scanner, or one typed by a person.

    Args:
        raw: the text as it came; what a person types is taken as it is, blanks around it aside.

    Raises:
        UsageError: it is empty, or a GS1 element string that makes no sense.
    """
    text = raw.strip("".join(chr(n) for n in range(33) if chr(n) != GROUP) + "\x7f")
    mark = _AIM.match(text)
    if mark is not None:
        text = text[mark.end() :]
    text = _SPELT_GROUP.sub(GROUP, text).strip(GROUP) if GROUP in text or mark else text
    printed = "".join(sign for sign in text if sign == GROUP or sign.isprintable()).strip()
    if not printed.strip(GROUP):
        raise UsageError("the code is empty: scan it again, or type the serial number")
    if (mark is not None and mark.group() in _GS1_MARKS) or GROUP in printed:
        return _of_elements(_elements(printed))
    if _PRINTED.fullmatch(printed):
        return _of_elements(dict(_PRINTED_ELEMENT.findall(printed)))
    return Scan(printed, printed)


def _of_elements(elements: dict[str, str]) -> Scan:
    readable = "".join(f"({identifier}){value}" for identifier, value in elements.items())
    return Scan(readable, elements.get(SERIAL), elements.get(LOT), gs1=True)


def _elements(text: str) -> dict[str, str]:
    """Values by application identifier.

    Raises:
        UsageError: an identifier or a value is missing or cut off.
    """
    if _PRINTED.fullmatch(text):  # some scanners add the brackets themselves
        return dict(_PRINTED_ELEMENT.findall(text))
    found: dict[str, str] = {}
    rest = text.lstrip(GROUP)
    while rest:
        start = rest[:2]
        identifier = rest[: _IDENTIFIER_DIGITS.get(start, 2)]
        whole = _WHOLE_LENGTH.get(start)
        end = whole if whole is not None else (rest + GROUP).index(GROUP)
        value = rest[len(identifier) : end]
        cut = whole is not None and (len(rest) < whole or GROUP in value)
        if not (identifier.isascii() and identifier.isdigit()) or not value or cut:
            readable = text.replace(GROUP, "|")
            raise UsageError(
                f"the code is marked as GS1, but {readable[:48]!r} is cut off or no GS1 at {rest[:12]!r}"
            )
        found[identifier] = value
        rest = rest[end:].lstrip(GROUP)
    return found


def mismatch(place: str, serial: str | None, lot: str | None, scan: Scan) -> str | None:
    """Difference between a code and its slot; None where they agree.

    Args:
        place: where the part is, such as ``slot 3``.
        serial: serial number of the part that should be there, as far as it is said.
        lot: its lot, likewise.
        scan: what its code says.
    """
    if scan.serial is None:
        return f"{place}: the code {scan.text} holds no serial number (GS1 identifier 21)"
    if serial is not None and scan.serial != serial:
        return f"{place} should hold {serial}, its code reads {scan.serial}"
    if lot is not None and scan.lot is not None and scan.lot != lot:
        return f"{place} should hold lot {lot}, its code reads lot {scan.lot}"
    return None
