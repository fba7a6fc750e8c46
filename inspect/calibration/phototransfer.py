"""Photon transfer: what a camera is, from its frames alone, after EMVA 1288 release 4 (linear).

Two frames of every exposure, under even light and in the dark, give the gain from the slope of variance over mean;
stacks of frames give the fixed pattern. Nothing about the camera has to be known, and quantum efficiency, which needs
a calibrated lamp, is not found: light counts in electrons.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from anisoscope.calibration.transfercurve import (
    QUANTISATION_DN2,
    Counts,
    Estimate,
    ExposureStep,
    clipping_of,
    curve_of,
    dark_level_and_current,
    dark_noises,
    linearity_deviations,
    root_uncertainty,
    saturation_of,
    system_gain,
)
from anisoscope.errors import CalibrationError, UsageError

MIN_STEPS = 6
MIN_STACK = 8


@dataclass(frozen=True)
class PhotoTransfer:
    """What photon transfer finds; e is electrons, dn is counts.

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

    @property
    def electrons_per_count(self) -> float:
        """1/K."""
        return 1.0 / self.gain_dn_per_e.value

    def to_json(self) -> dict[str, Any]:
        """All of it, for a JSON file; what was not found is None."""
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
    """DSNU in electrons, PRNU as a share: the spread of the mean frame, less what time leaves in it."""
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
    kept = 1.0
    if highpass_px > 1:
        from scipy.ndimage import uniform_filter  # noqa: PLC0415 - heavy

        mean = mean - uniform_filter(mean, highpass_px, mode="mirror")
        kept = 1.0 - 1.0 / highpass_px**2  # the share of white variance that the window leaves
    measured = float(mean.var()) / kept
    return Estimate(measured - temporal / len(stack), measured * math.sqrt(2.0 / mean.size))
