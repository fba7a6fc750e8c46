"""Commands and replies of the Zaber ASCII protocol as the device sees them, and its warning flags."""

import re
from dataclasses import dataclass
from typing import Self

from anisoscope.base.errors import UsageError

NO_REPLY = "--"
# What a warning flag can be, the gravest first; a fault with a number as its parameter counts in this list from 1.
FLAGS = ("FF", "FS", "FE", "FQ", "FI", "FA", "FT", "FP", "FO", "FD", "FM", "FV", "FR", "FH", "FC")
MILD_FLAGS = ("WL", "WV", "WT", "WS", "WM", "WR", "NC", "NI")
# These cut the motor off until the driver is enabled again.
CUTTING = frozenset({"FF", "FO", "FD", "FM", "FV", "FR", "FH", "FC"})
# Reasons of rejection; a fault with a number from 101 counts in this list from 101.
REASONS = (
    "BADDATA",
    "BADCOMMAND",
    "PARKED",
    "NOACCESS",
    "REMOTE",
    "LOCKSTEP",
    "INACTIVE",
    "FULL",
    "DRIVERDISABLED",
)
FIRST_REASON = 101
_LINE = re.compile(rb"/(?P<body>[^:]*)(?::(?P<lrc>[0-9A-Fa-f]{2}))?")


def lrc(body: bytes) -> int:
    """The checksum of a message: what makes the sum of its bytes zero, modulo 256."""
    return (0x100 - sum(body) % 0x100) % 0x100


@dataclass(frozen=True)
class Command:
    """One command; device 0 is everybody, axis 0 the device as a whole, and number "" is none."""

    device: int
    axis: int
    number: str
    words: tuple[str, ...]
    checked: bool

    @classmethod
    def parse(cls, line: bytes) -> Self | None:
        """Read a line without its end; None if it is no command, or its checksum is wrong."""
        start = line.rfind(b"/")
        match = _LINE.fullmatch(line[start:]) if start >= 0 else None
        if match is None:
            return None
        body = match["body"]
        if match["lrc"] is not None and int(match["lrc"], 16) != lrc(body):
            return None
        words = body.decode("ascii", errors="replace").split()
        device, axis = (int(words.pop(0)) if words and words[0].isdecimal() else 0 for _ in range(2))
        number = words.pop(0) if words and (words[0].isdecimal() or words[0] == NO_REPLY) else ""
        return cls(device, axis, number, tuple(words), match["lrc"] is not None)


def frame(kind: str, body: str, *, checked: bool) -> bytes:
    """A whole message to the host: ``@`` reply, ``#`` information, ``!`` alert."""
    data = body.encode("ascii", errors="replace")
    return kind.encode("ascii") + data + (b":%02X" % lrc(data) if checked else b"") + b"\r\n"


def flag_of_number(number: float) -> str:
    """The flag that a number as the parameter of a fault stands for.

    Raises:
        UsageError: there is none.
    """
    if not 1 <= number <= len(FLAGS):
        raise UsageError(f"a Zaber stage has no fault {number:g}; choose 1…{len(FLAGS)}: {', '.join(FLAGS)}")
    return FLAGS[int(number) - 1]


def error_of_number(number: float) -> tuple[str, str]:
    """The flag that a motion ends with, and the reason why it is rejected; both empty for 0.

    Raises:
        UsageError: a number that stands for neither.
    """
    place = int(number) - FIRST_REASON
    if place >= len(REASONS):
        raise UsageError(
            f"a Zaber stage has no reason {number:g} to reject a motion; choose {FIRST_REASON}…"
            f"{FIRST_REASON + len(REASONS) - 1}: {', '.join(REASONS)}"
        )
    if place >= 0:
        return "", REASONS[place]
    return (flag_of_number(number), "") if number else ("", "")
