"""``anisoscope rig home|move|jog|stop``: move an axis by hand, from the command line."""

from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import RigError
from anisoscope.base.language import decimal, message
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import Flag, Json
from anisoscope.cli.rig.options import NOTHING_NAMED, AxisName, Which, Yes, asking, write_line
from anisoscope.cli.tables import answer

if TYPE_CHECKING:
    from anisoscope.operations.rigging import Moved
    from anisoscope.rig.portholder import Holder
    from anisoscope.rig.rigfile import MotorPart
    from anisoscope.rig.stage import Unit

Devices = Annotated[Which, Parameter(name="*")]
Axis = Annotated[AxisName, Parameter(name="--axis", help="Which axis: stage, tilt, x, y or z.")]
RELEASE_S = 15.0


def home(
    *, which: Devices = NOTHING_NAMED, axis: Axis = "stage", yes: Yes = False, json_: Json = False
) -> int:
    """Find the reference position of an axis. It may turn by a full turn: confirm, or give --yes.

    Examples:
        anisoscope rig home --rig rig.toml --yes
    """
    from anisoscope.operations.rigging import home_axis

    return _show(home_axis(which.axis(axis), axis, confirm=asking(which.rig, yes=yes)), json_=json_)


def move(
    place: float,
    /,
    *,
    sample: Flag = False,
    which: Devices = NOTHING_NAMED,
    axis: Axis = "stage",
    yes: Yes = False,
    json_: Json = False,
) -> int:
    """Move an axis to a reading. An axis that was not homed is homed first: confirm, or give --yes.

    A stage that turns all the way round takes every angle: -5 is 355. The way stays within its limits.

    Args:
        place: Reading of the axis, in degrees, of x, y and z in mm; with --sample: angle or place of the sample.
        sample: The angle is that of the sample (or of the arm), as zero_deg and turns of the rig file say (zero_mm and
            sign of a linear axis); approached from below, as an inspection does.

    Examples:
        anisoscope rig move 90 --sample --rig rig.toml --yes
        anisoscope rig move 10 --rig rig.toml --axis tilt
        anisoscope rig move 12.5 --rig rig.toml --axis z
    """
    from anisoscope.operations.rigging import move_axis

    moved = move_axis(which.axis(axis), place, axis, sample=sample, confirm=asking(which.rig, yes=yes))
    return _show(moved, json_=json_)


def jog(
    delta_deg: Annotated[
        float, Parameter(help="By how much, in degrees of the reading (x, y, z: mm); may be negative.")
    ],
    /,
    *,
    which: Devices = NOTHING_NAMED,
    axis: Axis = "stage",
    yes: Yes = False,
    json_: Json = False,
) -> int:
    """Move an axis by an angle or a length. An axis that was not homed is homed first: confirm, or give --yes.

    A stage that turns all the way round goes on at its other limit: 20 from 350 is 10.

    Examples:
        anisoscope rig jog 5 --rig rig.toml
    """
    from anisoscope.operations.rigging import move_axis

    moved = move_axis(which.axis(axis), delta_deg, axis, by=True, confirm=asking(which.rig, yes=yes))
    return _show(moved, json_=json_)


def stop(*, which: Devices = NOTHING_NAMED, json_: Json = False) -> int:
    """Stop all axes at once, also those that another anisoscope process is moving; without options, of all held rigs.

    A held rig (`rig hold`) stops and stays held. Otherwise only one process can have a port open: that process is
    interrupted as by Ctrl-C, stops its axes, switches the light off, and exits.

    Examples:
        anisoscope rig stop
        anisoscope rig stop --rig rig.toml
    """
    from anisoscope.operations.rigging import position
    from anisoscope.rig.acquisition.opening import open_devices
    from anisoscope.rig.stage import unit_of

    if which == NOTHING_NAMED:
        return _stop_held(json_=json_)
    _, axes = which.read()
    interruptions = [_interrupt(holder) for holder in _holders(axes)]
    with open_devices(axes) as devices:
        problems = devices.make_safe()
        found = {table: (axis.name, position(axis), unit_of(axis)) for table, axis in devices.axes.items()}
    if problems:
        raise RigError("; ".join(problems))
    if json_:
        rows = {table: {"device": name, f"at_{unit}": at} for table, (name, at, unit) in found.items()}
        return print_json({"interrupted": interruptions, "axes": rows})
    for table, (name, at, unit) in found.items():
        print(message("{axis} {name}: stopped, is at {after}", axis=table, name=name, after=_shown(at, unit)))  # noqa: T201
    return 0


def _stop_held(*, json_: bool) -> int:
    from anisoscope.base.errors import UsageError
    from anisoscope.rig.holdline import stop_held

    found = stop_held()
    if not found:
        raise UsageError(
            "no rig is held (anisoscope rig hold): name the devices to stop, --rig FILE or --driver NAME"
        )
    problems = [text for axes in found.values() for text in axes.values() if text]
    if problems:
        raise RigError("; ".join(problems))
    if json_:
        return print_json({"held": {str(pid): list(axes) for pid, axes in found.items()}})
    for pid, axes in found.items():
        print(message("process {pid}: stopped {axes}", pid=str(pid), axes=", ".join(axes)))  # noqa: T201
    return 0


def _holders(axes: "dict[str, MotorPart]") -> "list[Holder]":
    from anisoscope.rig.portholder import holder_of, interrupted

    ports = [part.port for part in axes.values() if part.port is not None]
    found = [holder_of(port) or interrupted.get(port) for port in ports]
    return list(
        {holder.pid: holder for holder in found if holder is not None and not holder.serves_at}.values()
    )


def _interrupt(holder: "Holder") -> int:
    from anisoscope.rig.portholder import wait_until_released

    holder.interrupt()
    write_line(f"interrupted process {holder.pid} ({holder.program}), which has {holder.port} open")
    if not wait_until_released(holder.port, RELEASE_S):
        raise RigError(
            f"process {holder.pid} ({holder.program}) was interrupted, but still has {holder.port} open after "
            f"{RELEASE_S:g} s: look at the rig, and press Ctrl-C in its window"
        )
    return holder.pid


def _show(moved: "Moved", *, json_: bool) -> int:
    whose = {"stage": message("part"), "tilt": message("arm")}.get(moved.axis, moved.axis)
    known = moved.place_after is not None
    after = f" ({whose} {_shown(moved.place_after, moved.unit)})" if known else ""
    line = message(
        "{axis} {name}: was at {before}, is at {after}",
        axis=moved.axis,
        name=moved.device,
        before=_shown(moved.before, moved.unit),
        after=_shown(moved.after, moved.unit) + after,
    )
    answer(fields_of(moved) | moved.readings, [line], json_=json_)
    return 0


def _shown(place: float | None, unit: "Unit") -> str:
    from anisoscope.rig.stage import SYMBOLS

    if place is None:
        return message("an unknown angle") if unit == "deg" else message("an unknown place")
    return decimal(f"{place:.{3 if unit == 'deg' else 4}f}{SYMBOLS[unit]}")
