"""A simulated Grbl board without its commands: states, alarms, resets, real-time bytes, and what ends by itself."""

from abc import abstractmethod
from collections.abc import Iterable

from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.device import SimulatedDevice
from anisoscope.sim.bench.firmware.faults import Fault, FaultKind
from anisoscope.sim.bench.firmware.grbl_gcode import Modes
from anisoscope.sim.bench.firmware.grbl_motion import Planner
from anisoscope.sim.bench.firmware.grbl_report import Reporter
from anisoscope.sim.bench.firmware.grbl_settings import HARD_LIMITS, HOMING, STEPS, UNO, GrblModel, Memory

STATUS, CYCLE_START, FEED_HOLD, RESET, DOOR, JOG_CANCEL = b"?", b"~", b"!", b"\x18", b"\x84", b"\x85"
_REAL_TIME = frozenset(byte[0] for byte in (STATUS, CYCLE_START, FEED_HOLD, RESET))
RX_BUFFER = 127
LINE_LENGTH = 79
OVERFLOW = 11


class GrblLine(SimulatedDevice):
    """A board as far as its line goes; what it does with bytes and lines is added by `_real_time` and `_obey`."""

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
            self.commands.append(byte)
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
                self.commands.append(line.encode("latin-1"))
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
    """A board with a rotation axis and, perhaps, a tilt axis.

    Args:
        axis: what X turns; by default one that stands at 0° and moves in real time.
        tilt: what Y tilts; by default nothing that anybody sees.
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
        *,
        model: GrblModel = UNO,
        faults: Iterable[Fault | str] = (),
    ) -> None:
        self.axis = axis or RotaryAxis()
        super().__init__(faults, self.axis.clock)
        self.model = model
        self.memory = Memory(dict(model.settings))
        others = [RotaryAxis(time_scale=self.axis.time_scale, clock=self._clock) for _ in "YZ"]
        self.tilt_axis = tilt or others[0]
        axes = (self.axis, self.tilt_axis, others[1])
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
        """What power-up and a reset have in common."""
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
