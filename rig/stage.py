"""What a stage is, and how exactly and how fast it moves. Angles are in degrees.

A linear stage has the attribute ``unit = "mm"``; then all its numbers are millimetres, also those whose names say
degrees. So one set of rules, one protocol to other processes and one set of commands serve both.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol, cast, runtime_checkable

from anisoscope.base.clock import SYSTEM, Clock
from anisoscope.base.errors import LimitExceeded

Unit = Literal["deg", "mm"]
SYMBOLS: dict[Unit, str] = {"deg": "°", "mm": " mm"}
WRONG_UNIT: dict[Unit, str] = {
    "deg": "name the port of a rotation stage, or describe it in a table [x], [y] or [z] of the rig file",
    "mm": "name the port of a linear stage, or describe it in [stage] or [tilt] of the rig file",
}


def unit_of(stage: object) -> Unit:
    """Unit in which a stage counts; one that does not say turns."""
    return cast("Unit", getattr(stage, "unit", "deg"))


@runtime_checkable
class RotationStage(Protocol):
    """A stage that turns the sample; angles in degrees, in the stage's own sense and zero."""

    @property
    def name(self) -> str:
        """Model and serial number, for records."""
        ...

    @property
    def limits_deg(self) -> tuple[float, float]:
        """Lowest and highest permitted angle."""
        ...

    @property
    def resolution_deg(self) -> float:
        """Smallest step."""
        ...

    @property
    def is_homed(self) -> bool:
        """Whether the reference search was done since the connection was made."""
        ...

    def position_deg(self) -> float:
        """Read the angle."""
        ...

    def home(self) -> float:
        """Search the reference; return the angle read back."""
        ...

    def move_to(self, angle_deg: float) -> float:
        """Move to an angle; return the angle read back."""
        ...

    def move_by(self, delta_deg: float) -> float:
        """Move by an angle; return the angle read back."""
        ...

    def stop(self) -> None:
        """Stop at once; may be called from any thread."""
        ...

    def close(self) -> None:
        """Stop if moving, and disconnect."""
        ...


def check_limits(stage: RotationStage, angle_deg: float) -> None:
    """Reject an angle in degrees (a length in mm) outside the limits of a stage, before any motion.

    Raises:
        LimitExceeded: it does.
    """
    low, high = stage.limits_deg
    slack = 0.5 * stage.resolution_deg
    if not low - slack <= angle_deg <= high + slack:
        unit = SYMBOLS[unit_of(stage)]
        raise LimitExceeded(
            f"{stage.name}: {angle_deg:.6g}{unit} is outside {low:.6g}{unit}…{high:.6g}{unit}; nothing was moved"
        )


@dataclass(frozen=True)
class MotionState:
    """State of a motion.

    Attributes:
        moving: whether it turns.
        position_deg: where it is; None where it cannot be read during a motion.
        speed_deg_s: how fast it turns, negative towards lower angles; None where that is not known.
    """

    moving: bool
    position_deg: float | None
    speed_deg_s: float | None


OBSERVED_S = 0.1


def motion_state(stage: RotationStage, clock: Clock = SYSTEM) -> MotionState:
    """Look whether a stage turns, without waiting for the end: by its own account, or by two readings."""
    own: Callable[[], MotionState] | None = getattr(stage, "motion_state", None)
    if own is not None:
        return own()
    return between_readings(stage.position_deg, 2.0 * stage.resolution_deg, clock)


def between_readings(read_deg: Callable[[], float], still_deg: float, clock: Clock) -> MotionState:
    """State of a stage from two readings, `OBSERVED_S` apart; up to `still_deg` it is at rest."""
    before_deg, before_s = read_deg(), clock()
    clock.sleep(OBSERVED_S)
    now_deg, now_s = read_deg(), clock()
    moving = abs(now_deg - before_deg) > still_deg
    return MotionState(moving, now_deg, (now_deg - before_deg) / (now_s - before_s) if moving else 0.0)


FULL_TURN_DEG = 360.0
MOST_TURNS = 10
ROUND_SLACK_DEG = 0.01
"""Limits that miss a full turn by no more still span it: they are rounded to counts."""
LEAST_APPROACH = 0.25


def turns_round(limits_deg: tuple[float, float]) -> bool:
    """Whether limits in degrees span a turn, so that readings a turn apart are the same direction."""
    return limits_deg[1] - limits_deg[0] >= FULL_TURN_DEG - ROUND_SLACK_DEG


def apart_deg(first_deg: float, second_deg: float) -> float:
    """How far the first direction is from the second, −180° to below 180°."""
    half = FULL_TURN_DEG / 2.0
    return (first_deg - second_deg + half) % FULL_TURN_DEG - half


def within_a_turn(limits_deg: tuple[float, float], reading_deg: float, approach_deg: float = 0.0) -> float:
    """The reading within the limits that is the same direction, if possible with room to approach it from below.

    Of a stage that cannot turn all the way round, of one more than `MOST_TURNS` turns away, and of a number that is
    none, the reading itself. All in degrees.
    """
    low, high = limits_deg
    if not turns_round(limits_deg) or not math.isfinite(reading_deg):
        return reading_deg
    turns = sorted(range(-MOST_TURNS, MOST_TURNS + 1), key=abs)
    same = (reading_deg + FULL_TURN_DEG * turn for turn in turns)
    found = [
        min(max(one, low), high) for one in same if low - ROUND_SLACK_DEG <= one <= high + ROUND_SLACK_DEG
    ]
    return max(found, key=lambda one: min(one - low, approach_deg), default=reading_deg)


def approach_from(limits_deg: tuple[float, float], reading_deg: float, approach_deg: float) -> float:
    """Reading from which another is approached: so far below it, or the end of the travel of a stage that turns round.

    That end serves where `LEAST_APPROACH` of the way is left to it. All in degrees.
    """
    low, below = limits_deg[0], reading_deg - approach_deg
    near = turns_round(limits_deg) and reading_deg - low >= LEAST_APPROACH * approach_deg
    return max(below, low) if near else below


@dataclass(frozen=True)
class MotionRules:
    """Accuracy and speed of a stage.

    Attributes:
        tolerance_deg: a stage this near to the target has arrived.
        velocity_deg_s: speed that the stage at least reaches.
        acceleration_deg_s2: acceleration that the stage at least has.
        margin_s: time added to every computed move.
    """

    tolerance_deg: float
    velocity_deg_s: float
    acceleration_deg_s2: float = 1000.0
    margin_s: float = 2.0

    def duration_s(self, distance_deg: float) -> float:
        """Duration in seconds of a trapezoidal (or, if short, triangular) move over a distance in degrees."""
        distance, top = abs(distance_deg), self.velocity_deg_s
        ramp = top * top / self.acceleration_deg_s2
        if distance < ramp:
            return 2.0 * math.sqrt(distance / self.acceleration_deg_s2)
        return distance / top + top / self.acceleration_deg_s2

    def timeout_s(self, distance_deg: float) -> float:
        """Seconds after which a move over a distance in degrees has failed: 1.5 durations, plus margin."""
        return 1.5 * self.duration_s(distance_deg) + self.margin_s
