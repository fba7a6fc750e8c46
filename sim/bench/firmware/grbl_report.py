"""Reports of a simulated Grbl board: status, parser state, origins, build."""

from collections.abc import Sequence
from dataclasses import dataclass

from anisoscope.sim.bench.firmware.grbl_gcode import MM_PER_INCH, Modes, work_offset
from anisoscope.sim.bench.firmware.grbl_motion import Planner
from anisoscope.sim.bench.firmware.grbl_settings import AXES, HARD_LIMITS, INCHES, REPORT, GrblModel, Memory

HELP = "[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]"
# Every so many reports the offset of the work coordinates and the overrides come along.
OFFSET_EVERY = {"moving": 30, "still": 10}
OVERRIDES_EVERY = {"moving": 20, "still": 10}


@dataclass
class Reporter:
    """Writes the reports of a board.

    Attributes:
        offset_in, overrides_in: number of status reports until these come along again; 0 is now.
    """

    model: GrblModel
    memory: Memory
    planner: Planner
    offset_in: int = 0
    overrides_in: int = 1

    def status(self, state: str, modes: Modes, rx_free: int) -> str:
        """The answer to ``?``."""
        mask = self.memory.whole(REPORT)
        offset, position = work_offset(modes, self.memory), self.planner.position
        what = "MPos" if mask & 1 else "WPos"
        shown = position if mask & 1 else [a - b for a, b in zip(position, offset, strict=True)]
        fields = [state, f"{what}:{self.numbers(shown)}"]
        if mask & 2:
            fields.append(f"Bf:{self.planner.free},{rx_free}")
        speed = 0.0 if modes.spindle == "M5" else modes.speed
        fields.append(f"FS:{self.planner.rate:.0f},{speed:.0f}")
        pairs = zip(AXES, self.planner.steppers, strict=True)
        pins = "".join(letter for letter, stepper in pairs if stepper.axis.stalled())
        if pins and self.memory.whole(HARD_LIMITS):
            fields.append(f"Pn:{pins}")
        fields += self._now_and_then("still" if state in {"Idle", "Alarm", "Check"} else "moving", offset)
        return f"<{'|'.join(fields)}>"

    def numbers(self, values: Sequence[float]) -> str:
        """Coordinates as they are printed: three decimals, four in inches."""
        if self.memory.whole(INCHES):
            return ",".join(f"{value / MM_PER_INCH:.4f}" for value in values)
        return ",".join(f"{value:.3f}" for value in values)

    def origins(self, modes: Modes) -> list[str]:
        """The answer to ``$#``."""
        stored = [f"[G{number}:{self.numbers(place)}]" for number, place in self.memory.offsets.items()]
        return [
            *stored,
            f"[G92:{self.numbers(modes.shift)}]",
            f"[TLO:{self.numbers((0.0,))}]",
            f"[PRB:{self.numbers((0.0, 0.0, 0.0))}:0]",
        ]

    def build(self) -> list[str]:
        """The answer to ``$I``."""
        model = self.model
        return [f"[VER:{model.version}.{model.build}:{self.memory.note}]", f"[OPT:{model.options},15,128]"]

    def banner(self) -> bytes:
        """Start-up message."""
        return f"\r\nGrbl {self.model.version} ['$' for help]\r\n".encode("ascii")

    def _now_and_then(self, pace: str, offset: Sequence[float]) -> list[str]:
        self.offset_in -= 1
        self.overrides_in -= 1
        if self.offset_in < 0:
            self.offset_in = OFFSET_EVERY[pace] - 1
            self.overrides_in = max(self.overrides_in, 0)
            return [f"WCO:{self.numbers(offset)}"]
        if self.overrides_in < 0:
            self.overrides_in = OVERRIDES_EVERY[pace] - 1
            return ["Ov:100,100,100"]
        return []
