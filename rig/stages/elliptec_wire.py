"""The bytes of the Thorlabs Elliptec protocol: positions, answers, device information, status codes.

A command is ``<address><two lower-case letters><hex arguments>`` without terminator; an answer is
``<address><two upper-case letters><hex data>`` and CR LF. Source: Thorlabs ELLx protocol manual, and the
answers of real devices.
"""

import re
from dataclasses import dataclass
from typing import Self

from anisoscope.base.errors import LimitExceeded, MotionTimeout, ProtocolError, RigError, Stalled

TERMINATOR = b"\r\n"
ADDRESSES = "0123456789ABCDEF"
OK = 0
BUSY = 9
DATA_LENGTHS = {"IN": 30, "GS": 2, "PO": 8, "BO": 8, "HO": 8, "GJ": 8, "GV": 2, "BS": 2, "I1": 22, "I2": 22}
UNSOLICITED = frozenset({"BO", "BS"})
LINEAR_TYPES = frozenset({6, 7, 9, 10, 12, 17, 20})
STATUS_TEXTS = {
    0: "ok",
    1: "communication time-out",
    2: "mechanical time-out",
    3: "command error or not supported",
    4: "value out of range",
    5: "module isolated",
    6: "module out of isolation",
    7: "initialising error",
    8: "thermal error",
    9: "busy",
    10: "sensor error",
    11: "motor error",
    12: "out of range",
    13: "over-current",
}
_STATUS_ERRORS: dict[int, type[RigError]] = {
    1: ProtocolError,
    2: Stalled,
    3: ProtocolError,
    4: LimitExceeded,
    8: Stalled,
    9: MotionTimeout,
    10: Stalled,
    11: Stalled,
    12: LimitExceeded,
    13: Stalled,
}
_ANSWER = re.compile(rb"([0-9A-F])([A-Z][A-Z12])([0-9A-F]*)$")


@dataclass(frozen=True)
class Answer:
    """One answer: who speaks, what about (two letters), and the hex digits of the data."""

    address: str
    code: str
    data: str

    @classmethod
    def parse(cls, line: bytes) -> Self | None:
        """Read an answer from the end of a line; None if the line is damaged.

        NUL bytes and whatever stands before the answer (line noise at power-up) are ignored.
        """
        match = _ANSWER.search(line.replace(b"\0", b"").strip())
        if match is None:
            return None
        address, code, data = (group.decode("ascii") for group in match.groups())
        return cls(address, code, data) if len(data) == DATA_LENGTHS.get(code) else None

    @property
    def status(self) -> int | None:
        """The status code if this is a GS answer."""
        return int(self.data, 16) if self.code == "GS" else None

    @property
    def counts(self) -> int:
        """The data as a signed position in counts."""
        return counts_from_hex(self.data)


@dataclass(frozen=True)
class DeviceInfo:
    """What a device says about itself.

    Attributes:
        model: type number; 14 is an ELL14.
        serial: serial number.
        year: year of manufacture.
        firmware: firmware release, two hex digits.
        travel_deg: travel in degrees.
        pulses: encoder counts over the travel.
    """

    model: int
    serial: str
    year: str
    firmware: str
    travel_deg: int
    pulses: int

    @classmethod
    def parse(cls, data: str) -> Self:
        """Read the 30 hex digits of an IN answer.

        Raises:
            ProtocolError: the numbers cannot be those of a rotation stage.
        """
        info = cls(
            model=int(data[0:2], 16),
            serial=data[2:10],
            year=data[10:14],
            firmware=data[14:16],
            travel_deg=int(data[18:22], 16),
            pulses=int(data[22:30], 16),
        )
        if info.pulses <= 0 or info.travel_deg <= 0:
            raise ProtocolError(
                f"the stage claims {info.pulses} counts over {info.travel_deg}°; is it an Elliptec?"
            )
        if info.model in LINEAR_TYPES:
            raise ProtocolError(
                f"an ELL{info.model} is not a rotation stage; name the port of a rotation stage"
            )
        return info

    @property
    def counts_per_deg(self) -> float:
        """Encoder counts for one degree."""
        return self.pulses / self.travel_deg


def counts_to_hex(counts: int) -> str:
    """Write a signed position as eight hex digits, two's complement, most significant first.

    Raises:
        LimitExceeded: the number does not fit into 32 bits.
    """
    if not -(1 << 31) <= counts < 1 << 31:
        raise LimitExceeded(f"{counts} counts do not fit into the 32 bits of the Elliptec protocol")
    return f"{counts & 0xFFFFFFFF:08X}"


def counts_from_hex(digits: str) -> int:
    """Read a signed position from eight hex digits."""
    value = int(digits, 16)
    return value - (1 << 32) if value >= 1 << 31 else value


def error_of_status(name: str, status: int, doing: str) -> RigError:
    """Return the error that a status code other than 0 stands for."""
    text = STATUS_TEXTS.get(status, "a status this driver does not know")
    kind = _STATUS_ERRORS.get(status, RigError)
    return kind(f"{name}: {doing}: the stage reports {text} (GS{status:02X})")
