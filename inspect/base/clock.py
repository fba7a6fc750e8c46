"""Time as devices and those who wait for them see it: that of the system, or a virtual one.

Whoever waits takes the clock of what it waits for: a port of the system runs on `SYSTEM`, a simulated device on the
clock that it was given.
"""

import threading
import time
from typing import Protocol, runtime_checkable


@runtime_checkable
class Clock(Protocol):
    """A monotonic clock in seconds, and how to wait by it."""

    def __call__(self) -> float:
        """Seconds since some fixed moment; they never go back."""
        ...

    def sleep(self, seconds: float, /) -> None:
        """Return after so many seconds; at once if they are none."""
        ...


class SystemClock:
    """The monotonic clock of the system."""

    def __call__(self) -> float:
        """Seconds since some fixed moment."""
        return time.monotonic()

    def sleep(self, seconds: float, /) -> None:
        """Wait; other threads run meanwhile."""
        time.sleep(max(0.0, seconds))


class VirtualClock:
    """A virtual clock: waiting advances it at once, and every reading by a little.

    The little keeps those apart from standing still who ask a device again and again until their time is over.
    For one thread that waits; with several, each one's waits pass for all of them.
    """

    def __init__(self, start_s: float = 0.0, look_s: float = 5e-4) -> None:
        self._now_s = start_s
        self._look_s = look_s
        self._lock = threading.Lock()

    def __call__(self) -> float:
        """Seconds waited for so far, and those of all looks."""
        with self._lock:
            self._now_s += self._look_s
            return self._now_s

    def sleep(self, seconds: float, /) -> None:
        """Let time pass at once."""
        with self._lock:
            self._now_s += max(0.0, seconds)


SYSTEM = SystemClock()


def clock_of(time_scale: float) -> Clock:
    """The clock of a simulated device whose motions are stretched so much; virtual where they end at once (0)."""
    return VirtualClock() if time_scale == 0.0 else SYSTEM
