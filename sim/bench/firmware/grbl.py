"""Firmware of a Grbl 1.1 board that turns (X) and tilts (Y), byte by byte; the axis Z is there and moves nothing.

An ``ok`` says that a line was taken, not that its move is over. While the board searches its switches it answers
nothing. After a hard or soft limit it answers nothing until it is reset. The motors have no feedback: an obstacle
counts as a limit switch where hard limits are on ($21), and goes unnoticed where they are off. Every motion stops
at once, without its ramp. Source: interface description of Grbl 1.1.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.catalogue import Mount, Simulated
from anisoscope.sim.bench.firmware.device import Firmware
from anisoscope.sim.bench.firmware.faults import FaultKind
from anisoscope.sim.bench.firmware.grbl_board import NO_SWITCH, SOFT_LIMIT, GrblBoard
from anisoscope.sim.bench.firmware.grbl_gcode import Modes, read_block, read_jog, work_offset
from anisoscope.sim.bench.firmware.grbl_motion import Move, Place
from anisoscope.sim.bench.firmware.grbl_report import HELP
from anisoscope.sim.bench.firmware.grbl_settings import (
    ACCELERATION,
    AXES,
    HOMING,
    HOMING_DIRECTION,
    HOMING_DISABLED,
    HOMING_SEEK,
    INVALID_STATEMENT,
    MODELS,
    PULL_OFF,
    SOFT_LIMITS,
    STEPS,
    TRAVEL,
    Memory,
)
from anisoscope.sim.bench.firmware.grbl_words import GcodeError

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
MOVED_BY_HOMING = (0, 1)


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
        self._homing = [AXES.index(axis)] if axis else list(MOVED_BY_HOMING)
        speed = self.memory.settings[HOMING_SEEK] / 60.0 / self._planner.slowness
        for number in self._homing:
            self._planner.steppers[number].search(speed, self.memory.settings[ACCELERATION + number])
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
    """One board; X turns the first axis, Y the second."""
    if not 1 <= len(mounts) <= len(MOVED_BY_HOMING):
        raise UsageError(f"a simulated Grbl board turns one axis or two, not {len(mounts)}")
    for letter, mount in zip(AXES, mounts, strict=False):
        if mount.address not in {"", letter}:
            raise UsageError(
                f"'{mount.address}' is not the letter of this Grbl axis; use {letter}, or nothing"
            )
    return GrblFirmware(*(mount.axis for mount in mounts), model=MODELS[model], faults=faults)


SIMULATED = Simulated("Grbl 1.1 board with a rotation and a tilt axis", tuple(MODELS), build)
