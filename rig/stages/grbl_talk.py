"""Talking to a Grbl board: lines out, messages in, and what every message means for all axes."""

import logging
import time
from collections.abc import Callable

from anisoscope.base.errors import NotConnected, ProtocolError
from anisoscope.rig.stages.grbl_wire import (
    CRITICAL_ALARMS,
    TERMINATOR,
    Alarm,
    Banner,
    Message,
    Ok,
    Refused,
    Status,
    Told,
    error_of_refusal,
    parse,
)
from anisoscope.rig.transport import Transport

_log = logging.getLogger(__name__)

TRIES = 3
MAX_DAMAGED_LINES = 16


class GrblTalk:
    """A conversation. Whoever talks holds the lock of the transport.

    Args:
        transport: the open port.
        timeout_s: time in seconds for the answer to a question.

    Attributes:
        name: how error messages call the board.
        zeros: for every axis that was homed since, the steps at which it stands at 0°.
        critical: whether the board answers nothing until it is reset.
        alarm: the last alarm that was not dealt with, or None.
        answer: how the last line was acknowledged, or None.
    """

    def __init__(self, transport: Transport, timeout_s: float) -> None:
        self.name = f"the Grbl board at {transport.port}"
        self.zeros: dict[str, int] = {}
        self.critical = False
        self.alarm: int | None = None
        self.answer: Ok | Refused | None = None
        self._transports = [transport]
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
        deadline = time.monotonic() + wait_s
        while (line := self._transport.read_until(TERMINATOR, deadline - time.monotonic())) is not None:
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
            if message.state in {"Alarm", "Sleep"}:
                self.zeros.clear()
        elif isinstance(message, Told):
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

    def silence(self) -> NotConnected | ProtocolError:
        """The error for an answer that did not come."""
        if self.critical:
            return NotConnected(f"{self.name} is locked by an alarm and answers nothing; home it again")
        if self._damaged or (self._transport.pending and not self._heard):
            return ProtocolError(f"{self.name} sends bytes that are no Grbl answer; check port and baud rate")
        return NotConnected(f"{self.name} is silent; check the power, the cable and the port")
