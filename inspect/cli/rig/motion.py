"""``anisoscope rig home|move|jog|stop``: move an axis by hand, from the command line."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import AnisoscopeError, NotConnected, RigError
from anisoscope.base.language import decimal, message
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.rig.options import NOTHING_NAMED, AxisName, Which, Yes, home_axes, home_axis, write_line

if TYPE_CHECKING:
    from collections.abc import Callable

    from anisoscope.rig.portholder import Holder
    from anisoscope.rig.rigfile import MotorPart, RigAxes
    from anisoscope.rig.stage import RotationStage, Unit

    Target = Callable[[RotationStage, MotorPart, float], float]
    Go = Callable[[RotationStage, MotorPart, float], None]

Devices = Annotated[Which, Parameter(name="*")]
Axis = Annotated[AxisName, Parameter(name="--axis", help="Which axis: stage, tilt, x, y or z.")]
RELEASE_S = 15.0


@dataclass(frozen=True)
class _Moved:
    """Completed motion, in the unit of the axis; `before` is None where the position before was unknown."""

    axis: str
    device: str
    before: float | None
    after: float
    homed: bool


def home(
    *, which: Devices = NOTHING_NAMED, axis: Axis = "stage", yes: Yes = False, json_: Json = False
) -> int:
    """Find the reference position of an axis. It may turn by a full turn: confirm, or give --yes.

    Examples:
        anisoscope rig home --rig rig.toml --yes
    """
    from anisoscope.rig.acquisition.opening import open_devices

    file, parts = which.axis(axis)
    with open_devices(parts, rows_of=file) as devices:
        stage, part = devices.axes[axis], parts[axis]
        before = _position(stage)
        home_axis(stage, part, yes=yes)
        moved = _Moved(axis, stage.name, before, stage.position_deg(), homed=True)
    return _show(moved, file, part, json_=json_)


def move(
    place: Annotated[
        float,
        Parameter(
            help="Reading of the axis, in degrees, of x, y and z in mm; with --sample: angle or place of the sample."
        ),
    ],
    /,
    *,
    sample: Annotated[
        bool,
        Parameter(
            negative="",
            help="The angle is that of the sample (or of the arm), as zero_deg and turns of the rig file say (zero_mm "
            "and sign of a linear axis); approached from below, as an inspection does.",
        ),
    ] = False,
    which: Devices = NOTHING_NAMED,
    axis: Axis = "stage",
    yes: Yes = False,
    json_: Json = False,
) -> int:
    """Move an axis to a reading. An axis that was not homed is homed first: confirm, or give --yes.

    A stage that turns all the way round takes every angle: -5 is 355. The way stays within its limits.

    Examples:
        anisoscope rig move 90 --sample --rig rig.toml --yes
        anisoscope rig move 10 --rig rig.toml --axis tilt
        anisoscope rig move 12.5 --rig rig.toml --axis z
    """
    from anisoscope.base.errors import UsageError
    from anisoscope.rig.stage import check_limits

    if sample and which.rig is None:
        raise UsageError("--sample needs a rig file: only that says at which reading the sample stands at 0°")

    def target(stage: "RotationStage", part: "MotorPart", _now_deg: float) -> float:
        reading = _in_reach(stage, axis, part.reading(place) if sample else place)
        if sample:
            check_limits(stage, reading - part.approach)
        return reading

    def go(stage: "RotationStage", part: "MotorPart", reading: float) -> None:
        if sample and stage.position_deg() > (below := reading - part.approach):
            stage.move_to(below)
        stage.move_to(reading)

    return _motion(which, axis, target, go, yes=yes, json_=json_)


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

    def target(stage: "RotationStage", _part: "MotorPart", now_deg: float) -> float:
        return _in_reach(stage, axis, now_deg + delta_deg)

    def go(stage: "RotationStage", _part: "MotorPart", reading: float) -> None:
        stage.move_to(reading)

    return _motion(which, axis, target, go, yes=yes, json_=json_)


def stop(*, which: Devices = NOTHING_NAMED, json_: Json = False) -> int:
    """Stop all axes at once, also those that another anisoscope process is moving; without options, of all held rigs.

    A held rig (`rig hold`) stops and stays held. Otherwise only one process can have a port open: that process is
    interrupted as by Ctrl-C, stops its axes, switches the light off, and exits.

    Examples:
        anisoscope rig stop
        anisoscope rig stop --rig rig.toml
    """
    from anisoscope.rig.acquisition.opening import open_devices
    from anisoscope.rig.stage import unit_of

    if which == NOTHING_NAMED:
        return _stop_held(json_=json_)
    _, axes = which.read()
    interruptions = [_interrupt(holder) for holder in _holders(axes)]
    with open_devices(axes) as devices:
        problems = devices.make_safe()
        found = {table: (axis.name, _position(axis), unit_of(axis)) for table, axis in devices.axes.items()}
    if problems:
        raise RigError("; ".join(problems))
    if json_:
        rows = {table: {"device": name, f"at_{unit}": at} for table, (name, at, unit) in found.items()}
        print_json({"interrupted": interruptions, "axes": rows})
        return 0
    for table, (name, at, unit) in found.items():
        print(message("{axis} {name}: stopped, is at {after}", axis=table, name=name, after=_shown(at, unit)))  # noqa: T201
    return 0


def _in_reach(stage: "RotationStage", axis: AxisName, reading_deg: float) -> float:
    """The reading itself, or that of the same direction within the limits of a stage that turns all the way round.

    An arm is not turned round: it would hit something.

    Raises:
        LimitExceeded: it cannot be reached; nothing was moved.
    """
    from anisoscope.rig.stage import check_limits, within_a_turn

    if axis == "stage":
        reading_deg = within_a_turn(stage, reading_deg)
    check_limits(stage, reading_deg)
    return reading_deg


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
        print_json({"held": {str(pid): list(axes) for pid, axes in found.items()}})
        return 0
    for pid, axes in found.items():
        print(message("process {pid}: stopped {axes}", pid=str(pid), axes=", ".join(axes)))  # noqa: T201
    return 0


def _motion(which: Which, axis: AxisName, target: "Target", go: "Go", *, yes: bool, json_: bool) -> int:
    """Home if need be, and move; a target that cannot be reached is refused before both."""
    from anisoscope.rig.acquisition.opening import open_devices

    file, parts = which.axis(axis)
    with open_devices(parts, rows_of=file) as devices:
        stage, part = devices.axes[axis], parts[axis]
        before = _position(stage)
        homed = not stage.is_homed
        low, high = stage.limits_deg
        zero = min(max(0.0, low), high)
        reading = target(stage, part, zero if homed or before is None else before)
        home_axes(devices.axes, parts, file, yes=yes)
        if homed:
            reading = target(stage, part, stage.position_deg())
        go(stage, part, reading)
        moved = _Moved(axis, stage.name, before, stage.position_deg(), homed)
    return _show(moved, file, part, json_=json_)


def _position(stage: "RotationStage") -> float | None:
    try:
        return stage.position_deg()
    except NotConnected:
        raise
    except AnisoscopeError:  # an axis by hand that nobody has set yet
        return None


def _holders(axes: "dict[str, MotorPart]") -> "list[Holder]":
    from anisoscope.rig.portholder import holder_of

    found = [holder_of(part.port) for part in axes.values() if part.port is not None]
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


def _show(moved: _Moved, file: "RigAxes | None", part: "MotorPart", *, json_: bool) -> int:
    unit = part.unit
    known = file is not None

    def place(reading: float | None) -> float | None:
        return None if reading is None or not known else part.place(reading)

    if json_:
        kind = "angle" if unit == "deg" else "place"
        print_json(
            {
                "axis": moved.axis,
                "device": moved.device,
                "homed": moved.homed,
                f"before_{unit}": moved.before,
                f"after_{unit}": moved.after,
                f"{kind}_before_{unit}": place(moved.before),
                f"{kind}_after_{unit}": place(moved.after),
            }
        )
        return 0
    whose = {"stage": message("part"), "tilt": message("arm")}.get(moved.axis, moved.axis)
    after = f" ({whose} {_shown(place(moved.after), unit)})" if known else ""
    print(  # noqa: T201
        message(
            "{axis} {name}: was at {before}, is at {after}",
            axis=moved.axis,
            name=moved.device,
            before=_shown(moved.before, unit),
            after=_shown(moved.after, unit) + after,
        )
    )
    return 0


def _shown(place: float | None, unit: "Unit") -> str:
    from anisoscope.rig.stage import SYMBOLS

    if place is None:
        return message("an unknown angle") if unit == "deg" else message("an unknown place")
    return decimal(f"{place:.{3 if unit == 'deg' else 4}f}{SYMBOLS[unit]}")
