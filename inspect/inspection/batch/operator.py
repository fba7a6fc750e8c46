"""Operator of a batch: questions to a person, and the behaviour of a tray without one."""

import contextlib
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Literal, Protocol

from anisoscope.base.progress import Advance, silent
from anisoscope.inspection.batch.journal import BatchFile, SlotResult
from anisoscope.inspection.batch.scan import Scan


@dataclass(frozen=True)
class Answer:
    """Answer of the operator before a part: go on (with the scanned text, if any), skip it, or stop."""

    what: Literal["go on", "skip", "stop"] = "go on"
    scan: Scan | None = None


class Operator(Protocol):
    """Protocol of an operator."""

    @property
    def interactive(self) -> bool:
        """Whether an operator is present to answer."""
        ...

    def place(self, slot: SlotResult, *, again: bool, needs_serial: bool) -> Answer:
        """Have the part of a slot placed; ``again`` where its inspection was interrupted before."""
        ...

    def place_all(self, parts: int) -> bool:
        """Have all parts put on the plate at once, of a tray that says where they lie; False stops."""
        ...

    def serial_of(self, slot: SlotResult, why: str) -> Scan | None:
        """Serial number of a part whose code cannot be read, scanned or typed; None without an answer."""
        ...

    def trouble(self, slot: SlotResult, faults: int) -> Literal["again", "go on", "stop"]:
        """Decision after several faults in a row."""
        ...

    def progress(self, batch: BatchFile, number: int) -> AbstractContextManager[Advance]:
        """Shows how far the part of a slot is."""
        ...

    def finished(self, batch: BatchFile, number: int) -> None:
        """A part is done, or failed to be."""
        ...


class Unattended:
    """Operator of trays that load themselves: parts are present, and two faults in a row end the batch."""

    @property
    def interactive(self) -> bool:
        """No person answers."""
        return False

    def place(self, slot: SlotResult, *, again: bool, needs_serial: bool) -> Answer:
        """Go on: the part is on the stage."""
        del slot, again, needs_serial
        return Answer()

    def place_all(self, parts: int) -> bool:
        """Go on: they lie there."""
        del parts
        return True

    def serial_of(self, slot: SlotResult, why: str) -> Scan | None:
        """None: the serial number is unknown."""
        del slot, why
        return None

    def trouble(self, slot: SlotResult, faults: int) -> Literal["again", "go on", "stop"]:
        """Stop: repairs need a person."""
        del slot, faults
        return "stop"

    @contextlib.contextmanager
    def progress(self, batch: BatchFile, number: int) -> Iterator[Advance]:
        """Silent."""
        del batch, number
        yield silent

    def finished(self, batch: BatchFile, number: int) -> None:
        """Silent."""


def seconds_left(batch: BatchFile) -> float | None:
    """Remaining time by the mean of the finished parts; None before the first part."""
    took = [one.seconds for one in batch.slots if one.seconds is not None]
    rest = sum(one.state in {"waiting", "at work"} for one in batch.slots)
    return sum(took) / len(took) * rest if took else None
