"""The lines that a simulated Grbl board takes: G-code, and commands that begin with a dollar sign."""

from abc import abstractmethod
from collections.abc import Callable, Sequence

from anisoscope.sim.bench.firmware.faults import FaultKind
from anisoscope.sim.bench.firmware.grbl_board import GrblBoard
from anisoscope.sim.bench.firmware.grbl_gcode import read_block
from anisoscope.sim.bench.firmware.grbl_report import HELP
from anisoscope.sim.bench.firmware.grbl_settings import INVALID_STATEMENT, Memory
from anisoscope.sim.bench.firmware.grbl_words import GcodeError

BAD_NUMBER, NOT_IDLE, LOCKED = 2, 8, 9


class GrblCommands(GrblBoard):
    """The commands of a board; what moves is added by `_home`, `_jog` and `_gcode`, which return the error number."""

    @abstractmethod
    def _home(self, axis: str) -> int:
        """Search the switch of an axis, or of all ("")."""

    @abstractmethod
    def _jog(self, line: str) -> int:
        """Move as a whole ``$J=`` line says."""

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
            self._tell(line)
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
            self._tell("[MSG:Caution: Unlocked]")
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
