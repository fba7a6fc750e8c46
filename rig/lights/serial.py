"""Driver for the light controller of ``rig/firmware/light``: a board that dims a lamp, over a serial port.

The controller switches itself off when it hears nothing; while the light is on, a thread keeps talking to it. What
was switched is read back, and measured where the board has a sensor.
"""

import contextlib
import logging
import threading
import time

from anisoscope.base.errors import RigError
from anisoscope.rig.lights.light_line import LightLine, LightStatus
from anisoscope.rig.transport import Transport

_log = logging.getLogger(__name__)

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
        ProtocolError: somebody else answers.
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
            self._line.ask("OFF", "OK OFF")
            self._line.ask(f"WATCHDOG {self._watchdog_s}", "OK WATCHDOG")
        except BaseException:
            self._transport.close()
            raise

    def status(self) -> LightStatus:
        """Ask the controller for its state."""
        return self._line.status()

    def on(self) -> None:
        """Switch on, and return when the lamp has its level.

        Raises:
            NotConnected: the connection was lost.
            RigError: the controller refuses, the lamp stays dark or at a wrong level.
        """
        self._went_out = ""
        self._line.ask(f"LEVEL {self._level}", "OK LEVEL")
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
        self._line.ask(command, f"OK {command}")
        deadline = time.monotonic() + self._settle_s
        while True:
            status = self._line.status()
            wrong = self._what_is_wrong(status, on)
            if not wrong:
                return
            if status.on != on or time.monotonic() >= deadline:
                raise RigError(f"{self.name} was switched {command.lower()}, but {wrong}")
            time.sleep(SENSOR_POLL_S)

    def _what_is_wrong(self, status: LightStatus, on: bool) -> str:
        if status.on != on:
            return f"says that it is {'on' if status.on else 'off'}; check its power supply"
        wanted = self._level if on else 0
        if on and status.level_percent != wanted:
            return f"its level is {status.level_percent} % instead of {wanted} %"
        sensed = status.sensed_percent
        if sensed is not None and abs(sensed - wanted) > self._tolerance:
            return f"{sensed} % are measured at the lamp instead of {wanted} %; check lamp and cable"
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
