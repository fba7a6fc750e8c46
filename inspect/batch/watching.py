"""Watch a folder: inspect every folder of frames that arrives in it, once, whatever happens in between."""

import contextlib
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from anisoscope.batch.arrivals import (
    Arrival,
    Signature,
    arrivals,
    frames_key,
    missing_file,
    signature_of,
    whole_key,
)
from anisoscope.batch.firstpose import scan_of
from anisoscope.batch.partfile import whose
from anisoscope.batch.slotfolder import clear_copies, inspected_in
from anisoscope.batch.watched import Bad, Listener, Remember, Watched
from anisoscope.batch.watchjournal import Line, WatchJournal
from anisoscope.errors import AnisoscopeError, RecordError, UsageError
from anisoscope.folder import working_in
from anisoscope.inspection import Inspected
from anisoscope.prints.recipe import AnyRecipe, read_any_recipe
from anisoscope.record import RECORD_NAME, Particulars
from anisoscope.replay import inspect_frames
from anisoscope.replayframes import arrange
from anisoscope.rig.acquisition.writer import FRAMES
from anisoscope.rig.framefolder import read_frame_folder
from anisoscope.rig.rigfile import read_replay_rig

RETRY_S = 60.0
LEISURE = 4.0
"""A pause is at least so many times as long as the look before, however many old folders there are."""


@dataclass(eq=False)
class Watch:
    """What was seen since the watch began.

    Attributes:
        verdicts: of the inspections, in their order.
        bad: folders that cannot be inspected as they are, by name.
        arriving: folders that were still changing when they were looked at last, by name.
    """

    watched: Watched
    listener: Listener
    remember: Remember
    verdicts: list[str] = field(default_factory=list)
    bad: dict[str, Bad] = field(default_factory=dict)
    arriving: dict[str, tuple[Signature, float]] = field(default_factory=dict)
    _told: dict[str, str] = field(default_factory=dict)
    _recipe: AnyRecipe = field(init=False)
    _journal: WatchJournal = field(init=False)

    @contextlib.contextmanager
    def open(self) -> Iterator[None]:
        """Take the folder of the inspections, and finish what a killed program began.

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
            yield

    def run(self, stop: threading.Event) -> None:
        """Look and inspect until somebody says stop; the inspection at work then is finished first.

        Raises:
            RecordError: the watched folder or the journal cannot be used any more.
        """
        while not stop.is_set():
            begun = time.monotonic()
            self.look(stop)
            stop.wait(max(self.watched.poll_s, LEISURE * (time.monotonic() - begun)))

    def run_once(self, stop: threading.Event) -> None:
        """Inspect what is there and at rest, and nothing that arrives later.

        Raises:
            RecordError: the watched folder or the journal cannot be used.
        """
        self.look(stop)
        if self.arriving and not stop.wait(self.watched.settle_s):
            self.look(stop)

    def look(self, stop: threading.Event) -> None:
        """Look once: inspect what has come to rest, note what has not.

        Raises:
            RecordError: as for `run`.
        """
        seen = set()
        for arrival in arrivals(self.watched.root, self.watched.out):
            seen.add(arrival.name)
            if stop.is_set():
                return
            if self._journal.knows(arrival):
                self.arriving.pop(arrival.name, None)
                self.bad.pop(arrival.name, None)
                continue
            signature = signature_of(arrival.path)
            if not self._is_due(arrival.name, signature):
                continue
            if self._at_rest(arrival.name, signature):
                self._take(arrival, signature)
        for names in (self.arriving, self.bad):
            for name in names.keys() - seen:
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
        """Inspect a folder that is at rest, or say why it cannot be."""
        del self.arriving[arrival.name]
        name = missing_file(signature)
        try:
            if name is not None:
                raise RecordError(f"the table names {name}, which is not there yet")
            who = self._whose(arrival.path)
            frames = frames_key(arrival.path)
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
            self._inspect(arrival, who, key, frames)
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
        """Note why a folder is bad, and say so once; which file is missing may change while it arrives."""
        said = " ".join(reason.split())
        self.bad[name] = Bad(signature, said, retry_at)
        what = "incomplete" if incomplete else said
        if self._told.get(name) != what:
            self._told[name] = what
            self.listener.bad(name, said)

    def _whose(self, folder: Path) -> tuple[str, Particulars]:
        """Whose frames these are, by files and, if wanted, by the code on the part; the frames are checked as well.

        Raises:
            ConfigError, UsageError, RecordError, MeasurementError: the folder cannot be inspected as it is.
        """
        kind = self.watched.code_kind
        if kind is None:
            whose(folder)  # quickly said, before pictures are read
        replay = arrange(read_frame_folder(folder), self._recipe)
        return whose(folder, None if kind is None else scan_of(replay, self._recipe, kind))

    def _inspect(self, arrival: Arrival, part: tuple[str, Particulars], key: str, frames: str) -> None:
        watched, (serial, who) = self.watched, part
        home = watched.out / arrival.name
        clear_copies(home)
        self._journal.add(Line(line="begin", folder=arrival.folder, key=key, frames=frames))
        with self.listener.progress(arrival.name) as advance:
            inspected = inspect_frames(
                arrival.path,
                watched.recipe,
                serial,
                home,
                advance,
                rig_path=watched.rig,
                reflectance=watched.reflectance,
                particulars=who,
                lot_mates=watched.lot_mates(who.lot),
            )
        copied = frames_key(inspected.folder / FRAMES)
        if copied == frames:
            self._done(arrival.path, key, inspected, arrival)
        else:  # it changed before it was copied, and will be looked at again
            self._done(arrival.path, whole_key(arrival.path, copied), inspected, None)
        self._told.pop(arrival.name, None)
        self.listener.inspected(arrival.name, inspected)

    def _done(self, folder: Path, key: str, inspected: Inspected, arrival: Arrival | None) -> None:
        """Into the history first: of what is only there, the journal learns by :meth:`_recover`."""
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

    def _relative(self, folder: Path) -> str:
        return folder.resolve().relative_to(self.watched.out.resolve()).as_posix()

    def _recover(self) -> None:
        """An inspection that had begun when the program died: finished ones count, others begin anew."""
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
