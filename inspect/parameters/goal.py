"""What the best ridge design is best at (`anisoscope.study.objective`)."""

from dataclasses import dataclass
from typing import Literal

from anisoscope.base.errors import UsageError

Kind = Literal["difference", "michelson", "log_ratio"]
Over = Literal["mean", "worst"]


@dataclass(frozen=True)
class Goal:
    """Score of a design.

    Attributes:
        contrast: contrast; its absolute value counts.
        tilts_deg: tilts in degrees, comma-separated (--tilts=-10,0,10).
        over: mean over pairs and tilts, or the worst of them.
        score: the contrast, or its ratio to its standard deviation.
        z: the robust score is mean − z · standard deviation.
        quantile: the robust score is this quantile of the contrast instead, up to 0.5.
        samples: parts in the sample of tolerances, a power of two.
        seed: seed of the sample.
        bounces: most reflections; 1: direct light; 2 holds most of what 'all' adds, in half of its time.

    Raises:
        UsageError: a number outside its range.
    """

    contrast: Kind = "difference"
    tilts_deg: tuple[float, ...] = (0.0,)
    over: Over = "mean"
    score: Literal["contrast", "snr"] = "contrast"
    z: float = 2.0
    quantile: float | None = None
    samples: int = 64
    seed: int = 1
    bounces: int | Literal["all"] = "all"

    def __post_init__(self) -> None:
        if self.samples < 8 or self.samples & (self.samples - 1):
            raise UsageError(f"the sample must be a power of two from 8 on, not {self.samples}")
        if self.quantile is not None and not 0.0 < self.quantile <= 0.5:
            raise UsageError(f"the quantile must lie above 0 and up to 0.5, not {self.quantile:g}")
        if not 0.0 <= self.z < float("inf"):
            raise UsageError(f"z must be 0 or more, not {self.z:g}")
        if self.bounces != "all" and self.bounces < 1:
            raise UsageError(f"light reflects at least once, not {self.bounces} times")
        if self.score == "snr" and self.quantile is not None:
            raise UsageError("a signal-to-noise ratio has no quantile: leave one of the two out")
