"""Is a folder what it was? Hash everything again, and name what is not."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from anisoscope.base.errors import RecordError
from anisoscope.inspection.folder import JOB, files_in
from anisoscope.inspection.manifest import read_job_file
from anisoscope.inspection.report_seal import OWN, SEAL_NAME, ReportState, report_state
from anisoscope.record.schema import RECORD_NAME, InputFile, recorded_files, sha256_of
from anisoscope.report.inspection_page import REPORT_NAME
from anisoscope.rig.acquisition.journal import JOURNAL, read_journal


@dataclass(frozen=True)
class Verified:
    """What became of the files of an inspection folder; names relative to it.

    Attributes:
        finished: whether there is a record.
        files: how many files were compared.
        changed: those whose content is not what it was.
        missing: those that are gone.
        additional: those that the inspection did not make.
        report_written: whether the report is there; a finished inspection without one is intact, unless its record
            lists it, as those of earlier versions do.
    """

    finished: bool
    files: int
    changed: tuple[str, ...]
    missing: tuple[str, ...]
    additional: tuple[str, ...]
    report_written: bool = True

    @property
    def intact(self) -> bool:
        """Whether everything is as it was."""
        return not (self.changed or self.missing or self.additional)


def verify(folder: Path) -> Verified:
    """Hash every file of an inspection folder again.

    A finished inspection is compared with its record, which carries a seal over itself, and its report with
    ``report.sha256``, which is written after both; an unfinished one with ``job.json`` and the journal of its frames.

    Raises:
        RecordError: this is no inspection folder.
    """
    present = files_in(folder)
    if not present & {RECORD_NAME, JOB}:
        raise RecordError(f"{folder}: is no inspection folder: it holds neither {RECORD_NAME} nor {JOB}")
    listed, changed = None, []
    if RECORD_NAME in present:
        try:
            listed = recorded_files(folder)
        except RecordError:
            changed.append(RECORD_NAME)
    if listed is not None and not listed:
        raise RecordError(f"{folder}: its record is of an earlier version, which listed no files")
    known, damaged = _begun(folder) if listed is None else (list(listed), [])
    expected = {file.name: file.sha256 for file in known}
    changed += damaged
    changed += [name for name in expected.keys() & present if _hash(folder / name) != expected[name]]
    own = {RECORD_NAME} if listed is not None else {RECORD_NAME, JOB, JOURNAL, REPORT_NAME, SEAL_NAME}
    report = None if listed is None else report_state(folder, listed)
    if report is not None and not report.by_record:
        changed += report.changed
        own |= OWN
    return Verified(
        RECORD_NAME in present,
        len(expected) + 1 + _count(report, present),
        tuple(sorted(set(changed))),
        tuple(sorted(expected.keys() - present)),
        tuple(sorted(present - expected.keys() - own)),
        REPORT_NAME in present,
    )


def _count(report: ReportState | None, present: set[str]) -> int:
    """How many files of the report were compared besides those that the record lists."""
    return 0 if report is None or report.by_record else len({REPORT_NAME, SEAL_NAME} & present)


def _begun(folder: Path) -> tuple[list[InputFile], list[str]]:
    """What an inspection without a record knows of its files, and which of its own files are damaged."""
    found: list[InputFile] = []
    changed = []
    try:
        found += [InputFile(name=copy.name, sha256=copy.sha256) for copy in read_job_file(folder).inputs]
    except RecordError:
        changed.append(JOB)
    try:
        found += [InputFile(name=line.name, sha256=line.sha256) for line in read_journal(folder).frames]
    except RecordError:
        changed.append(JOURNAL)
    return found, changed


def listed_files(folder: Path, known: Mapping[str, str]) -> tuple[InputFile, ...]:
    """All files of a folder with their hashes, without its record and what belongs to its report.

    Args:
        folder: the inspection folder.
        known: hashes by name of files that were hashed when they were written or read.

    Raises:
        RecordError: a file cannot be read.
    """
    names = sorted(files_in(folder) - {RECORD_NAME} - OWN)
    try:
        return tuple(
            InputFile(name=name, sha256=known.get(name) or sha256_of(folder / name)) for name in names
        )
    except OSError as error:
        raise RecordError(f"{folder}: cannot be read: {error.strerror}") from error


def _hash(path: Path) -> str:
    try:
        return sha256_of(path)
    except OSError:
        return ""
