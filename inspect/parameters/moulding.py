"""A simulated injection moulding machine (`anisoscope.sim.press`)."""

import math
from dataclasses import dataclass

from anisoscope.base.errors import UsageError


@dataclass(frozen=True)
class MouldingRun:
    """Parts of a simulated machine, one of whose settings may change.

    Attributes:
        parts: parts that are inspected, one shot in 20.
        setting: setting that changes, such as 'mould temperature'.
        change: by how much, in °C, bar, s or shots.
        onset: first part with the change, counted from 1.
        ramp: parts over which it grows; 0 for a step.
        seed: seed of the noise.

    Raises:
        UsageError: a number outside its range, or a setting without a change.
    """

    parts: int = 300
    setting: str | None = None
    change: float = 0.0
    onset: int = 200
    ramp: int = 0
    seed: int = 1

    def __post_init__(self) -> None:
        if min(self.parts, self.onset) < 1 or self.ramp < 0 or not math.isfinite(self.change):
            raise UsageError(
                "rig sim press: --parts and --onset are at least 1, --ramp at least 0, --change is finite"
            )
        if (self.setting is None) != (self.change == 0.0):
            raise UsageError("rig sim press: --setting and --change go together")
