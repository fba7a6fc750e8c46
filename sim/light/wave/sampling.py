"""Random stepped surfaces: sampling processes 1 and 2 of Levin et al. 2013, along one axis and in two.

Heights are in µm at the middles of pixels; they hold for whole pixels (`WaveSurface.of(…, cells=True)`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError

IntArray = npt.NDArray[np.int64]

MIN_WIDTH_UM = 2.0
"""Smallest feature of optical lithography (Levin et al. 2013, section 5); electron beams write finer ones."""


@dataclass(frozen=True)
class Widths:
    """Distribution p_a of the widths of steps along one axis.

    Attributes:
        widths_um: widths in µm.
        probabilities: how often each is drawn; scaled to a sum of 1.
        min_width_um: smallest feature that can be made.

    Raises:
        ModelError: a width below the smallest feature, or probabilities that are none.
    """

    widths_um: tuple[float, ...]
    probabilities: tuple[float, ...] = (1.0,)
    min_width_um: float = MIN_WIDTH_UM

    def __post_init__(self) -> None:
        if not self.widths_um or len(self.widths_um) != len(self.probabilities):
            raise ModelError("every width of a step needs its probability")
        if min(self.widths_um) < self.min_width_um:
            raise ModelError(
                f"steps of {min(self.widths_um):g} µm are narrower than the smallest feature "
                f"of {self.min_width_um:g} µm"
            )
        if min(self.probabilities) < 0.0 or not 0.0 < sum(self.probabilities) < float("inf"):
            raise ModelError("the probabilities of widths must not be negative, and not all zero")

    @property
    def mean_um(self) -> float:
        """E[a] in µm."""
        return float(np.dot(self.widths_um, self.probabilities) / sum(self.probabilities))

    def cells(self, count: int, pixel_um: float, rng: np.random.Generator) -> IntArray:
        """(count,) number of the step that each pixel belongs to; the first step starts anywhere within itself."""
        total = count * pixel_um + max(self.widths_um)
        shares = np.asarray(self.probabilities) / sum(self.probabilities)
        draws = int(np.ceil(1.5 * total / self.mean_um)) + 16
        edges = np.cumsum(rng.choice(self.widths_um, draws, p=shares))
        while edges[-1] < total:
            edges = np.append(edges, edges[-1] + np.cumsum(rng.choice(self.widths_um, draws, p=shares)))
        middle = (np.arange(count) + 0.5) * pixel_um
        return np.searchsorted(edges, middle, side="right").astype(np.int64)


def steps_profile(
    widths: Widths, levels_um: Sequence[float], count: int, pixel_um: float, rng: np.random.Generator
) -> FloatArray:
    """(count,) heights of sampling process 1 along one axis: widths ~ p_a, then a level for each, equally likely."""
    cells = widths.cells(count, pixel_um, rng)
    return rng.choice(np.asarray(levels_um, dtype=np.float64), int(cells[-1]) + 1)[cells]


def steps_map(
    widths_x: Widths,
    widths_y: Widths,
    levels_um: Sequence[float],
    shape: tuple[int, int],
    pixel_um: float,
    rng: np.random.Generator,
) -> FloatArray:
    """(rows, cols) heights of sampling process 1 in two: the outer product of two sequences, a level each rectangle."""
    rows, cols = widths_y.cells(shape[0], pixel_um, rng), widths_x.cells(shape[1], pixel_um, rng)
    levels = rng.choice(np.asarray(levels_um, dtype=np.float64), (int(rows[-1]) + 1, int(cols[-1]) + 1))
    return levels[np.ix_(rows, cols)]


def permuted_profile(
    levels_um: Sequence[float], width_um: float, count: int, pixel_um: float, rng: np.random.Generator
) -> FloatArray:
    """(count,) heights of sampling process 2: after each other all m levels in random order, steps of equal width.

    Raises:
        ModelError: fewer than two levels, or a width that is not whole pixels.
    """
    step = _pixels(width_um, pixel_um)
    blocks = _blocks(levels_um, -(-count // (step * len(levels_um))), rng)
    return np.repeat(blocks.ravel(), step)[:count]


def permuted_map(
    levels_um: Sequence[float],
    arrangement: tuple[int, int],
    widths_um: tuple[float, float],
    shape: tuple[int, int],
    pixel_um: float,
    rng: np.random.Generator,
) -> FloatArray:
    """(rows, cols) heights of sampling process 2 in blocks of m_x × m_y rectangles a0x × a0y, all given (x, y).

    Raises:
        ModelError: an arrangement that does not hold all levels once, or widths that are not whole pixels.
    """
    many_x, many_y = arrangement
    if many_x * many_y != len(levels_um):
        raise ModelError(f"{many_x} × {many_y} rectangles do not hold {len(levels_um)} levels once each")
    step_x, step_y = (_pixels(width, pixel_um) for width in widths_um)
    down, over = -(-shape[0] // (step_y * many_y)), -(-shape[1] // (step_x * many_x))
    blocks = _blocks(levels_um, down * over, rng).reshape(down, over, many_y, many_x)
    cells = blocks.transpose(0, 2, 1, 3).reshape(down * many_y, over * many_x)
    return np.repeat(np.repeat(cells, step_y, axis=0), step_x, axis=1)[: shape[0], : shape[1]]


def crossed_map(profile_x_um: FloatArray, profile_y_um: FloatArray) -> FloatArray:
    """(rows, cols) heights whose wave is the product of those of two profiles: heights add."""
    return np.add.outer(profile_y_um, profile_x_um)


def _pixels(width_um: float, pixel_um: float) -> int:
    step = round(width_um / pixel_um)
    if step < 1 or abs(step * pixel_um - width_um) > 1e-6 * width_um:
        raise ModelError(f"steps of {width_um:g} µm are not whole pixels of {pixel_um:g} µm")
    return step


def _blocks(levels_um: Sequence[float], count: int, rng: np.random.Generator) -> FloatArray:
    """(count, m) random orders of the levels."""
    if len(levels_um) < 2:
        raise ModelError("sampling process 2 needs two levels or more")
    return rng.permuted(np.tile(np.asarray(levels_um, dtype=np.float64), (count, 1)), axis=1)
