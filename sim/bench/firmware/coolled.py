"""Firmware of LED controllers of CoolLED (pE-300 series, pE-4000), line by line (docs/interfaces.md)."""

import re
import time
from collections.abc import Callable, Iterable, Mapping, Sequence

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.catalogue import Mount, Simulated
from anisoscope.sim.bench.firmware.device import Firmware, SimulatedDevice
from anisoscope.sim.bench.firmware.faults import Fault, FaultKind
from anisoscope.sim.bench.firmware.light import Dimmable, Led, LightFirmware

LAMPS = {"pE-300": "ABC", "pE-4000": "ABCD"}
GREETING = b"CoolLED precisExcite, Hello, pleased to meet you.\r\n\r\n"
VERSIONS = ("XFW_VER=1.2.7", "XHW_VER=3", "XDATA_VER=1", "XPOD_VER=1.1.4")
_CHANNEL = re.compile(r"([A-H])([SX])([NF])([0-9]{3})")
_ENDS = re.compile(rb"[\r\n]")


class CoolLedFirmware(SimulatedDevice):
    """One controller with its lamps.

    It is dark at power-up, with all lamps selected; one that is not selected stays dark. Lines may end with CR, as the
    maker's client ends them, or with LF.

    Args:
        lamps: the lamps that it drives, by letter.
        model: what it calls itself.
        faults: what is wrong with it; a motion is here a switching-on. ``stall:45`` gives no more than 45 % and says
            so, ``lost-homing`` is a power cycle after switching on, ``lost-reply`` switches without saying so,
            ``motion-error`` leaves the lamps as they are.
        clock: monotonic time in seconds.

    Raises:
        UsageError: there is no fault of this name, or a light cannot have it.
    """

    IMPOSSIBLE = LightFirmware.IMPOSSIBLE

    def __init__(
        self,
        lamps: Mapping[str, Dimmable] | None = None,
        model: str = "pE-300",
        *,
        faults: Iterable[Fault | str] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(faults, clock)
        self.lamps: dict[str, Dimmable] = dict(lamps or {letter: Led() for letter in LAMPS[model]})
        self._model, self._lit = model, 0
        self._power_up()

    def _power_up(self) -> None:
        self._state = dict.fromkeys(self.lamps, (False, False, 0))  # selected, on, percent
        self._shine()

    def connect(self) -> None:
        """A host opened the line: the controller greets it; its lamps stay as they are."""
        with self._lock:
            super().connect()
            self._outbox += GREETING

    def _attend(self) -> None:
        """Nothing happens by itself."""

    def _unsolicited(self) -> bytes:
        return f"CSS{self._css()}\r\n".encode("ascii")  # what the pod switches is reported

    def _take_packet(self) -> bool:
        end = _ENDS.search(self._inbox)
        if end is None:
            return False
        line = bytes(self._inbox[: end.start()])
        del self._inbox[: end.end()]
        if line:
            self._take(line)
            self._obey(line.decode("ascii", errors="replace"))
        return True

    def _obey(self, line: str) -> None:
        wanted = _CHANNEL.findall(line[3:])
        if line == "XMODEL":
            self._answer(f"XMODEL={self._model}")
        elif line == "XVER":
            for text in VERSIONS:
                self._answer(text)
        elif line == "CSS?":
            self._answer(f"CSS{self._css()}")
        elif line in {"CSN", "CSF"}:
            self._set({one: (kept[0], line == "CSN", kept[2]) for one, kept in self._state.items()})
        elif line.startswith("CSS") and wanted and "".join(map("".join, wanted)) == line[3:]:
            self._set({one: (s == "S", n == "N", min(int(level), 100)) for one, s, n, level in wanted})

    def _set(self, wanted: Mapping[str, tuple[bool, bool, int]]) -> None:
        faults, known = self.faults, {one: state for one, state in wanted.items() if one in self.lamps}
        lights = any(selected and on for selected, on, _ in known.values())
        self._lit += lights
        self.stops += not lights
        if lights and FaultKind.HANGUP in faults and self._lit > faults[FaultKind.HANGUP]:
            self._dead = True
            return
        if not (lights and FaultKind.MOTION_ERROR in faults):
            most = int(faults.get(FaultKind.STALL, 100.0))
            self._state |= {one: (s, on, min(level, most)) for one, (s, on, level) in known.items()}
        self._shine()
        if not (lights and FaultKind.LOST_REPLY in faults):
            self._answer(f"CSS{self._css()}")
        if lights and FaultKind.LOST_HOMING in faults:
            self._power_up()

    def _shine(self) -> None:
        for letter, (selected, on, percent) in self._state.items():
            self.lamps[letter].level = percent / 100.0 if selected and on else 0.0

    def _css(self) -> str:
        return "".join(
            f"{letter}{'S' if selected else 'X'}{'N' if on else 'F'}{percent:03d}"
            for letter, (selected, on, percent) in self._state.items()
        )

    def _answer(self, text: str) -> None:
        self._send(f"{text}\r\n".encode("ascii"))


def build(mounts: Sequence[Mount], model: str, faults: Sequence[str]) -> Firmware:
    """One controller; the axes stay where they are."""
    if any(mount.address for mount in mounts):
        raise UsageError("a light controller has a port of its own, and no address")
    return CoolLedFirmware(model=model, faults=faults)


SIMULATED = Simulated("LED controller of CoolLED with several lamps", tuple(LAMPS), build)
