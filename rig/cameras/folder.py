"""A camera that replays a folder of frames, to inspect recorded data again.

Frames come strictly in the order of ``frames.csv``. A camera does not know whether the light is on, so the plan
that asks has to be the one with which the frames were taken: dark frames first, then the poses in order. What
can be checked is checked: exposure and gain that are set must be those of the next frame, and after the last
frame there is none.
"""

import math
from pathlib import Path
from typing import get_args

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError, RecordError, RigFileError
from anisoscope.rig.camera import CameraInfo, CameraSettings
from anisoscope.rig.frame import FrameKind
from anisoscope.rig.framefolder import FrameEntry, read_frame_folder

SAME_SETTING = 1e-3
"""Relative difference up to which a requested exposure or gain is that of a frame."""


class FolderCamera:
    """A camera whose frames lie in a folder; see `anisoscope.rig.framefolder`."""

    def __init__(self, entries: tuple[FrameEntry, ...], info: CameraInfo, *, repeat: bool = False) -> None:
        self.info = info
        self._entries = entries
        self._repeat = repeat
        self._next = 0
        self._settings: CameraSettings | None = None

    @classmethod
    def open(
        cls,
        *,
        folder: str | Path,
        kinds: str = "",
        serial: str = "",
        linear: bool = True,
        repeat: bool = False,
    ) -> "FolderCamera":
        """Open a folder.

        Args:
            folder: the folder with ``frames.csv``.
            kinds: what is replayed, as ``"dark,sample"``; everything if empty.
            serial: serial number of the camera that took the frames; a white reference asks for it.
            linear: whether its counts grow in proportion to light.
            repeat: start again after the last frame, for a live picture.

        Raises:
            RigFileError: the folder or a picture in it cannot be used, or a kind is unknown.
        """
        selected = {kind.strip() for kind in kinds.split(",") if kind.strip()}
        if unknown := selected - set(get_args(FrameKind)):
            known = ", ".join(get_args(FrameKind))
            raise RigFileError(f"camera.options.kinds: unknown: {', '.join(sorted(unknown))}; known: {known}")
        try:
            read = read_frame_folder(Path(folder))
        except RecordError as problem:
            raise RigFileError(f"camera.options.folder: {problem}") from problem
        entries = tuple(entry for entry in read.entries if not selected or entry.kind in selected)
        if not entries:
            raise RigFileError(f"camera.options.kinds: {folder} holds no frames of kind {kinds}")
        sensors = {(entry.bit_depth, entry.black_level) for entry in entries}
        if len(sensors) > 1:
            raise RigFileError(
                f"camera.options.folder: {folder}: bit_depth and black_level change from frame to frame; "
                "one camera has one of each"
            )
        bit_depth, black_level = sensors.pop()
        info = CameraInfo(
            model=f"frames of {read.folder.resolve().name}",
            serial=serial or "replay",
            rows=read.rows,
            cols=read.cols,
            bit_depth=bit_depth,
            black_level=black_level,
            linear=linear,
            filters=read.filters,
        )
        return cls(entries, info, repeat=repeat)

    @property
    def left(self) -> int:
        """Number of frames that were not served yet."""
        return len(self._entries) - self._next

    def configure(self, exposure_s: float, gain: float) -> CameraSettings:
        """Settings of the next frame, which must equal the requested ones.

        Raises:
            CameraError: they are others, or there is no next frame.
        """
        entry = self._upcoming()
        if not (_same(exposure_s, entry.exposure_s) and _same(gain, entry.gain)):
            raise CameraError(
                f"{entry.path} was taken with {entry.exposure_s:g} s and gain {entry.gain:g}, but "
                f"{exposure_s:g} s and gain {gain:g} are asked for; replay with the plan of the recording"
            )
        self._settings = CameraSettings(entry.exposure_s, entry.gain)
        return self._settings

    def grab(self) -> npt.NDArray[np.uint16]:
        """The next frame, (rows, cols) counts.

        Raises:
            CameraError: ``configure`` was not called, or with other settings than those of the next frame; there
                is no next frame; or its file has gone.
        """
        if self._settings is None:
            raise CameraError("the camera was asked for a frame before exposure and gain were set")
        entry = self._upcoming()
        self.configure(self._settings.exposure_s, self._settings.gain)
        try:
            counts = entry.load().counts
        except RecordError as problem:
            raise CameraError(str(problem)) from problem
        if counts.shape != (self.info.rows, self.info.cols):
            raise CameraError(f"{entry.path}: has another size than when the folder was opened")
        self._next += 1
        return counts

    def close(self) -> None:
        """Nothing is held."""

    def _upcoming(self) -> FrameEntry:
        if self._next == len(self._entries) and self._repeat:
            self._next = 0
        if self._next == len(self._entries):
            raise CameraError(
                f"{self._entries[0].path.parent}: all {len(self._entries)} frames were served; the plan asks "
                "for more than were recorded"
            )
        return self._entries[self._next]


def _same(requested: float, recorded: float) -> bool:
    return math.isclose(requested, recorded, rel_tol=SAME_SETTING)
