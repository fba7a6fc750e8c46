"""The station: what is inspected now, who holds the rig, and the routes by which pages and programs steer it.

Everything that happens is an event with a number. A browser that lost its connection asks for those after the last one
it saw; one that comes anew, or comes back after a restart, gets the state.
"""

import asyncio
import contextlib
import json
import math
import secrets
import threading
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, FastAPI, HTTPException, Request, Response
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse, StreamingResponse
from pydantic import BaseModel, ConfigDict, Field

from anisoscope.base.clock import SYSTEM, Clock
from anisoscope.base.errors import RigError, UsageError
from anisoscope.base.json_fields import as_json
from anisoscope.base.language import message, translated
from anisoscope.console.access import Needs, Session, Trail
from anisoscope.console.pages import render
from anisoscope.inspection.recipe_store import RecipeEntry, recipe_entry, recipe_path, recipe_paths
from anisoscope.inspection.work import Task, Worker, Workplace
from anisoscope.live_view.page import or_none
from anisoscope.record.schema import RECORD_NAME, Particulars
from anisoscope.rig.hold import SharedCamera
from anisoscope.rig.light import Light

MOST_EVENTS = 5000
ALIVE_S = 10.0
LAMP_S = 5.0
LEAST_GAP_S = 0.03
SATURATED_SHARE, DARK_MEAN = 0.001, 0.1
BETTER, WORSE = 1.02, 0.98
SOON_DAYS = 7.0
MOST_STREAMS = 200


class EventLog:
    """The latest events, numbered; threads add them, coroutines wait for them.

    Attributes:
        run: a name of this log, which another one after a restart does not have.
    """

    def __init__(self) -> None:
        self.run = secrets.token_hex(4)
        self._lock = threading.Lock()
        self._events: deque[tuple[int, str, dict[str, Any]]] = deque(maxlen=MOST_EVENTS)
        self._waiting: set[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = set()
        self.number = 0

    def add(self, kind: str, content: dict[str, Any]) -> None:
        """Add an event and wake who waits."""
        with self._lock:
            self.number += 1
            self._events.append((self.number, kind, content))
            for loop, event in self._waiting:
                with contextlib.suppress(RuntimeError):  # its loop has ended
                    loop.call_soon_threadsafe(event.set)

    def after(self, number: int) -> list[tuple[int, str, dict[str, Any]]] | None:
        """Events after a number; None where some of them are gone, or the number is not of this log."""
        with self._lock:
            first = self._events[0][0] if self._events else self.number + 1
            if not first - 1 <= number <= self.number:
                return None
            return [event for event in self._events if event[0] > number]

    def last_seen(self, id_: str) -> int | None:
        """Number of an event's id; None for one of another log."""
        run, _, number = id_.partition("-")
        return int(number) if run == self.run and number.isdigit() else None

    async def stream(
        self, last_id: str, state: Callable[[], tuple[int, dict[str, Any]]]
    ) -> AsyncIterator[str]:
        """Server-sent events: those after an id, or the state and what follows it; never ends."""
        woken = asyncio.Event()
        me = (asyncio.get_running_loop(), woken)
        with self._lock:
            self._waiting.add(me)
        number = self.last_seen(last_id)
        try:
            while True:
                woken.clear()
                events = None if number is None else self.after(number)
                if events is None:
                    number, content = state()
                    events = [(number, "state", content)]
                for number, kind, content in events:
                    data = json.dumps(content, allow_nan=False)
                    yield f"id: {self.run}-{number}\nevent: {kind}\ndata: {data}\n\n"
                if not events:
                    try:
                        async with asyncio.timeout(ALIVE_S):
                            await woken.wait()
                    except TimeoutError:
                        yield ": alive\n\n"
        finally:
            with self._lock:
                self._waiting.discard(me)


@dataclass(frozen=True)
class Eyes:
    """What the live picture needs of a rig."""

    camera: SharedCamera
    light: Light | None


class Live:
    """Live picture with numbers and advice; taken on request, once for all who look.

    Args:
        eyes: camera and light; None where the rig has none at hand.
        clock: a monotonic clock in seconds.
    """

    def __init__(self, eyes: Eyes | None, clock: Clock = SYSTEM) -> None:
        from anisoscope.live_view.view import Meter  # noqa: PLC0415 - loads OpenCV

        self._eyes, self._clock = eyes, clock
        self._lock = threading.Lock()
        self._new_meter: Callable[[], Meter] = Meter
        self._meter = Meter()
        self._newest: tuple[float, tuple[float, float], bytes, dict[str, Any]] | None = None
        self._lit = False
        self._paused = False
        self._off: threading.Timer | None = None

    def look(self, exposure_s: float, gain: float) -> tuple[bytes, dict[str, Any]]:
        """The newest picture as JPEG, and its numbers with advice.

        Raises:
            RigError: there is no camera, or the rig is at work.
        """
        from anisoscope.live_view.picture import as_jpeg, draw  # noqa: PLC0415
        from anisoscope.live_view.view import look_at  # noqa: PLC0415

        with self._lock:
            if self._paused:
                raise RigError("the rig is at work: its frames are shown as they come")
            if self._eyes is None:
                raise RigError("the camera of the rig cannot be used here")
            asked = (exposure_s, gain)
            if self._newest is not None and self._newest[1] != asked:
                self._meter, self._newest = self._new_meter(), None
            if self._newest is not None and self._clock() - self._newest[0] < LEAST_GAP_S:
                return self._newest[2:]
            if not self._lit and self._eyes.light is not None:
                self._eyes.light.on()
                self._lit = True
            counts, info = self._eyes.camera.grab(exposure_s, gain), self._eyes.camera.info
            reading = self._meter.read(look_at(counts, info), self._clock())
            view, before = reading.view, None if self._newest is None else self._newest[3]["focus"]
            numbers = {
                "frame": reading.frame,
                "frames_per_s": or_none(reading.frames_per_s),
                "mean": view.mean,
                "saturated_share": view.saturated_share,
                "focus": or_none(view.focus),
                "relative_focus": or_none(reading.relative_focus),
                "ridge_deg": view.ridge_deg,
                "advice": [
                    *exposure_advice(view.mean, view.saturated_share),
                    *focus_advice(view.focus, before, reading.relative_focus),
                ],
            }
            jpeg = as_jpeg(draw(counts, info, view, reading.relative_focus))
            self._newest = (self._clock(), asked, jpeg, numbers)
            self._lamp_off_later()
            return jpeg, numbers

    def _lamp_off_later(self) -> None:
        if self._off is not None:
            self._off.cancel()
        self._off = threading.Timer(LAMP_S, self._rest)
        self._off.daemon = True
        self._off.start()

    def _rest(self) -> None:
        with self._lock:
            self._darken()

    def _darken(self) -> None:
        if self._lit and self._eyes is not None and self._eyes.light is not None:
            self._lit = False
            with contextlib.suppress(RigError):  # who uses the rig next says what is wrong with it
                self._eyes.light.off()

    def pause(self) -> None:
        """Leave camera and light to others."""
        with self._lock:
            if self._off is not None:
                self._off.cancel()
            self._darken()
            self._paused, self._newest = True, None

    def go_on(self) -> None:
        """Take pictures again, on request."""
        with self._lock:
            self._paused, self._meter = False, self._new_meter()


def exposure_advice(mean: float, saturated_share: float) -> list[str]:
    """What to change about the exposure, in English; empty where it is right."""
    if saturated_share > SATURATED_SHARE:
        return ["too bright: shorten the exposure"]
    return ["too dark: lengthen the exposure"] if mean < DARK_MEAN else []


def focus_advice(focus: float, before: float | None, relative: float) -> list[str]:
    """In which direction to go on with the focus, from the last two pictures; empty where neither is sharper."""
    if not math.isfinite(focus) or before is None or before <= 0.0:
        return []
    if focus > BETTER * before:
        return ["sharper: go on in this direction"]
    if focus < WORSE * before or relative < 0.9:
        return ["less sharp than it was: go back"]
    return []


class Start(BaseModel):
    """What to inspect."""

    model_config = ConfigDict(extra="forbid")

    recipe: str = Field(max_length=200)
    serial: str = Field(min_length=1, max_length=200)
    lot: str | None = Field(None, max_length=200)
    cavity: str | None = Field(None, max_length=200)


class Named(BaseModel):
    """A recipe, or the folder of an inspection."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(max_length=300)


@dataclass
class _Present:
    """What the page shows."""

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
    ) -> None:
        self.place, self.recipes_folder, self.name = place, recipes, name
        self.log, self.live = EventLog(), Live(eyes)
        self._worker, self._stop_axes, self._trail = worker, stop_axes, trail
        self._lock = threading.RLock()
        self._now = _Present()
        self._cancel = threading.Event()
        self._holder: tuple[str, str] | None = None
        self._asking: tuple[str, str] | None = None
        self._streams: dict[str, int] = {}
        self._busy: threading.Thread | None = None

    # Who holds the rig.

    def state(self) -> tuple[int, dict[str, Any]]:
        """Number of the last event, and everything that a page shows."""
        with self._lock:
            now = self._now
            return self.log.number, {
                "run": self.log.run,
                "state": now.state,
                "task": now.task,
                "doing": translated(now.doing),
                "done": now.done,
                "total": now.total,
                "frames": now.frames,
                "folder": now.folder,
                "verdict": now.verdict,
                "checked": now.checked,
                "failure": now.failure,
                "notes": now.notes,
                "holder": None if self._holder is None else {"id": self._holder[0], "name": self._holder[1]},
                "asking": None if self._asking is None else {"id": self._asking[0], "name": self._asking[1]},
            }

    def _publish(self) -> None:
        self.log.add("state", self.state()[1])

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
                gone = self._holder is not None and self._holder[0] not in self._streams
                if gone and self._asking is not None and not self._runs:
                    self._holder, self._asking = self._asking, None
                    self._trail.add(self._holder[1], "holds the rig", before=session.name)
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
            UsageError: a serial number that cannot be used.
        """
        from anisoscope.inspection.job import check_serial  # noqa: PLC0415 - loads much

        path = self.recipe_path(asked.recipe)
        operator = session.name
        who = Particulars(
            operator=operator, lot=asked.lot or None, cavity=asked.cavity or None, station=self.name
        )
        task = Task("inspect", path, check_serial(asked.serial.strip()), who)
        self._begin(session, task, {"recipe": asked.recipe, "serial": task.serial, "lot": asked.lot or ""})

    def resume(self, session: Session, folder: str) -> None:
        """Go on with an interrupted inspection; errors as for `start`."""
        if folder not in self.resumable():
            raise HTTPException(404, "there is no such interrupted inspection")
        self._begin(session, Task("resume", folder=self.place.out / folder), {"folder": folder})

    def check(self, session: Session, recipe: str) -> None:
        """Test the rig with the exposure of a recipe; errors as for `start`."""
        entry = self.recipe(recipe)
        self._begin(session, Task("check", exposure_s=entry.exposure_s, gain=entry.gain), {"recipe": recipe})

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
        finally:
            with self._lock:
                if mine is self._now and self._runs:  # a check, or what ended without a word
                    mine.state = "done" if mine.checked is not None else "failed"
                    self.live.go_on()
                self._publish()

    def _take_in(self, mine: _Present, kind: str, content: dict[str, Any]) -> None:
        if kind == "progress":
            mine.doing, mine.done, mine.total = content["doing"], content["done"], content["total"]
            if " frame at " in mine.doing:
                mine.frames += 1
            self.log.add(
                "progress", {**content, "doing": translated(content["doing"]), "frames": mine.frames}
            )
            return
        if kind == "folder":
            mine.folder = content["folder"]
        elif kind == "note":
            mine.notes.append(content["text"])
        elif kind == "verdict":
            words = {name: translated(content[name]) for name in ("finding", "action")}
            words["word"] = message(content["verdict"])
            mine.verdict = content | words | {"reasons": [translated(one) for one in content["reasons"]]}
            mine.state = "done"
        elif kind == "checked":
            mine.checked = content
            for one in content["checks"]:
                one["words"], one["remark"] = translated(one["words"]), translated(one["remark"])
            mine.state = "done"
        elif kind == "failed":
            mine.failure = content | {"text": translated(content["text"])}
            mine.state = "failed"
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
        from datetime import UTC, datetime  # noqa: PLC0415

        from anisoscope.calibration.corrections import list_calibrations  # noqa: PLC0415

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

    def frame(self, number: int) -> bytes:
        """A frame of the inspection at work or the last one, as JPEG; the first is 1.

        Raises:
            HTTPException: 404, it is not there yet.
        """
        from anisoscope.live_view.picture import as_jpeg, eight_bits  # noqa: PLC0415
        from anisoscope.rig.acquisition.journal import read_journal  # noqa: PLC0415
        from anisoscope.rig.camera import CameraInfo  # noqa: PLC0415
        from anisoscope.rig.frame import read_frame  # noqa: PLC0415

        folder = self.place.out / self._now.folder
        lines = read_journal(folder).frames if self._now.folder else ()
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


def _words() -> dict[str, str]:
    """What the script of the page says."""
    return {
        "frame": message("frame"),
        "next": message("What to do next"),
        "stopped": message("stopped"),
        "away": message("The console does not answer. The inspection goes on; Stop at the rig itself."),
        "good": message("exposure and focus are good"),
        "mine": message("You hold the rig."),
        "free": message("The rig is free."),
        "held": message("{name} holds the rig.", name="{name}"),
        "asks": message("{name} asks for it.", name="{name}"),
        "you": message("you"),
        "PASS": message("good"),
        "WARN": message("look at it"),
        "FAIL": message("not good"),
        "SKIPPED": message("not done"),
    }


Looking = Annotated[Session, Depends(Needs("look"))]
Operating = Annotated[Session, Depends(Needs("operate"))]


def station_router(station: Station) -> APIRouter:
    """Routes of a station: its page, and the interface of programs below ``/api/v1``, which the page uses too."""
    router = APIRouter()
    for add in (_add_pages, _add_readings, _add_pictures, _add_changes):
        add(router, station)
    return router


def _add_pages(router: APIRouter, station: Station) -> None:
    @router.get("/station", include_in_schema=False)
    def page(request: Request, session: Looking) -> HTMLResponse:
        return render(
            request,
            "station.html",
            me=session.short,
            recipes=station.all_recipes(),
            calibrations=station.calibrations(),
            resumable=station.resumable(),
            name=station.name or "",
            words=_words(),
        )

    @router.get("/inspections/{folder}/report.html", include_in_schema=False)
    def report(folder: str, _: Looking) -> FileResponse:
        # its scripts run, in an origin of its own: they reach nothing of the console
        policy = "sandbox allow-scripts allow-popups allow-downloads; frame-ancestors 'none'"
        return FileResponse(station.report(folder), headers={"Content-Security-Policy": policy})

    @router.get("/api/v1/openapi.json", include_in_schema=False)
    def schema(request: Request, _: Looking) -> JSONResponse:
        app: FastAPI = request.app
        return JSONResponse(app.openapi())


def _add_readings(router: APIRouter, station: Station) -> None:
    @router.get("/api/v1/session", summary="Who asks, and the token that every change takes in X-CSRF-Token")
    def session_(session: Looking) -> dict[str, Any]:
        return {
            "name": session.name,
            "roles": sorted(session.roles),
            "token": session.token,
            "id": session.short,
        }

    @router.get("/api/v1/recipes", summary="Recipes that may be inspected here")
    def recipes(_: Looking) -> list[RecipeEntry]:
        return station.all_recipes()

    @router.get("/api/v1/status", summary="What the station does now")
    def status(_: Looking) -> dict[str, Any]:
        return station.state()[1]

    @router.get("/api/v1/calibrations", summary="Calibrations of the rig and how long they hold")
    def calibrations(_: Looking) -> list[dict[str, Any]]:
        return station.calibrations()

    @router.get("/api/v1/resumable", summary="Interrupted inspections")
    def resumable(_: Looking) -> list[str]:
        return station.resumable()

    @router.get(
        "/api/v1/events", summary="Server-sent events: state, progress; Last-Event-ID goes on from there"
    )
    async def events(request: Request, session: Looking, after: str = "") -> StreamingResponse:
        station.check_room()
        last = request.headers.get("last-event-id", after)

        async def stream() -> AsyncIterator[str]:
            with station.watched_by(session):
                async for text in station.log.stream(last, station.state):
                    yield text

        return StreamingResponse(stream(), media_type="text/event-stream")

    @router.get("/api/v1/results", summary="Past inspections of the history, the latest last")
    def results(
        _: Looking, serial: str | None = None, limit: Annotated[int, Field(ge=1, le=1000)] = 50
    ) -> Any:  # noqa: ANN401
        return past(station.place.history, serial, limit)


def _add_pictures(router: APIRouter, station: Station) -> None:
    @router.get(
        "/api/v1/live.jpg", summary="Live picture with the exposure of a recipe; its numbers in X-Numbers"
    )
    def live(recipe: str, _: Looking) -> Response:
        entry = station.recipe(recipe)
        if entry.problem is not None:
            raise HTTPException(409, entry.problem)
        jpeg, numbers = station.live.look(entry.exposure_s, entry.gain)
        said = numbers | {"advice": [message(one) for one in numbers["advice"]]}
        return Response(jpeg, media_type="image/jpeg", headers={"X-Numbers": json.dumps(said)})

    @router.get("/api/v1/frames/{number}.jpg", summary="A frame of the present inspection, small")
    def frame(number: int, _: Looking) -> Response:
        return Response(station.frame(number), media_type="image/jpeg")


def _add_changes(router: APIRouter, station: Station) -> None:
    @router.post("/api/v1/take", summary="Hold the rig, or ask its holder for it")
    def take(session: Operating) -> dict[str, Any]:
        station.take(session)
        return station.state()[1]

    @router.post("/api/v1/release", summary="Hand the rig over")
    def release(session: Operating) -> dict[str, Any]:
        station.release(session)
        return station.state()[1]

    @router.post("/api/v1/start", summary="Inspect a part")
    def start(asked: Start, session: Operating) -> dict[str, Any]:
        station.start(session, asked)
        return station.state()[1]

    @router.post("/api/v1/resume", summary="Go on with an interrupted inspection")
    def resume(asked: Named, session: Operating) -> dict[str, Any]:
        station.resume(session, asked.name)
        return station.state()[1]

    @router.post("/api/v1/check", summary="Test the rig with the exposure of a recipe")
    def check(asked: Named, session: Operating) -> dict[str, Any]:
        station.check(session, asked.name)
        return station.state()[1]

    @router.post("/api/v1/stop", summary="Stop the rig; everybody may")
    async def stop(session: Annotated[Session, Depends(Needs("stop"))]) -> dict[str, str]:
        # not in the threads of the other routes, all of which may wait for a camera
        return await asyncio.to_thread(station.stop, session)


def past(history: str | Path | None, serial: str | None, limit: int) -> Any:  # noqa: ANN401 - rows as JSON
    """Past inspections with what was decided about them, the oldest first; none without a history."""
    from anisoscope.history.address import parse_address  # noqa: PLC0415 - loads SQLAlchemy
    from anisoscope.history.export import with_dispositions  # noqa: PLC0415
    from anisoscope.history.filters import Filters  # noqa: PLC0415
    from anisoscope.history.store import open_history  # noqa: PLC0415

    if history is None:
        return []
    path = parse_address(history).path
    if path is not None and not path.exists():
        return []
    with open_history(history, create=False) as found:
        rows = found.rows(Filters(serial=serial, limit=limit))
        decided = found.dispositions_of([row.id for row in rows])
        return as_json([with_dispositions(row, decided.get(row.id, [])) for row in rows])
