"""Driver for the light controller of ``rig/firmware/light``: a board that dims a lamp, over a serial port.

The controller switches itself off when it hears nothing; while the light is on, a thread keeps talking to it. What
was switched is read back, and measured where the board has a sensor.

Driver and board exchange lines of ASCII (docs/interfaces.md).
"""

import contextlib
import logging
import re
import threading
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
    """Status reported by the controller.

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
        self._clock = transport.clock
        self.name = f"the light at {transport.port}"
        self._timeout_s = timeout_s

    def query(self, command: str, expected: str) -> str:
        """Send a command and return its answer, which begins with `expected`; damaged answers are queried again.

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
        """Query the state."""
        return LightStatus.parse(self.query("STATUS?", "STATUS"))

    def identify(self, boot_s: float) -> str:
        """Identify the controller, for as long as a board may take to start after the port was opened."""
        deadline = self._clock() + boot_s
        while True:
            try:
                return self.query("ID?", "ID")
            except NotConnected:
                if not self.transport.is_open or self._clock() >= deadline:
                    raise
                self._clock.sleep(BOOT_POLL_S)

    def _await(self, expected: str) -> tuple[bool, str | None]:
        """Whether anything came in time, and the answer if it was among it."""
        heard = False
        deadline = self._clock() + self._timeout_s
        while (left_s := deadline - self._clock()) > 0.0:
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


BAUDRATE = 115200
SENSOR_POLL_S = 0.02


class SerialLight:
    """A dimmable light at a serial port.

    Args:
        port: COM port, device path, ``socket://host:port`` or ``sim://light``.
        level_percent: level when on, 1 … 100.
        timeout_s: time in seconds for an answer.
        boot_s: for so long a board may start after the port was opened (an Arduino resets then).
        watchdog_s: the controller switches off after so many seconds without a word, 1 … 600.
        settle_s: the lamp must reach its level within so many seconds.
        tolerance_percent: a measured level this near to the one that was set is right.

    Raises:
        NotConnected: no such port, or silence.
        ProtocolError: another device answers.
        RigError: an option is out of range.
    """

    def __init__(
        self,
        port: str,
        *,
        level_percent: int = 100,
        timeout_s: float = 0.5,
        boot_s: float = 4.0,
        watchdog_s: int = 10,
        settle_s: float = 1.0,
        tolerance_percent: float = 10.0,
    ) -> None:
        if not 1 <= level_percent <= 100:
            raise RigError(f"level_percent must lie between 1 and 100, not {level_percent}")
        if not 1 <= watchdog_s <= 600:
            raise RigError(f"watchdog_s must lie between 1 and 600, not {watchdog_s}")
        self._level, self._settle_s, self._tolerance = int(level_percent), settle_s, tolerance_percent
        self._watchdog_s = int(watchdog_s)
        self._stop_talking = threading.Event()
        self._talker: threading.Thread | None = None
        self._went_out = ""
        self._transport = Transport(port, baudrate=BAUDRATE)
        try:
            self._line = LightLine(self._transport, timeout_s)
            self.name = self._line.name = f"light {self._line.identify(boot_s).removeprefix('ID ')}"
            self._line.query("OFF", "OK OFF")
            self._line.query(f"WATCHDOG {self._watchdog_s}", "OK WATCHDOG")
        except BaseException:
            self._transport.close()
            raise

    def status(self) -> LightStatus:
        """Query the state of the controller."""
        return self._line.status()

    def on(self) -> None:
        """Switch on, and return when the lamp has its level.

        Raises:
            NotConnected: the connection was lost.
            RigError: the controller refuses, the lamp stays dark or at a wrong level.
        """
        self._went_out = ""
        self._line.query(f"LEVEL {self._level}", "OK LEVEL")
        self._switch("ON", on=True)
        self._start_talking()

    def off(self) -> None:
        """Switch off, and return when the lamp is dark.

        Raises:
            NotConnected: the connection was lost; the controller's watchdog will switch off.
            RigError: the lamp still shines, or it went out by itself while it should have shone.
        """
        self._finish_talking()
        self._switch("OFF", on=False)
        went_out, self._went_out = self._went_out, ""
        if went_out:
            raise RigError(f"{self.name} {went_out}; frames taken since may be dark")

    def close(self) -> None:
        """Switch off and disconnect; closing twice is fine."""
        self._finish_talking()
        if self._transport.is_open:
            with contextlib.suppress(RigError):
                self._switch("OFF", on=False)
        self._transport.close()

    def _switch(self, command: str, *, on: bool) -> None:
        self._line.query(command, f"OK {command}")
        deadline = self._transport.clock() + self._settle_s
        while True:
            status = self._line.status()
            wrong = self._what_is_wrong(status, on)
            if not wrong:
                return
            if status.on != on or self._transport.clock() >= deadline:
                raise RigError(f"{self.name} was switched {command.lower()}, but {wrong}")
            self._transport.clock.sleep(SENSOR_POLL_S)

    def _what_is_wrong(self, status: LightStatus, on: bool) -> str:
        if status.on != on:
            return f"says that it is {'on' if status.on else 'off'}; check its power supply"
        target = self._level if on else 0
        if on and status.level_percent != target:
            return f"its level is {status.level_percent} % instead of {target} %"
        sensed = status.sensed_percent
        if sensed is not None and abs(sensed - target) > self._tolerance:
            return f"{sensed} % are measured at the lamp instead of {target} %; check lamp and cable"
        return ""

    # The controller hears from us while the light is on.

    def _start_talking(self) -> None:
        self._finish_talking()
        self._stop_talking.clear()
        self._talker = threading.Thread(target=self._talk, name=f"keep {self.name} on", daemon=True)
        self._talker.start()

    def _finish_talking(self) -> None:
        self._stop_talking.set()
        if self._talker is not None:
            self._talker.join()
            self._talker = None

    def _talk(self) -> None:
        while not self._stop_talking.wait(self._watchdog_s / 4.0):
            try:
                if not self._line.status().on:
                    self._went_out = "went out by itself"
            except RigError as problem:
                self._went_out = f"was lost: {problem}"
            if self._went_out:
                _log.warning("%s %s", self.name, self._went_out)
                return
