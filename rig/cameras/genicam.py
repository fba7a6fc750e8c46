"""What cameras with GenICam feature names have in common: plain pictures, settings read back, single frames.

Every frame is triggered by software when it is asked for, so that a frame from before the last change of exposure, gain
or pose cannot come. Automatic functions are off, gamma is 1, and what is set is read back.

Features go by their names in the Standard Features Naming Convention (SFNC 2.7), with the older GigE names. What a
camera does not have is passed over; what it has is set and read back.
"""

import abc
import contextlib
import logging
import math
from collections.abc import Iterable
from typing import Protocol

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError, NotConnected, RigFileError
from anisoscope.rig.camera import CameraInfo, CameraSettings
from anisoscope.rig.cameras import pixelformats

EXPOSURE_TOLERANCE = 0.05
GAIN_TOLERANCE_DB = 0.2
Value = str | float | bool
_LOG = logging.getLogger(__name__)


class Features(Protocol):
    """The features of a camera, by name."""

    def readable(self, name: str) -> bool:
        """Whether there is such a feature and it can be read now."""
        ...

    def writable(self, name: str) -> bool:
        """Whether the feature can be set now."""
        ...

    def get(self, name: str) -> Value:
        """Its value; of an enumeration the name of the entry."""
        ...

    def set(self, name: str, value: Value) -> None:
        """Set it, without reading it back."""
        ...

    def bounds(self, name: str) -> tuple[float, float]:
        """Least and largest value of a number."""
        ...

    def step(self, name: str) -> int:
        """Distance of the values of a whole number."""
        ...

    def choices(self, name: str) -> tuple[str, ...]:
        """Names of the entries of an enumeration; empty for anything else."""
        ...

    def execute(self, name: str) -> None:
        """Execute a command."""
        ...


# Everything that bends the curve of counts against light, or that changes by itself.
_PLAIN: tuple[tuple[str, Value], ...] = (
    ("ExposureAuto", "Off"),
    ("GainAuto", "Off"),
    ("BalanceWhiteAuto", "Off"),
    ("BlackLevelAuto", "Off"),
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


def prepare(
    features: Features, pixel_format: str, size: tuple[int, int], wanted: str = "", *, triggered: bool = True
) -> str:
    """Set up single frames of raw counts, triggered by software. Returns the pixel format.

    Args:
        features: those of the camera.
        pixel_format: the format that is asked for; see `anisoscope.rig.cameras.pixelformats.choose`.
        size: (rows, cols), in the middle of the sensor; 0 for all.
        wanted: further features, as ``ReverseX=1, BinningHorizontal=2``; they are set first.
        triggered: False leaves all triggers off.

    Raises:
        CameraError: the camera refuses a setting.
        RigFileError: `wanted` cannot be read, or the camera has no such size.
    """
    for name, value in _PLAIN:
        assign(features, name, value)
    for name, text in _pairs(wanted):
        _assign_text(features, name, text)
    used = pixelformats.choose(pixel_format, features.choices("PixelFormat"))
    if used != pixel_format:
        _LOG.warning("the camera has no %s: %s is used", pixel_format, used)
    assign(features, "PixelFormat", used, needed=True)
    coloured = pixelformats.FORMATS[used].filters != "mono"
    if coloured:
        _set_even_white(features)
    _set_size(features, size, even=coloured)
    assign(features, "AcquisitionMode", "Continuous")
    for choice in features.choices("TriggerSelector"):
        features.set("TriggerSelector", choice)
        assign(features, "TriggerMode", "Off")
    if not triggered:
        return used
    assign(features, "TriggerSelector", "FrameStart")
    assign(features, "TriggerSource", "Software", needed=True)
    assign(features, "TriggerMode", "On", needed=True)
    return used


def assign(features: Features, name: str, value: Value, *, needed: bool = False) -> None:
    """Set a feature and read it back; what the camera does not have is passed over unless it is needed.

    Raises:
        CameraError: the camera lacks a feature that is needed, or does not take the value.
    """
    if not features.readable(name):
        if needed:
            raise CameraError(f"the camera has no setting {name}; it cannot be used")
        return
    if features.get(name) == value:
        return
    choices = features.choices(name)
    if choices and value not in choices:
        if needed:
            raise CameraError(f"the camera does not know {name} = {value}; it cannot be used")
        return
    if not features.writable(name):
        raise CameraError(f"{name} stands at {features.get(name)} and cannot be set to {value}")
    features.set(name, value)
    if features.get(name) != value:
        raise CameraError(f"{name} = {value} was asked for, the camera took {features.get(name)}")


def set_exposure(features: Features, exposure_s: float) -> float:
    """Set the exposure; returns what the camera took, in seconds.

    Raises:
        CameraError: out of range, or the camera took another one by more than 5 %.
    """
    name = _first(features, ("ExposureTime", "ExposureTimeAbs"))
    if not name:
        raise CameraError("the camera has no node for its exposure time")
    low, high = features.bounds(name)
    low_s, high_s = low * 1e-6, high * 1e-6
    if not low_s <= exposure_s <= high_s:
        raise CameraError(f"the exposure must lie between {low_s:g} s and {high_s:g} s, not {exposure_s:g} s")
    features.set(name, exposure_s * 1e6)
    real_s = float(features.get(name)) * 1e-6
    if abs(real_s - exposure_s) > EXPOSURE_TOLERANCE * exposure_s:
        raise CameraError(f"an exposure of {exposure_s:g} s was asked for, the camera took {real_s:g} s")
    return real_s


def set_gain(features: Features, gain: float) -> float:
    """Set the gain, a factor; returns the factor that the camera took. Features of gain count in dB.

    A camera whose gain is only a number of its own (GainRaw) takes gain 1, at the lowest of these numbers.

    Raises:
        CameraError: out of range, or the camera took another one by more than 0.2 dB.
    """
    assign(features, "GainSelector", "All")
    name = _first(features, ("Gain", "GainAbs"))
    if not name:
        return _lowest_gain(features, gain)
    least, most = features.bounds(name)
    low, high = _factor(least), _factor(most)
    requested_db = 20.0 * math.log10(gain) if gain > 0.0 else -math.inf
    slack_db = 1e-6
    if not least - slack_db <= requested_db <= most + slack_db:
        raise CameraError(f"the gain must lie between {low:.4g} and {high:.4g}, not {gain:g}")
    features.set(name, min(max(requested_db, least), most))
    real_db = float(features.get(name))
    if abs(real_db - requested_db) > GAIN_TOLERANCE_DB:
        raise CameraError(f"a gain of {requested_db:.2f} dB was asked for, the camera took {real_db:.2f} dB")
    return _factor(real_db)


def _lowest_gain(features: Features, gain: float) -> float:
    if gain != 1.0:
        raise CameraError(f"the camera has no gain in dB: ask for gain 1, not {gain:g}")
    if features.readable("GainRaw"):
        assign(features, "GainRaw", int(features.bounds("GainRaw")[0]))
    return 1.0


def _factor(gain_db: float) -> float:
    return float(10.0 ** (gain_db / 20.0))


def _first(features: Features, names: Iterable[str]) -> str:
    return next((name for name in names if features.readable(name)), "")


def _pairs(wanted: str) -> list[tuple[str, str]]:
    pairs = [part.partition("=") for part in wanted.split(",") if part.strip()]
    if not all(name.strip() and sign and text.strip() for name, sign, text in pairs):
        raise RigFileError(f"camera.options.features: expected NAME=VALUE, NAME=VALUE, not '{wanted}'")
    return [(name.strip(), text.strip()) for name, _, text in pairs]


def _assign_text(features: Features, name: str, text: str) -> None:
    """Set a feature to a value of a rig file, in the feature's type."""
    where = f"camera.options.features: {name}"
    if not features.readable(name):
        raise RigFileError(f"{where}: the camera has no such feature")
    old = features.get(name)
    try:
        if isinstance(old, bool):
            value: Value = {"true": True, "1": True, "false": False, "0": False}[text.lower()]
        else:
            value = type(old)(text)
    except (KeyError, ValueError):
        raise RigFileError(f"{where}: '{text}' is not of its type ({type(old).__name__})") from None
    choices = features.choices(name)
    if choices and value not in choices:
        raise RigFileError(f"{where}: '{text}' is none of {', '.join(choices)}")
    if not choices and not isinstance(old, str | bool):
        low, high = features.bounds(name)
        if not low <= float(value) <= high:
            raise RigFileError(f"{where}: must lie between {low:g} and {high:g}, not {text}")
    assign(features, name, value)


def _set_even_white(features: Features) -> None:
    """Counts as they are read out: no colour amplified against another."""
    for name in ("LightSourcePreset", "BslLightSourcePreset", "LightSourceSelector"):
        assign(features, name, "Off")
    for choice in features.choices("BalanceRatioSelector"):
        features.set("BalanceRatioSelector", choice)
        assign(features, "BalanceRatio", 1.0)
        assign(features, "BalanceRatioAbs", 1.0)


def _set_size(features: Features, size: tuple[int, int], *, even: bool) -> None:
    """Set the size; `even` keeps the offset even, so that the mosaic begins with the same filter."""
    for name, offset, requested in (("Height", "OffsetY", size[0]), ("Width", "OffsetX", size[1])):
        assign(features, offset, 0)
        low, high = (int(number) for number in features.bounds(name))
        step = features.step(name)
        target = requested or high
        if not low <= target <= high or (target - low) % step:
            raise RigFileError(
                f"camera.options.{name.lower()}: must lie between {low} and {high} in steps of {step}, not {target}"
            )
        assign(features, name, target, needed=True)
        if requested and features.readable(offset):
            middle = int(features.bounds(offset)[1]) // 2
            stride = math.lcm(features.step(offset), 2 if even else 1)
            assign(features, offset, middle - middle % stride)


def check_options(pixel_format: str, retries: int, timeout_s: float) -> None:
    """Check the options that all of these cameras have.

    Raises:
        RigFileError: one of them makes no sense.
    """
    if pixel_format not in pixelformats.FORMATS:
        raise RigFileError(
            "camera.options.pixel_format: expected Mono12, Mono10, Mono8 or the raw format of a colour camera, "
            f"such as BayerRG12, not '{pixel_format}'"
        )
    if retries < 0 or timeout_s <= 0.0:
        raise RigFileError("camera.options: retries must be 0 or more, and timeout_s above 0")


class GenicamCamera(abc.ABC):
    """A camera that takes single frames, each triggered by software.

    Attributes:
        info: what is fixed about it.
        failed_buffers: frames that came incomplete, or not at all, since the camera was opened.
    """

    def __init__(self, features: Features, info: CameraInfo, *, retries: int, timeout_s: float) -> None:
        self.info = info
        self.failed_buffers = 0
        self._features = features
        self._name = f"{info.model} {info.serial}"
        self._retries, self._timeout_s = retries, timeout_s
        self._settings: CameraSettings | None = None

    def configure(self, exposure_s: float, gain: float) -> CameraSettings:
        """Set exposure in seconds and gain as a factor; returns what the camera reports afterwards.

        Raises:
            CameraError: outside of the camera's range, or the camera took something else.
            NotConnected: the camera has gone.
        """
        self._settings = None
        with self._errors():
            self._settings = CameraSettings(
                set_exposure(self._features, exposure_s), set_gain(self._features, gain)
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
        with self._errors():
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
                if self._is_gone():
                    raise NotConnected(f"{self._name} was unplugged")
        raise CameraError(
            f"{self._name}: no complete frame in {self._retries + 1} attempts: {reason}; "
            "check cable, hub and network load"
        )

    @abc.abstractmethod
    def _errors(self) -> contextlib.AbstractContextManager[None]:
        """Turns the library's exceptions into ours."""

    @abc.abstractmethod
    def _attempt(self, exposure_s: float) -> tuple[npt.NDArray[np.uint16] | None, str]:
        """One frame, or the reason why there is none."""

    @abc.abstractmethod
    def _is_gone(self) -> bool:
        """Whether the camera is known to be unplugged."""

    @abc.abstractmethod
    def close(self) -> None:
        """Disconnect; closing twice is fine."""
