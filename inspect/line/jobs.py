"""Jobs at one rig: each is carried out once, whatever is killed meanwhile, and its result is that of the records.

A job is accepted when its line is in the journal ``line/jobs.jsonl`` among the inspections; only then is a controller
answered. The id of a job makes an order idempotent: who lost the answer orders again and gets the same job. The id is
also in the manifest of the inspection and in its record, so that after a kill it is known from the folders what became
of a job (`anisoscope.inspection.work`), and the seal of the record keeps its row in the history single.
"""

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from anisoscope.base.crash import as_foreseen
from anisoscope.base.errors import AnisoscopeError, RecordError, UsageError
from anisoscope.base.json_file import JsonLines
from anisoscope.base.printable import Printable
from anisoscope.base.toml_file import one_line
from anisoscope.history.rows import numbers_of
from anisoscope.history.signs import Beacon, Doing
from anisoscope.inspection.folder import working_in
from anisoscope.inspection.job import check_serial, prepare
from anisoscope.inspection.recipe_store import RecipeEntry, recipe_entry, recipe_path, recipe_paths
from anisoscope.inspection.reports import Wanted, gets_report
from anisoscope.inspection.work import LINE, Task, Worker, WorkerProcess, Workplace, held_rig
from anisoscope.operations.findings import explained
from anisoscope.operations.remembering import (
    history_place,
    judge_lot,
    lot_mates,
    remember,
    unsigned,
    used_before,
)
from anisoscope.record.schema import RECORD_NAME, REPORT_NAME, Particulars, Record, read_record

JOURNAL = "jobs.jsonl"
KNOWN = 20_000
"""Jobs that are known by their ids at least, the latest ones; from twice as many on the others are forgotten."""
MOST_TRIES = 3
"""Inspecting processes that may end by themselves at one job."""

_log = logging.getLogger("anisoscope.line")

State = Literal["running", "done", "failed", "stopped"]
Kind = Literal["accepted", "progress", "done", "failed", "stopped"]


class Refused(UsageError):
    """An order that is not accepted: nothing is written and nothing moves.

    Attributes:
        why: in a word: ``busy``, ``recipe`` (unknown or unusable), ``serial``, ``changed`` (the id is that of another
            order), ``order`` (not one at all), ``closed``.
    """

    def __init__(
        self, why: Literal["busy", "recipe", "serial", "changed", "order", "closed"], text: str
    ) -> None:
        super().__init__(text)
        self.why = why


class Order(BaseModel):
    """Order of a controller: a part, by a recipe. The id is the controller's; printable, 1 to 200 characters."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    job: Printable = Field(min_length=1)
    recipe: str = Field(max_length=200)
    serial: str = Field(max_length=200)
    lot: Printable | None = None
    cavity: Printable | None = None
    operator: Printable | None = None


def order_of(content: object) -> Order:
    """An order from what came over a wire.

    Raises:
        Refused: it is none; names the entry.
    """
    try:
        return Order.model_validate(content, strict=True)
    except ValidationError as error:
        raise Refused("order", one_line(error, Order)) from None


class JobLine(BaseModel):
    """A line of the journal: ``accepted`` job, ``stop`` of the one at work, or ``end`` of a job with its state."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    line: Literal["accepted", "stop", "end"]
    at: str
    job: str
    order: Order | None = None
    state: State | None = None
    folder: str | None = None
    verdict: str | None = None
    problem: str | None = None


@dataclass(frozen=True)
class Job:
    """State of a job.

    Attributes:
        order: what was ordered.
        state: running, done (there is a record), failed (the rig or the process failed) or stopped.
        accepted_at, ended_at: UTC, ISO 8601.
        folder: the inspection folder.
        verdict: PASS, FAIL, INCONCLUSIVE or INVALID, once it is done.
        problem: why it failed or was stopped, in a line.
    """

    order: Order
    state: State
    accepted_at: str
    ended_at: str | None = None
    folder: Path | None = None
    verdict: str | None = None
    problem: str | None = None

    @property
    def id(self) -> str:
        """The id that the controller chose."""
        return self.order.job


Listener = Callable[[Kind, Job, dict[str, Any]], None]
"""Called in a thread of the jobs, in order: what happened, to which job, and more: for ``progress`` how far it is, for
``done`` its ``record``, as it was read from its folder, where that was possible."""


def now_utc() -> datetime:
    """The time."""
    return datetime.now(UTC)


class Jobs:
    """One rig, one folder of recipes, one job at a time.

    Use it as a context: entering locks the folder of inspections and takes up a job that a killed process left; leaving
    stops the job at work, which the next process takes up.

    Args:
        place: rig file, folder of inspections, history.
        recipes: folder of the recipes.
        worker: does the inspections.
        stop_axes: stops all axes at once; returns by table what went wrong, or "".
        station: name of the station, for the records.
        now: the time, UTC.
    """

    def __init__(
        self,
        place: Workplace,
        recipes: Path,
        worker: Worker,
        stop_axes: Callable[[], dict[str, str]],
        station: str | None = None,
        now: Callable[[], datetime] = now_utc,
    ) -> None:
        self.place, self._recipes, self._worker, self._stop_axes = place, recipes, worker, stop_axes
        self._station, self._now = station, now
        self._lock = threading.RLock()
        self._jobs: dict[str, Job] = {}
        self._listeners: list[Listener] = []
        self._cancel = threading.Event()
        self._stopped = False
        self._busy: threading.Thread | None = None
        self._open = False

    # Recipes.

    def recipes(self) -> list[RecipeEntry]:
        """All recipes by name; one that cannot be read says why."""
        return [recipe_entry(path) for path in recipe_paths(self._recipes).values()]

    def recipe(self, name: str) -> RecipeEntry:
        """A recipe that can be used.

        Raises:
            Refused: there is none of this name, or it cannot be read.
        """
        try:
            entry = recipe_entry(recipe_path(self._recipes, name))
        except UsageError as problem:
            raise Refused("recipe", str(problem)) from None
        if entry.problem is not None:
            raise Refused("recipe", f"recipe {name} cannot be used: {entry.problem}")
        return entry

    def check(self, name: str) -> None:
        """Read all that inspections by a recipe need: what it names, the rig file, calibrations; nothing moves.

        Raises:
            Refused: something is missing or wrong.
        """
        self.recipe(name)
        try:
            prepare(recipe_path(self._recipes, name), self.place.rig, "0")
        except AnisoscopeError as problem:
            text = " ".join(str(problem).split())
            raise Refused("recipe", f"recipe {name} cannot be used: {text}") from None

    # Jobs.

    def listen(self, listener: Listener) -> None:
        """Add a function that is called with what happens; it must not wait for the jobs."""
        self._listeners.append(listener)

    @property
    def running(self) -> Job | None:
        """The job at work."""
        with self._lock:
            last = next(reversed(self._jobs.values()), None)  # none is accepted while one is at work
            return last if last is not None and last.state == "running" else None

    def job(self, id_: str) -> Job | None:
        """A job by its id, or None."""
        return self._jobs.get(id_)

    def all(self) -> list[Job]:
        """The jobs that are known, the oldest first."""
        with self._lock:
            return list(self._jobs.values())

    def record(self, id_: str) -> Record | None:
        """The record of a job that is done, else None.

        Raises:
            RecordError: it is gone or damaged.
        """
        job = self._jobs.get(id_)
        return read_record(job.folder) if job is not None and job.state == "done" and job.folder else None

    def submit(self, order: Order) -> Job:
        """Accept a job and begin it; one that was accepted before, whatever became of it, is given back as it is.

        Returns:
            The job; it is in the journal when this returns.

        Raises:
            Refused: busy with another job, unknown recipe, a serial number that cannot be used, or the id is that of
                another order.
            RecordError: the journal cannot be written: nothing was begun.
        """
        with self._lock:
            known = self._jobs.get(order.job)
            if known is not None:
                if known.order != order:
                    raise Refused(
                        "changed", f"job {order.job} was ordered before, for another part or recipe"
                    )
                return known
            running = self.running
            if not self._open:
                raise Refused("closed", "the server is ending: no job is accepted")
            if running is not None:
                raise Refused("busy", f"job {running.id} is at work: one job at a time")
            self.recipe(order.recipe)
            try:
                check_serial(order.serial)
            except UsageError as problem:
                raise Refused("serial", str(problem)) from None
            self._forget()
            line = JobLine(line="accepted", at=self._time(), job=order.job, order=order)
            self._journal.add(line)
            job = self._take(line)
            self._say("accepted", job, {})
            self._begin(job, fresh=True)
            return job

    def stop(self) -> dict[str, str]:
        """Stop all axes at once, and the job at work for good.

        Returns:
            By table of the rig file what was not stopped, and why.
        """
        self._cancel.set()  # before anything that may wait
        found = {table: problem for table, problem in self._stop_axes().items() if problem}
        with self._lock:
            running = self.running
            if running is not None and not self._stopped:
                self._stopped = True
                self._journal.add(JobLine(line="stop", at=self._time(), job=running.id))
        return found

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until nothing is at work, reports included; False where it did not come to rest in time."""
        busy = self._busy
        if busy is not None:
            busy.join(timeout_s)
        return busy is None or not busy.is_alive()

    # How it goes on.

    def __enter__(self) -> Self:
        """Lock the folder of inspections, read the journal, and take up the job that was at work.

        Raises:
            RecordError: the folder cannot be used, another server works there, or the journal is damaged.
        """
        self._cleanup = contextlib.ExitStack()
        folder = self.place.out / LINE
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordError(f"cannot make the folder {folder}: {error.strerror}") from error
        self._cleanup.enter_context(working_in(self.place.out))
        with _closed_on_error(self._cleanup):
            self._journal = JsonLines(folder / JOURNAL, JobLine)
            stopped = False
            for line in self._journal.read():
                stopped = line.line == "stop"
                self._take(line)
            self._open = True
            running = self.running
            if running is not None:
                self._begin(running, fresh=False, stopped=stopped)
        return self

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._open = False
        self._cancel.set()
        self.wait()
        self._cleanup.close()

    def _time(self) -> str:
        return self._now().isoformat(timespec="milliseconds")

    def _take(self, line: JobLine) -> Job:
        """Take over a line of the journal."""
        if line.order is not None:
            job = Job(line.order, "running", line.at)
        elif line.job not in self._jobs:
            raise RecordError(f"{self._journal.path} names job {line.job}, which was never accepted")
        elif line.line == "stop":
            return self._jobs[line.job]
        else:
            assert line.state is not None
            folder = None if line.folder is None else self.place.out / line.folder
            job = replace(
                self._jobs[line.job],
                state=line.state,
                ended_at=line.at,
                folder=folder,
                verdict=line.verdict,
                problem=line.problem,
            )
        self._jobs[line.job] = job
        return job

    def _begin(self, job: Job, *, fresh: bool, stopped: bool = False) -> None:
        self._cancel, self._stopped = threading.Event(), stopped
        before = self._busy
        self._busy = threading.Thread(
            target=self._do, args=(job, self._cancel, before, fresh), name=f"job {job.id}"
        )
        self._busy.start()

    def _do(self, job: Job, cancel: threading.Event, before: threading.Thread | None, fresh: bool) -> None:
        if before is not None:
            before.join()  # the report of the part before
        order = job.order
        who = Particulars(
            operator=order.operator, lot=order.lot, cavity=order.cavity, station=self._station, job=order.job
        )
        at_work = _AtWork(self, job, cancel)
        try:
            for number in range(MOST_TRIES):
                at_work.problem = None
                path = recipe_paths(self._recipes).get(order.recipe)
                task = Task("job", path, order.serial, who, fresh=fresh and not number, stopped=self._stopped)
                if path is None:  # taken away since the job was accepted
                    at_work.problem = {"text": f"recipe {order.recipe} is gone"}
                    break
                self._worker.run(task, at_work.emit, cancel)
                if at_work.ended or not at_work.is_crashed:
                    break
        except Exception as error:  # noqa: BLE001 - the job has an end, whatever ended it
            at_work.problem = {"text": str(as_foreseen(error, f"job {job.id}"))}
        at_work.close()

    def _forget(self) -> None:
        """Leave only the latest jobs in journal and memory, once there are twice as many; nothing is at work."""
        if len(self._jobs) >= 2 * KNOWN:
            latest = list(self._jobs.values())[-KNOWN:]
            self._journal.replace(line for job in latest for line in _lines_of(job))
            self._jobs = {job.id: job for job in latest}

    def _end(self, job: Job, state: State, record: Record | None = None, **more: str | None) -> None:
        line = JobLine(line="end", at=self._time(), job=job.id, state=state, **more)
        with self._lock:
            try:
                self._journal.add(line, is_safe=state != "done")  # the record in the folder says it too
            except (
                RecordError
            ):  # a full disk must not leave the rig busy; the next process looks into the folder
                _log.exception("end of job %s", job.id)
            ended = self._take(line)
        self._say(_END[state], ended, {} if record is None else {"record": record})

    def _say(self, kind: Kind, job: Job, content: dict[str, Any]) -> None:
        for listener in self._listeners:
            try:
                listener(kind, job, content)
            except Exception:  # noqa: BLE001 - a listener that fails must not hold up the jobs
                _log.exception("job %s: %s", job.id, kind)


def _lines_of(job: Job) -> tuple[JobLine, JobLine]:
    """Lines of the journal for a job that has ended."""
    assert job.ended_at is not None
    folder = None if job.folder is None else job.folder.name
    more = {"state": job.state, "folder": folder, "verdict": job.verdict, "problem": job.problem}
    return (
        JobLine(line="accepted", at=job.accepted_at, job=job.id, order=job.order),
        JobLine(line="end", at=job.ended_at, job=job.id, **more),
    )


_END: dict[State, Kind] = {"done": "done", "failed": "failed", "stopped": "stopped"}


class _AtWork:
    """Messages of a job at work."""

    def __init__(self, jobs: Jobs, job: Job, cancel: threading.Event) -> None:
        self._jobs, self._job, self._cancel = jobs, job, cancel
        self.folder: str | None = None
        self.verdict: str | None = None
        self.record: Record | None = None
        self.problem: dict[str, Any] | None = None
        self.ended = False

    def emit(self, kind: str, content: dict[str, Any]) -> None:
        if kind == "progress":
            self._jobs._say("progress", self._job, content)  # noqa: SLF001 - one thing in two classes
        elif kind == "folder":
            self.folder = content["folder"]
        elif kind == "verdict":
            self.verdict, self.folder = content["verdict"], content["folder"]
            with contextlib.suppress(RecordError):  # whoever asks for it hears why
                folder = self._jobs.place.out / content["folder"]
                self.record = read_record(folder)  # while it enters the history
        elif kind == "entered":
            self._close("done", self.record, verdict=self.verdict)
        elif kind == "failed" and not self.ended:
            self.problem = content

    @property
    def is_crashed(self) -> bool:
        """Whether the inspecting process ended by itself, so that another one may take the job up."""
        return self.problem is not None and bool(self.problem.get("ended"))

    def close(self) -> None:
        """The task is over: a job without a result has failed, was stopped, or is left to the next process."""
        if self.ended:
            return
        text = str((self.problem or {}).get("text", "the inspection ended without a word"))
        if not self._cancel.is_set():
            self._close("failed", problem=text)
        elif self._jobs._stopped:  # noqa: SLF001
            self._close("stopped", problem=text)

    def _close(self, state: State, record: Record | None = None, **more: str | None) -> None:
        self.ended = True
        self._jobs._end(self._job, state, record, folder=self.folder, **more)  # noqa: SLF001


@contextlib.contextmanager
def _closed_on_error(stack: contextlib.ExitStack) -> Iterator[None]:
    try:
        yield
    except BaseException:
        stack.close()
        raise


def result_of(job: Job, record: Record | None, reports: Wanted = "all") -> dict[str, Any]:
    """A result as JSON: job and part, verdict and why, every number of the history by its label, causes, and links.

    Numbers are those of `anisoscope.history.rows.numbers_of`: ``ln 0-90`` is a contrast, ``u ln 0-90`` its standard
    uncertainty with that of the prediction, ``deviation …`` and ``tolerance …`` what they were compared by.

    Args:
        job: the job.
        record: its record, or None where it has none.
        reports: which parts get a report by themselves; without one its link is None.
    """
    found: dict[str, Any] = {
        "job": job.id,
        "state": job.state,
        "serial": job.order.serial,
        "recipe": job.order.recipe,
        "lot": job.order.lot,
        "cavity": job.order.cavity,
        "accepted_at": job.accepted_at,
        "ended_at": job.ended_at,
        "problem": job.problem,
        "verdict": job.verdict,
    }
    if record is None or job.folder is None:
        return found
    said, diagnosis = record.conclusion, record.diagnosis
    report = job.folder / REPORT_NAME
    return found | {
        "product": record.product,
        "finding": None if said is None else said.finding,
        "action": None if said is None else said.action,
        "reasons": list(record.reasons),
        "numbers": numbers_of(record),
        "causes": []
        if diagnosis is None
        else [{"cause": one.cause, "weight": one.weight} for one in diagnosis.causes],
        "links": {
            "folder": job.folder.as_uri(),
            "record": (job.folder / RECORD_NAME).as_uri(),
            "report": report.as_uri() if gets_report(reports, record.verdict) or report.exists() else None,
        },
    }


@contextlib.contextmanager
def jobs_at(
    rig: Path, recipes: Path, out: Path, history: str | None, station: str | None, reports: Wanted
) -> Iterator[Jobs]:
    """The jobs of a rig, which this process holds; not entered.

    Raises:
        UsageError: there is no folder of recipes, or the rig is set by hand.
        RigFileError, RigError: the rig cannot be read or opened.
    """
    if not recipes.is_dir():
        raise UsageError(f"--recipes {recipes}: there is no such folder")
    place = history_place(history, out)
    rig, out = rig.resolve(), out.resolve()
    with contextlib.ExitStack() as stack:
        own = stack.enter_context(held_rig(rig))
        workplace = Workplace(
            rig,
            out,
            place,
            remember,
            lot_mates,
            explained,
            reports=reports,
            used_before=used_before,
            judge_lot=judge_lot,
        )
        worker = WorkerProcess(workplace)
        stack.callback(worker.close)
        jobs = Jobs(workplace, recipes.resolve(), worker, own.stop, station)
        beacon = stack.enter_context(Beacon(place, station, unsigned))
        jobs.listen(lambda kind, job, _: beacon.show(*_sign(kind, job)))
        yield jobs


def _sign(kind: Kind, job: Job) -> tuple[Doing, str]:
    """What a station does after something happened to a job."""
    if kind in {"accepted", "progress"}:
        return "running", job.order.serial
    return ("fault", job.problem or "") if kind == "failed" else ("idle", "")
