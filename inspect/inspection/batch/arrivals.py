"""Folders of frames as they arrive: which have come to rest, and what is in them.

A folder is taken when its table and every file named there have kept size and time for a while. Times are compared with
each other only, never with the clock: the writer may be another machine.
"""

import contextlib
import csv
import hashlib
import io
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from anisoscope.base.csv_table import read_text
from anisoscope.base.errors import ConfigError, RecordError, UsageError
from anisoscope.base.toml_file import Part, read_toml_model
from anisoscope.inspection.batch.scan import Scan, mismatch
from anisoscope.inspection.job import check_serial
from anisoscope.record.schema import Particulars, sha256_of
from anisoscope.rig.framefolder import TABLE
from anisoscope.rig.framefolderline import read_lines

PART_NAME = "part.toml"
COLUMNS = ("serial", "lot", "cavity", "operator", "station")


class PartFile(Part):
    """``part.toml``: who the part is, as far as it is known; everything may be left out."""

    serial: str | None = None
    lot: str | None = None
    cavity: str | None = None
    operator: str | None = None
    station: str | None = None


def whose(folder: Path, scan: Scan | None = None) -> tuple[str, Particulars]:
    """Serial number and particulars of the part in a folder of frames.

    What ``part.toml`` does not say, columns ``serial``, ``lot``, ``cavity``, ``operator`` and ``station`` of
    ``frames.csv`` may. Then the code on the part says serial number and lot; where codes are not read, the name of
    the folder is the last source of a serial number.

    Args:
        folder: the folder.
        scan: what the code on the part says, or None where codes are not read.

    Raises:
        ConfigError: ``part.toml`` is wrong.
        UsageError: lines of the table disagree, or files and code, or there is no usable serial number.
    """
    path = folder / PART_NAME
    said = read_toml_model(path, PartFile, error=ConfigError) if path.exists() else PartFile()
    known = _of_table(folder / TABLE) | {
        name: text for name in COLUMNS if (text := getattr(said, name)) is not None
    }
    serial = known.pop("serial", None)
    if scan is not None:
        wrong = mismatch(str(folder), serial, known.get("lot"), scan)
        if wrong is not None:
            raise UsageError(wrong)
        serial = scan.serial
        known |= {} if scan.lot is None else {"lot": scan.lot}
    try:
        return check_serial(serial or folder.name), Particulars(**known)
    except UsageError as error:
        where = "" if serial else f"its name stands in for one; write it into {PART_NAME}: "
        raise UsageError(f"{folder}: {where}{error}") from None


def _of_table(table: Path) -> dict[str, str]:
    """Values of our columns, where the table has them; all its lines must agree."""
    reader = csv.DictReader(io.StringIO(read_text(table), newline=""), skipinitialspace=True)
    found: dict[str, str] = {}
    for line in reader:
        for column, text in line.items():
            name, value = str(column).strip().lower(), (text if isinstance(text, str) else "").strip()
            if name in COLUMNS and value and found.setdefault(name, value) != value:
                raise UsageError(
                    f"{table}, line {reader.line_num}, column {name}: {value!r}, but {found[name]!r} before: "
                    "a folder holds one part"
                )
    return found


RIG_NAME = "rig.toml"
PASSED_OVER = (".partial", ".part", ".tmp")

Mark = tuple[int, int]
"""Time of change in ns, and size in bytes."""
Signature = tuple[tuple[str, Mark | None], ...]


class Arrival(NamedTuple):
    """A folder with a table of frames: its path, its name, and the mark of that table."""

    folder: str
    name: str
    mark: Mark

    @property
    def path(self) -> Path:
        """The folder."""
        return Path(self.folder)


def arrivals(root: Path, leave_out: Path) -> Iterator[Arrival]:
    """Folders below ``root`` that hold a table, by name; those that are being written under another name are not.

    Args:
        root: the watched folder.
        leave_out: a folder that is none, though it may lie there: that of the inspections.

    Raises:
        RecordError: the folder cannot be read.
    """
    try:
        with os.scandir(root) as entries:
            found = sorted((entry.name, entry.path) for entry in entries if entry.is_dir())
    except OSError as error:
        raise RecordError(f"{root}: cannot be watched: {error.strerror}") from error
    away = str(leave_out)
    for name, folder in found:
        if name.startswith(".") or name.endswith(PASSED_OVER) or folder == away:
            continue
        mark = _mark(f"{folder}{os.sep}{TABLE}")
        if mark is not None:
            yield Arrival(folder, name, mark)


def signature_of(folder: Path) -> Signature:
    """Size and time of everything that counts in a folder; None for a file that is named and missing."""
    names = [TABLE, PART_NAME, RIG_NAME]
    with contextlib.suppress(RecordError):  # the table may be half written
        names += dict.fromkeys(line.file for line in read_lines(folder / TABLE)[0])
    return tuple((name, _mark(str(folder / name))) for name in names)


def missing_file(signature: Signature) -> str | None:
    """The first file that the table names and that is not there."""
    optional = {PART_NAME, RIG_NAME}
    return next((name for name, mark in signature if mark is None and name not in optional), None)


def frames_key(folder: Path) -> str:
    """SHA-256 over the table and the pictures that it names: the same frames have the same one, wherever they lie.

    Raises:
        RecordError: one of them cannot be read.
    """
    digest = hashlib.sha256()
    names = dict.fromkeys([TABLE, *(line.file for line in read_lines(folder / TABLE)[0])])
    for name in names:
        try:
            digest.update(f"{name}\0{sha256_of(folder / name.replace(chr(92), '/'))}\n".encode())
        except OSError as error:
            raise RecordError(f"{folder / name}: cannot be read: {error.strerror}") from error
    return digest.hexdigest()


def whole_key(folder: Path, frames: str) -> str:
    """The key of the frames, and of what is said beside them of part and rig."""
    digest = hashlib.sha256(frames.encode())
    for name in (PART_NAME, RIG_NAME):
        with contextlib.suppress(OSError):
            digest.update(f"{name}\0{sha256_of(folder / name)}\n".encode())
    return digest.hexdigest()


def _mark(path: str) -> Mark | None:
    try:
        found = os.stat(path)  # noqa: PTH116 - ten thousand times a poll
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size
