"""A folder of frames with a table: import of pictures from any program, and export of our own.

``frames.csv`` has a header and one line a frame, in the order of recording::

    file,kind,stage_deg,tilt_deg,exposure_s,gain,bit_depth,black_level

An optional column ``filters`` names the colour filters on the camera's pixels (`anisoscope.rig.bayer`). Without it they
come from the metadata of our own pictures, and are ``mono`` otherwise.

An optional column ``again`` (0 or 1) marks the frames after the return to the first pose. Without it, these are the
sample frames at the end of the table at the pose of the first sample frame, provided that there are sample frames at
another pose in between; angles that differ by full turns are the same pose. The format is described in docs/cameras.md.

From a TIFF or PNG of any program the raw counts are read: the stored numbers, unchanged, or an error. Viewers scale,
invert, rotate and gamma-correct; the reader does none of this. A format that would need it (palettes, inverted grey,
packed bits) is refused.
"""

import contextlib
import csv
import hashlib
import io
import re
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TypeGuard, get_args

import numpy as np
import numpy.typing as npt
import tifffile

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import RecordError, UsageError
from anisoscope.base.parallel import for_each
from anisoscope.rig.frame import (
    Frame,
    FrameKind,
    file_content,
    filters_in_header,
    header_of,
    quiet_tifffile,
    too_high,
    unreadable_tiff,
    write_frame,
)
from anisoscope.rig.framefolderline import COLUMNS, OPTIONAL, Line, find_inside, read_lines

Counts = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_LOSSY = "JPEG is lossy: let the camera's program save raw counts as TIFF or PNG"
_LOSSY_TIFF = {6, 7, 34892}  # compressions of TIFF: JPEG, old and new, and lossy DNG
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_PNG_COLOURS = {2: "colour", 3: "a palette of colours", 4: "grey with transparency", 6: "colour"}
_MIN_IS_WHITE, _MIN_IS_BLACK = 0, 1


def read_counts(path: Path) -> Counts:
    """Read the counts of a grey picture.

    Args:
        path: TIFF or PNG, recognised by its content; 8 or 16 bits per pixel, one picture.

    Returns:
        (rows, cols) counts in the type of the file, uint8 or uint16.

    Raises:
        RecordError: there is no such file, it is damaged, or it is not such a picture.
    """
    return counts_of(file_content(path), path)


def counts_of(data: bytes, path: Path) -> Counts:
    """The counts in the bytes of such a file; ``path`` names it in errors, which are those of `read_counts`."""
    if data.startswith(_PNG):
        counts = _png(path, data)
    elif data.startswith(_TIFF):
        counts = _tiff(path, data)
    elif data.startswith(_JPEG):
        raise RecordError(f"{path}: {_LOSSY}")
    else:
        raise RecordError(f"{path}: neither a TIFF nor a PNG file")
    if counts.ndim != 2 or counts.size == 0:
        raise RecordError(f"{path}: a frame has the shape (rows, cols), not {counts.shape}")
    if not _is_counts(counts):
        raise RecordError(f"{path}: a frame has 8-bit or 16-bit counts without sign, not {counts.dtype}")
    return counts


def as_frame_counts(counts: Counts, bit_depth: int, path: Path) -> npt.NDArray[np.uint16]:
    """(rows, cols) counts as uint16, checked against the bit depth.

    Raises:
        RecordError: counts above 2**bit_depth − 1 (left-justified, mostly), or too few bits in the file.
    """
    if counts.dtype == np.uint8 and bit_depth > 8:
        raise RecordError(
            f"{path}: an 8-bit file cannot hold counts of {bit_depth} bits; "
            "give the 16-bit original, or bit_depth 8 if the camera has no more"
        )
    if problem := too_high(counts, bit_depth):
        raise RecordError(f"{path}: {problem}")
    return counts.astype(np.uint16, copy=False)


def _is_counts(array: npt.NDArray[np.generic]) -> TypeGuard[Counts]:
    return array.dtype in {np.dtype(np.uint8), np.dtype(np.uint16)}


def _png(path: Path, data: bytes) -> npt.NDArray[np.generic]:
    if len(data) < 29 or data[12:16] != b"IHDR":
        raise RecordError(f"{path}: not a readable PNG file: it has no header")
    bits, colour = struct.unpack(">BB", data[24:26])
    if colour in _PNG_COLOURS:
        raise RecordError(f"{path}: a frame is grey; this PNG holds {_PNG_COLOURS[colour]}")
    if bits not in {8, 16}:
        raise RecordError(f"{path}: a frame has 8 or 16 bits per pixel; this PNG has {bits}")
    picture = _decode(data)
    if picture is None:
        raise RecordError(f"{path}: not a readable PNG file: it is damaged or cut short")
    return picture


def _decode(data: bytes) -> npt.NDArray[np.generic] | None:
    import cv2  # noqa: PLC0415 - rig status and stages do without it

    flags = cv2.IMREAD_UNCHANGED
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None


def _tiff(path: Path, data: bytes) -> npt.NDArray[np.generic]:
    try:
        with quiet_tifffile(), tifffile.TiffFile(io.BytesIO(data)) as tiff:
            pages = [page for page in tiff.pages if not getattr(page, "is_reduced", False)]
            _check_page(path, pages)
            try:
                return np.asarray(pages[0].asarray())
            except (ValueError, ImportError):
                # LZW and the like need a package that is not ours to ask for; OpenCV can do them
                picture = _decode(data)
                if picture is None:
                    raise
                return picture
    except RecordError:
        raise
    except Exception as problem:  # a damaged TIFF fails in many ways
        raise RecordError(f"{path}: {unreadable_tiff(problem)}") from problem


def _check_page(path: Path, pages: Sequence[object]) -> None:
    if len(pages) != 1:
        raise RecordError(f"{path}: a frame is one picture; this TIFF holds {len(pages)}")
    page = pages[0]
    samples, kind = getattr(page, "samplesperpixel", 1), getattr(page, "photometric", _MIN_IS_BLACK)
    if samples != 1 or kind not in {_MIN_IS_WHITE, _MIN_IS_BLACK}:
        raise RecordError(f"{path}: a frame is grey; this TIFF holds colour ({samples} values per pixel)")
    if kind == _MIN_IS_WHITE:
        raise RecordError(f"{path}: this TIFF says that 0 is white; write it with 0 as black")
    if int(getattr(page, "compression", 1)) in _LOSSY_TIFF:
        raise RecordError(f"{path}: {_LOSSY}")
    bits = getattr(page, "bitspersample", 16)
    if bits not in {8, 16}:
        raise RecordError(f"{path}: a frame has 8 or 16 bits per pixel; this TIFF has {bits}")


TABLE = "frames.csv"
POSE_TOLERANCE_DEG = 0.5
"""Poses that differ by less are the same: a stage reads back the reached position, not the requested one."""


class HeldFile:
    """A file that is read once: its hash and its bytes, which are held until they are released.

    Args:
        path: the file.

    Raises:
        RecordError: it cannot be read; of `content` as well.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._content: bytes | None = file_content(path)

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the bytes that were read, hexadecimal."""
        return hashlib.sha256(self.content()).hexdigest()

    def content(self) -> bytes:
        """The bytes; once released, they are read from the disk again."""
        return file_content(self.path) if self._content is None else self._content

    def release(self) -> None:
        """Hold the bytes no longer."""
        self._content = None


Linearise = Callable[[npt.NDArray[np.uint16]], npt.NDArray[np.uint16]]


@dataclass(frozen=True)
class FrameEntry:
    """A line of ``frames.csv``.

    Attributes:
        path: the picture.
        kind: what is in it; see `Frame`.
        stage_deg: sample angle in degrees.
        tilt_deg: tilt of the camera arm in degrees.
        exposure_s: exposure in seconds.
        gain: gain as a factor.
        bit_depth: bits per pixel of the camera; counts are right-justified.
        black_level: counts of a pixel without light.
        again: whether it was taken after the return to the first pose.
        filters: the colour filters on the camera's pixels.
        held: the file with its content, where that is held.
        linearise: bits of the counts in the picture, and what makes linear ones of them with `bit_depth` and
            `black_level`; None where they are linear, or nothing is known.
    """

    path: Path
    kind: FrameKind
    stage_deg: float
    tilt_deg: float
    exposure_s: float
    gain: float
    bit_depth: int
    black_level: float
    again: bool = False
    filters: str = "mono"
    held: HeldFile | None = field(default=None, repr=False, compare=False)
    linearise: tuple[int, Linearise] | None = field(default=None, repr=False, compare=False)

    def load(self, content: bytes | None = None) -> Frame:
        """The frame, with the settings of the table; time and camera from the picture if it is one of ours.

        Args:
            content: bytes of the picture; what is held or on disk where they are not given.

        Raises:
            RecordError: the picture is missing, is damaged, is no grey picture, or its counts do not fit.
        """
        if content is None:
            content = file_content(self.path) if self.held is None else self.held.content()
        raw_bits, linear = self.linearise or (self.bit_depth, None)
        counts = as_frame_counts(counts_of(content, self.path), raw_bits, self.path)
        counts = counts if linear is None else linear(counts)
        commanded_deg, captured_at, camera = self.stage_deg, "", "unknown"
        if (ours := header_of(content)) is not None:
            captured_at, camera = ours.captured_at, ours.camera
            commanded_deg = ours.commanded_deg if ours.stage_deg == self.stage_deg else self.stage_deg
        return Frame(
            counts=counts,
            kind=self.kind,
            bit_depth=self.bit_depth,
            black_level=self.black_level,
            exposure_s=self.exposure_s,
            gain=self.gain,
            stage_deg=self.stage_deg,
            commanded_deg=commanded_deg,
            tilt_deg=self.tilt_deg,
            captured_at=captured_at,
            camera=camera,
            filters=self.filters,
        )


@dataclass(frozen=True)
class FrameFolder:
    """A folder of frames.

    Attributes:
        folder: where it is.
        entries: its frames in the order of the table.
        rows, cols: shape of every frame.
        table_sha256: SHA-256 of the table, hexadecimal.
        notes: what was passed over in reading, one line each.
    """

    folder: Path
    entries: tuple[FrameEntry, ...]
    rows: int
    cols: int
    table_sha256: str
    notes: tuple[str, ...] = ()

    @property
    def filters(self) -> str:
        """The colour filters on the camera's pixels, the same in every frame."""
        return self.entries[0].filters

    def of_kind(self, kind: FrameKind, *, again: bool | None = None) -> tuple[FrameEntry, ...]:
        """The frames of a kind; with `again`, only those after (or before) the return to the first pose."""
        return tuple(e for e in self.entries if e.kind == kind and again in {None, e.again})


def read_frame_folder(folder: Path, *, hold: bool = False) -> FrameFolder:
    """Read the table of a folder and check every picture in it.

    Args:
        folder: where it is.
        hold: hold the content of all pictures, so that each is read from the disk and hashed once.

    Raises:
        RecordError: the table or a picture cannot be used; the line of the table and the file are named.
    """
    table = folder / TABLE
    lines, columns = read_lines(table)
    table_sha256 = HeldFile(table).sha256
    notes = []
    known = (*COLUMNS, *OPTIONAL)
    if extra := [name for name in columns if name not in known]:
        notes.append(f"{table}: columns passed over: {', '.join(extra)}")
    entries, shape = _checked_entries(lines, folder, table, hold=hold)
    if "again" not in columns:
        entries = _mark_return(entries)
    else:
        _check_marks(entries, lines, table)
    return FrameFolder(folder, tuple(entries), *shape, table_sha256, notes=tuple(notes))


def write_frame_folder(
    folder: Path, frames: Sequence[Frame], again: Sequence[bool] | None = None
) -> FrameFolder:
    """Write frames and their table into a folder, created if missing.

    The table is written last: a folder without one is incomplete.

    Args:
        folder: where to write; it must not hold a table yet.
        frames: the frames in the order in which they were taken.
        again: for each, whether it was taken after the return to the first pose; without it the rule of
            `read_frame_folder` decides.

    Returns:
        The folder as `read_frame_folder` reads it.

    Raises:
        UsageError: there are no frames, or `again` has another length.
        RecordError: the folder holds a table already, cannot be written, or the frames do not fit together.
    """
    if not frames or (again is not None and len(again) != len(frames)):
        raise UsageError(f"{folder}: {len(frames)} frames and {len(again or ())} marks cannot be written")
    folder = Path(folder)
    table = folder / TABLE
    if table.exists():
        raise RecordError(f"{table}: is there already; write into an empty folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise RecordError(f"{folder}: cannot be made: {problem.strerror}") from problem
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    coloured = any(frame.filters != "mono" for frame in frames)
    more = (*(("again",) if again is not None else ()), *(("filters",) if coloured else ()))
    writer.writerow((*COLUMNS, *more))
    for number, frame in enumerate(frames):
        path = folder / f"{number:03d}_{frame.kind}_{frame.stage_deg:07.2f}.tif"
        as_frame_counts(frame.counts, frame.bit_depth, path)
        write_frame(frame, path)
        mark: tuple[int | str, ...] = () if again is None else (int(again[number]),)
        mark += (frame.filters,) if coloured else ()
        writer.writerow((path.name, *(getattr(frame, name) for name in COLUMNS[1:]), *mark))
    write_text(table, text.getvalue())
    return read_frame_folder(folder)


def same_pose(a: FrameEntry, b: FrameEntry) -> bool:
    """Whether two frames have the same pose, apart from full turns."""
    turned = (a.stage_deg - b.stage_deg + 180.0) % 360.0 - 180.0
    return abs(turned) <= POSE_TOLERANCE_DEG and abs(a.tilt_deg - b.tilt_deg) <= POSE_TOLERANCE_DEG


def frame_entries(folder: Path) -> tuple[FrameEntry, ...]:
    """The frames that the table of a folder lists, in its order; their pictures are not read.

    Raises:
        RecordError: the table cannot be used, or a file is missing; the line is named.
    """
    table = folder / TABLE
    lines, _ = read_lines(table)
    return tuple(entry for _, entry in _entries(lines, folder, table, {}))


def _held(lines: list[Line], folder: Path, table: Path) -> dict[Path, HeldFile]:
    """The pictures of a table with their hashes, read in threads; those that cannot be read are named later."""

    def read(line: Line) -> HeldFile | None:
        with contextlib.suppress(RecordError):
            held = HeldFile(find_inside(folder, line.file, f"{table}, line {line.number}"))
            return held if held.sha256 else None
        return None

    return {held.path: held for held in for_each(read, lines) if held is not None}


def _entries(
    lines: list[Line], folder: Path, table: Path, known: dict[Path, HeldFile]
) -> Iterator[tuple[Line, FrameEntry]]:
    seen: dict[Path, int] = {}
    for line in lines:
        entry = _entry(line, folder, table, known)
        if (first := seen.setdefault(entry.path, line.number)) != line.number:
            place = f"{table}, line {line.number}"
            raise RecordError(f"{place}: {line.file} stands already in line {first}; each frame has one line")
        yield line, entry


def _checked_entries(
    lines: list[Line], folder: Path, table: Path, *, hold: bool
) -> tuple[list[FrameEntry], tuple[int, int]]:
    entries: list[FrameEntry] = []
    shape: tuple[int, int] | None = None
    known = _held(lines, folder, table) if hold else {}
    for line, entry in _entries(lines, folder, table, known):
        place = f"{table}, line {line.number}"
        found = _checked_shape(entry, place)
        if shape is not None and found != shape:
            raise RecordError(
                f"{place}: {line.file} has {found[0]} x {found[1]} pixels (rows x cols), the frames before "
                f"have {shape[0]} x {shape[1]}; all frames of a folder are alike"
            )
        if entries and entry.filters != entries[0].filters:
            raise RecordError(
                f"{place}: {line.file} was taken through filters {entry.filters}, the frames before through "
                f"{entries[0].filters}; all frames of a folder are alike"
            )
        shape = found
        entries.append(entry)
    if shape is None:
        raise RecordError(f"{table}, line 1: no frames follow the header")
    return entries, shape


def _entry(line: Line, folder: Path, table: Path, known: dict[Path, HeldFile]) -> FrameEntry:
    place = f"{table}, line {line.number}"
    path = find_inside(folder, line.file, place)
    kind = next((known for known in get_args(FrameKind) if known == line.kind), None)
    if kind is None:
        raise RecordError(
            f"{place}: unknown kind {line.kind!r}; it is one of {', '.join(get_args(FrameKind))}"
        )
    held = known.get(path)
    filters = line.filters or filters_in_header(path if held is None else held.content()) or "mono"
    settings = {name: getattr(line, name) for name in (*COLUMNS[2:], "again")}
    return FrameEntry(path, kind, **settings, filters=filters, held=held)


def _checked_shape(entry: FrameEntry, place: str) -> tuple[int, int]:
    try:
        content = file_content(entry.path) if entry.held is None else entry.held.content()
        counts = as_frame_counts(counts_of(content, entry.path), entry.bit_depth, entry.path)
    except RecordError as problem:
        raise RecordError(f"{place}: {problem}") from problem
    rows, cols = counts.shape
    return rows, cols


def _mark_return(entries: list[FrameEntry]) -> list[FrameEntry]:
    samples = [number for number, entry in enumerate(entries) if entry.kind == "sample"]
    if not samples:
        return entries
    first = entries[samples[0]]
    back: list[int] = []
    for number in reversed(samples):
        if not same_pose(entries[number], first):
            break
        back.append(number)
    if len(back) == len(samples):  # one pose only: nothing was left, so nothing was returned to
        return entries
    return [replace(e, again=True) if number in back else e for number, e in enumerate(entries)]


def _check_marks(entries: list[FrameEntry], lines: list[Line], table: Path) -> None:
    for entry, line in zip(entries, lines, strict=True):
        if not entry.again:
            continue
        first = next((e for e in entries if e.kind == entry.kind), entry)
        if entry.kind == "dark" or first is entry or first.again or not same_pose(entry, first):
            raise RecordError(
                f"{table}, line {line.number}: again marks a later frame at the first pose, in the light, but "
                f"this {entry.kind} frame stands at {entry.stage_deg:g}° (tilt {entry.tilt_deg:g}°), the first "
                f"{first.kind} frame at {first.stage_deg:g}° (tilt {first.tilt_deg:g}°)"
            )


MOST_NAMED = 4
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


def draft_table(folder: Path | str) -> Draft:
    """Write a first ``frames.csv`` for the pictures in a folder, in the order of their names.

    Cells of which nothing tells the value stay empty; the reader of the table names each of them. Pictures of ours
    state everything; of others the names tell kind, angle, tilt, exposure and gain, the counts the bits, and dark
    frames the black level.

    Raises:
        UsageError: there is a table, or no picture.
        RecordError: a picture cannot be read, or the table not be written.
    """
    folder = Path(folder)
    table = folder / TABLE
    if table.exists():
        raise UsageError(f"{table} exists already: change it with an editor, or move it away")
    paths = _pictures(folder)
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


def _pictures(folder: Path) -> list[Path]:
    found = (path for path in folder.glob("*") if path.suffix.lower() in SUFFIXES)
    return sorted(found, key=lambda path: _natural(path.name))


def frames_to_add(folder: FrameFolder, kind: FrameKind, like: FrameEntry) -> str:
    """Advice which pictures of a folder may be the frames that its table lacks, and which cells list them.

    Args:
        folder: the folder.
        kind: kind of frame that is missing.
        like: a frame whose exposure and gain they need.
    """
    listed = {entry.path.name for entry in folder.entries}
    unlisted = (path for path in _pictures(folder.folder) if path.name not in listed)
    names = [path.name for path in unlisted if told_by_name(path.stem)["kind"] == kind]
    cells = f"with kind {kind}, exposure_s {like.exposure_s:g}, gain {like.gain:g}"
    if names:
        return f"{', '.join(names[:MOST_NAMED])} may be some: list them in {TABLE} {cells}, if they were exposed so"
    what = {"dark": "the light off", "flat": "the white tile in place of the part"}
    what |= {"stray": "a light trap in place of the part", "reference": "the reference patch"}
    return f"photograph some with {what[kind]}, save them as {kind}-1.tif and so on, and list them in {TABLE} {cells}"


def told_by_name(name: str) -> dict[str, str]:
    """Cells of a line by the name of a picture; "" for angle or exposure that it does not tell."""
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
