"""The motion of one axis of a Grbl board: jogs in machine coordinates, and what ends them."""

import time
from abc import abstractmethod

from anisoscope.base.errors import NotConnected, NotHomed, ProtocolError, RigError
from anisoscope.rig.stage import MotionRules
from anisoscope.rig.stages.grbl_board import GrblBoard
from anisoscope.rig.stages.grbl_wire import (
    ACCELERATION,
    AXES,
    JOG_CANCEL,
    MOVING,
    NOT_IDLE,
    RATE,
    RESET,
    STEPS,
    Refused,
    Status,
    error_of_alarm,
    error_of_refusal,
)
from anisoscope.rig.stages.portstage import PortStage
from anisoscope.rig.transport import Transport

REPORTED_DEG = 0.001
FIRST_POLL_S, BUSY_POLL_S = 0.002, 0.02


class GrblAxis(PortStage):
    """An axis that moves; how it finds its reference is added by a subclass.

    The board knows nothing of references, and all axes of a board lose them together: they stand in `GrblBoard.zeros`.

    Args:
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
        transport: Transport,
        board: GrblBoard,
        axis: str,
        tolerance_deg: float,
        velocity_deg_s: float | None,
        margin_s: float,
        limits_deg: tuple[float, float],
    ) -> None:
        self.axis = axis
        self._transport = transport
        self._board = board
        self._number = AXES.index(axis)
        self._searching = False
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
            return self._board.ask_status()
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
        self._busy_until = time.monotonic() + self.rules.margin_s
        self._board.send(command)

    def _is_busy(self, wait_s: float) -> bool:
        if self._polls and not self._searching:
            time.sleep(max(0.0, min(wait_s, FIRST_POLL_S * 2.0 ** min(self._polls, 5))))
        self._polls += 1
        return self._search_goes_on(wait_s) if self._searching else self._move_goes_on()

    def _move_goes_on(self) -> bool:
        status = self._status()
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
        """Whether the board was busy and was told once more; any other refusal is an error."""
        self._raise_alarm()
        refusal = self._board.answer
        if not isinstance(refusal, Refused):
            return False
        if refusal.code != NOT_IDLE or time.monotonic() >= self._busy_until or self._stopping.is_set():
            raise error_of_refusal(self.name, refusal.code, doing)
        time.sleep(BUSY_POLL_S)
        self._board.send(self._command)
        return True

    def _send_stop(self) -> None:
        # A search takes no other order than a reset; a jog that is cancelled keeps its position.
        self._board.send_now(RESET if self._searching else JOG_CANCEL)

    def _wait_until_still(self) -> None:
        deadline = time.monotonic() + self.rules.margin_s
        if self._searching or self._board.critical:
            self._searching = False
            self._board.reset(self.rules.margin_s)
        while time.monotonic() < deadline and self._board.ask_status().state in MOVING:
            time.sleep(BUSY_POLL_S)
        self._board.alarm = None
