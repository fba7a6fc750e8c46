"""Limits of measured parameters, read from a TOML file, and the PASS/FAIL sheet.

A file holds a table for every parameter: ``[Sa]`` with ``min``, ``max`` or both, in the unit of the parameter's table.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Literal

from anisoscope.base.errors import ConfigError, HeightMapError
from anisoscope.base.toml_table import read_toml


@dataclass(frozen=True)
class Limit:
    """Bounds of one parameter; None where there is none."""

    low: float | None
    high: float | None


@dataclass(frozen=True)
class Judged:
    """One line of the sheet.

    Attributes:
        name: the parameter.
        value: as measured; NaN where it has none.
        unit: of the parameter.
        low: least value allowed.
        high: greatest value allowed.
        verdict: PASS within the limits, ends included; FAIL beyond them or without a value.
    """

    name: str
    value: float
    unit: str
    low: float | None
    high: float | None
    verdict: Literal["PASS", "FAIL"]


class LimitsError(ConfigError):
    """A file of limits that cannot be used."""


def read_limits(path: Path) -> dict[str, Limit]:
    """Limits by parameter.

    Raises:
        LimitsError: not readable, no limits, or a table with anything but min ≤ max.
    """
    found: dict[str, Limit] = {}
    for name, table in read_toml(path, LimitsError).items():
        if not isinstance(table, dict) or not table or set(table) - {"min", "max"}:
            raise LimitsError(f"{path}: [{name}] takes min, max or both, such as max = 0.4")
        bounds = [table.get("min"), table.get("max")]
        for bound in bounds:
            if bound is not None and (
                isinstance(bound, bool) or not isinstance(bound, int | float) or not isfinite(bound)
            ):
                raise LimitsError(f"{path}: [{name}] takes finite numbers, not {bound!r}")
        low, high = (None if bound is None else float(bound) for bound in bounds)
        if low is not None and high is not None and low > high:
            raise LimitsError(f"{path}: [{name}]: min {low:g} is above max {high:g}")
        found[name] = Limit(low, high)
    if not found:
        raise LimitsError(f"{path}: no limits; give a table such as [Sa] with max = 0.4")
    return found


def sheet_of(path: Path | None, values: Mapping[str, tuple[float, str]]) -> tuple[Judged, ...]:
    """The sheet of a file of limits; empty without one.

    Raises:
        LimitsError: the file cannot be used.
        HeightMapError: a limit of a parameter that was not measured.
    """
    return () if path is None else judge(read_limits(path), values)


def judge(limits: Mapping[str, Limit], values: Mapping[str, tuple[float, str]]) -> tuple[Judged, ...]:
    """The sheet: every limit against its parameter.

    Args:
        limits: by parameter.
        values: value and unit by parameter.

    Raises:
        HeightMapError: a limit of a parameter that was not measured.
    """
    sheet = []
    for name, limit in limits.items():
        if name not in values:
            raise HeightMapError(f"limits: {name} was not measured; there are {', '.join(values)}")
        value, unit = values[name]
        good = isfinite(value) and (limit.low is None or value >= limit.low)
        good = good and (limit.high is None or value <= limit.high)
        sheet.append(Judged(name, value, unit, limit.low, limit.high, "PASS" if good else "FAIL"))
    return tuple(sheet)
