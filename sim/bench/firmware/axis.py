"""An axis: where it truly is, as a function of time."""

import math
import threading
import time
from collections.abc import Callable
from typing import Any


class RotaryAxis:
    """A motor that turns a load, on a trapezoidal velocity profile. Angles in degrees.

    Args:
        start_deg: true angle at power-up.
        velocity_deg_s: top speed.
        acceleration_deg_s2: acceleration and deceleration.
        time_scale: stretch of time; 1 is real time, 0 ends every move at once.
        backlash_deg: play between motor and load; the load stands true when approached from below.
        stall_at_deg: an obstacle that the motor does not pass, or None.
        clock: monotonic time in seconds.
    """

    def __init__(
        self,
        *,
        start_deg: float = 0.0,
        velocity_deg_s: float = 430.0,
        acceleration_deg_s2: float = 4000.0,
        time_scale: float = 1.0,
        backlash_deg: float = 0.0,
        stall_at_deg: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.velocity_deg_s = velocity_deg_s
        self.acceleration_deg_s2 = acceleration_deg_s2
        self.time_scale = time_scale
        self.backlash_deg = backlash_deg
        self.stall_at_deg = stall_at_deg
        self.clock = clock
        self._lock = threading.RLock()
        self._from_deg = self._to_deg = self._load_deg = start_deg
        self._since = clock()
        self._top_deg_s = velocity_deg_s
        self._stalled = False

    def start_move(self, target_deg: float, speed_factor: float = 1.0, now: float | None = None) -> None:
        """Start from wherever the motor is at a time of the clock (by default: now), at a share of the top speed."""
        with self._lock:
            self.stop(now)
            end_deg = self._obstacle_before(target_deg)
            self._stalled = end_deg is not None
            self._to_deg = target_deg if end_deg is None else end_deg
            self._top_deg_s = self.velocity_deg_s * speed_factor

    def stop(self, now: float | None = None) -> None:
        """Stop at once, where the motor is at a time of the clock (a piezo motor holds without power)."""
        with self._lock:
            now = self.clock() if now is None else now
            here_deg, self._load_deg = self.position(now), self.load_deg(now)
            self._from_deg = self._to_deg = here_deg
            self._since = now
            self._stalled = False

    def position(self, now: float | None = None) -> float:
        """Motor angle in degrees at a time of the clock (by default: now)."""
        with self._lock:
            distance = self._to_deg - self._from_deg
            gone = self._travelled(abs(distance), self._elapsed(now))
            return self._to_deg if gone >= abs(distance) else self._from_deg + math.copysign(gone, distance)

    def load_deg(self, now: float | None = None) -> float:
        """Angle in degrees of what the motor turns; lags behind by the backlash when turning down."""
        with self._lock:
            motor_deg = self.position(now)
            return min(max(self._load_deg, motor_deg), motor_deg + self.backlash_deg)

    def busy(self, now: float | None = None) -> bool:
        """Whether the motor turns at a time of the clock (by default: now)."""
        with self._lock:
            return self._elapsed(now) < self._duration(abs(self._to_deg - self._from_deg))

    def stalled(self, now: float | None = None) -> bool:
        """Whether the motor is at the obstacle instead of at its target."""
        with self._lock:
            return self._stalled and not self.busy(now)

    def _obstacle_before(self, target_deg: float) -> float | None:
        wall_deg = self.stall_at_deg
        if wall_deg is None or not min(self._from_deg, target_deg) <= wall_deg <= max(
            self._from_deg, target_deg
        ):
            return None
        return None if wall_deg == target_deg else wall_deg

    def _elapsed(self, now: float | None) -> float:
        passed = (self.clock() if now is None else now) - self._since
        return passed / self.time_scale if self.time_scale > 0.0 else math.inf

    def _duration(self, distance_deg: float) -> float:
        peak = min(self._top_deg_s, math.sqrt(distance_deg * self.acceleration_deg_s2))
        return distance_deg / peak + peak / self.acceleration_deg_s2 if peak > 0.0 else 0.0

    def _travelled(self, distance_deg: float, elapsed_s: float) -> float:
        total = self._duration(distance_deg)
        if elapsed_s >= total:
            return distance_deg
        peak = min(self._top_deg_s, math.sqrt(distance_deg * self.acceleration_deg_s2))
        ramp = peak / self.acceleration_deg_s2
        if elapsed_s < ramp:
            return 0.5 * self.acceleration_deg_s2 * elapsed_s**2
        if elapsed_s < total - ramp:
            return peak * (elapsed_s - 0.5 * ramp)
        return distance_deg - 0.5 * self.acceleration_deg_s2 * (total - elapsed_s) ** 2


class LinearAxis(RotaryAxis):
    """The same motion along a line: all numbers are millimetres, also those whose names say degrees."""

    def __init__(self, *, velocity_deg_s: float = 180.0, **options: Any) -> None:  # noqa: ANN401 - of its base
        super().__init__(velocity_deg_s=velocity_deg_s, **options)
