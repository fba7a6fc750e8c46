"""What a block of G-code does, as Grbl 1.1 understands it: moves, modes, origins.

Arcs (G2, G3) and probing (G38) are not simulated and answered as unsupported. Source: the description of Grbl
1.1 and NIST RS274/NGC.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from anisoscope.sim.bench.firmware.grbl_motion import Move, Place
from anisoscope.sim.bench.firmware.grbl_settings import Memory
from anisoscope.sim.bench.firmware.grbl_words import (
    AXIS_UNDER_G80,
    BAD_SYSTEM,
    INVALID_JOG,
    LINE_NUMBER,
    NO_AXIS,
    NO_FEED,
    TOO_LARGE,
    UNSUPPORTED,
    UNUSED,
    VALUE_MISSING,
    WITH_AXES,
    GcodeError,
    Words,
    read_words,
)

MM_PER_INCH = 25.4
_JOG_WORDS = frozenset({"distance", "units", "once"})


@dataclass(frozen=True)
class Modes:
    """Modal state from block to block."""

    motion: str = "G0"
    system: str = "G54"
    plane: str = "G17"
    units: str = "G21"
    distance: str = "G90"
    feed_mode: str = "G94"
    spindle: str = "M5"
    coolant: str = "M9"
    feed: float = 0.0
    speed: float = 0.0
    tool: int = 0
    shift: Place = (0.0, 0.0, 0.0)

    def text(self) -> str:
        """Text of the ``$G`` report."""
        modal = (self.motion, self.system, self.plane, self.units, self.distance, self.feed_mode)
        return f"[GC:{' '.join((*modal, self.spindle, self.coolant))} T{self.tool} F{self.feed:.0f} S{self.speed:.0f}]"


@dataclass(frozen=True)
class Block:
    """Effect of a block of G-code: moves, a pause in seconds, and the end of the program (M0, M2 …)."""

    modes: Modes
    moves: tuple[Move, ...] = ()
    dwell_s: float = 0.0
    flow: str = ""


def read_jog(text: str, modes: Modes, position: Place, memory: Memory) -> Move:
    """Read what follows ``$J=``; modes stay as they are."""
    words = read_words(text)
    if "F" not in words.values:
        raise GcodeError(NO_FEED)
    if not words.axes:
        raise GcodeError(NO_AXIS)
    if words.commands.keys() - _JOG_WORDS or words.once not in {"", "G53"}:
        raise GcodeError(INVALID_JOG)
    if words.values.keys() - set("FNXYZ"):
        raise GcodeError(UNUSED)
    local = _with_modal(modes, words)
    scale = MM_PER_INCH if local.units == "G20" else 1.0
    if not words.values["F"]:
        raise GcodeError(NO_FEED)
    return Move(_target(words, local, position, memory), words.values["F"] * scale)


def read_block(text: str, modes: Modes, position: Place, memory: Memory) -> Block:
    """Read a block; `position` is the machine position in degrees after all that came before.

    Raises:
        GcodeError: the block is refused, and nothing of it is carried out.
    """
    words = read_words(text)
    values = words.values
    after = _with_modal(modes, words)
    scale = MM_PER_INCH if after.units == "G20" else 1.0
    if after.feed_mode != modes.feed_mode or after.feed_mode == "G93":
        after = replace(after, feed=0.0)
    if "F" in values:
        after = replace(after, feed=values["F"] * (scale if after.feed_mode == "G94" else 1.0))
    after = replace(after, speed=values.get("S", after.speed), tool=int(values.get("T", after.tool)))
    _check(words, after)
    flow = words.commands.get("flow", "")
    if words.once in {"G10", "G92", "G92.1", "G28.1", "G30.1"}:
        return Block(_store(words, after, position, memory), flow=flow)
    moves = _moves(words, after, position, memory)
    return Block(after, moves, values["P"] if words.once == "G4" else 0.0, flow)


def work_offset(modes: Modes, memory: Memory) -> Place:
    """Machine position of the origin in force."""
    origin = memory.offsets[int(modes.system[1:])]
    x, y, z = (a + b for a, b in zip(origin, modes.shift, strict=True))
    return x, y, z


def _with_modal(modes: Modes, words: Words) -> Modes:
    commands = words.commands
    return replace(
        modes,
        motion=commands.get("motion", modes.motion),
        system=commands.get("system", modes.system),
        plane=commands.get("plane", modes.plane),
        units=commands.get("units", modes.units),
        distance=commands.get("distance", modes.distance),
        feed_mode=commands.get("feed_mode", modes.feed_mode),
        spindle=commands.get("spindle", modes.spindle),
        coolant=commands.get("coolant", modes.coolant),
    )


def _check(words: Words, after: Modes) -> None:
    values, once = words.values, words.once
    if values.get("N", 0.0) > 1e7:
        raise GcodeError(LINE_NUMBER)
    if values.get("T", 0.0) > 255:
        raise GcodeError(TOO_LARGE)
    needed = {"G4": "P", "G10": "PL"}.get(once, "")
    if once in {"G10", "G92"} and not words.axes:
        raise GcodeError(NO_AXIS)
    if any(letter not in values for letter in needed):
        raise GcodeError(VALUE_MISSING)
    if once == "G10" and values["L"] not in {2, 20}:
        raise GcodeError(UNSUPPORTED)
    if once == "G10" and int(values["P"]) > 6:
        raise GcodeError(BAD_SYSTEM)
    if after.motion == "G80" and words.axes:
        raise GcodeError(AXIS_UNDER_G80)
    moves = (bool(words.axes) and once not in WITH_AXES) or "motion" in words.commands
    if moves and after.motion == "G1" and not after.feed:
        raise GcodeError(NO_FEED)
    if values.keys() - set("NFSTXYZ") - set(needed):
        raise GcodeError(UNUSED)


def _store(words: Words, after: Modes, position: Place, memory: Memory) -> Modes:
    """Carry out the commands that set origins and places."""
    once, axes, scale = words.once, words.axes, MM_PER_INCH if after.units == "G20" else 1.0
    if once in {"G28.1", "G30.1"}:
        memory.offsets[int(once[1:3])] = position
        return after
    if once == "G92.1":
        return replace(after, shift=(0.0, 0.0, 0.0))
    if once == "G92":
        origin = memory.offsets[int(after.system[1:])]
        shift = (position[i] - origin[i] - axes[i] * scale if i in axes else after.shift[i] for i in range(3))
        return replace(after, shift=_place(shift))
    number = int(words.values["P"])
    system = 53 + number if number else int(after.system[1:])
    old, live = memory.offsets[system], words.values["L"] == 20
    memory.offsets[system] = _place(
        (position[i] - after.shift[i] if live else 0.0) + axes[i] * scale * (-1 if live else 1)
        if i in axes
        else old[i]
        for i in range(3)
    )
    return after


def _moves(words: Words, after: Modes, position: Place, memory: Memory) -> tuple[Move, ...]:
    if words.once in {"G28", "G30"}:
        place = memory.offsets[int(words.once[1:])]
        if not words.axes:
            return (Move(place),)
        end = _place(place[i] if i in words.axes else position[i] for i in range(3))
        return (Move(_target(words, after, position, memory)), Move(end))
    if not words.axes:
        return ()
    target = _target(words, after, position, memory)
    if after.motion == "G0":
        return (Move(target),)
    if after.feed_mode == "G94":
        return (Move(target, after.feed),)
    way = sum((a - b) ** 2 for a, b in zip(target, position, strict=True)) ** 0.5
    return (Move(target, max(way * after.feed, 1e-6)),)


def _target(words: Words, modes: Modes, position: Place, memory: Memory) -> Place:
    scale, axes = MM_PER_INCH if modes.units == "G20" else 1.0, words.axes
    if words.once == "G53":
        start: Place = (0.0, 0.0, 0.0)
    else:
        start = work_offset(modes, memory) if modes.distance == "G90" else position
    return _place(start[i] + axes[i] * scale if i in axes else position[i] for i in range(3))


def _place(values: Iterable[float]) -> Place:
    x, y, z = values
    return x, y, z
