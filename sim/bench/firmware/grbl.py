"""Firmware of a Grbl 1.1 board that turns (X), tilts (Y) and moves along a line (Z), byte by byte.

An ``ok`` acknowledges a line, not the end of its move. While the board searches its switches it answers nothing. After
a hard or soft limit it answers nothing until it is reset. The motors have no feedback: an obstacle counts as a limit
switch where hard limits are on ($21), and is not detected where they are off. Every motion stops at once, without its
ramp. Source: interface description of Grbl 1.1.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.axis import LinearAxis, RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, Simulated
from anisoscope.sim.bench.firmware.device import Firmware, SimulatedDevice
from anisoscope.sim.bench.firmware.faults import Fault, FaultKind
from anisoscope.sim.bench.firmware.grbl_gcode import MM_PER_INCH, Modes, read_block, read_jog, work_offset
from anisoscope.sim.bench.firmware.grbl_motion import Move, Place, Planner
from anisoscope.sim.bench.firmware.grbl_settings import (
    ACCELERATION,
    AXES,
    HARD_LIMITS,
    HOMING,
    HOMING_DIRECTION,
    HOMING_DISABLED,
    HOMING_SEEK,
    INCHES,
    INVALID_STATEMENT,
    MODELS,
    PULL_OFF,
    RATE,
    REPORT,
    SOFT_LIMITS,
    STEPS,
    TRAVEL,
    UNO,
    GrblModel,
    Memory,
)
from anisoscope.sim.bench.firmware.grbl_words import GcodeError

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


STATUS, CYCLE_START, FEED_HOLD, RESET, DOOR, JOG_CANCEL = b"?", b"~", b"!", b"\x18", b"\x84", b"\x85"
_REAL_TIME = frozenset(byte[0] for byte in (STATUS, CYCLE_START, FEED_HOLD, RESET))
RX_BUFFER = 127
LINE_LENGTH = 79
OVERFLOW = 11


class GrblLine(SimulatedDevice):
    """Line of a board; `_real_time` and `_obey` add its behaviour."""

    _rx: bytearray

    @abstractmethod
    def _real_time(self, byte: bytes) -> None:
        """Act on a real-time byte, at once."""

    @abstractmethod
    def _obey(self, line: str) -> None:
        """Carry out a line without blanks and comments, in capitals, and answer it."""

    @abstractmethod
    def _waiting(self) -> bool:
        """Whether lines have to wait: for the end of a search, a pause, or room in the queue of moves."""

    @property
    def rx_free(self) -> int:
        """Bytes that the receive buffer still takes."""
        return RX_BUFFER - len(self._rx)

    def _take_packet(self) -> bool:
        """Pass one byte on: real-time bytes overtake the lines that wait in the receive buffer."""
        if not self._inbox or self._dead:
            self._inbox.clear()
            return False
        byte = bytes(self._inbox[:1])
        del self._inbox[:1]
        if byte[0] in _REAL_TIME or byte[0] >= 0x80:
            self._attend()
            self._take(byte)
            self._real_time(byte)
        elif self.rx_free > 0:
            self._rx += byte
            if byte in b"\r\n":
                self._take_lines()
        return True

    def _take_lines(self) -> None:
        while not (self._dead or self._waiting()):
            ends = [place for place in (self._rx.find(b"\n"), self._rx.find(b"\r")) if place >= 0]
            if not ends:
                return
            raw = bytes(self._rx[: min(ends)])
            del self._rx[: min(ends) + 1]
            line = clean(raw.decode("latin-1"))
            if line:
                self._take(line.encode("latin-1"))
            if len(line) > LINE_LENGTH:
                self._answer(OVERFLOW)
            else:
                self._obey(line)

    def _answer(self, error: int) -> None:
        """Report the result of a line: 0 is ok."""
        self._send(b"error:%d\r\n" % error if error else b"ok\r\n")


def clean(line: str) -> str:
    """Drop blanks, control characters, slashes and comments, as Grbl does; letters become capitals."""
    characters = []
    in_brackets = False
    for character in line:
        if in_brackets or character == "(":
            in_brackets = character != ")"
        elif character == ";":
            break
        elif character > " " and character != "/":
            characters.append(character.upper())
    return "".join(characters)


HARD_LIMIT, SOFT_LIMIT, RESET_IN_MOTION, RESET_IN_HOMING, NO_SWITCH = 1, 2, 3, 6, 9
CRITICAL = frozenset({HARD_LIMIT, SOFT_LIMIT})
UNLOCK_HINT = "[MSG:'$H'|'$X' to unlock]"


class GrblBoard(GrblLine):
    """A board with a rotation axis and, perhaps, a tilt axis and a linear one.

    Args:
        axis: what X turns; by default one that stands at 0° and moves in real time.
        tilt: what Y tilts; by default nothing that anybody sees.
        focus: what Z moves, in mm; by default nothing, and then Z is not homed.
        model: settings, scale and options.
        faults: what is wrong with it; as text, ``name`` or ``name:number``. Those of the mechanics are those of X.

    Raises:
        UsageError: there is no fault of this name, or a board cannot have it.
    """

    IMPOSSIBLE = frozenset({FaultKind.WRONG_ADDRESS})

    def __init__(
        self,
        axis: RotaryAxis | None = None,
        tilt: RotaryAxis | None = None,
        focus: RotaryAxis | None = None,
        *,
        model: GrblModel = UNO,
        faults: Iterable[Fault | str] = (),
    ) -> None:
        paced = axis or tilt or focus or RotaryAxis()
        self.axis = axis or RotaryAxis(time_scale=paced.time_scale, clock=paced.clock)
        super().__init__(faults, self.axis.clock)
        self.model = model
        self.memory = Memory(dict(model.settings))
        others = [RotaryAxis(time_scale=self.axis.time_scale, clock=self._clock) for _ in "YZ"]
        self.tilt_axis = tilt or others[0]
        self.homed_axes = (0, 1) if focus is None else (0, 1, 2)
        axes = (self.axis, self.tilt_axis, focus or others[1])
        scales = [model.settings[STEPS + number] for number in range(3)]
        self._planner = Planner(axes, self.memory, scales, self.faults.get(FaultKind.SLOW, 1.0))
        self._planner.overshoot = self.faults.get(FaultKind.OVERSHOOT, 0.0)
        self.axis.stall_at_deg = self.faults.get(FaultKind.STALL, self.axis.stall_at_deg)
        self._reporter = Reporter(model, self.memory, self._planner)
        self._busy_answers = int(self.faults.get(FaultKind.BUSY, 0))
        self._motions = 0
        self._power_up()
        self._outbox.clear()

    @property
    def state(self) -> str:
        """State as a status report gives it."""
        with self._lock:
            self._attend()
            return self._state

    @property
    def counts(self) -> int:
        """Position of X in steps, as the board believes it to be."""
        return self._planner.steppers[0].steps

    def connect(self) -> None:
        """A host opened the line: the DTR line resets the board, where it has one."""
        with self._lock:
            super().connect()
            self._rx.clear()
            if self.model.resets_on_connect:
                self._power_up()

    # What the commands add.

    @abstractmethod
    def _gcode(self, line: str) -> int:
        """Carry out a block of G-code; return the error number."""

    @abstractmethod
    def _end_homing(self) -> None:
        """The search for the switches is over."""

    @abstractmethod
    def _end_pause(self) -> None:
        """End the pause requested by a line."""

    # Starting and ending.

    def _power_up(self) -> None:
        self._planner.cancel()
        for stepper in self._planner.steppers:
            stepper.count_from(0)
        self._state = "Alarm" if self.memory.whole(HOMING) else "Idle"
        self._doomed = False
        self._restart()
        if FaultKind.LATCHED_ERROR in self.faults:
            self._alarm(int(self.faults[FaultKind.LATCHED_ERROR]))

    def _restart(self) -> None:
        """Common part of power-up and reset."""
        self._rx = bytearray()
        self._modes = Modes()
        self._planned = self._planner.position
        self._critical = self._status_requested = False
        self._homing: list[int] = []
        self._quiet_until: float | None = None
        self._flow = ""
        self._restarting = False
        self._reporter.offset_in, self._reporter.overrides_in = 0, 1
        self._send(self._reporter.banner())
        if self._state in {"Alarm", "Sleep"}:
            self._state = "Alarm"
            self._send_line(UNLOCK_HINT)
            return
        self._state = "Idle"
        for line in filter(None, self.memory.startup):
            error = self._gcode(line)
            self._send_line(f">{line}:{f'error:{error}' if error else 'ok'}")

    def _reset(self) -> None:
        self.stops += 1
        was = self._state
        self._planner.cancel()
        self.faults.pop(FaultKind.LATCHED_ERROR, None)
        if was in {"Run", "Jog", "Home"}:
            self._alarm(RESET_IN_HOMING if was == "Home" else RESET_IN_MOTION)
        self._restart()

    def _alarm(self, code: int) -> None:
        self._planner.cancel()
        self._state = "Alarm"
        self._homing = []
        self._send_line(f"ALARM:{code}")
        if code in CRITICAL:
            self._critical = True
            self._send_line("[MSG:Reset to continue]")

    def _repair(self) -> None:
        self.axis.stall_at_deg = None
        self._planner.overshoot, self._planner.slowness = 0.0, 1.0
        self._busy_answers = 0
        self._doomed = False

    # What happens by itself.

    def _attend(self) -> None:
        if self._dead or self._critical or not (self._waits_for_end or self._state in {"Run", "Jog"}):
            return
        while self._planner.go_on():
            pass
        if not self._homing and self.memory.whole(HARD_LIMITS) and self._planner.blocked:
            self._alarm(HARD_LIMIT)
            return
        if self._homing and not any(self._planner.steppers[axis].busy for axis in self._homing):
            self._end_homing()
        if self._state in {"Run", "Jog"} and self._planner.idle:
            self._state = "Idle"
            self._doomed = FaultKind.LOST_HOMING in self.faults
        if self._quiet_until is not None and self._planner.idle and self._clock() >= self._quiet_until:
            self._quiet_until = None
            self._end_pause()
        self._take_lines()

    @property
    def _waits_for_end(self) -> bool:
        return self._critical or bool(self._homing) or self._quiet_until is not None

    def _waiting(self) -> bool:
        return self._waits_for_end or self._planner.free <= 0

    def _unsolicited(self) -> bytes:
        return b"[MSG:Pgm End]\r\n\r\n"

    def _send_line(self, text: str) -> None:
        self._send(text.encode("ascii") + b"\r\n")

    # Real-time bytes.

    def _real_time(self, byte: bytes) -> None:
        if byte == RESET:
            self._reset()
        elif self._critical:
            return
        elif byte == STATUS:
            self._status_requested = True
            if not self._homing:
                self._report()
        elif byte == CYCLE_START:
            if self._state in {"Hold:0", "Door:0"}:
                self._state = "Idle" if self._planner.idle else "Run"
                self._planner.resume()
        elif byte in {FEED_HOLD, DOOR, JOG_CANCEL}:
            self.stops += 1
            self._hold(byte)

    def _hold(self, byte: bytes) -> None:
        if self._state == "Jog":
            self._planner.cancel()
            self._planned = self._planner.position
            self._state = "Idle"
        elif byte != JOG_CANCEL and self._state in {"Idle", "Run", "Hold:0"}:
            self._planner.hold()
            self._state = "Hold:0"
        if byte == DOOR and self._state in {"Idle", "Hold:0"}:
            self._planner.hold()
            self._state = "Door:0"
            self._send_line("[MSG:Check Door]")

    def _report(self) -> None:
        self._status_requested = False
        self._send_line(self._reporter.status(self._state, self._modes, self.rx_free))
        if self._doomed:
            self._power_up()


BAD_NUMBER, NOT_IDLE, LOCKED = 2, 8, 9


class GrblCommands(GrblBoard):
    """The commands of a board; what moves is added by `_home`, `_jog` and `_gcode`, which return the error number."""

    @abstractmethod
    def _home(self, axis: str) -> int:
        """Search the switch of an axis, or of all ("")."""

    @abstractmethod
    def _jog(self, line: str) -> int:
        """Execute a complete ``$J=`` line."""

    def _obey(self, line: str) -> None:
        motions = self._motions
        try:
            error = self._system(line) if line.startswith("$") else self._program(line)
        except GcodeError as refusal:
            error = refusal.code
        if self._dead or self._waits_for_end:
            return  # answered later, or never
        if error or motions == self._motions or FaultKind.LOST_REPLY not in self.faults:
            self._answer(error)
        if self._restarting:
            self._restarting = False
            self._restart()

    def _program(self, line: str) -> int:
        if line and self._state in {"Alarm", "Jog", "Sleep"}:
            return LOCKED
        return self._gcode(line) if line else 0

    def _system(self, line: str) -> int:
        if line == "$$" and self._state in {"Run", "Hold:0"}:
            return NOT_IDLE
        simple = self._simple_commands().get(line)
        if simple is not None:
            return simple()
        if line.startswith("$J"):
            return self._jog(line)
        return self._command_at_rest(line) if self._state in {"Idle", "Alarm"} else NOT_IDLE

    def _command_at_rest(self, line: str) -> int:
        if line.startswith("$H"):
            return self._home(line[2:])
        if line == "$SLP":
            self._state = "Sleep"
            return 0
        if line.startswith("$RST="):
            return self._restore(line[5:])
        return self._write(line[1:])

    def _simple_commands(self) -> dict[str, Callable[[], int]]:
        return {
            "$": lambda: self._list([HELP]),
            "$$": lambda: self._list(self.memory.lines()),
            "$G": lambda: self._list([self._modes.text()]),
            "$C": self._check_mode,
            "$X": self._unlock,
            "$#": lambda: self._list_at_rest(self._reporter.origins(self._modes)),
            "$I": lambda: self._list_at_rest(self._reporter.build()),
            "$N": lambda: self._list_at_rest([f"$N{n}={text}" for n, text in enumerate(self.memory.startup)]),
        }

    def _list(self, lines: Sequence[str]) -> int:
        for line in lines:
            self._send_line(line)
        return 0

    def _list_at_rest(self, lines: Sequence[str]) -> int:
        return self._list(lines) if self._state in {"Idle", "Alarm"} else NOT_IDLE

    def _check_mode(self) -> int:
        if self._state == "Check":
            self._restarting = True
            return self._list(["[MSG:Disabled]"])
        if self._state != "Idle":
            return NOT_IDLE
        self._state = "Check"
        return self._list(["[MSG:Enabled]"])

    def _unlock(self) -> int:
        if self._state == "Alarm":
            self.faults.pop(FaultKind.LATCHED_ERROR, None)
            self._state = "Idle"
            self._send_line("[MSG:Caution: Unlocked]")
        return 0

    def _restore(self, what: str) -> int:
        if what not in {"$", "#", "*"}:
            return INVALID_STATEMENT
        fresh = Memory(dict(self.model.settings))
        if what != "#":
            self.memory.settings.update(fresh.settings)
        if what != "$":
            self.memory.offsets.update(fresh.offsets)
        if what == "*":
            self.memory.startup, self.memory.note = fresh.startup, fresh.note
        self._restarting = True
        return self._list(["[MSG:Restoring defaults]"])

    def _write(self, line: str) -> int:
        """Store a setting, a start-up line or the user's text."""
        name, equals, value = line.partition("=")
        if name == "I" and equals:
            self.memory.note = value
            return 0
        if name in {"N0", "N1"} and equals:
            if self._state != "Idle":
                return NOT_IDLE
            read_block(value, self._modes, self._planned, self.memory)
            self.memory.startup[int(name[1])] = value
            return 0
        if not name.isdigit():
            return INVALID_STATEMENT if name[:1].isalpha() else BAD_NUMBER
        try:
            number = float(value)
        except ValueError:
            return BAD_NUMBER if equals else INVALID_STATEMENT
        return self.memory.store(int(name), number)


TRAVEL_EXCEEDED = 15


class GrblFirmware(GrblCommands):
    """A whole board; arguments and errors are those of `GrblBoard`."""

    def _refusal(self) -> int:
        """Count a requested motion; returns the error of its refusal, if any."""
        self._motions += 1
        if FaultKind.HANGUP in self.faults and self._motions > self.faults[FaultKind.HANGUP]:
            self._dead = True
        if self._busy_answers > 0:
            self._busy_answers -= 1
            return NOT_IDLE
        return int(self.faults.get(FaultKind.MOTION_ERROR, 0))

    def _home(self, axis: str) -> int:
        if not self.memory.whole(HOMING):
            return HOMING_DISABLED
        if axis and ("H" not in self.model.options or axis not in AXES):
            self._state = "Home"  # as the real one does: only a reset helps then
            return INVALID_STATEMENT
        if error := self._refusal():
            return error
        self.faults.pop(FaultKind.LATCHED_ERROR, None)
        self._state = "Home"
        self._homing = [AXES.index(axis)] if axis else list(self.homed_axes)
        settings = self.memory.settings
        for number in self._homing:
            speed = min(settings[HOMING_SEEK], settings[RATE + number]) / 60.0 / self._planner.slowness
            self._planner.steppers[number].search(speed, settings[ACCELERATION + number])
        return 0

    def _end_homing(self) -> None:
        if self._planner.blocked:
            self._alarm(NO_SWITCH)
            self._restart()
            return
        settings = self.memory.settings
        for axis in self._homing:
            angle = -settings[PULL_OFF]
            if self.memory.whole(HOMING_DIRECTION) & 1 << axis:
                angle = settings[PULL_OFF] - settings[TRAVEL + axis]
            self._planner.steppers[axis].count_from(round(angle * settings[STEPS + axis]))
        if self._status_requested:
            self._report()
        self._homing = []
        self._state = "Idle"
        self._planned = self._planner.position
        if FaultKind.LOST_REPLY not in self.faults:
            self._answer(0)

    def _jog(self, line: str) -> int:
        if self._state not in {"Idle", "Jog"}:
            return NOT_IDLE
        if not line.startswith("$J="):
            return INVALID_STATEMENT
        move = read_jog(line[3:], self._modes, self._planned, self.memory)
        if self._beyond(move.target):
            return TRAVEL_EXCEEDED
        if (error := self._refusal()) or self._dead:
            return error
        self._state = "Jog"
        self._queue(move)
        return 0

    def _gcode(self, line: str) -> int:
        block = read_block(line, self._modes, self._planned, self.memory)
        if block.moves and self._state != "Check" and ((error := self._refusal()) or self._dead):
            return error
        for move in block.moves:
            if self._beyond(move.target):
                self._alarm(SOFT_LIMIT)
                return 0
        if work_offset(block.modes, self.memory) != work_offset(self._modes, self.memory):
            self._reporter.offset_in = 0
        self._modes = block.modes
        if self._state == "Check":
            return 0
        for move in block.moves:
            if self._state == "Idle":
                self._state = "Run"
            self._queue(move)
        if block.dwell_s or block.flow:
            self._quiet_until = self._clock() + block.dwell_s * self.axis.time_scale
            self._flow = block.flow
        return 0

    def _queue(self, move: Move) -> None:
        self._planned = move.target
        self._planner.put(move)

    def _beyond(self, target: Place) -> bool:
        settings = self.memory.settings
        if not self.memory.whole(SOFT_LIMITS):
            return False
        slack = 1e-6
        return any(
            not -settings[TRAVEL + axis] - slack <= angle <= slack for axis, angle in enumerate(target)
        )

    def _end_pause(self) -> None:
        """A dwell is over, or all moves before a change of the program's flow."""
        flow, self._flow = self._flow, ""
        if flow == "M0":
            self._planner.hold()
            self._state = "Hold:0"
        elif flow in {"M2", "M30"}:
            modes = self._modes
            self._modes = Modes(feed=modes.feed, speed=modes.speed, tool=modes.tool, shift=modes.shift)
            self._send_line("[MSG:Pgm End]")
        self._answer(0)


def build(mounts: Sequence[Mount], model: str, faults: Sequence[str]) -> Firmware:
    """One board; X turns the first axis, Y the second, Z moves a linear one."""
    axes: dict[str, RotaryAxis] = {}
    for mount in mounts:
        linear = isinstance(mount.axis, LinearAxis)
        letter = "Z" if linear else "Y" if "X" in axes else "X"
        if letter in axes:
            raise UsageError("a simulated Grbl board has one or two axes that turn, and one linear axis")
        if mount.address not in {"", letter}:
            raise UsageError(
                f"'{mount.address}' is not the letter of this Grbl axis; use {letter}, or nothing"
            )
        axes[letter] = mount.axis
    return GrblFirmware(axes.get("X"), axes.get("Y"), axes.get("Z"), model=MODELS[model], faults=faults)


SIMULATED = Simulated("Grbl 1.1 board with axes that turn, tilt and lift", tuple(MODELS), build)
