"""From raw counts to radiance: dark, flat and white reference, with the noise that the frames show.

Pictures are worked on in blocks of rows that fit into a core's cache, because passes over whole ones wait for memory.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.errors import CalibrationError
from anisoscope.rig.frame import Frame

Image = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

SATURATION_SHARE = 0.98
HOT_PIXEL_SIGMA = 12.0
_BLOCK_BYTES = 1 << 18
_SAMPLE_SIZE = 1 << 18


def _blocks(shape: tuple[int, ...]) -> Iterator[slice]:
    """Rows that make blocks of a quarter of a megabyte in single precision."""
    rows = max(1, _BLOCK_BYTES // (4 * max(shape[1], 1)))
    for start in range(0, shape[0], rows):
        yield slice(start, start + rows)


def _middle(image: Image) -> float:
    """Median of a picture; of a large one, of every n-th pixel."""
    step = max(1, int(np.sqrt(image.size / _SAMPLE_SIZE)))
    return float(np.median(image[::step, ::step]))


@dataclass(frozen=True, eq=False)
class Stack:
    """Frames of one pose put together.

    Attributes:
        mean: (rows, cols) mean counts.
        frames: how many frames it is the mean of.
        noise: (rows, cols) standard deviation of one frame about the mean of the frames, in counts.
        saturated: (rows, cols) True where any frame reached full scale.
        exposure_s: exposure of every frame.
        gain: gain of every frame.
        flicker: standard deviation of one frame's mean over the picture, counts: what all pixels share.
    """

    mean: Image
    frames: int
    noise: Image
    saturated: Mask
    exposure_s: float
    gain: float
    flicker: float = 0.0

    @cached_property
    def hot(self) -> Mask:
        """Pixels whose signal stands out by more than 12 robust standard deviations: in the dark, hot ones."""
        middle = _middle(self.mean)
        spread = 1.4826 * _middle(np.abs(self.mean - np.float32(middle))) + 0.5
        reach = np.float32(HOT_PIXEL_SIGMA * spread)
        return np.asarray((self.mean > middle + reach) | (self.mean < middle - reach))


def stack(frames: Iterable[Frame]) -> Stack:
    """Mean and noise of frames taken alike.

    Raises:
        CalibrationError: the frames differ in size, exposure or gain, or there are none.
    """
    frames = list(frames)
    if not frames:
        raise CalibrationError("no frames to average")
    first = frames[0]
    for frame in frames:
        if (frame.counts.shape, frame.exposure_s, frame.gain) != (
            first.counts.shape,
            first.exposure_s,
            first.gain,
        ):
            raise CalibrationError("frames of one pose differ in size, exposure or gain: take them again")
    shape = first.counts.shape
    mean, noise = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
    for rows in _blocks(shape):
        _mean_and_noise([frame.counts[rows] for frame in frames], mean[rows], noise[rows])
    saturated = np.zeros(shape, dtype=bool)
    for frame in frames:
        limit = np.ceil(SATURATION_SHARE * frame.full_scale)
        if frame.counts.max(initial=0) >= limit:
            saturated |= frame.counts >= frame.counts.dtype.type(limit)
    means = [cv2.mean(frame.counts)[0] for frame in frames]
    flicker = float(np.std(means, ddof=1)) if len(frames) > 1 else 0.0
    return Stack(mean, len(frames), noise, saturated, first.exposure_s, first.gain, flicker)


def _mean_and_noise(counts: list[npt.NDArray[np.uint16]], mean: Image, noise: Image) -> None:
    """Mean and standard deviation of counts, from their differences to the first: small ones, so nothing cancels."""
    count = len(counts)
    mean[:] = counts[0]
    if count == 1:
        noise[:] = 0.0
        return
    total, squares = np.zeros_like(mean), np.zeros_like(mean)
    for later in counts[1:]:
        off = later.astype(np.float32)
        off -= counts[0]
        total += off
        np.multiply(off, off, out=off)
        squares += off
    total *= np.float32(1.0 / count)
    mean += total
    np.multiply(total, total, out=total)
    total *= np.float32(count)
    squares -= total
    np.maximum(squares, 0.0, out=squares)
    squares *= np.float32(1.0 / (count - 1))
    np.sqrt(squares, out=noise)


@dataclass(frozen=True, eq=False)
class WhiteReference:
    """A flat frame of a white tile: it fixes the picture's shading and the scale of radiance.

    Attributes:
        signal: (rows, cols) counts per second at unit gain, dark subtracted.
        radiance: what a perfect measurement of the tile would give, in 1/sr: ρ·cos θl/π.
        camera: serial number of the camera it was taken with.
        taken_at: UTC time.
        reflectance: reflectance of the tile.
        sha256: hash of the file.
    """

    signal: Image
    radiance: float
    camera: str
    taken_at: str
    reflectance: float
    sha256: str

    @cached_property
    def unlit(self) -> Mask:
        """Pixels that the flat shows next to no light in."""
        return np.asarray(self.signal <= np.float32(0.05 * _middle(self.signal)))

    @cached_property
    def radiance_per_signal(self) -> Image:
        """(rows, cols) radiance of one count per second at unit gain; anything where there is no light."""
        return np.asarray(np.float32(self.radiance) / np.where(self.unlit, np.float32(1.0), self.signal))


@dataclass(frozen=True, eq=False)
class RadianceImage:
    """A linear picture in radiance per unit irradiance [1/sr].

    Attributes:
        value: (rows, cols); NaN where the pixel is unusable (hot, or saturated).
        noise: (rows, cols) standard deviation of one pixel of the mean picture; NaN where there is no value.
        saturated: (rows, cols) True where a pixel reached full scale in any frame.
        signal_share: 99th percentile of the dark-corrected signal, as a share of full scale.
        flicker: relative standard deviation of the light from one frame to the next, common to all pixels.
        frames: how many frames were averaged.
    """

    value: Image
    noise: Image
    saturated: Mask
    signal_share: float
    flicker: float = 0.0
    frames: int = 1

    @cached_property
    def usable(self) -> Mask:
        """Pixels that carry a value."""
        return np.isfinite(self.value)


def hot_pixels(dark: Stack) -> Mask:
    """Pixels whose dark signal stands out by more than 12 robust standard deviations."""
    return dark.hot


def check_size(white: WhiteReference, shape: tuple[int, ...]) -> None:
    """Does the white reference fit frames of this (rows, cols) shape?

    Raises:
        CalibrationError: it does not.
    """
    if white.signal.shape != shape:
        raise CalibrationError(
            f"the flat has {' × '.join(map(str, white.signal.shape[::-1]))} pixels, the frames "
            f"{' × '.join(map(str, shape[::-1]))}: take a new flat with this camera"
        )


def linearise(sample: Stack, dark: Stack, white: WhiteReference, full_scale: int) -> RadianceImage:
    """(raw − dark)/(flat − dark), scaled to radiance by the white tile.

    Args:
        sample: frames of the part in one pose.
        dark: frames with the light off, taken alike.
        white: the white reference.
        full_scale: largest count of the camera.

    Raises:
        CalibrationError: dark frames or white reference do not fit the frames.
    """
    if (dark.exposure_s, dark.gain) != (sample.exposure_s, sample.gain):
        raise CalibrationError(
            "dark frames and sample frames differ in exposure or gain: take the dark frames again"
        )
    if dark.mean.shape != sample.mean.shape:
        raise CalibrationError("dark frames and sample frames differ in size: take the dark frames again")
    check_size(white, sample.mean.shape)
    unusable = white.unlit | dark.hot | sample.saturated
    value, noise = np.empty_like(sample.mean), np.empty_like(sample.mean)
    per_second = np.float32(1.0 / (sample.exposure_s * sample.gain))
    light = 0.0
    for rows in _blocks(value.shape):
        scale = white.radiance_per_signal[rows] * per_second
        signal = np.subtract(sample.mean[rows], dark.mean[rows], out=value[rows])
        light += cv2.sumElems(signal)[0]
        signal *= scale
        spread = np.multiply(sample.noise[rows], sample.noise[rows], out=noise[rows])
        spread *= np.float32(1.0 / sample.frames)
        spread += np.square(dark.noise[rows]) * np.float32(1.0 / dark.frames)
        np.sqrt(spread, out=spread)
        spread *= scale
        if unusable[rows].any():
            np.copyto(signal, np.nan, where=unusable[rows])
            np.copyto(spread, np.nan, where=unusable[rows])
    thinned = sample.mean[::4, ::4] - dark.mean[::4, ::4]
    return RadianceImage(
        value,
        noise,
        sample.saturated,
        float(np.percentile(thinned, 99) / full_scale),
        sample.flicker / max(light / value.size, 1e-9),
        sample.frames,
    )
