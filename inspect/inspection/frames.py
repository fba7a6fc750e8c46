"""The frames of an inspection, read back from its folder: those that count, each with its hash checked."""

from collections.abc import Callable, Mapping
from pathlib import Path

from anisoscope.base.errors import RecordError
from anisoscope.base.parallel import for_each
from anisoscope.imaging.frames import AcquiredFrames, Shot
from anisoscope.inspection.frame_table import linear_entries
from anisoscope.inspection.manifest import Manifest, checked, checked_content
from anisoscope.record.schema import InputFile
from anisoscope.rig.acquisition.journal import FrameLine, Journal, read_journal
from anisoscope.rig.acquisition.writer import FRAMES
from anisoscope.rig.cameras.response import read_response
from anisoscope.rig.frame import Frame, frame_of
from anisoscope.rig.framefolder import frame_entries

NOT_USED = "not used"
RESPONSE = "camera response"
"""Role of the curve through which frames of a camera that is not linear were read."""
REPLAYED = "as the table of the frames says"


def missing_frames(manifest: Manifest, journal: Journal) -> int:
    """Number of frames still to be photographed."""
    if manifest.plan is None:
        return manifest.frames - len(journal.frames)
    return manifest.plan.frame_count - len(manifest.plan.complete(journal.by_step))


def check_frames(folder: Path) -> None:
    """Check that the frames of a folder are unchanged.

    Raises:
        RecordError: one is missing or was changed; it is named.
    """
    for line in read_journal(folder).frames:
        checked(InputFile(name=line.name, sha256=line.sha256), folder)


def read_frames(folder: Path, manifest: Manifest, fresh: Mapping[str, Frame] | None = None) -> AcquiredFrames:
    """Read the frames of a folder that has all of them.

    Args:
        folder: the inspection folder.
        manifest: how the inspection began.
        fresh: frames that this process has just written, by their names; they are not read again.

    Raises:
        RecordError: a frame is missing, was changed or is damaged.
    """
    if manifest.frames == 0:
        return AcquiredFrames((), NOT_USED, NOT_USED)
    journal = read_journal(folder)
    if missing_frames(manifest, journal) > 0:
        raise RecordError(f"{folder}: {missing_frames(manifest, journal)} frames are still to be taken")
    lines = [*journal.by_step.values(), *journal.checks(manifest.plan.shots_per_pose if manifest.plan else 1)]
    load = _loader(folder, manifest)
    shots = tuple(for_each(lambda line: _shot(line, folder, load, fresh or {}), lines))
    first = shots[0].frame
    for shot in shots:
        if (shot.frame.counts.shape, shot.frame.bit_depth) != (first.counts.shape, first.bit_depth):
            raise RecordError(f"{folder / shot.name}: other size or bit depth than {shots[0].name}")
    run = journal.runs[-1]
    stage = run.stage if run.tilt is None else f"{run.stage}, {run.tilt}"
    return AcquiredFrames(shots, run.camera, stage, all(one.linear for one in journal.runs))


def _shot(
    line: FrameLine, folder: Path, load: Callable[[bytes, str], Frame], fresh: Mapping[str, Frame]
) -> Shot:
    """A frame from one read of its file, which is hashed and decoded."""
    frame = fresh.get(line.name)
    if frame is None:
        frame = load(checked_content(InputFile(name=line.name, sha256=line.sha256), folder), line.name)
    check = line.step is None
    return Shot(line.name, line.sha256, frame, line.pose, line.again, line.run, check, line.linear_mm)


def _loader(folder: Path, manifest: Manifest) -> Callable[[bytes, str], Frame]:
    """Decoder of the bytes of a frame by its name; frames of a replay are described by their table."""
    if manifest.origin == "rig":
        return lambda content, name: frame_of(content, folder / name)
    read = tuple(frame_entries(folder / FRAMES))
    for copy in manifest.inputs:
        if copy.role == RESPONSE:
            read = linear_entries(read, read_response(checked(copy, folder)))
    entries = {entry.path: entry for entry in read}

    def load(content: bytes, name: str) -> Frame:
        entry = entries.get((folder / name).resolve())
        if entry is None:
            raise RecordError(f"{folder / name}: is in the journal, but not in the table of the frames")
        return entry.load(content)

    return load
