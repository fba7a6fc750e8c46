"""The lines of Newport SMC100 and CONEX controllers: answers, states, and the errors that their codes stand for.

A command is ``<address><two letters><value>`` and CR LF; the answer to a question repeats address and letters.
Source: Newport SMC100CC/PP user's manual.
"""

import re
from dataclasses import dataclass
from typing import Self

from anisoscope.base.errors import (
    LimitExceeded,
    MotionTimeout,
    NotConnected,
    NotHomed,
    ProtocolError,
    RigError,
    Stalled,
)

TERMINATOR = b"\r\n"
ADDRESSES = range(1, 32)
NO_ERROR = "@"
NOT_REFERENCED = frozenset(range(0x0A, 0x12))
CONFIGURATION = 0x14
HOMING = frozenset({0x1E, 0x1F})
MOVING = 0x28
READY = frozenset(range(0x32, 0x37))
DISABLED = frozenset(range(0x3C, 0x40))
JOGGING = frozenset({0x46, 0x47})
IN_MOTION = HOMING | JOGGING | {MOVING}
# A command that meets a moving stage is not carried out, and may be repeated.
BUSY_ERRORS = frozenset("LM")
_ERROR_TEXTS = {
    "A": "a command it does not know",
    "B": "a wrong address",
    "C": "a parameter that is missing or out of range",
    "D": "a command that is not allowed",
    "E": "a home search that goes on already",
    "F": "an unknown stage name",
    "G": "a target out of its limits",
    "H": "that it is not referenced",
    "I": "that it is being configured",
    "J": "that its motor is disabled",
    "K": "a command that is not allowed while it is ready",
    "L": "that it is searching its home",
    "M": "that it is moving",
    "N": "a position out of its limits",
    "S": "a communication time-out",
    "U": "a fault of its memory",
    "V": "a failure while it carried out the command",
    "W": "a command that steppers (PP) do not have",
    "X": "a command that servo motors (CC) do not have",
}
_ERROR_KINDS: dict[str, type[RigError]] = {
    "B": NotConnected,
    "G": LimitExceeded,
    "H": NotHomed,
    "I": RigError,
    "J": Stalled,
    "L": MotionTimeout,
    "M": MotionTimeout,
    "N": LimitExceeded,
    "U": RigError,
    "V": RigError,
}
_FAULTS = (
    "the negative end of run",
    "the positive end of run",
    "too high a peak current",
    "too high a mean current",
    "a short circuit",
    "a following error: something blocks it, or the load is too high",
    "that the home search took too long",
    "a stage that is not the one it was configured for",
    "too low a supply voltage",
    "too high an output power",
)
_ANSWER = re.compile(rb"(?<![0-9A-Za-z])(\d{1,2})([A-Z]{2})([ -~]*)$")


@dataclass(frozen=True)
class Answer:
    """One answer: who speaks, about what (two letters), and the value as text."""

    address: int
    code: str
    value: str

    @classmethod
    def parse(cls, line: bytes) -> Self | None:
        """Read an answer from the end of a line; None if the line is damaged. Noise before it is ignored."""
        match = _ANSWER.search(line.replace(b"\0", b"").strip())
        if match is None:
            return None
        address, code, value = (group.decode("ascii") for group in match.groups())
        return cls(int(address), code, value.strip())


@dataclass(frozen=True)
class State:
    """What TS tells: the faults of the positioner, one bit each, and the state of the controller."""

    faults: int
    code: int

    @classmethod
    def parse(cls, value: str) -> Self | None:
        """Read four hex digits of faults and two of state; None if they are damaged."""
        return cls(int(value[:4], 16), int(value[4:], 16)) if re.fullmatch("[0-9A-Fa-f]{6}", value) else None

    @property
    def faults_text(self) -> str:
        """The faults in words."""
        found = [text for bit, text in enumerate(_FAULTS) if self.faults & 1 << bit]
        return " and ".join(found) or "no reason"


def error_of_letter(name: str, letter: str, doing: str) -> RigError:
    """Return the error that a letter of TE stands for."""
    text = _ERROR_TEXTS.get(letter, "an error this driver does not know")
    return _ERROR_KINDS.get(letter, ProtocolError)(
        f"{name}: {doing}: the controller reports {text} (TE {letter})"
    )
