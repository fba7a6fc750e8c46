"""UVC cameras (webcams, USB microscopes) by OpenCV: 8 bits, and not linear until a response curve is given.

Such a camera adjusts itself wherever it can. The driver switches all automatic functions off, reads every property
back, discards the frames in the driver's queue, and `UvcCamera.prove_exposure` measures whether brightness follows the
exposure.

Frames become grey counts of 8 bits. The Y plane is used directly if the camera delivers it (YUYV, UYVY, GREY). From
colour pictures it is computed: 0.299 R + 0.587 G + 0.114 B (ITU-R BT.601, OpenCV's weights), of values that are not
linear.

Units and values of a property differ between OpenCV's camera backends. V4L2 counts exposure in steps of 100 µs (the
control of the UVC driver); DirectShow and Media Foundation count in powers of two of a second. Auto exposure is off at
1 in V4L2 (manual mode) and at 0 in the others. AVFoundation cannot set the exposure.
"""

import contextlib
import logging
import math
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError, RigFileError
from anisoscope.rig.camera import CameraInfo, CameraSettings
from anisoscope.rig.cameras.capturethread import Capture, CaptureThread
from anisoscope.rig.cameras.linearised import curve_of
from anisoscope.rig.cameras.proof import ExposureProof, prove_exposure
from anisoscope.rig.cameras.response import LINEAR_BITS, LINEAR_BLACK, ResponseCurve

Grey = npt.NDArray[np.uint8]
_Y_PLACE = {"YUYV": 0, "YUY2": 0, "UYVY": 1}
TOP = 255


def to_grey(picture: npt.NDArray[Any], fourcc: str, size: tuple[int, int], white_level: int = TOP) -> Grey:
    """Grey counts of a picture.

    Args:
        picture: as OpenCV gave it.
        fourcc: format that the camera states.
        size: expected (rows, cols).
        white_level: counts at which the camera clips; pixels there, in any colour, are set to 255.

    Returns:
        (rows, cols) counts.

    Raises:
        CameraError: a picture of another size, or of a format that is not known.
    """
    if picture.dtype != np.uint8:
        raise CameraError(f"the camera delivers {picture.dtype}, not the 8-bit counts of a UVC camera")
    rows, cols = size
    if picture.size == 2 * rows * cols and fourcc in _Y_PLACE:
        grey = picture.reshape(rows, cols, 2)[..., _Y_PLACE[fourcc]]
        clipped = grey >= white_level
    elif picture.shape == (rows, cols, 3):
        grey, clipped = _luma(picture), np.any(picture >= white_level, axis=2)
    elif picture.size == rows * cols and (picture.ndim == 2 or picture.shape[-1] == 1):
        grey = picture.reshape(rows, cols)
        clipped = grey >= white_level
    else:
        raise CameraError(
            f"the camera delivers pictures of shape {picture.shape} in format {fourcc or 'unknown'}, which are "
            f"no {rows} x {cols} pixels (rows x cols); set camera.options.width, height or fourcc"
        )
    return np.where(clipped, np.uint8(TOP), grey)


def _luma(picture: npt.NDArray[Any]) -> npt.NDArray[Any]:
    import cv2  # noqa: PLC0415 - cameras without colour do without it

    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))


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

    def check(self, requested: float, came: float) -> None:
        """Compare the requested with the actual value of the property.

        Raises:
            CameraError: it took something else, or cannot be read back.
        """
        if self.unit == "log2 s":
            fits = came == requested
        else:
            fits = came > 0.0 and abs(came - requested) <= max(1.0, EXPOSURE_TOLERANCE * requested)
        if not fits:
            real = f" ({self.exposure_s(came):g} s)" if self.unit == "log2 s" or came > 0.0 else ""
            raise CameraError(
                f"exposure: {requested:g} ({self.exposure_s(requested):g} s) was asked for, {came:g}{real} came; "
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


NOT_OFFERED = -1.0
"""What OpenCV reads back where a camera has no such property."""
RAW_FORMATS = ("GREY", "YUYV", "YUY2", "UYVY")
_USUAL_QUEUE = 4
_SYSFS = Path("/sys/class/video4linux")


@dataclass(frozen=True)
class PictureSetup:
    """Format, (rows, cols) and length of the driver's queue of a camera's pictures."""

    fourcc: str
    size: tuple[int, int]
    queue: int


def cv2_capture(backend: Backend) -> Callable[[int | str, int], Capture]:
    """``cv2.VideoCapture``.

    Raises:
        RigFileError: this computer's OpenCV lacks the backend.
    """
    import cv2  # noqa: PLC0415 - slow to import

    available = set(cv2.videoio_registry.getCameraBackends())
    if api(backend) not in available:
        names = ", ".join(name for name, other in BACKENDS.items() if api(other) in available) or "none"
        raise RigFileError(
            f"camera.options.backend: {backend.name} is not on this computer; there is: {names}"
        )
    if "OPENCV_LOG_LEVEL" not in os.environ:  # it writes to the terminal what our errors say in one line
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    return cast("Callable[[int | str, int], Capture]", cv2.VideoCapture)


def api(backend: Backend) -> int:
    """OpenCV's number of a backend."""
    import cv2  # noqa: PLC0415 - slow to import

    return int(getattr(cv2, backend.api))


def switch_off_automatics(capture: CaptureThread, backend: Backend, gain_raw: float | None) -> list[str]:
    """Switch off all that a camera adjusts by itself; returns notes on what it does not offer.

    Auto gain has no switch of its own in UVC: it belongs to auto exposure.

    Raises:
        CameraError: the camera says that something is on nevertheless.
    """
    import cv2  # noqa: PLC0415 - slow to import

    notes = []
    if backend.api == "CAP_V4L2" and capture.get(cv2.CAP_PROP_MODE) > 0.0:
        capture.set(cv2.CAP_PROP_MODE, 0.0)  # or values would be shares of their range
    for what, prop, off in (
        ("auto exposure", cv2.CAP_PROP_AUTO_EXPOSURE, backend.manual_exposure),
        ("auto white balance", cv2.CAP_PROP_AUTO_WB, 0.0),
        ("autofocus", cv2.CAP_PROP_AUTOFOCUS, 0.0),
    ):
        if capture.get(prop) == NOT_OFFERED:
            notes.append(f"{what} has no switch")
        else:
            _set(capture, what, prop, off)
    if gain_raw is not None:
        _set(capture, "gain", cv2.CAP_PROP_GAIN, gain_raw)
    return notes


def set_picture(capture: CaptureThread, size: tuple[int, int], fourcc: str) -> PictureSetup:
    """Choose format and (rows, cols); 0 leaves the size as it is.

    Raises:
        CameraError: the camera does not take the size, or the format that is asked for.
    """
    import cv2  # noqa: PLC0415 - slow to import

    used = _set_format(capture, fourcc)
    rows, cols = size
    if rows and cols:
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, cols)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, rows)
    came = round(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)), round(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
    if rows and cols and came != size:
        raise CameraError(
            f"{capture.name}: {cols} x {rows} pixels were asked for, {came[1]} x {came[0]} came; choose a size "
            "that the camera has, or another fourcc"
        )
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    queue = round(capture.get(cv2.CAP_PROP_BUFFERSIZE))
    return PictureSetup(used, came, queue if queue >= 1 else _USUAL_QUEUE)


def set_exposure(capture: CaptureThread, backend: Backend, exposure_s: float) -> float:
    """Set the exposure; returns what the camera took, in seconds.

    Raises:
        CameraError: it took something else, or switched auto exposure on again.
    """
    import cv2  # noqa: PLC0415 - slow to import

    requested = backend.raw_exposure(exposure_s)
    accepted = capture.set(cv2.CAP_PROP_EXPOSURE, requested)
    came = capture.get(cv2.CAP_PROP_EXPOSURE)
    if not accepted and came != requested:
        raise CameraError(
            f"{capture.name}: exposure: {requested:g} ({exposure_s:g} s) was asked for and refused; "
            f"it stays at {came:g}"
        )
    backend.check(requested, came)
    automatic = capture.get(cv2.CAP_PROP_AUTO_EXPOSURE)
    if automatic not in {NOT_OFFERED, backend.manual_exposure}:
        raise CameraError(
            f"{capture.name}: auto exposure was switched off and is on again (at {automatic:g})"
        )
    return backend.exposure_s(came)


def name_of(device: int | str, sysfs: Path = _SYSFS) -> tuple[str, str]:
    """Model and serial number from Linux; elsewhere the number of the camera in place of both."""
    node = f"video{device}" if isinstance(device, int) else Path(device).resolve().name
    place = sysfs / node
    model = _line(place / "name") or f"UVC camera {device}"
    # the link leads to the USB interface, whose parent is the device
    serial = _line((place / "device").resolve().parent / "serial") or node
    return model, serial


def _line(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def _set_format(capture: CaptureThread, fourcc: str) -> str:
    import cv2  # noqa: PLC0415 - slow to import

    for code in (fourcc,) if fourcc else RAW_FORMATS:
        if len(code) != 4:
            raise RigFileError(f"camera.options.fourcc: expected four letters, not '{code}'")
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*code))
        if _fourcc(capture) == code:
            break
    came = _fourcc(capture)
    if fourcc and came != fourcc:
        raise CameraError(f"{capture.name}: format {fourcc} was asked for, {came or 'none'} came")
    raw = came in RAW_FORMATS
    capture.set(cv2.CAP_PROP_CONVERT_RGB, 0.0 if raw else 1.0)
    if raw and capture.get(cv2.CAP_PROP_CONVERT_RGB) != 0.0:
        raw = False
    return came if raw else "BGR"


def _fourcc(capture: CaptureThread) -> str:
    import cv2  # noqa: PLC0415 - slow to import

    number = int(capture.get(cv2.CAP_PROP_FOURCC))
    if number <= 0:
        return ""
    return number.to_bytes(8, "little")[:4].decode("ascii", errors="replace")


def _set(capture: CaptureThread, what: str, prop: int, value: float) -> None:
    capture.set(prop, value)
    came = capture.get(prop)
    if came != value:
        raise CameraError(f"{capture.name}: {what}: {value:g} was asked for, {came:g} came")


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
        picture: PictureSetup,
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
        opener = capture or cv2_capture(chosen)
        name = f"camera {number} ({chosen.name})"
        thread = CaptureThread(lambda: opener(number, api(chosen)), name, timeout_s)
        try:
            notes = switch_off_automatics(thread, chosen, gain_raw)
            picture = set_picture(thread, (height, width), fourcc)
            thread.discard(warmup_frames + 1)
            rows, cols = to_grey(thread.read(), picture.fourcc, picture.size).shape
            model, found_serial = name_of(number)
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
        real_s = set_exposure(self._capture, self._backend, exposure_s)
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
