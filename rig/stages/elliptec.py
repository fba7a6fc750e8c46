"""Driver for Thorlabs Elliptec stages: ASCII at 9600 baud, several on a bus.

Rotation stages are ELL14, ELL18, ELL8, …; linear ones (``unit = "mm"``) ELL7, ELL10, ELL17, ELL20.

Scale, travel and serial number are read from the device. A move is answered once, at its end; meanwhile the device is
silent, or reports that it is busy. The device does not report whether it was homed: the driver stores this for the
duration of the connection.

Positions, device information and status codes are read from lines of ASCII. A command is ``<address><two lower-case
letters><hex arguments>`` without terminator; an answer is ``<address><two upper-case letters><hex data>`` and CR LF.
Sources: Thorlabs ELLx protocol manual, and the answers of real devices.
"""

import logging
import re
from dataclasses import dataclass
from typing import ClassVar, Self

from anisoscope.base.errors import (
    LimitExceeded,
    MotionTimeout,
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
ADDRESSES = "0123456789ABCDEF"
OK = 0
BUSY = 9
DATA_LENGTHS = {"IN": 30, "GS": 2, "PO": 8, "BO": 8, "HO": 8, "GJ": 8, "GV": 2, "BS": 2, "I1": 22, "I2": 22}
UNSOLICITED = frozenset({"BO", "BS"})
LINEAR_TYPES, SLIDERS = frozenset({7, 10, 17, 20}), frozenset({6, 9, 12})
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
_ANSWER = re.compile(rb"([0-9A-Fa-f])([A-Z][A-Z12])([0-9A-Fa-f]*)$")


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
        return cls(address.upper(), code, data) if len(data) == DATA_LENGTHS.get(code) else None

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
    """Identification of a device.

    Attributes:
        model: type number; 14 is an ELL14.
        serial: serial number.
        year: year of manufacture.
        firmware: firmware release, two hex digits.
        travel_deg: travel in degrees; of a linear stage in mm.
        pulses: encoder counts over the travel; of a linear stage for 1 mm.
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
            ProtocolError: the numbers cannot be those of a stage.
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
                f"the stage claims {info.pulses} counts over {info.travel_deg}{SYMBOLS[info.unit]}; is it an Elliptec?"
            )
        if info.model in SLIDERS:
            raise ProtocolError(f"an ELL{info.model} has a few fixed places only; name the port of a stage")
        return info

    @property
    def unit(self) -> Unit:
        """In what it moves."""
        return "mm" if self.model in LINEAR_TYPES else "deg"

    @property
    def counts_per_deg(self) -> float:
        """Encoder counts for one degree, or for 1 mm."""
        return float(self.pulses) if self.unit == "mm" else self.pulses / self.travel_deg


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
    """Error of a status code other than 0."""
    text = STATUS_TEXTS.get(status, "a status this driver does not know")
    kind = _STATUS_ERRORS.get(status, RigError)
    return device_error(kind, f"{name}: {doing}: the stage reports {text} (GS{status:02X})")


_log = logging.getLogger(__name__)

TRIES = 3
MAX_DAMAGED_LINES = 16
BUSY_POLL_S = 0.05


class ElliptecLine:
    """One address of a port.

    Whoever asks holds the lock of the transport, because several devices may share it.

    Args:
        transport: the open port.
        address: bus address, ``0`` … ``F``.
        timeout_s: time in seconds for the answer to a question.

    Attributes:
        name: how error messages call the device.
        busy_limit_s: for so long a busy device is asked again.
    """

    def __init__(self, transport: Transport, address: str, timeout_s: float) -> None:
        self.transport = transport
        self._clock = transport.clock
        self.address = address
        self.name = f"the stage at {transport.port}, address {address},"
        self.busy_limit_s = 10.0
        self._timeout_s = timeout_s
        self._stranger = ""
        self._heard = False

    def send(self, command: str) -> None:
        """Send a command, and wait for nothing."""
        self.transport.write(f"{self.address}{command}".encode("ascii"))

    def next_answer(self, wait_s: float) -> Answer | None:
        """Return the next whole answer of this device within `wait_s` seconds; skip what is unasked for."""
        deadline = self._clock() + wait_s
        damaged = 0
        while (line := self.transport.read_until(TERMINATOR, deadline - self._clock())) is not None:
            answer = Answer.parse(line)
            self._heard = True
            if answer is None:
                damaged += 1
                _log.warning("%s: damaged answer %r", self.name, line[:80])
                if damaged >= MAX_DAMAGED_LINES:
                    raise ProtocolError(f"{self.name} sends only garbage; check port and baud rate")
            elif answer.address != self.address:
                self._stranger = answer.address
            elif answer.code in UNSOLICITED:
                _log.info("%s: unasked for: %s%s", self.name, answer.code, answer.data)
            else:
                return answer
        return None

    def query(self, command: str, expected: str) -> Answer:
        """Send a repeatable query and return the answer.

        A damaged answer is asked for again; a busy device is asked for up to `busy_limit_s`.
        """
        busy_until = self._clock() + self.busy_limit_s
        tries = 0
        while tries < TRIES:
            self.transport.discard()
            self.send(command)
            answer = self._await_answer(expected)
            if answer is None:
                tries = tries + 1 if self._heard or self.transport.pending else TRIES
            elif answer.code == expected:
                return answer
            elif self._clock() >= busy_until:
                raise MotionTimeout(f"{self.name} stays busy; switch it off and on")
            else:
                self._clock.sleep(BUSY_POLL_S)
        raise self._silence()

    def _await_answer(self, expected: str) -> Answer | None:
        """Wait for an answer of one kind, or for the news that the device is busy or in trouble."""
        deadline = self._clock() + self._timeout_s
        self._stranger = ""
        self._heard = False
        while (left_s := deadline - self._clock()) > 0.0:
            answer = self.next_answer(left_s)
            if answer is None:
                break
            if answer.code == expected or answer.status == BUSY:
                return answer
            if answer.status not in {None, OK}:
                raise error_of_status(self.name, answer.status or 0, "asked a question")
        return None

    def _silence(self) -> RigError:
        return no_answer(
            self.name,
            self.transport,
            self._timeout_s,
            "Elliptec",
            heard=self._heard,
            stranger=self._stranger or None,
        )

    def check_alone(self) -> None:
        """Ask once more who is there, and refuse two answers; damaged ones are no second device.

        Raises:
            ProtocolError: two devices answer.
        """
        self.query("in", "IN")
        answer = self.next_answer(SECOND_S)
        if answer is not None and answer.code == "IN":
            raise two_devices(self.name)

    def set(self, command: str, doing: str) -> None:
        """Send a command that the device acknowledges with its status; `doing` names it in error messages."""
        with self.transport.lock:
            self.transport.discard()
            self.send(command)
            answer = self._await_answer("GS")
            if answer is None:
                raise self._silence()
            if answer.status:
                raise error_of_status(self.name, answer.status, doing)


# Full speed is 430°/s for an ELL14, 180 mm/s for an ELL17; time limits count on less: load and resonance slow it down.
SURE_VELOCITY: dict[Unit, float] = {"deg": 100.0, "mm": 40.0}
TOLERANCE: dict[Unit, float] = {"deg": 0.05, "mm": 0.01}
QUIET_S = 0.15
FIRST_POLL_S = 0.002


class Elliptec(PortStage):
    """A stage at one address of a port.

    Args:
        transport: the open port; several stages may share it.
        unit: ``deg`` for a rotation stage, ``mm`` for a linear one; all that follows counts in it.
        address: bus address, ``0`` … ``F``.
        timeout_s: time in seconds for the answer to a question.
        move_gap_s: pause in seconds between two moves; devices that get none may run to zero instead.
        tolerance_deg: a stage this near to the target has arrived; by default 0.05° or 0.01 mm.
        velocity_deg_s: speed to compute time limits from; by default 100°/s or 40 mm/s times the velocity setting.
        margin_s: seconds added to every computed time limit.
        min_deg, max_deg: limits in degrees; by default 0 and the travel that the device reports.

    Raises:
        NotConnected: no answer at this address.
        ProtocolError: the device that answers is no such Elliptec stage.
    """

    PORT: ClassVar = {"baudrate": 9600}
    search_turns = 1.0  # its reference is at most one turn away

    def __init__(
        self,
        transport: Transport,
        *,
        unit: Unit = "deg",
        address: str = "0",
        timeout_s: float = 1.0,
        move_gap_s: float = 0.1,
        tolerance_deg: float | None = None,
        velocity_deg_s: float | None = None,
        margin_s: float = 2.0,
        min_deg: float = 0.0,
        max_deg: float | None = None,
    ) -> None:
        if len(address) != 1 or address not in ADDRESSES:
            raise RigError(f"'{address}' is not an Elliptec address; use one of 0…9, A…F")
        self.address = address
        self._transport = transport
        self._line = ElliptecLine(transport, address, timeout_s)
        self._move_gap_s = move_gap_s
        self._last_motion_end = -1e9
        self._polling = False
        self._poll_s = FIRST_POLL_S
        self._refused = False
        self._command = ""
        self._target_counts = 0
        self.unit = unit
        tolerance = TOLERANCE[unit] if tolerance_deg is None else tolerance_deg
        super().__init__(self._line.name, MotionRules(tolerance, SURE_VELOCITY[unit]), (min_deg, 360.0), 0.0)
        self._bus = transport.lock
        with self._bus:
            self.info = self._identify()
        self._name = self._line.name = f"ELL{self.info.model} {self.info.serial}"
        self._resolution_deg = 1.0 / self.info.counts_per_deg
        self._limits_deg = (min_deg, float(self.info.travel_deg) if max_deg is None else max_deg)
        velocity = velocity_deg_s or SURE_VELOCITY[unit] * max(self.velocity_percent(), 5) / 100.0
        # A piezo motor is at full speed in well under a tenth of a second.
        self.rules = MotionRules(
            max(tolerance, self._resolution_deg), velocity, velocity / 0.1, margin_s=margin_s
        )
        self._line.busy_limit_s = self.rules.timeout_s(float(self.info.travel_deg))

    @classmethod
    def stop_command(cls, *, address: str = "0", **_options: object) -> bytes:
        """Stop of the device at an address; see `PortStage`."""
        return f"{address}st".encode("ascii", errors="ignore")

    def status(self) -> int:
        """Read and thereby clear the status code; 0 is ok, 9 is busy."""
        with self._bus:
            return int(self._line.query("gs", "GS").data, 16)

    def velocity_percent(self) -> int:
        """Read the velocity setting in percent of full speed."""
        with self._bus:
            return int(self._line.query("gv", "GV").data, 16)

    def _identify(self) -> DeviceInfo:
        info = DeviceInfo.parse(self._line.query("in", "IN").data)
        self._line.check_alone()
        if info.unit != self.unit:
            kind = "a linear" if info.unit == "mm" else "a rotation"
            raise ProtocolError(f"an ELL{info.model} is {kind} stage; {WRONG_UNIT[self.unit]}")
        # A fault of the past is latched until it is read; one that comes back is of now.
        if self.status() not in {OK, BUSY} and (status := self.status()) not in {OK, BUSY}:
            raise error_of_status(self.name, status, "connecting")
        return info

    # The motion.

    def _read_deg(self) -> float:
        return self._line.query("gp", "PO").counts / self.info.counts_per_deg

    def _begin_home(self) -> None:
        self._target_counts = 0
        self._begin("ho0")

    def _begin_move(self, target_deg: float) -> None:
        self._target_counts = round(target_deg * self.info.counts_per_deg)
        self._begin(f"ma{counts_to_hex(self._target_counts)}")

    def _begin(self, command: str) -> None:
        pause_s = self._last_motion_end + self._move_gap_s - self._clock()
        if pause_s > 0.0:
            self._clock.sleep(pause_s)
        self._transport.discard()
        self._command = command
        self._polling = self._refused = False
        self._poll_s = FIRST_POLL_S
        self._line.send(command)

    def _is_busy(self, wait_s: float) -> bool:
        if self._polling:
            self._clock.sleep(self._poll_s)
            self._poll_s = min(2.0 * self._poll_s, BUSY_POLL_S)
            self._line.send("gs")
        answer = self._line.next_answer(wait_s)
        if answer is None:
            return True
        if answer.status == BUSY:
            # A command that meets a busy device is not carried out.
            self._refused = self._refused or not self._polling
            self._polling = True
            return True
        if answer.status:
            self._last_motion_end = self._clock()
            raise error_of_status(self.name, answer.status, "moving")
        if answer.status is None and not self._near(answer):
            # An unsolicited position, or the end of the motion at a wrong place: the status decides.
            self._polling = True
            return True
        self._last_motion_end = self._clock()
        self._polling = True  # from here on the device has to be asked
        if self._refused and not self._stopping.is_set() and not self._near(self._line.query("gp", "PO")):
            self._begin(self._command)
            return True
        return False

    def _near(self, answer: Answer) -> bool:
        if answer.code != "PO":
            return False
        away_deg = abs(answer.counts - self._target_counts) / self.info.counts_per_deg
        return away_deg <= self.rules.tolerance_deg

    def _is_surely_busy(self) -> bool:
        status = self.status()
        if status not in {OK, BUSY}:
            raise error_of_status(self.name, status, "moving")
        return status == BUSY

    def _send_stop(self) -> None:
        self._line.send("st")

    def _wait_until_still(self) -> None:
        # A stop is answered once; what else may come is discarded before the next question.
        self._line.next_answer(QUIET_S)
        self._last_motion_end = self._clock()
