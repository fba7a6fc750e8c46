"""From raw counts to radiance: dark, flat and white reference, with the noise that the frames show."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from anisoscope.errors import CalibrationError
from anisoscope.rig.frame import Frame

Image = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

SATURATION_SHARE = 0.98
HOT_PIXEL_SIGMA = 12.0


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
    total = np.zeros(first.counts.shape, dtype=np.float64)
    squares = np.zeros_like(total)
    saturated = np.zeros(first.counts.shape, dtype=bool)
    for frame in frames:
        counts = frame.counts.astype(np.float64)
        total += counts
        squares += counts**2
        saturated |= frame.counts >= SATURATION_SHARE * frame.full_scale
    flicker = float(np.std([frame.counts.mean() for frame in frames], ddof=1)) if len(frames) > 1 else 0.0
    mean = total / len(frames)
    spare = max(len(frames) - 1, 1)
    variance = np.maximum(squares - len(frames) * mean**2, 0.0) / spare
    return Stack(
        mean.astype(np.float32),
        len(frames),
        np.sqrt(variance).astype(np.float32),
        saturated,
        first.exposure_s,
        first.gain,
        flicker,
    )


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
    middle = np.median(dark.mean)
    spread = 1.4826 * np.median(np.abs(dark.mean - middle)) + 0.5
    return np.asarray(np.abs(dark.mean - middle) > HOT_PIXEL_SIGMA * spread)


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
    unlit = white.signal <= 0.05 * np.median(white.signal)
    scale = white.radiance / (np.where(unlit, 1.0, white.signal) * sample.exposure_s * sample.gain)
    signal = sample.mean - dark.mean
    unusable = unlit | hot_pixels(dark) | sample.saturated
    value = np.where(unusable, np.nan, signal * scale)
    noise = scale * np.sqrt(sample.noise**2 / sample.frames + dark.noise**2 / dark.frames)
    return RadianceImage(
        value.astype(np.float32),
        np.where(unusable, np.nan, noise).astype(np.float32),
        sample.saturated,
        float(np.percentile(signal[::4, ::4], 99) / full_scale),
        sample.flicker / max(float(signal.mean()), 1e-9),
        sample.frames,
    )
