"""Driver for LED controllers of CoolLED (pE-300 series, pE-4000): up to eight lamps behind one serial port.

Lines of ASCII at 57600 baud. ``CSS?`` asks for the state of all lamps, and ``CSS`` with six characters a lamp sets it:
its letter A to H, S or X (selected or not), N or F (on or off), and three digits of level in percent. Both are answered
by the state. Source: Micro-Manager's adapter CoolLEDpE300 (CoolLED Ltd, BSD) and python-microscope's ``coolled``.
"""

import contextlib
import re
from collections.abc import Mapping
from dataclasses import dataclass

from anisoscope.base.errors import NotConnected, ProtocolError, RigError
from anisoscope.rig.transport import Transport

BAUDRATE = 57600
TRIES = 3
_STATE = re.compile(rb"CSS((?:[A-H][SX][NF][0-9]{3})+)\r?\n$")
_MODEL = re.compile(rb"XMODEL=([ -~]+)\r?\n$")


@dataclass(frozen=True)
class LampState:
    """State of a lamp as the controller reports it; a lamp that is not selected stays dark."""

    selected: bool
    on: bool
    level_percent: int

    @property
    def shines_percent(self) -> int:
        """Level at which it shines; 0 while it is dark."""
        return self.level_percent if self.selected and self.on else 0


class CoolLed:
    """The lamps of one controller.

    Args:
        port: COM port, device path, ``usb:SERIAL``, ``socket://host:port`` or ``sim://coolled``.
        level_percent: of all lamps, until channels say otherwise, 1 … 100.
        timeout_s: time in seconds for an answer.

    Raises:
        NotConnected: no such port, or silence.
        ProtocolError: another device answers.
        RigError: an option is out of range.
    """

    def __init__(self, port: str, *, level_percent: int = 100, timeout_s: float = 0.5) -> None:
        self.name = f"the light at {port}"
        self._timeout_s = timeout_s
        self._transport = Transport(port, baudrate=BAUDRATE)
        try:
            self._model = self._ask(b"XMODEL", _MODEL).decode("ascii").strip()
            self.name = f"light CoolLED {self._model}"
            self._letters = tuple(self.state())
            self.select(dict.fromkeys(self._letters, level_percent))
            self.off()
        except BaseException:
            self._transport.close()
            raise

    @property
    def lamps(self) -> tuple[str, ...]:
        """Letters of its lamps."""
        return self._letters

    def select(self, levels_percent: Mapping[str, int]) -> None:
        """Choose the lamps that `on` lights, and their levels.

        Raises:
            RigError: there is no such lamp, or a level is out of range.
        """
        for lamp, level in levels_percent.items():
            if lamp not in self._letters:
                raise RigError(f"{self.name} has no lamp '{lamp}'; its lamps are {', '.join(self._letters)}")
            if not 1 <= level <= 100:
                raise RigError(f"level_percent must lie between 1 and 100, not {level}")
        self._levels = dict(levels_percent)

    def state(self) -> dict[str, LampState]:
        """Query all lamps.

        Raises:
            NotConnected: silence, or a lost connection.
            ProtocolError: only bytes that are no answer.
        """
        return _states(self._ask(b"CSS?", _STATE))

    def on(self) -> None:
        """Light the selected lamps, darken all others, and read back what shines.

        Raises:
            NotConnected: the connection was lost.
            RigError: a lamp stays dark, has a wrong level, or shines without being asked to.
        """
        self._set({lamp: self._levels.get(lamp, 0) for lamp in self._letters})

    def off(self) -> None:
        """Darken all lamps; errors as of `on`."""
        self._set(dict.fromkeys(self._letters, 0))

    def close(self) -> None:
        """Darken all lamps and disconnect; closing twice is fine."""
        if self._transport.is_open:
            with contextlib.suppress(RigError):
                self.off()
        self._transport.close()

    def _set(self, levels: Mapping[str, int]) -> None:
        said = "".join(
            f"{lamp}S{'N' if level else 'F'}{level or self._levels.get(lamp, 0):03d}"
            for lamp, level in levels.items()
        )
        self._ask(b"CSS" + said.encode("ascii"), _STATE)
        for lamp, state in self.state().items():
            wanted = levels.get(lamp, 0)
            if state.shines_percent != wanted:
                raise RigError(
                    f"{self.name}: lamp {lamp} shines at {state.shines_percent} % instead of {wanted} %; check the "
                    "lamp, and whether the control pod is locked"
                )

    def _ask(self, command: bytes, answer: re.Pattern[bytes]) -> bytes:
        """Send a command and return the group of its answer; damaged answers are queried again."""
        transport = self._transport
        with transport.lock:
            for _ in range(TRIES):
                transport.discard()
                transport.write(command + b"\r")
                heard, deadline = False, transport.clock() + self._timeout_s
                while (left_s := deadline - transport.clock()) > 0.0:
                    line = transport.read_until(b"\n", left_s)
                    if line is None:
                        break
                    heard = True
                    if found := answer.search(line):
                        return found.group(1)
                if not heard and not transport.pending:
                    raise NotConnected(f"{self.name} is silent; check the power, the cable and the port")
        raise ProtocolError(
            f"{self.name} sends bytes that are no answer of a CoolLED controller; check port and baud rate"
        )


def _states(text: bytes) -> dict[str, LampState]:
    said = text.decode("ascii")
    each = [said[start : start + 6] for start in range(0, len(said), 6)]
    return {one[0]: LampState(one[1] == "S", one[2] == "N", int(one[3:])) for one in each}
