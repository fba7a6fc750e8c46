"""Camera linearity: photon transfer over an exposure series, and the response curve of a camera that is not linear."""

from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.calibration.frames import Bed, Taking, calibration_bed
from anisoscope.calibration.photon_transfer import (
    LINEARITY_RANGE,
    MIN_STACK,
    Counts,
    Estimate,
    ExposureStep,
    PhotoTransfer,
    curve_of,
    photo_transfer,
)
from anisoscope.calibration.record import (
    CalibrationRecord,
    Value,
    dated,
    days_of,
    record_path,
    write_calibration,
)
from anisoscope.rig.cameras.response import ResponseCurve, fit_response, write_response
from anisoscope.rig.frame import Frame

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

    Where the response is bent by more than 0.2 %, a second-order correction is fitted: signal·(1 + b·signal); the
    error that then remains is the record's ``linearity_error``, the one before its ``raw_error``.

    Args:
        rig_path: rig file.
        out: record to write (JSON).
        taking: the exposure is a start: any that is neither dark nor clipped.
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
    with calibration_bed(rig_path, on_progress) as bed:
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

    EMVA 1288 takes the colours of a camera one by one.
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
        taking: its exposure is the longest, at which the brightest places just clip; its frames are taken at each.
        white_level: counts at which the camera clips; full scale if not given.
        on_progress: called with what is being done, steps done and steps in all.

    Raises:
        RigFileError, RigError: the rig.
        CalibrationError: the camera is linear already, or the frames carry no curve.
        RecordError: the file cannot be written.
    """
    with calibration_bed(rig_path, on_progress) as bed:
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
