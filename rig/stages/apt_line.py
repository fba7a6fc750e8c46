"""The conversation with one Thorlabs APT controller: questions, answers, and what comes in between."""

import logging
import time

from anisoscope.base.errors import NotConnected, ProtocolError, RigError
from anisoscope.rig.stages.apt_wire import (
    ACK_DC_STATUS,
    GET_DC_STATUS,
    GET_STATUS,
    HOMED,
    HW_RESPONSE,
    HW_RICH_RESPONSE,
    MOVE_COMPLETED,
    REQ_DC_STATUS,
    REQ_STATUS,
    STOPPED,
    Message,
    Status,
    error_text,
    take_message,
)
from anisoscope.rig.transport import Transport

_log = logging.getLogger(__name__)

TRIES = 3
# A servo controller that sends updates falls silent unless it hears once a second that the host lives.
ACKNOWLEDGE_S = 0.5
ENDS = frozenset({HOMED, MOVE_COMPLETED, STOPPED})


class AptLine:
    """One controller at a port.

    Args:
        transport: the open port.
        address: destination of the messages.
        timeout_s: time in seconds for the answer to a question.

    Attributes:
        name: how error messages call the device.
        servo: whether the controller speaks of its status in the messages of servos, not of steppers.
        ended: id of the last message that said that a motion ended, since `forget` was called.
    """

    def __init__(self, transport: Transport, address: int, timeout_s: float) -> None:
        self.transport = transport
        self.address = address
        self.name = f"the controller at {transport.port}"
        self.servo = False
        self.ended: int | None = None
        self._timeout_s = timeout_s
        self._received = bytearray()
        self._heard = False
        self._stranger: int | None = None
        self._acknowledged = -1e9

    def send(self, *messages: Message) -> None:
        """Send messages in one go, and wait for nothing."""
        self.transport.write(b"".join(message.to_bytes(self.address) for message in messages))

    def forget(self) -> None:
        """Drop everything that has arrived so far."""
        self.transport.discard()
        self._received.clear()
        self.ended = None

    def ask(self, question: Message, expected: int, *, fresh: bool = True) -> Message:
        """Ask a question that may be repeated without harm, and return the newest answer.

        Args:
            question: the question.
            expected: id of its answer.
            fresh: forget first what has arrived.

        Raises:
            NotConnected: silence, or another address answers.
            ProtocolError: only bytes that are no APT message.
            RigError: the controller complains.
        """
        if fresh:
            self.forget()
        for _ in range(TRIES):
            self.send(question)
            self._heard, self._stranger = False, None
            deadline = time.monotonic() + self._timeout_s
            while (message := self._next(deadline)) is not None:
                if message.id == expected:
                    return self._newest(message)
            if not self._heard:
                break
        raise self._silence()

    def status(self, *, fresh: bool = True) -> Status:
        """Ask where the motor stands and what it does."""
        question, answer = (REQ_DC_STATUS, GET_DC_STATUS) if self.servo else (REQ_STATUS, GET_STATUS)
        return Status.parse(self.ask(Message(question, (1, 0)), answer, fresh=fresh).data)

    def wait_for_end(self, wait_s: float) -> None:
        """Wait up to `wait_s` seconds for the news that a motion ended."""
        deadline = time.monotonic() + wait_s
        while (message := self._next(deadline)) is not None:
            if message.id in ENDS:
                return

    def _newest(self, answer: Message) -> Message:
        """The last of the answers that came already: unasked-for ones must not make us lag behind."""
        self._received += self.transport.discard()
        while (message := self._take()) is not None:
            if message.id == answer.id:
                answer = message
        return answer

    def _next(self, deadline: float) -> Message | None:
        while (message := self._take()) is None:
            left_s = deadline - time.monotonic()
            first = self.transport.read_exactly(1, left_s) if left_s > 0.0 else None
            if first is None:
                return None
            self._heard = True
            self._received += first + self.transport.discard()
        return message

    def _take(self) -> Message | None:
        """The next message of this controller that has arrived."""
        while True:
            message, dropped = take_message(self._received)
            if dropped:
                _log.debug("%s: %d bytes are no message", self.name, dropped)
            if message is None:
                return None
            if message.source == self.address:
                break
            self._stranger = message.source
        if message.id in {HW_RESPONSE, HW_RICH_RESPONSE}:
            raise RigError(f"{self.name} reports {error_text(message)}")
        if message.id in ENDS:
            self.ended = message.id
        if message.id == GET_DC_STATUS:
            self._acknowledge()
        return message

    def _acknowledge(self) -> None:
        now = time.monotonic()
        if now - self._acknowledged > ACKNOWLEDGE_S:
            self._acknowledged = now
            self.send(Message(ACK_DC_STATUS))

    def _silence(self) -> RigError:
        if self._stranger is not None:
            return NotConnected(
                f"{self.name} is silent at address {self.address:02X}, but {self._stranger:02X} answers; "
                "correct the address"
            )
        if self._heard:
            return ProtocolError(f"{self.name} sends bytes that are no APT message; check port and baud rate")
        return NotConnected(f"{self.name} is silent; check the power, the cable and the port")
