# ruff: noqa: ANN401 - pypylon has no types
"""Basler cameras, by the maker's pypylon (``pip install 'anisoscope[basler]'``).

Every frame is an acquisition of its own: started, triggered by software and stopped when the frame is asked
for, so that a frame from before the last change of exposure, gain or pose cannot come. Automatic functions are
off, gamma is 1, and what is set is read back.

Settings go by their names in the node map (GenICam SFNC, with the older GigE names). What a camera does not have is
passed over; what it has is set and read back.
"""

import contextlib
import importlib
import logging
import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError, NotConnected, RigFileError
from anisoscope.rig.camera import CameraInfo, CameraSettings


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


_MOSAICS = {"BayerRG": "rggb", "BayerGR": "grbg", "BayerGB": "gbrg", "BayerBG": "bggr"}
BITS = {f"{kind}{bits}": bits for kind in ("Mono", *_MOSAICS) for bits in (12, 10, 8)}
FILTERS = {name: _MOSAICS.get(name.rstrip("0128"), "mono") for name in BITS}
"""Colour filters by pixel format; the letters of a Bayer format are the first two pixels of the picture."""
EXPOSURE_TOLERANCE = 0.05
GAIN_TOLERANCE_DB = 0.2
_BLACK_LEVEL_BITS = 12
_LOG = logging.getLogger(__name__)

# Everything that bends the curve of counts against light, or that changes by itself.
_PLAIN: tuple[tuple[str, str | float | bool], ...] = (
    ("ExposureAuto", "Off"),
    ("GainAuto", "Off"),
    ("BalanceWhiteAuto", "Off"),
    ("BslBlackLevelAuto", "Off"),
    ("ExposureMode", "Timed"),
    ("GammaEnable", False),
    ("Gamma", 1.0),
    ("LUTEnable", False),
    ("DigitalShift", 0),
    ("BslContrast", 0.0),
    ("BslBrightness", 0.0),
    ("BslSharpnessEnhancement", 0.0),
    ("BslNoiseReduction", 0.0),
    ("AcquisitionFrameRateEnable", False),
)


def prepare(device: Any, pixel_format: str, size: tuple[int, int]) -> str:
    """Set up single frames of raw counts; `size` is (rows, cols), 0 for all. Returns the pixel format.

    Raises:
        CameraError: the camera refuses a setting.
    """
    for name, value in _PLAIN:
        _set(device, name, value)
    used = _set_pixel_format(device, pixel_format)
    coloured = FILTERS[used] != "mono"
    if coloured:
        _set_even_white(device)
    _set_size(device, size, even=coloured)
    _set(device, "AcquisitionMode", "Continuous")
    selector = _node(device, "TriggerSelector")
    if selector is not None:
        for choice in selector.Symbolics:
            selector.Value = choice
            _set(device, "TriggerMode", "Off")
        _set(device, "TriggerSelector", "FrameStart")
    _set(device, "TriggerSource", "Software", needed=True)
    _set(device, "TriggerMode", "On", needed=True)
    return used


def set_exposure(device: Any, exposure_s: float) -> float:
    """Set the exposure; returns what the camera took, in seconds.

    Raises:
        CameraError: out of range, or the camera took another one by more than 5 %.
    """
    node = _node(device, "ExposureTime") or _node(device, "ExposureTimeAbs")
    if node is None:
        raise CameraError("the camera has no node for its exposure time")
    low_s, high_s = node.Min * 1e-6, node.Max * 1e-6
    if not low_s <= exposure_s <= high_s:
        raise CameraError(f"the exposure must lie between {low_s:g} s and {high_s:g} s, not {exposure_s:g} s")
    node.Value = exposure_s * 1e6
    real_s = float(node.Value) * 1e-6
    if abs(real_s - exposure_s) > EXPOSURE_TOLERANCE * exposure_s:
        raise CameraError(f"an exposure of {exposure_s:g} s was asked for, the camera took {real_s:g} s")
    return real_s


def set_gain(device: Any, gain: float) -> float:
    """Set the gain, a factor; returns the factor that the camera took. Nodes of gain count in dB.

    Raises:
        CameraError: out of range, or the camera took another one by more than 0.2 dB.
    """
    _set(device, "GainSelector", "All")
    node = _node(device, "Gain") or _node(device, "GainAbs")
    if node is None:
        raise CameraError("the camera has no node for its gain in dB")
    low, high = _factor(node.Min), _factor(node.Max)
    requested_db = 20.0 * math.log10(gain) if gain > 0.0 else -math.inf
    slack_db = 1e-6
    if not node.Min - slack_db <= requested_db <= node.Max + slack_db:
        raise CameraError(f"the gain must lie between {low:.4g} and {high:.4g}, not {gain:g}")
    node.Value = min(max(requested_db, node.Min), node.Max)
    real_db = float(node.Value)
    if abs(real_db - requested_db) > GAIN_TOLERANCE_DB:
        raise CameraError(f"a gain of {requested_db:.2f} dB was asked for, the camera took {real_db:.2f} dB")
    return _factor(real_db)


def read_black_level(device: Any, pixel_format: str) -> float:
    """Counts of a pixel without light, as the camera states them (in counts of 12 bits); 0 if it does not."""
    node = _node(device, "BlackLevel") or _node(device, "BlackLevelAbs")
    if node is None:
        return 0.0
    return float(node.Value) * 2.0 ** (BITS[pixel_format] - _BLACK_LEVEL_BITS)


def show_image_file(device: Any, path: Path) -> None:
    """Make the maker's emulated camera show a picture; it is read again for every frame.

    Raises:
        RigFileError: there is no such file, or the camera is a real one.
    """
    if not path.is_file():
        raise RigFileError(f"camera.options.image_file: there is no file {path}")
    if _node(device, "ImageFilename") is None:
        raise RigFileError(
            "camera.options.image_file: only the emulated camera shows a file; this one is real"
        )
    _set(device, "TestImageSelector", "Off")
    _set(device, "ImageFilename", str(path.resolve()), needed=True)
    _set(device, "ImageFileMode", "On", needed=True)


def _factor(gain_db: float) -> float:
    return float(10.0 ** (gain_db / 20.0))


def _node(device: Any, name: str) -> Any:
    """A node that can be read, or None."""
    genicam = load_genicam()

    try:
        node = getattr(device, name)
    except (AttributeError, genicam.LogicalErrorException):
        return None
    return node if genicam.IsReadable(node) else None


def _set(device: Any, name: str, value: str | float | bool, *, needed: bool = False) -> None:
    genicam = load_genicam()

    node = _node(device, name)
    if node is None:
        if needed:
            raise CameraError(f"the camera has no setting {name}; it cannot be used")
        return
    if node.Value == value:
        return
    if isinstance(value, str) and hasattr(node, "Symbolics") and value not in node.Symbolics:
        if needed:
            raise CameraError(f"the camera does not know {name} = {value}; it cannot be used")
        return
    if not genicam.IsWritable(node):
        raise CameraError(f"{name} stands at {node.Value} and cannot be set to {value}")
    node.Value = value
    if node.Value != value:
        raise CameraError(f"{name} = {value} was asked for, the camera took {node.Value}")


def _set_pixel_format(device: Any, pixel_format: str) -> str:
    offered = device.PixelFormat.Symbolics
    target: list[str] = [pixel_format] + (["Mono8"] if FILTERS[pixel_format] == "mono" else [])
    for candidate in target:
        if candidate in offered:
            if candidate != pixel_format:
                _LOG.warning("the camera has no %s: %s is used", pixel_format, candidate)
            _set(device, "PixelFormat", candidate, needed=True)
            return candidate
    raise CameraError(
        f"the camera has no {' nor '.join(dict.fromkeys(target))}, only {', '.join(offered)}; choose one of "
        f"{', '.join(BITS)}"
    )


def _set_even_white(device: Any) -> None:
    """Counts as they are read out: no colour amplified against another."""
    for name in ("LightSourcePreset", "BslLightSourcePreset", "LightSourceSelector"):
        _set(device, name, "Off")
    selector = _node(device, "BalanceRatioSelector")
    if selector is not None:
        for choice in selector.Symbolics:
            selector.Value = choice
            _set(device, "BalanceRatio", 1.0)
            _set(device, "BalanceRatioAbs", 1.0)


def _set_size(device: Any, size: tuple[int, int], *, even: bool) -> None:
    """Set the size; `even` keeps the offset even, so that the mosaic begins with the same filter."""
    for name, offset, requested in (("Height", "OffsetY", size[0]), ("Width", "OffsetX", size[1])):
        _set(device, offset, 0)
        node = getattr(device, name)
        target = requested or node.Max
        if not node.Min <= target <= node.Max or (target - node.Min) % node.Inc:
            raise RigFileError(
                f"camera.options.{name.lower()}: must lie between {node.Min} and {node.Max} in steps of "
                f"{node.Inc}, not {target}"
            )
        _set(device, name, target, needed=True)
        shift = _node(device, offset)
        if requested and shift is not None:
            middle, step = shift.Max // 2, math.lcm(shift.Inc, 2 if even else 1)
            _set(device, offset, middle - middle % step)


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
            NotConnected: no such camera, or in use elsewhere.
            CameraError: pypylon is not installed, or the camera refuses a setting.
        """
        if pixel_format not in BITS:
            raise RigFileError(
                "camera.options.pixel_format: expected Mono12, Mono10, Mono8 or the raw format of a colour camera, "
                f"such as BayerRG12, not '{pixel_format}'"
            )
        if retries < 0 or timeout_s <= 0.0:
            raise RigFileError("camera.options: retries must be 0 or more, and timeout_s above 0")
        pylon = load_pylon()
        device = pylon.InstantCamera(find_device(pylon, serial, name))
        try:
            with _sdk_errors(device, "the camera"):
                device.Open()
                if image_file:
                    show_image_file(device, Path(image_file))
                used = prepare(device, pixel_format, (height, width))
                level = read_black_level(device, used) if black_level is None else black_level
            found = device.GetDeviceInfo()
            info = CameraInfo(
                model=str(found.GetModelName()),
                serial=str(found.GetSerialNumber()),
                rows=int(device.Height.Value),
                cols=int(device.Width.Value),
                bit_depth=BITS[used],
                black_level=level,
                filters=FILTERS[used],
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
        with _sdk_errors(self._device, self._name):
            self._settings = CameraSettings(
                set_exposure(self._device, exposure_s), set_gain(self._device, gain)
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
        with _sdk_errors(self._device, self._name):
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
