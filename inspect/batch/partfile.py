"""Whose frames are in a folder: ``part.toml`` says it, or columns of the table, or the folder's name."""

import csv
import io
from pathlib import Path

from anisoscope.batch.scan import Scan, mismatch
from anisoscope.csvtable import read_text
from anisoscope.errors import ConfigError, UsageError
from anisoscope.job import check_serial
from anisoscope.record import Particulars
from anisoscope.rig.framefolder import TABLE
from anisoscope.tomlfile import Part, read_toml_model

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
