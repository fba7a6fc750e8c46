"""Driver for Zaber stages: ASCII protocol at 115200 baud or over TCP.

Rotary stages are X-RSW, X-RST, X-RSB, …; linear ones (``unit = "mm"``) X-LSM, X-LRM, X-VSR and others. A linear stage
does not say how long its microstep is.

Scale, speed, acceleration, limits and the state of the reference are read from the device: a stage that was homed since
power-up need not be homed again. Every command has a number and a checksum, and an answer is accepted only if both are
right.

A command is ``/<device> <axis> <id> <words>:<LRC>`` and a line feed, a reply ``@<device> <axis> <id>
OK|RJ IDLE|BUSY <flag> <data>:<LRC>`` and CR LF. Lines that begin with ``#`` (information) or ``!`` (alert) may arrive
in between. Queries of identity, scale, limits, speed and warning flags are made under the lock of the transport.
Sources: Zaber ASCII protocol manual; names and meanings of flags and reasons also from the maker's client
`zaber-motion`.
"""

import contextlib
import itertools
import logging
import math
import re
from dataclasses import dataclass
from typing import ClassVar, Self

from anisoscope.base.errors import (
    LimitExceeded,
    MotionTimeout,
    NotHomed,
    ProtocolError,
    RigError,
    Stalled,
)
from anisoscope.rig.stage import SYMBOLS, WRONG_UNIT, MotionRules, Unit
from anisoscope.rig.stages.device_error import device_error
from anisoscope.rig.stages.no_answer import SECOND_S, no_answer, two_devices
from anisoscope.rig.stages.portstage import PortStage
from anisoscope.rig.transport import Transport

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
    "FQ": (Stalled, "an encoder error: its position is unreliable"),
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
        "it does not know the command: its firmware may be too old, or it is no motion stage",
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
    rb"(?P<flag>--|[A-Z][A-Z0-9]) (?P<data>[^:]*):(?P<lrc>[0-9A-Fa-f]{2})"
)
_OTHER = re.compile(rb"(?P<kind>[#!])(?P<device>\d\d) (?P<axis>\d)(?: .*)?")


def checksum(body: bytes) -> int:
    """Longitudinal redundancy check: what makes the sum of all bytes between the first and ``:`` zero, modulo 256."""
    return -sum(body) % 256


def command(device: int, axis: int, number: int, words: str) -> bytes:
    """A complete command with its number and checksum; without words it queries the state only."""
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
        """Whether the flag is of a fault that ends a motion."""
        return self.flag.startswith("F")


def is_aside(line: bytes) -> bool:
    """Whether a line is information or an alert, which answers no command."""
    return _OTHER.search(line) is not None


def is_alert_of(line: bytes, device: int) -> bool:
    """Whether a line is an alert of this device: a motion may have ended."""
    match = _OTHER.search(line)
    return match is not None and match["kind"] == b"!" and int(match["device"]) == device


def deg_s_of_speed(data: float, counts_per_deg: float) -> float:
    """Speed in degrees per second of a setting such as ``maxspeed``."""
    return data / SPEED_FACTOR / counts_per_deg


def deg_s2_of_acceleration(data: float, counts_per_deg: float) -> float:
    """Acceleration in degrees per second squared of a setting such as ``accel``."""
    return data / ACCELERATION_FACTOR / counts_per_deg


def error_of_flag(name: str, flag: str) -> RigError:
    """Error of a warning flag."""
    if flag in NO_REFERENCE:
        return NotHomed(
            f"{name} has no reference position ({flag}): it was switched off, or lost it; home it again"
        )
    kind, text = _FAULTS.get(flag, (RigError, "a fault that this driver does not know"))
    return device_error(kind, f"{name} reports {text} ({flag})")


def error_of_rejection(name: str, words: str, reply: Reply) -> RigError:
    """Error of a rejected command."""
    if reply.data == "BADDATA" and reply.flag in NO_REFERENCE and words.startswith("move"):
        return error_of_flag(name, reply.flag)
    kind, text = _REJECTIONS.get(reply.data, (ProtocolError, "for a reason that this driver does not know"))
    return device_error(kind, f"{name} rejects '{words}': {text} ({reply.data})")


_log = logging.getLogger(__name__)

TRIES = 3
MAX_DAMAGED_LINES = 16
NUMBERS = 100


class ZaberLine:
    """One device of a port.

    Whoever asks holds the lock of the transport, because several devices may share it.

    Args:
        transport: the open port.
        device: address of the device, 1…99.
        axis: number of the axis on the device.
        timeout_s: time in seconds for the answer to a question.

    Attributes:
        name: how error messages call the device.
        flag: the warning flag of the last answer.
    """

    def __init__(self, transport: Transport, device: int, axis: int, timeout_s: float) -> None:
        self.transport = transport
        self._clock = transport.clock
        self.device = device
        self.axis = axis
        self.name = f"the stage at {transport.port}, address {device},"
        self.flag = NO_FLAG
        self._timeout_s = timeout_s
        self._numbers = itertools.count()
        self._stranger: int | None = None
        self._heard = False

    def send(self, words: str, axis: int | None = None) -> int:
        """Send a command, wait for nothing, and return its number; may be called from any thread."""
        number = next(self._numbers) % NUMBERS
        self.transport.write(command(self.device, self.axis if axis is None else axis, number, words))
        return number

    def query(self, words: str, axis: int | None = None) -> Reply:
        """Send a command that may be repeated without harm, and return its answer, be it a rejection.

        A device ignores a command that arrived damaged, so silence and damaged answers are reason to ask again.

        Raises:
            NotConnected: silence.
            ProtocolError: bytes that are no answer.
        """
        self._stranger, self._heard = None, False
        for _ in range(TRIES):
            reply = self._await_reply(self.send(words, axis), self.axis if axis is None else axis)
            if reply is not None:
                self.flag = reply.flag
                return reply
        raise self._silence()

    def command(self, words: str, axis: int | None = None) -> Reply:
        """As `query`; a rejection raises its error."""
        reply = self.query(words, axis)
        if not reply.accepted:
            raise error_of_rejection(self.name, words, reply)
        return reply

    def number(self, setting: str, axis: int | None = None) -> float | None:
        """Read a setting that is a number; None if the device has no such setting.

        Raises:
            ProtocolError: it is none.
        """
        reply = self.query(f"get {setting}", axis)
        if not reply.accepted:
            return None
        try:
            return float(reply.data)
        except ValueError:
            raise ProtocolError(f"{self.name} says '{reply.data}' for {setting}; that is no number") from None

    def rest(self, wait_s: float) -> None:
        """Wait, but no longer than until the device alerts us."""
        deadline = self._clock() + wait_s
        while (left_s := deadline - self._clock()) > 0.0:
            line = self.transport.read_until(TERMINATOR, left_s)
            if line is not None and is_alert_of(line, self.device):
                return

    def _await_reply(self, number: int, axis: int, wait_s: float | None = None) -> Reply | None:
        deadline = self._clock() + (self._timeout_s if wait_s is None else wait_s)
        damaged = 0
        while (line := self.transport.read_until(TERMINATOR, deadline - self._clock())) is not None:
            reply = Reply.parse(line)
            if reply is None:
                if is_aside(line):
                    continue
                damaged += 1
                self._heard = True
                _log.warning("%s: damaged answer %r", self.name, line[:80])
                if damaged >= MAX_DAMAGED_LINES:
                    raise ProtocolError(f"{self.name} sends only garbage; check port and baud rate")
            elif reply.device != self.device:
                self._stranger = reply.device
            elif (reply.number, reply.axis) == (number, axis):  # others answer earlier commands
                return reply
        return None

    def check_alone(self) -> None:
        """Ask for the state, and refuse two answers to one question.

        Raises:
            ProtocolError: two devices answer.
        """
        if self._await_reply(self.query("", 0).number, 0, SECOND_S) is not None:
            raise two_devices(self.name)

    def _silence(self) -> RigError:
        check = "the power, the cable, the address and the baud rate"
        heard, stranger = self._heard, self._stranger
        return no_answer(
            self.name,
            self.transport,
            self._timeout_s,
            "Zaber ASCII",
            heard=heard,
            stranger=stranger,
            check=check,
        )


FULL_TURN_DEG = 360.0
RAMP_WITHOUT_LIMIT_S = 0.01


def identify(line: ZaberLine) -> str:
    """Maker, device id and serial number, for records."""
    device = line.query("get deviceid", axis=0)
    if not device.accepted:  # the newer name
        device = line.command("get device.id", axis=0)
    serial = line.query("get system.serial", axis=0)
    return f"Zaber {device.data} {serial.data}" if serial.accepted else f"Zaber {device.data}"


def read_counts_per_unit(
    line: ZaberLine, unit: Unit, counts_per_turn: float | None, counts_per_mm: float | None
) -> float:
    """Microsteps for one degree or 1 mm; what is given goes before what the device says.

    Raises:
        ProtocolError: the scale is not known, or the stage moves otherwise.
    """
    if unit == "mm":
        if (line.number("limit.cycle.dist") or 0.0) > 0.0:
            raise ProtocolError(f"{line.name} is a rotary stage; {WRONG_UNIT[unit]}")
        if not counts_per_mm or counts_per_mm <= 0.0:
            raise ProtocolError(
                f"{line.name} does not say how long a microstep is; set the option counts_per_mm: 1000 over the "
                "microstep size in µm of its data sheet (X-LSM: 20997.375)"
            )
        return counts_per_mm
    counts = counts_per_turn or line.number("limit.cycle.dist") or 0.0
    if counts <= 0.0:
        raise ProtocolError(
            f"{line.name} does not say how many microsteps a turn has (limit.cycle.dist); "
            "if it is a rotary stage, set the option counts_per_turn"
        )
    return counts / FULL_TURN_DEG


def read_limits(
    line: ZaberLine, counts_per_unit: float, unit: Unit, lowest: float | None, highest: float | None
) -> tuple[float, float]:
    """Lowest and highest place: as configured; else those of the device, of a rotary stage one turn within them.

    Raises:
        LimitExceeded: what is asked for is beyond the limits of the device.
    """
    known = line.number("limit.min"), line.number("limit.max")
    low = -math.inf if known[0] is None else known[0] / counts_per_unit
    high = math.inf if known[1] is None else known[1] / counts_per_unit
    turn = FULL_TURN_DEG if unit == "deg" else math.inf
    asked_low = max(0.0, low) if lowest is None else lowest
    asked_high = min(turn, high) if highest is None else highest
    slack = 1.0 / counts_per_unit
    if asked_low < low - slack or asked_high > high + slack or asked_low > asked_high:
        sign = SYMBOLS[unit]
        raise LimitExceeded(
            f"{line.name}: the limits {asked_low:.6g}{sign}…{asked_high:.6g}{sign} are not within those of the device, "
            f"{low:.6g}{sign}…{high:.6g}{sign}; change min_{unit} and max_{unit}, or the device's limit.min and "
            "limit.max"
        )
    return asked_low, asked_high


def read_pace(line: ZaberLine, counts_per_deg: float) -> tuple[float, float]:
    """Speed in degrees per second and acceleration in degrees per second squared, as the device is set.

    Raises:
        ProtocolError: it has no speed.
    """
    speed = line.number("maxspeed") or 0.0
    if speed <= 0.0:
        raise ProtocolError(f"{line.name} claims a maxspeed of {speed:g}; is it a motion stage?")
    velocity = deg_s_of_speed(speed, counts_per_deg)
    # An acceleration of 0 means: as fast as it can.
    data = line.number("accel") or 0.0
    return velocity, deg_s2_of_acceleration(
        data, counts_per_deg
    ) if data > 0.0 else velocity / RAMP_WITHOUT_LIMIT_S


def read_flags(line: ZaberLine) -> tuple[str, ...]:
    """Active warning flags, the gravest first."""
    return tuple(line.command("warnings").data.split()[1:])  # before them: how many


def acknowledge_flags(line: ZaberLine) -> tuple[str, ...]:
    """Clear a latched fault of the past, and return the active flags.

    Raises:
        RigError: a fault stays; it is of now.
    """
    flags = read_flags(line)
    if any(flag.startswith("F") for flag in flags):
        line.command("warnings clear")
        flags = read_flags(line)
    faults = [flag for flag in flags if flag.startswith("F")]
    if faults:
        raise error_of_flag(line.name, faults[0])
    return flags


TOLERANCE: dict[Unit, float] = {"deg": 0.02, "mm": 0.002}
MAX_ADDRESS = 99
MAX_AXIS = 9
FIRST_PAUSE_S = 0.002
LAST_PAUSE_S = 0.05


class Zaber(PortStage):
    """A stage at one address of a port.

    Args:
        transport: the open port; several stages may share it.
        unit: ``deg`` for a rotary stage, ``mm`` for a linear one; all that follows counts in it.
        address: number of the device, 1…99.
        axis: number of the axis on the device; stages with a controller of their own have one.
        timeout_s: time in seconds for the answer to a question; a question is asked three times.
        tolerance_deg: a stage this near to the target has arrived; by default 0.02° or 0.002 mm.
        velocity_deg_s, acceleration_deg_s2: to compute time limits from; by default the device's own settings.
        margin_s: seconds added to every computed time limit.
        min_deg, max_deg: limits; by default 0 and 360° or the travel, or less if the device's own limits are narrower.
        counts_per_turn: microsteps for 360°, where the device does not know, or behind a gear of your own.
        counts_per_deg: of a linear stage, the microsteps for 1 mm (``counts_per_mm`` in a rig file).

    Raises:
        NotConnected: no answer at this address.
        ProtocolError: the device that answers is no such Zaber stage.
        LimitExceeded: `min_deg` or `max_deg` is beyond what the device allows.
        RigError: the device reports a fault that does not go away.
    """

    PORT: ClassVar = {"baudrate": 115200}

    def __init__(
        self,
        transport: Transport,
        *,
        unit: Unit = "deg",
        address: int | str = 1,
        axis: int = 1,
        timeout_s: float = 0.5,
        tolerance_deg: float | None = None,
        velocity_deg_s: float | None = None,
        acceleration_deg_s2: float | None = None,
        margin_s: float = 2.0,
        min_deg: float | None = None,
        max_deg: float | None = None,
        counts_per_turn: float | None = None,
        counts_per_deg: float | None = None,
    ) -> None:
        self.unit = unit
        tolerance = TOLERANCE[unit] if tolerance_deg is None else tolerance_deg
        self.address = _number("address", address, MAX_ADDRESS)
        self.axis = _number("axis", axis, MAX_AXIS)
        self._transport = transport
        self._line = ZaberLine(transport, self.address, self.axis, timeout_s)
        self._command = ""
        self._refused = False
        self._pause_s = 0.0
        super().__init__(self._line.name, MotionRules(tolerance, 1.0), (0.0, FULL_TURN_DEG), 0.0)
        self._bus = transport.lock
        with self._bus:
            self._name = self._line.name = identify(self._line)
            self._line.check_alone()
            self._counts_per_deg = read_counts_per_unit(self._line, unit, counts_per_turn, counts_per_deg)
            self._resolution_deg = 1.0 / self._counts_per_deg
            self._limits_deg = read_limits(self._line, self._counts_per_deg, unit, min_deg, max_deg)
            velocity, acceleration = read_pace(self._line, self._counts_per_deg)
            self.rules = MotionRules(
                max(tolerance, self._resolution_deg),
                velocity_deg_s or velocity,
                acceleration_deg_s2 or acceleration,
                margin_s=margin_s,
            )
            self._homed = NO_REFERENCE.isdisjoint(acknowledge_flags(self._line))

    @classmethod
    def stop_command(cls, *, address: int | str = 1, axis: int = 1, **_options: object) -> bytes:
        """Stop of an axis of the device at an address; see `PortStage`."""
        device, number = _number("address", address, MAX_ADDRESS), _number("axis", axis, MAX_AXIS)
        return command(device, number, NUMBERS - 1, "stop")

    def warnings(self) -> tuple[str, ...]:
        """Read the active warning flags, such as ``WR``, the gravest first."""
        with self._bus:
            return read_flags(self._line)

    # The motion.

    def _read_deg(self) -> float:
        reply = self._line.command("get pos")
        if reply.flag in NO_REFERENCE:
            self._homed = False
        try:
            return float(reply.data) / self._counts_per_deg
        except ValueError:
            raise ProtocolError(
                f"{self.name} says '{reply.data}' for its position; that is no number"
            ) from None

    def _check_reference(self, now_deg: float) -> None:
        """Read the reference state from the device; turns of its knob are counted."""
        del now_deg
        if not self._homed:
            raise error_of_flag(self.name, "WR")

    def _read_moving_deg(self) -> float | None:
        try:
            return float(self._line.command("get pos").data) / self._counts_per_deg
        except ValueError:
            return None

    def _begin_home(self) -> None:
        self._begin("home")

    def _begin_move(self, target_deg: float) -> None:
        self._begin(f"move abs {round(target_deg * self._counts_per_deg)}")

    def _begin(self, command: str) -> None:
        if self._line.flag == INTERRUPTED or self._line.flag.startswith("F"):
            self._line.command("warnings clear")  # what is of the past shall not end the motion to come
        self._command = command
        self._pause_s = 0.0
        self._start()

    def _start(self) -> None:
        reply = self._line.query(self._command)
        self._refused = reply.data in TRY_AGAIN and not reply.accepted
        if not reply.accepted and not self._refused:
            raise error_of_rejection(self.name, self._command, reply)

    def _is_busy(self, wait_s: float) -> bool:
        # Asked at once, then less and less often: a short move costs no pause, a long one no traffic.
        self._line.rest(min(self._pause_s, wait_s))
        self._pause_s = min(max(2.0 * self._pause_s, FIRST_PAUSE_S), LAST_PAUSE_S)
        if self._refused and not self._stopping.is_set():
            self._start()
            return True
        reply = self._line.query("")
        if not self._stopping.is_set():
            self._check_state(reply)
        return reply.busy

    def _check_state(self, reply: Reply) -> None:
        if reply.faulty:
            raise error_of_flag(self.name, reply.flag)
        if not reply.busy and reply.flag in NO_REFERENCE:
            self._homed = False
            raise error_of_flag(self.name, reply.flag)

    def _off_target(self, what: str, at_deg: float, target_deg: float) -> MotionTimeout:
        if self._line.flag != INTERRUPTED:
            return super()._off_target(what, at_deg, target_deg)
        return MotionTimeout(
            f"{self.name}: the {what} was interrupted at {self._shown(at_deg, 6)} ({INTERRUPTED}), by its knob or "
            "another program"
        )

    def _send_stop(self) -> None:
        self._refused = False
        self._pause_s = 0.0
        self._line.send("stop")


def _number(what: str, value: int | str, highest: int) -> int:
    with contextlib.suppress(ValueError):
        if 1 <= int(value) <= highest:
            return int(value)
    raise RigError(f"'{value}' is not a Zaber {what}; use one of 1…{highest}")
