"""The station: what is inspected now, and who holds the rig.

Everything that happens is an event with a number. A browser that lost its connection asks for those after the last one
it saw; one that comes anew, or comes back after a restart, gets the state.
"""

import contextlib
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from fastapi import HTTPException
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from anisoscope.base.crash import as_foreseen
from anisoscope.base.errors import UsageError
from anisoscope.base.language import message, translated
from anisoscope.base.language import shown as shown_text
from anisoscope.base.printable import Printable
from anisoscope.console.access import SINGLE_USER, Session
from anisoscope.console.guided import Begin, Guided, Outcome, guides
from anisoscope.console.live import EventLog, Eyes, Live
from anisoscope.console.trail import Trail
from anisoscope.inspection.recipe_store import RecipeEntry, recipe_entry, recipe_path, recipe_paths
from anisoscope.inspection.work import Task, Worker, Workplace
from anisoscope.record.schema import RECORD_NAME, Particulars

if TYPE_CHECKING:
    from anisoscope.history.signs import Doing
    from anisoscope.rig.acquisition.journal import FrameLine

SOON_DAYS = 7.0
MOST_STREAMS = 200


class Start(BaseModel):
    """Request to inspect; x and y of the part are mm right and up of the stage's axis at sample angle 0."""

    model_config = ConfigDict(extra="forbid")

    recipe: str = Field(max_length=200)
    serial: str = Field(min_length=1, max_length=200)
    lot: Printable | None = None
    cavity: Printable | None = None
    x_mm: FiniteFloat | None = None
    y_mm: FiniteFloat | None = None


class Named(BaseModel):
    """A recipe, or the folder of an inspection."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(max_length=300)


@dataclass
class _Present:
    """State for the page."""

    state: Literal["idle", "running", "stopping", "done", "failed"] = "idle"
    task: dict[str, Any] = field(default_factory=dict)
    doing: str = ""
    done: int = 0
    total: int = 0
    frames: int = 0
    folder: str = ""
    verdict: dict[str, Any] | None = None
    checked: dict[str, Any] | None = None
    failure: dict[str, Any] | None = None
    notes: list[str] = field(default_factory=list)


class Station:
    """A rig, and the inspections made at it.

    Args:
        place: rig file, folder of the inspections, history.
        recipes: folder of the recipes.
        worker: does the tasks.
        stop_axes: stops all axes at once; returns by table what went wrong, or "".
        eyes: camera and light for the live picture.
        trail: where starts, stops and other changes are recorded.
        name: of the station, for records.
        report: called with what the station does whenever something happens (`anisoscope.history.signs.Beacon.show`).
        patience_s: after which a rig is free whose holder has closed the page.
    """

    def __init__(
        self,
        place: Workplace,
        recipes: Path,
        worker: Worker,
        stop_axes: Callable[[], dict[str, str]],
        eyes: Eyes | None,
        trail: Trail,
        name: str | None = None,
        report: "Callable[[Doing, str], None]" = lambda *_: None,
        patience_s: float = 10.0,
    ) -> None:
        self._patience_s = patience_s
        self.place, self.recipes_folder, self.name, self._report = place, recipes, name, report
        self.log, self.live = EventLog(), Live(eyes)
        self._worker, self._stop_axes, self._trail = worker, stop_axes, trail
        self._lock = threading.RLock()
        self._now = _Present()
        self._cancel = threading.Event()
        self._holder: tuple[str, str] | None = None
        self._asking: tuple[str, str] | None = None
        self._streams: dict[str, int] = {}
        self._guided = Guided(place.out, recipes)
        self._busy: threading.Thread | None = None

    # Who holds the rig.

    def state(self) -> tuple[int, dict[str, Any]]:
        """Number of the last event, and everything that a page shows, in the language of its reader."""
        number, content = self._snapshot()
        return number, self.in_words(content)

    def _snapshot(self) -> tuple[int, dict[str, Any]]:
        """The state in English, as events have it."""
        with self._lock:
            now = self._now
            return self.log.number, {
                "run": self.log.run,
                "state": now.state,
                "task": now.task,
                "doing": now.doing,
                "done": now.done,
                "total": now.total,
                "frames": now.frames,
                "folder": now.folder,
                "verdict": now.verdict,
                "checked": now.checked,
                "failure": now.failure,
                "notes": [*now.notes],
                "guide": self._guided.state and self._guided.state.model_copy(deep=True),
                "holder": self._holder,
                "asking": self._asking,
            }

    def in_words(self, content: dict[str, Any]) -> dict[str, Any]:
        """The content of an event in the language of its reader."""
        shown = content | {"doing": translated(content["doing"])}
        if "guide" not in content:  # progress
            return shown
        for name in ("holder", "asking"):
            shown[name] = _browser(content[name])
        shown["notes"] = [translated(one) for one in content["notes"]]
        shown["guide"] = self._guided.shown(content["guide"])
        if content["verdict"] is not None:
            verdict = content["verdict"]
            words = {name: shown_text(translated(verdict[name])) for name in ("finding", "action")}
            words["word"] = message(verdict["verdict"])
            shown["verdict"] = (
                verdict | words | {"reasons": [shown_text(translated(one)) for one in verdict["reasons"]]}
            )
        if content["checked"] is not None:
            checks = [
                one | {"words": translated(one["words"]), "remark": translated(one["remark"])}
                for one in content["checked"]["checks"]
            ]
            shown["checked"] = content["checked"] | {"checks": checks}
        if content["failure"] is not None:
            shown["failure"] = content["failure"] | {"text": translated(content["failure"]["text"])}
        return shown

    def _publish(self) -> None:
        self.log.add("state", self._snapshot()[1])
        self._report(*_in_short(self._now))

    @contextlib.contextmanager
    def watched_by(self, session: Session) -> Iterator[None]:
        """While a browser of this session follows the events."""
        with self._lock:
            self._streams[session.short] = self._streams.get(session.short, 0) + 1
        try:
            yield
        finally:
            with self._lock:
                self._streams[session.short] -= 1
                if not self._streams[session.short]:
                    del self._streams[session.short]
                self._look_for_holder()

    def _look_for_holder(self) -> None:
        if self._is_gone() and self._asking is not None:
            self._let_go()
        elif self._is_gone():  # unless the page is only loaded again
            later = threading.Timer(self._patience_s, self._let_go)
            later.daemon = True
            later.start()

    def _is_gone(self) -> bool:
        """Whether no page of the rig's holder is open, and nothing runs that was started there."""
        return self._holder is not None and self._holder[0] not in self._streams and not self._runs

    def _let_go(self) -> None:
        """A holder whose pages are closed hands the rig to who asks for it, or leaves it free."""
        with self._lock:
            if not self._is_gone():
                return
            before, self._holder, self._asking = self._holder, self._asking, None
            if self._holder is not None and before is not None:
                self._trail.add(self._holder[1], "holds the rig", before=before[1])
            self._publish()

    def check_room(self) -> None:
        """Refuse a further page that follows the events where there are too many.

        Raises:
            HTTPException: 503.
        """
        with self._lock:
            if sum(self._streams.values()) >= MOST_STREAMS:
                raise HTTPException(503, "too many pages are open: close some")

    def take(self, session: Session) -> None:
        """Hold the rig: at once if it is free, or its holder has closed the page; else request it from its holder."""
        with self._lock:
            holder = self._holder
            if (
                holder is None
                or holder[0] == session.short
                or (holder[0] not in self._streams and not self._runs)
            ):
                self._holder, self._asking = (session.short, session.name), None
                if holder != self._holder:
                    self._trail.add(session.name, "holds the rig", before="" if holder is None else holder[1])
            else:
                self._asking = (session.short, session.name)
            self._publish()

    def release(self, session: Session) -> None:
        """Hand the rig over to who asks for it, or leave it free.

        Raises:
            HTTPException: 409, another one holds it.
        """
        with self._lock:
            self._check_holder(session)
            self._holder, self._asking = self._asking, None
            self._trail.add(
                session.name, "hands the rig over", to="" if self._holder is None else self._holder[1]
            )
            self._publish()

    def _check_holder(self, session: Session) -> None:
        if self._holder is None:
            self.take(session)
        if self._holder is None or self._holder[0] != session.short:
            name = "" if self._holder is None else self._holder[1]
            raise HTTPException(
                409, message("{name} holds the rig in another browser: ask for it first", name=name)
            )

    # What it does.

    @property
    def _runs(self) -> bool:
        return self._now.state in {"running", "stopping"}

    def start(self, session: Session, asked: Start) -> None:
        """Inspect a part.

        Raises:
            HTTPException: 409 if the rig is at work or held by another one, 404 without such a recipe.
            UsageError: a serial number that cannot be used, or a place that the rig has no axes for.
        """
        from anisoscope.inspection.job import check_serial

        path = self.recipe_path(asked.recipe)
        serial, place = check_serial(asked.serial.strip()), self._place(asked)
        who = Particulars(
            operator=session.name,
            lot=asked.lot or None,
            cavity=asked.cavity or None,
            station=self.name,
            place_mm=place,
        )
        words = {"recipe": asked.recipe, "serial": serial, "lot": asked.lot or ""}
        words |= {} if place is None else {"place_mm": f"{place[0]:g}, {place[1]:g}"}
        self._begin(session, Task("inspect", path, serial, who), words)

    def _place(self, asked: Start) -> tuple[float, float] | None:
        if asked.x_mm is None and asked.y_mm is None:
            return None
        if asked.x_mm is None or asked.y_mm is None:
            raise UsageError(message("The place of a part takes both x and y."))
        if not self.has_places():
            raise UsageError(message("This rig has no axes x and y: leave the place out."))
        return asked.x_mm, asked.y_mm

    def resume(self, session: Session, folder: str) -> None:
        """Go on with an interrupted inspection; errors as for `start`."""
        if folder not in self.resumable():
            raise HTTPException(404, "there is no such interrupted inspection")
        self._begin(session, Task("resume", folder=self.place.out / folder), {"folder": folder})

    def check(self, session: Session, recipe: str) -> None:
        """Test the rig with the exposure and the light channel of a recipe; errors as for `start`."""
        entry = self.recipe(recipe)
        task = Task("check", exposure_s=entry.exposure_s, gain=entry.gain, channel=entry.channel)
        self._begin(session, task, {"recipe": recipe})

    def begin_guide(self, session: Session, given: Begin) -> None:
        """Begin guided work; its first step waits for `do_step`.

        Raises:
            HTTPException: 403 without the permission, 409 as for `start`, and where other guided work has not ended.
            UsageError: what was entered cannot be used.
        """
        if not session.may(guides()[given.key].needs):
            raise HTTPException(
                403, f"this needs the permission '{guides()[given.key].needs}', which your role has not"
            )
        with self._lock:
            if self._runs:
                raise HTTPException(409, message("the rig is at work"))
            if self._guided.state is not None:
                raise HTTPException(409, message("end the guided work at hand first"))
            self._check_holder(session)
            self._guided.begin(given, session.name)
            self._trail.add(
                session.name, "guided work", given.why, key=given.key, recipe=given.recipe, **given.values
            )
            self._publish()

    def do_step(self, session: Session) -> None:
        """Do the next step of the guided work; errors as for `begin_guide`."""
        with self._lock:
            step, state, guide = self._guided.step(), self._guided.state, self._guided.guide
            assert state is not None
            assert guide is not None
            if not session.may(guide.needs):
                raise HTTPException(
                    403, f"this needs the permission '{guide.needs}', which your role has not"
                )
            words = {"guide": state.key, "step": str(state.at + 1)}
            if step.work is not None:
                self._begin(session, Task("step", do=step.work), words)
                return
            lot = f"{state.key}-{state.seed:08x}"  # by which `msa gauge --lot` finds them
            who = Particulars(operator=step.operator or session.name, lot=lot, station=self.name)
            self._begin(session, Task("inspect", self._guided.recipe(), step.serial, who), words)

    def end_guide(self, session: Session) -> None:
        """End the guided work, finished or not; errors as for `start`."""
        with self._lock:
            if self._runs:
                raise HTTPException(409, message("the rig is at work"))
            self._check_holder(session)
            if self._guided.state is not None:
                self._trail.add(session.name, "guided work ended", key=self._guided.state.key)
            self._guided.end()
            self._publish()

    def _take_step(self, mine: _Present, kind: str, content: dict[str, Any]) -> None:
        """Take in what a step of guided work found."""
        guide = self._guided.guide
        if guide is None:
            return
        if kind == "stepped":
            self._guided.has_done(Outcome(content["good"], content["rows"], content["notes"]))
        else:
            word = message("measured") if guide.blind else content["verdict"]
            rows = ((content["serial"], word),)
            good = content["verdict"] != "INVALID"
            self._guided.has_done(Outcome(good, rows, () if good else content["reasons"]), content["folder"])
            mine.verdict = None
        mine.state = "done"

    def _begin(self, session: Session, task: Task, words: dict[str, str]) -> None:
        with self._lock:
            if self._runs:
                raise HTTPException(409, message("the rig is at work"))
            self._check_holder(session)
            self._trail.add(session.name, task.kind, **words)
            cancel = self._cancel = threading.Event()
            self._now = _Present("running", {"kind": task.kind, **words}, checked=self._now.checked)
            before, self._busy = (
                self._busy,
                threading.Thread(target=self._do, args=(task, cancel), name="task"),
            )
            self._publish()
            self._busy_after(before)

    def _busy_after(self, before: threading.Thread | None) -> None:
        """Start the task once the report of the part before it is written."""
        thread = self._busy
        assert thread is not None
        if before is None or not before.is_alive():
            thread.start()
            return

        def follow() -> None:
            before.join()
            thread.start()

        threading.Thread(target=follow, name="next task").start()

    def _do(self, task: Task, cancel: threading.Event) -> None:
        mine = self._now

        def emit(kind: str, content: dict[str, Any]) -> None:
            if kind != "entered":  # the page has its verdict already
                with self._lock:
                    self._take_in(mine, kind, content)

        try:
            self.live.pause()  # here, not where a page waits: a camera may hang
            self._worker.run(task, emit, cancel)
        except Exception as error:  # noqa: BLE001 - the page says it, and the next task can begin
            emit("failed", {"text": str(as_foreseen(error, f"serve: {task.kind}")), "stopped": False})
        finally:
            with self._lock:
                if mine is self._now and self._runs:  # a check, or what ended without a word
                    mine.state = "done" if mine.checked is not None else "failed"
                    self.live.go_on()
                self._publish()
                self._look_for_holder()

    def _take_progress(self, mine: _Present, content: dict[str, Any]) -> None:
        mine.doing, mine.done, mine.total = content["doing"], content["done"], content["total"]
        self.log.add("progress", content | {"frames": mine.frames})

    def _take_in(self, mine: _Present, kind: str, content: dict[str, Any]) -> None:
        mine.frames = len(self._film(mine.folder))
        if kind == "progress":
            self._take_progress(mine, content)
            return
        if kind == "stepped" or (kind == "verdict" and "guide" in mine.task):
            self._take_step(mine, kind, content)
        elif kind == "folder":
            mine.folder = content["folder"]
        elif kind == "note":
            mine.notes.append(content["text"])
        elif kind == "verdict":
            mine.verdict, mine.state = content, "done"
        elif kind == "checked":
            mine.checked, mine.state = content, "done"
        elif kind == "failed":
            mine.failure, mine.state = content, "failed"
        if mine is self._now and not self._runs:
            self.live.go_on()
        self._publish()

    def stop(self, session: Session) -> dict[str, str]:
        """Stop everything that moves, and the inspection; every role may. It can be resumed with its frames.

        Returns:
            By table of the rig file what was not stopped, and why.
        """
        self._cancel.set()
        found = {table: problem for table, problem in self._stop_axes().items() if problem}
        with self._lock:
            if self._runs:
                self._now.state = "stopping"
            self._publish()
        self._trail.add(session.name, "stop", problems=found)
        return found

    def end(self) -> None:
        """Stop the task at work and wait for its end."""
        self._cancel.set()
        if self._busy is not None and self._busy.ident is not None:
            self._busy.join(15.0)
        self.live.pause()

    # What there is.

    def has_places(self) -> bool:
        """Whether axes x and y bring parts below the camera."""
        from anisoscope.rig.rigfile import read_rig

        return {"x", "y"} <= read_rig(self.place.rig).linear.keys()

    def recipe_path(self, name: str) -> Path:
        """Path of a recipe by its name.

        Raises:
            HTTPException: 404, there is none.
        """
        try:
            return recipe_path(self.recipes_folder, name)
        except UsageError as problem:
            raise HTTPException(404, "there is no such recipe") from problem

    def recipe(self, name: str) -> RecipeEntry:
        """A recipe; errors as for `recipe_path`."""
        return recipe_entry(self.recipe_path(name))

    def all_recipes(self) -> list[RecipeEntry]:
        """All recipes by name; one that cannot be read says why."""
        return [recipe_entry(path) for path in recipe_paths(self.recipes_folder).values()]

    def resumable(self) -> list[str]:
        """Folders of inspections that were interrupted and have frames, the latest first."""
        with self._lock:
            at_work = self._now.folder if self._runs else ""
        out = self.place.out
        folders = [path.parent for path in out.glob("*/job.json")] if out.is_dir() else []
        found = [
            path
            for path in folders
            if path.name != at_work and not (path / RECORD_NAME).exists() and (path / "frames.jsonl").exists()
        ]
        return [path.name for path in sorted(found, key=lambda path: path.stat().st_mtime, reverse=True)]

    def calibrations(self) -> list[dict[str, Any]]:
        """Calibrations of the rig, with the days that each still holds."""
        from datetime import UTC, datetime

        from anisoscope.calibration.corrections import list_calibrations

        now, found = datetime.now(UTC), []
        for one in list_calibrations(self.place.rig, now):
            if one.file is None and not one.needed:
                continue
            until = None if one.valid_until is None else datetime.fromisoformat(one.valid_until)
            days = None if until is None else (until - now).total_seconds() / 86400.0
            light = "red" if one.state not in {"valid", "no record"} else "green"
            if light == "green" and days is not None and days < SOON_DAYS:
                light = "yellow"
            found.append(
                {"kind": one.kind, "state": one.state, "days": days, "light": light, "advice": one.advice}
            )
        return found

    def _film(self, folder: str) -> "list[FrameLine]":
        """The pictures of the part on disk, without dark and flat frames; of calibrations store none."""
        from anisoscope.rig.acquisition.journal import read_journal

        lines = read_journal(self.place.out / folder).frames if folder else ()
        return [line for line in lines if line.kind == "sample"]

    def frame(self, number: int) -> bytes:
        """A picture of the part of the inspection at work or the last one, as JPEG; the first is 1.

        Raises:
            HTTPException: 404, it is not there yet.
        """
        from anisoscope.live_view.picture import as_jpeg, eight_bits
        from anisoscope.rig.camera import CameraInfo
        from anisoscope.rig.frame import read_frame

        folder, lines = self.place.out / self._now.folder, self._film(self._now.folder)
        if not 1 <= number <= len(lines):
            raise HTTPException(404, "this frame is not there yet")
        frame = read_frame(folder / lines[number - 1].name)
        rows, cols = frame.counts.shape
        info = CameraInfo("", "", rows, cols, frame.bit_depth, frame.black_level)
        step = max(1, cols // 320)
        return as_jpeg(eight_bits(frame.counts[::step, ::step], info))

    def report(self, folder: str) -> Path:
        """The report of an inspection in the folder of inspections.

        Raises:
            HTTPException: 404, there is none.
        """
        known = {path.name for path in self.place.out.iterdir()} if self.place.out.is_dir() else set()
        path = self.place.out / folder / "report.html"
        if folder not in known or not path.is_file():
            raise HTTPException(404, "there is no such report here")
        return path


def _browser(one: tuple[str, str] | None) -> dict[str, str] | None:
    """Name of who holds the rig or asks for it; without accounts this computer, in the language of the page."""
    if one is None:
        return None
    return {"id": one[0], "name": message("this computer") if one[1] == SINGLE_USER else one[1]}


def _in_short(now: _Present) -> "tuple[Doing, str]":
    """State of a station for the page of all stations; a fault ended its last task, a stop is none."""
    if now.state in {"running", "stopping"}:
        return "running", now.task.get("serial") or now.task.get("folder", "")
    if now.state == "failed" and now.failure is not None and not now.failure["stopped"]:
        return "fault", now.failure["text"]
    if now.task.get("kind") == "check" and now.checked is not None and not now.checked["fit"]:
        return "fault", message("the self test found the rig unfit")
    return "idle", ""
