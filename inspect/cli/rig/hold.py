"""``anisoscope rig hold``: keep axes, camera and light of a rig open, for other commands of this machine."""

import contextlib
import os
import sys
import threading
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import CameraError, NotConnected, UsageError
from anisoscope.base.language import message
from anisoscope.cli.rig.options import NOTHING_NAMED, Which, Yes, home_axes, write_line

if TYPE_CHECKING:
    from anisoscope.rig.acquisition.opening import Devices
    from anisoscope.rig.camera import Camera
    from anisoscope.rig.hold import Owner
    from anisoscope.rig.rigfile import CameraPart, RigAxes


def hold(
    *,
    which: Annotated[Which, Parameter(name="*")] = NOTHING_NAMED,
    home: Annotated[
        bool, Parameter(negative="", help="Search the reference of every axis first: confirm, or give --yes.")
    ] = False,
    yes: Yes = False,
) -> int:
    """Keep axes, camera and light of a rig open until q and Enter or Ctrl-C; other commands on this machine use them.

    Their references stay known, so nothing homes twice, `rig stop` reaches the axes at once, and several commands take
    pictures at the same time, each with its own exposure. Enter stops all axes.

    Examples:
        anisoscope rig hold --rig rig.toml --home
    """
    from anisoscope.rig.acquisition.opening import open_devices
    from anisoscope.rig.hold import ASKING, Owner, is_held

    file, axes = which.read()
    axes = {table: part for table, part in axes.items() if part.driver not in ASKING}
    if not axes:
        raise UsageError("nothing can be held: an axis needs a motor")
    light = None if file is None or file.light is None or file.light.driver in ASKING else file.light
    eye = None if file is None else file.camera
    if any(is_held(part) for part in (*axes.values(), light, eye) if part is not None):
        raise UsageError("another process holds this rig already; end it with q in its window")
    with open_devices(axes, light=light, rows_of=file) as devices, contextlib.ExitStack() as stack:
        camera, missing = _camera_of(eye, stack)
        if home:
            home_axes(devices.axes, axes, file, yes=yes)
        served = {table: (axes[table], axis) for table, axis in devices.axes.items()}
        lamp = None if light is None or devices.light is None else (light, devices.light)
        shared = None if eye is None or camera is None else (eye, camera)
        with Owner(served, lamp, "" if which.rig is None else str(which.rig.resolve()), shared) as owner:
            held = [message("light")] * (lamp is not None) + [message("camera")] * (shared is not None)
            _announce(devices, held)
            free = [missing] * bool(missing) + [message("light")] * (lamp is None and _has_light(file))
            if free:
                write_line(
                    message("not held: {names}; every command opens them itself", names=", ".join(free))
                )
            with contextlib.suppress(KeyboardInterrupt):
                _listen(owner)
    return 0


def _has_light(file: "RigAxes | None") -> bool:
    return file is not None and file.light is not None


def _camera_of(part: "CameraPart | None", stack: contextlib.ExitStack) -> "tuple[Camera | None, str]":
    """The open camera; where it does not open, None and why: the axes are held all the same."""
    from anisoscope.rig.acquisition.opening import open_eye

    if part is None:
        return None, ""
    try:
        camera = open_eye(part)
    except (NotConnected, CameraError) as problem:
        return None, f"{message('camera')} ({problem})"
    stack.callback(camera.close)
    return camera, ""


def _announce(devices: "Devices", others: list[str]) -> None:
    names = [f"{table} {axis.name}" for table, axis in devices.axes.items()] + others
    print(message("holding {names} for other commands", names=", ".join(names)), flush=True)  # noqa: T201
    write_line(message("Enter stops all axes; q and Enter, or Ctrl-C, ends"))


def _listen(owner: "Owner") -> None:
    """Stop at Enter and return at q; without a terminal wait for a signal."""
    if sys.stdin is None or not sys.stdin.isatty():
        threading.Event().wait()
        return
    while line := os.read(sys.stdin.fileno(), 64):
        if line.strip().lower() == b"q":
            return
        for table, problem in owner.stop_all().items():
            write_line(
                f"{table} was not stopped: {problem}" if problem else message("{table}: stopped", table=table)
            )
