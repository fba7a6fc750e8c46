"""Setting up a UVC camera: every property is set, read back, and compared."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from anisoscope.base.errors import CameraError, RigFileError
from anisoscope.rig.cameras.capturethread import Capture, CaptureThread
from anisoscope.rig.cameras.uvcbackends import BACKENDS, Backend

NOT_OFFERED = -1.0
"""What OpenCV reads back where a camera has no such property."""
RAW_FORMATS = ("GREY", "YUYV", "YUY2", "UYVY")
_USUAL_QUEUE = 4
_SYSFS = Path("/sys/class/video4linux")


@dataclass(frozen=True)
class PictureSetup:
    """What the camera delivers: its format, (rows, cols), and how many frames may wait in the driver."""

    fourcc: str
    size: tuple[int, int]
    queue: int


def cv2_capture(backend: Backend) -> Callable[[int | str, int], Capture]:
    """``cv2.VideoCapture``.

    Raises:
        RigFileError: this computer's OpenCV lacks the backend.
    """
    import cv2  # noqa: PLC0415 - slow to import

    there = set(cv2.videoio_registry.getCameraBackends())
    if api(backend) not in there:
        names = ", ".join(name for name, other in BACKENDS.items() if api(other) in there) or "none"
        raise RigFileError(
            f"camera.options.backend: {backend.name} is not on this computer; there is: {names}"
        )
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

    asked = backend.raw_exposure(exposure_s)
    taken = capture.set(cv2.CAP_PROP_EXPOSURE, asked)
    came = capture.get(cv2.CAP_PROP_EXPOSURE)
    if not taken and came != asked:
        raise CameraError(
            f"{capture.name}: exposure: {asked:g} ({exposure_s:g} s) was asked for and refused; it stays at {came:g}"
        )
    backend.check(asked, came)
    automatic = capture.get(cv2.CAP_PROP_AUTO_EXPOSURE)
    if automatic not in {NOT_OFFERED, backend.manual_exposure}:
        raise CameraError(
            f"{capture.name}: auto exposure was switched off and is on again (at {automatic:g})"
        )
    return backend.exposure_s(came)


def name_of(device: int | str, sysfs: Path = _SYSFS) -> tuple[str, str]:
    """Model and serial number, as Linux tells them; elsewhere the number of the camera stands for both."""
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

    for wanted in (fourcc,) if fourcc else RAW_FORMATS:
        if len(wanted) != 4:
            raise RigFileError(f"camera.options.fourcc: expected four letters, not '{wanted}'")
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*wanted))
        if _fourcc(capture) == wanted:
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
