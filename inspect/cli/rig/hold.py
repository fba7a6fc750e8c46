"""``anisoscope rig hold``: keep axes, camera and light of a rig open, for other commands of this machine."""

import contextlib
import os
import sys
import threading
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.language import message
from anisoscope.cli.rig.options import NOTHING_NAMED, Which, Yes, asking, write_line

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
    """Keep axes, camera and light of a rig open until q and Enter or Ctrl-C; other commands on this machine use them.

    Their references stay known, so nothing homes twice, `rig stop` reaches the axes at once, and several commands take
    pictures at the same time, each with its own exposure. Enter stops all axes.

    Examples:
        anisoscope rig hold --rig rig.toml --home
    """
    from anisoscope.operations.rigging import home_axes
    from anisoscope.rig.acquisition.opening import hold_devices

    file, axes = which.read()
    with hold_devices(axes, file, "" if which.rig is None else str(which.rig.resolve())) as held:
        devices = held.devices
        if home:
            home_axes(devices.axes, axes, file, asking(which.rig, yes=yes))
        missing = f"{message('camera')} ({held.missing})" if held.missing else ""
        names = [message("light")] * (devices.light is not None)
        names += [message("camera")] * (devices.camera is not None)
        _announce(devices, names)
        free = [missing] * bool(missing) + [message("light")] * (devices.light is None and _has_light(file))
        if free:
            write_line(message("not held: {names}; every command opens them itself", names=", ".join(free)))
        with contextlib.suppress(KeyboardInterrupt):
            _listen(held.owner)
    return 0


def _has_light(file: "RigAxes | None") -> bool:
    return file is not None and file.light is not None


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
