"""Driver for an axis of a Grbl 1.1 board (Arduino and others): 115200 baud, lines.

Scale, speed, acceleration and travel are read from the board, where 1 mm stands for 1°. Moves are jogs in machine
coordinates: they leave the modes of the G-code parser alone, and a jog that is cancelled keeps its position. An
``ok`` only says that a move was queued: an axis has arrived when the board is idle and counts the target. The
motors have no feedback: steps that are lost without a limit switch are seen by nobody but the camera.
Source: interface description of Grbl 1.1.
"""

import time
from typing import ClassVar

from anisoscope.base.errors import NotHomed, RigError
from anisoscope.rig.stages.grbl_axis import GrblAxis
from anisoscope.rig.stages.grbl_board import GrblBoard, board_on
from anisoscope.rig.stages.grbl_wire import (
    AXES,
    HOMING,
    HOMING_DIRECTION,
    HOMING_FEED,
    HOMING_SEEK,
    MOVING,
    PULL_OFF,
    STATUS,
    STEPS,
    TRAVEL,
    Ok,
    Status,
    Told,
)
from anisoscope.rig.transport import Transport

SWITCH, HERE = "switch", "here"
ASK_AGAIN_S = 1.0


class Grbl(GrblAxis):
    """One axis of a board.

    Args:
        transport: the open port; several axes may share it.
        axis: letter of the axis, ``X`` … ``C``.
        home: ``switch`` searches the limit switch ($H); ``here`` declares the place where the axis stands to be
            0°, for a board without switches.
        timeout_s: time in seconds for the answer to a question.
        reset_s: for so long a board that opening the port resets has time to start; one that is silent for so
            long is reset by a byte.
        tolerance_deg: an axis this near to the target has arrived.
        velocity_deg_s: speed of moves in deg/s; by default, and at most, what the board allows.
        margin_s: seconds added to every computed time limit.
        min_deg, max_deg: limits in degrees; by default the travel that the board knows.

    Raises:
        NotConnected: nobody answers.
        ProtocolError: somebody answers, but it is no Grbl 1.1.
        RigError: the board has no such axis.
    """

    PORT: ClassVar = {"baudrate": 115200}

    def __init__(
        self,
        transport: Transport,
        *,
        axis: str = "X",
        home: str = SWITCH,
        timeout_s: float = 1.0,
        reset_s: float = 3.0,
        tolerance_deg: float = 0.05,
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
        self._asked_order = False
        self._asked_at = 0.0
        self._seen_homings = board.homings
        low, high = _travel_deg(board, AXES.index(axis), from_switch=not self._home_here)
        limits = (low if min_deg is None else min_deg, high if max_deg is None else max_deg)
        super().__init__(transport, board, axis, tolerance_deg, velocity_deg_s, margin_s, limits)

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
                    f"{self.name}: homing is switched off in the board ($22=0); fit a switch and set $22=1, or turn "
                    'the axis to its 0° by hand and say home = "here" in the options of the rig file'
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
        """Seconds for a search over one and a half travels, as Grbl does it, of the slowest axis."""
        settings = self._board.settings
        travels = [value for number, value in settings.items() if TRAVEL <= number < TRAVEL + len(AXES)]
        way = 1.5 * max(travels) / max(settings.get(HOMING_SEEK, 0.0), 1.0)
        way += 10.0 * settings[PULL_OFF] / max(settings.get(HOMING_FEED, 0.0), 1.0)
        return 1.5 * 60.0 * way + self.rules.margin_s

    def _begin_home(self) -> None:
        self._searching = True
        if self._board.critical or self._status().state not in {"Idle", "Alarm", *MOVING}:
            self._board.reset()
        self._board.alarm = None
        self._asked_order = False
        self._asked_at = time.monotonic()
        self._begin(f"$H{self.axis}" if "H" in self._board.options else "$H")

    def _search_goes_on(self, wait_s: float) -> bool:
        """While it searches, a board answers nothing, neither to ``?``: the ``ok`` comes at the end."""
        message = self._board.next_message(max(wait_s, 0.0))
        if self._refused_as_busy("searching the reference"):
            return True
        # Lines are carried out in order: whatever is answered to a later one, the search is over.
        if isinstance(self._board.answer, Ok) or (isinstance(message, Told) and message.name == "GC"):
            self._take_zero()
            return False
        if isinstance(message, Status) and message.state == "Idle" and not self._asked_order:
            self._asked_order = True
            self._board.send("$G")
        elif message is None or isinstance(message, Status):
            self._ask_now_and_then()
        return True

    def _ask_now_and_then(self) -> None:
        now = time.monotonic()
        if now - self._asked_at >= ASK_AGAIN_S or self._polls <= 1:
            self._asked_at = now
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
