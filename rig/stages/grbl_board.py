"""A Grbl board, which several axes share: how it starts, what it is, where it stands."""

import logging
import weakref
from collections.abc import Callable

from anisoscope.base.errors import NotConnected, ProtocolError, RigError
from anisoscope.rig.stages.grbl_wire import (
    ACCELERATION,
    CRITICAL_ALARMS,
    HOMING,
    HOMING_DIRECTION,
    INCHES,
    PULL_OFF,
    RATE,
    RESET,
    STATUS,
    STEPS,
    TERMINATOR,
    TRAVEL,
    Alarm,
    Banner,
    Feedback,
    Message,
    Ok,
    Refused,
    Setting,
    Status,
    error_of_refusal,
    parse,
)
from anisoscope.rig.stages.no_answer import no_answer
from anisoscope.rig.transport import Transport

_log = logging.getLogger(__name__)

TRIES = 3
MAX_DAMAGED_LINES = 16


class GrblTalk:
    """The line protocol of one board; callers hold the lock of the transport.

    Args:
        transport: the open port.
        timeout_s: time in seconds for the answer to a question.

    Attributes:
        name: how error messages call the board.
        zeros: for every axis that was homed since, the steps at which it stands at 0°.
        critical: whether the board answers nothing until it is reset.
        feed_percent: its feed override, as last reported.
        alarm: the last alarm that was not dealt with, or None.
        answer: how the last line was acknowledged, or None.
    """

    def __init__(self, transport: Transport, timeout_s: float) -> None:
        self.name = f"the Grbl board at {transport.port}"
        self.zeros: dict[str, int] = {}
        self.critical = False
        self.feed_percent = 100
        self.alarm: int | None = None
        self.answer: Ok | Refused | None = None
        self._transports = [transport]
        self._clock = transport.clock
        self._timeout_s = timeout_s
        self._offset: tuple[float, ...] = ()
        self._rest = b""
        self._damaged = 0
        self._heard = False

    def attach(self, transport: Transport) -> None:
        """Know another holder of the same connection: it outlives those that let go."""
        self._transports = [known for known in self._transports if known.is_open] + [transport]

    @property
    def _transport(self) -> Transport:
        return next((known for known in self._transports if known.is_open), self._transports[-1])

    def send(self, line: str) -> None:
        """Send a line, and wait for nothing."""
        self.answer = None
        self._transport.write(line.encode("ascii") + TERMINATOR)

    def send_now(self, byte: bytes) -> None:
        """Send a real-time byte; needs no lock."""
        self._transport.write(byte)

    def next_message(self, wait_s: float) -> Message | None:
        """Return the next message within `wait_s` seconds, and take note of what it means for all axes."""
        deadline = self._clock() + wait_s
        while (line := self._transport.read_until(TERMINATOR, deadline - self._clock())) is not None:
            line, self._rest = self._rest + line, b""
            if (message := self._take(line)) is not None:
                return message
        return None

    def drain(self) -> None:
        """Take note of everything that has arrived."""
        *lines, self._rest = (self._rest + self._transport.discard()).split(TERMINATOR)
        for line in lines:
            self._take(line)

    def _take(self, line: bytes) -> Message | None:
        message = parse(line)
        if message is not None:
            self._damaged = 0
            self._note(message)
        elif line.strip(b"\r\n\0 "):
            self._damaged += 1
            _log.info("%s: damaged line %r", self.name, line[:80])
            if self._damaged >= MAX_DAMAGED_LINES:
                raise ProtocolError(f"{self.name} sends only garbage; check port and baud rate")
        return message

    def _note(self, message: Message) -> None:
        self._heard = True
        if isinstance(message, Ok | Refused):
            self.answer = message
        elif isinstance(message, Banner):
            self.zeros.clear()
            self.critical = False
        elif isinstance(message, Alarm):
            self.zeros.clear()
            self.alarm = message.code
            self.critical = self.critical or message.code in CRITICAL_ALARMS
        elif isinstance(message, Status):
            self._offset = message.offset or self._offset
            self.feed_percent = message.feed_percent or self.feed_percent
            if message.state in {"Alarm", "Sleep"}:
                self.zeros.clear()
        elif isinstance(message, Feedback):
            _log.info("%s: [%s:%s]", self.name, message.name, message.text)

    def request(self, line: str, take: Callable[[Message], object]) -> None:
        """Send a line that may be repeated without harm; hand over what comes until it is acknowledged.

        Raises:
            NotConnected: no answer.
            RigError: the board refuses the line.
        """
        for _ in range(TRIES):
            self.drain()
            self._heard = False
            self.send(line)
            while (message := self.next_message(self._timeout_s)) is not None:
                if isinstance(message, Ok):
                    return
                if isinstance(message, Refused):
                    raise error_of_refusal(self.name, message.code, f"asked {line}")
                take(message)
                if self.critical:
                    raise self.silence()
            if not self._heard:
                break
        raise self.silence()

    def silence(self) -> RigError:
        """The error for an answer that did not come."""
        if self.critical:
            return NotConnected(f"{self.name} is locked by an alarm and answers nothing; home it again")
        heard = bool(self._damaged or (self._transport.pending and not self._heard))
        return no_answer(
            self.name,
            self._transport,
            self._timeout_s,
            "Grbl",
            heard=heard,
            check="the power, the cable and the port",
        )


# The offset of the work coordinates comes along with every 30th report at the latest.
REPORTS_UNTIL_OFFSET = 32
NEEDED_SETTINGS = (STEPS, RATE, ACCELERATION, TRAVEL, INCHES, HOMING, HOMING_DIRECTION, PULL_OFF)


class GrblBoard(GrblTalk):
    """A board behind a port.

    Args:
        transport: the open port.
        timeout_s: time in seconds for the answer to a question.
        reset_s: for so long a board that was reset by opening the port has time to start.

    Attributes:
        version: firmware release.
        note: the user's text in the board.
        options: letters of the options that were compiled in.
        settings: the settings, by number.
        homings: how often a reference search ended.

    Raises:
        NotConnected: no answer.
        ProtocolError: the device that answers is no Grbl 1.1.
    """

    def __init__(self, transport: Transport, timeout_s: float, reset_s: float) -> None:
        super().__init__(transport, timeout_s)
        self.settings: dict[int, float] = {}
        self.version = self.note = self.options = ""
        self.homings = 0
        self._connect(reset_s)

    def query_status(self, wait_s: float | None = None) -> Status:
        """Query a status report and fill in the machine position.

        Raises:
            NotConnected: no report within `wait_s` seconds, by default the time for an answer.
        """
        self.drain()
        for _ in range(REPORTS_UNTIL_OFFSET):
            status = self._one_status(self._timeout_s if wait_s is None else wait_s)
            machine = self._machine(status)
            if machine:
                return Status(
                    status.state, status.substate, machine, status.work, self._offset, pins=status.pins
                )
        raise ProtocolError(f"{self.name} does not say where its work coordinates begin; set $10=1")

    def _one_status(self, wait_s: float) -> Status:
        for _ in range(TRIES):
            self._heard = False
            self.send_now(STATUS)
            deadline = self._clock() + wait_s
            while (left_s := deadline - self._clock()) > 0.0:
                message = self.next_message(left_s)
                if isinstance(message, Status):
                    return message
                if message is None or self.critical:
                    break
            if self.critical or not self._heard:
                break
        raise self.silence()

    def _machine(self, status: Status) -> tuple[float, ...]:
        if status.machine or not self._offset:
            return status.machine
        return tuple(place + offset for place, offset in zip(status.work, self._offset, strict=False))

    # Starting.

    def reset(self, wait_s: float = 1.0) -> bool:
        """Reset the firmware, and wait for it to start; whether it did. A board at rest keeps its position."""
        self.drain()
        self.send_now(RESET)
        return self._await_banner(wait_s)

    def _await_banner(self, wait_s: float) -> bool:
        deadline = self._clock() + wait_s
        while (left_s := deadline - self._clock()) > 0.0:
            message = self.next_message(left_s)
            if isinstance(message, Banner):
                self.version = message.version
                return True
        return False

    def _connect(self, reset_s: float) -> None:
        # A board without reset by DTR may stand in the middle of anything: it is reset by a byte.
        if not self._await_banner(reset_s) and not self.reset(self._timeout_s):
            raise self.silence()
        if self.version < "1.1":
            raise ProtocolError(f"{self.name} runs Grbl {self.version}; this driver needs 1.1 or newer")
        try:
            self.request("$I", self._take_build)
        except NotConnected:
            # An alarm that stands since power-up locks the board; only a reset helps.
            if not (self.critical and self.reset(self._timeout_s)):
                raise
            self.request("$I", self._take_build)
        self.alarm = None
        self.request("$$", self._take_setting)
        if missing := [number for number in NEEDED_SETTINGS if number not in self.settings]:
            raise ProtocolError(f"{self.name} does not list its setting ${missing[0]}; is it Grbl 1.1?")
        if self.settings[INCHES]:
            raise ProtocolError(f"{self.name} reports in inches; set $13=0")

    def _take_build(self, message: Message) -> None:
        if isinstance(message, Feedback) and message.name == "VER":
            self.note = message.text.partition(":")[2].strip()
        elif isinstance(message, Feedback) and message.name == "OPT":
            self.options = message.text.partition(",")[0]

    def _take_setting(self, message: Message) -> None:
        if isinstance(message, Setting):
            self.settings[message.number] = message.value


# By the lock of their connection, which lives as long as the board.
_boards: weakref.WeakValueDictionary[int, GrblBoard] = weakref.WeakValueDictionary()


def board_on(transport: Transport, timeout_s: float, reset_s: float) -> GrblBoard:
    """The board behind a port; axes that share a connection share it. Errors as for `GrblBoard`."""
    with transport.lock:
        board = _boards.get(id(transport.lock))
        if board is None:
            board = _boards[id(transport.lock)] = GrblBoard(transport, timeout_s, reset_s)
        else:
            board.attach(transport)
        return board
