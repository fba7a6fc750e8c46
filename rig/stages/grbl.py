"""Driver for an axis of a Grbl 1.1 board (Arduino and others): 115200 baud, lines.

Scale, speed, acceleration and travel are read from the board, where 1 mm stands for 1° of an axis that turns. Moves are
jogs in machine coordinates: they leave the modes of the G-code parser alone, and a jog that is cancelled keeps its
position. An ``ok`` only says that a move was queued: an axis has arrived when the board is idle and counts the target.
The motors have no feedback: steps that are lost without a limit switch are visible to the camera only.
Source: interface description of Grbl 1.1.
"""

import math
from abc import abstractmethod
from typing import ClassVar

from anisoscope.base.errors import NotConnected, NotHomed, ProtocolError, RigError
from anisoscope.rig.stage import MotionRules, Unit
from anisoscope.rig.stages.grbl_board import GrblBoard, board_on
from anisoscope.rig.stages.grbl_wire import (
    ACCELERATION,
    AXES,
    DEBOUNCE,
    HOMING,
    HOMING_DIRECTION,
    HOMING_FEED,
    HOMING_SEEK,
    JOG_CANCEL,
    MOVING,
    NOT_IDLE,
    PULL_OFF,
    RATE,
    RESET,
    STATUS,
    STEPS,
    TRAVEL,
    Feedback,
    Ok,
    Refused,
    Status,
    error_of_alarm,
    error_of_refusal,
)
from anisoscope.rig.stages.portstage import PortStage
from anisoscope.rig.transport import Transport

REPORTED_DEG = 0.001
TOLERANCE: dict[Unit, float] = {"deg": 0.05, "mm": 0.005}
FIRST_POLL_S, BUSY_POLL_S = 0.002, 0.02


class GrblAxis(PortStage):
    """An axis that moves; how it finds its reference is added by a subclass.

    The board knows nothing of references, and all axes of a board lose them together: they stand in `GrblBoard.zeros`.

    Args:
        unit: ``deg`` for an axis that turns, ``mm`` for a linear one; all that follows counts in it.
        transport: the open port.
        board: the board behind it.
        axis: letter of the axis.
        tolerance_deg: an axis this near to the target has arrived.
        velocity_deg_s: speed of moves in deg/s, or None for what the board allows.
        margin_s: seconds added to every computed time limit.
        limits_deg: limits in degrees.

    Raises:
        ProtocolError: the settings of this axis cannot be true.
    """

    def __init__(
        self,
        unit: Unit,
        transport: Transport,
        board: GrblBoard,
        axis: str,
        tolerance_deg: float,
        velocity_deg_s: float | None,
        margin_s: float,
        limits_deg: tuple[float, float],
    ) -> None:
        self.unit = unit
        self.axis = axis
        self._transport = transport
        self._board = board
        self._number = AXES.index(axis)
        self._searching = False
        self._moving_deg: float | None = None
        self._command = ""
        self._polls = self._target_steps = 0
        self._busy_until = 0.0
        self._steps_per_deg = board.settings[STEPS + self._number]
        velocity = board.settings[RATE + self._number] / 60.0
        if self._steps_per_deg <= 0.0 or velocity <= 0.0:
            raise ProtocolError(
                f"{board.name}: the settings of axis {axis} cannot be true; correct $10x, $11x"
            )
        velocity = velocity if velocity_deg_s is None else min(velocity, velocity_deg_s)
        resolution = max(1.0 / self._steps_per_deg, REPORTED_DEG)
        acceleration = board.settings[ACCELERATION + self._number]
        rules = MotionRules(max(tolerance_deg, resolution), velocity, acceleration, margin_s)
        parts = ("Grbl", board.version, board.note, axis)
        super().__init__(" ".join(filter(None, parts)), rules, limits_deg, resolution)
        self._bus = transport.lock

    @abstractmethod
    def _search_goes_on(self, wait_s: float) -> bool:
        """Whether the search for the reference goes on, after up to `wait_s` seconds."""

    @property
    def _homed(self) -> bool:
        return self.axis in self._board.zeros

    @_homed.setter
    def _homed(self, homed: bool) -> None:
        if not homed:
            self._board.zeros.pop(self.axis, None)

    def _status(self) -> Status:
        if not self._transport.is_open:
            raise NotConnected(f"{self.name}: the port is closed; connect again")
        try:
            return self._board.query_status()
        except NotConnected:
            self._raise_alarm()
            raise

    def _raise_alarm(self) -> None:
        if self._board.alarm is not None:
            code, self._board.alarm = self._board.alarm, None
            raise error_of_alarm(self.name, code)

    def _steps(self, status: Status) -> int:
        if len(status.machine) <= self._number:
            raise RigError(
                f"{self.name}: the board reports {len(status.machine)} axes; there is no {self.axis}"
            )
        return round(status.machine[self._number] * self._steps_per_deg)

    def _read_deg(self) -> float:
        was_homed = self._homed
        status = self._status()
        if was_homed and not self._homed:
            self._raise_alarm()
            raise self._lost()
        return (self._steps(status) - self._board.zeros.get(self.axis, 0)) / self._steps_per_deg

    def _read_moving_deg(self) -> float | None:
        return None if self._searching else self._moving_deg  # a board that searches reports nothing

    def _slowed(self) -> tuple[float, str]:
        percent = self._board.feed_percent
        return max(1.0, 100.0 / percent), f"the feed override of the board stands at {percent} %"

    def _lost(self) -> NotHomed:
        return NotHomed(f"{self.name} was reset or switched off, and its position is lost; home it again")

    def _begin_move(self, target_deg: float) -> None:
        self._searching = False
        self._board.drain()
        if not self._homed:
            raise self._lost()
        self._target_steps = self._board.zeros[self.axis] + round(target_deg * self._steps_per_deg)
        target = self._target_steps / self._steps_per_deg
        self._begin(f"$J=G53G90G21{self.axis}{target:.5f}F{60.0 * self.rules.velocity_deg_s:.3f}")

    def _begin(self, command: str) -> None:
        self._command = command
        self._polls = 0
        self._busy_until = self._clock() + self.rules.margin_s
        self._board.send(command)

    def _is_busy(self, wait_s: float) -> bool:
        if self._polls and not self._searching:
            self._clock.sleep(max(0.0, min(wait_s, FIRST_POLL_S * 2.0 ** min(self._polls, 5))))
        self._polls += 1
        return self._search_goes_on(wait_s) if self._searching else self._move_goes_on()

    def _move_goes_on(self) -> bool:
        status = self._status()
        self._moving_deg = (self._steps(status) - self._board.zeros.get(self.axis, 0)) / self._steps_per_deg
        self._raise_alarm()
        if self._refused_as_busy("moving"):
            return True
        if status.state in MOVING:
            return True
        if not self._homed:
            raise self._lost()
        if status.state != "Idle":
            raise RigError(
                f"{self.name} stands in state {status.state}; release it at the board, or home it again"
            )
        # An idle board that did not acknowledge the move yet has not read it.
        near = abs(self._steps(status) - self._target_steps) <= self.rules.tolerance_deg * self._steps_per_deg
        return self._board.answer is None and not near

    def _refused_as_busy(self, doing: str) -> bool:
        """Whether the board was busy and the command was repeated; any other refusal is an error."""
        self._raise_alarm()
        refusal = self._board.answer
        if not isinstance(refusal, Refused):
            return False
        if refusal.code != NOT_IDLE or self._clock() >= self._busy_until or self._stopping.is_set():
            raise error_of_refusal(self.name, refusal.code, doing)
        self._clock.sleep(BUSY_POLL_S)
        self._board.send(self._command)
        return True

    def _send_stop(self) -> None:
        # A search takes no other order than a reset; a jog that is cancelled keeps its position.
        self._board.send_now(RESET if self._searching else JOG_CANCEL)

    def _wait_until_still(self) -> None:
        deadline = self._clock() + self.rules.margin_s
        if self._searching or self._board.critical:
            self._searching = False
            self._board.reset(self.rules.margin_s)
        while self._clock() < deadline and self._board.query_status().state in MOVING:
            self._clock.sleep(BUSY_POLL_S)
        self._board.alarm = None


SWITCH, HERE = "switch", "here"
QUERY_INTERVAL_S = 1.0


class Grbl(GrblAxis):
    """One axis of a board.

    Args:
        transport: the open port; several axes may share it.
        unit: ``deg`` for an axis that turns, ``mm`` for a linear one; all that follows counts in it.
        axis: letter of the axis, ``X`` … ``C``.
        home: ``switch`` searches the limit switch ($H); ``here`` declares the place where the axis stands to be
            0°, for a board without switches.
        timeout_s: time in seconds for the answer to a question.
        reset_s: for so long a board that opening the port resets has time to start; one that is silent for so
            long is reset by a byte.
        tolerance_deg: an axis this near to the target has arrived; by default 0.05° or 0.005 mm.
        velocity_deg_s: speed of moves in deg/s; by default, and at most, what the board allows.
        margin_s: seconds added to every computed time limit.
        min_deg, max_deg: limits in degrees; by default the travel that the board knows.

    Raises:
        NotConnected: no answer.
        ProtocolError: the device that answers is no Grbl 1.1.
        RigError: the board has no such axis.
    """

    PORT: ClassVar = {"baudrate": 115200}

    def __init__(
        self,
        transport: Transport,
        *,
        unit: Unit = "deg",
        axis: str = "X",
        home: str = SWITCH,
        timeout_s: float = 1.0,
        reset_s: float = 3.0,
        tolerance_deg: float | None = None,
        velocity_deg_s: float | None = None,
        margin_s: float = 2.0,
        min_deg: float | None = None,
        max_deg: float | None = None,
    ) -> None:
        if len(axis) != 1 or axis not in AXES:
            raise RigError(f"'{axis}' is no axis of a Grbl board; use one of {', '.join(AXES)}")
        if home not in {SWITCH, HERE}:
            raise RigError(f"home = '{home}' means nothing for a Grbl board; use '{SWITCH}' or '{HERE}'")
        board = board_on(transport, timeout_s, reset_s)
        if STEPS + AXES.index(axis) not in board.settings:
            raise RigError(f"{board.name} has no axis {axis}")
        self._home_here = home == HERE
        self._queried_order = False
        self._queried_at = 0.0
        self._seen_homings = board.homings
        low, high = _travel_deg(board, AXES.index(axis), from_switch=not self._home_here)
        limits = (low if min_deg is None else min_deg, high if max_deg is None else max_deg)
        tolerance = TOLERANCE[unit] if tolerance_deg is None else tolerance_deg
        super().__init__(unit, transport, board, axis, tolerance, velocity_deg_s, margin_s, limits)

    @classmethod
    def stop_command(cls, **_options: object) -> bytes:
        """A reset, which stops a search as well as a move; see `PortStage`."""
        return RESET

    # The reference.

    def home(self) -> float:
        """Search the limit switch, or declare this place to be 0°; return the angle read back, in degrees.

        A board that cannot home its axes one by one moves all of them.

        Raises:
            NotHomed: the board has no switches, and the rig file does not say that 0° is here.
        """
        with self._one_motion():
            self._homed = False
            if not self._home_here and not self._board.settings[HOMING]:
                raise NotHomed(
                    f"{self.name}: homing is switched off in the board ($22=0); fit a switch and set $22=1, or move "
                    'the axis to its 0 by hand and say home = "here" in the options of the rig file'
                )
            if self._home_here:
                return self._declare_zero()
            return self._move("home", self._begin_home, 0.0, self._search_limit_s())

    def _declare_zero(self) -> float:
        status = self._status()
        if self._board.critical or status.state not in {"Idle", "Alarm"}:
            self._board.reset()
            status = self._status()
        self._board.alarm = None
        if status.state == "Alarm":
            self._board.request("$X", lambda _: None)
            status = self._status()
        self._board.zeros[self.axis] = self._steps(status)
        self._left_at_deg = 0.0
        return self._read_deg()

    def _search_limit_s(self) -> float:
        """Seconds after which Grbl itself has given a search up, and a tenth more.

        It searches a switch over 1.5 travels, backs off, and finds it again over five pull-offs, with a pause after
        each of these motions; Z first, then X and Y together, unless it homes axes one by one. It answers nothing
        meanwhile, and an axis may stand anywhere: no shorter time is safe. Source: limits.c and config.h of Grbl 1.1.
        """
        cycles = [self.axis] if "H" in self._board.options else ["Z", "XY", *AXES[3:]]
        return 1.1 * sum(self._cycle_limit_s(axes) for axes in cycles) + self.rules.margin_s

    def _cycle_limit_s(self, axes: str) -> float:
        """Seconds for one cycle of a search, of axes that search together."""
        settings, numbers = self._board.settings, [AXES.index(axis) for axis in axes]
        travel = max(settings.get(TRAVEL + number, 0.0) for number in numbers)
        if travel <= 0.0:
            return 0.0
        top = min(settings.get(RATE + number, math.inf) for number in numbers)
        seek, feed = (
            max(min(settings.get(rate, 0.0), top), 1.0) / 60.0 for rate in (HOMING_SEEK, HOMING_FEED)
        )
        way_s = (1.5 * travel + 2.0 * settings[PULL_OFF]) / seek + 5.0 * settings[PULL_OFF] / feed
        return way_s + 4.0e-3 * settings.get(DEBOUNCE, 250.0)

    def _begin_home(self) -> None:
        self._searching = True
        if self._board.critical or self._status().state not in {"Idle", "Alarm", *MOVING}:
            self._board.reset()
        self._board.alarm = None
        self._queried_order = False
        self._queried_at = self._clock()
        self._begin(f"$H{self.axis}" if "H" in self._board.options else "$H")

    def _search_goes_on(self, wait_s: float) -> bool:
        """While it searches, a board answers nothing, neither to ``?``: the ``ok`` comes at the end."""
        message = self._board.next_message(max(wait_s, 0.0))
        if self._refused_as_busy("searching the reference"):
            return True
        # Lines are carried out in order: whatever is answered to a later one, the search is over.
        if isinstance(self._board.answer, Ok) or (isinstance(message, Feedback) and message.name == "GC"):
            self._take_zero()
            return False
        if isinstance(message, Status) and message.state == "Idle" and not self._queried_order:
            self._queried_order = True
            self._board.send("$G")
        elif message is None or isinstance(message, Status):
            self._query_periodically()
        return True

    def _query_periodically(self) -> None:
        now = self._clock()
        if now - self._queried_at >= QUERY_INTERVAL_S or self._polls <= 1:
            self._queried_at = now
            self._board.send_now(STATUS)

    def _take_zero(self) -> None:
        self._searching = False
        status = self._status()
        alone = "H" in self._board.options
        for number, axis in enumerate(AXES[: len(status.machine)]):
            if axis == self.axis or not alone:
                scale = self._board.settings.get(STEPS + number, 0.0)
                self._board.zeros[axis] = round(status.machine[number] * scale)
        self._board.homings += 1
        self._seen_homings = self._board.homings

    def _check_reference(self, now_deg: float) -> None:
        if self._seen_homings != self._board.homings:  # another axis homed the board, and this one with it
            self._seen_homings = self._board.homings
            self._left_at_deg = None
        super()._check_reference(now_deg)


def _travel_deg(board: GrblBoard, number: int, *, from_switch: bool) -> tuple[float, float]:
    """Limits in degrees of an axis, seen from where the search for the switch ends."""
    settings, travel = board.settings, board.settings[TRAVEL + number]
    if not from_switch:
        return 0.0, travel
    # A board that calls the end of the search 0 (option Z) counts the travel from there.
    usable = travel if "Z" in board.options else travel - settings[PULL_OFF]
    upward = int(settings[HOMING_DIRECTION]) & 1 << number
    return (0.0, usable) if upward else (-usable, 0.0)
