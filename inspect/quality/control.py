"""One number under control: chart, EWMA, patterns, capability and normality of a series, and a verdict in words."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from anisoscope.errors import UsageError
from anisoscope.quality.capability import GOOD, POOR, Capability, Specification, capability
from anisoscope.quality.ewma import WEIGHT, WIDTH, Ewma, ewma
from anisoscope.quality.individuals import (
    BoolArray,
    FloatArray,
    Limits,
    given_limits,
    limits_of,
    moving_range,
)
from anisoscope.quality.nelson import Flag, flags
from anisoscope.quality.normality import Normality, anderson_darling

FEW = 20


@dataclass(frozen=True)
class Settings:
    """How a series is charted.

    Attributes:
        baseline: measured values from the start that the limits rest on; None for all.
        weight: lambda of the EWMA.
        width: L of the EWMA.
        center, sigma: known mean and short-term standard deviation, in place of a baseline; both or neither.
    """

    baseline: int | None = None
    weight: float = WEIGHT
    width: float = WIDTH
    center: float | None = None
    sigma: float | None = None

    def limits(self, values: FloatArray) -> Limits:
        """Limits of a series.

        Raises:
            UsageError: one of mean and sigma is missing, or as `limits_of`.
        """
        if (self.center is None) != (self.sigma is None):
            raise UsageError("a known mean and a known sigma go together: give both or neither")
        if self.center is not None and self.sigma is not None:
            if self.baseline is not None:
                raise UsageError("a known mean and sigma take the place of a baseline: leave one of them out")
            return given_limits(self.center, self.sigma)
        return limits_of(values, self.baseline)


@dataclass(frozen=True, eq=False)
class ControlStudy:
    """All that is said of one series.

    Attributes:
        name: of the number, and of the group it belongs to.
        values: (N,), NaN is missing.
        labels: N names of the values, such as serial numbers.
        limits: of the chart.
        ranges: (N,) moving ranges.
        average: EWMA.
        flags: patterns of the values.
        wide: (N,) moving ranges above their limit.
        capability: where there is a specification.
        normality: where there are enough values.
        notes: what the reader should know.
    """

    name: str
    values: FloatArray
    labels: tuple[str, ...]
    limits: Limits
    ranges: FloatArray
    average: Ewma
    flags: tuple[Flag, ...]
    wide: BoolArray
    capability: Capability | None
    normality: Normality | None
    notes: tuple[str, ...]

    @property
    def count(self) -> int:
        """Measured values."""
        return int(np.count_nonzero(~np.isnan(self.values)))

    @property
    def stable(self) -> bool:
        """No pattern, no wide range, no average outside."""
        return not (self.flags or self.wide.any() or self.average.outside.any())

    @property
    def verdict(self) -> str:
        """The outcome in plain words."""
        words = [f"stable: nothing unusual among {self.count} values" if self.stable else self._trouble()]
        if self.capability is not None:
            words.append(capable_words(self.capability, self.stable))
        return "; ".join(words)

    def _trouble(self) -> str:
        found = []
        if self.flags:
            first = self.flags[0]
            found.append(
                f"{_times(len(self.flags), 'pattern')}, the first at {self.labels[first.seen_at]} "
                f"(rule {first.rule}: {first.text})"
            )
        if self.wide.any():
            found.append(f"{_times(int(self.wide.sum()), 'jump')} between neighbours above the limit")
        if self.average.outside.any():
            at = self.labels[int(np.argmax(self.average.outside))]
            found.append(f"the moving average leaves its limits, first at {at}")
        return "not stable: " + "; ".join(found)

    def to_json(self) -> dict[str, Any]:
        """All of it but the values, for JSON."""
        return {
            "name": self.name,
            "measured": self.count,
            "missing": len(self.values) - self.count,
            "stable": self.stable,
            "verdict": self.verdict,
            "limits": {
                "center": self.limits.center,
                "sigma": self.limits.sigma,
                "lower": self.limits.lower,
                "upper": self.limits.upper,
                "range_center": self.limits.range_center,
                "range_upper": self.limits.range_upper,
                "baseline": self.limits.baseline,
            },
            "ewma": {"lambda": self.average.weight, "width": self.average.width},
            "flags": [_flag_json(flag, self.labels) for flag in self.flags],
            "wide_ranges": [self.labels[k] for k in np.flatnonzero(self.wide)],
            "ewma_outside": [self.labels[k] for k in np.flatnonzero(self.average.outside)],
            "capability": None if self.capability is None else _capability_json(self.capability),
            "normality": None if self.normality is None else vars(self.normality),
            "notes": list(self.notes),
        }


def _times(count: int, word: str) -> str:
    return f"{count} {word}" + ("" if count == 1 else "s")


def _flag_json(flag: Flag, labels: tuple[str, ...]) -> dict[str, Any]:
    return {
        "rule": flag.rule,
        "text": flag.text,
        "first": flag.first + 1,
        "last": flag.last + 1,
        "seen_at": flag.seen_at + 1,
        "labels": list(labels[flag.first : flag.last + 1]),
    }


def _capability_json(found: Capability) -> dict[str, Any]:
    plain = {name: value for name, value in vars(found).items() if name != "specification"}
    indices = {
        name: None if plain[name] is None else vars(plain[name]) for name in ("cp", "cpk", "pp", "ppk")
    }
    return plain | indices | vars(found.specification)


def capable_words(found: Capability, stable: bool) -> str:
    """What the capability says, with its doubt."""
    index = found.ppk
    if index.low >= GOOD:
        word = "capable"
    elif index.value >= GOOD:
        word = "probably capable, but too few values to be sure"
    elif index.value >= POOR:
        word = "barely capable"
    else:
        word = "not capable"
    outside = f"{found.outside} of {found.count} outside"
    text = f"{word}: Ppk {index.value:.2f} ({index.low:.2f} to {index.high:.2f}), {outside}"
    return text if stable else text + "; of a process that is not stable this foretells nothing"


def control_study(
    name: str,
    values: FloatArray,
    labels: tuple[str, ...],
    settings: Settings,
    specification: Specification | None = None,
) -> ControlStudy:
    """Chart and judge a series.

    Args:
        name: of the number.
        values: (N,) in the order in which they were measured; NaN is missing.
        labels: N names of the values.
        settings: how.
        specification: limits of good parts.

    Raises:
        UsageError: too few values, or settings that make no sense.
    """
    limits = settings.limits(values)
    ranges = moving_range(values)
    wide = ranges > limits.range_upper
    average = ewma(values, limits, settings.weight, settings.width)
    found = flags(values, limits.center, limits.sigma)
    able = None if specification is None else capability(values, limits, specification)
    notes = tuple(_notes(values, ranges, limits))
    return ControlStudy(
        name, values, labels, limits, ranges, average, found, wide, able, anderson_darling(values), notes
    )


def _notes(values: FloatArray, ranges: FloatArray, limits: Limits) -> list[str]:
    missing, known = int(np.isnan(values).sum()), ranges[~np.isnan(ranges)]
    notes = []
    if missing:
        notes.append(f"{_times(missing, 'value')} missing; no moving range and no pattern reaches across")
    if limits.baseline == 0:
        notes.append("mean and sigma of the limits were given")
    elif limits.baseline < FEW:
        notes.append(f"the limits rest on {limits.baseline} values only; {FEW} or more are usual")
    still = int(np.count_nonzero(known == 0.0))
    if len(known) and still > 0.3 * len(known):
        notes.append(
            f"{still} of {len(known)} neighbours are equal: the number is rounded too coarsely for a chart, and its "
            "limits are too narrow or too wide"
        )
    return notes
