"""Light sources by their spectral power: CIE D65, A and the LED series, or a measured lamp.

The tables (5 nm, relative power) are those of CIE 015:2018 (D65 and A as in ISO/CIE 11664-2), taken from
colour-science 0.4.7 (BSD-3-Clause).
"""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.colour.tables import package_table

VISIBLE_NM = (380.0, 780.0)
NEEDED_NM = (400.0, 700.0)
"""What a measured spectrum has to cover; beyond its ends, up to the visible range, its end values are held."""


@dataclass(frozen=True)
class Illuminant:
    """A spectrum of light, linear between its points.

    Attributes:
        name: for people.
        wavelengths_nm: (N,) rising, any spacing.
        power: (N,) relative spectral power, 0 or more.

    Raises:
        ModelError: lengths that differ, wavelengths that do not rise or do not reach from 400 to 700 nm, power that is
            negative, not finite, or nothing but zero.
    """

    name: str
    wavelengths_nm: tuple[float, ...]
    power: tuple[float, ...]

    def __post_init__(self) -> None:
        steps = np.diff(self.wavelengths_nm)
        if len(self.wavelengths_nm) != len(self.power) or steps.size == 0:
            raise ModelError(
                f"illuminant {self.name}: it needs two wavelengths or more, and a power for each"
            )
        if not np.all((steps > 0.0) & np.isfinite(steps)):
            raise ModelError(f"illuminant {self.name}: its wavelengths must be finite and rise")
        first, last = self.wavelengths_nm[0], self.wavelengths_nm[-1]
        if first > NEEDED_NM[0] or last < NEEDED_NM[1]:
            raise ModelError(
                f"illuminant {self.name}: its spectrum reaches from {first:g} to {last:g} nm; "
                f"at least {NEEDED_NM[0]:g} to {NEEDED_NM[1]:g} nm are needed"
            )
        if not np.all(np.isfinite(self.power)) or min(self.power) < 0.0 or max(self.power) <= 0.0:
            raise ModelError(f"illuminant {self.name}: its power must be finite, 0 or more, and not all zero")

    def band_means(self, centres_nm: FloatArray, width_nm: float) -> FloatArray:
        """(M,) mean power over bands about ``centres_nm``, cut at the ends of the visible range.

        Exact for a spectrum that is linear between its points: narrow lines keep their power, wherever they fall.
        """
        low = np.maximum(np.asarray(centres_nm, dtype=np.float64) - 0.5 * width_nm, VISIBLE_NM[0])
        high = np.minimum(np.asarray(centres_nm, dtype=np.float64) + 0.5 * width_nm, VISIBLE_NM[1])
        grid = np.array(
            sorted({*self.wavelengths_nm, *low.flat, *high.flat})
        )  # np.union1d loads masked arrays
        power = np.interp(grid, self.wavelengths_nm, self.power)
        until = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(grid))])
        return np.asarray((np.interp(high, grid, until) - np.interp(low, grid, until)) / (high - low))


def standard_names() -> tuple[str, ...]:
    """Names of the illuminants that come with the package: d65, a, led-b1 …."""
    return package_table("anisoscope.sim.light.colour", "cie_illuminants.csv")[0][1:]


def standard(name: str) -> Illuminant:
    """A CIE illuminant by name; case does not matter.

    Raises:
        ModelError: no such illuminant; the message lists them.
    """
    columns, numbers = package_table("anisoscope.sim.light.colour", "cie_illuminants.csv")
    key = name.lower()
    if key not in columns[1:]:
        raise ModelError(f"no illuminant is named {name!r}; known: {', '.join(columns[1:])}")
    power = numbers[:, columns.index(key)]
    return Illuminant(key.upper(), tuple(numbers[:, 0].tolist()), tuple(power.tolist()))
