"""Folders of one part: its finished inspection, the one to resume, and those without a result."""

import contextlib
import shutil
from pathlib import Path

from anisoscope.base.errors import RecordError
from anisoscope.inspection.folder import JOB, working_in
from anisoscope.inspection.manifest import read_job_file
from anisoscope.inspection.run import Inspected
from anisoscope.record.schema import RECORD_NAME, REPORT_NAME, read_record
from anisoscope.rig.acquisition.journal import JOURNAL


def finished_in(home: Path) -> Path | None:
    """The latest finished inspection below a folder, or None."""
    return _latest([path for path in _folders(home) if (path / RECORD_NAME).exists()])


def unfinished_in(home: Path) -> Path | None:
    """The latest inspection below a folder that can be resumed, or None."""
    begun = [path for path in _folders(home) if not (path / RECORD_NAME).exists() and (path / JOB).exists()]
    return _latest(begun)


def clear_stillborn(home: Path) -> None:
    """Remove folders of a program that died before its first note: they hold no frame."""
    for path in _folders(home):
        if not any((path / name).exists() for name in (RECORD_NAME, JOB, JOURNAL)):
            with contextlib.suppress(OSError):
                shutil.rmtree(path)


def inspected_in(folder: Path) -> Inspected:
    """A finished inspection, from its folder.

    Raises:
        RecordError: its record is damaged.
    """
    return Inspected(read_record(folder), folder, folder / REPORT_NAME)


def _folders(home: Path) -> list[Path]:
    try:
        return [path.resolve() for path in home.iterdir() if path.is_dir()]
    except OSError:
        return []


def _latest(paths: list[Path]) -> Path | None:
    return max(paths, key=lambda path: path.stat().st_mtime_ns, default=None)


def clear_copies(home: Path) -> None:
    """Remove the remains of an unfinished inspection; the original frames are elsewhere."""
    for folder in home.iterdir() if home.is_dir() else ():
        if not (folder / RECORD_NAME).exists() and _is_a_copy(folder):
            with contextlib.suppress(RecordError), working_in(folder):
                shutil.rmtree(folder, ignore_errors=True)


def _is_a_copy(folder: Path) -> bool:
    """Whether an unfinished inspection holds only copies of frames."""
    if not (folder / JOB).exists():
        return False
    try:
        return read_job_file(folder).origin == "frames"
    except RecordError:
        return False
