"""What inspections have in common: files that are on the disk once, and the dark frames of a series.

**Objects** are files ``objects/ab/cdef….tif`` next to the inspection folders, named by the hash of their content. Each
is a hard link: the same file has its usual name in every inspection folder that needs it. So every folder is complete,
and whatever copies, moves or sends one takes all of it along. Objects are read-only, as an edit in one folder would
change all; an object with no other name is cleared away. Where the file system has no hard links, folders hold copies.

**Dark frames** are taken once a series. An inspection takes one of every exposure itself. Where it agrees with those
of the series, the others come from there, captured before it began; where it does not, as after other light was
switched on, all are taken, and begin a new series. The rig file limits how long a series lasts.
"""

import contextlib
import hashlib
import json
import logging
import os
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache, lru_cache
from pathlib import Path, PurePosixPath
from typing import Literal

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_bytes, write_text
from anisoscope.base.errors import RecordError
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes
from anisoscope.record.schema import InputFile, sha256_of
from anisoscope.rig.acquisition.plan import Plan, Pose
from anisoscope.rig.acquisition.runner import Rig
from anisoscope.rig.acquisition.writer import FrameRecord, Shot
from anisoscope.rig.frame import Frame, frame_of

OBJECTS = "objects"
ARCHIVE = "archive.json"
"""Marks a folder as an archive, whose objects have no other names."""
_OF_MANY = ("batch.json", "watch.jsonl")
LARGE = 1 << 16
"""Smaller inputs are copied: a link would save nothing."""
GRACE = timedelta(days=1)
"""Objects without another name stay so long: dark frames of a series whose inspections went to the archive."""
_log = logging.getLogger("anisoscope.objects")


def objects_of(folder: Path) -> Path:
    """Objects of an inspection folder: next to it; in a batch or a watch, next to the folders of all parts."""
    out = folder.parent
    return (out.parent if any((out.parent / name).exists() for name in _OF_MANY) else out) / OBJECTS


def object_name(file: InputFile) -> str:
    """Name of the object of a file, below ``objects``; it has the ending of the file, by which formats are known."""
    return f"{file.sha256[:2]}/{file.sha256[2:]}{PurePosixPath(file.name).suffix.lower()}"


def store(content: bytes, file: InputFile, folder: Path) -> None:
    """Store the content of a file of an inspection folder, and share it.

    Args:
        content: of the file.
        file: its name in the folder, and its SHA-256.
        folder: the inspection folder.

    Raises:
        OSError, RecordError: it cannot be written.
    """
    path = folder / file.name
    with contextlib.suppress(OSError):
        _link(_whole_object(file, folder), path)
        return
    if not path.exists():
        write_bytes(path, content)
    share(file, folder)


def share(file: InputFile, folder: Path) -> bool:
    """Let a file of an inspection folder be the object of its hash: one file on the disk, under several names.

    An object that is damaged, or that can have no further name (65,000 on ext4), is replaced by the file.

    Returns:
        False where the file system has no hard links: the folder has a copy of its own then.
    """
    path, place = folder / file.name, objects_of(folder) / object_name(file)
    with contextlib.suppress(OSError):
        _link(_whole_object(file, folder), path)
        return True
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        if os.name == "posix":  # others refuse to remove what is read-only
            path.chmod(path.stat().st_mode & ~0o222)
        _link(path, place)
    except OSError as error:
        _say_once(place.parents[1], error.strerror or str(error))
        return False
    return True


def _whole_object(file: InputFile, folder: Path) -> Path:
    """The object of a file; an `OSError` where there is none, or a damaged one."""
    place = objects_of(folder) / object_name(file)
    if sha256_of(place) != file.sha256:
        raise OSError
    return place


def _link(source: Path, path: Path) -> None:
    """Make a path a further name of a file, at once; what had that name loses it."""
    if path.exists() and path.samefile(source):
        return
    partial = path.with_name(f".{uuid.uuid4().hex}.partial")
    try:
        os.link(source, partial)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


@cache
def _say_once(objects: Path, reason: str) -> None:
    _log.warning("%s: no hard links (%s): every inspection keeps copies of its own", objects, reason)


def clear_unused(objects: Path, now: datetime) -> int:
    """Delete objects of more than a day that no inspection folder has any more; how many."""
    count = 0
    if (objects.parent / ARCHIVE).exists():
        return count
    for path in objects.glob("??/*"):
        with contextlib.suppress(OSError):
            found = path.stat()
            unused = found.st_nlink == 1 or path.suffix == ".partial"
            if unused and now - datetime.fromtimestamp(found.st_mtime, UTC) > GRACE:
                path.unlink()
                count += 1
    return count


SERIES = "darks"
BLOCKS = 8
"""A picture is compared by the means of so many blocks along either side."""
LEVEL_SHARE = 2.0**-13
"""Difference of a block, as a share of full scale, that is no change: half a count of 12 bits."""
SIGMAS = 6.0


class SeriesFrame(BaseModel):
    """A dark frame of a series: its object, its step in the plan, and the pose (stage, tilt) in degrees."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    step: int
    sha256: str
    pose_deg: tuple[float, float]


class SeriesFile(BaseModel):
    """``objects/darks/….json``: the shared frames of a series, and when they were taken (UTC)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_version: Literal[1] = Field(1, alias="schema")
    taken_at: datetime
    frames: tuple[SeriesFrame, ...]


@dataclass(frozen=True, eq=False)
class SharedDarks:
    """Dark frames that an inspection may take over, with their files."""

    shots: tuple[Shot, ...]

    def agree(self, own: Sequence[Frame]) -> bool:
        """Whether dark frames taken now, one of every exposure, are as those of the series."""
        return all(self._agrees(frame) for frame in own)

    def _agrees(self, own: Frame) -> bool:
        known = [one.frame for one in self.shots if one.frame.exposure_s == own.exposure_s]
        if not known or any(
            (one.counts.shape, one.gain, one.bit_depth, one.black_level, one.camera)
            != (own.counts.shape, own.gain, own.bit_depth, own.black_level, own.camera)
            for one in known
        ):
            return False
        stacked = np.mean([_blocks(one) for one in known], axis=0)
        noise = float(np.std(own.counts.astype(np.float32) - known[0].counts)) / np.sqrt(2.0)
        of_block = noise * BLOCKS / np.sqrt(own.counts.size) * np.sqrt(1.0 + 1.0 / len(known))
        limit = LEVEL_SHARE * own.full_scale + SIGMAS * of_block
        return bool(np.max(np.abs(_blocks(own) - stacked)) <= limit)


def _blocks(frame: Frame) -> FloatArray:
    small = cv2.resize(frame.counts.astype(np.float32), (BLOCKS, BLOCKS), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float64)


def shared_darks(folder: Path, plan: Plan, rig: Rig, now: datetime) -> SharedDarks | None:
    """The dark frames of the present series of a rig, or None where an inspection has to take all of them.

    Args:
        folder: the inspection folder.
        plan: what is to be photographed.
        rig: the opened rig.
        now: the time, UTC.
    """
    if plan.dark_frames < 2 or rig.file.camera.share_darks_s <= 0.0:
        return None
    try:
        series = SeriesFile.model_validate_json(bounded_bytes(_series_path(folder, plan, rig)))
    except (OSError, ValidationError):
        return None
    age_s = (now - series.taken_at).total_seconds()
    if not 0.0 <= age_s <= rig.file.camera.share_darks_s:  # a clock that was set back ends a series too
        return None
    objects = objects_of(folder)
    names = tuple(InputFile(name=_DARK, sha256=one.sha256) for one in series.frames)
    try:
        frames = _frames(tuple((objects / object_name(name), name.sha256) for name in names))
    except (OSError, RecordError):
        return None
    return SharedDarks(
        tuple(
            Shot(frame, Pose(*one.pose_deg), one.step, again=False, before=before)
            for one, (frame, before) in zip(series.frames, frames, strict=True)
        )
    )


_DARK = "dark.tif"


@lru_cache(maxsize=1)
def _frames(files: tuple[tuple[Path, str], ...]) -> list[tuple[Frame, tuple[Path, str]]]:
    """The frames of a series from files and their hashes, each hashed and decoded once in a process."""
    found = []
    for path, sha256 in files:
        content = bounded_bytes(path, MOST_PICTURE_BYTES)
        if hashlib.sha256(content).hexdigest() != sha256:
            raise RecordError(f"{path}: was changed")
        found.append((frame_of(content, path), (path, sha256)))
    return found


def begin_series(folder: Path, plan: Plan, rig: Rig, taken: Sequence[FrameRecord], now: datetime) -> None:
    """Share the dark frames that an inspection took, if it took all of them; one of every exposure stays its own.

    What cannot be shared stays as it is: nothing depends on it.
    """
    own = {steps[0] for steps in plan.dark_steps}
    wanted = {step for steps in plan.dark_steps for step in steps} - own
    darks = [one for one in taken if one.step in wanted and not one.before]
    if rig.file.camera.share_darks_s <= 0.0 or len(darks) < len(wanted) or not wanted:
        return
    try:
        if not all(share(_file_of(one, folder), folder) for one in darks):
            return
        frames = tuple(
            SeriesFrame(step=one.step, sha256=one.sha256, pose_deg=(one.pose.stage_deg, one.pose.tilt_deg))
            for one in darks
            if one.step is not None
        )
        path = _series_path(folder, plan, rig)
        path.parent.mkdir(parents=True, exist_ok=True)
        series = SeriesFile(taken_at=now.astimezone(UTC), frames=frames)
        write_text(path, series.model_dump_json(by_alias=True))
        clear_unused(objects_of(folder), now)
    except (OSError, RecordError):
        return


def _file_of(one: FrameRecord, folder: Path) -> InputFile:
    return InputFile(name=one.path.relative_to(folder).as_posix(), sha256=one.sha256)


def _series_path(folder: Path, plan: Plan, rig: Rig) -> Path:
    info = rig.camera.info
    key = [info.model, info.serial, info.filters, plan.exposures_s, plan.gain, plan.dark_frames]
    name = hashlib.sha256(json.dumps(key).encode()).hexdigest()[:16]
    return objects_of(folder) / SERIES / f"{name}.json"
