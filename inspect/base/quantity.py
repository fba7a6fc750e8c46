"""Numbers with a unit as people write them: ``10``, ``10.5``, ``10,5``, ``0.1 mm``, ``10°``, ``5 %``."""

import math
import re
from dataclasses import dataclass

UNITS = {
    "um": {"nm": 1e-3, "um": 1.0, "µm": 1.0, "μm": 1.0, "mm": 1e3, "cm": 1e4},
    "nm": {"nm": 1.0, "um": 1e3, "µm": 1e3, "μm": 1e3, "mm": 1e6},
    "mm": {"um": 1e-3, "µm": 1e-3, "μm": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1e3},
    "deg": {"deg": 1.0, "°": 1.0, "rad": 180.0 / math.pi, "mrad": 0.18 / math.pi},
    "s": {"us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0},
    "share": {"%": 0.01, "": 1.0},
}
"""Unit of a name's end -> factors of what may be written after the number."""
SIGNS = {"um": "µm", "deg": "°", "share": ""}
_NUMBER = re.compile(r"\s*([-+−]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?)\s*([^\s\d]*)\s*")


@dataclass(frozen=True)
class Likely:
    """Likely range of a length: a number without a unit beyond it may have been meant in a larger or smaller one.

    Attributes:
        low: smallest likely value, in the unit of the parameter.
        high: largest likely value.
        noun: the plural of what has the length.
        firm: nothing beyond the range is taken, whatever unit is written.
    """

    low: float
    high: float
    noun: str
    firm: bool = False

    def check(self, value: float, name: str, unit: str, written: str = "") -> float:
        """The value, where it may be meant; arguments as of `read_number`, and the unit that was written.

        Raises:
            ValueError: one line that asks which unit was meant, or gives the range.
        """
        if value <= 0.0 or self.low <= value <= self.high:
            return value
        own, factor = SIGNS.get(unit, unit), 1e3 if value < self.low else 1e-3
        others = [one for one, of in UNITS[unit].items() if math.isclose(of, factor)]
        may_be = self.low <= factor * value <= self.high or (value < self.low and not self.firm)
        limits = f"{self.noun} have {self.low:g} to {self.high:g} {own}"
        if others and may_be and not written:
            other = SIGNS.get(others[0], others[0])
            rest = limits if self.firm else f"if {value:g} {own} is meant, write {value:g}{unit}"
            raise ValueError(
                f"{name} {value:g} {own}? {self.noun} of {value:g} {other} are {name} {factor * value:g} (or write "
                f"{value:g}{others[0]}); {rest}"
            )
        if self.firm:
            raise ValueError(f"{name} {value:g} {own}? {limits}: check the number and its unit")
        return value


def unit_of(name: str) -> str:
    """Unit at the end of a parameter's name, such as "um" of ``pitch_um``; empty without one."""
    end = name.rpartition("_")[2]
    return end if end in UNITS else ""


def read_number(text: str, name: str, unit: str = "", likely: Likely | None = None) -> float:
    """A number, in the unit of its parameter.

    Args:
        text: as it was written; a decimal comma and a unit of the same kind are read.
        name: option or key as the user wrote it, for the message.
        unit: the parameter's own, a key of `UNITS`; empty takes plain numbers only.
        likely: range beyond which a number without a unit is asked about.

    Raises:
        ValueError: one line that says what is wrong and how to write it.
    """
    found = _NUMBER.fullmatch(text)
    units = UNITS.get(unit, {"": 1.0})
    if found is None:
        kind = f"a number of {SIGNS.get(unit, unit)}" if SIGNS.get(unit, unit) else "a number"
        raise ValueError(f"{name} takes {kind}, not {text!r}")
    value, written = float(found[1].replace(",", ".").replace("−", "-")), found[2]
    if written:
        if written not in units:
            known = ", ".join(one for one in units if one)
            raise ValueError(
                f"{name} {text}: {written!r} is no unit of it; "
                + (f"it takes {known}" if known else "leave it out")
            )
        value *= units[written]
    return value if likely is None else likely.check(value, name, unit, written)
