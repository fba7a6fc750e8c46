"""The response curve of a camera that does not count in proportion to light, from an exposure series on the rig."""

from pathlib import Path

import numpy as np

from anisoscope.base.errors import CalibrationError
from anisoscope.base.progress import Advance, silent
from anisoscope.calibration.frames import Taking, calibration_bed
from anisoscope.rig.cameras.response import ResponseCurve, fit_response, write_response

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
