"""The bytes of the Zaber ASCII protocol: commands, replies, checksums, units, warning flags, reasons of rejection.

A command is ``/<device> <axis> <id> <words>:<LRC>`` and a line feed, a reply ``@<device> <axis> <id> OK|RJ IDLE|BUSY
<flag> <data>:<LRC>`` and CR LF; lines that begin with ``#`` (information) or ``!`` (alert) come besides. Sources:
Zaber ASCII protocol manual; names and meanings of flags and reasons also as the maker's client `zaber-motion` has
them.
"""

import re
from dataclasses import dataclass
from typing import Self

from anisoscope.base.errors import LimitExceeded, MotionTimeout, NotHomed, ProtocolError, RigError, Stalled

TERMINATOR = b"\n"
NO_FLAG = "--"
INTERRUPTED = "NI"
NO_REFERENCE = frozenset({"WR", "WH"})
TRY_AGAIN = frozenset({"STATUSBUSY", "AGAIN"})
# Speed in microsteps/s is data / 1.6384, acceleration in microsteps/s² is data · 10⁴ / 1.6384.
SPEED_FACTOR = 1.6384
ACCELERATION_FACTOR = SPEED_FACTOR / 1e4

_FAULTS: dict[str, tuple[type[RigError], str]] = {
    "FF": (RigError, "a critical system error; switch it off and on, and ask the maker if it comes back"),
    "FN": (RigError, "that it does not support the stage that is plugged in"),
    "FZ": (RigError, "that the stage is not activated"),
    "FH": (RigError, "that the emergency stop cut the motor off; release it and enable the driver"),
    "FV": (RigError, "a supply voltage too high or too low, and cut the motor off; check the power supply"),
    "FO": (RigError, "that its driver is disabled; find out why, then send 'driver enable'"),
    "FC": (RigError, "too high an inrush current, and cut the motor off"),
    "FM": (RigError, "that the motor is too hot; let it cool"),
    "FD": (RigError, "that its driver is disabled (too hot, or a wrong voltage or current); let it cool"),
    "FQ": (Stalled, "an encoder error; the position is not to be trusted"),
    "FI": (Stalled, "an index error of its encoder; the position is not to be trusted"),
    "FA": (Stalled, "that its analog encoder is out of step; the position is not to be trusted"),
    "FR": (RigError, "that the limit of overdrive was exceeded, and cut the motor off; lower load or speed"),
    "FS": (Stalled, "that it stalled and stopped; look for an obstacle"),
    "FB": (LimitExceeded, "that a stream left its bounds"),
    "FP": (Stalled, "that the axis left its path"),
    "FE": (LimitExceeded, "a limit error: it met a limit sensor where none should be"),
    "FT": (LimitExceeded, "that its cable is twisted too far"),
}
_REJECTIONS: dict[str, tuple[type[RigError], str]] = {
    "AGAIN": (MotionTimeout, "it cannot take the command right now"),
    "STATUSBUSY": (MotionTimeout, "it is busy with something else"),
    "BADAXIS": (ProtocolError, "it has no axis of this number; correct the option 'axis'"),
    "BADCOMMAND": (
        ProtocolError,
        "it does not know the command; is its firmware too old, or it no motion stage?",
    ),
    "BADDATA": (LimitExceeded, "the value is out of range"),
    "BADMESSAGEID": (ProtocolError, "it does not take the number of the message"),
    "DEVICEONLY": (ProtocolError, "the command is for the device, not for an axis"),
    "DRIVERDISABLED": (RigError, "its driver is disabled; find out why, then send 'driver enable'"),
    "FULL": (RigError, "its memory is full"),
    "INACTIVE": (RigError, "the axis is not activated"),
    "LOCKSTEP": (RigError, "it is part of a lockstep group; disable the group"),
    "NOACCESS": (RigError, "its access level forbids it"),
    "PARKED": (RigError, "it is parked; unpark it ('tools parking unpark')"),
    "REMOTE": (RigError, "it is under remote control over another bus"),
}
_REPLY = re.compile(
    rb"@(?P<device>\d\d) (?P<axis>\d) (?P<number>\d\d) (?P<verdict>OK|RJ) (?P<state>IDLE|BUSY) "
    rb"(?P<flag>--|[A-Z][A-Z0-9]) (?P<data>[^:]*):(?P<lrc>[0-9A-F]{2})"
)
_OTHER = re.compile(rb"(?P<kind>[#!])(?P<device>\d\d) (?P<axis>\d)(?: .*)?")


def checksum(body: bytes) -> int:
    """Longitudinal redundancy check: what makes the sum of all bytes between the first and ``:`` zero, modulo 256."""
    return -sum(body) % 256


def command(device: int, axis: int, number: int, words: str) -> bytes:
    """A whole command with its number and checksum; without words it asks for nothing but the state."""
    body = f"{device} {axis} {number:02d}{' ' if words else ''}{words}".encode("ascii")
    return b"/%s:%02X\n" % (body, checksum(body))


@dataclass(frozen=True)
class Reply:
    """One reply: who speaks to which message, whether it was obeyed, what the axis does, and the data."""

    device: int
    axis: int
    number: int
    accepted: bool
    busy: bool
    flag: str
    data: str

    @classmethod
    def parse(cls, line: bytes) -> Self | None:
        """Read a reply from the end of a line; None if it is damaged, or bears no number and checksum.

        NUL bytes and whatever stands before the reply (line noise at power-up) are ignored.
        """
        line = line.replace(b"\0", b"").strip()
        match = _REPLY.fullmatch(line[line.rfind(b"@") :]) if b"@" in line else None
        if match is None or checksum(match[0][1:-3]) != int(match["lrc"], 16):
            return None
        return cls(
            device=int(match["device"]),
            axis=int(match["axis"]),
            number=int(match["number"]),
            accepted=match["verdict"] == b"OK",
            busy=match["state"] == b"BUSY",
            flag=match["flag"].decode("ascii"),
            data=match["data"].decode("ascii", errors="replace"),
        )

    @property
    def faulty(self) -> bool:
        """Whether the flag stands for a fault that ends a motion."""
        return self.flag.startswith("F")


def is_aside(line: bytes) -> bool:
    """Whether a line is information or an alert, which nobody has to wait for."""
    return _OTHER.search(line) is not None


def is_alert_of(line: bytes, device: int) -> bool:
    """Whether a line is an alert of this device: a motion may have ended."""
    match = _OTHER.search(line)
    return match is not None and match["kind"] == b"!" and int(match["device"]) == device


def deg_s_of_speed(data: float, counts_per_deg: float) -> float:
    """Speed in degrees per second that a setting such as ``maxspeed`` stands for."""
    return data / SPEED_FACTOR / counts_per_deg


def deg_s2_of_acceleration(data: float, counts_per_deg: float) -> float:
    """Acceleration in degrees per second squared that a setting such as ``accel`` stands for."""
    return data / ACCELERATION_FACTOR / counts_per_deg


def error_of_flag(name: str, flag: str) -> RigError:
    """Return the error that a warning flag stands for."""
    if flag in NO_REFERENCE:
        return NotHomed(
            f"{name} has no reference position ({flag}): it was switched off, or lost it; home it again"
        )
    kind, text = _FAULTS.get(flag, (RigError, "a fault that this driver does not know"))
    return kind(f"{name} reports {text} ({flag})")


def error_of_rejection(name: str, words: str, reply: Reply) -> RigError:
    """Return the error that a rejected command stands for."""
    if reply.data == "BADDATA" and reply.flag in NO_REFERENCE and words.startswith("move"):
        return error_of_flag(name, reply.flag)
    kind, text = _REJECTIONS.get(reply.data, (ProtocolError, "for a reason that this driver does not know"))
    return kind(f"{name} rejects '{words}': {text} ({reply.data})")
