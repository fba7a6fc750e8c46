"""Driver for the filter wheels FW102C and FW212C of Thorlabs: six or twelve filters behind a serial port.

Commands of ASCII that end with CR at 115200 baud; the wheel echoes each, answers questions in a line, and ends with the
prompt ``> ``. Errors are lines ``Command error …``. Source: two clients,
Micro-Manager's adapter ThorlabsFilterWheel and python-microscope's ``thorlabs``; the maker's manual was not read.
"""

import contextlib
import re

from anisoscope.base.errors import NotConnected, ProtocolError, RigError
from anisoscope.rig.transport import Transport

BAUDRATE = 115200
TRIES = 3
POLL_S = 0.1
PROMPT = b"> "


class _Silent(NotConnected):
    """Nothing was heard in time; the line may be alive."""


class ThorlabsWheel:
    """A filter wheel; places count from 1.

    Args:
        port: COM port, device path, ``usb:SERIAL``, ``socket://host:port`` or ``sim://fw102c``.
        timeout_s: time in seconds for an answer.
        move_s: the wheel must reach a place within so many seconds.
        settle_s: wait after the place was reached.

    Raises:
        NotConnected: no such port, or silence.
        ProtocolError: another device answers.
    """

    def __init__(
        self, port: str, *, timeout_s: float = 1.0, move_s: float = 8.0, settle_s: float = 0.2
    ) -> None:
        self.name = f"the filter wheel at {port}"
        self._timeout_s, self._move_s, self._settle_s = timeout_s, move_s, settle_s
        self._transport = Transport(port, baudrate=BAUDRATE)
        try:
            self.name = f"filter wheel {self._query(b'*idn?', rb'([ -~]*FW[0-9]+[ -~]*)').decode('ascii')}"
            self._places = int(self._query(b"pcount?", rb"([0-9]{1,2})"))
        except BaseException:
            self._transport.close()
            raise

    @property
    def places(self) -> int:
        """Number of filters."""
        return self._places

    def place(self) -> int:
        """Read the place in the beam.

        Raises:
            NotConnected: silence, or a lost connection.
            ProtocolError: only bytes that are no answer.
        """
        return int(self._query(b"pos?", rb"([0-9]{1,2})"))

    def go(self, place: int) -> None:
        """Turn a place into the beam and read it back.

        Raises:
            NotConnected: the connection was lost.
            RigError: there is no such place, the wheel refuses, or does not come there in time.
        """
        if not 1 <= place <= self._places:
            raise RigError(f"{self.name} has the places 1 to {self._places}, not {place}")
        clock = self._transport.clock
        deadline = clock() + self._move_s
        with contextlib.suppress(_Silent):  # the prompt comes at the end of the turn; the place is read back
            self._exchange(b"pos=%d" % place, re.compile(rb"pos=%d[\r\n]+> $" % place), self._move_s)
        while (there := self.place()) != place:
            if clock() >= deadline:
                raise RigError(
                    f"{self.name} was sent to place {place} and stands at {there}; check that it turns freely"
                )
            clock.sleep(POLL_S)
        clock.sleep(self._settle_s)

    def close(self) -> None:
        """Disconnect; closing twice is fine."""
        self._transport.close()

    def _query(self, command: bytes, answer: bytes) -> bytes:
        """Send a question, again where its answer was damaged; return the answer."""
        pattern = re.compile(re.escape(command) + rb"[\r\n]+" + answer + rb"[\r\n]+> $")
        for _ in range(TRIES):
            if (found := self._exchange(command, pattern, self._timeout_s)) is not None:
                return found
        raise ProtocolError(
            f"{self.name} sends bytes that are no answer of a filter wheel; check port and baud rate"
        )

    def _exchange(self, command: bytes, pattern: re.Pattern[bytes], within_s: float) -> bytes | None:
        """Send a command and wait for the prompt after its answer: its first group, or None if it was damaged."""
        transport = self._transport
        with transport.lock:
            transport.discard()
            transport.write(command + b"\r")
            heard = b""
            deadline = transport.clock() + within_s
            while (left_s := deadline - transport.clock()) > 0.0:
                part = transport.read_until(PROMPT, left_s)
                if part is None:
                    break
                heard += part
                if error := re.search(rb"Command error ([A-Z_]+)", heard):
                    raise RigError(
                        f"{self.name} refuses {command.decode('ascii')}: {error.group(1).decode('ascii')}"
                    )
                if found := pattern.search(heard):
                    return found.group(1) if pattern.groups else b""
            if not heard and not transport.pending:
                raise _Silent(f"{self.name} is silent; check the power, the cable and the port")
            return None
