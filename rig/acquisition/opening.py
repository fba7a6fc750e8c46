"""Open the devices of a rig file. However the rig is left, its axes stand and its light is off."""

import atexit
import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FrameType
from typing import Protocol

from anisoscope.errors import RigError
from anisoscope.rig.camera import Camera
from anisoscope.rig.drivers import open_camera, open_light, open_stage
from anisoscope.rig.light import Light, rest
from anisoscope.rig.rigfile import BY_HAND, AxisPart, RigFile
from anisoscope.rig.stage import RotationStage
from anisoscope.rig.transport import shared_ports

SAFE = "the stage is stopped and the light is off"
INTERRUPTIONS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


@dataclass(frozen=True)
class Rig:
    """An opened rig: its devices and its file; `tilt` is None where the camera arm is fixed."""

    stage: RotationStage
    camera: Camera
    light: Light
    file: RigFile
    tilt: RotationStage | None = None

    @property
    def axes(self) -> tuple[RotationStage, ...]:
        """All axes that can move."""
        return (self.stage,) if self.tilt is None else (self.stage, self.tilt)

    def stop(self) -> tuple[str, ...]:
        """Stop all axes; return what failed. May be called from any thread."""
        return _attempt([(f"{axis.name} was not stopped", axis.stop) for axis in self.axes])

    def make_safe(self) -> tuple[str, ...]:
        """Stop all axes and switch the light off; return what failed.

        A device that fails does not keep the others from it, and neither does an impatient Ctrl-C: in the main
        thread it waits until this is done.
        """
        with undisturbed():
            return self.stop() + _attempt([("the light was not switched off", lambda: rest(self.light))])


def _attempt(actions: list[tuple[str, Callable[[], None]]]) -> tuple[str, ...]:
    problems = []
    for failure, action in actions:
        try:
            action()
        except Exception as problem:  # noqa: BLE001 - whatever a driver raises, the next device has its turn
            problems.append(f"{failure}: {problem}")
    return tuple(problems)


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Hold back Ctrl-C, SIGTERM and SIGHUP; what came meanwhile is delivered at the end.

    Only the main thread gets signals; in other threads this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []

    def remember(number: int, _frame: FrameType | None) -> None:
        came.append(number)

    # None stands for a handler that Python did not install; it could not be put back.
    before = {one: signal.getsignal(one) for one in INTERRUPTIONS}
    before = {one: handler for one, handler in before.items() if handler is not None}
    for one in before:
        signal.signal(one, remember)
    try:
        yield
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)
    for number in came:
        signal.raise_signal(number)


@contextlib.contextmanager
def open_rig(file: RigFile) -> Iterator[Rig]:
    """Connect to the devices of a rig file; leaving the context makes them safe and disconnects them.

    Devices on the same port share it. After an error or an interruption the exception carries, as a note, what
    became of the rig.

    Raises:
        RigFileError: a driver that is not installed, or an option that it does not know.
        NotConnected: a device that is not there.
    """
    with contextlib.ExitStack() as stack:
        with shared_ports():
            stage = _open_axis(file.stage, "stage")
            stack.push(_closing(stage))
            tilt = None if file.tilt is None else _open_axis(file.tilt, "tilt")
            if tilt is not None:
                stack.push(_closing(tilt))
            camera = open_camera(file.camera.driver, **file.camera.options)
            stack.push(_closing(camera))
            light = open_light(file.light.driver, **file.light.options)
            stack.push(_closing(light))
        rig = Rig(stage, camera, light, file, tilt)
        # Leaving the context does the same; this is for an interpreter that ends inside of it.
        atexit.register(rig.make_safe)
        stack.callback(atexit.unregister, rig.make_safe)
        try:
            yield rig
        except BaseException as error:
            problems = rig.make_safe()
            if problems or isinstance(error, KeyboardInterrupt):
                error.add_note("; ".join(problems) or SAFE)
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


def _open_axis(part: AxisPart, table: str) -> RotationStage:
    options: dict[str, object] = dict(part.options)
    if part.driver == BY_HAND:
        options.setdefault("label", table)
    return open_stage(part.driver, table=table, port=part.port, **options)
