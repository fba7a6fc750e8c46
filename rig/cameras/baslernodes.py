# ruff: noqa: ANN401 - pypylon has no types
"""The settings of a Basler camera, by name in its node map (GenICam SFNC, with the older GigE names).

What a camera does not have is passed over; what it has is set and read back.
"""

import logging
import math
from pathlib import Path
from typing import Any

from anisoscope.base.errors import CameraError, RigFileError
from anisoscope.rig.cameras.baslersdk import load_genicam

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
    asked_db = 20.0 * math.log10(gain) if gain > 0.0 else -math.inf
    slack_db = 1e-6
    if not node.Min - slack_db <= asked_db <= node.Max + slack_db:
        raise CameraError(f"the gain must lie between {low:.4g} and {high:.4g}, not {gain:g}")
    node.Value = min(max(asked_db, node.Min), node.Max)
    real_db = float(node.Value)
    if abs(real_db - asked_db) > GAIN_TOLERANCE_DB:
        raise CameraError(f"a gain of {asked_db:.2f} dB was asked for, the camera took {real_db:.2f} dB")
    return _factor(real_db)


def black_level(device: Any, pixel_format: str) -> float:
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
    wanted: list[str] = [pixel_format] + (["Mono8"] if FILTERS[pixel_format] == "mono" else [])
    for candidate in wanted:
        if candidate in offered:
            if candidate != pixel_format:
                _LOG.warning("the camera has no %s: %s is used", pixel_format, candidate)
            _set(device, "PixelFormat", candidate, needed=True)
            return candidate
    raise CameraError(
        f"the camera has no {' nor '.join(dict.fromkeys(wanted))}, only {', '.join(offered)}; choose one of "
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
    for name, offset, asked in (("Height", "OffsetY", size[0]), ("Width", "OffsetX", size[1])):
        _set(device, offset, 0)
        node = getattr(device, name)
        wanted = asked or node.Max
        if not node.Min <= wanted <= node.Max or (wanted - node.Min) % node.Inc:
            raise RigFileError(
                f"camera.options.{name.lower()}: must lie between {node.Min} and {node.Max} in steps of "
                f"{node.Inc}, not {wanted}"
            )
        _set(device, name, wanted, needed=True)
        shift = _node(device, offset)
        if asked and shift is not None:
            middle, step = shift.Max // 2, math.lcm(shift.Inc, 2 if even else 1)
            _set(device, offset, middle - middle % step)
