"""A first ``frames.csv`` for pictures of another program: what their names and contents tell, and what is missing."""

import csv
import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import RecordError, UsageError
from anisoscope.rig.frame import file_content, header_of
from anisoscope.rig.framefolder import TABLE, read_counts
from anisoscope.rig.framefolderline import COLUMNS

SUFFIXES = frozenset({".tif", ".tiff", ".png"})
KINDS = {
    "dark": r"dark|black|closed|lightoff",
    "flat": r"flat|white|tile",
    "stray": r"stray|trap",
    "reference": r"reference|patch",
}
_NUMBER = r"([+-]?\d+(?:[.,]\d+)?)"
_TILT = re.compile(rf"tilt[_ =]?{_NUMBER}", re.IGNORECASE)
_EXPOSURE = re.compile(r"(?<![a-z\d.])(\d+(?:[.,]\d+)?)[-_ ]?(us|µs|ms|s)(?![a-z\d])", re.IGNORECASE)
_GAIN = re.compile(r"gain[-_ =]?(\d+(?:[.,]\d+)?)", re.IGNORECASE)
_NAMED = re.compile(rf"(?<![a-z])(?:stage|sample|angle|part|rot|pose|deg|s|a)[-_ =]?{_NUMBER}", re.IGNORECASE)
_MARKED = re.compile(rf"(?<![\d.]){_NUMBER}[-_ ]?(?:deg|°)", re.IGNORECASE)
_SECONDS = {"us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0}
MEANINGS = {
    "kind": "sample (the part), dark (light off), flat (white tile), stray (light trap) or reference (reference patch)",
    "stage_deg": "angle of the sample in degrees, counter-clockwise seen from the camera; of dark frames any",
    "tilt_deg": "tilt of the camera arm in degrees",
    "exposure_s": "exposure in seconds",
    "gain": "a factor, not decibels",
    "bit_depth": "bits of the camera: 12 for counts from 0 to 4095",
    "black_level": "counts of a pixel without light",
}


@dataclass(frozen=True)
class Draft:
    """A table that was written.

    Attributes:
        table: its path.
        frames: number of its lines.
        missing: by column, the files of which nothing tells the value; their cells are empty.
    """

    table: Path
    frames: int
    missing: dict[str, tuple[str, ...]]


def draft_table(folder: Path) -> Draft:
    """Write ``frames.csv`` for the pictures in a folder, in the order of their names; what nothing tells stays empty.

    Pictures of ours state everything; of others the names tell kind, angle, tilt, exposure and gain, the counts the
    bits, and dark frames the black level. The reader of the table names each cell that is still empty.

    Raises:
        UsageError: there is a table, or no picture.
        RecordError: a picture cannot be read, or the table not be written.
    """
    table = folder / TABLE
    if table.exists():
        raise UsageError(f"{table} exists already: change it with an editor, or move it away")
    paths = sorted(
        (path for path in folder.glob("*") if path.suffix.lower() in SUFFIXES),
        key=lambda path: _natural(path.name),
    )
    if not paths:
        raise UsageError(f"{folder}: there is no TIFF or PNG in it")
    rows, peak, darks = [], 0, []
    for path in paths:
        row, counts = told_by_name(path.stem), read_counts(path)
        own = header_of(file_content(path))
        if own is not None:
            row |= {name: f"{getattr(own, name)}" for name in COLUMNS[1:]}
        peak = max(peak, int(counts.max()))
        if row["kind"] == "dark":
            darks.append(float(np.median(counts)))
        rows.append({"file": path.name, **row})
    bits = next(bits for bits in (8, 10, 12, 14, 16) if peak < 1 << bits)
    for row in rows:
        row.setdefault("bit_depth", str(bits))
        row.setdefault("black_level", f"{np.median(darks):g}" if darks else "")
    missing = {name: tuple(row["file"] for row in rows if not row[name]) for name in COLUMNS}
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    try:
        write_text(table, text.getvalue())
    except OSError as problem:
        raise RecordError(f"{table}: cannot be written: {problem.strerror}") from problem
    return Draft(table, len(rows), {name: files for name, files in missing.items() if files})


def told_by_name(name: str) -> dict[str, str]:
    """What the name of a picture tells, as text for the table; "" where it tells nothing of angle or exposure."""
    kind = next((one for one, words in KINDS.items() if re.search(words, name, re.IGNORECASE)), "sample")
    tilt, exposure, gain = (pattern.search(name) for pattern in (_TILT, _EXPOSURE, _GAIN))
    rest = name
    for found in (tilt, exposure, gain):
        rest = rest.replace(found[0], "_") if found else rest
    angle = _MARKED.search(rest) or _NAMED.search(rest)
    return {
        "kind": kind,
        "stage_deg": _dotted(angle[1]) if angle else "0" if kind != "sample" else "",
        "tilt_deg": _dotted(tilt[1]) if tilt else "0",
        "exposure_s": f"{float(_dotted(exposure[1])) * _SECONDS[exposure[2].lower()]:.9g}"
        if exposure
        else "",
        "gain": _dotted(gain[1]) if gain else "1",
    }


def _dotted(number: str) -> str:
    return f"{float(number.replace(',', '.')):g}"


def _natural(name: str) -> list[tuple[int, str]]:
    """A key by which part-9 comes before part-10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name.lower())]
