"""The conversation with one SMC100 or CONEX controller: questions, answers, and commands that are not answered."""

import logging
import time

from anisoscope.base.errors import NotConnected, ProtocolError, RigError
from anisoscope.rig.stages.smc100_wire import NO_ERROR, TERMINATOR, Answer, State, error_of_letter
from anisoscope.rig.transport import Transport

_log = logging.getLogger(__name__)

TRIES = 3
MAX_DAMAGED_LINES = 16


class Smc100Line:
    """One address of a port. Whoever talks holds the lock of the transport, because several may share it.

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
        self._address = address
        self._timeout_s = timeout_s
        self._stranger: int | None = None
        self._heard = False

    def send(self, command: str) -> None:
        """Send a command, and wait for nothing."""
        self._transport.write(f"{self._address}{command}".encode("ascii") + TERMINATOR)

    def ask(self, question: str) -> str:
        """Ask a question, and return the value; a damaged answer is asked for again."""
        for _ in range(TRIES):
            self._transport.discard()
            self._stranger, self._heard = None, False
            self.send(question)
            if (value := self._answer_to(question[:2])) is not None:
                return value
            if not (self._heard or self._transport.pending):
                break
        raise self._silence()

    def ask_number(self, question: str) -> float:
        """Ask for a number.

        Raises:
            ProtocolError: the answer is none.
        """
        value = self.ask(question)
        try:
            return float(value)
        except ValueError:
            raise ProtocolError(
                f"{self.name} answers '{value[:40]}' to {question}: that is no number"
            ) from None

    def state(self) -> State:
        """Ask for faults and state.

        Raises:
            ProtocolError: the answer is none.
        """
        value = ""
        for _ in range(TRIES):
            value = self.ask("TS")
            if (state := State.parse(value)) is not None:
                return state
        raise ProtocolError(f"{self.name} answers '{value[:40]}' to TS: that is no state")

    def error(self) -> str:
        """Ask for the letter of the last error, which forgets it; ``@`` is none."""
        return self.ask("TE")[:1] or NO_ERROR

    def command(self, command: str, doing: str) -> None:
        """Send a command and ask whether it was taken; `doing` says it in error messages."""
        self.send(command)
        if (letter := self.error()) != NO_ERROR:
            raise error_of_letter(self.name, letter, doing)

    def _answer_to(self, code: str) -> str | None:
        deadline = time.monotonic() + self._timeout_s
        damaged = 0
        while (line := self._transport.read_until(TERMINATOR, deadline - time.monotonic())) is not None:
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

    def _silence(self) -> RigError:
        if self._stranger is not None:
            return NotConnected(
                f"{self.name} is silent, but address {self._stranger} answers; correct the address"
            )
        if self._heard or self._transport.pending:
            return ProtocolError(
                f"{self.name} sends bytes that are no SMC100 answer; check port and baud rate"
            )
        return NotConnected(f"{self.name} is silent; check the power, the cable and the address")
