"""Messages of a Grbl 1.1 board, and the errors of its numeric codes.

Source: interface description of Grbl 1.1 (messages, status reports, error and alarm codes).
"""

import re
from dataclasses import dataclass
from typing import Self

from anisoscope.base.errors import LimitExceeded, MotionTimeout, NotHomed, ProtocolError, RigError, Stalled
from anisoscope.rig.stages.device_error import device_error

TERMINATOR = b"\n"
STATUS, FEED_HOLD, RESET, JOG_CANCEL = b"?", b"!", b"\x18", b"\x85"
AXES = "XYZABC"
MM_PER_INCH = 25.4
STEPS, RATE, ACCELERATION, TRAVEL = 100, 110, 120, 130
INCHES, SOFT_LIMITS, HOMING, HOMING_DIRECTION, HOMING_FEED, HOMING_SEEK = 13, 20, 22, 23, 24, 25
DEBOUNCE, PULL_OFF = 26, 27
NOT_IDLE, HOMING_OFF = 8, 5
# After these alarms the board answers nothing until it is reset.
CRITICAL_ALARMS = frozenset({1, 2, 10})
MOVING = frozenset({"Run", "Jog", "Home"})
_ERROR_TEXTS = {
    1: "a word without a letter",
    2: "a number it cannot read",
    3: "a $ command it does not know",
    4: "a negative value where none may be",
    5: "homing is switched off ($22=0)",
    6: "a step pulse that is too short",
    7: "settings that cannot be read from its memory",
    8: "it is busy",
    9: "it is locked by an alarm",
    10: "soft limits need homing to be switched on",
    11: "a line that is too long",
    12: "a step rate that is too high",
    13: "the safety door is open",
    14: "a line too long to be stored",
    15: "the target is beyond the travel ($130…)",
    16: "a jog command with words that do not belong there",
    20: "a command it does not support",
    22: "no feed rate",
    26: "no axis in the command",
    31: "an axis where none may be",
    33: "a target it cannot reach",
    36: "words that nothing uses",
}
_ERROR_KINDS: dict[int, type[RigError]] = {
    5: NotHomed,
    8: MotionTimeout,
    9: NotHomed,
    13: RigError,
    15: LimitExceeded,
}
_ALARM_TEXTS = {
    1: "a limit switch was hit, or an obstacle that counts as one",
    2: "a move beyond the travel was stopped before it began",
    3: "it was reset while it moved",
    4: "the probe was not in its initial state",
    5: "the probe touched nothing",
    6: "it was reset while it searched the switches",
    7: "the safety door was opened while it searched the switches",
    8: "the switch stayed pressed after pulling off; enlarge $27, or check the switch",
    9: "no switch was found; check the switches, $23 and $130…",
    10: "the second motor of an axis found no switch",
}
_ALARM_KINDS: dict[int, type[RigError]] = {
    1: Stalled,
    2: LimitExceeded,
    3: NotHomed,
    8: Stalled,
    9: Stalled,
    10: Stalled,
}
_STATUS = re.compile(rb"<([A-Z][a-z]+)(?::(\d+))?((?:\|[A-Za-z]+:[^|<>]*)*)>")
_ANSWER = re.compile(rb"(?<![A-Za-z])(ok|error:\s?(\d+)|ALARM:\s?(\d+))$")
_SETTING = re.compile(rb"\$(\d+)=(-?\d+(?:\.\d+)?)(?:\s|$)")
_BANNER = re.compile(rb"Grbl\w* (\d+\.\d+\w*)")
_BRACKETS = re.compile(rb"\[([A-Z][A-Za-z0-9]*):(.*)\]$")


@dataclass(frozen=True)
class Ok:
    """Acknowledgement of a line."""


@dataclass(frozen=True)
class Refused:
    """A line was refused, with an error number."""

    code: int


@dataclass(frozen=True)
class Alarm:
    """The board stopped everything, for the reason of a number."""

    code: int


@dataclass(frozen=True)
class Banner:
    """The board has just started, with this firmware."""

    version: str


@dataclass(frozen=True)
class Setting:
    """One line of the list of settings."""

    number: int
    value: float


@dataclass(frozen=True)
class Feedback:
    """A feedback message in square brackets: name and text."""

    name: str
    text: str


@dataclass(frozen=True)
class Status:
    """A status report; positions in the units of the board.

    Attributes:
        state: Idle, Run, Hold, Jog, Alarm, Door, Check, Home, Sleep.
        substate: what kind of Hold or Door; 0 without.
        machine, work: position in machine and in work coordinates; the board reports one of them.
        offset: machine position of the work origin, if this report holds it.
        free: moves and bytes that the board still accepts, if reported.
        feed: present rate.
        pins: letters of the switches that are closed.
        feed_percent: feed override, if this report holds it; else 0.
    """

    state: str
    substate: int = 0
    machine: tuple[float, ...] = ()
    work: tuple[float, ...] = ()
    offset: tuple[float, ...] = ()
    free: tuple[float, ...] = ()
    feed: float = 0.0
    pins: str = ""
    feed_percent: int = 0

    @classmethod
    def parse(cls, state: str, substate: str, fields: str) -> Self | None:
        """Read the fields between the bars; None if a number is damaged."""
        values = dict(field.split(":", 1) for field in fields.split("|") if field)
        try:
            numbers = {
                name: tuple(float(part) for part in values[name].split(","))
                for name in ("MPos", "WPos", "WCO", "Bf", "FS", "F", "Ov")
                if name in values
            }
        except ValueError:
            return None
        rates = numbers.get("FS", numbers.get("F", (0.0,)))
        return cls(
            state,
            int(substate or 0),
            numbers.get("MPos", ()),
            numbers.get("WPos", ()),
            numbers.get("WCO", ()),
            numbers.get("Bf", ()),
            rates[0],
            values.get("Pn", ""),
            int(numbers.get("Ov", (0.0,))[0]),
        )


Message = Ok | Refused | Alarm | Banner | Setting | Feedback | Status


def parse(line: bytes) -> Message | None:
    """Read one line; noise before the message is ignored. None if there is no message in it."""
    line = line.replace(b"\0", b"").strip()
    if match := _STATUS.search(line):
        return Status.parse(*((group or b"").decode("latin-1") for group in match.groups()))
    if match := _ANSWER.search(line):
        return _answer(match)
    if match := _BANNER.search(line):
        return Banner(match[1].decode("ascii"))
    if match := _BRACKETS.search(line):
        return Feedback(match[1].decode("ascii"), match[2].decode("latin-1"))
    match = _SETTING.search(line)
    return Setting(int(match[1]), float(match[2])) if match else None


def _answer(match: re.Match[bytes]) -> Message:
    if match[2]:
        return Refused(int(match[2]))
    return Alarm(int(match[3])) if match[3] else Ok()


def error_of_refusal(name: str, code: int, doing: str) -> RigError:
    """Error of an error number."""
    text = _ERROR_TEXTS.get(code, "a line it does not take")
    kind = _ERROR_KINDS.get(code, ProtocolError)
    return device_error(kind, f"{name}: {doing}: the board reports {text} (error:{code})")


def error_of_alarm(name: str, code: int) -> RigError:
    """Error of an alarm number."""
    text = _ALARM_TEXTS.get(code, "an alarm this driver does not know")
    return _ALARM_KINDS.get(code, RigError)(
        f"{name}: {text} (ALARM:{code}); its position is uncertain; home it again"
    )
