"""Colour filters before the sensor: from channels of radiance to what every pixel sees through its own filter."""

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.rig.bayer import channel_of_pixels
from anisoscope.sim.bench.benchfile import SensorPart

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
