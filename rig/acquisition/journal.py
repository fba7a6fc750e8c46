"""The journal of an acquisition: one line of JSON for every start and every frame, safe on disk before the next.

``frames.jsonl`` is only ever appended to. A frame counts once its line is there, and its line is written after
its picture; so whatever ends the program, what the journal names is complete.
"""

import json
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from anisoscope.base.errors import RecordError
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.rig.acquisition.plan import Pose
from anisoscope.rig.frame import FrameKind

JOURNAL = "frames.jsonl"


class _Line(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class RunLine(_Line):
    """The start of a run: the first, or one that takes up an interrupted one.

    ``linear`` says whether the camera counts in proportion to light, as far as it is known; ``filters`` names the
    colour filters on its pixels (`anisoscope.rig.bayer`).
    """

    line: Literal["run"] = "run"
    run: int
    stage: str
    tilt: str | None
    camera: str
    filters: str = "mono"
    started_at: str
    linear: bool = True


class FrameLine(_Line):
    """A frame on disk: its file and its acquisition settings.

    ``pose_deg`` is (stage, tilt) as asked for, ``stage_deg`` and ``tilt_deg`` as read back. ``step`` is the number
    of the frame in the plan; None for one that checks the first pose on resuming. ``linear_mm`` are the readings of x,
    y and z, of a rig that has them.
    """

    line: Literal["frame"] = "frame"
    run: int
    step: int | None
    name: str
    sha256: str
    kind: FrameKind
    again: bool
    pose_deg: tuple[float, float]
    stage_deg: float
    tilt_deg: float
    exposure_s: float
    gain: float
    captured_at: str
    linear_mm: dict[str, float] = Field(default_factory=dict, exclude_if=lambda value: not value)

    @property
    def pose(self) -> Pose:
        """The requested pose."""
        return Pose(*self.pose_deg)


_ANY: TypeAdapter[RunLine | FrameLine] = TypeAdapter(
    Annotated[RunLine | FrameLine, Field(discriminator="line")]
)


@dataclass(frozen=True)
class Journal:
    """A journal as it was read: its starts and its frames, in order."""

    runs: tuple[RunLine, ...] = ()
    frames: tuple[FrameLine, ...] = ()

    @property
    def by_step(self) -> dict[int, FrameLine]:
        """The latest frame of every acquired step of the plan."""
        return {line.step: line for line in self.frames if line.step is not None}

    def checks(self, frames_per_pose: int) -> tuple[FrameLine, ...]:
        """The frames that checked the first pose on resuming, of the runs that took all of them."""
        found: list[FrameLine] = []
        for run in self.runs:
            group = [line for line in self.frames if line.run == run.run and line.step is None]
            found += group if len(group) >= frames_per_pose else []
        return tuple(found)


def read_journal(folder: Path) -> Journal:
    """Read the journal of a folder; empty if there is none. A torn last line is ignored.

    Raises:
        RecordError: it cannot be read, or a line is damaged.
    """
    path = folder / JOURNAL
    try:
        data = bounded_bytes(path)
    except FileNotFoundError:
        return Journal()
    except OSError as problem:
        raise RecordError(f"{path}: cannot be read: {problem.strerror}") from problem
    *whole, _torn = data.split(b"\n")
    lines: list[RunLine | FrameLine] = []
    for number, text in enumerate(whole, start=1):
        try:
            lines.append(_ANY.validate_json(text))
        except ValidationError:
            raise RecordError(f"{path}: line {number} is damaged; this folder cannot be trusted") from None
    return Journal(
        tuple(line for line in lines if isinstance(line, RunLine)),
        tuple(line for line in lines if isinstance(line, FrameLine)),
    )


class JournalFile:
    """The journal of a folder, open for appending; a torn last line of an earlier run is cut off.

    Raises:
        RecordError: it cannot be opened.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / JOURNAL
        try:
            self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
            data = bounded_bytes(self.path)
            os.ftruncate(self._file, data.rfind(b"\n") + 1)
        except OSError as problem:
            raise RecordError(f"{self.path}: cannot be written: {problem.strerror}") from problem

    def append(self, lines: Iterable[RunLine | FrameLine]) -> None:
        """Append lines; they are on disk when this returns.

        Raises:
            RecordError: the disk is full, or the folder is gone.
        """
        text = "".join(json.dumps(line.model_dump(mode="json")) + "\n" for line in lines)
        try:
            os.write(self._file, text.encode())
            os.fsync(self._file)
        except OSError as problem:
            raise RecordError(f"{self.path}: cannot be written: {problem.strerror}") from problem

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._file)
