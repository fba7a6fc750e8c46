"""Fold a ridged map onto one pitch: the median shape of its ridges."""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.heightmap import HeightMap

MAX_BINS = 2048


@dataclass(frozen=True)
class Folded:
    """The median ridge.

    Attributes:
        phase: (rows, cols) position of every point across its ridge, 0 to 1 of the pitch.
        position: (bins,) mean phase of the points in each bin, rising.
        height_um: (bins,) median height of the points in each bin.
    """

    phase: FloatArray
    position: FloatArray
    height_um: FloatArray

    def at(self, phase: FloatArray) -> FloatArray:
        """Height of the median ridge in µm at phases, interpolated between the bins."""
        return np.interp(phase, self.position, self.height_um, period=1.0)


def fold(surface: HeightMap, pitch_um: float, direction_deg: float = 0.0) -> Folded:
    """Median height by position across the ridges; bins are about a pixel wide.

    Args:
        surface: (rows, cols) heights in µm, NaN where missing.
        pitch_um: distance of neighbouring ridges.
        direction_deg: direction of the ridges, counter-clockwise from +y.
    """
    rows, cols = surface.shape
    angle = np.radians(direction_deg)
    x, y = np.arange(cols) * surface.pixel_x_um, np.arange(rows) * surface.pixel_y_um
    across = np.add.outer(y * np.sin(angle), x * np.cos(angle)) / pitch_um
    phase = np.mod(across + 1e-9, 1.0)
    pixel = min(
        surface.pixel_x_um / max(abs(np.cos(angle)), 1e-9), surface.pixel_y_um / max(abs(np.sin(angle)), 1e-9)
    )
    bins = int(np.clip(np.floor(pitch_um / pixel + 1e-6), 4, MAX_BINS))
    known = np.isfinite(surface.height_um)
    p, z = phase[known], surface.height_um[known]
    index = np.minimum((p * bins).astype(np.intp), bins - 1)
    count = np.bincount(index, minlength=bins)
    filled = np.flatnonzero(count)
    position = np.bincount(index, p, minlength=bins)[filled] / count[filled]
    z = z[np.argsort(index.astype(np.uint16), kind="stable")]  # few short numbers: sorted by their digits
    medians = [_median(part) for part in np.split(z, np.cumsum(count[filled])[:-1])]
    return Folded(phase, position, np.array(medians))


def _median(values: FloatArray) -> float:
    """Of finite values, which it reorders."""
    low, high = (values.size - 1) // 2, values.size // 2
    values.partition((low, high))
    return 0.5 * float(values[low] + values[high])
