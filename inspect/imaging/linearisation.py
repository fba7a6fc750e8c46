"""From raw counts to radiance: dark, flat and white reference, with the noise estimated from the frames.

Pictures are processed in blocks of rows that fit into a core's cache: passes over whole pictures are memory-bound.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CalibrationError
from anisoscope.rig.frame import Frame

Image = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Counts = npt.NDArray[np.uint16]
PixelScatter = Image | tuple[Counts, ...]
Window = tuple[slice, slice]

SATURATION_SHARE = 0.98
HOT_PIXEL_SIGMA = 12.0
_BLOCK_BYTES = 1 << 18
_SAMPLE_SIZE = 1 << 18
_GUESS_SIZE = 1 << 12
_EXACT_SUMS = 256  # number of 16-bit counts whose sum is exact in single precision


def _blocks(shape: tuple[int, ...]) -> Iterator[slice]:
    """Slices of rows: blocks of a quarter of a megabyte in single precision."""
    rows = max(1, _BLOCK_BYTES // (4 * max(shape[1], 1)))
    for start in range(0, shape[0], rows):
        yield slice(start, start + rows)


def _middle(image: Image) -> float:
    """Median of a picture; of a large one, of every n-th pixel."""
    return float(np.median(_thinned(image)))


def _thinned(image: Image) -> Image:
    step = max(1, int(np.sqrt(image.size / _SAMPLE_SIZE)))
    return image[::step, ::step]


@dataclass(frozen=True, eq=False)
class Stack:
    """Combined frames of one pose.

    Attributes:
        mean: (rows, cols) mean counts.
        frames: how many frames it is the mean of.
        scatter: (rows, cols) standard deviation of one frame about the mean of the frames, in counts; or the frames,
            from which it is computed.
        saturated: (rows, cols) True where any frame reached full scale.
        exposure_s: exposure of every frame.
        gain: gain of every frame.
        flicker: standard deviation of one frame's mean over the picture in counts, common to all pixels.
    """

    mean: Image
    frames: int
    scatter: PixelScatter
    saturated: Mask
    exposure_s: float
    gain: float
    flicker: float = 0.0

    @cached_property
    def noise(self) -> Image:
        """(rows, cols) standard deviation of one frame about the mean of the frames, in counts."""
        return scatter_in(self.scatter, (slice(None), slice(None)))

    @cached_property
    def hot(self) -> Mask:
        """Pixels whose signal deviates by more than 12 robust standard deviations: in the dark, hot ones."""
        middle = _middle(self.mean)
        spread = 1.4826 * float(np.median(np.abs(_thinned(self.mean) - np.float32(middle)))) + 0.5
        reach = np.float32(HOT_PIXEL_SIGMA * spread)
        hot = np.empty(self.mean.shape, dtype=bool)
        for rows in _blocks(hot.shape):
            part = self.mean[rows]
            np.logical_or(part > middle + reach, part < middle - reach, out=hot[rows])
        return hot


def stack(frames: Iterable[Frame]) -> Stack:
    """Mean and noise of frames with the same settings.

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
    shape, counts = first.counts.shape, tuple(frame.counts for frame in frames)
    mean = np.empty(shape, dtype=np.float32)
    for rows in _blocks(shape):
        _mean([one[rows] for one in counts], mean[rows])
    saturated = np.zeros(shape, dtype=bool)
    for frame in frames:
        limit = np.ceil(SATURATION_SHARE * frame.full_scale)
        if frame.counts.max(initial=0) >= limit:
            saturated |= frame.counts >= frame.counts.dtype.type(limit)
    means = [cv2.mean(one)[0] for one in counts]
    flicker = float(np.std(means, ddof=1)) if len(frames) > 1 else 0.0
    return Stack(mean, len(frames), counts, saturated, first.exposure_s, first.gain, flicker)


def _mean(counts: list[Counts], mean: Image) -> None:
    """Mean of counts, rounded once."""
    if len(counts) > _EXACT_SUMS:
        mean[:] = np.mean(counts, axis=0, dtype=np.float64)
        return
    mean[:] = counts[0]
    for later in counts[1:]:
        cv2.accumulate(later, mean)
    if len(counts) > 1:
        mean /= np.float32(len(counts))


def _window_of(scatter: PixelScatter, window: Window) -> PixelScatter:
    return tuple(one[window] for one in scatter) if isinstance(scatter, tuple) else scatter[window]


def scatter_in(scatter: PixelScatter, window: Window) -> Image:
    """A window of the scatter of a `Stack`, (rows, cols); of a single frame, zeros."""
    counts = _window_of(scatter, window)
    if not isinstance(counts, tuple):
        return counts
    noise = np.zeros(counts[0].shape, dtype=np.float32)
    if len(counts) > 1:
        for rows in _blocks(noise.shape):
            _deviation([one[rows] for one in counts], noise[rows])
    return noise


def _deviation(counts: list[Counts], noise: Image) -> None:
    """Standard deviation of counts, from their differences to the first frame to avoid cancellation.

    ``noise`` is passed in as zeros.
    """
    count, total, squares = len(counts), np.zeros_like(noise), noise
    first = counts[0].astype(np.float32)
    for later in counts[1:]:
        off = later.astype(np.float32)
        off -= first
        total += off
        np.multiply(off, off, out=off)
        squares += off
    total *= np.float32(1.0 / count)
    np.multiply(total, total, out=total)
    total *= np.float32(count)
    squares -= total
    np.maximum(squares, 0.0, out=squares)
    squares *= np.float32(1.0 / (count - 1))
    np.sqrt(squares, out=squares)


@dataclass(frozen=True, eq=False)
class WhiteReference:
    """Flat frame of a white tile: corrects the shading and fixes the radiance scale.

    Attributes:
        signal: (rows, cols) counts per second at unit gain, dark subtracted.
        radiance: nominal radiance of the tile in 1/sr: ρ·cos θl/π.
        camera: serial number of the camera.
        taken_at: UTC time.
        reflectance: reflectance of the tile.
        sha256: hash of the file.
        filters: the colour filters on the camera's pixels; every pixel has the scale of its own filter.
    """

    signal: Image
    radiance: float
    camera: str
    taken_at: str
    reflectance: float
    sha256: str
    filters: str = "mono"

    @cached_property
    def unlit(self) -> Mask:
        """Pixels with next to no light in the flat."""
        return np.asarray(self.signal <= np.float32(0.05 * _middle(self.signal)))

    @cached_property
    def radiance_per_signal(self) -> Image:
        """(rows, cols) radiance of one count per second at unit gain; undefined where `unlit`."""
        found = np.empty(self.signal.shape, dtype=np.float32)
        for rows in _blocks(found.shape):
            safe = np.where(self.unlit[rows], np.float32(1.0), self.signal[rows])
            np.divide(np.float32(self.radiance), safe, out=found[rows])
        return found


@dataclass(frozen=True, eq=False)
class RadianceImage:
    """A linear picture in radiance per unit irradiance [1/sr].

    Attributes:
        value: (rows, cols); NaN where the pixel is unusable (hot, or saturated).
        scatter: (rows, cols) standard deviation of one pixel of the mean picture, or a function that computes it for a
            window; only `noise` sets it to NaN where there is no value.
        saturated: (rows, cols) True where a pixel reached full scale in any frame.
        signal_share: 99th percentile of the dark-corrected signal, as a share of full scale.
        flicker: relative standard deviation of the light from one frame to the next, common to all pixels.
        frames: how many frames were averaged.
    """

    value: Image
    scatter: Image | Callable[[Window], Image]
    saturated: Mask
    signal_share: float
    flicker: float = 0.0
    frames: int = 1

    @cached_property
    def usable(self) -> Mask:
        """Pixels that carry a value."""
        return np.isfinite(self.value)

    @cached_property
    def noise(self) -> Image:
        """(rows, cols) standard deviation of one pixel of the mean picture; NaN where there is no value."""
        return self.noise_in((slice(None), slice(None)))

    def noise_in(self, window: Window) -> Image:
        """`noise` within a window, computed on demand."""
        found = self.scatter(window) if callable(self.scatter) else self.scatter[window]
        unknown = np.isnan(self.value[window])
        return np.where(unknown, np.float32(np.nan), found) if unknown.any() else found


def hot_pixels(dark: Stack) -> Mask:
    """Pixels whose dark signal deviates by more than 12 robust standard deviations."""
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
        dark: frames with the light off, same settings.
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
    value = np.empty_like(sample.mean)
    per_second = np.float32(1.0 / (sample.exposure_s * sample.gain))
    unlit, hot, light = white.unlit, dark.hot, 0.0
    saturated = sample.saturated & ~hot  # a defective pixel says nothing about the exposure
    for rows in _blocks(value.shape):
        scale = white.radiance_per_signal[rows] * per_second
        signal = np.subtract(sample.mean[rows], dark.mean[rows], out=value[rows])
        light += cv2.sumElems(signal)[0]
        signal *= scale
        unusable = unlit[rows] | hot[rows] | saturated[rows]
        if unusable.any():
            np.copyto(signal, np.nan, where=unusable)
    thinned = sample.mean[::4, ::4] - dark.mean[::4, ::4]
    return RadianceImage(
        value,
        _noise_of(sample, dark, white),
        saturated,
        upper_quantile(thinned, 0.99) / full_scale,
        sample.flicker / max(light / value.size, 1e-9),
        sample.frames,
    )


def _noise_of(sample: Stack, dark: Stack, white: WhiteReference) -> Callable[[Window], Image]:
    """Function for the noise of a window of a linear picture, from the scatter of sample and dark frames."""
    scatter, frames = sample.scatter, sample.frames  # not the stack itself: its mean can be freed
    per_second = np.float32(1.0 / (sample.exposure_s * sample.gain))

    def noise(window: Window) -> Image:
        scale, own, of_dark = (
            white.radiance_per_signal[window],
            _window_of(scatter, window),
            _window_of(dark.scatter, window),
        )
        found = np.empty(scale.shape, dtype=np.float32)
        for rows in _blocks(found.shape):
            block = (rows, slice(None))
            spread = np.square(scatter_in(own, block))
            spread *= np.float32(1.0 / frames)
            spread += np.square(scatter_in(of_dark, block)) * np.float32(1.0 / dark.frames)
            np.sqrt(spread, out=spread)
            np.multiply(spread, scale[rows] * per_second, out=found[rows])
        return found

    return noise


def upper_quantile(values: Image, share: float) -> float:
    """Quantile at or above the median, linear between neighbours.

    As `numpy.quantile`, but only the values above an estimate from every n-th of them are sorted.
    """
    flat = values.ravel()
    place = share * (flat.size - 1)
    lower = int(place)
    few = np.sort(flat[:: max(1, flat.size // _GUESS_SIZE)])
    high = flat[flat >= few[int((2.0 * share - 1.0) * (few.size - 1))]]
    if flat.size - high.size > lower:  # the estimate was too high
        high = flat
    at = lower - (flat.size - high.size)
    ordered = np.partition(high, (at, min(at + 1, high.size - 1)))
    first, second = float(ordered[at]), float(ordered[min(at + 1, high.size - 1)])
    return first + (place - lower) * (second - first)
