"""A finished inspection judged anew by its own frames, when the other parts of its lot are known."""

import contextlib
import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.progress import Advance, silent
from anisoscope.decision.reference_parts import golden_text
from anisoscope.inspection.folder import INPUTS, JOB, new_folder, working_in
from anisoscope.inspection.frames import read_frames
from anisoscope.inspection.job import LOT, LOT_NAME
from anisoscope.inspection.kept_measurement import KEPT_NAME
from anisoscope.inspection.manifest import InputCopy, checked_content, reopen, write_manifest
from anisoscope.inspection.objects import LARGE, share, store
from anisoscope.inspection.report_seal import OWN
from anisoscope.inspection.reports import Reports
from anisoscope.inspection.run import Inspected, Methods, conclude, expecting, judged_by, reported
from anisoscope.record.schema import RECORD_NAME, InputFile, read_record, sha256_of
from anisoscope.report.peers import LotMate

_MADE_ANEW = OWN | {JOB, KEPT_NAME, f"{INPUTS}/{LOT_NAME}"}


def judge_anew(
    folder: Path,
    mates: Sequence[LotMate],
    on_progress: Advance = silent,
    *,
    methods: Methods | None = None,
    reports: Reports | None = None,
) -> Inspected | None:
    """Judge a part by the frames of its finished inspection, compared with the other parts of its lot.

    A changed verdict is an inspection of its own, in a new folder next to that of the finished one, with the same
    frames; the finished one stays as it is.

    Args:
        folder: of the finished inspection.
        mates: inspections of the lot, the oldest first.
        on_progress: called with what is being done, steps done and steps in all.
        methods: what varies, for tests.
        reports: as for `anisoscope.inspection.run.inspect_part`.

    Returns:
        The inspection; None where the verdict stays, or the part is not compared with its lot.

    Raises:
        RecordError: a file of the folder is missing or was changed, or another process works in it.
        RecipeError, RigFileError, CalibrationError: a copy that this version cannot use.
    """
    folder = folder.resolve()
    with contextlib.ExitStack() as cleanup:
        cleanup.enter_context(working_in(folder))
        recorded = read_record(folder)
        manifest, job = reopen(folder)
        if job.reference is not None and manifest.input(LOT) is None:
            return None
        found = job.lot_parts(manifest.particulars.lot, mates)
        if found is None:
            return None
        parts = golden_text(found).encode()
        sha256 = hashlib.sha256(parts).hexdigest()
        copy = InputCopy(role=LOT, name=f"{INPUTS}/{LOT_NAME}", sha256=sha256, original="")
        before = f"{recorded.verdict} in {folder.name} ({RECORD_NAME} {sha256_of(folder / RECORD_NAME)})"
        inputs = (*(one for one in manifest.inputs if one.role != LOT), copy)
        manifest = manifest.model_copy(update={"inputs": inputs, "judged_anew": before})
        job = replace(job, reference=found)
        with expecting(job, on_progress, mates, methods) as ready:
            on_progress("measurement", 0, 1)
            judged = judged_by(manifest, job, ready, read_frames(folder, manifest), on_progress)
            if judged[0].verdict == recorded.verdict:
                ready.discard()
                return None
            new = cleanup.enter_context(new_folder(folder.parent, manifest.serial))
            for file in recorded.files:
                if file.name not in _MADE_ANEW:
                    _copy(file, folder, new)
            write_bytes(new / copy.name, parts)
            write_manifest(manifest, new)
            concluded = conclude(new, manifest, job, ready, on_progress, judged)
    return reported(*concluded, reports, on_progress)


def _copy(file: InputFile, folder: Path, new: Path) -> None:
    """Copy a file of a folder into another one; large ones are on the disk once."""
    content, path = checked_content(file, folder), new / file.name
    path.parent.mkdir(exist_ok=True)
    if len(content) < LARGE:
        write_bytes(path, content)
        return
    share(file, folder)
    store(content, file, new)
