"""Pages of past inspections, from their folders: photographs, conclusions, and reports made again."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import AnisoscopeError, RecordError
from anisoscope.base.notation import true_minus
from anisoscope.base.progress import Advance, silent
from anisoscope.history.comparing import Comparison, record_of
from anisoscope.history.dispositions import Disposition
from anisoscope.history.rows import Row
from anisoscope.inspection.report_seal import report_state
from anisoscope.inspection.run import report_again
from anisoscope.kinds.parts import reporting
from anisoscope.kinds.registry import kind_named
from anisoscope.record.schema import REPORT_NAME, ConclusionRecord, FrameRecord, Record
from anisoscope.report.figures import photograph
from anisoscope.report.past_pages import Past, PosePair, write_compared_page, write_history_page
from anisoscope.rig.bayer import demosaicked
from anisoscope.rig.frame import Frame, read_frame

NEAR_DEG = 1.0
SATURATED_SHARE = 0.01


@dataclass(frozen=True, eq=False)
class Photograph:
    """One pose as the camera saw it.

    Attributes:
        stage_deg, tilt_deg: the pose.
        rate: (rows, cols) or (rows, cols, 3 of red, green, blue) counts per second of exposure and unit of gain; white
            is not balanced.
    """

    stage_deg: float
    tilt_deg: float
    rate: npt.NDArray[np.float32]


def photographs_of(
    folder: Path, record: Record, side_px: int, most: int | None = None
) -> tuple[Photograph, ...]:
    """A photograph of every pose whose frames are in the folder.

    Of several exposures the longest is shown that does not saturate.

    Args:
        folder: the inspection folder.
        record: its record.
        side_px: longer side of the pictures; frames are averaged down to it.
        most: at most so many poses, the first ones; all without.
    """
    angles = dict.fromkeys(
        (one.commanded_deg, one.tilt_deg or 0.0) for one in record.frames if _shows_the_part(one)
    )
    poses = [(pose.stage_deg, pose.tilt_deg) for pose in record.poses] or list(angles)
    found = []
    for stage_deg, tilt_deg in poses[:most]:
        frames = [one for one in record.frames if _shows_the_part(one) and _at(one, stage_deg, tilt_deg)]
        frame = _exposed(folder, frames)
        if frame is not None:
            found.append(Photograph(stage_deg, tilt_deg, _rate(frame, side_px)))
    return tuple(found)


def _shows_the_part(frame: FrameRecord) -> bool:
    return frame.kind == "sample" and not frame.again


def _at(frame: FrameRecord, stage_deg: float, tilt_deg: float) -> bool:
    off = (frame.commanded_deg - stage_deg + 180.0) % 360.0 - 180.0
    return abs(off) < NEAR_DEG and abs((frame.tilt_deg or 0.0) - tilt_deg) < NEAR_DEG


def _exposed(folder: Path, frames: Sequence[FrameRecord]) -> Frame | None:
    """The longest exposure that does not saturate; the shortest where all do; None where no frame can be read."""
    distinct = {one.exposure_s: one for one in frames}
    frame = None
    for _, one in sorted(distinct.items(), reverse=True):
        try:
            frame = read_frame(folder / one.name)
        except AnisoscopeError:
            continue
        if frame.saturated_share <= SATURATED_SHARE:
            return frame
    return frame


def _rate(frame: Frame, side_px: int) -> npt.NDArray[np.float32]:
    mono = frame.filters == "mono"
    counts = frame.counts if mono else demosaicked(frame.counts, frame.filters)
    scale = min(1.0, side_px / max(counts.shape[:2]))
    small = cv2.resize(counts.astype(np.float32), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    rate = (small - frame.black_level) / (frame.exposure_s * frame.gain)
    return np.asarray(np.maximum(rate, 0.0), dtype=np.float32)


THUMBNAIL_PX = 144
PHOTOGRAPH_PX = 420
WHITE_PERCENT = 99.5


def history_page(
    path: Path,
    rows: Sequence[Row],
    decided: Mapping[int, Sequence[Disposition]],
    total: int,
    source: str,
    advance: Advance = silent,
) -> None:
    """Write the page of a selection of inspections; arguments as of `write_history_page`."""
    past = []
    for number, row in enumerate(rows):
        advance("page of the history", number, len(rows))
        past.append(_past(row, decided.get(row.id, ()), thumbnail=True))
    write_history_page(path, past, total, source)


def compared_page(path: Path, found: Comparison, decided: Mapping[int, Sequence[Disposition]]) -> None:
    """Write the page of two inspections."""
    rows = (found.first, found.second)
    first, second = (_past(row, decided.get(row.id, ()), thumbnail=False) for row in rows)
    write_compared_page(path, found, (first, second), _pairs(*(_photographs(row) for row in rows)))


def inspection_page(path: Path, row: Row, *, refresh: bool, advance: Advance = silent) -> str:
    """Write the report of an inspection to a file: that of its folder, or one made again from the frames.

    Args:
        path: file to write.
        row: the inspection.
        refresh: make it again in any case.
        advance: progress.

    Returns:
        Where it comes from, in words.

    Raises:
        RecordError: the folder is gone, its record is another one, or it holds too little for a report.
    """
    folder, record = Path(row.folder), record_of(row)
    report = folder / REPORT_NAME
    found = report_state(folder).state
    if not refresh and found == "written":
        if path.resolve() != report.resolve():
            try:
                shutil.copyfile(report, path)
            except OSError as error:
                raise RecordError(f"cannot write {path}: {error.strerror}") from error
        return "as the inspection wrote it"
    write_text(path, report_again(folder, _concluded(record), advance))
    if refresh:
        return "made again from the frames"
    return f"made again from the frames, because {report} is {found}"


def _concluded(record: Record) -> Record:
    """The record with a conclusion; one of an earlier version gets it from its kind."""
    conclusion = record.conclusion or reporting(kind_named(record.kind)).conclude(record)
    return record.model_copy(update={"conclusion": conclusion})


def _past(row: Row, decided: Sequence[Disposition], *, thumbnail: bool) -> Past:
    last = decided[-1] if decided else None
    disposition = None if last is None else f"{last.decision}: {last.reviewer}"
    conclusion: ConclusionRecord | None = None
    picture = None
    try:
        record = record_of(row)
        conclusion = _concluded(record).conclusion
        shown = photographs_of(Path(row.folder), record, THUMBNAIL_PX, 1) if thumbnail else ()
        picture = _picture(shown[0], _white(shown)) if shown else None
    except AnisoscopeError:  # the folder is gone or damaged: the row is what is left
        pass
    return Past(row, conclusion, disposition, picture, (Path(row.folder) / REPORT_NAME).is_file())


def thumbnail_of(row: Row) -> str | None:
    """The part at the first pose as a data URI; None where its folder is gone or damaged."""
    return _past(row, (), thumbnail=True).thumbnail


def _photographs(row: Row) -> tuple[Photograph, ...]:
    try:
        return photographs_of(Path(row.folder), record_of(row), PHOTOGRAPH_PX)
    except AnisoscopeError:
        return ()


def _pairs(first: Sequence[Photograph], second: Sequence[Photograph]) -> tuple[PosePair, ...]:
    """Photographs of the same pose, on one brightness scale."""
    sides = [{(one.stage_deg, one.tilt_deg): one for one in side} for side in (first, second)]
    found = []
    for pose in dict.fromkeys((*sides[0], *sides[1])):
        both = [side.get(pose) for side in sides]
        white = _white([one for one in both if one is not None])
        uris = [None if one is None else _picture(one, white) for one in both]
        found.append(PosePair(true_minus(f"{pose[0]:g}°, tilt {pose[1]:g}°"), *uris))
    return tuple(found)


def _white(shown: Sequence[Photograph]) -> float:
    return max(1e-9, *(float(np.percentile(one.rate, WHITE_PERCENT)) for one in shown))


def _picture(one: Photograph, white: float) -> str:
    return photograph(one.rate if one.rate.ndim == 2 else one.rate[..., ::-1], white, jpeg=True)
