"""Jogging by hand: steps of the axes from keys and game pads, while a picture is watched.

A step is one relative motion; what comes while an axis moves waits, the newest alone. `stop` ends the motion at once.
Keys are bytes of a terminal; game pads are read as Linux input events (`Gamepad`).
"""

import logging
import os
import re
import select
import struct
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, Self

from anisoscope.base.errors import AnisoscopeError, NotConnected, UsageError
from anisoscope.rig.stage import SYMBOLS, RotationStage, check_limits, unit_of, within_a_turn

_log = logging.getLogger(__name__)

STEPS: Final = {"deg": (0.1, 1.0, 5.0, 15.0), "mm": (0.01, 0.1, 1.0, 5.0)}
"""Sizes of a step, chosen together by ``finer`` and ``coarser``."""

Action = Literal["stop", "finer", "coarser"]


@dataclass(frozen=True)
class Step:
    """One step of an axis, forward or back."""

    axis: str
    sign: int


Command = Step | Action

KEYS: Final[dict[bytes, Command]] = {
    b"\x1b[C": Step("stage", 1),
    b"\x1b[D": Step("stage", -1),
    b"\x1b[A": Step("tilt", 1),
    b"\x1b[B": Step("tilt", -1),
    b"\x1b[5~": Step("z", 1),
    b"\x1b[6~": Step("z", -1),
    b"d": Step("x", 1),
    b"a": Step("x", -1),
    b"w": Step("y", 1),
    b"s": Step("y", -1),
    b"+": "coarser",
    b"-": "finer",
    b" ": "stop",
}
"""Arrows: stage and tilt; page up and down: z; a, d and w, s: x and y; + and −: size of the step; space: stop."""

_KEY = re.compile(rb"\x1b\[[0-9]*[A-Za-z~]|\x1bO[A-Z]|.", re.DOTALL)


def commands_of(data: bytes) -> Iterator[Command]:
    """Commands of the keys in bytes of a terminal; other keys are ignored."""
    for key in _KEY.findall(data):
        plain = key.replace(b"\x1bO", b"\x1b[")  # arrows in the application mode of some terminals
        if (found := KEYS.get(plain)) is not None:
            yield found


class Jogger:
    """Jogging of axes in a thread, until its context ends.

    Args:
        axes: homed axes by their tables of the rig file.
    """

    def __init__(self, axes: Mapping[str, RotationStage]) -> None:
        self.axes = dict(axes)
        self._at = {table: axis.position_deg() for table, axis in self.axes.items()}
        self._size = 1
        self._wanted: Step | None = None
        self._problem = ""
        self._change = threading.Condition()
        self._over = False
        self._thread = threading.Thread(target=self._work, name="jogging", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._change:
            self._over, self._wanted = True, None
            self._change.notify()
        self.stop()
        self._thread.join()

    def do(self, command: Command) -> None:
        """Take a command; a step waits until the motion before it has ended, and replaces one that waits."""
        if command == "stop":
            self.stop()
        elif isinstance(command, Step):
            with self._change:
                if command.axis in self.axes:
                    self._wanted = command
                    self._change.notify()
                else:
                    self._problem = f"the rig has no axis {command.axis}"
        else:
            sizes = len(STEPS["deg"])
            self._size = min(max(self._size + (1 if command == "coarser" else -1), 0), sizes - 1)

    def stop(self) -> None:
        """Forget what waits and stop all axes at once."""
        with self._change:
            self._wanted = None
        for axis in self.axes.values():
            try:
                axis.stop()
            except AnisoscopeError as problem:
                self._problem = str(problem)

    def step_of(self, axis: str) -> float:
        """Size of a step of an axis, in its unit."""
        return STEPS[unit_of(self.axes[axis])][self._size]

    def state(self) -> str:
        """Positions after the last steps, sizes of the steps, and the error of the last motion."""
        units = {table: unit_of(axis) for table, axis in self.axes.items()}
        places = [f"{table} {at:.4g}{SYMBOLS[units[table]]}" for table, at in self._at.items()]
        sizes = [f"{STEPS[unit][self._size]:g}{SYMBOLS[unit]}" for unit in dict.fromkeys(units.values())]
        return "; ".join(filter(None, (", ".join(places), f"± {' '.join(sizes)}", self._problem)))

    def _work(self) -> None:
        while True:
            with self._change:
                while self._wanted is None and not self._over:
                    self._change.wait()
                if self._over:
                    return
                step, self._wanted = self._wanted, None
            assert step is not None
            try:
                self._move(step)
                self._problem = ""
            except AnisoscopeError as problem:
                self._problem = str(problem)
                _log.info("jogging: %s", problem)

    def _move(self, step: Step) -> None:
        axis = self.axes[step.axis]
        target = axis.position_deg() + step.sign * self.step_of(step.axis)
        if step.axis == "stage":
            target = within_a_turn(axis.limits_deg, target)
        check_limits(axis, target)
        self._at[step.axis] = axis.move_to(target)


# Game pads: Linux input events. Source: Linux kernel, include/uapi/linux/input.h and input-event-codes.h.

EVENT: Final = struct.Struct("llHHi")
"""``struct input_event``: time in seconds and microseconds, type, code, value."""

EV_KEY, EV_ABS = 1, 3
BTN_TL, BTN_TR = 0x136, 0x137
ABS_X, ABS_Y, ABS_RX, ABS_RY, ABS_HAT0X, ABS_HAT0Y = 0x00, 0x01, 0x03, 0x04, 0x10, 0x11
STICKS: Final = {
    ABS_X: ("stage", 1),
    ABS_Y: ("tilt", -1),  # a stick that is pushed away counts down
    ABS_RX: ("x", 1),
    ABS_RY: ("z", -1),
    ABS_HAT0X: ("stage", 1),
    ABS_HAT0Y: ("tilt", -1),
}
BUTTONS: Final[dict[int, Action]] = {BTN_TL: "finer", BTN_TR: "coarser"}
"""Shoulder buttons choose the size of the step; every other button stops all axes."""

DEAD_ZONE = 0.5
HATS = frozenset({ABS_HAT0X, ABS_HAT0Y})
USUAL_RANGE = (-32768, 32767)
REPEAT_S = 0.1
INPUTS = Path("/dev/input/by-id")


class Gamepad:
    """A game pad or joystick: a stick that is held steps its axis again and again.

    Args:
        path: its device, such as ``/dev/input/event5``; or a pipe or file with recorded events.

    Raises:
        NotConnected: it cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        except OSError as problem:
            raise NotConnected(
                f"game pad {path}: {problem.strerror or problem}; on Linux join the group input"
            ) from problem
        self.path = path
        self._held: dict[str, Step] = {}
        self._pending = b""
        self._ranges = {code: self._range(code) for code in STICKS}

    @classmethod
    def find(cls) -> Self:
        """The only game pad of this machine.

        Raises:
            UsageError: there is none, or several.
        """
        found = sorted(INPUTS.glob("*-event-joystick")) if INPUTS.is_dir() else []
        if len(found) != 1:
            what = f"there are {', '.join(map(str, found))}" if found else f"{INPUTS} shows none"
            raise UsageError(
                f"--pad auto: one game pad is needed, {what}; name its device: --pad /dev/input/event5"
            )
        return cls(found[0])

    def commands(self, ended: threading.Event) -> Iterator[Command]:
        """Commands as they come, until the pad's file ends or `ended` is true.

        Raises:
            NotConnected: the pad was unplugged.
        """
        while not ended.is_set():
            ready, _, _ = select.select([self._descriptor], [], [], REPEAT_S)
            if ready:
                try:
                    data = os.read(self._descriptor, 64 * EVENT.size)
                except OSError as problem:
                    yield "stop"
                    raise NotConnected(f"game pad {self.path} has gone: {problem.strerror}") from problem
                if not data:
                    yield "stop"
                    return
                yield from self.take(data)
            yield from self._held.values()

    def take(self, data: bytes) -> Iterator[Command]:
        """Commands of some bytes of events; what is held afterwards is repeated by `commands`."""
        data = self._pending + data
        whole = len(data) - len(data) % EVENT.size
        self._pending = data[whole:]
        for _, _, kind, code, value in EVENT.iter_unpack(data[:whole]):
            if kind == EV_KEY and value == 1:
                yield BUTTONS.get(code, "stop")
            elif kind == EV_ABS and code in STICKS:
                axis, sense = STICKS[code]
                low, high = self._ranges[code]
                share = (2.0 * value - low - high) / (high - low)
                if abs(share) > DEAD_ZONE:
                    self._held[f"{code}"] = Step(axis, sense if share > 0.0 else -sense)
                elif self._held.pop(f"{code}", None) is not None:
                    yield "stop"

    def close(self) -> None:
        """Let go of the pad; closing twice is fine."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def _range(self, code: int) -> tuple[int, int]:
        """Smallest and largest value of an axis, as the device says (EVIOCGABS); of a recording the usual ones."""
        from fcntl import ioctl  # noqa: PLC0415 - POSIX only

        buffer = bytearray(24)  # struct input_absinfo: value, minimum, maximum, fuzz, flat, resolution
        try:
            ioctl(self._descriptor, 0x80184540 + code, buffer)
        except OSError:
            return (-1, 1) if code in HATS else USUAL_RANGE
        _, low, high, *_ = struct.unpack("6i", buffer)
        return (low, high) if high > low else USUAL_RANGE
