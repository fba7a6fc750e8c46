"""Faults of simulated devices, by name: ``stall``, or with a parameter, ``stall:47.5``."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from anisoscope.base.errors import UsageError


class FaultKind(StrEnum):
    """Kind of fault; the meaning of the parameter in brackets, with its default."""

    SILENT = "silent"
    """Answers nothing [after so many commands, 0]."""
    BABBLE = "babble"
    """Sends only bytes that mean nothing."""
    GARBAGE = "garbage"
    """Sends NUL bytes and noise between and before its answers."""
    SPLIT = "split"
    """Sends every answer byte by byte."""
    UNSOLICITED = "unsolicited"
    """Sends unsolicited messages before its answers."""
    JOINED = "joined"
    """Sends an unsolicited message directly after every answer."""
    LATCHED_ERROR = "latched-error"
    """Stands in a fault since power-up, until it is read or cleared [code of the protocol, 2]."""
    MOTION_ERROR = "motion-error"
    """Refuses every motion with an error [code of the protocol, 13]."""
    HANGUP = "hangup"
    """The line goes dead at a motion [after so many motions, 0]."""
    STALL = "stall"
    """Meets an obstacle [angle in degrees, 45]."""
    OVERSHOOT = "overshoot"
    """Stops beyond the target [counts, 1]."""
    LOST_HOMING = "lost-homing"
    """Is switched off and on after an absolute move."""
    LOST_REPLY = "lost-reply"
    """Moves, but never says that it arrived."""
    WRONG_ADDRESS = "wrong-address"
    """Answers from another address."""
    BUSY = "busy"
    """Says that it is busy and does nothing [so many times, 3]."""
    SLOW = "slow"
    """Moves slower [factor, 1000]."""


_DEFAULTS = {
    FaultKind.LATCHED_ERROR: 2.0,
    FaultKind.MOTION_ERROR: 13.0,
    FaultKind.STALL: 45.0,
    FaultKind.OVERSHOOT: 1.0,
    FaultKind.BUSY: 3.0,
    FaultKind.SLOW: 1000.0,
}


@dataclass(frozen=True)
class Fault:
    """A fault and its parameter."""

    kind: FaultKind
    value: float

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read ``name`` or ``name:number``.

        Raises:
            UsageError: no fault has this name, or the parameter is not a number.
        """
        name, _, number = text.partition(":")
        try:
            kind = FaultKind(name)
        except ValueError:
            names = ", ".join(FaultKind)
            raise UsageError(f"there is no fault '{name}'; choose one of: {names}") from None
        try:
            return cls(kind, float(number) if number else _DEFAULTS.get(kind, 0.0))
        except ValueError:
            raise UsageError(f"fault {name}: '{number}' is not a number") from None
