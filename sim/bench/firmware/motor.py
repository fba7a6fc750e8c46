"""One motor behind a firmware: it counts from where it stood at power-up until it finds its reference."""

from collections.abc import Mapping
from enum import StrEnum

from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.faults import FaultKind

STALL_S = 2.0


class Motion(StrEnum):
    """Motion of the motor, or the one that has just ended."""

    HOME = "home"
    MOVE = "move"
    STALL = "stall"


class Motor:
    """Moves an axis in counts, with the faults of the mechanics: slow, overshoot, stall, power loss.

    Args:
        axis: the axis that it turns; its true angle has its zero at the reference mark.
        counts_per_deg: scale.
        faults: the faults of the device, shared with it.
        stall_s: a motor that stands at an obstacle for so many seconds (stretched as the axis' time) gives up.

    Attributes:
        motion: what goes on now, or None.
        referenced: whether the reference was found since power-up.
    """

    def __init__(
        self,
        axis: RotaryAxis,
        counts_per_deg: float,
        faults: Mapping[FaultKind, float],
        *,
        stall_s: float = STALL_S,
    ) -> None:
        self.axis = axis
        self.counts_per_deg = counts_per_deg
        self._faults = faults
        self._stall_s = stall_s
        self._motions = 0
        self.power_up()
        self.axis.stall_at_deg = faults.get(FaultKind.STALL, axis.stall_at_deg)

    @property
    def counts(self) -> int:
        """Position in counts, as the device believes it to be."""
        return round((self.axis.position() - self._zero_deg) * self.counts_per_deg)

    @property
    def motions(self) -> int:
        """Number of motions requested so far."""
        return self._motions

    def power_up(self) -> None:
        """Switched on: zero is here, and the reference is unknown."""
        self._zero_deg = self.axis.position()
        self.referenced = False
        self.motion: Motion | None = None
        self._home_counts = 0
        self._stalled_since: float | None = None
        self._doomed = False

    def count_motion(self) -> bool:
        """Count a requested motion; True if the line dies at it."""
        self._motions += 1
        return FaultKind.HANGUP in self._faults and self._motions > self._faults[FaultKind.HANGUP]

    def move(self, target_counts: float, speed_factor: float = 1.0) -> None:
        """Start a move to a position in counts, at a share of the top speed."""
        self.motion = Motion.MOVE
        beyond = self._faults.get(FaultKind.OVERSHOOT, 0.0)
        self._go(self._zero_deg + (target_counts + beyond) / self.counts_per_deg, speed_factor)

    def home(self, home_counts: int = 0, speed_factor: float = 1.0) -> None:
        """Start the reference search: it ends ``home_counts`` from the mark; that position is the new zero."""
        self.motion = Motion.HOME
        self.referenced = False
        self._home_counts = home_counts
        self._go(home_counts / self.counts_per_deg, speed_factor)

    def stop(self) -> Motion | None:
        """Stop where it is; return what was going on."""
        was, self.motion = self.motion, None
        self.axis.stop()
        return was

    def ended(self) -> Motion | None:
        """Motion that ended since the last call, reported once: a home, a move, or a stall at an obstacle."""
        if self.motion is None or self.axis.busy():
            return None
        if self.axis.stalled():
            return self._ended_at_obstacle()
        ended, self.motion = self.motion, None
        if ended is Motion.HOME:
            self._zero_deg = self._home_counts / self.counts_per_deg
            self.referenced = True
        self._doomed = ended is Motion.MOVE and FaultKind.LOST_HOMING in self._faults
        return ended

    def loses_power(self) -> bool:
        """Whether the device is power-cycled now (after a move, with the fault for it), reported once."""
        doomed, self._doomed = self._doomed, False
        return doomed

    def repair(self) -> None:
        """Take the obstacle away."""
        self.axis.stall_at_deg = None

    def _go(self, target_deg: float, speed_factor: float) -> None:
        self._stalled_since = None
        self.axis.start_move(target_deg, speed_factor / self._faults.get(FaultKind.SLOW, 1.0))

    def _ended_at_obstacle(self) -> Motion | None:
        now = self.axis.clock()
        self._stalled_since = now if self._stalled_since is None else self._stalled_since
        if now - self._stalled_since < self._stall_s * self.axis.time_scale:
            return None
        self._stalled_since = self.motion = None
        self.axis.stop()
        return Motion.STALL
