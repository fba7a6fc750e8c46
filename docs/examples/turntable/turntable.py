"""A stage and a camera of our own for anisoscope: a turntable that never misses, and a camera that sees a grating."""

import numpy as np

from anisoscope.rig.camera import CameraInfo, CameraSettings
from anisoscope.rig.stage import MotionRules
from anisoscope.rig.stages.motion import StageBase


class Turntable(StageBase):
    """All that a driver adds to the motion rules: how to ask, to start and to stop. Angles in degrees."""

    def __init__(self, port: str, *, max_deg: float = 360.0) -> None:
        super().__init__(f"turntable at {port}", MotionRules(0.01, 100.0), (0.0, max_deg), 0.001)
        self._at_deg = 0.0

    def _read_deg(self) -> float:
        return self._at_deg

    def _begin_home(self) -> None:
        self._at_deg = 0.0

    def _begin_move(self, target_deg: float) -> None:
        self._at_deg = target_deg

    def _is_busy(self, wait_s: float) -> bool:  # noqa: ARG002 - it is always there at once
        return False

    def _send_stop(self) -> None: ...
    def _disconnect(self) -> None: ...


class GratingCamera:
    """A camera needs `info`, `configure`, `grab` and `close`; see `anisoscope.rig.camera.Camera`."""

    def __init__(self, *, pitch_px: float = 16.0) -> None:
        self.info = CameraInfo("grating camera", "G-1", rows=240, cols=320, bit_depth=12, black_level=64.0)
        self._pitch_px, self._exposure_s = pitch_px, 0.0

    def configure(self, exposure_s: float, gain: float) -> CameraSettings:
        """Set exposure in seconds and gain; say what is really used."""
        self._exposure_s = exposure_s
        return CameraSettings(exposure_s, gain)

    def grab(self) -> np.ndarray:
        """Take a picture, (rows, cols) counts."""
        wave = 2.0 + np.cos(2.0 * np.pi * np.arange(self.info.cols) / self._pitch_px)
        counts = self.info.black_level + np.tile(wave, (self.info.rows, 1)) * self._exposure_s * 1e5
        return np.minimum(counts, 4095).astype(np.uint16)

    def close(self) -> None:
        """Let go of the camera."""
