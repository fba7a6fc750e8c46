"""Open only those devices of a rig that a command needs; however it is left, axes stand and the light is off.

A live picture that leaves the stage's port alone lets another terminal turn the stage meanwhile.
"""

import atexit
import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from anisoscope.rig.acquisition.opening import undisturbed
from anisoscope.rig.camera import Camera
from anisoscope.rig.drivers import open_camera, open_light, open_stage
from anisoscope.rig.light import Light
from anisoscope.rig.rigfile import BY_HAND, AxisPart, CameraPart, LightPart
from anisoscope.rig.stage import RotationStage
from anisoscope.rig.transport import shared_ports

ALWAYS_ON = "none"


@dataclass
class Devices:
    """The devices that a command opened; `switched` is False for a light that always burns."""

    axes: dict[str, RotationStage] = field(default_factory=dict)
    camera: Camera | None = None
    light: Light | None = None
    switched: bool = True

    @property
    def safe(self) -> str:
        """What is true after `make_safe` had no trouble."""
        said = ["every axis is stopped"] if self.axes else []
        return " and ".join(said + (["the light is off"] if self.light and self.switched else []))

    def darken(self) -> None:
        """Switch the light off, where it has a switch: one that always burns would ask for a cover instead."""
        if self.light is not None and self.switched:
            self.light.off()

    def make_safe(self) -> tuple[str, ...]:
        """Stop the axes and switch the light off; return what failed. An impatient Ctrl-C waits meanwhile."""
        actions: list[tuple[str, Callable[[], None]]] = [
            (f"{axis.name} was not stopped", axis.stop) for axis in self.axes.values()
        ]
        actions.append(("the light was not switched off", self.darken))
        problems = []
        with undisturbed():
            for failure, action in actions:
                try:
                    action()
                except Exception as problem:  # noqa: BLE001 - whatever a driver raises, the next has its turn
                    problems.append(f"{failure}: {problem}")
        return tuple(problems)


def open_axis(part: AxisPart, table: str) -> RotationStage:
    """Open an axis as its table of the rig file says."""
    options: dict[str, object] = dict(part.options)
    if part.driver == BY_HAND:
        options.setdefault("label", table)
    return open_stage(part.driver, table=table, port=part.port, **options)


@contextlib.contextmanager
def opened(
    axes: Mapping[str, AxisPart] | None = None,
    camera: CameraPart | None = None,
    light: LightPart | None = None,
) -> Iterator[Devices]:
    """Connect to some devices; leaving the context switches the light off and disconnects them.

    After an error or an interruption the axes are stopped first, and the exception carries, as a note, what became
    of them.

    Raises:
        RigFileError: a driver that is not installed, or an option that it does not know.
        NotConnected: a device that is not there.
    """
    devices = Devices()
    with contextlib.ExitStack() as stack:
        with shared_ports():
            for table, part in (axes or {}).items():
                axis = open_axis(part, table)
                stack.callback(axis.close)
                devices.axes[table] = axis
            if camera is not None:
                devices.camera = open_camera(camera.driver, **camera.options)
                stack.callback(devices.camera.close)
            if light is not None:
                devices.light = open_light(light.driver, **light.options)
                devices.switched = light.driver != ALWAYS_ON
                stack.callback(devices.light.close)
        # Leaving the context does the same; this is for an interpreter that ends inside of it.
        atexit.register(devices.make_safe)
        stack.callback(atexit.unregister, devices.make_safe)
        try:
            yield devices
            devices.darken()
        except BaseException as error:
            problems = devices.make_safe()
            if problems or (isinstance(error, KeyboardInterrupt) and devices.safe):
                error.add_note("; ".join(problems) or devices.safe)
            raise
