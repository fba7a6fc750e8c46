"""What a rotation stage is, and how exactly and how fast it moves. Angles are in degrees."""

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from anisoscope.base.errors import LimitExceeded


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
    """Reject an angle in degrees outside the limits of a stage, before any motion.

    Raises:
        LimitExceeded: it does.
    """
    low, high = stage.limits_deg
    slack = 0.5 * stage.resolution_deg
    if not low - slack <= angle_deg <= high + slack:
        raise LimitExceeded(
            f"{stage.name}: {angle_deg:.6g}° is outside {low:.6g}°…{high:.6g}°; nothing was moved"
        )


@dataclass(frozen=True)
class MotionRules:
    """How exactly and how fast a stage moves.

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
