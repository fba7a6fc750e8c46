"""The conversation with one Zaber device: numbered questions, their answers, and what comes in between."""

import itertools
import logging
import time

from anisoscope.base.errors import NotConnected, ProtocolError, RigError
from anisoscope.rig.stages.zaber_wire import (
    NO_FLAG,
    TERMINATOR,
    Reply,
    command,
    error_of_rejection,
    is_alert_of,
    is_aside,
)
from anisoscope.rig.transport import Transport

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

    def ask(self, words: str, axis: int | None = None) -> Reply:
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
        """As `ask`; a rejection is raised as the error that it stands for."""
        reply = self.ask(words, axis)
        if not reply.accepted:
            raise error_of_rejection(self.name, words, reply)
        return reply

    def number(self, setting: str, axis: int | None = None) -> float | None:
        """Read a setting that is a number; None if the device has no such setting.

        Raises:
            ProtocolError: it is none.
        """
        reply = self.ask(f"get {setting}", axis)
        if not reply.accepted:
            return None
        try:
            return float(reply.data)
        except ValueError:
            raise ProtocolError(f"{self.name} says '{reply.data}' for {setting}; that is no number") from None

    def rest(self, wait_s: float) -> None:
        """Wait, but no longer than until the device alerts us."""
        deadline = time.monotonic() + wait_s
        while (left_s := deadline - time.monotonic()) > 0.0:
            line = self.transport.read_until(TERMINATOR, left_s)
            if line is not None and is_alert_of(line, self.device):
                return

    def _await_reply(self, number: int, axis: int) -> Reply | None:
        deadline = time.monotonic() + self._timeout_s
        damaged = 0
        while (line := self.transport.read_until(TERMINATOR, deadline - time.monotonic())) is not None:
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
            elif (reply.number, reply.axis) == (number, axis):  # others answer what nobody waits for
                return reply
        return None

    def _silence(self) -> RigError:
        if self._stranger is not None:
            return NotConnected(
                f"{self.name} is silent, but address {self._stranger} answers; correct the address"
            )
        if self._heard or self.transport.pending:
            return ProtocolError(
                f"{self.name} sends bytes that are no Zaber ASCII answer; check port and baud rate"
            )
        return NotConnected(
            f"{self.name} is silent; check the power, the cable, the address and the baud rate"
        )
