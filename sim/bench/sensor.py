"""An image sensor after the linear model of EMVA 1288: photons to counts, with its noise and its flaws.

Colour filters before the sensor: from channels of radiance to what every pixel sees through its own filter.
"""

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.rig.bayer import channel_of_pixels
from anisoscope.sim.bench.benchfile import SensorPart

Counts = npt.NDArray[np.uint16]

AUTOMATIC_LEVEL = 0.4
MANY = 25.0  # electrons; below it Poisson numbers are drawn as such, which takes four times as long


class Sensor:
    """One sensor with its fixed pattern drawn once from ``rng``."""

    def __init__(self, part: SensorPart, rng: np.random.Generator) -> None:
        self.part = part
        self._rng = rng
        shape = (part.rows, part.cols)
        self._response = 1.0 + part.prnu * rng.standard_normal(shape)
        self._offset_e = part.dsnu_e * rng.standard_normal(shape)
        self._dark_e_s = np.full(shape, part.dark_current_e_s)
        hot = rng.random(shape) < part.hot_pixel_share
        self._dark_e_s[hot] *= 2000.0

    @property
    def full_scale(self) -> int:
        """Largest count."""
        return int(2**self.part.bit_depth - 1)

    def expose(self, signal_e: FloatArray, exposure_s: float, gain: float) -> Counts:
        """Counts of one frame.

        Args:
            signal_e: (rows, cols) expected photo-electrons of a perfect sensor.
            exposure_s: exposure in seconds.
            gain: amplification, 1 is the sensor's native gain.

        Returns:
            (rows, cols) counts, right-justified.
        """
        expected = signal_e * self._response
        noise = self._dark_e_s * exposure_s
        expected += noise
        np.maximum(expected, 0.0, out=expected)
        collected = self._arrivals(expected)
        np.minimum(collected, self.part.full_well_e, out=collected)
        if self.part.nonlinearity:
            collected *= 1.0 - self.part.nonlinearity * collected / self.part.full_well_e
        self._rng.standard_normal(out=noise)
        noise *= self.part.read_noise_e
        noise += self._offset_e
        collected += noise
        collected *= gain
        collected /= self.part.gain_e_per_dn
        counts = self._bent(collected)
        counts += self.part.black_level
        np.rint(counts, out=counts)
        np.clip(counts, 0, self.full_scale, out=counts)
        return counts.astype(np.uint16)

    def _arrivals(self, expected: FloatArray) -> FloatArray:
        """Poisson numbers about ``expected``; from MANY on, their Cornish-Fisher expansion: λ + √λ z + (z² − 1) / 6.

        It has the mean and the skewness of a Poisson number, and a variance that is larger by 1/18.
        """
        few = expected < MANY
        if few.all():
            return self._rng.poisson(expected).astype(np.float64)
        normal = self._rng.standard_normal(expected.shape)
        arrivals: FloatArray = np.sqrt(expected)
        arrivals *= normal
        arrivals += expected
        normal *= normal
        normal -= 1.0
        normal /= 6.0
        arrivals += normal
        if few.any():
            arrivals[few] = self._rng.poisson(expected[few])
        return arrivals

    def automatic_exposure_s(self, signal_e: FloatArray) -> float:
        """Exposure at which the middle tone is 40 % of full scale, for (rows, cols) photo-electrons in one second."""
        target_e = (
            AUTOMATIC_LEVEL**self.part.gamma
            * (self.full_scale - self.part.black_level)
            * self.part.gain_e_per_dn
        )
        return float(np.clip(target_e / max(float(signal_e.mean()), 1e-9), 1e-5, 1.0))

    def _bent(self, signal: FloatArray) -> FloatArray:
        """Counts above black after the camera's gamma curve; noise below black stays as it is."""
        if self.part.gamma == 1.0:
            return signal
        top = self.full_scale - self.part.black_level
        return np.where(
            signal > 0.0, top * (np.maximum(signal, 0.0) / top) ** (1.0 / self.part.gamma), signal
        )


Image = npt.NDArray[np.float32]


class Mosaic:
    """The filters of a sensor.

    Args:
        part: the sensor.
        strengths: (1 or 3,) share of white light that counts behind each kind of filter; 1 behind the strongest.

    Attributes:
        passed: (rows, cols) share of white light that counts in each pixel.
    """

    def __init__(self, part: SensorPart, strengths: FloatArray) -> None:
        self._tile = channel_of_pixels(part.filters, (2, 2))
        self.passed: FloatArray = strengths[channel_of_pixels(part.filters, (part.rows, part.cols))]

    def pick(self, channels: Image) -> Image:
        """(rows, cols) of an image of (1 or 3, rows, cols), every pixel from its own channel; one channel is grey."""
        if len(channels) == 1:
            return np.asarray(channels[0])
        picked: Image = np.empty_like(channels[0])
        for row in (0, 1):
            for col in (0, 1):
                picked[row::2, col::2] = channels[self._tile[row, col], row::2, col::2]
        return picked
