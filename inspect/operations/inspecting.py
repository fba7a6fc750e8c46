"""One part is inspected, on a rig or from frames; finished inspections are judged again."""

from collections.abc import Sequence
from pathlib import Path

from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.inspection.recompute import Recomputed, recompute_or_reason
from anisoscope.inspection.replay import inspect_frames
from anisoscope.inspection.reports import Reports
from anisoscope.inspection.run import Inspected, UsedBefore, inspect_part, never_used
from anisoscope.parameters.workers import Workers
from anisoscope.record.schema import Particulars
from anisoscope.report.peers import LotMate
from anisoscope.study.sweep import again_after_a_kill


def inspect(
    recipe: Path | str,
    rig: Path | str | None = None,
    *,
    serial: str,
    frames: Path | str | None = None,
    reflectance: float = 0.99,
    out: Path | str = "inspections",
    particulars: Particulars | None = None,
    lot_mates: Sequence[LotMate] = (),
    reports: Reports | None = None,
    used_before: UsedBefore = never_used,
    reuse: str = "",
    on_progress: Advance = silent,
) -> Inspected:
    """Photograph a part on a rig, or take a folder of frames, and decide.

    Args:
        recipe: recipe file.
        rig: rig file; with ``frames`` the rig.toml in their folder where it is not given.
        serial: serial number of the part.
        frames: folder of frames (frames.csv) that another program took.
        reflectance: of the white tile in the flat frames of that folder.
        out: folder that receives the inspection folder.
        particulars: operator, lot, cavity, station and place, for the record.
        lot_mates: inspections of the same lot, for the report (`operations.remembering.lot_mates`).
        reports: writes reports beside further work; without it the report is written before this returns.
        used_before: whose frames were in earlier inspections (`operations.remembering.used_before`).
        reuse: reason for judging frames of another part all the same; it is kept in the record.
        on_progress: called with the work being done, steps done and steps in all.

    Returns:
        The record with its verdict (INVALID included), and the places of folder and report. Nothing enters a history:
        see `operations.remembering.remember`.

    Raises:
        UsageError: neither a rig nor frames, or frames of another part.
        AnisoscopeError: recipe, rig file, calibration or hardware.
    """
    who = Particulars() if particulars is None else particulars
    rig_path = None if rig is None else Path(rig)
    if frames is not None:
        return inspect_frames(
            Path(frames),
            Path(recipe),
            serial,
            Path(out),
            on_progress,
            rig_path=rig_path,
            reflectance=reflectance,
            particulars=who,
            lot_mates=lot_mates,
            reports=reports,
            used_before=used_before,
            reuse=reuse,
        )
    if rig_path is None:
        raise UsageError("name a rig file, or a folder of frames")
    if reuse:
        raise UsageError("--reuse says why frames of another part are judged: it needs a folder of --frames")
    return inspect_part(
        Path(recipe),
        rig_path,
        serial,
        Path(out),
        on_progress,
        particulars=who,
        lot_mates=lot_mates,
        used_before=used_before,
        reports=reports,
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
