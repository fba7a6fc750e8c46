"""Is a folder what it was? Hash everything again, and name what is not."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from anisoscope.base.errors import RecordError
from anisoscope.base.json_fields import in_json
from anisoscope.base.signature import Signed, Trust
from anisoscope.inspection.folder import JOB, files_in
from anisoscope.inspection.kept_measurement import KEPT_NAME
from anisoscope.inspection.manifest import read_job_file
from anisoscope.inspection.report_seal import (
    OWN,
    REPORT_SIGNATURE,
    SEAL_NAME,
    ReportState,
    report_signature,
    report_state,
)
from anisoscope.record.schema import (
    RECORD_NAME,
    REPORT_NAME,
    SIGNATURE_NAME,
    InputFile,
    record_signature,
    recorded_files,
    recorded_origin,
    sha256_of,
)
from anisoscope.rig.acquisition.journal import JOURNAL, read_journal
from anisoscope.rig.acquisition.writer import FRAMES
from anisoscope.rig.frame import header_of


@dataclass(frozen=True)
class Verified:
    """State of the files of an inspection folder; names relative to it.

    Attributes:
        finished: whether there is a record.
        files: how many files were compared.
        changed: those whose content is not what it was.
        missing: those that are gone.
        additional: those that the inspection did not make.
        signed_by: station and key that signed the record; None where it is not signed.
        distrust: why the signature, or a frame, does not belong to this inspection.
        report_signed: whether the key that signed the record also signed the report; None where the record is not
            signed, or there is no report beside it.
        origin: "rig" or "imported", as the record says; "" where it does not.
        judged_anew: earlier record of the same frames; "" where there is none.
        number: of the record among those of its station in one folder, as was signed; None where it is not linked.
        report_written: whether the report is there; a finished inspection without one is intact, unless its record
            lists it, as those of earlier versions do.
    """

    finished: bool
    files: int
    changed: tuple[str, ...]
    missing: tuple[str, ...]
    additional: tuple[str, ...]
    report_written: bool = True
    signed_by: str | None = None
    distrust: tuple[str, ...] = ()
    report_signed: bool | None = None
    origin: str = ""
    judged_anew: str = ""
    number: int | None = None

    @property
    @in_json()
    def intact(self) -> bool:
        """Whether everything is as it was, and signed by whom it should be."""
        return not (self.changed or self.missing or self.additional or self.distrust)


def verify(folder: Path | str, trust: Trust | None = None) -> Verified:
    """Hash every file of an inspection folder again.

    A finished inspection is compared with its record, which carries a seal over itself, and its report with
    ``report.sha256``, which is written after both; an unfinished one with ``job.json`` and the journal of its frames.

    Args:
        folder: the inspection folder.
        trust: keys of which one has to have signed the record; without it, whoever signed is named.

    Raises:
        RecordError: this is no inspection folder.
    """
    folder = Path(folder)
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
    own = (
        {RECORD_NAME, SIGNATURE_NAME}
        if listed is not None
        else {RECORD_NAME, JOB, JOURNAL, KEPT_NAME, REPORT_NAME, SEAL_NAME}
    )
    report = None if listed is None else report_state(folder, listed)
    if report is not None and not report.by_record:
        changed += report.changed
        own |= OWN
    origin, anew = ("", "") if listed is None else recorded_origin(folder)
    return Verified(
        RECORD_NAME in present,
        len(expected) + 1 + _count(report, present),
        tuple(sorted(set(changed))),
        tuple(sorted(expected.keys() - present)),
        tuple(sorted(present - expected.keys() - own)),
        REPORT_NAME in present,
        *_signature(folder, trust, finished=RECORD_NAME in present),
        origin=origin,
        judged_anew=anew,
        number=_number(folder) if RECORD_NAME in present else None,
    )


def _number(folder: Path) -> int | None:
    try:
        found = record_signature(folder)
    except RecordError:
        return None
    number = None if found is None else found.content.get("number")
    return number if isinstance(number, int) else None


def _signature(
    folder: Path, trust: Trust | None, *, finished: bool
) -> tuple[str | None, tuple[str, ...], bool | None]:
    """Signer of the record, reasons why signatures do not count, and whether the report is signed by the same key."""
    if not finished:
        return (
            None,
            () if trust is None else ("the inspection is not finished, so that nothing is signed",),
            None,
        )
    try:
        found = record_signature(folder)
    except RecordError as error:
        return None, (str(error),), None
    if found is None:
        return None, () if trust is None else ("the record is not signed",), None
    wrong = None if trust is None else trust.distrust(found)
    signed, by_other = _report_signed(folder, found)
    problems = (*(one for one in (wrong, by_other) if one is not None), *_strangers(folder, found.content))
    return found.key if trust is None else trust.station(found), problems, signed


def _report_signed(folder: Path, of_record: Signed) -> tuple[bool | None, str | None]:
    """Whether the report is signed as the record is, and the reason why its signature does not count."""
    if not (folder / REPORT_NAME).is_file():
        return None, None
    try:
        found = report_signature(folder)
    except RecordError as error:
        return False, str(error)
    if found is not None and found.public != of_record.public:
        return (
            False,
            f"{folder / REPORT_SIGNATURE}: another key signed the report ({found.key}) than the record",
        )
    return found is not None, None


def _strangers(folder: Path, signed: Mapping[str, object]) -> Iterator[str]:
    """Frames whose metadata name another part than the signature."""
    for path in sorted((folder / FRAMES).glob("*.tif")):
        header = header_of(path)
        if header is not None and header.serial is not None:
            for what, found in (("serial number", header.serial), ("lot", header.lot)):
                wanted = signed.get(what.partition(" ")[0])
                if found != wanted:
                    yield f"{FRAMES}/{path.name}: shows a part of {what} {found}, not {wanted}"


def _count(report: ReportState | None, present: set[str]) -> int:
    """Number of files of the report compared besides the files that the record lists."""
    return (
        0 if report is None or report.by_record else len({REPORT_NAME, SEAL_NAME, REPORT_SIGNATURE} & present)
    )


def _begun(folder: Path) -> tuple[list[InputFile], list[str]]:
    """Listed files of an inspection without a record, and its damaged files."""
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
    names = sorted(files_in(folder) - {RECORD_NAME, SIGNATURE_NAME} - OWN)
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
