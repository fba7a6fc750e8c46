"""The conversation with one Elliptec device: questions, answers, and what comes in between."""

import logging
import time

from anisoscope.base.errors import MotionTimeout, NotConnected, ProtocolError, RigError
from anisoscope.rig.stages.elliptec_wire import BUSY, OK, TERMINATOR, UNSOLICITED, Answer, error_of_status
from anisoscope.rig.transport import Transport

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
        deadline = time.monotonic() + wait_s
        damaged = 0
        while (line := self.transport.read_until(TERMINATOR, deadline - time.monotonic())) is not None:
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

    def ask(self, command: str, expected: str) -> Answer:
        """Ask a question that may be repeated without harm, and return the answer.

        A damaged answer is asked for again; a busy device is asked for up to `busy_limit_s`.
        """
        busy_until = time.monotonic() + self.busy_limit_s
        tries = 0
        while tries < TRIES:
            self.transport.discard()
            self.send(command)
            answer = self._await_answer(expected)
            if answer is None:
                tries = tries + 1 if self._heard or self.transport.pending else TRIES
            elif answer.code == expected:
                return answer
            elif time.monotonic() >= busy_until:
                raise MotionTimeout(f"{self.name} stays busy; switch it off and on")
            else:
                time.sleep(BUSY_POLL_S)
        raise self._silence()

    def _await_answer(self, expected: str) -> Answer | None:
        """Wait for an answer of one kind, or for the news that the device is busy or in trouble."""
        deadline = time.monotonic() + self._timeout_s
        self._stranger = ""
        self._heard = False
        while (left_s := deadline - time.monotonic()) > 0.0:
            answer = self.next_answer(left_s)
            if answer is None:
                break
            if answer.code == expected or answer.status == BUSY:
                return answer
            if answer.status not in {None, OK}:
                raise error_of_status(self.name, answer.status or 0, "asked a question")
        return None

    def _silence(self) -> RigError:
        if self._stranger:
            return NotConnected(
                f"{self.name} is silent, but address {self._stranger} answers; correct the address"
            )
        if self._heard or self.transport.pending:
            return ProtocolError(
                f"{self.name} sends bytes that are no Elliptec answer; check port and baud rate"
            )
        return NotConnected(f"{self.name} is silent; check the power, the cable and the address")

    def set(self, command: str, doing: str) -> None:
        """Send a command that the device acknowledges with its status; `doing` says it in error messages."""
        with self.transport.lock:
            self.transport.discard()
            self.send(command)
            answer = self._await_answer("GS")
            if answer is None:
                raise self._silence()
            if answer.status:
                raise error_of_status(self.name, answer.status, doing)
