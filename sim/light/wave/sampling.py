"""Random stepped surfaces: sampling process 1 of Levin et al. 2013, along one axis.

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
