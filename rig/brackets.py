"""Exposure brackets: pictures of one scene with several exposures become one, over more decades of light.

The rate of a pixel is the weighted mean of (s - dark)/t over the exposures t in which it is neither clipped nor
lost in the dark: linear counts stay linear. Weights are inverse variances of shot and read noise (EMVA 1288's
linear model). They are computed from the rate that the exposures agree on, never from the single reading: a
weight that depends on the reading itself prefers low readings, and bends the result.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError
from anisoscope.rig.frame import SATURATION, Frame

Mask = npt.NDArray[np.bool_]

NEAR_CLIP_SIGMA = 4.0
NEAR_DARK_SIGMA = 3.0
_ROUNDS = 3
_STRIP = 16384
"""Pixels that are merged at a time."""
_QUANTISATION = 1.0 / 12.0


@dataclass(frozen=True)
class SensorNoise:
    """Noise of the camera at the gain of the bracket (EMVA 1288).

    Attributes:
        counts_per_electron: system gain K.
        read_noise_counts: standard deviation of a pixel without light, without quantisation.
    """

    counts_per_electron: float
    read_noise_counts: float

    def variance(self, signal: FloatArray) -> FloatArray:
        """Variance in counts² of one reading with a signal in counts above dark."""
        floor = self.read_noise_counts**2 + _QUANTISATION
        return self.counts_per_electron * np.maximum(signal, 0.0) + floor


@dataclass(frozen=True, eq=False)
class MergedBracket:
    """A merged bracket.

    Attributes:
        rate: (rows, cols) counts per second above dark, float32; NaN where no exposure can be used.
        variance: (rows, cols) its variance, float32; NaN likewise.
        usable: (rows, cols) whether an exposure can be used.
        lost_in_dark: (rows, cols) whether not even the longest usable exposure stands out of the read noise; the
            rate is measured there, but only its variance says something.
        exposures_s: the exposures, ascending.
        saturated_share: share of clipped pixels in each of them.
        gain: gain of all frames, a factor.
    """

    rate: npt.NDArray[np.float32]
    variance: npt.NDArray[np.float32]
    usable: Mask
    lost_in_dark: Mask
    exposures_s: tuple[float, ...]
    saturated_share: tuple[float, ...]
    gain: float


@dataclass(frozen=True, eq=False)
class Exposure:
    """Frames of one exposure, put together.

    Attributes:
        time_s: the exposure.
        signal: (rows, cols) mean counts above dark, in proportion to light.
        dark_signal: (rows, cols) what dark current adds to the black level; it has shot noise too.
        clipped: (rows, cols) whether a pixel was clipped in any frame.
        limit: (rows, cols) `signal` at which a pixel clips.
        frames: how many lit frames `signal` is the mean of.
        darks: how many dark frames were subtracted.
        other_variance: (rows, cols) variance of `signal` that comes from elsewhere, as from stray light taken away.
    """

    time_s: float
    signal: FloatArray
    dark_signal: FloatArray
    clipped: Mask
    limit: FloatArray
    frames: int
    darks: int
    other_variance: FloatArray | float = 0.0

    def rows(self, at: slice) -> "Exposure":
        """Some rows of it."""
        other = self.other_variance
        return replace(
            self,
            signal=self.signal[at],
            dark_signal=self.dark_signal[at],
            clipped=self.clipped[at],
            limit=self.limit[at],
            other_variance=other[at] if isinstance(other, np.ndarray) else other,
        )

    def variance_of_one(self, rate: FloatArray, noise: SensorNoise) -> FloatArray:
        """Variance of one reading in counts², if the rate is as given."""
        return noise.variance(np.maximum(rate, 0.0) * self.time_s + self.dark_signal)

    def variance_of_dark(self, noise: SensorNoise) -> FloatArray:
        """Variance of `signal` in counts² that its dark frames and what else was taken away add."""
        return noise.variance(self.dark_signal) / self.darks + self.other_variance

    def floor(self, noise: SensorNoise) -> FloatArray:
        """Signal in counts above the noise in the dark."""
        return NEAR_DARK_SIGMA * np.sqrt(noise.variance(self.dark_signal))


def merge_brackets(frames: Iterable[Frame], darks: Iterable[Frame], noise: SensorNoise) -> MergedBracket:
    """Merge frames of one scene.

    A reading is left out if it is clipped (98 % of full scale in any frame), or if the other exposures say that
    it would be but for its noise; and if it does not stand out of the read noise by 3 σ while a longer exposure
    can be used. Frames of equal exposure are averaged first.

    Args:
        frames: lit frames of one pose, at one gain, with at least one exposure; linear counts.
        darks: frames with the light off, at least one for every exposure, at the same gain.
        noise: noise of the camera.

    Raises:
        CalibrationError: there are no frames; they differ in size, pose, gain or bit depth; or an exposure has no
            dark frames.
    """
    lit, dark = _sorted(frames), _sorted(darks)
    if not lit:
        raise CalibrationError("a bracket needs frames, and there are none")
    first = next(iter(lit.values()))[0]
    for group in (*lit.values(), *dark.values()):
        for frame in group:
            _check_alike(frame, first)
    exposures = [_exposure(time_s, group, dark.get(time_s, [])) for time_s, group in lit.items()]
    return merge_exposures(exposures, noise, first.gain)


def merge_exposures(exposures: Iterable[Exposure], noise: SensorNoise, gain: float) -> MergedBracket:
    """Merge a bracket whose frames were put together already; see `merge_brackets`.

    Args:
        exposures: one or more, in any order.
        noise: noise of the camera.
        gain: gain of all frames, a factor.
    """
    ordered = sorted(exposures, key=lambda exposure: exposure.time_s)
    rows, cols = ordered[0].signal.shape
    rate, variance = np.empty((2, rows, cols), dtype=np.float32)
    usable, lost = np.empty((2, rows, cols), dtype=bool)
    # pixel by pixel, in strips that stay in the cache
    step = max(1, _STRIP // cols)
    for first in range(0, rows, step):
        at = slice(first, first + step)
        rate[at], variance[at], usable[at], lost[at] = _merged([one.rows(at) for one in ordered], noise)
    return MergedBracket(
        rate,
        variance,
        usable,
        lost,
        exposures_s=tuple(exposure.time_s for exposure in ordered),
        saturated_share=tuple(float(exposure.clipped.mean()) for exposure in ordered),
        gain=gain,
    )


def _merged(ordered: Sequence[Exposure], noise: SensorNoise) -> tuple[FloatArray, FloatArray, Mask, Mask]:
    """Rate, its variance, where an exposure can be used, and where all are lost in the dark."""
    clipped = np.stack([exposure.clipped for exposure in ordered])
    use = ~clipped
    rate = _first_estimate(ordered, use)
    variance = np.full_like(rate, np.nan)
    floors = [exposure.floor(noise) for exposure in ordered]
    of_dark = [exposure.variance_of_dark(noise) for exposure in ordered]
    for _ in range(_ROUNDS):
        known = np.nan_to_num(rate)
        of_one = [exposure.variance_of_one(known, noise) for exposure in ordered]
        use = _selection(ordered, clipped, known, of_one, floors)
        rate, variance = _weighted(ordered, use, of_one, of_dark)
    return rate, variance, np.asarray(use.any(axis=0)), _lost(ordered, use, rate, floors)


def _sorted(frames: Iterable[Frame]) -> dict[float, list[Frame]]:
    groups: dict[float, list[Frame]] = {}
    for frame in frames:
        groups.setdefault(frame.exposure_s, []).append(frame)
    return groups


def _check_alike(frame: Frame, first: Frame) -> None:
    for what, same in (
        ("size", frame.counts.shape == first.counts.shape),
        ("gain", frame.gain == first.gain),
        ("bit depth", frame.bit_depth == first.bit_depth),
        ("colour filters", frame.filters == first.filters),
        ("kind", frame.kind in {"dark", first.kind} and first.kind != "dark"),
        ("angle", frame.kind == "dark" or frame.commanded_deg == first.commanded_deg),
        ("tilt", frame.kind == "dark" or frame.tilt_deg == first.tilt_deg),
    ):
        if not same:
            raise CalibrationError(f"frames of one bracket differ in {what}: take them again")


def _exposure(time_s: float, frames: Sequence[Frame], darks: Sequence[Frame]) -> Exposure:
    if not darks:
        raise CalibrationError(
            f"the exposure of {time_s:g} s has no dark frames; take some with the light off, at the same gain"
        )
    dark = _mean(darks)
    top = SATURATION * frames[0].full_scale
    return Exposure(
        time_s,
        signal=_mean(frames) - dark,
        dark_signal=np.maximum(dark - frames[0].black_level, 0.0),
        clipped=np.asarray(np.any([frame.counts >= top for frame in frames], axis=0)),
        limit=top - dark,
        frames=len(frames),
        darks=len(darks),
    )


def _mean(frames: Sequence[Frame]) -> FloatArray:
    total = np.zeros(frames[0].counts.shape)
    for frame in frames:
        total += frame.counts
    return total / len(frames)


def _first_estimate(exposures: Sequence[Exposure], use: Mask) -> FloatArray:
    """Sum of signals over sum of times: best in bright light, and unbiased everywhere."""
    total = np.zeros(use.shape[1:])
    time_s = np.zeros_like(total)
    for exposure, good in zip(exposures, use, strict=True):
        total += np.where(good, exposure.signal * exposure.frames, 0.0)
        time_s += np.where(good, exposure.time_s * exposure.frames, 0.0)
    return np.divide(total, time_s, out=np.full_like(total, np.nan), where=time_s > 0.0)


def _selection(
    exposures: Sequence[Exposure],
    clipped: npt.NDArray[np.bool_],
    known: FloatArray,
    of_one: Sequence[FloatArray],
    floors: Sequence[FloatArray],
) -> Mask:
    """(exposures, rows, cols) mask of the readings that count, with the variance of one and the floor of each."""
    use = ~clipped
    for number, (exposure, variance) in enumerate(zip(exposures, of_one, strict=True)):
        # A reading below the limit whose fellows lie above it is there because of its noise only.
        margin = NEAR_CLIP_SIGMA * np.sqrt(variance)
        use[number] &= known * exposure.time_s + margin < exposure.limit
    # The shortest exposure has nothing to be replaced by: it counts unless it is clipped.
    nothing_left = ~use.any(axis=0)
    use[0] |= nothing_left & ~clipped[0]
    longer = np.zeros(known.shape, dtype=bool)
    for number in reversed(range(len(exposures))):
        near_dark = known * exposures[number].time_s < floors[number]
        keep = use[number] & ~(near_dark & longer)
        longer |= use[number]
        use[number] = keep
    return use


def _weighted(
    exposures: Sequence[Exposure], use: Mask, of_one: Sequence[FloatArray], of_dark: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Weighted mean of signal/t and its variance, with the variances of one reading and of the darks of each."""
    total = np.zeros(use.shape[1:])
    weights = np.zeros_like(total)
    for exposure, good, lit, dark in zip(exposures, use, of_one, of_dark, strict=True):
        weight = np.where(good, exposure.time_s**2 / (lit / exposure.frames + dark), 0.0)
        total += weight * exposure.signal / exposure.time_s
        weights += weight
    nothing = np.full(total.shape, np.nan)
    some = weights > 0.0
    merged = np.divide(total, weights, out=nothing.copy(), where=some)
    return merged, np.divide(1.0, weights, out=nothing, where=some)


def _lost(exposures: Sequence[Exposure], use: Mask, rate: FloatArray, floors: Sequence[FloatArray]) -> Mask:
    """Mask of pixels with valid exposures, none of which exceeds the noise."""
    known, stands_out = np.nan_to_num(rate), np.zeros(rate.shape, dtype=bool)
    for exposure, good, floor in zip(exposures, use, floors, strict=True):
        stands_out |= good & (known * exposure.time_s >= floor)
    return np.asarray(use.any(axis=0) & ~stands_out)
