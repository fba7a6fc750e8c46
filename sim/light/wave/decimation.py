"""The low-pass of the fused reflectance: a Kaiser window whose droop is undone after decimation.

Only what would fold into the pass band must be stopped, so that the filter may droop within it; the droop is divided
out where only few numbers are left. That halves the taps of a filter that is flat by itself.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray

Floats = npt.NDArray[np.float32]

STOP_DB = 80.0
RATE = 6.0
"""Samples after decimation in half a pass band; less decimation makes the filter shorter."""


@dataclass(frozen=True, eq=False)
class Decimation:
    """Low-pass and decimation along one axis.

    Attributes:
        count: points before.
        pixel_um: their distance in µm.
        step: points between two outputs; 1 leaves everything as it is.
        taps: (2·half + 1,) float32 filter of sum 1.
        pass_band: half-width of the pass band in cycles per µm.
    """

    count: int
    pixel_um: float
    step: int
    taps: Floats
    pass_band: float

    @property
    def outputs(self) -> int:
        """Points after."""
        half = self.taps.size // 2
        return half // self.step + (self.count - 1 + half) // self.step + 1

    def equaliser(self, frequency: FloatArray) -> FloatArray:
        """What (F,) frequencies in cycles per µm must be multiplied with: 1/H in the pass band, tapered to 0."""
        offset = (np.arange(self.taps.size) - self.taps.size // 2) * self.pixel_um
        response = np.cos(2.0 * np.pi * np.outer(frequency, offset)) @ self.taps.astype(np.float64)
        end = 0.5 / (self.step * self.pixel_um)
        share = np.clip((np.abs(frequency) - self.pass_band) / max(end - self.pass_band, 1e-12), 0.0, 1.0)
        taper = np.cos(0.5 * np.pi * share) ** 2
        return np.asarray(np.where(taper > 0.0, taper / np.maximum(response, 1e-3), 0.0))


def decimation(count: int, pixel_um: float, half_width: float) -> Decimation:
    """Decimation that keeps frequencies up to ``half_width`` cycles per µm."""
    pass_band = max(half_width, 2.0 / (count * pixel_um))
    step = min(int(1.0 / (RATE * pass_band * pixel_um)), max(count // 16, 1))
    if step < 2:
        return Decimation(count, pixel_um, 1, np.ones(1, dtype=np.float32), 0.5 / pixel_um)
    beta = 0.12438 * (STOP_DB + 6.3)
    stop = 1.0 / (step * pixel_um) - pass_band
    length = np.sqrt(np.pi**2 + beta**2) / (
        np.pi * stop * pixel_um
    )  # to the first null of the window's spectrum
    half = int(np.ceil(0.5 * length))
    taps = np.kaiser(2 * half + 1, beta)
    return Decimation(count, pixel_um, step, (taps / taps.sum()).astype(np.float32), pass_band)
