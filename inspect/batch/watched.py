"""What is watched, and who is told what happens."""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from anisoscope.batch.arrivals import Signature
from anisoscope.batch.codes import Kind
from anisoscope.inspection import Inspected
from anisoscope.progress import Advance, silent
from anisoscope.report.peers import LotMates, no_lot_mates

Remember = Callable[[Inspected], None]


class Listener(Protocol):
    """Who is told what happens."""

    def inspected(self, name: str, inspected: Inspected) -> None:
        """The frames of a folder were judged."""
        ...

    def same(self, name: str, other: str) -> None:
        """A folder holds frames that were inspected already, in another one."""
        ...

    def bad(self, name: str, reason: str) -> None:
        """A folder cannot be inspected as it is."""
        ...

    def progress(self, name: str) -> contextlib.AbstractContextManager[Advance]:
        """Shows how far the inspection of a folder is."""
        ...


@dataclass(frozen=True, eq=False)
class Watched:
    """What is watched, and how.

    Attributes:
        root: the folder in which folders of frames arrive.
        out: where inspections and the journal go; every folder of frames gets a folder of its name there.
        recipe: recipe file.
        rig: rig file, or None for ``rig.toml`` in every folder.
        reflectance: of the white tile in flat frames.
        settle_s: how long a folder must have kept still.
        poll_s: pause between looks.
        code_kind: kind of code that every part bears, which says who it is; None where codes are not read.
        lot_mates: who was inspected before of a lot, for the reports; must not raise.
    """

    root: Path
    out: Path
    recipe: Path
    rig: Path | None = None
    reflectance: float = 0.99
    settle_s: float = 2.0
    poll_s: float = 1.0
    code_kind: Kind | None = None
    lot_mates: LotMates = no_lot_mates


@dataclass(frozen=True)
class Bad:
    """A folder that cannot be inspected as it is; ``retry_at`` where the reason may lie elsewhere."""

    signature: Signature
    reason: str
    retry_at: float | None = None


@contextlib.contextmanager
def silence(name: str) -> Iterator[Advance]:
    """Progress that nobody sees."""
    del name
    yield silent
