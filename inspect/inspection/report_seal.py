"""``report.sha256``: the hash of a report, written after the record, which seals everything but the report.

The verdict does not wait for its report: the record is written first, then the report. The line that seals the report
also names the hash of the record that it belongs to. The file has the form of the program ``sha256sum``, which checks
it: ``sha256sum --check report.sha256``. Records of earlier versions list their report themselves.

Whoever rewrites a report can hash it anew. So where a signing key is in use, a second statement binds the report to the
record: ``report.signature.json``.
"""

import hashlib
import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from anisoscope.base.atomic_write import write_bytes, write_text
from anisoscope.base.errors import RecordError
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.base.signature import Signed, read_signed, signed, signer_in_use
from anisoscope.record.schema import RECORD_NAME, REPORT_NAME, InputFile, recorded_files, sha256_of

SEAL_NAME = "report.sha256"
REPORT_SIGNATURE = "report.signature.json"
_FILES = REPORT_NAME, SEAL_NAME, REPORT_SIGNATURE
OWN = frozenset({*_FILES, *(f".{name}.partial" for name in _FILES)})
"""Files that belong to a report, those of a program included that was killed while it wrote them."""
_LINE = re.compile(r"([0-9a-f]{64})  (.+)")
State = Literal["written", "missing", "changed"]


@dataclass(frozen=True)
class ReportState:
    """State of the report of a finished inspection.

    Attributes:
        state: "written" and as it was, "missing" (not written yet, or removed), or "changed".
        changed: names of the files that are not what they were.
        by_record: whether the record itself lists the report, as those of earlier versions do.
    """

    state: State
    changed: tuple[str, ...] = ()
    by_record: bool = False


def write_report_sealed(folder: Path, page: str) -> Path:
    """Write the report of a finished inspection into its folder: first the line with its hash, then the report.

    A program that is killed in between leaves a folder whose report is missing, never one without a seal.

    Args:
        folder: the inspection folder, which has its record.
        page: the report.

    Raises:
        RecordError: a file cannot be read or written.
        ConfigError: the signing key cannot be used.
    """
    content = page.encode()
    lines = {RECORD_NAME: _hash(folder / RECORD_NAME), REPORT_NAME: hashlib.sha256(content).hexdigest()}
    signer = signer_in_use()
    if signer is not None:
        statement = {"record": lines[RECORD_NAME], "report": lines[REPORT_NAME]}
        write_text(folder / REPORT_SIGNATURE, signed("report", statement, signer) + "\n")
    else:
        (folder / REPORT_SIGNATURE).unlink(missing_ok=True)  # of a report that is replaced
    write_text(folder / SEAL_NAME, "".join(f"{sha256}  {name}\n" for name, sha256 in lines.items()))
    write_bytes(folder / REPORT_NAME, content)
    return folder / REPORT_NAME


def report_signature(folder: Path) -> Signed | None:
    """Signature of the report, checked with the key that it names; None where the report is not signed.

    Raises:
        RecordError: it is damaged, or that of another report or record.
    """
    path = folder / REPORT_SIGNATURE
    try:
        if not path.exists():
            return None
        found = read_signed("report", bounded_bytes(path))
    except OSError as error:
        raise RecordError(f"{path} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise RecordError(f"{path}: {error}") from None
    is_of = {"record": _hash(folder / RECORD_NAME), "report": _hash(folder / REPORT_NAME)}
    if any(found.content.get(name) != sha256 for name, sha256 in is_of.items()):
        raise RecordError(f"{path}: it is the signature of another report, or the report was changed")
    return found


def report_state(folder: Path, listed: Collection[InputFile] | None = None) -> ReportState:
    """Compare the report of a finished inspection with its seal.

    Args:
        folder: the inspection folder.
        listed: the files that the record lists; read from it where they are not given.

    Raises:
        RecordError: there is no record, or it is damaged.
    """
    listed = recorded_files(folder) if listed is None else listed
    report = folder / REPORT_NAME
    by_record = next((file.sha256 for file in listed if file.name == REPORT_NAME), None)
    if by_record is not None:
        if not report.is_file():
            return ReportState("missing", by_record=True)
        same = _hash(report) == by_record
        return ReportState("written" if same else "changed", () if same else (REPORT_NAME,), by_record=True)
    sealed = _sealed(folder)
    if sealed is None:  # a report without a seal is none of ours
        return ReportState("changed", (REPORT_NAME,)) if report.is_file() else ReportState("missing")
    if sealed.keys() != {RECORD_NAME, REPORT_NAME} or sealed[RECORD_NAME] != _hash(folder / RECORD_NAME):
        return ReportState("changed", (SEAL_NAME,))
    if not report.is_file():
        return ReportState("missing")
    same = _hash(report) == sealed[REPORT_NAME]
    return ReportState("written" if same else "changed", () if same else (REPORT_NAME,))


def _sealed(folder: Path) -> dict[str, str] | None:
    """Hashes by the names in the seal; None without one, and empty where it is damaged."""
    try:
        text = bounded_bytes(folder / SEAL_NAME).decode()
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        return {}
    lines = [_LINE.fullmatch(line) for line in text.splitlines()]
    return {line[2]: line[1] for line in lines if line is not None} if all(lines) else {}


def _hash(path: Path) -> str:
    try:
        return sha256_of(path)
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror}") from error
