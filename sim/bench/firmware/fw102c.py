"""Firmware of the filter wheels FW102C and FW212C of Thorlabs, command by command (docs/interfaces.md)."""

import time
from collections.abc import Callable, Iterable, Sequence
from typing import ClassVar

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.catalogue import Mount, Simulated
from anisoscope.sim.bench.firmware.device import Firmware, SimulatedDevice
from anisoscope.sim.bench.firmware.faults import Fault, FaultKind

PLACES = {"FW102C": 6, "FW212C": 12}
STEP_S = 0.3
"""From one place to the next, about: the maker states no more than the time of a turn."""


class WheelFirmware(SimulatedDevice):
    """One wheel. It echoes its input, and prompts on arrival.

    Args:
        model: FW102C with six places, or FW212C with twelve.
        faults: what is wrong with it. ``stall`` keeps it where it is, ``lost-reply`` turns without a prompt,
            ``motion-error`` refuses to turn, ``lost-homing`` is a power cycle after a turn: it seeks place 1,
            ``overshoot`` comes to stand places further on, ``slow`` turns slower.
        clock: monotonic time in seconds.

    Attributes:
        place: the one in the beam, from 1; between two of them the one before.

    Raises:
        UsageError: there is no fault of this name, or a wheel cannot have it.
    """

    IMPOSSIBLE: ClassVar[frozenset[FaultKind]] = frozenset(
        {
            FaultKind.BUSY,
            FaultKind.LATCHED_ERROR,
            FaultKind.WRONG_ADDRESS,
            FaultKind.UNSOLICITED,
            FaultKind.JOINED,
        }
    )

    def __init__(
        self,
        model: str = "FW102C",
        *,
        faults: Iterable[Fault | str] = (),
        clock: Callable[[], float] = time.monotonic,
        time_scale: float = 1.0,
    ) -> None:
        super().__init__(faults, clock)
        self.model, self.place = model, 1
        self._step_s, self._turns = STEP_S * time_scale, 0
        self._settings = {"speed": 1, "sensors": 0, "trig": 0}
        self._target, self._arrives = 1, 0.0
        self._ends: bytes | None = None  # what is sent at the end of the turn

    def connect(self) -> None:
        """A host opened the line; the wheel stays where it is."""
        with self._lock:
            super().connect()
            self._ends = None

    def _attend(self) -> None:
        if self._target != self.place and self._clock() >= self._arrives:
            self.place = self._target
        if self._ends is not None and self._clock() >= self._arrives:
            ends, self._ends = self._ends, None
            self._send(ends)

    def _unsolicited(self) -> bytes:
        return b""

    def _take_packet(self) -> bool:
        if self._ends is not None or (end := self._inbox.find(b"\r")) < 0:
            return False
        line = bytes(self._inbox[:end]).strip(b"\n")
        del self._inbox[: end + 1]
        self._take(line)
        self._obey(line.decode("ascii", errors="replace"))
        return True

    def _obey(self, line: str) -> None:
        word, _, number = line.partition("=")
        value = int(number) if number.isdecimal() else -1
        if line == "*idn?":
            self._answer(line, "THORLABS FW102C/FW212C Filter Wheel version 1.07")
        elif line == "pos?":
            self._answer(line, str(self.place))
        elif line == "pcount?":
            self._answer(line, str(PLACES[self.model]))
        elif line[:-1] in self._settings and line.endswith("?"):
            self._answer(line, str(self._settings[line[:-1]]))
        elif word in self._settings and value in {0, 1}:
            self._settings[word] = value
            self._answer(line)
        elif word == "pos" and 1 <= value <= PLACES[self.model]:
            self._turn(line, value)
        else:
            known = word in {"pos", *self._settings} and number
            self._send(
                f"{line}\rCommand error {'CMD_ARG_INVALID' if known else 'CMD_NOT_DEFINED'}\n\r> ".encode()
            )

    def _turn(self, line: str, place: int) -> None:
        faults = self.faults
        self._turns += 1
        if FaultKind.HANGUP in faults and self._turns > faults[FaultKind.HANGUP]:
            self._dead = True
            return
        if FaultKind.MOTION_ERROR in faults:
            self._send(f"{line}\rCommand error CMD_ARG_INVALID\n\r> ".encode())
            return
        places = PLACES[self.model]
        steps = min((place - self.place) % places, (self.place - place) % places)
        self._arrives = self._clock() + steps * self._step_s * faults.get(FaultKind.SLOW, 1.0)
        self._target = self.place if FaultKind.STALL in faults else place
        if FaultKind.OVERSHOOT in faults:
            self._target = (place - 1 + int(faults[FaultKind.OVERSHOOT])) % places + 1
        if FaultKind.LOST_HOMING in faults:
            self._target = 1
        self._ends = b"" if FaultKind.LOST_REPLY in faults else f"{line}\r> ".encode("ascii")

    def _answer(self, line: str, text: str | None = None) -> None:
        self._send((f"{line}\r> " if text is None else f"{line}\r{text}\r> ").encode("ascii"))


def build(mounts: Sequence[Mount], model: str, faults: Sequence[str]) -> Firmware:
    """One wheel; the axes stay where they are."""
    if any(mount.address for mount in mounts):
        raise UsageError("a filter wheel has a port of its own, and no address")
    return WheelFirmware(model, faults=faults)


SIMULATED = Simulated("filter wheel of Thorlabs", tuple(PLACES), build)
