"""Driver for stages on Newport SMC100 and CONEX controllers: 57600 or 921600 baud, several on a line.

The controller works in degrees, or in millimetres of a linear stage (``unit = "mm"``), without saying which; it
reports limits, speed and resolution. Commands are not answered: the driver asks
for the error after each. A new home search needs a restart of the controller, because a referenced one refuses
it. The reference survives a new connection. Source: Newport SMC100CC/PP user's manual.

States and errors come as codes in lines of ASCII. A command is ``<address><two letters><value>`` and CR LF; the
answer to a question repeats address and letters. Source: Newport SMC100CC/PP user's manual.
"""

import contextlib
import logging
import re
from dataclasses import dataclass
from typing import ClassVar, Self

from anisoscope.base.errors import (
    LimitExceeded,
    MotionTimeout,
    NotConnected,
    NotHomed,
    ProtocolError,
    RigError,
    Stalled,
)
from anisoscope.rig.stage import SYMBOLS, MotionRules, Unit
from anisoscope.rig.stages.device_error import device_error
from anisoscope.rig.stages.no_answer import SECOND_S, no_answer, two_devices
from anisoscope.rig.stages.portstage import PortStage
from anisoscope.rig.transport import Transport

TERMINATOR = b"\r\n"
ADDRESSES = range(1, 32)
NO_ERROR, NOT_FOR_STEPPERS = "@", "W"
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
_ANSWER = re.compile(rb"(?<![0-9A-Za-z])(\d{1,2})(FRM|FRS|[A-Z]{2})([ -~]*)$")


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
    """Answer to TS: faults of the positioner, one bit each, and the state of the controller."""

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
    """Error of a letter of TE."""
    text = _ERROR_TEXTS.get(letter, "an error this driver does not know")
    kind = _ERROR_KINDS.get(letter, ProtocolError)
    return device_error(kind, f"{name}: {doing}: the controller reports {text} (TE {letter})")


_log = logging.getLogger(__name__)

TRIES = 3
MAX_DAMAGED_LINES = 16


class Smc100Line:
    """One address of a port; callers hold the lock of the transport, which several devices may share.

    Args:
        transport: the open port.
        address: 1 … 31.
        timeout_s: time in seconds for the answer to a question.

    Attributes:
        name: how error messages call the device.
    """

    def __init__(self, transport: Transport, address: int, timeout_s: float) -> None:
        self.name = f"the stage at {transport.port}, address {address},"
        self._transport = transport
        self._clock = transport.clock
        self._address = address
        self._timeout_s = timeout_s
        self._stranger: int | None = None
        self._heard = False
        self._sent = b""

    def send(self, command: str) -> None:
        """Send a command, and wait for nothing."""
        self._sent = f"{self._address}{command}".encode("ascii")
        self._transport.write(self._sent + TERMINATOR)

    def query(self, question: str) -> str:
        """Query a value; a damaged answer is queried again."""
        for _ in range(TRIES):
            self._transport.discard()
            self._stranger, self._heard = None, False
            self.send(question)
            if (value := self._answer_to(question.rstrip("?"))) is not None:
                return value
            if not (self._heard or self._transport.pending):
                break
        raise self._silence()

    def query_number(self, question: str) -> float:
        """Query a number.

        Raises:
            ProtocolError: the answer is none.
        """
        value = self.query(question)
        try:
            return float(value)
        except ValueError:
            raise ProtocolError(
                f"{self.name} answers '{value[:40]}' to {question}: that is no number"
            ) from None

    def state(self) -> State:
        """Query faults and state.

        Raises:
            ProtocolError: the answer is none.
        """
        value = ""
        for _ in range(TRIES):
            value = self.query("TS")
            if (state := State.parse(value)) is not None:
                return state
        raise ProtocolError(f"{self.name} answers '{value[:40]}' to TS: that is no state")

    def error(self) -> str:
        """Query and clear the letter of the last error; ``@`` is none."""
        return self.query("TE")[:1] or NO_ERROR

    def command(self, command: str, doing: str) -> None:
        """Send a command and query its acceptance; `doing` names it in error messages."""
        self.send(command)
        if (letter := self.error()) != NO_ERROR:
            raise error_of_letter(self.name, letter, doing)

    def _answer_to(self, code: str, wait_s: float | None = None) -> str | None:
        deadline = self._clock() + (self._timeout_s if wait_s is None else wait_s)
        damaged = 0
        while (line := self._transport.read_until(b"\n", deadline - self._clock())) is not None:
            if line.strip() == self._sent:  # an echo
                self._heard = True
                continue
            answer = Answer.parse(line)
            if answer is None:
                damaged += bool(line.strip(b"\r\n\0 "))
                self._heard = True
                _log.info("%s: damaged answer %r", self.name, line[:80])
                if damaged >= MAX_DAMAGED_LINES:
                    raise ProtocolError(f"{self.name} sends only garbage; check port and baud rate")
            elif answer.address != self._address:
                self._stranger = answer.address
            elif answer.code == code:
                return answer.value
            else:
                self._heard = True
        return None

    def check_alone(self) -> None:
        """Ask for the state, and refuse two answers to one question.

        Raises:
            ProtocolError: two controllers answer.
        """
        self.query("TS")
        if self._answer_to("TS", SECOND_S) is not None:
            raise two_devices(self.name)

    def _silence(self) -> RigError:
        return no_answer(
            self.name, self._transport, self._timeout_s, "SMC100", heard=self._heard, stranger=self._stranger
        )


FIRST_POLL_S, BUSY_POLL_S = 0.002, 0.02
TOLERANCE: dict[Unit, float] = {"deg": 0.01, "mm": 0.001}


class Smc100(PortStage):
    """A stage at one address of a port.

    Args:
        transport: the open port; several stages may share it.
        unit: ``deg`` for a rotation stage, ``mm`` for a linear one; all that follows counts in it.
        address: 1 … 31, as a number or as text.
        timeout_s: time in seconds for the answer to a question.
        restart_s: time in seconds that the controller may need to restart before a second home search.
        tolerance_deg: a stage this near to the target has arrived; by default 0.01° or 0.001 mm.
        resolution_deg: smallest step; by default the encoder increment that the controller reports.
        velocity_deg_s: speed to compute time limits from; by default the one that is set in the controller.
        margin_s: seconds added to every computed time limit.
        min_deg, max_deg: limits in degrees; by default those of the controller.

    Raises:
        NotConnected: no answer at this address.
        ProtocolError: the device that answers is no such controller.
    """

    PORT: ClassVar = {"baudrate": 57600, "xonxoff": True}

    def __init__(
        self,
        transport: Transport,
        *,
        unit: Unit = "deg",
        address: str | int = 1,
        timeout_s: float = 0.5,
        restart_s: float = 15.0,
        tolerance_deg: float | None = None,
        resolution_deg: float | None = None,
        velocity_deg_s: float | None = None,
        margin_s: float = 2.0,
        min_deg: float | None = None,
        max_deg: float | None = None,
    ) -> None:
        if not str(address).isdecimal() or int(address) not in ADDRESSES:
            raise RigError(f"'{address}' is no address of an SMC100 controller; use one of 1…31")
        self.unit = unit
        tolerance = TOLERANCE[unit] if tolerance_deg is None else tolerance_deg
        self.address = int(address)
        self._transport = transport
        self._line = line = Smc100Line(transport, self.address, timeout_s)
        self._restart_s = restart_s
        self._command, self._doing = "", ""
        self._refusal = NO_ERROR
        self._polls = 0
        self._busy_until = 0.0
        self._searching = False
        with transport.lock:
            state = line.state()
            line.check_alone()
            line.error()  # one of the past is kept until it is asked for
            name = line.query("ID?") or "SMC100"
            limits = line.query_number("SL?"), line.query_number("SR?")
            velocity, acceleration = line.query_number("VA?"), line.query_number("AC?")
            resolution = resolution_deg or self._encoder_step_deg()
        if velocity_deg_s is not None:
            velocity, acceleration = velocity_deg_s, velocity_deg_s / 0.1
        if min(velocity, acceleration, resolution) <= 0.0:
            raise ProtocolError(
                f"{line.name} tells a speed of {velocity:g}{SYMBOLS[unit]}/s; is it a motion stage?"
            )
        limits = (limits[0] if min_deg is None else min_deg, limits[1] if max_deg is None else max_deg)
        rules = MotionRules(max(tolerance, resolution), velocity, acceleration, margin_s)
        super().__init__(f"{name}, address {self.address}", rules, limits, resolution)
        line.name = self.name
        self._bus = transport.lock
        self._homed = state.code not in NOT_REFERENCED | HOMING | {CONFIGURATION}

    def _encoder_step_deg(self) -> float:
        """Encoder increment (CC), or a microstep: motion of a full step over the microsteps in it (PP)."""
        try:
            return self._line.query_number("SU?")
        except NotConnected:
            if self._line.error() == NOT_FOR_STEPPERS:
                return self._line.query_number("FRS?") / max(self._line.query_number("FRM?"), 1.0)
            raise ProtocolError(
                f"{self._line.name} does not tell its resolution (SU); set resolution_deg in the rig file"
            ) from None
        finally:
            self._line.error()

    @classmethod
    def stop_command(cls, *, address: str | int = 1, **_options: object) -> bytes:
        """Stop of the controller at an address; see `PortStage`."""
        return f"{address}ST".encode("ascii", errors="ignore") + TERMINATOR

    # The motion.

    def _read_moving_deg(self) -> float | None:
        return self._line.query_number("TP")

    def _state(self) -> State:
        state = self._line.state()
        if state.code == CONFIGURATION:
            raise RigError(
                f"{self.name} is being configured; leave that state with PW0 in the maker's program"
            )
        return state

    def _read_deg(self) -> float:
        if self._homed and self._state().code in NOT_REFERENCED:
            raise self._lost()
        return self._line.query_number("TP")

    def _lost(self) -> NotHomed:
        self._homed = False
        return NotHomed(f"{self.name} was restarted or switched off, and its position is lost; home it again")

    def _begin_home(self) -> None:
        self._searching = True
        state = self._state()
        if state.code in IN_MOTION - HOMING:
            self._line.send("ST")
            self._wait_until_still()
            state = self._state()
        if state.code in READY | DISABLED:
            self._restart()
        self._begin("OR", "searching the reference")

    def _restart(self) -> None:
        """Restart the controller, and wait until it answers again and knows no reference."""
        self._line.send("RS")  # no question about an error: it answers nothing for some seconds
        deadline = self._clock() + self._restart_s
        while True:
            with contextlib.suppress(NotConnected):
                if self._line.state().code in NOT_REFERENCED:
                    return
            if not self._transport.is_open or self._clock() >= deadline:
                raise NotConnected(f"{self.name} does not come back from its restart; switch it off and on")
            self._clock.sleep(BUSY_POLL_S)

    def _begin_move(self, target_deg: float) -> None:
        self._searching = False
        if self._state().code in DISABLED:
            self._line.command("MM1", "enabling the motor")
        steps = round(target_deg / self._resolution_deg)
        self._begin(f"PA{steps * self._resolution_deg:.6f}", "moving")

    def _begin(self, command: str, doing: str) -> None:
        self._command, self._doing = command, doing
        self._polls = 0
        self._busy_until = self._clock() + self.rules.margin_s
        self._order()

    def _order(self) -> None:
        """Send the command of the motion; one that meets a moving stage is sent again later."""
        self._line.send(self._command)
        self._refusal = self._line.error()
        if self._refusal in BUSY_ERRORS and self._clock() < self._busy_until:
            return
        if self._refusal != NO_ERROR:
            raise error_of_letter(self.name, self._refusal, self._doing)

    def _is_busy(self, wait_s: float) -> bool:
        if self._polls:
            self._clock.sleep(max(0.0, min(wait_s, FIRST_POLL_S * 2.0 ** min(self._polls, 5))))
        self._polls += 1
        state = self._state()
        if state.code in IN_MOTION:
            return True
        if self._refusal != NO_ERROR and not self._stopping.is_set():
            self._clock.sleep(BUSY_POLL_S)
            self._order()
            return True
        if state.code not in READY and not self._stopping.is_set():
            raise self._failure(state)
        return False

    def _failure(self, state: State) -> RigError:
        """Why a motion ended without the stage being ready."""
        if state.code in DISABLED:
            return device_error(
                Stalled,
                f"{self.name}: the motor was disabled, and the controller reports {state.faults_text}",
            )
        if not self._searching and not state.faults:
            return self._lost()
        self._homed = False
        return Stalled(
            f"{self.name}: {self._doing} failed; the controller reports {state.faults_text}; home it again"
        )

    def _send_stop(self) -> None:
        self._line.send("ST")

    def _wait_until_still(self) -> None:
        deadline = self._clock() + self.rules.margin_s
        while self._line.state().code in IN_MOTION and self._clock() < deadline:
            self._clock.sleep(BUSY_POLL_S)
        self._line.error()  # a stop of a stage at rest may have been refused
