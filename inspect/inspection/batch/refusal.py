"""Parts that are INVALID before they are photographed, because the part in the slot is a wrong one."""

from pathlib import Path

from anisoscope.base.progress import Advance, silent
from anisoscope.inspection.folder import new_folder
from anisoscope.inspection.job import prepare
from anisoscope.inspection.manifest import begin
from anisoscope.inspection.run import Inspected, conclude, expecting
from anisoscope.record.schema import Particulars
from anisoscope.rig.frame import Frame, write_frame

CODE_PICTURE = "code.tif"


def refuse_part(
    recipe_path: Path,
    rig_path: Path,
    serial: str,
    out: Path,
    reason: str,
    on_progress: Advance = silent,
    *,
    particulars: Particulars | None = None,
    picture: Frame | None = None,
) -> Inspected:
    """Record an inspection as INVALID for a reason; nothing moves.

    Args:
        recipe_path: recipe file.
        rig_path: rig file.
        serial: serial number under which it is recorded.
        out: folder that receives the inspection folder.
        reason: in one line.
        on_progress: progress.
        particulars: operator, lot, cavity, station.
        picture: what the code was read from; kept beside the record.

    Raises:
        UsageError, RecipeError, RigFileError, HeightMapError, CalibrationError: one of the files.
        RecordError: the folder cannot be written.
    """
    job = prepare(recipe_path, rig_path, serial)
    with expecting(job, on_progress) as ready, new_folder(out, serial) as folder:
        here = rig_path.resolve().parent
        started = begin(
            folder,
            job,
            particulars or Particulars(),
            plan=None,
            frames=0,
            rig_folder=here,
            refused=reason,
        )
        if picture is not None:
            write_frame(picture, folder / CODE_PICTURE)
        return conclude(folder, started, job, ready, on_progress)
