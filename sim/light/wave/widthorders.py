"""Orders of a tile whose features are a little wider or narrower, without drawing them anew.

Where an edge moves by δ, the Fourier coefficients of its level's area change by the integral of exp(−2πi·f·x) over δ:
smooth, and next to a parabola as long as 2π·f·δ is small. Corners that touch or part make it another parabola for wider
features than for narrower ones. Of three widths each parabola is known, and a direction costs as little as at the
width of the design.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.light.wave.halfvectors import HalfVector
from anisoscope.sim.light.wave.orders import Orders, level_phases
from anisoscope.sim.light.wave.windows import Window


@dataclass(frozen=True, eq=False)
class WidthOrders:
    """Orders of a tile at any width near the one it was designed with.

    Attributes:
        narrower: orders with (3K, Y, X) spectra: those of the design, and their change with the first and the second
            power of the share, for shares below 0.
        wider: likewise for shares above 0.
        share: of the step between widths that were drawn: the width that is set.
    """

    narrower: Orders
    wider: Orders
    share: float = 0.0

    @classmethod
    def of(cls, at: Callable[[float], Orders]) -> Self:
        """From the orders at the shares −1, −½, 0, ½ and 1, of one tile with one reach."""
        middle = at(0.0)
        below, above = (_parabola(middle, at(0.5 * side), at(side), side) for side in (-1.0, 1.0))
        return cls(below, above)

    def at(self, share: float) -> Self:
        """At another width."""
        return replace(self, share=share)

    def density(self, levels_um: FloatArray, half: HalfVector, wavelength_um: float, window: Window) -> float:
        """As `Orders.density`, of the width that is set."""
        phases = level_phases(levels_um, wavelength_um, half.z)
        powers = np.array([1.0, self.share, self.share**2])
        terms = self.narrower if self.share < 0.0 else self.wider
        return terms.blurred(np.outer(powers, phases).ravel(), half, wavelength_um, window)


def _parabola(middle: Orders, near: Orders, far: Orders, side: float) -> Orders:
    """Terms in powers of the share, through the shares 0, half of ``side`` and ``side``."""
    half, whole = near.spectra - middle.spectra, far.spectra - middle.spectra
    first, second = (4.0 * half - whole) * side, 2.0 * whole - 4.0 * half
    terms = np.concatenate([middle.spectra, first, second]).astype(np.complex64)
    return replace(middle, spectra=terms)
