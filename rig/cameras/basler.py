# ruff: noqa: ANN401 - pypylon has no types
"""Basler cameras, by the maker's pypylon (``pip install 'anisoscope[basler]'``).

Every frame is an acquisition of its own: started, triggered by software and stopped when the frame is asked for.
Settings go by the names of GenICam; see `anisoscope.rig.cameras.genicam`.
"""

import contextlib
import importlib
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError, NotConnected, RigFileError
from anisoscope.rig.camera import CameraInfo
from anisoscope.rig.cameras.genicam import Features, GenicamCamera, Value, assign, check_options, prepare
from anisoscope.rig.cameras.pixelformats import FORMATS


def load_pylon() -> Any:
    """The module ``pypylon.pylon``.

    Raises:
        CameraError: it is not installed, or does not load.
    """
    return _load("pypylon.pylon")


def load_genicam() -> Any:
    """The module ``pypylon.genicam``; errors as for `load_pylon`."""
    return _load("pypylon.genicam")


def _load(module: str) -> Any:
    try:
        with warnings.catch_warnings():
            # Its compiled part warns of itself, and dies where warnings are errors.
            warnings.simplefilter("ignore", DeprecationWarning)
            return importlib.import_module(module)
    except ImportError as problem:
        raise CameraError(
            f"Basler cameras need pypylon: pip install 'anisoscope[basler]' ({problem})"
        ) from problem


def find_device(pylon: Any, serial: str, name: str) -> Any:
    """Create the device with a serial number, a user-defined name, or both; the only one if neither is given.

    Raises:
        NotConnected: no such camera, more than one, or in use elsewhere; the cameras found are listed.
    """
    try:
        return _create(pylon.TlFactory.GetInstance(), serial, name)
    except load_genicam().GenericException as problem:
        raise NotConnected(f"Basler's SDK finds no camera: {one_line(str(problem))}") from problem


def one_line(text: str) -> str:
    """Error text of the SDK without its source location."""
    return " ".join(text.split(" : ", maxsplit=1)[0].split()).rstrip(". ")


def _create(factory: Any, serial: str, name: str) -> Any:
    devices = list(factory.EnumerateDevices())
    fitting = [
        device
        for device in devices
        if serial in {"", device.GetSerialNumber()} and name in {"", device.GetUserDefinedName()}
    ]
    requested = " and ".join(
        f"{what} '{value}'" for what, value in (("serial number", serial), ("name", name)) if value
    )
    connected = ", ".join(_called(device) for device in devices) or "none"
    if not fitting:
        raise NotConnected(
            f"there is no Basler camera{f' with {requested}' if requested else ''}; found: {connected}"
        )
    if len(fitting) > 1:
        raise NotConnected(
            f"there are {len(fitting)} Basler cameras{f' with {requested}' if requested else ''}; name one by "
            f"camera.options.serial: {connected}"
        )
    if not factory.IsDeviceAccessible(fitting[0]):
        raise NotConnected(f"{_called(fitting[0])} is in use by another program")
    return factory.CreateDevice(fitting[0])


def _called(device: Any) -> str:
    name = device.GetUserDefinedName()
    return f"{device.GetModelName()} {device.GetSerialNumber()}" + (f" '{name}'" if name else "")


_BLACK_LEVEL_BITS = 12


class PylonFeatures:
    """The features of a device of pypylon; see `anisoscope.rig.cameras.genicam.Features`."""

    def __init__(self, device: Any) -> None:
        self._device, self._genicam = device, load_genicam()

    def _node(self, name: str) -> Any:
        try:
            node = getattr(self._device, name)
        except (AttributeError, self._genicam.LogicalErrorException):
            return None
        return node if self._genicam.IsReadable(node) else None

    def readable(self, name: str) -> bool:
        """Whether there is such a feature and it can be read now."""
        return self._node(name) is not None

    def writable(self, name: str) -> bool:
        """Whether the feature can be set now."""
        return bool(self._genicam.IsWritable(getattr(self._device, name)))

    def get(self, name: str) -> Value:
        """Its value; of an enumeration the name of the entry."""
        value: Value = getattr(self._device, name).Value
        return value

    def set(self, name: str, value: Value) -> None:
        """Set it, without reading it back."""
        getattr(self._device, name).Value = value

    def bounds(self, name: str) -> tuple[float, float]:
        """Least and largest value of a number."""
        node = getattr(self._device, name)
        return node.Min, node.Max

    def step(self, name: str) -> int:
        """Distance of the values of a whole number."""
        return int(getattr(self._device, name).Inc)

    def choices(self, name: str) -> tuple[str, ...]:
        """Names of the entries of an enumeration; empty for anything else."""
        node = self._node(name)
        return tuple(getattr(node, "Symbolics", ()))

    def execute(self, name: str) -> None:
        """Execute a command."""
        getattr(self._device, name).Execute()


def read_black_level(features: Features, pixel_format: str) -> float:
    """Counts of a pixel without light, as the camera states them (in counts of 12 bits); 0 if it does not."""
    for name in ("BlackLevel", "BlackLevelAbs"):
        if features.readable(name):
            return float(features.get(name)) * 2.0 ** (FORMATS[pixel_format].bits - _BLACK_LEVEL_BITS)
    return 0.0


def show_image_file(features: Features, path: Path) -> None:
    """Make the maker's emulated camera show a picture; it is read again for every frame.

    Raises:
        RigFileError: there is no such file, or the camera is a real one.
    """
    if not path.is_file():
        raise RigFileError(f"camera.options.image_file: there is no file {path}")
    if not features.readable("ImageFilename"):
        raise RigFileError(
            "camera.options.image_file: only the emulated camera shows a file; this one is real"
        )
    assign(features, "TestImageSelector", "Off")
    assign(features, "ImageFilename", str(path.resolve()), needed=True)
    assign(features, "ImageFileMode", "On", needed=True)


class BaslerCamera(GenicamCamera):
    """A Basler camera that takes single frames."""

    def __init__(self, pylon: Any, device: Any, info: CameraInfo, *, retries: int, timeout_s: float) -> None:
        super().__init__(PylonFeatures(device), info, retries=retries, timeout_s=timeout_s)
        self._pylon = pylon
        self._device = device

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
        features: str = "",
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
            features: further features by name, as ``ReverseX=1``.
            image_file: picture that the maker's emulated camera shows (TIFF or PNG, 16 bits left-justified).

        Raises:
            RigFileError: an option that makes no sense.
            NotConnected: no such camera, or in use elsewhere.
            CameraError: pypylon is not installed, or the camera refuses a setting.
        """
        check_options(pixel_format, retries, timeout_s)
        pylon = load_pylon()
        device = pylon.InstantCamera(find_device(pylon, serial, name))
        try:
            with _sdk_errors(device, "the camera"):
                device.Open()
                settings = PylonFeatures(device)
                if image_file:
                    show_image_file(settings, Path(image_file))
                used = prepare(settings, pixel_format, (height, width), features)
                level = read_black_level(settings, used) if black_level is None else black_level
            found = device.GetDeviceInfo()
            info = CameraInfo(
                model=str(found.GetModelName()),
                serial=str(found.GetSerialNumber()),
                rows=int(device.Height.Value),
                cols=int(device.Width.Value),
                bit_depth=FORMATS[used].bits,
                black_level=level,
                filters=FORMATS[used].filters,
            )
        except BaseException:
            _close(device)
            raise
        return cls(pylon, device, info, retries=retries, timeout_s=timeout_s)

    def _errors(self) -> contextlib.AbstractContextManager[None]:
        return _sdk_errors(self._device, self._name)

    def _is_gone(self) -> bool:
        return bool(self._device.IsCameraDeviceRemoved())

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
def _sdk_errors(device: Any, name: str) -> Iterator[None]:
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
