# ruff: noqa: ANN401 - pypylon has no types
"""Finding a Basler camera, and the SDK itself, which is an extra."""

import importlib
import warnings
from typing import Any

from anisoscope.base.errors import CameraError, NotConnected


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
        NotConnected: no such camera, more than one, or somebody else uses it; those that are there are listed.
    """
    try:
        return _create(pylon.TlFactory.GetInstance(), serial, name)
    except load_genicam().GenericException as problem:
        raise NotConnected(f"Basler's SDK finds no camera: {one_line(str(problem))}") from problem


def one_line(text: str) -> str:
    """What the SDK says, without the place in its sources."""
    return " ".join(text.split(" : ", maxsplit=1)[0].split()).rstrip(". ")


def _create(factory: Any, serial: str, name: str) -> Any:
    devices = list(factory.EnumerateDevices())
    fitting = [
        device
        for device in devices
        if serial in {"", device.GetSerialNumber()} and name in {"", device.GetUserDefinedName()}
    ]
    asked = " and ".join(
        f"{what} '{value}'" for what, value in (("serial number", serial), ("name", name)) if value
    )
    there = ", ".join(_called(device) for device in devices) or "none"
    if not fitting:
        raise NotConnected(f"there is no Basler camera{f' with {asked}' if asked else ''}; found: {there}")
    if len(fitting) > 1:
        raise NotConnected(
            f"there are {len(fitting)} Basler cameras{f' with {asked}' if asked else ''}; name one by "
            f"camera.options.serial: {there}"
        )
    if not factory.IsDeviceAccessible(fitting[0]):
        raise NotConnected(f"{_called(fitting[0])} is in use by another program")
    return factory.CreateDevice(fitting[0])


def _called(device: Any) -> str:
    name = device.GetUserDefinedName()
    return f"{device.GetModelName()} {device.GetSerialNumber()}" + (f" '{name}'" if name else "")
