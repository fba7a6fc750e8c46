"""Firmware of the light controller of ``rig/firmware/light``, line by line (docs/interfaces.md).

It is off at power-up and when a host opens the line, and switches itself off when the host has said nothing for the
time of its watchdog.
"""

import time
from collections.abc import Callable, Iterable, Sequence
from typing import ClassVar, Protocol

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.catalogue import Mount, Simulated
from anisoscope.sim.bench.firmware.device import Firmware, SimulatedDevice
from anisoscope.sim.bench.firmware.faults import Fault, FaultKind

IDENTITY = "ID ANISOLIGHT 1 L0001"
MAX_LINE = 31
WATCHDOG_S = 10
WATCHDOG_RANGE = range(1, 601)
UNKNOWN, OUT_OF_RANGE, TOO_LONG = 1, 2, 3
COMPLAINTS = {UNKNOWN: "unknown command", OUT_OF_RANGE: "number out of range", TOO_LONG: "line too long"}


class Dimmable(Protocol):
    """Lamp of the controller."""

    level: float
    attend: Callable[[], None]


class Led:
    """An LED without a lamp model."""

    def __init__(self) -> None:
        self.level = 0.0
        self.attend: Callable[[], None] = lambda: None


class LightFirmware(SimulatedDevice):
    """One controller with one lamp.

    Args:
        lamp: the lamp that it drives.
        faults: what is wrong with it; a motion is here a switching-on. ``stall:45`` gives no more than 45 %,
            ``lost-homing`` is a power cycle after switching on, ``lost-reply`` switches without saying so.
        clock: monotonic time in seconds.

    Raises:
        UsageError: there is no fault of this name, or a light cannot have it.
    """

    IMPOSSIBLE: ClassVar[frozenset[FaultKind]] = frozenset(
        {
            FaultKind.BUSY,
            FaultKind.LATCHED_ERROR,
            FaultKind.OVERSHOOT,
            FaultKind.SLOW,
            FaultKind.WRONG_ADDRESS,
        }
    )

    def __init__(
        self,
        lamp: Dimmable | None = None,
        *,
        faults: Iterable[Fault | str] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(faults, clock)
        self.lamp: Dimmable = lamp or Led()
        self._switched_on = 0
        self._power_up()
        # Whoever looks at the lamp finds it off once the watchdog has bitten.
        self.lamp.attend = self.attend

    def _power_up(self) -> None:
        self._on = False
        self._percent = 100
        self._watchdog_s = WATCHDOG_S
        self._heard = self._clock()
        self._overlong = False

    def connect(self) -> None:
        """A host opened the line: the board starts anew."""
        with self._lock:
            super().connect()
            self._power_up()
            self.lamp.level = 0.0
            self._send(b"! READY\r\n")

    def attend(self) -> None:
        """Switch off if the host has been silent for too long."""
        with self._lock:
            if self._on and self._clock() - self._heard > self._watchdog_s:
                self._switch(False)
                self._send(b"! WATCHDOG\r\n")

    # What the protocol adds.

    def _attend(self) -> None:
        self.attend()

    def _unsolicited(self) -> bytes:
        return b"! READY\r\n"

    def _take_packet(self) -> bool:
        end = self._inbox.find(b"\n")
        if end < 0:
            if len(self._inbox) > MAX_LINE:
                self._overlong = True
                self._inbox.clear()
            return False
        line = bytes(self._inbox[:end]).rstrip(b"\r")
        del self._inbox[: end + 1]
        self._heard = self._clock()
        self._take(line)
        if self._overlong or len(line) > MAX_LINE:
            self._overlong = False
            self._complain(TOO_LONG)
        elif line:
            self._obey(line.decode("ascii", errors="replace"))
        return True

    def _obey(self, line: str) -> None:
        word, space, argument = line.partition(" ")
        if line == "ID?":
            self._answer(IDENTITY)
        elif line == "STATUS?":
            state = "ON" if self._on else "OFF"
            sensed = round(100.0 * self.lamp.level)
            self._answer(f"STATUS {state} {self._percent} {sensed} {self._watchdog_s}")
        elif line == "OFF":
            self.stops += 1
            self._switch(False)
            self._answer("OK OFF")
        elif line == "ON":
            self._switch_on()
        elif word + space == "LEVEL ":
            self._set("_percent", argument, range(101), line)
        elif word + space == "WATCHDOG ":
            self._set("_watchdog_s", argument, WATCHDOG_RANGE, line)
        else:
            self._complain(UNKNOWN)

    def _set(self, name: str, argument: str, allowed: range, line: str) -> None:
        if not argument.isdecimal() or int(argument) not in allowed:
            self._complain(OUT_OF_RANGE)
            return
        setattr(self, name, int(argument))
        self._switch(self._on)
        self._answer(f"OK {line}")

    def _switch_on(self) -> None:
        faults = self.faults
        self._switched_on += 1
        if FaultKind.HANGUP in faults and self._switched_on > faults[FaultKind.HANGUP]:
            self._dead = True
        elif FaultKind.MOTION_ERROR in faults:
            self._complain(int(faults[FaultKind.MOTION_ERROR]))
        else:
            self._switch(True)
            if FaultKind.LOST_REPLY not in faults:
                self._answer(f"OK ON {self._percent}")
            if FaultKind.LOST_HOMING in faults:
                self._power_up()
                self._switch(False)

    def _switch(self, on: bool) -> None:
        self._on = on
        percent = min(float(self._percent), self.faults.get(FaultKind.STALL, 100.0))
        self.lamp.level = percent / 100.0 if on else 0.0

    def _complain(self, code: int) -> None:
        self._answer(f"ERR {code} {COMPLAINTS.get(code, 'simulated failure')}")

    def _answer(self, text: str) -> None:
        self._send(f"{text}\r\n".encode("ascii"))


def build(mounts: Sequence[Mount], model: str, faults: Sequence[str]) -> Firmware:
    """One light; the axes stay where they are."""
    del model
    if any(mount.address for mount in mounts):
        raise UsageError("a light controller has a port of its own, and no address")
    return LightFirmware(faults=faults)


SIMULATED = Simulated("light controller of rig/firmware/light", ("anisolight",), build)
