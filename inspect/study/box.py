"""Search box of an optimisation: varied parameters and bounds, and the map from unit coordinates to parts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from itertools import product
from typing import Any

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

    def unit(self, part: Part) -> list[float]:
        """Unit coordinates of a part."""
        found = []
        for name, low, high in zip(self.names, self.low, self.high, strict=True):
            value = getattr(part, name)
            even = name == "ridge_angle"
            found.append((value - low) / (high - low) if even else np.log(value / low) / np.log(high / low))
        return found

    def at(self, unit: Sequence[float] | FloatArray) -> Part:
        """The part at a point in unit coordinates."""
        values: dict[str, Any] = {name: self.value(k, float(unit[k])) for k, name in enumerate(self.names)}
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
    sized = max(part.edge_radius, part.foot_radius) > 0.0 or (
        scoring.tolerances is not None and scoring.tolerances.edge_radius > 0.0
    )
    if "pitch" in bounds and not sized:
        raise UsageError(
            "the pitch has no effect on ideal ridges: light knows angles only; it takes part through something of "
            "absolute size: give --edge-radius UM, or a tolerance edge_radius=UM with --robust, or leave pitch out"
        )


TABLED = {"ridge_angle": 6, "pitch": 3, "alpha_along": 3, "alpha_across": 3}
"""Points of a table along each varied parameter."""


@dataclass(frozen=True)
class TabledScoring(Scoring):
    """Scoring of a search, which takes light that reflects three times and more from a table over its box.

    That light is computed in 60 ms a part, and adds less than 1 % to a radiance; the table is polynomials through
    Chebyshev points, and off by less than 0.1 % of the radiance.

    Attributes:
        box: the box.
        table: (points of every parameter…, P) light in 1/sr that reflects three times and more.
    """

    box: Box | None = field(default=None, compare=False)
    table: FloatArray | None = field(default=None, compare=False, repr=False)

    def reflections(self, part: Part) -> FloatArray:
        """(P,) light of the nominal part in 1/sr that reflects more than once."""
        if self.box is None or self.table is None:
            return super().reflections(part)
        found = self.table
        for count, unit in zip(self.table.shape, self.box.unit(part), strict=False):
            found = np.tensordot(_weights(count, unit), found, axes=1)
        return np.asarray(self.light_after(2, part) + found)


def tabled(box: Box, scoring: Scoring) -> Scoring:
    """The scoring with a table of light that reflects three times and more; without such light as it is."""
    if scoring.bounces in (1, 2):
        return scoring
    given = {one.name: getattr(scoring, one.name) for one in fields(Scoring)}
    return TabledScoring(**given, box=box, table=_table(box, scoring.nominal))


@lru_cache(maxsize=2)
def _table(box: Box, scoring: Scoring) -> FloatArray | None:
    """The table; None where some parts of the box cannot be manufactured, so that nothing is smooth."""
    counts = [TABLED[name] for name in box.names]
    parts = [box.at(unit) for unit in product(*map(_points, counts))]
    if not np.isfinite(scores(parts, replace(scoring, bounces=1))).all():
        return None
    found = np.array([scoring.reflections(one) - scoring.light_after(2, one) for one in parts])
    return found.reshape(*counts, -1)


def _points(count: int) -> FloatArray:
    """(count,) Chebyshev points of the first kind, within 0 and 1."""
    return 0.5 - 0.5 * np.cos(np.pi * (np.arange(count) + 0.5) / count)


def _weights(count: int, at: float) -> FloatArray:
    """(count,) weights of the values at Chebyshev points in the polynomial through them, in barycentric form."""
    away = at - _points(count)
    if np.any(away == 0.0):
        return np.asarray(away == 0.0, dtype=np.float64)
    number = np.arange(count)
    found = (-1.0) ** number * np.sin(np.pi * (number + 0.5) / count) / away
    return np.asarray(found / found.sum())


def value_of(part: Part, scoring: Scoring) -> float:
    """Score, or −inf for a part that cannot be manufactured."""
    return float(scores((part,), scoring)[0])


def scores_of_task(task: tuple[tuple[Part, ...], Scoring]) -> FloatArray:
    """Scores of some parts, for one task of a sweep."""
    return scores(*task)
