"""Photon transfer: characteristics of a camera from its frames alone, after EMVA 1288 release 4 (linear).

Two frames of every exposure, under even light and in the dark, give the gain from the slope of variance over mean;
stacks of frames give the fixed pattern. No property of the camera needs to be known. Quantum efficiency, which requires
a calibrated lamp, is not determined: light is measured in electrons.

Electrons (e) and counts (dn) are tied by the system gain K, the slope of variance over mean.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError, UsageError

Counts = npt.NDArray[np.uint16]

QUANTISATION_DN2 = 1.0 / 12.0
GAIN_RANGE = 0.7  # of saturation: EMVA 1288, 6.6
LINEARITY_RANGE = (0.05, 0.95)
CLIPPED_VARIANCE = 0.02  # of the largest: a step with less is clipped as a whole


@dataclass(frozen=True, eq=False)
class ExposureStep:
    """Two frames under even light and two in the dark, of one exposure.

    Attributes:
        exposure_s: exposure in seconds.
        light, dark: (2, rows, cols) counts.
        irradiation: light that a pixel got, in any unit; by default the lamp is steady, and it is the exposure.
    """

    exposure_s: float
    light: Counts
    dark: Counts
    irradiation: float | None = None

    @property
    def amount(self) -> float:
        """The irradiation."""
        return self.exposure_s if self.irradiation is None else self.irradiation


@dataclass(frozen=True)
class Estimate:
    """A value and its standard uncertainty."""

    value: float
    uncertainty: float


@dataclass(frozen=True, eq=False)
class TransferCurve:
    """Means and temporal variances of all steps, in counts, by rising irradiation."""

    exposure_s: FloatArray
    amount: FloatArray
    light: FloatArray
    dark: FloatArray
    light_variance: FloatArray
    dark_variance: FloatArray
    pixels: int

    @property
    def signal(self) -> FloatArray:
        """Mean level above the dark, in counts."""
        return self.light - self.dark

    def content(self) -> dict[str, list[float] | int]:
        """All of it as plain lists, as the record of a calibration holds it."""
        columns = {name: column.tolist() for name, column in vars(self).items() if name != "pixels"}
        return columns | {"pixels": self.pixels}


def curve_of(steps: Sequence[ExposureStep]) -> TransferCurve:
    """Means and temporal variances of all steps."""
    ordered = sorted(steps, key=lambda step: step.amount)

    def column(values: Sequence[float]) -> FloatArray:
        return np.asarray(values, dtype=np.float64)

    return TransferCurve(
        column([step.exposure_s for step in ordered]),
        column([step.amount for step in ordered]),
        column([float(step.light.mean()) for step in ordered]),
        column([float(step.dark.mean()) for step in ordered]),
        column([_temporal_variance(step.light) for step in ordered]),
        column([_temporal_variance(step.dark) for step in ordered]),
        int(np.prod(ordered[0].light.shape[1:])),
    )


def _temporal_variance(pair: Counts) -> float:
    """Half the variance of the difference: the fixed pattern cancels, and so does a flicker of the lamp."""
    return float(np.var(pair[0].astype(np.float64) - pair[1].astype(np.float64))) / 2.0


def straight_line(x: FloatArray, y: FloatArray, variance: FloatArray) -> tuple[Estimate, Estimate]:
    """Intercept and slope of the weighted straight line."""
    weight = 1.0 / np.maximum(variance, 1e-300)
    total = weight.sum()
    centre = float((weight * x).sum() / total)
    spread = float((weight * (x - centre) ** 2).sum())
    slope = float((weight * (x - centre) * y).sum()) / spread
    mean = float((weight * y).sum() / total)
    slope_variance = 1.0 / spread
    intercept = Estimate(mean - slope * centre, math.sqrt(1.0 / total + centre**2 * slope_variance))
    return intercept, Estimate(slope, math.sqrt(slope_variance))


def system_gain(curve: TransferCurve, saturation_dn: float) -> Estimate:
    """Slope of the excess variance over the signal, through the origin."""
    use = (curve.signal > 0.0) & (curve.signal <= GAIN_RANGE * saturation_dn)
    x, y = curve.signal[use], (curve.light_variance - curve.dark_variance)[use]
    variance = 2.0 * (curve.light_variance**2 + curve.dark_variance**2)[use] / curve.pixels
    weight = x / variance
    norm = float((weight * x).sum())
    slope = float((weight * y).sum()) / norm if norm > 0.0 else 0.0
    if slope <= 0.0:
        raise CalibrationError(
            "photon transfer: the noise does not grow with the signal; is it light that is measured?"
        )
    return Estimate(slope, 1.0 / math.sqrt(norm))


def dark_level_and_current(curve: TransferCurve, gain: Estimate) -> tuple[Estimate, Estimate | None]:
    """Mean dark level at no exposure, and dark current."""
    variance = np.maximum(curve.dark_variance, QUANTISATION_DN2) / (2 * curve.pixels)
    if len(np.unique(curve.exposure_s)) < 2:
        return Estimate(float(curve.dark.mean()), math.sqrt(float(variance.mean()) / len(variance))), None
    level, slope = straight_line(curve.exposure_s, curve.dark, variance)
    current = slope.value / gain.value
    doubt = math.hypot(slope.uncertainty / gain.value, current * gain.uncertainty / gain.value)
    return level, Estimate(current, doubt)


def dark_noises(curve: TransferCurve, gain: Estimate) -> tuple[Estimate, Estimate]:
    """Temporal noise in the dark at the shortest exposure, and at none."""
    variance = 2.0 * np.maximum(curve.dark_variance, QUANTISATION_DN2) ** 2 / curve.pixels
    first = int(np.argmin(curve.exposure_s))
    shortest = Estimate(float(curve.dark_variance[first]), math.sqrt(float(variance[first])))
    none = shortest
    if len(np.unique(curve.exposure_s)) > 1:
        none, _ = straight_line(curve.exposure_s, curve.dark_variance, variance)
    return _electrons_of_variance(shortest, gain), _electrons_of_variance(none, gain)


def _electrons_of_variance(variance: Estimate, gain: Estimate) -> Estimate:
    noise = math.sqrt(max(variance.value - QUANTISATION_DN2, 0.0)) / gain.value
    return Estimate(noise, root_uncertainty(noise * gain.value, variance.uncertainty, gain))


def root_uncertainty(root_dn: float, variance_uncertainty: float, gain: Estimate) -> float:
    """Of a standard deviation in electrons, from that of its variance in counts²."""
    own = variance_uncertainty / (2.0 * root_dn) if root_dn > 0.0 else math.sqrt(variance_uncertainty)
    return math.hypot(own, root_dn * gain.uncertainty / gain.value) / gain.value


def saturation_of(curve: TransferCurve, top: int, gain: Estimate) -> Estimate:
    """Saturation signal: the maximum of the variance is between the neighbours of the largest sample."""
    signal = float(curve.signal[top])
    gap = float(curve.signal[top + 1] - curve.signal[max(top - 1, 0)]) / 2.0
    doubt = math.hypot(gap / math.sqrt(3.0), signal * gain.uncertainty / gain.value)
    return Estimate(signal / gain.value, doubt / gain.value)


def clipping_of(curve: TransferCurve, top: int, gain: Estimate) -> Estimate | None:
    """Mean signal of the fully clipped steps; None without any."""
    shot = curve.light_variance - curve.dark_variance
    clipped = np.flatnonzero(shot < CLIPPED_VARIANCE * shot[top])
    clipped = clipped[clipped > top]
    if len(clipped) == 0:
        return None
    signal = float(curve.signal[clipped].mean())
    return Estimate(signal / gain.value, signal * gain.uncertainty / gain.value**2)


def linearity_deviations(curve: TransferCurve, saturation_dn: float) -> FloatArray:
    """Relative deviations from the line that makes them small: weights 1/signal²."""
    low, high = LINEARITY_RANGE
    use = (curve.signal >= low * saturation_dn) & (curve.signal <= high * saturation_dn)
    if use.sum() < 3:
        raise CalibrationError(
            "photon transfer: too few exposures between 5 and 95 % of saturation for linearity"
        )
    x, y = curve.amount[use], curve.signal[use]
    intercept, slope = straight_line(x, y, y**2)
    line = intercept.value + slope.value * x
    return np.asarray((y - line) / line, dtype=np.float64)


MIN_STEPS = 6
MIN_STACK = 8


@dataclass(frozen=True)
class PhotoTransfer:
    """Result of a photon transfer; e is electrons, dn is counts.

    Attributes:
        gain_dn_per_e: system gain K.
        dark_noise_e: temporal dark noise at the shortest exposure, without quantisation.
        read_noise_e: temporal dark noise at no exposure at all.
        dark_current_e_s: mean dark current, from the dark level over exposure; None for a single exposure.
        dark_level_dn: mean level in the dark at no exposure.
        dsnu_e: spatial standard deviation of the dark signal.
        prnu: spatial standard deviation of the response, as a share of it.
        saturation_e: signal where the temporal variance is largest (EMVA's saturation capacity).
        clipping_e: signal of frames that are clipped as a whole; None if the series ends before.
        linearity_error: mean deviation from a straight line from 5 to 95 % of saturation, as a share (LE).
        linearity_peak: largest such deviation.
        snr_max: signal-to-noise ratio at saturation.
        dynamic_range: saturation over the smallest signal that is seen, as a ratio.
    """

    gain_dn_per_e: Estimate
    dark_noise_e: Estimate
    read_noise_e: Estimate
    dark_current_e_s: Estimate | None
    dark_level_dn: Estimate
    dsnu_e: Estimate
    prnu: Estimate
    saturation_e: Estimate
    clipping_e: Estimate | None
    linearity_error: float
    linearity_peak: float
    snr_max: float
    dynamic_range: float

    def to_json(self) -> dict[str, Any]:
        """All values for a JSON file; None for undetermined ones."""
        return asdict(self)


def photo_transfer(
    steps: Sequence[ExposureStep], light_stack: Counts, dark_stack: Counts, *, highpass_px: int = 0
) -> PhotoTransfer:
    """Analyse frames after EMVA 1288.

    Args:
        steps: at least 6, from dim to clipped; for saturation to be exact to a percent, the steps around it must lie
            a percent apart.
        light_stack: (n, rows, cols) frames at about half of saturation, n ≥ 8 (100 for a small PRNU).
        dark_stack: (n, rows, cols) frames in the dark, of the same exposure.
        highpass_px: width of the window whose mean is subtracted before the fixed pattern is measured, so that uneven
            light and vignetting do not count; 0 subtracts the mean of all.

    Raises:
        UsageError: too few steps or frames, or arrays of other shapes.
        CalibrationError: the series does not reach saturation, or the frames carry no shot noise.
    """
    _check(steps, light_stack, dark_stack)
    curve = curve_of(steps)
    top = int(np.argmax(curve.light_variance))
    if top == len(steps) - 1:
        raise CalibrationError(
            "photon transfer: the noise still grows at the longest exposure; add longer ones, until all is clipped"
        )
    saturation_dn = float(curve.signal[top])
    gain = system_gain(curve, saturation_dn)
    dark_level, current = dark_level_and_current(curve, gain)
    dark_noise, read_noise = dark_noises(curve, gain)
    dsnu, prnu = _fixed_pattern(light_stack, dark_stack, gain, highpass_px)
    saturation = saturation_of(curve, top, gain)
    deviations = linearity_deviations(curve, saturation_dn)
    dimmest_e = math.sqrt(dark_noise.value**2 + QUANTISATION_DN2 / gain.value**2) + 0.5
    return PhotoTransfer(
        gain_dn_per_e=gain,
        dark_noise_e=dark_noise,
        read_noise_e=read_noise,
        dark_current_e_s=current,
        dark_level_dn=dark_level,
        dsnu_e=dsnu,
        prnu=prnu,
        saturation_e=saturation,
        clipping_e=clipping_of(curve, top, gain),
        linearity_error=float(np.mean(np.abs(deviations))),
        linearity_peak=float(np.max(np.abs(deviations))),
        snr_max=math.sqrt(saturation.value),
        dynamic_range=saturation.value / dimmest_e,
    )


def _check(steps: Sequence[ExposureStep], light_stack: Counts, dark_stack: Counts) -> None:
    if len(steps) < MIN_STEPS:
        raise UsageError(f"photon transfer needs at least {MIN_STEPS} exposures, not {len(steps)}")
    shape = light_stack.shape[1:]
    for step in steps:
        for name, frames in (("light", step.light), ("dark", step.dark)):
            if frames.shape != (2, *shape):
                raise UsageError(
                    f"photon transfer: {name} frames of {step.exposure_s:g} s have shape {frames.shape}, "
                    f"not {(2, *shape)}"
                )
    if (
        light_stack.ndim != 3
        or dark_stack.shape[1:] != shape
        or min(len(light_stack), len(dark_stack)) < MIN_STACK
    ):
        raise UsageError(
            f"photon transfer needs stacks of at least {MIN_STACK} frames of one shape, not {light_stack.shape} "
            f"and {dark_stack.shape}"
        )


def _fixed_pattern(
    light: Counts, dark: Counts, gain: Estimate, highpass_px: int
) -> tuple[Estimate, Estimate]:
    """DSNU in electrons, PRNU as a share: spatial variance of the mean frame, less its remaining temporal noise."""
    light_variance, dark_variance = (
        _spatial_variance(light, highpass_px),
        _spatial_variance(dark, highpass_px),
    )
    dark_root = math.sqrt(max(dark_variance.value, 0.0))
    dsnu = Estimate(dark_root / gain.value, root_uncertainty(dark_root, dark_variance.uncertainty, gain))
    signal = float(light.mean()) - float(dark.mean())
    if signal <= 0.0:
        raise CalibrationError("photon transfer: the light stack is not brighter than the dark one")
    root = math.sqrt(max(light_variance.value - dark_variance.value, 0.0))
    doubt = math.hypot(light_variance.uncertainty, dark_variance.uncertainty)
    own = doubt / (2.0 * root) if root > 0.0 else math.sqrt(doubt)
    return dsnu, Estimate(root / signal, own / signal)


def _spatial_variance(stack: Counts, highpass_px: int) -> Estimate:
    mean = stack.mean(axis=0, dtype=np.float64)
    temporal = float(stack.var(axis=0, ddof=1, dtype=np.float64).mean())
    window_gain = 1.0
    if highpass_px > 1:
        from scipy.ndimage import uniform_filter  # noqa: PLC0415 - heavy

        mean = mean - uniform_filter(mean, highpass_px, mode="mirror")
        window_gain = 1.0 - 1.0 / highpass_px**2  # the share of white variance that the window leaves
    measured = float(mean.var()) / window_gain
    return Estimate(measured - temporal / len(stack), measured * math.sqrt(2.0 / mean.size))
