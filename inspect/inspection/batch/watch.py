"""Watching a folder: every folder of frames that arrives in it is inspected once, across restarts and failures.

A folder is inspected when its table and every file named there have kept size and time for a while. Times are compared
with each other only, never with the clock: the writer may be another machine.
"""

import contextlib
import csv
import hashlib
import io
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

from pydantic import BaseModel, ConfigDict

from anisoscope.base.crash import Steady, crash_line
from anisoscope.base.csv_table import read_text
from anisoscope.base.errors import AnisoscopeError, ConfigError, RecordError, UsageError
from anisoscope.base.json_file import JsonLines
from anisoscope.base.printable import Printable
from anisoscope.base.progress import Advance, silent
from anisoscope.base.toml_file import Part, read_toml_model
from anisoscope.inspection.batch.first_pose import scan_of
from anisoscope.inspection.batch.scan import Scan, mismatch
from anisoscope.inspection.batch.slot_folder import clear_copies, inspected_in
from anisoscope.inspection.folder import working_in
from anisoscope.inspection.frame_table import arrange
from anisoscope.inspection.job import check_serial
from anisoscope.inspection.replay import inspect_frames
from anisoscope.inspection.reports import WAITING, Reports
from anisoscope.inspection.run import (
    Inspected,
    JudgeLot,
    Methods,
    UsedBefore,
    lot_as_it_is,
    missing_report,
    never_used,
)
from anisoscope.kinds.recipes import read_any_recipe
from anisoscope.parameters.inspecting import CodeKind
from anisoscope.recipe.base import RecipeBase
from anisoscope.record.schema import RECORD_NAME, Particulars, sha256_of
from anisoscope.report.peers import LotMates, no_lot_mates
from anisoscope.rig.acquisition.writer import FRAMES
from anisoscope.rig.framefolder import TABLE, FrameFolder, read_frame_folder
from anisoscope.rig.framefolderline import read_lines
from anisoscope.rig.rigfile import read_replay_rig

PART_NAME = "part.toml"
COLUMNS = ("serial", "lot", "cavity", "operator", "station")


class PartFile(Part):
    """``part.toml``: known particulars of the part; every entry is optional."""

    serial: Printable | None = None
    lot: Printable | None = None
    cavity: Printable | None = None
    operator: Printable | None = None
    station: Printable | None = None


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
    part_file = read_toml_model(path, PartFile, error=ConfigError) if path.exists() else PartFile()
    known = _of_table(folder / TABLE) | {
        name: text for name in COLUMNS if (text := getattr(part_file, name)) is not None
    }
    serial = known.pop("serial", None)
    if scan is not None:
        wrong = mismatch(str(folder), serial, known.get("lot"), scan)
        if wrong is not None:
            raise UsageError(wrong)
        serial = scan.serial
        known |= {} if scan.lot is None else {"lot": scan.lot}
    try:
        return check_serial(serial or folder.name), Particulars(**known).checked()
    except UsageError as error:
        where = "" if serial else f"its name stands in for one; write it into {PART_NAME}: "
        raise UsageError(f"{folder}: {where}{error}") from None


def _of_table(table: Path) -> dict[str, str]:
    """Values of our columns, where the table has them; all its lines must agree."""
    reader = csv.DictReader(io.StringIO(read_text(table), newline=""), skipinitialspace=True)
    found: dict[str, str] = {}
    try:
        for line in reader:
            for column, text in line.items():
                name, value = str(column).strip().lower(), (text if isinstance(text, str) else "").strip()
                if name in COLUMNS and value and found.setdefault(name, value) != value:
                    raise UsageError(
                        f"{table}, line {reader.line_num}, column {name}: {value!r}, but {found[name]!r} before: "
                        "a folder holds one part"
                    )
    except csv.Error as error:
        raise UsageError(f"{table}, line {reader.reader.line_num}: {error}") from None
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
            found = sorted((entry.name, entry.path) for entry in entries if _is_folder(entry))
    except OSError as error:
        raise RecordError(f"{root}: cannot be watched: {error.strerror}") from error
    away = str(leave_out)
    for name, folder in found:
        if name.startswith(".") or name.endswith(PASSED_OVER) or folder == away:
            continue
        mark = _mark(f"{folder}{os.sep}{TABLE}")
        if mark is not None:
            yield Arrival(folder, name, mark)


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:  # a link to itself, or one that another program takes away
        return False


def signature_of(folder: Path) -> Signature:
    """Size and time of every relevant file of a folder; None for a listed file that is missing."""
    names = [TABLE, PART_NAME, RIG_NAME]
    with contextlib.suppress(RecordError):  # the table may be half written
        names += dict.fromkeys(line.file for line in read_lines(folder / TABLE)[0])
    return tuple((name, _mark(str(folder / name))) for name in names)


def missing_file(signature: Signature) -> str | None:
    """First file in the table that does not exist."""
    optional = {PART_NAME, RIG_NAME}
    return next((name for name, mark in signature if mark is None and name not in optional), None)


def frames_key(folder: Path, known: Mapping[Path, str] | None = None) -> str:
    """SHA-256 over the table and its pictures: identical frames have the same key in any folder.

    Args:
        folder: with the table.
        known: hashes of pictures that were read already, by their resolved paths.

    Raises:
        RecordError: one of them cannot be read.
    """
    digest = hashlib.sha256()
    names = dict.fromkeys([TABLE, *(line.file for line in read_lines(folder / TABLE)[0])])
    for name in names:
        path = folder / name.replace(chr(92), "/")
        try:
            sha256 = (known or {}).get(path.resolve()) or sha256_of(path)
            digest.update(f"{name}\0{sha256}\n".encode())
        except OSError as error:
            raise RecordError(f"{folder / name}: cannot be read: {error.strerror}") from error
    return digest.hexdigest()


def whole_key(folder: Path, frames: str) -> str:
    """Key of the frames and of the particulars of part and rig that accompany them."""
    digest = hashlib.sha256(frames.encode())
    for name in (PART_NAME, RIG_NAME):
        with contextlib.suppress(OSError):
            digest.update(f"{name}\0{sha256_of(folder / name)}\n".encode())
    return digest.hexdigest()


def _hashes(read: FrameFolder) -> dict[Path, str]:
    """Hashes of held pictures by their paths."""
    return {entry.path: entry.held.sha256 for entry in read.entries if entry.held is not None}


def _copied_key(inspected: Inspected) -> str:
    """Key of the frames that an inspection copied, with the hashes of its record."""
    folder = inspected.folder
    return frames_key(
        folder / FRAMES, {(folder / one.name).resolve(): one.sha256 for one in inspected.record.frames}
    )


def _mark(path: str) -> Mark | None:
    try:
        found = os.stat(path)  # noqa: PTH116 - ten thousand times a poll
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


Remember = Callable[[Inspected], None]


class Listener(Protocol):
    """Receiver of the events of a watched folder."""

    def inspected(self, name: str, inspected: Inspected) -> None:
        """The frames of a folder were inspected."""
        ...

    def same(self, name: str, other: str) -> None:
        """A folder holds frames that were inspected already, in another one."""
        ...

    def bad(self, name: str, reason: str) -> None:
        """A folder cannot be inspected as it is."""
        ...

    def progress(self, name: str) -> contextlib.AbstractContextManager[Advance]:
        """Shows how far the inspection of a folder is."""
        ...


@dataclass(frozen=True, eq=False)
class Watched:
    """Folder to watch, and settings.

    Attributes:
        root: the folder in which folders of frames arrive.
        out: where inspections and the journal go; every folder of frames gets a folder of its name there.
        recipe: recipe file.
        rig: rig file, or None for ``rig.toml`` in every folder.
        reflectance: of the white tile in flat frames.
        settle_s: how long a folder must have kept still.
        poll_s: pause between looks.
        code_kind: kind of code that every part bears, which says who it is; None where codes are not read.
        lot_mates: who was inspected before of a lot, for the reports; must not raise.
        used_before: whose frames were in earlier inspections.
        reuse: reason for judging frames of another part all the same.
        judge_lot: judges parts of a lot anew when more of it are known; must not raise.
    """

    root: Path
    out: Path
    recipe: Path
    rig: Path | None = None
    reflectance: float = 0.99
    settle_s: float = 2.0
    poll_s: float = 1.0
    code_kind: CodeKind | None = None
    lot_mates: LotMates = no_lot_mates
    used_before: UsedBefore = never_used
    reuse: str = ""
    judge_lot: JudgeLot = lot_as_it_is


@dataclass(frozen=True)
class Bad:
    """Folder that cannot be inspected as it is; ``retry_at`` where the reason may be elsewhere."""

    signature: Signature
    reason: str
    retry_at: float | None = None


@contextlib.contextmanager
def silence(name: str) -> Iterator[Advance]:
    """Progress without display."""
    del name
    yield silent


WATCH_NAME = "watch.jsonl"


class Line(BaseModel):
    """A line of the journal.

    Attributes:
        line: "begin" before an inspection; "done" after it; "same" for frames that were inspected already.
        folder: the folder of frames, absolute.
        key: its content; frames: that of its table and pictures alone.
        mark: of its table when it was looked at; None where it changed meanwhile.
        inspection: the inspection folder, relative to the journal.
        verdict: of the inspection.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    line: Literal["begin", "done", "same"]
    folder: str
    key: str
    frames: str | None = None
    mark: Mark | None = None
    inspection: str | None = None
    verdict: str | None = None


class WatchJournal:
    """The journal, read once and then only added to; every line is on disk before anything else happens.

    Raises:
        RecordError: it cannot be read or written, or a line in the middle is damaged.
    """

    def __init__(self, out: Path) -> None:
        self._file = JsonLines(out / WATCH_NAME, Line)
        self.marks: dict[str, Mark | None] = {}
        self.by_key: dict[str, Line] = {}
        self.inspections: dict[str, None] = {}
        self.open: Line | None = None
        for line in self._file.read():
            self._take(line)

    def _take(self, line: Line) -> None:
        if line.line == "begin":
            self.open = line
            return
        self.open = None
        self.marks[line.folder] = line.mark
        self.by_key.setdefault(line.key, line)
        if line.line == "done" and line.inspection is not None:
            self.by_key[line.key] = line
            self.inspections[line.inspection] = None

    def add(self, line: Line) -> None:
        """Add a line; it is safe on disk when this returns.

        Raises:
            RecordError: it cannot be written.
        """
        self._file.add(line)
        self._take(line)

    def knows(self, arrival: Arrival) -> bool:
        """Whether a folder was inspected, and its table has not changed since."""
        return self.marks.get(arrival.folder) == arrival.mark


RETRY_S = 60.0
LEISURE = 4.0
"""Smallest ratio of a pause to the scan before it, however many old folders there are."""


@dataclass(eq=False)
class Watch:
    """State of a watch since its start.

    Attributes:
        verdicts: of the inspections, in their order.
        bad: folders that cannot be inspected as they are, by name.
        arriving: folders that were still changing when they were looked at last, by name.
        methods: what varies in an inspection, for tests.
        reports: where reports are written while the next folder is inspected; without it each is waited for.
    """

    watched: Watched
    listener: Listener
    remember: Remember
    verdicts: list[str] = field(default_factory=list)
    bad: dict[str, Bad] = field(default_factory=dict)
    arriving: dict[str, tuple[Signature, float]] = field(default_factory=dict)
    methods: Methods | None = None
    reports: Reports | None = None
    _reported: dict[str, str] = field(default_factory=dict)
    _recipe: RecipeBase = field(init=False)
    _journal: WatchJournal = field(init=False)

    @contextlib.contextmanager
    def open(self) -> Iterator[None]:
        """Lock the folder of the inspections, and finish the work of a killed program.

        Raises:
            UsageError, RecipeError, RigFileError: something that concerns all folders.
            RecordError: a folder cannot be used, or another process works there.
        """
        watched = self.watched
        if not watched.root.is_dir():
            raise UsageError(f"{watched.root}: there is no such folder to watch")
        self._recipe = read_any_recipe(watched.recipe)
        if watched.rig is not None:
            read_replay_rig(watched.rig)
        try:
            watched.out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordError(f"cannot make the folder {watched.out}: {error.strerror}") from error
        with working_in(watched.out):
            self._journal = WatchJournal(watched.out)
            self._recover()
            self._write_missing_reports()
            yield

    def run(self, stop: threading.Event) -> None:
        """Watch and inspect until stopped; a running inspection is finished first.

        What goes wrong beyond a folder, such as a share that is away for a while, is heard of once, and tried again.
        """
        name = self.watched.root.name
        steady = Steady(
            f"watch, at {name}", lambda text: self.listener.bad(name, f"{text}; it is tried again")
        )
        while not stop.is_set():
            begun = time.monotonic()
            steady(lambda: self.look(stop), None)
            stop.wait(max(self.watched.poll_s, LEISURE * (time.monotonic() - begun)))

    def run_once(self, stop: threading.Event) -> None:
        """Inspect all settled folders, and none that arrives later.

        Raises:
            RecordError: the watched folder or the journal cannot be used.
        """
        self.look(stop)
        if self.arriving and not stop.wait(self.watched.settle_s):
            self.look(stop)

    def look(self, stop: threading.Event) -> None:
        """One scan: inspect settled folders, note the others.

        Raises:
            RecordError: as for `run`.
        """
        listed = set()
        for arrival in arrivals(self.watched.root, self.watched.out):
            listed.add(arrival.name)
            if stop.is_set():
                return
            if self._journal.knows(arrival):
                self.arriving.pop(arrival.name, None)
                self.bad.pop(arrival.name, None)
                continue
            signature = signature_of(arrival.path)
            if not self._is_due(arrival.name, signature):
                continue
            if not self._at_rest(arrival.name, signature):
                continue
            try:
                self._take(arrival, signature)
            except Exception as error:  # noqa: BLE001 - what is wrong with one part must not stop the line
                self._complain(arrival.name, signature, crash_line(error, f"watch, at {arrival.path}"))
        for names in (self.arriving, self.bad):
            for name in names.keys() - listed:
                del names[name]

    def _is_due(self, name: str, signature: Signature) -> bool:
        bad = self.bad.get(name)
        if bad is None or bad.signature != signature:
            self.bad.pop(name, None)
            return True
        return bad.retry_at is not None and time.monotonic() >= bad.retry_at

    def _at_rest(self, name: str, signature: Signature) -> bool:
        before, since = self.arriving.get(name, (None, 0.0))
        if before != signature:
            since = time.monotonic()
            self.arriving[name] = (signature, since)
        return time.monotonic() - since >= self.watched.settle_s

    def _take(self, arrival: Arrival, signature: Signature) -> None:
        """Inspect a settled folder, or note why it cannot be inspected."""
        del self.arriving[arrival.name]
        name = missing_file(signature)
        try:
            if name is not None:
                raise RecordError(f"the table names {name}, which is not there yet")
            who, read = self._whose(arrival.path)
            frames = frames_key(arrival.path, _hashes(read))
        except AnisoscopeError as error:
            self._complain(arrival.name, signature, str(error), incomplete=name is not None)
            return
        key = whole_key(arrival.path, frames)
        known = self._journal.by_key.get(key)
        if known is not None:
            self._journal.add(Line(line="same", folder=arrival.folder, key=key, mark=arrival.mark))
            if known.folder != arrival.folder:
                self.listener.same(arrival.name, Path(known.folder).name)
            return
        try:
            self._inspect(arrival, who, key, frames, read)
        except AnisoscopeError as error:
            retry = time.monotonic() + RETRY_S if isinstance(error, RecordError) else None
            self._complain(arrival.name, signature, str(error), retry_at=retry)

    def _complain(
        self,
        name: str,
        signature: Signature,
        reason: str,
        *,
        incomplete: bool = False,
        retry_at: float | None = None,
    ) -> None:
        """Note and report once why a folder is bad; the missing file may change while it arrives."""
        text = " ".join(reason.split())
        self.bad[name] = Bad(signature, text, retry_at)
        what = "incomplete" if incomplete else text
        if self._reported.get(name) != what:
            self._reported[name] = what
            self.listener.bad(name, text)

    def _whose(self, folder: Path) -> tuple[tuple[str, Particulars], FrameFolder]:
        """Particulars of the frames, by files and, if configured, by the code on the part; and the frames, checked.

        Raises:
            ConfigError, UsageError, RecordError, MeasurementError: the folder cannot be inspected as it is.
        """
        kind = self.watched.code_kind
        if kind is None:
            whose(folder)  # quickly said, before pictures are read
        read = read_frame_folder(folder, hold=True)
        replay = arrange(read, self._recipe)
        return whose(folder, None if kind is None else scan_of(replay, self._recipe, kind)), read

    def _inspect(
        self, arrival: Arrival, part: tuple[str, Particulars], key: str, frames: str, read: FrameFolder
    ) -> None:
        watched, (serial, who) = self.watched, part
        home = watched.out / arrival.name
        clear_copies(home)
        self._journal.add(Line(line="begin", folder=arrival.folder, key=key, frames=frames))
        with self.listener.progress(arrival.name) as advance:
            inspected = inspect_frames(
                read,
                watched.recipe,
                serial,
                home,
                advance,
                rig_path=watched.rig,
                reflectance=watched.reflectance,
                particulars=who,
                lot_mates=watched.lot_mates(who.lot),
                methods=self.methods,
                reports=self.reports,
                used_before=watched.used_before,
                reuse=watched.reuse,
            )
        copied = _copied_key(inspected)
        if copied == frames:
            self._done(arrival.path, key, inspected, arrival)
        else:  # it changed before it was copied, and will be looked at again
            self._done(arrival.path, whole_key(arrival.path, copied), inspected, None)
        self._reported.pop(arrival.name, None)
        self.listener.inspected(arrival.name, inspected)
        for anew in watched.judge_lot(inspected):
            self.verdicts.append(anew.record.verdict)
            self.listener.inspected(f"{anew.folder.parent.name} (judged anew)", anew)

    def _done(self, folder: Path, key: str, inspected: Inspected, arrival: Arrival | None) -> None:
        """Enter into the history first: a crash in between is repaired by :meth:`_recover`."""
        self.remember(inspected)
        self._journal.add(
            Line(
                line="done",
                folder=str(folder),
                key=key,
                mark=None if arrival is None else arrival.mark,
                inspection=self._relative(inspected.folder),
                verdict=inspected.record.verdict,
            )
        )
        self.verdicts.append(inspected.record.verdict)

    def _write_missing_reports(self) -> None:
        """Reports of the last inspections, which a killed program did not come to write."""
        for name in list(self._journal.inspections)[-2 - WAITING :]:
            with contextlib.suppress(RecordError, FileNotFoundError):  # removed or damaged since
                report = missing_report(self.watched.out / name)
                if report is not None and self.reports is not None:
                    self.reports.add(report)
                elif report is not None:
                    report.write()

    def _relative(self, folder: Path) -> str:
        return folder.resolve().relative_to(self.watched.out.resolve()).as_posix()

    def _recover(self) -> None:
        """Recover an inspection that was running when the program died: finished ones count, others begin again."""
        begun = self._journal.open
        if begun is None:
            return
        source = Path(begun.folder)
        home = self.watched.out / source.name
        for folder in sorted(home.iterdir()) if home.is_dir() else ():
            finished = (folder / RECORD_NAME).exists() and self._relative(
                folder
            ) not in self._journal.inspections
            if finished and frames_key(folder / FRAMES) == begun.frames:
                self._done(source, begun.key, inspected_in(folder.resolve()), None)
        clear_copies(home)
