"""A camera whose counts are not linear, read through its response curve."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CalibrationError, RigFileError
from anisoscope.rig.camera import Camera, CameraSettings
from anisoscope.rig.cameras.response import LINEAR_BITS, LINEAR_BLACK, ResponseCurve, read_response


class LinearisedCamera:
    """Delivers linear counts of 16 bits, black at `LINEAR_BLACK`, from a camera and its response curve."""

    def __init__(self, camera: Camera, curve: ResponseCurve) -> None:
        self._camera, self._curve = camera, curve
        self.info = replace(camera.info, bit_depth=LINEAR_BITS, black_level=float(LINEAR_BLACK), linear=True)

    def configure(self, exposure_s: float, gain: float) -> CameraSettings:
        """Set exposure in seconds and gain; errors as for the camera."""
        return self._camera.configure(exposure_s, gain)

    def grab(self) -> npt.NDArray[np.uint16]:
        """One frame, (rows, cols) linear counts; errors as for the camera."""
        return self._curve.linearise(self._camera.grab())

    def close(self) -> None:
        """Disconnect."""
        self._camera.close()


def linearised(camera: Camera, response: str | Path) -> LinearisedCamera:
    """A camera with the response curve of a file.

    Raises:
        RigFileError: the file is no curve, or that of another camera; the camera is closed.
    """
    info = camera.info
    try:
        return LinearisedCamera(camera, curve_of(response, info.serial, info.bit_depth))
    except BaseException:
        camera.close()
        raise


def curve_of(
    response: str | Path, serial: str, bit_depth: int, white_level: int | None = None
) -> ResponseCurve:
    """The response curve of a camera, as ``camera.options.response`` names it.

    Args:
        response: the file.
        serial: serial number of the camera.
        bit_depth: bits of its raw counts.
        white_level: counts at which it clips, where that is known.

    Raises:
        RigFileError: the file is no curve, or that of another camera.
    """
    try:
        curve = read_response(Path(response))
    except CalibrationError as problem:
        raise RigFileError(f"camera.options.response: {problem}") from problem
    if serial not in curve.camera:
        raise RigFileError(
            f"camera.options.response: {response} belongs to camera {curve.camera}, this is {serial}; take one of it "
            "with `anisoscope calibrate response`"
        )
    white = curve.white_level if white_level is None else white_level
    if (curve.bit_depth, curve.white_level) != (bit_depth, white):
        raise RigFileError(
            f"camera.options.response: {response} is for {curve.bit_depth} bits and white_level {curve.white_level}, "
            f"this camera has {bit_depth} and {white}"
        )
    return curve
