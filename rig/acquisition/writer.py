"""Frames go to disk in a thread of their own, so that the camera need not wait for disk and hash."""

import contextlib
import hashlib
import os
import queue
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Self

from anisoscope.base.regular_file import regular_file
from anisoscope.rig.acquisition.interruptions import undisturbed
from anisoscope.rig.acquisition.journal import FrameLine, JournalFile
from anisoscope.rig.acquisition.plan import Pose
from anisoscope.rig.camera import Compression
from anisoscope.rig.frame import Frame, write_frame

FRAMES = "frames"


@dataclass(frozen=True)
class FrameRecord:
    """A frame and the file it was written to.

    Attributes:
        path: the file.
        frame: what was written.
        again: whether it only shows drift: taken after the return to the first pose, or on resuming.
        pose: the pose that was asked for.
        step: number of the frame in the plan; None for a check on resuming.
        sha256: of the file.
        linear_mm: readings of x, y and z, of a rig that has them.
        before: whether it was taken before this acquisition.
    """

    path: Path
    frame: Frame
    again: bool
    pose: Pose
    step: int | None
    sha256: str
    linear_mm: Mapping[str, float] = field(default_factory=dict)
    before: bool = False


@dataclass(frozen=True)
class Shot:
    """A frame that waits to be written; one that was taken before may have a file and its SHA-256 already."""

    frame: Frame
    pose: Pose
    step: int | None
    again: bool
    linear_mm: Mapping[str, float] = field(default_factory=dict)
    before: tuple[Path, str] | None = None


class FrameWriter:
    """Writes frame after frame and enters each in the journal, at most one behind the camera.

    So a program that is killed loses the frame in flight and no other. Leaving the context waits until
    everything handed over is on disk.

    Args:
        folder: the inspection folder; pictures go to ``frames`` in it.
        journal: its journal.
        run: number of the run.
        number: number of the next file.
        on_trouble: called, in the thread of the writer, when writing fails.
        compression: how frames are packed.
    """

    def __init__(
        self,
        folder: Path,
        journal: JournalFile,
        run: int,
        number: int,
        on_trouble: Callable[[], None],
        compression: Compression = "zlib",
    ) -> None:
        self.records: list[FrameRecord] = []
        self.part: tuple[str | None, str | None] = (None, None)
        """Serial number and lot of the sample, for the metadata of its frames."""
        self._folder, self._journal, self._run, self._number = folder, journal, run, number
        self._on_trouble, self._compression = on_trouble, compression
        self._waiting: queue.SimpleQueue[Shot | None] = queue.SimpleQueue()
        self._room = threading.Semaphore(1)
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="frame writer", daemon=True)

    def put(self, shot: Shot) -> None:
        """Hand over a frame; waits until the one before is on disk.

        Raises:
            RecordError: an earlier frame could not be written.
        """
        try:
            self._room.acquire()
        finally:  # an interruption here must not lose a frame that was taken
            self._waiting.put(shot)
        self.check()

    def check(self) -> None:
        """Raise what went wrong in writing, if anything."""
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        while (shot := self._waiting.get()) is not None:
            if self._error is None:
                try:
                    self._write(shot)
                except BaseException as problem:  # noqa: BLE001 - it is raised where the frames come from
                    self._error = problem
                    self._on_trouble()
            self._room.release()

    def _write(self, shot: Shot) -> None:
        frame = shot.frame
        if frame.kind == "sample":
            frame = replace(frame, serial=self.part[0], lot=self.part[1])
        path = self._folder / FRAMES / f"{self._number:03d}_{_name(frame, shot.pose)}.tif"
        if shot.before is None or not _linked(*shot.before, path):
            write_frame(frame, path, self._compression)
        _sync(path.parent)
        sha256 = _hash(path)
        line = FrameLine(
            run=self._run,
            step=shot.step,
            name=path.relative_to(self._folder).as_posix(),
            sha256=sha256,
            kind=frame.kind,
            again=shot.again,
            pose_deg=(shot.pose.stage_deg, shot.pose.tilt_deg),
            stage_deg=frame.stage_deg,
            tilt_deg=frame.tilt_deg,
            exposure_s=frame.exposure_s,
            gain=frame.gain,
            captured_at=frame.captured_at,
            linear_mm=dict(shot.linear_mm),
        )
        self._journal.append([line])
        self._number += 1
        self.records.append(
            FrameRecord(
                path,
                frame,
                shot.again,
                shot.pose,
                shot.step,
                sha256,
                shot.linear_mm,
                before=shot.before is not None,
            )
        )

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        with undisturbed():  # the journal must stay open until the last line is in it
            self._waiting.put(None)
            self._thread.join()
        if kind is None:
            self.check()


def _linked(source: Path, sha256: str, path: Path) -> bool:
    """Make a path a further name of a file, if that is as it was and the file system can."""
    try:
        os.link(source, path)
        return _hash(path) == sha256
    except OSError:
        return False


def _hash(path: Path) -> str:
    with regular_file(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _name(frame: Frame, pose: Pose) -> str:
    if frame.kind == "dark":
        return frame.kind
    tilt = f"_tilt{pose.tilt_deg:+06.2f}" if pose.tilt_deg else ""
    return f"{frame.kind}_{pose.stage_deg:07.2f}{tilt}"


def _sync(folder: Path) -> None:
    """Make the names in a folder safe against a power cut, where the system can."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
