"""Search box of an optimisation: varied parameters and bounds, and the map from unit coordinates to parts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.study.objective import Part, Scoring, scores

Bounds = Mapping[str, tuple[float, float]]

LIMITS = {
    "ridge_angle": (0.1, 44.0),
    "pitch": (1.0, 2000.0),
    "alpha_along": (0.005, 0.9),
    "alpha_across": (0.005, 0.9),
}
UNITS = {"ridge_angle": "°", "pitch": "µm", "alpha_along": "1", "alpha_across": "1"}


@dataclass(frozen=True)
class Box:
    """The bounds, and the way between unit coordinates and parts."""

    part: Part
    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    def value(self, number: int, unit: float) -> float:
        """The value of a parameter at a unit coordinate."""
        low, high = self.low[number], self.high[number]
        if self.names[number] == "ridge_angle":
            return float(low + unit * (high - low))
        return float(np.clip(low * (high / low) ** unit, low, high))

    def at(self, unit: Sequence[float] | FloatArray) -> Part:
        """The part at a point in unit coordinates."""
        values = {name: self.value(k, float(unit[k])) for k, name in enumerate(self.names)}
        return replace(self.part, **values)


def check_bounds(bounds: Bounds, part: Part, scoring: Scoring) -> None:
    """Refuse bounds outside the domain of the parameters.

    Raises:
        UsageError: unknown parameters, empty or absurd ranges, or a pitch without anything of absolute size.
    """
    if not bounds:
        raise UsageError("nothing to vary: give --vary NAME=FROM:TO, such as --vary ridge_angle=3:20")
    for name, (low, high) in bounds.items():
        if name not in LIMITS:
            raise UsageError(f"{name!r} cannot be varied; what can: {', '.join(LIMITS)}")
        least, most = LIMITS[name]
        if not least <= low < high <= most:
            raise UsageError(
                f"--vary {name}={low:g}:{high:g}: the range must rise, within {least:g} and {most:g} {UNITS[name]}"
            )
    sized = part.edge_radius > 0.0 or (
        scoring.tolerances is not None and scoring.tolerances.edge_radius > 0.0
    )
    if "pitch" in bounds and not sized:
        raise UsageError(
            "the pitch has no effect on ideal ridges: light knows angles only; it takes part through something of "
            "absolute size: give --edge-radius UM, or a tolerance edge_radius=UM with --robust, or leave pitch out"
        )


def value_of(part: Part, scoring: Scoring) -> float:
    """Score, or −inf for a part that cannot be manufactured."""
    return float(scores((part,), scoring)[0])


def scores_of_task(task: tuple[tuple[Part, ...], Scoring]) -> FloatArray:
    """Scores of some parts, for one task of a sweep."""
    return scores(*task)
