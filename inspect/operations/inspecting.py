"""One part is inspected, on a rig or from frames; finished inspections are judged again."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.inspection.recompute import Recomputed, recompute_or_reason
from anisoscope.inspection.replay import inspect_frames
from anisoscope.inspection.reports import Reports
from anisoscope.inspection.run import Inspected, UsedBefore, inspect_part, never_used
from anisoscope.parameters.inspecting import ForeignFrames, PartLabels
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.workers import Workers
from anisoscope.record.schema import Particulars
from anisoscope.report.peers import LotMate
from anisoscope.study.sweep import again_after_a_kill


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What is known besides a part when it is inspected.

    Attributes:
        lot_mates: inspections of the same lot, for the report (`operations.remembering.lot_mates`).
        used_before: whose frames were in earlier inspections (`operations.remembering.used_before`).
        reports: writes reports beside further work; without it the report is written before the inspection ends.
    """

    lot_mates: Sequence[LotMate] = ()
    used_before: UsedBefore = never_used
    reports: Reports | None = None


ALONE = Surroundings()


@by_keywords(labels=PartLabels, foreign=ForeignFrames)
def inspect(
    recipe: Path | str,
    rig: Path | str | None = None,
    *,
    labels: PartLabels,
    foreign: ForeignFrames,
    out: Path | str = "inspections",
    known: Surroundings = ALONE,
    on_progress: Advance = silent,
) -> Inspected:
    """Photograph a part on a rig, or take a folder of frames, and decide: ``anisoscope inspect`` from Python.

    Args:
        recipe: recipe file.
        rig: rig file; with ``frames`` the rig.toml in their folder where it is not given.
        labels: serial number, operator, lot, cavity, station and place, or these as keywords.
        foreign: frames that another program took, or the fields as keywords.
        out: folder that receives the inspection folder.
        known: inspections of the lot, users of the frames, and the writer of reports.
        on_progress: called with the work being done, steps done and steps in all.

    Returns:
        The record with its verdict (INVALID included), and the places of folder and report. Nothing enters a history:
        see `operations.remembering.remember`.

    Raises:
        UsageError: no serial number, neither a rig nor frames, or frames of another part.
        AnisoscopeError: recipe, rig file, calibration or hardware.
    """
    if labels.serial is None:
        raise UsageError("name the part: its serial number is missing")
    who = Particulars(
        operator=labels.operator,
        lot=labels.lot,
        cavity=labels.cavity,
        station=labels.station,
        place_mm=labels.at_mm,
    )
    here, rig_path = vars(known), None if rig is None else Path(rig)
    if foreign.frames is not None:
        return inspect_frames(
            Path(foreign.frames),
            Path(recipe),
            labels.serial,
            Path(out),
            on_progress,
            rig_path=rig_path,
            reflectance=foreign.reflectance,
            particulars=who,
            reuse=foreign.reuse,
            **here,
        )
    if rig_path is None:
        raise UsageError("name a rig file, or a folder of frames")
    if foreign.reuse:
        raise UsageError("--reuse says why frames of another part are judged: it needs a folder of --frames")
    return inspect_part(
        Path(recipe), rig_path, labels.serial, Path(out), on_progress, particulars=who, **here
    )


def recompute_all(
    folders: Sequence[Path], workers: Workers, on_progress: Advance = silent
) -> list[Recomputed | str]:
    """Judge inspections again from their raw frames, in processes side by side; nothing is written.

    Args:
        folders: inspection folders.
        workers: processes of this machine or of a cluster.
        on_progress: called with folders done and folders in all.

    Returns:
        For each folder the comparison with its record, or the reason why it cannot be judged again.

    Raises:
        SweepError: the processes end again and again.
    """
    return again_after_a_kill(
        recompute_or_reason, [folder.resolve() for folder in folders], workers, on_progress
    )
