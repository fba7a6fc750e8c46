"""Devices by name. Entry points name them, so that a third party's driver registers like a built-in one."""

from collections.abc import Callable
from inspect import Parameter, signature
from typing import cast

from anisoscope.base.errors import RigFileError
from anisoscope.base.plugins import installed
from anisoscope.rig.camera import Camera
from anisoscope.rig.light import FilterWheel, Light
from anisoscope.rig.stage import RotationStage

STAGES = "anisoscope.stages"
CAMERAS = "anisoscope.cameras"
LIGHTS = "anisoscope.lights"
WHEELS = "anisoscope.wheels"


def open_stage(name: str, *, table: str = "stage", **options: object) -> RotationStage:
    """Connect to a stage.

    Args:
        name: name of the driver.
        table: table of the rig file that names it, for error messages.
        options: what the driver takes; a `port` of None counts as not given.

    Raises:
        RigFileError: no such driver is installed, or it does not know an option.
        NotConnected: the driver does not find its device.
    """
    if options.get("port") is None:
        options.pop("port", None)
    return cast("RotationStage", _open(STAGES, table, name, options))


def open_camera(name: str, **options: object) -> Camera:
    """Connect to a camera; errors as for `open_stage`."""
    return cast("Camera", _open(CAMERAS, "camera", name, options))


def open_light(name: str, **options: object) -> Light:
    """Connect to a light; options and errors as for `open_stage`."""
    if options.get("port") is None:
        options.pop("port", None)
    return cast("Light", _open(LIGHTS, "light", name, options))


def open_wheel(name: str, **options: object) -> FilterWheel:
    """Connect to a filter wheel; options and errors as for `open_stage`."""
    if options.get("port") is None:
        options.pop("port", None)
    return cast("FilterWheel", _open(WHEELS, "light.wheel", name, options))


def _open(group: str, table: str, name: str, options: dict[str, object]) -> object:
    what = group.rpartition(".")[2].removesuffix("s")
    drivers = installed(group)
    if name not in drivers:
        names = ", ".join(drivers) or "none"
        raise RigFileError(f"{table}.driver: there is no {what} driver '{name}'; installed: {names}")
    try:
        driver = drivers[name].load()
    except ImportError as problem:
        raise RigFileError(f"{table}.driver: the driver '{name}' does not load: {problem}") from problem
    opener = getattr(driver, "open", driver)
    if "port" not in options and _needs_port(opener):
        raise RigFileError(f"{table}.port: missing; the driver '{name}' needs one")
    try:
        signature(opener).bind(**options)
        return opener(**options)
    except TypeError as problem:
        raise RigFileError(f"{table}.options: the driver '{name}' does not take them: {problem}") from problem


def _needs_port(opener: Callable[..., object]) -> bool:
    port = signature(opener).parameters.get("port")
    return port is not None and port.default is Parameter.empty
