"""UVC cameras (webcams, USB microscopes) by OpenCV: 8 bits, and not linear until a response curve is given.

Such a camera adjusts itself wherever it can. Here everything automatic is switched off, every property is read
back, frames that waited in the driver's queue are thrown away, and `UvcCamera.prove_exposure` measures whether
brightness obeys the exposure.
"""

import contextlib
import logging
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError, RigFileError
from anisoscope.rig.camera import CameraInfo, CameraSettings
from anisoscope.rig.cameras import uvcsetup
from anisoscope.rig.cameras.capturethread import Capture, CaptureThread
from anisoscope.rig.cameras.grey import TOP, to_grey
from anisoscope.rig.cameras.linearised import curve_of
from anisoscope.rig.cameras.proof import ExposureProof, prove_exposure
from anisoscope.rig.cameras.response import LINEAR_BITS, LINEAR_BLACK, ResponseCurve
from anisoscope.rig.cameras.uvcbackends import Backend, choose_backend

OpenCapture = Callable[[int | str, int], Capture]
_LOG = logging.getLogger(__name__)
_BITS = 8


class UvcCamera:
    """A UVC camera.

    Attributes:
        notes: what the camera or the backend does not offer, one line each.
    """

    def __init__(
        self,
        capture: CaptureThread,
        backend: Backend,
        info: CameraInfo,
        picture: uvcsetup.PictureSetup,
        *,
        settle_frames: int,
        white_level: int,
        curve: ResponseCurve | None,
        notes: Sequence[str] = (),
    ) -> None:
        self.info = info
        self.notes = tuple(notes)
        self._capture = capture
        self._backend = backend
        self._picture = picture
        self._settle_frames = settle_frames
        self._white_level = white_level
        self._curve = curve
        self._settings: CameraSettings | None = None
        self._fresh = False

    @classmethod
    def open(
        cls,
        *,
        device: int | str = 0,
        backend: str = "default",
        width: int = 0,
        height: int = 0,
        fourcc: str = "",
        settle_frames: int = 2,
        warmup_frames: int = 10,
        gain_raw: float | None = None,
        black_level: float = 0.0,
        white_level: int = TOP,
        serial: str = "",
        response: str | Path = "",
        timeout_s: float = 5.0,
        capture: OpenCapture | None = None,
    ) -> "UvcCamera":
        """Connect to a camera.

        Args:
            device: number of the camera, or its device path.
            backend: v4l2, dshow, msmf, avfoundation, or default for that of the operating system.
            width: columns to ask for; 0 leaves them.
            height: rows to ask for; both or none.
            fourcc: format to ask for, as ``MJPG``; empty for the first one with a raw Y plane.
            settle_frames: frames thrown away after every change, 1 or more, besides those in the queue.
            warmup_frames: frames thrown away after opening.
            gain_raw: the camera's own value of its gain, without unit; it counts as gain 1. Left as it is if
                not given.
            black_level: counts without light.
            white_level: counts at which the camera clips (235 where Y has video range).
            serial: serial number, where the operating system does not tell it.
            response: file of a response curve of this camera; makes counts linear.
            timeout_s: seconds to wait for anything beyond the exposure.
            capture: opens a capture by device and number of the API, instead of ``cv2.VideoCapture``.

        Raises:
            RigFileError: an option that makes no sense, or a backend that is not on this computer.
            NotConnected: no such camera, or no frames come.
            CameraError: the camera refuses a setting; what was asked and what came are named.
        """
        _check(width, height, settle_frames, warmup_frames, timeout_s, black_level, white_level)
        chosen = choose_backend(backend)
        number = int(device) if isinstance(device, str) and device.isdecimal() else device
        opener = capture or uvcsetup.cv2_capture(chosen)
        name = f"camera {number} ({chosen.name})"
        thread = CaptureThread(lambda: opener(number, uvcsetup.api(chosen)), name, timeout_s)
        try:
            notes = uvcsetup.switch_off_automatics(thread, chosen, gain_raw)
            picture = uvcsetup.set_picture(thread, (height, width), fourcc)
            thread.discard(warmup_frames + 1)
            rows, cols = to_grey(thread.read(), picture.fourcc, picture.size).shape
            model, found_serial = uvcsetup.name_of(number)
            curve = curve_of(response, serial or found_serial, _BITS, white_level) if response else None
        except BaseException:
            thread.close()
            raise
        for note in notes:
            _LOG.info("%s: %s", name, note)
        info = CameraInfo(
            model=model,
            serial=serial or found_serial,
            rows=rows,
            cols=cols,
            bit_depth=LINEAR_BITS if curve else _BITS,
            black_level=LINEAR_BLACK if curve else black_level,
            linear=curve is not None,
            auto_exposure=True,
        )
        return cls(
            thread,
            chosen,
            info,
            picture,
            settle_frames=settle_frames,
            white_level=white_level,
            curve=curve,
            notes=notes,
        )

    def configure(self, exposure_s: float, gain: float) -> CameraSettings:
        """Set the exposure; returns the one that the camera really uses, in steps of its backend.

        Raises:
            CameraError: a gain other than 1, which has no unit in UVC; or an exposure that the camera did not take.
            NotConnected: the camera has gone.
        """
        if gain != 1.0:
            raise CameraError(
                f"a UVC camera has no gain in known units: ask for gain 1, not {gain:g}; its own value is "
                "camera.options.gain_raw"
            )
        self._settings = None
        real_s = uvcsetup.set_exposure(self._capture, self._backend, exposure_s)
        self._settings = CameraSettings(real_s, 1.0)
        self._fresh = True
        return self._settings

    def grab(self) -> npt.NDArray[np.uint16]:
        """A frame that was exposed after this call, (rows, cols) counts.

        Frames that waited in the driver's queue are thrown away every time: they show the pose before.

        Raises:
            CameraError: ``configure`` was not called, or a picture of another size or format came.
            NotConnected: the camera delivers no frames.
        """
        if self._settings is None:
            raise CameraError("the camera was asked for a frame before exposure and gain were set")
        exposure_s = self._settings.exposure_s
        stale = self._picture.queue + 1 + (self._settle_frames if self._fresh else 0)
        self._capture.discard(stale, exposure_s)
        self._fresh = False
        picture = self._capture.read(exposure_s)
        grey = to_grey(picture, self._picture.fourcc, (self.info.rows, self.info.cols), self._white_level)
        return grey.astype(np.uint16) if self._curve is None else self._curve.linearise(grey)

    def prove_exposure(
        self,
        exposures_s: Sequence[float],
        *,
        dark_counts: float | None = None,
        tolerance: float = 0.05,
        frames: int = 3,
    ) -> ExposureProof:
        """Measure on a still, lit scene that auto exposure is off; see `anisoscope.rig.cameras.proof`.

        Raises:
            UsageError: fewer than two exposures, or they hardly differ.
            CameraError: brightness does not follow the exposure, or nothing can be said.
        """
        return prove_exposure(self, exposures_s, dark_counts=dark_counts, tolerance=tolerance, frames=frames)

    def close(self) -> None:
        """Disconnect; closing twice is fine."""
        self._settings = None
        with contextlib.suppress(CameraError):
            self._capture.close()


def _check(
    width: int,
    height: int,
    settle_frames: int,
    warmup_frames: int,
    timeout_s: float,
    black_level: float,
    white_level: int,
) -> None:
    for good, name, expected in (
        (min(width, height) >= 0 and (width > 0) == (height > 0), "width", "given together with height"),
        (settle_frames >= 1, "settle_frames", "1 or more"),
        (warmup_frames >= 0, "warmup_frames", "0 or more"),
        (timeout_s > 0.0, "timeout_s", "above 0"),
        (0.0 <= black_level < white_level <= TOP, "white_level", f"above black_level, {TOP} at most"),
    ):
        if not good:
            raise RigFileError(f"camera.options.{name}: must be {expected}")
