"""Open the devices of a rig file. However the rig is left, its axes stand and its light is off."""

import atexit
import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from anisoscope.base.errors import CameraError, NotConnected, RigError, RigFileError, UsageError
from anisoscope.rig.acquisition.interruptions import undisturbed
from anisoscope.rig.camera import Camera
from anisoscope.rig.collisions import Guard
from anisoscope.rig.drivers import open_camera, open_light, open_stage, open_wheel
from anisoscope.rig.hold import ASKING, Owner, held_camera, held_light, held_stage, is_held
from anisoscope.rig.light import Channel, ChannelLight, FilterWheel, Light, rest
from anisoscope.rig.rigfile import BY_HAND, CameraPart, LightPart, MotorPart, RigAxes, RigFile
from anisoscope.rig.stage import RotationStage, unit_of
from anisoscope.rig.transport import shared_ports


@dataclass(frozen=True)
class Rig:
    """An opened rig: its devices and its file; `tilt` is None where the camera arm is fixed.

    `linear` holds the axes x, y and z that it has; `guard` the combinations that its file forbids.
    """

    stage: RotationStage
    camera: Camera
    light: Light
    file: RigFile
    tilt: RotationStage | None = None
    linear: Mapping[str, RotationStage] = field(default_factory=dict)
    guard: Guard = field(default_factory=lambda: Guard((), {}))

    @property
    def by_table(self) -> dict[str, RotationStage]:
        """All axes that can move, by their tables."""
        return {"stage": self.stage, **({} if self.tilt is None else {"tilt": self.tilt}), **self.linear}

    @property
    def axes(self) -> tuple[RotationStage, ...]:
        """All axes that can move."""
        return tuple(self.by_table.values())

    def unhomed(self, *, all_axes: bool = False) -> Iterator[RotationStage]:
        """The axes that were not homed (or all), in the order in which they may search their references."""
        axes = self.by_table
        for table in dict.fromkeys((*self.file.home_order, *axes)):
            if all_axes or not axes[table].is_homed:
                yield axes[table]

    def stop(self) -> tuple[str, ...]:
        """Stop all axes; return what failed. May be called from any thread."""
        return _stop(self.axes)

    def make_safe(self) -> tuple[str, ...]:
        """Stop all axes and switch the light off; return what failed; see `Devices.make_safe`."""
        return _make_safe(self.axes, self.light)


@dataclass
class Devices:
    """Some devices of a rig, opened by `open_devices`; `axes` by their tables of the rig file."""

    axes: dict[str, RotationStage] = field(default_factory=dict)
    camera: Camera | None = None
    light: Light | None = None
    guard: Guard = field(default_factory=lambda: Guard((), {}))

    @property
    def safe(self) -> str:
        """State of the rig after a successful `make_safe`; empty where there is nothing to make safe."""
        names = " and ".join(self.axes)
        states = (
            [f"{names} are stopped" if len(self.axes) > 1 else f"the {names} is stopped"] if names else []
        )
        lamp = self.light is not None and not getattr(self.light, "asks", False)
        return " and ".join(states + (["the light is off"] if lamp else []))

    def make_safe(self) -> tuple[str, ...]:
        """Stop all axes and switch the light off; return what failed.

        A device that fails does not keep the others from it, and neither does an impatient Ctrl-C: in the main
        thread it waits until this is done.
        """
        return _make_safe(self.axes.values(), self.light)


def _stop(axes: Iterable[RotationStage]) -> tuple[str, ...]:
    return _attempt([(f"{axis.name} was not stopped", axis.stop) for axis in axes])


def _make_safe(axes: Iterable[RotationStage], light: Light | None) -> tuple[str, ...]:
    with undisturbed():
        problems = _stop(axes)
        if light is not None:
            problems += _attempt([("the light was not switched off", lambda: rest(light))])
        return problems


def _attempt(actions: list[tuple[str, Callable[[], None]]]) -> tuple[str, ...]:
    problems = []
    for failure, action in actions:
        try:
            action()
        except Exception as problem:  # noqa: BLE001 - whatever a driver raises, the next device has its turn
            problems.append(f"{failure}: {problem}")
    return tuple(problems)


@contextlib.contextmanager
def open_rig(file: RigFile) -> Iterator[Rig]:
    """Connect to all devices of a rig file; leaving the context makes them safe and disconnects them.

    Errors, and what they carry, as for `open_devices`.
    """
    with open_devices(file.axes, file.camera, file.light, rows_of=file) as found:
        assert found.camera is not None
        assert found.light is not None
        linear = {table: found.axes[table] for table in file.linear}
        tilt = found.axes.get("tilt")
        yield Rig(found.axes["stage"], found.camera, found.light, file, tilt, linear, found.guard)


@contextlib.contextmanager
def open_devices(
    axes: Mapping[str, MotorPart],
    camera: CameraPart | None = None,
    light: LightPart | None = None,
    *,
    rows_of: RigAxes | None = None,
) -> Iterator[Devices]:
    """Connect to some devices; leaving the context switches the light off and disconnects them.

    A live picture that leaves the stage's port alone lets another terminal turn the stage meanwhile. Devices on the
    same port share it. After an error or an interruption the axes are stopped, and the exception carries, as a note,
    what became of the rig.

    Args:
        axes: axes by their tables of the rig file, ``stage``, ``tilt``, ``x``, ``y`` and ``z``.
        camera: the camera, if it is wanted.
        light: the light, if it is wanted.
        rows_of: the rig file whose forbidden combinations hold, those of which all axes are among these
            (`RigAxes.moved_with`).

    Raises:
        RigFileError: a driver that is not installed, or an option that it does not know.
        NotConnected: a device that is not there.
    """
    found = Devices()
    with contextlib.ExitStack() as stack:
        with shared_ports():
            for table, part in axes.items():
                found.axes[table] = open_axis(part, table)
                stack.push(_closing(found.axes[table]))
            if rows_of is not None and rows_of.collisions:
                rows = [row for row in rows_of.collisions if row.ranges.keys() <= axes.keys()]
                found.guard = Guard(rows, found.axes, rows_of.home_order)
                found.axes = {table: found.guard.guarded(table) for table in found.axes}
            if camera is not None:
                found.camera = open_eye(camera)
                stack.push(_closing(found.camera))
            if light is not None:
                found.light = open_lamp(light)
                stack.push(_closing(found.light))
        # Leaving the context does the same; this is for an interpreter that ends inside of it.
        atexit.register(found.make_safe)
        stack.callback(atexit.unregister, found.make_safe)
        try:
            yield found
            if found.light is not None:
                rest(found.light)
        except BaseException as error:
            problems = found.make_safe()
            if problems or (isinstance(error, KeyboardInterrupt) and found.safe):
                error.add_note("; ".join(problems) or found.safe)
            raise


class _Closable(Protocol):
    def close(self) -> None: ...


def _closing(device: _Closable) -> Callable[..., None]:
    """Close a device on the way out; one that does not close does not hide why everybody leaves."""

    def leave(kind: type[BaseException] | None, _value: object, _trace: object) -> None:
        try:
            device.close()
        except RigError:
            if kind is None:
                raise

    return leave


def open_axis(part: MotorPart, table: str) -> RotationStage:
    """Open an axis from its table in the rig file, or use it where another process holds it for others.

    Errors as for `open_devices`.
    """
    if (held := held_stage(part)) is not None:
        return held
    options: dict[str, object] = dict(part.driver_options)
    if part.driver == BY_HAND:
        options.setdefault("label", table)
    axis = open_stage(part.driver, table=table, port=part.port, **options)
    if unit_of(axis) != part.unit:
        axis.close()
        raise RigFileError(f"{table}.driver: the driver '{part.driver}' does not move in {part.unit}")
    return axis


def open_eye(part: CameraPart) -> Camera:
    """Open a camera from its table, or use it where another process holds it; errors as for `open_devices`."""
    if (held := held_camera(part)) is not None:
        return held
    return open_camera(part.driver, **part.options)


def open_lamp(part: LightPart) -> Light:
    """Open a light from its table, or use it where another process holds it; errors as for `open_devices`."""
    if (held := held_light(part)) is not None:
        if part.channel is not None:
            held.select(part.channel)
        return held
    light = open_light(part.driver, port=part.port, **part.options)
    if not part.channels:
        return light
    wheel: FilterWheel | None = None
    try:
        if (turned := part.wheel) is not None:
            wheel = open_wheel(turned.driver, port=turned.port, **turned.options)
        channels = {
            name: Channel(dict.fromkeys(one.lamps, one.level_percent), one.filter)
            for name, one in part.channels.items()
        }
        found = ChannelLight(light, wheel, channels)
        if part.channel is not None:
            found.select(part.channel)
    except BaseException:
        light.close()
        if wheel is not None:
            wheel.close()
        raise
    return found


@dataclass(frozen=True)
class HeldRig:
    """Devices of a rig that this process holds for others, and why its camera is not among them ("" if it is)."""

    owner: Owner
    devices: Devices
    missing: str


@contextlib.contextmanager
def hold_devices(axes: Mapping[str, MotorPart], file: RigAxes | None, rig: str = "") -> Iterator[HeldRig]:
    """Keep the devices of a rig open and serve them to other processes of this user.

    What asks the operator is left out. A camera that does not open does not keep the axes from being held.

    Args:
        axes: axes by their tables of the rig file.
        file: the rig file, or None.
        rig: its path; "" without.

    Raises:
        UsageError: no axis has a motor, or another process holds the rig.
        RigFileError, NotConnected: as for `open_devices`.
    """
    axes = {table: part for table, part in axes.items() if part.driver not in ASKING}
    if not axes:
        raise UsageError("nothing can be held: an axis needs a motor")
    light = None if file is None or file.light is None or file.light.driver in ASKING else file.light
    eye = None if file is None else file.camera
    if any(is_held(part) for part in (*axes.values(), light, eye) if part is not None):
        raise UsageError("another process holds this rig already; end it with q in its window")
    with open_devices(axes, light=light, rows_of=file) as devices, contextlib.ExitStack() as stack:
        missing = ""
        if eye is not None:
            try:
                devices.camera = open_eye(eye)
                stack.push(_closing(devices.camera))
            except (NotConnected, CameraError) as problem:
                missing = str(problem)
        served = {table: (axes[table], axis) for table, axis in devices.axes.items()}
        lamp = None if light is None or devices.light is None else (light, devices.light)
        shared = None if eye is None or devices.camera is None else (eye, devices.camera)
        with Owner(served, lamp, rig, shared) as owner:
            yield HeldRig(owner, devices, missing)
