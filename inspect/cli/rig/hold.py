"""``anisoscope rig hold``: keep the axes and the light of a rig open, for other commands of this machine."""

import contextlib
import os
import sys
import threading
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.language import message
from anisoscope.cli.rig.options import NOTHING_NAMED, Which, Yes, home_axes, write_line

if TYPE_CHECKING:
    from anisoscope.rig.acquisition.opening import Devices
    from anisoscope.rig.hold import Owner
    from anisoscope.rig.rigfile import RigAxes


def hold(
    *,
    which: Annotated[Which, Parameter(name="*")] = NOTHING_NAMED,
    home: Annotated[
        bool, Parameter(negative="", help="Search the reference of every axis first: confirm, or give --yes.")
    ] = False,
    yes: Yes = False,
) -> int:
    """Keep axes and light of a rig open until q and Enter or Ctrl-C; other commands on this machine use them.

    Their references stay known, so nothing homes twice, and `rig stop` reaches the axes at once. Enter stops all axes.

    Examples:
        anisoscope rig hold --rig rig.toml --home
    """
    from anisoscope.rig.acquisition.opening import open_devices
    from anisoscope.rig.hold import Owner, is_held
    from anisoscope.rig.rigfile import BY_HAND

    file, axes = which.read()
    axes = {table: part for table, part in axes.items() if part.driver != BY_HAND and part.port is not None}
    if not axes:
        raise UsageError("nothing can be held: an axis needs a motor and a port")
    light = None if file is None else file.light
    light = light if light is not None and light.port is not None and light.driver != BY_HAND else None
    if any(is_held(part) for part in axes.values()) or (light is not None and is_held(light)):
        raise UsageError("another process holds this rig already; end it with q in its window")
    with open_devices(axes, light=light, rows_of=file) as devices:
        if home:
            home_axes(devices.axes, axes, file, yes=yes)
        served = {table: (axes[table], axis) for table, axis in devices.axes.items()}
        lamp = None if light is None or devices.light is None else (light, devices.light)
        with Owner(served, lamp, "" if which.rig is None else str(which.rig.resolve())) as owner:
            _announce(devices, [] if file is None else _left_free(file, lamp is not None))
            with contextlib.suppress(KeyboardInterrupt):
                _listen(owner)
    return 0


def _left_free(file: "RigAxes", lamp_held: bool) -> list[str]:
    """What other commands open for themselves, as without a holder."""
    lamp = [] if file.light is None or lamp_held else [message("light")]
    return ([] if file.camera is None else [message("camera")]) + lamp


def _announce(devices: "Devices", free: list[str]) -> None:
    names = [f"{table} {axis.name}" for table, axis in devices.axes.items()]
    names += [] if devices.light is None else [message("light")]
    print(message("holding {names} for other commands", names=", ".join(names)), flush=True)  # noqa: T201
    if free:
        write_line(message("not held: {names}; every command opens them itself", names=", ".join(free)))
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
