"""Camera linearity: photon transfer after EMVA 1288, and the response curve of a camera that is not linear.

Two frames of every exposure, under even light and in the dark, give the gain from the slope of variance over mean;
stacks of frames give the fixed pattern (EMVA 1288, release 4, linear model). No property of the camera needs to be
known. Quantum efficiency, which requires a calibrated lamp, is not determined: light is measured in electrons.

Electrons (e) and counts (dn) are related by the system gain K, the slope of variance over mean.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.calibration.frames import Bed, calibration_bed
from anisoscope.calibration.record import (
    CalibrationRecord,
    Value,
    dated,
    days_of,
    record_path,
    write_calibration,
)
from anisoscope.parameters.taking import Taking
from anisoscope.rig.cameras.response import ResponseCurve, fit_response, write_response
from anisoscope.rig.frame import Frame

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
        irradiation: irradiation of a pixel, in any unit; by default the exposure, which assumes a steady lamp.
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


MIN_EXPOSURES = 6
MIN_STACK = 8


@dataclass(frozen=True)
class PhotoTransfer:
    """Result of a photon transfer; e is electrons, dn is counts.

    Attributes:
        gain_dn_per_e: system gain K.
        dark_noise_e: temporal dark noise at the shortest exposure, without quantisation.
        read_noise_e: temporal dark noise extrapolated to zero exposure.
        dark_current_e_s: mean dark current, from the dark level over exposure; None for a single exposure.
        dark_level_dn: mean dark level extrapolated to zero exposure.
        dsnu_e: spatial standard deviation of the dark signal.
        prnu: spatial standard deviation of the response, as a share of it.
        saturation_e: signal where the temporal variance is largest (EMVA's saturation capacity).
        clipping_e: signal of completely clipped frames; None if the series ends before.
        linearity_error: mean deviation from a straight line from 5 to 95 % of saturation, as a share (LE).
        linearity_peak: largest such deviation.
        snr_max: signal-to-noise ratio at saturation.
        dynamic_range: saturation over the smallest detectable signal, as a ratio.
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


def photo_transfer(
    steps: Sequence[ExposureStep], light_stack: Counts, dark_stack: Counts, *, highpass_px: int = 0
) -> PhotoTransfer:
    """Analyse frames after EMVA 1288.

    Args:
        steps: at least 6, from dim to clipped; an error of saturation below 1 % needs steps of 1 % around it.
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
    if len(steps) < MIN_EXPOSURES:
        raise UsageError(f"photon transfer needs at least {MIN_EXPOSURES} exposures, not {len(steps)}")
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


WINDOW_SHARE = 0.4  # of rows and columns: beyond, vignetting spreads the signal
MIN_STEPS, MAX_STEPS = 10, 200
FIRST_SHARE, LAST_SHARE = 0.02, 1.3  # of the exposure that reaches full scale
MAX_RAW_ERROR = 0.002
MAX_ERROR = 0.02


def calibrate_linearity(
    rig_path: Path,
    out: Path,
    taking: Taking,
    *,
    steps: int = 24,
    on_progress: Advance = silent,
) -> CalibrationRecord:
    """Photograph a white tile with exposures from 2 % of full scale to clipping, and analyse after EMVA 1288.

    If the response deviates from linear by more than 0.2 %, a second-order correction is fitted: signal·(1 + b·signal).
    The record has the remaining error as ``linearity_error`` and the error before correction as ``raw_error``.

    Args:
        rig_path: rig file.
        out: record to write (JSON).
        taking: its exposure is the starting point: any that is neither dark nor clipped.
        steps: exposures of the series.
        on_progress: called with what is being done, steps done and steps in all.

    Raises:
        UsageError: too few or too many steps.
        RigFileError, RigError: the rig.
        CalibrationError: the series cannot be analysed.
        RecordError: the file cannot be written.
    """
    if not MIN_STEPS <= steps <= MAX_STEPS:
        raise UsageError(f"a linearity series needs {MIN_STEPS} to {MAX_STEPS} steps, not {steps}")
    days_of("linearity", taking.valid_days)
    with calibration_bed(rig_path, taking, on_progress) as bed:
        top_s = _full_scale_exposure(bed, taking)
        exposures = np.linspace(FIRST_SHARE, LAST_SHARE, steps) * top_s
        series = [_step(bed, float(one), taking.gain, number, steps) for number, one in enumerate(exposures)]
        count = max(taking.frames, MIN_STACK)
        light = _cut(bed.frames("flat", 0.5 * top_s, taking.gain, count))
        dark = _cut(bed.frames("dark", 0.5 * top_s, taking.gain, count))
        content = bed.content(taking, 4 * steps + 2 * count) | {"exposure_s": float(exposures[-1])}
    found = photo_transfer(series, light, dark, highpass_px=11)
    record = dated("linearity", content | _results(series, found), valid_days=taking.valid_days)
    write_calibration(record, record_path(out))
    return record


def _full_scale_exposure(bed: Bed, taking: Taking) -> float:
    """Exposure at which the middle of the tile would reach full scale, from one trial."""
    dark = float(_cut(bed.frames("dark", taking.exposure_s, taking.gain, 1)).mean())
    light = float(_cut(bed.frames("flat", taking.exposure_s, taking.gain, 1)).mean())
    share = (light - dark) / (bed.full_scale - dark)
    if not 0.02 < share < 0.9:
        word = "lengthen" if share <= 0.02 else "shorten"
        raise CalibrationError(
            f"at {taking.exposure_s:g} s the tile reaches {share:.1%} of full scale (wanted 2 % to 90 %): "
            f"{word} --exposure"
        )
    return taking.exposure_s / share


def _step(bed: Bed, exposure_s: float, gain: float, number: int, steps: int) -> ExposureStep:
    bed.advance(f"exposure {exposure_s:.3g} s", number, steps)
    quiet = Bed(bed.rig, bed.tilt_deg, silent)
    light, dark = quiet.frames("flat", exposure_s, gain, 2), quiet.frames("dark", exposure_s, gain, 2)
    return ExposureStep(light[0].exposure_s, _cut(light), _cut(dark))


def _cut(frames: list[Frame]) -> Counts:
    """The middle of frames, (n, rows, cols); of a mosaic, the green pixels of every other row.

    EMVA 1288 evaluates each colour channel separately.
    """
    counts = [_green(frame) for frame in frames]
    rows, cols = counts[0].shape
    high, wide = (max(8, int(size * WINDOW_SHARE)) for size in (rows, cols))
    top, left = (rows - high) // 2, (cols - wide) // 2
    return np.stack([one[top : top + high, left : left + wide] for one in counts])


def _green(frame: Frame) -> Counts:
    if frame.filters == "mono":
        return frame.counts
    row, col = divmod(frame.filters.index("g"), 2)
    return frame.counts[row::2, col::2]


def _results(series: list[ExposureStep], found: PhotoTransfer) -> dict[str, Any]:
    saturation_dn = found.saturation_e.value * found.gain_dn_per_e.value
    bend, residuals = _response(series, saturation_dn)
    bent = found.linearity_error > MAX_RAW_ERROR
    error = float(np.mean(np.abs(residuals))) if bent else found.linearity_error
    remarks = []
    if bent:
        remarks.append(
            f"the response is bent by {found.linearity_error:.2%}; inspections at this gain correct "
            f"it, which leaves {error:.2%}"
        )
    if error > MAX_ERROR:
        remarks.insert(
            0,
            f"{error:.1%} of the response cannot be corrected (limit {MAX_ERROR:.0%}); a camera with a "
            "gamma curve needs `anisoscope calibrate response`",
        )
    values = {
        "gain": _value(found.gain_dn_per_e, "counts/e"),
        "read_noise": _value(found.read_noise_e, "e"),
        "dark_level": _value(found.dark_level_dn, "counts"),
        "saturation": _value(found.saturation_e, "e"),
        "dsnu": _value(found.dsnu_e, "e"),
        "prnu": _value(found.prnu, ""),
        "raw_error": Value(value=found.linearity_error),
        "linearity_error": Value(value=error),
        "snr_max": Value(value=found.snr_max),
        "dynamic_range": Value(value=found.dynamic_range),
    }
    if found.dark_current_e_s is not None:
        values["dark_current"] = _value(found.dark_current_e_s, "e/s")
    return {
        "values": values,
        "residuals": tuple(float(value) for value in residuals),
        "details": {
            "response_per_count": bend if bent else 0.0,
            "steps": len(series),
            "curve": curve_of(series).content(),
        },
        "in_limits": error <= MAX_ERROR,
        "remarks": tuple(remarks),
    }


def _response(series: list[ExposureStep], saturation_dn: float) -> tuple[float, FloatArray]:
    """Second-order term b of light ∝ signal·(1 + b·signal), per count, and the relative residuals of the fit."""
    curve = curve_of(series)
    low, high = LINEARITY_RANGE
    used = (curve.signal >= low * saturation_dn) & (curve.signal <= high * saturation_dn)
    signal, light = curve.signal[used], curve.amount[used]
    design = np.column_stack([signal, signal**2]) / light[:, None]
    (slope, square), *_ = np.linalg.lstsq(design, np.ones_like(light), rcond=None)
    return float(square / slope), np.asarray(design @ [slope, square] - 1.0)


def _value(estimate: Estimate, unit: str) -> Value:
    return Value(value=estimate.value, u=estimate.uncertainty, unit=unit)


STEPS = 9
STEP = 2.0**0.5
MAX_BITS = 12


def calibrate_response(
    rig_path: Path,
    out: Path,
    taking: Taking,
    *,
    white_level: int | None = None,
    on_progress: Advance = silent,
) -> ResponseCurve:
    """Photograph a still scene with exposures from that of `taking` down to a sixteenth, and fit the curve.

    Args:
        rig_path: rig file.
        out: file of the curve (JSON), for ``camera.options.response``.
        taking: its exposure is the longest, at which the brightest places just clip; as many frames at each.
        white_level: counts at which the camera clips; full scale if not given.
        on_progress: called with what is being done, steps done and steps in all.

    Raises:
        RigFileError, RigError: the rig.
        CalibrationError: the camera is linear already, or the frames carry no curve.
        RecordError: the file cannot be written.
    """
    with calibration_bed(rig_path, taking, on_progress) as bed:
        info = bed.rig.camera.info
        if info.linear:
            raise CalibrationError(
                f"{info.model} counts in proportion to light already, or by the curve that [camera.options] response "
                "names: take that out of the rig file to take a new one"
            )
        if info.bit_depth > MAX_BITS:
            raise CalibrationError(
                f"{info.model} has {info.bit_depth} bits; a response curve is for {MAX_BITS} at most: set a format "
                "with fewer bits"
            )
        darks = bed.frames("dark", taking.exposure_s, taking.gain, taking.frames)
        exposures = taking.exposure_s * STEP ** -np.arange(STEPS)
        frames = [
            frame
            for exposure_s in exposures
            for frame in bed.frames("reference", float(exposure_s), taking.gain, taking.frames)
        ]
        bed.rig.light.off()
    on_progress("fit", 0, 1)
    curve = fit_response(frames, darks, white_level=white_level)
    write_response(out, curve)
    return curve
