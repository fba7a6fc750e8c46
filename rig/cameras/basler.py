# ruff: noqa: ANN401 - pypylon has no types
"""Basler cameras, by the maker's pypylon (``pip install 'anisoscope[basler]'``).

Every frame is an acquisition of its own: started, triggered by software and stopped when the frame is asked
for, so that a frame from before the last change of exposure, gain or pose cannot come. Automatic functions are
off, gamma is 1, and what is set is read back.
"""

import contextlib
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError, NotConnected, RigFileError
from anisoscope.rig.camera import CameraInfo, CameraSettings
from anisoscope.rig.cameras import baslernodes as nodes
from anisoscope.rig.cameras.baslersdk import find_device, load_genicam, load_pylon, one_line

_LOG = logging.getLogger(__name__)


class BaslerCamera:
    """A Basler camera that takes single frames.

    Attributes:
        failed_buffers: frames that came incomplete, or not at all, since the camera was opened.
    """

    def __init__(self, pylon: Any, device: Any, info: CameraInfo, *, retries: int, timeout_s: float) -> None:
        self.info = info
        self.failed_buffers = 0
        self._pylon = pylon
        self._device = device
        self._retries = retries
        self._timeout_s = timeout_s
        self._settings: CameraSettings | None = None
        self._name = f"{info.model} {info.serial}"

    @classmethod
    def open(
        cls,
        *,
        serial: str = "",
        name: str = "",
        pixel_format: str = "Mono12",
        width: int = 0,
        height: int = 0,
        black_level: float | None = None,
        retries: int = 3,
        timeout_s: float = 2.0,
        image_file: str | Path = "",
    ) -> "BaslerCamera":
        """Connect to a camera.

        Args:
            serial: serial number; without it and `name` there must be one camera only.
            name: name that the user gave the camera.
            pixel_format: Mono12, Mono10 or Mono8, and a camera without it is used with Mono8; or the raw format of a
                colour camera, such as BayerRG12, which is used or refused.
            width: columns of the picture, in the middle of the sensor; 0 for all.
            height: rows of the picture, likewise.
            black_level: counts of a pixel without light; read from the camera if not given.
            retries: how often a frame that came incomplete is asked for again.
            timeout_s: seconds to wait for a frame beyond its exposure.
            image_file: picture that the maker's emulated camera shows (TIFF or PNG, 16 bits left-justified).

        Raises:
            RigFileError: an option that makes no sense.
            NotConnected: no such camera, or somebody else uses it.
            CameraError: pypylon is not installed, or the camera refuses a setting.
        """
        if pixel_format not in nodes.BITS:
            raise RigFileError(
                "camera.options.pixel_format: expected Mono12, Mono10, Mono8 or the raw format of a colour camera, "
                f"such as BayerRG12, not '{pixel_format}'"
            )
        if retries < 0 or timeout_s <= 0.0:
            raise RigFileError("camera.options: retries must be 0 or more, and timeout_s above 0")
        pylon = load_pylon()
        device = pylon.InstantCamera(find_device(pylon, serial, name))
        try:
            with _told(device, "the camera"):
                device.Open()
                if image_file:
                    nodes.show_image_file(device, Path(image_file))
                used = nodes.prepare(device, pixel_format, (height, width))
                level = nodes.black_level(device, used) if black_level is None else black_level
            found = device.GetDeviceInfo()
            info = CameraInfo(
                model=str(found.GetModelName()),
                serial=str(found.GetSerialNumber()),
                rows=int(device.Height.Value),
                cols=int(device.Width.Value),
                bit_depth=nodes.BITS[used],
                black_level=level,
                filters=nodes.FILTERS[used],
            )
        except BaseException:
            _close(device)
            raise
        return cls(pylon, device, info, retries=retries, timeout_s=timeout_s)

    def configure(self, exposure_s: float, gain: float) -> CameraSettings:
        """Set exposure in seconds and gain as a factor; returns what the camera reports afterwards.

        Raises:
            CameraError: outside of the camera's range, or the camera took something else.
            NotConnected: the camera has gone.
        """
        self._settings = None
        with _told(self._device, self._name):
            self._settings = CameraSettings(
                nodes.set_exposure(self._device, exposure_s), nodes.set_gain(self._device, gain)
            )
        return self._settings

    def grab(self) -> npt.NDArray[np.uint16]:
        """Take a frame, (rows, cols) counts.

        Raises:
            CameraError: ``configure`` was not called, or no complete frame came in 1 + `retries` attempts.
            NotConnected: the camera has gone.
        """
        if self._settings is None:
            raise CameraError("the camera was asked for a frame before exposure and gain were set")
        reason = ""
        with _told(self._device, self._name):
            for attempt in range(1, self._retries + 2):
                counts, reason = self._attempt(self._settings.exposure_s)
                if counts is not None:
                    return counts
                self.failed_buffers += 1
                _LOG.warning(
                    "%s: attempt %d of %d gave no frame: %s (%d since the camera was opened)",
                    self._name,
                    attempt,
                    self._retries + 1,
                    reason,
                    self.failed_buffers,
                )
                if self._device.IsCameraDeviceRemoved():
                    break
        if self._device.IsCameraDeviceRemoved():
            raise NotConnected(f"{self._name} was unplugged")
        raise CameraError(
            f"{self._name}: no complete frame in {self._retries + 1} attempts: {reason}; "
            "check cable, hub and network load"
        )

    def close(self) -> None:
        """Disconnect; closing twice is fine."""
        _close(self._device)

    def _attempt(self, exposure_s: float) -> tuple[npt.NDArray[np.uint16] | None, str]:
        """One frame, or the reason why there is none."""
        if not self._device.IsOpen():
            raise NotConnected(f"{self._name} is closed: open it again")
        self._device.StartGrabbingMax(1, self._pylon.GrabStrategy_OneByOne)
        try:
            wait_ms = round(1000.0 * (self._timeout_s + exposure_s))
            to_return = self._pylon.TimeoutHandling_Return
            can_wait = self._device.CanWaitForFrameTriggerReady()
            if can_wait and not self._device.WaitForFrameTriggerReady(wait_ms, to_return):
                return None, f"it was not ready for a trigger in {wait_ms} ms"
            self._device.ExecuteSoftwareTrigger()
            result = self._device.RetrieveResult(wait_ms, to_return)
            try:
                return self._counts(result, wait_ms)
            finally:
                result.Release()
        finally:
            self._device.StopGrabbing()

    def _counts(self, result: Any, wait_ms: int) -> tuple[npt.NDArray[np.uint16] | None, str]:
        if not result.IsValid():
            return None, f"nothing came in {wait_ms} ms"
        if not result.GrabSucceeded():
            return None, one_line(result.GetErrorDescription())
        counts = result.Array
        expected = (self.info.rows, self.info.cols)
        if counts.shape != expected:
            raise CameraError(
                f"{self.info.model} delivered a picture of shape {counts.shape} instead of {expected} (rows, cols)"
            )
        return counts.astype(np.uint16), ""


@contextlib.contextmanager
def _told(device: Any, name: str) -> Iterator[None]:
    """Turn the SDK's exceptions, which go over several lines, into ours."""
    genicam = load_genicam()
    try:
        yield
    except genicam.GenericException as problem:
        reason = one_line(str(problem))
        if device.IsCameraDeviceRemoved():
            raise NotConnected(f"{name} was unplugged: {reason}") from problem
        if not device.IsOpen():
            raise NotConnected(f"{name} is not open: {reason}") from problem
        raise CameraError(f"{name} refuses: {reason}") from problem


def _close(device: Any) -> None:
    with contextlib.suppress(Exception):
        device.StopGrabbing()
    with contextlib.suppress(Exception):
        device.Close()
