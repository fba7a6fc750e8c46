"""What OpenCV's camera backends call things: the same property has other units and other values in each.

V4L2 counts exposure in steps of 100 µs (the control of the UVC driver); DirectShow and Media Foundation count
in powers of two of a second. Auto exposure is off at 1 in V4L2 (manual mode) and at 0 in the others.
AVFoundation sets no exposure at all.
"""

import math
import sys
from dataclasses import dataclass
from typing import Literal

from anisoscope.base.errors import CameraError, RigFileError

STEP_S = 1e-4
EXPOSURE_TOLERANCE = 0.05


@dataclass(frozen=True)
class Backend:
    """A backend of ``cv2.VideoCapture``.

    Attributes:
        name: name in the rig file.
        api: name of OpenCV's constant.
        unit: unit of the exposure; none if the backend does not set it.
        manual_exposure: value of ``CAP_PROP_AUTO_EXPOSURE`` that means off.
    """

    name: str
    api: str
    unit: Literal["100 us", "log2 s"] | None
    manual_exposure: float

    def raw_exposure(self, exposure_s: float) -> float:
        """Value of the property that comes nearest to an exposure in seconds.

        Raises:
            CameraError: the backend has no such exposure, or does not set any.
        """
        if self.unit is None:
            raise CameraError(
                f"the backend {self.name} cannot set the exposure; use the camera under Linux (v4l2) or "
                "Windows (dshow), or one with a driver of its own"
            )
        if not exposure_s > 0.0 or not math.isfinite(exposure_s):
            raise CameraError(f"the exposure must be above 0 s, not {exposure_s:g} s")
        if self.unit == "log2 s":
            return float(round(math.log2(exposure_s)))
        steps = max(1, round(exposure_s / STEP_S))
        if abs(steps * STEP_S - exposure_s) > max(0.5 * STEP_S, EXPOSURE_TOLERANCE * exposure_s) * 1.001:
            raise CameraError(
                f"an exposure of {exposure_s:g} s was asked for; the backend {self.name} has steps of {STEP_S:g} s"
            )
        return float(steps)

    def exposure_s(self, raw: float) -> float:
        """Exposure in seconds of a value of the property."""
        return 2.0**raw if self.unit == "log2 s" else raw * STEP_S

    def check(self, asked: float, came: float) -> None:
        """See that the camera took what was asked; both are values of the property.

        Raises:
            CameraError: it took something else, or cannot be read back.
        """
        if self.unit == "log2 s":
            fits = came == asked
        else:
            fits = came > 0.0 and abs(came - asked) <= max(1.0, EXPOSURE_TOLERANCE * asked)
        if not fits:
            real = f" ({self.exposure_s(came):g} s)" if self.unit == "log2 s" or came > 0.0 else ""
            raise CameraError(
                f"exposure: {asked:g} ({self.exposure_s(asked):g} s) was asked for, {came:g}{real} came; "
                "the camera has no such exposure, or does not let it be set"
            )


BACKENDS = {
    backend.name: backend
    for backend in (
        Backend("v4l2", "CAP_V4L2", "100 us", 1.0),
        Backend("dshow", "CAP_DSHOW", "log2 s", 0.0),
        Backend("msmf", "CAP_MSMF", "log2 s", 0.0),
        Backend("avfoundation", "CAP_AVFOUNDATION", None, 0.0),
    )
}


def choose_backend(name: str, platform: str = sys.platform) -> Backend:
    """A backend by name; ``"default"`` is that of the operating system.

    Raises:
        RigFileError: there is none of that name.
    """
    if name == "default":
        name = {"win32": "dshow", "darwin": "avfoundation"}.get(platform, "v4l2")
    if name not in BACKENDS:
        raise RigFileError(f"camera.options.backend: expected default, {', '.join(BACKENDS)}, not '{name}'")
    return BACKENDS[name]
