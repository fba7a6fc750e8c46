"""What moves behind a simulated Grbl board: stepper motors without feedback, and the queue of moves.

The board counts the pulses that it sends. Whether the load follows it does not know: at an obstacle the axis
stands still and the counts go on.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.grbl_settings import ACCELERATION, RATE, STEPS, Memory

QUEUE_LENGTH = 15
Place = tuple[float, float, float]


@dataclass(frozen=True)
class Move:
    """A straight move to a machine position in degrees, at a rate in deg/min (None: as fast as it goes)."""

    target: Place
    rate: float | None = None


class Stepper:
    """One motor: pulses on one side, a load on the other.

    Args:
        axis: the load; its zero is where a reference search ends.
        steps_per_deg: what the mechanics really has, whatever the settings say.
    """

    def __init__(self, axis: RotaryAxis, steps_per_deg: float) -> None:
        self.axis = axis
        self._steps_per_deg = steps_per_deg
        self._pulses = RotaryAxis(time_scale=axis.time_scale, clock=axis.clock)

    @property
    def steps(self) -> int:
        """Position as the board counts it."""
        return round(self._pulses.position())

    @property
    def busy(self) -> bool:
        """Whether pulses are sent."""
        return self._pulses.busy()

    def count_from(self, steps: int) -> None:
        """Call the present position so many steps."""
        self.stop()
        self._pulses = RotaryAxis(
            start_deg=float(steps), time_scale=self.axis.time_scale, clock=self.axis.clock
        )

    def go(self, target_steps: float, speed_deg_s: float, acceleration_deg_s2: float) -> None:
        """Send the pulses to a position; speed and acceleration of the load in degrees."""
        now = self.axis.clock()  # one time for both: the load must not lag behind its pulses
        self._stop_at(now)
        away = target_steps - self._pulses.position(now)
        for what, scale in ((self.axis, 1.0), (self._pulses, self._steps_per_deg)):
            what.velocity_deg_s, what.acceleration_deg_s2 = speed_deg_s * scale, acceleration_deg_s2 * scale
        self._pulses.start_move(target_steps, now=now)
        self.axis.start_move(self.axis.position(now) + away / self._steps_per_deg, now=now)

    def search(self, speed_deg_s: float, acceleration_deg_s2: float) -> None:
        """Start for the reference: one move that ends pulled off the switch."""
        away = -self.axis.position() * self._steps_per_deg
        self.go(self._pulses.position() + away, speed_deg_s, acceleration_deg_s2)

    def stop(self) -> None:
        """Stop where it is."""
        self._stop_at(self.axis.clock())

    def _stop_at(self, now: float) -> None:
        self._pulses.stop(now)
        self.axis.stop(now)


class Planner:
    """The queue of moves, and the motors that carry them out.

    Args:
        axes: rotation, tilt and a third one.
        memory: the settings.
        steps_per_deg: of the mechanics, for every axis.
        slowness: factor by which everything is slower.

    Attributes:
        overshoot: steps that the first axis goes beyond every target.
    """

    def __init__(
        self, axes: Sequence[RotaryAxis], memory: Memory, steps_per_deg: Sequence[float], slowness: float
    ) -> None:
        self.steppers = [Stepper(axis, steps) for axis, steps in zip(axes, steps_per_deg, strict=True)]
        self.overshoot = 0.0
        self.slowness = slowness
        self._memory = memory
        self._queue: deque[Move] = deque()
        self._now: Move | None = None
        self._held = False

    @property
    def free(self) -> int:
        """Number of moves that the queue still takes."""
        return QUEUE_LENGTH - len(self._queue)

    @property
    def idle(self) -> bool:
        """Whether nothing moves and nothing waits."""
        return self._now is None and not self._queue

    @property
    def position(self) -> Place:
        """Machine position in degrees, from the counts."""
        x, y, z = (stepper.steps / self._scale(axis) for axis, stepper in enumerate(self.steppers))
        return x, y, z

    @property
    def blocked(self) -> bool:
        """Whether a load is blocked by an obstacle."""
        return any(stepper.axis.stalled() for stepper in self.steppers)

    @property
    def rate(self) -> float:
        """Rate of the present move in deg/min."""
        if self._now is None or self._held:
            return 0.0
        return self._now.rate if self._now.rate is not None else self._memory.settings[RATE]

    def put(self, move: Move) -> None:
        """Queue a move; it starts at once if nothing goes on."""
        self._queue.append(move)
        self.go_on()

    def go_on(self) -> bool:
        """Start what waits if the present move is over; whether a move has ended."""
        if self._held:
            return False
        ended = self._now is not None and not any(stepper.busy for stepper in self.steppers)
        if ended:
            self._now = None
        if self._now is None and self._queue:
            self._now = self._queue.popleft()
            self._start(self._now)
        return ended

    def hold(self) -> None:
        """Stop, and keep the target for resumption."""
        self._held = True
        self._stop_motors()

    def resume(self) -> None:
        """Go on after `hold`."""
        self._held = False
        if self._now is not None:
            self._start(self._now)

    def cancel(self) -> None:
        """Stop, and forget everything that waits."""
        self._stop_motors()
        self._queue.clear()
        self._now = None
        self._held = False

    def _stop_motors(self) -> None:
        for stepper in self.steppers:
            stepper.stop()

    def _scale(self, axis: int) -> float:
        return self._memory.settings[STEPS + axis]

    def _start(self, move: Move) -> None:
        settings = self._memory.settings
        targets = [round(angle * self._scale(axis)) for axis, angle in enumerate(move.target)]
        ways = [
            abs(target - stepper.steps) / self._scale(axis)
            for axis, (target, stepper) in enumerate(zip(targets, self.steppers, strict=True))
        ]
        path = math.hypot(*ways)
        moving = [axis for axis, way in enumerate(ways) if way > 0.0]
        if moving == [0]:
            targets[0] += round(self.overshoot)
        # All axes start and end together: the one with the least to give in proportion to its way decides.
        limit = min((settings[RATE + axis] * path / ways[axis] for axis in moving), default=0.0)
        rate = limit if move.rate is None else min(move.rate, limit)
        push = min((settings[ACCELERATION + axis] * path / ways[axis] for axis in moving), default=0.0)
        for axis in moving:
            share = ways[axis] / path
            self.steppers[axis].go(targets[axis], rate / 60.0 * share / self.slowness, push * share)
