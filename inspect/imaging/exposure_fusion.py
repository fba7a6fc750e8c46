"""Fusion of the exposure brackets of a pose to one linear picture; a single exposure is linearised as it is.

The exposures are weighted by the noise of the frames themselves: their scatter in the dark gives the read noise, its
growth with the signal the gain of the camera (photon transfer).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError, CameraError
from anisoscope.imaging.linearisation import RadianceImage, Stack, WhiteReference, check_size, linearise
from anisoscope.rig.brackets import Exposure, SensorNoise, merge_exposures
from anisoscope.rig.frame import SATURATION

MIN_FRAMES = 2
CLEAR_OF_CLIPPING = 0.9
QUANTISATION = 1.0 / 12.0


@dataclass(frozen=True, eq=False)
class Exposed:
    """The frames of one pose and exposure.

    Attributes:
        raw: counts of the camera.
        dark: the dark frames of this exposure.
        correct: corrects a stack to the counts of a linear camera, without stray light.
    """

    raw: Stack
    dark: Stack
    correct: Callable[[Stack], Stack]

    @cached_property
    def sample(self) -> Stack:
        """The frames, corrected."""
        return self.correct(self.raw)

    def limit(self, full_scale: int) -> FloatArray:
        """(rows, cols) counts of `sample` above `dark` at which a pixel clips."""
        top = np.full_like(self.raw.mean, SATURATION * full_scale)
        return np.asarray(self.correct(replace(self.raw, mean=top)).mean - self.dark.mean, dtype=np.float64)


def radiance_of(
    exposed: Sequence[Exposed], white: WhiteReference, full_scale: int, black_level: float
) -> RadianceImage:
    """One linear picture of a pose, from one exposure or several.

    Args:
        exposed: the pose, at one exposure or more.
        white: the white reference.
        full_scale: largest count of the camera.
        black_level: counts of a pixel without light.

    Raises:
        CalibrationError: dark frames or white reference do not fit, or too few frames for the noise of a bracket.
        CameraError: the light of its exposures is not in proportion to the times that the camera states.
    """
    if len(exposed) == 1:
        return linearise(exposed[0].sample, exposed[0].dark, white, full_scale)
    _check(exposed, white)
    ordered = sorted(exposed, key=lambda one: one.raw.exposure_s)
    for shorter, longer in pairwise(ordered):
        _check_times(shorter, longer, full_scale)
    gain = ordered[0].raw.gain
    exposures = [_exposure(one, full_scale, black_level) for one in ordered]
    merged = merge_exposures(exposures, noise_of(ordered, full_scale, black_level), gain)
    clipped = np.logical_and.reduce([one.raw.saturated for one in ordered])
    hot = np.logical_or.reduce([one.dark.hot for one in ordered])
    scale = np.where(white.unlit | hot | ~merged.usable, np.float32(np.nan), white.radiance_per_signal)
    scale /= np.float32(gain)
    longest = ordered[-1]
    thinned = longest.raw.mean[::4, ::4] - longest.dark.mean[::4, ::4]
    return RadianceImage(
        value=np.asarray(merged.rate * scale, dtype=np.float32),
        scatter=np.asarray(np.sqrt(merged.variance) * scale, dtype=np.float32),
        saturated=clipped & ~hot,
        signal_share=float(np.percentile(thinned, 99) / full_scale),
        flicker=_flicker(ordered[0]),
        frames=min(one.raw.frames for one in ordered),
    )


def noise_of(exposed: Sequence[Exposed], full_scale: int, black_level: float) -> SensorNoise:
    """Gain and read noise of the camera, from the scatter of the frames of a bracket.

    Pixels near clipping, where noise is truncated, and hot pixels are excluded; the flicker of the lamp is subtracted.
    """
    excess, light, dark_variance, dark_light = 0.0, 0.0, [], []
    for one in exposed:
        signal = one.raw.mean.astype(np.float64) - one.dark.mean
        scatter = one.raw.noise.astype(np.float64) ** 2 - one.dark.noise.astype(np.float64) ** 2
        good = ~one.raw.saturated & ~one.dark.hot & (one.raw.mean < CLEAR_OF_CLIPPING * full_scale)
        flicker = _flicker(one) ** 2 * signal[good] ** 2
        excess += float(scatter[good].sum() - flicker.sum())
        light += float(signal[good].sum())
        dark_variance.append(float(np.mean(one.dark.noise[~one.dark.hot].astype(np.float64) ** 2)))
        dark_light.append(float(np.mean(one.dark.mean[~one.dark.hot], dtype=np.float64)) - black_level)
    gain = max(excess / light, 0.0) if light > 0.0 else 0.0
    quiet = int(np.argmin(dark_variance))
    read = dark_variance[quiet] - QUANTISATION - gain * max(dark_light[quiet], 0.0)
    return SensorNoise(counts_per_electron=gain, read_noise_counts=float(np.sqrt(max(read, 0.0))))


def _check(exposed: Sequence[Exposed], white: WhiteReference) -> None:
    first = exposed[0].raw
    check_size(white, first.mean.shape)
    for one in exposed:
        if one.raw.gain != first.gain:
            raise CalibrationError("the exposures of a pose differ in gain: take them again at one gain")
        if one.dark.mean.shape != one.raw.mean.shape:
            raise CalibrationError("dark frames and sample frames differ in size: take the dark frames again")
        for words, found in (("sample", one.raw.frames), ("dark", one.dark.frames)):
            if found < MIN_FRAMES:
                raise CalibrationError(
                    f"a bracket needs {MIN_FRAMES} or more frames of every exposure, which tell the noise that weighs "
                    f"them; of {one.raw.exposure_s:g} s there is {found} {words} frame"
                )


MOST_OFF, LEAST_SIGNAL, LEAST_PIXELS = 0.05, 0.02, 100


def _check_times(shorter: Exposed, longer: Exposed, full_scale: int) -> None:
    """Check two exposures by what both saw, such as the white of the markers: a camera may state another time."""
    short, long = (one.sample.mean - one.dark.mean for one in (shorter, longer))
    seen = ~(shorter.raw.saturated | longer.raw.saturated | shorter.dark.hot | longer.dark.hot)
    seen &= (short > LEAST_SIGNAL * full_scale) & (longer.raw.mean < CLEAR_OF_CLIPPING * full_scale)
    if np.count_nonzero(seen) < LEAST_PIXELS:
        return
    stated = longer.raw.exposure_s / shorter.raw.exposure_s
    found = float(np.median(long[seen] / short[seen]))
    if abs(found / stated - 1.0) > MOST_OFF:
        raise CameraError(
            f"between the exposures {shorter.raw.exposure_s:g} s and {longer.raw.exposure_s:g} s the light grows "
            f"{found:.3g} times, not {stated:.3g}: the camera exposed otherwise than it states; switch its automatic "
            "functions off, and take the pictures again"
        )


def _exposure(one: Exposed, full_scale: int, black_level: float) -> Exposure:
    dark = one.dark.mean.astype(np.float64)
    added = one.sample.noise.astype(np.float64) ** 2 - one.raw.noise.astype(np.float64) ** 2
    return Exposure(
        time_s=one.raw.exposure_s,
        signal=one.sample.mean - dark,
        dark_signal=np.maximum(dark - black_level, 0.0),
        clipped=one.raw.saturated,
        limit=one.limit(full_scale),
        frames=one.raw.frames,
        darks=one.dark.frames,
        other_variance=np.maximum(added, 0.0) / one.raw.frames,
    )


def _flicker(one: Exposed) -> float:
    """Relative standard deviation of the light from frame to frame."""
    light = float(np.mean(one.raw.mean, dtype=np.float64) - np.mean(one.dark.mean, dtype=np.float64))
    return one.raw.flicker / max(light, 1e-9)
