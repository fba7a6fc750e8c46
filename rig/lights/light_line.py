"""The conversation with the light controller of ``rig/firmware/light``: lines of ASCII (docs/lights.md)."""

import logging
import re
import time
from dataclasses import dataclass
from typing import Self

from anisoscope.base.errors import NotConnected, ProtocolError, RigError
from anisoscope.rig.transport import Transport

_log = logging.getLogger(__name__)

TRIES = 3
BOOT_POLL_S = 0.3
_ANSWER = re.compile(rb"(?:^|[^A-Z])((?:ID|OK|STATUS|ERR) [ -~]*)$")
_STATUS = re.compile(r"STATUS (ON|OFF) (\d{1,3}) (-|\d{1,3}) (\d{1,3})")


@dataclass(frozen=True)
class LightStatus:
    """What the controller says of itself.

    Attributes:
        on: whether it is switched on.
        level_percent: level to which it is set.
        sensed_percent: level that it measures at the lamp; None if the board has no sensor.
        watchdog_s: seconds of silence after which it switches itself off.
    """

    on: bool
    level_percent: int
    sensed_percent: int | None
    watchdog_s: int

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read a STATUS answer.

        Raises:
            ProtocolError: it is not written as the protocol has it.
        """
        match = _STATUS.fullmatch(text)
        if match is None:
            raise ProtocolError(
                f"the light controller answers '{text}'; its firmware is not the one of this release"
            )
        state, level, sensed, watchdog = match.groups()
        return cls(state == "ON", int(level), None if sensed == "-" else int(sensed), int(watchdog))


class LightLine:
    """One controller at a port; `name` is how error messages call it."""

    def __init__(self, transport: Transport, timeout_s: float) -> None:
        self.transport = transport
        self.name = f"the light at {transport.port}"
        self._timeout_s = timeout_s

    def ask(self, command: str, expected: str) -> str:
        """Send a command and return its answer, which begins with `expected`; damaged answers are asked for again.

        Raises:
            NotConnected: silence, or a lost connection.
            ProtocolError: only bytes that are no answer.
            RigError: the controller refuses.
        """
        with self.transport.lock:
            for _ in range(TRIES):
                self.transport.discard()
                self.transport.write(f"{command}\n".encode("ascii"))
                heard, answer = self._await(expected)
                if answer is not None:
                    return answer
                if not heard:
                    raise NotConnected(f"{self.name} is silent; check the power, the cable and the port")
        raise ProtocolError(
            f"{self.name} sends bytes that are no answer of a light; check port and baud rate"
        )

    def status(self) -> LightStatus:
        """Ask for the state."""
        return LightStatus.parse(self.ask("STATUS?", "STATUS"))

    def identify(self, boot_s: float) -> str:
        """Ask who is there, for as long as a board may take to start after the port was opened."""
        deadline = time.monotonic() + boot_s
        while True:
            try:
                return self.ask("ID?", "ID")
            except NotConnected:
                if not self.transport.is_open or time.monotonic() >= deadline:
                    raise
                time.sleep(BOOT_POLL_S)

    def _await(self, expected: str) -> tuple[bool, str | None]:
        """Whether anything came in time, and the answer if it was among it."""
        heard = False
        deadline = time.monotonic() + self._timeout_s
        while (left_s := deadline - time.monotonic()) > 0.0:
            line = self.transport.read_until(b"\n", left_s)
            if line is None:
                break
            heard = True
            match = _ANSWER.search(line.rstrip(b"\r\n"))
            text = match.group(1).decode("ascii") if match else ""
            if text.startswith("ERR"):
                raise RigError(f"{self.name} refuses: {text.removeprefix('ERR ')}")
            if text.startswith(expected):
                return True, text
            _log.info("%s: unasked for, or damaged: %r", self.name, line[:60])
        return heard or bool(self.transport.pending), None
