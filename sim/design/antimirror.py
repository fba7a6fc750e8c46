"""Surfaces that reflect everywhere but in the mirror direction: sampling process 2 and all its arrangements.

Blocks of m_x × m_y rectangles carry every level equally often in random order, so that each block has a zero mean: the
spectrum has a hole of 1/(m_x·a0x) by 1/(m_y·a0y). Crossed, both axes have sequences of their own: the hole is a cross.
Source: Levin et al. 2013, section 3.2 and Fig. 7.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.wave.claims import anti_mirror, anti_mirror_2d, crossed
from anisoscope.sim.light.wave.sampling import MIN_WIDTH_UM

Labels = npt.NDArray[np.uint16]
Integers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class AntiMirror:
    """An anti-mirror.

    Attributes:
        arrangement: (m_x, m_y) rectangles in a block; crossed: steps in a block along x and along y.
        widths_um: (a0x, a0y) in µm.
        levels: K levels of equal share, with a zero mean phase.
        crossed: an outer product of two sequences instead of blocks.
        min_width_um: smallest feature.

    Raises:
        ModelError: steps narrower than the smallest feature, or a block that does not hold all levels equally often.
    """

    arrangement: tuple[int, int]
    widths_um: tuple[float, float]
    levels: int = 2
    crossed: bool = False
    min_width_um: float = MIN_WIDTH_UM

    def __post_init__(self) -> None:
        if min(self.widths_um) < self.min_width_um - 1e-9:
            raise ModelError(
                f"steps of {min(self.widths_um):g} µm are narrower than the smallest feature of {self.min_width_um:g} "
                "µm: take wider steps, or a smaller --min-width (electron beams)"
            )
        if self.levels < 2 or min(self.arrangement) < 1:
            raise ModelError("an anti-mirror needs two levels or more, and one step or more along each axis")
        many_x, many_y = self.arrangement
        if self.crossed and (many_x % self.levels or many_y % self.levels):
            raise ModelError(
                f"sequences of {many_x} and {many_y} steps do not hold {self.levels} levels equally often: take "
                f"multiples of {self.levels} along both axes"
            )
        if not self.crossed and (many_x * many_y) % self.levels:
            raise ModelError(
                f"blocks of {many_x} × {many_y} steps do not hold {self.levels} levels equally often: take an "
                f"arrangement whose product is a multiple of {self.levels}"
            )

    def density(self, frequency_x: FloatArray, frequency_y: FloatArray, coherence_um: float) -> FloatArray:
        """(Y, X) density in µm² (blurred, corrected claim 2); frequencies ω = 2h/λ in cycles per µm."""
        if not self.crossed:
            return anti_mirror_2d(frequency_x, frequency_y, self.arrangement, self.widths_um, coherence_um)
        (many_x, many_y), (wide_x, wide_y) = self.arrangement, self.widths_um
        return crossed(
            anti_mirror(frequency_x, many_x, wide_x, coherence_um),
            anti_mirror(frequency_y, many_y, wide_y, coherence_um),
        )

    def hole(self, wavelength_um: float) -> tuple[float, float]:
        """Full width of the hole along h_x and h_y, 1/(m·a0) in frequency; infinite where one step spans the block."""
        x, y = (
            wavelength_um / (2.0 * many * width) if many > 1 else float("inf")
            for many, width in zip(self.arrangement, self.widths_um, strict=True)
        )
        return x, y

    def ring(self, wavelength_um: float) -> tuple[float, float]:
        """First zeros of the ring along h_x and h_y: λ/(2·a0)."""
        x, y = (wavelength_um / (2.0 * width) for width in self.widths_um)
        return x, y

    def floor(self, wavelength_um: float, coherence_um: float) -> float:
        """Density in the mirror direction over the largest: the hole that the source leaves open."""
        wide = 2.0 / wavelength_um * max(self.ring(wavelength_um))
        f = np.linspace(0.0, wide, 161)
        found = self.density(f, f, coherence_um)
        return float(found[0, 0] / found.max())

    def folds(self, tau: float) -> bool:
        """Whether a crossed surface needs one set of passes only: two half-wave steps, up and down, are one surface."""
        return self.crossed and self.levels == 2 and tau < 1e-3

    def labels(
        self, shape: tuple[int, int], grid_um: float, folded: bool, rng: np.random.Generator
    ) -> Labels:
        """(rows, cols) number of the level of every grid point of a dot that begins and ends with whole steps.

        What the blocks leave over of the dot is given to the steps of some of them, a grid step each. Crossed and not
        folded, the bits of the level along y stand above those along x.
        """
        (many_x, many_y), (wide_x, wide_y) = self.arrangement, self.widths_um
        x, y = (
            _steps(shape[1], wide_x / grid_um, many_x, rng),
            _steps(shape[0], wide_y / grid_um, many_y, rng),
        )
        if self.crossed:
            bits = self.levels.bit_length() - 1
            along_x = np.repeat(self._orders(x.size // many_x, many_x, rng).ravel(), x)
            along_y = np.repeat(self._orders(y.size // many_y, many_y, rng).ravel(), y)
            if folded:
                return np.asarray(np.bitwise_xor.outer(along_y, along_x), dtype=np.uint16)
            return np.asarray(np.bitwise_or.outer(along_y << bits, along_x), dtype=np.uint16)
        down, over = y.size // many_y, x.size // many_x
        blocks = self._orders(down * over, many_x * many_y, rng).reshape(down, over, many_y, many_x)
        cells = blocks.transpose(0, 2, 1, 3).reshape(y.size, x.size)
        return np.asarray(np.repeat(np.repeat(cells, y, axis=0), x, axis=1), dtype=np.uint16)

    def _orders(self, count: int, many: int, rng: np.random.Generator) -> Integers:
        """(count, many) random orders with every level equally often."""
        row = np.arange(many) % self.levels
        return rng.permuted(np.tile(row, (count, 1)), axis=1)


def _steps(points: int, width: float, many: int, rng: np.random.Generator) -> Integers:
    """Widths of steps in grid points: whole blocks of ``many`` steps that fill ``points``."""
    step = round(width)
    if step < 1 or abs(step - width) > 1e-6 * width:
        raise ModelError(f"steps of {width:g} grid points are no whole number of them: take a finer --grid")
    blocks = points // (step * many)
    if blocks < 1:
        raise ModelError(
            f"a dot of {points} grid points holds no block of {many} steps of {step}: take a larger --dot"
        )
    found = np.full((blocks, many), step, dtype=np.int64)
    rest = points - blocks * step * many
    everywhere, rest = divmod(rest, blocks * many)
    found += everywhere
    whole, rest = divmod(rest, many)
    found[rng.permutation(blocks)[:whole]] += 1
    found[rng.integers(blocks), rng.permutation(many)[:rest]] += 1
    return found.ravel()
