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
FAR = 7.0  # standard deviations: arrivals that stay as far below the full well never reach it
RARE = 0.5  # electrons; fewer arrivals a pixel are drawn as a whole and spread over the pixels
ROWS = 64


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
        counts: Counts = np.empty(signal_e.shape, dtype=np.uint16)
        for first in range(0, len(counts), ROWS):  # few rows at a time stay in the processor's cache
            rows = slice(first, first + ROWS)
            expected = signal_e[rows] * self._response[rows]
            expected += self._dark_e_s[rows] * exposure_s
            np.maximum(expected, 0.0, out=expected)
            signal = self._read(expected, self._offset_e[rows])
            signal *= gain / self.part.gain_e_per_dn
            bent = self._bent(signal)
            bent += self.part.black_level
            np.rint(bent, out=bent)
            np.clip(bent, 0, self.full_scale, out=bent)
            counts[rows] = bent
        return counts

    def _read(self, expected: FloatArray, offset: FloatArray) -> FloatArray:
        """Electrons that are read where these numbers are expected: arrivals up to the full well, and read noise."""
        part = self.part
        largest = float(expected.max())
        linear = part.nonlinearity == 0.0 and largest + FAR * largest**0.5 < part.full_well_e
        if linear and float(expected.min()) >= MANY:
            found = self._near_normal(expected, part.read_noise_e**2)
        else:
            found = self._arrivals(expected)
            np.minimum(found, part.full_well_e, out=found)
            if part.nonlinearity:
                found *= 1.0 - part.nonlinearity * found / part.full_well_e
            found += part.read_noise_e * self._rng.standard_normal(expected.shape)
        found += offset
        return found

    def _arrivals(self, expected: FloatArray) -> FloatArray:
        """Poisson numbers about ``expected``; from MANY on, numbers of the same mean, variance and skewness."""
        few = expected < MANY
        arrivals = np.empty(expected.shape)
        arrivals[few] = self._rare(expected[few])
        arrivals[~few] = self._near_normal(expected[~few], 0.0)
        return arrivals

    def _near_normal(self, expected: FloatArray, noise: float) -> FloatArray:
        """Poisson numbers λ from MANY on with normal noise of variance ν: λ + s z + λ (z² − 1) / (6 s²), s² = λ + ν.

        The Cornish-Fisher expansion of their sum: its mean, its skewness, and a variance larger by 1/18 at most.
        """
        normal = self._rng.standard_normal(expected.shape)
        variance = expected + noise
        found: FloatArray = np.sqrt(variance)
        found *= normal
        found += expected
        normal *= normal
        normal -= 1.0
        normal *= expected
        normal /= variance
        normal /= 6.0
        found += normal
        return found

    def _rare(self, expected: FloatArray) -> FloatArray:
        """Poisson numbers of (n,) pixels; what all pixels expect alike is drawn as one number and spread over them.

        A dark frame expects .1 electrons in all but its hot pixels. A sum of Poisson numbers is a Poisson number.
        """
        common = float(expected.min(initial=RARE))
        if common >= RARE:
            return self._rng.poisson(expected).astype(np.float64)
        struck = self._rng.integers(expected.size, size=self._rng.poisson(common * expected.size))
        arrivals: FloatArray = np.bincount(struck, minlength=expected.size).astype(np.float64)
        above = np.flatnonzero(expected > common)
        arrivals[above] += self._rng.poisson(expected[above] - common)
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

    def pick(self, channels: FloatArray) -> FloatArray:
        """(rows, cols) of an image of (1 or 3, rows, cols), every pixel from its own channel; one channel is grey."""
        if len(channels) == 1:
            return np.asarray(channels[0])
        picked: FloatArray = np.empty_like(channels[0])
        for row in (0, 1):
            for col in (0, 1):
                picked[row::2, col::2] = channels[self._tile[row, col], row::2, col::2]
        return picked
