"""What console and line have done at a rig: inspections, their resumption and self tests, in a process of their own.

The process that serves pages or a controller keeps the devices open and does nothing else, so that a stop is never
behind a computation. The other one computes; it begins when the server begins, has everything imported when the first
part comes, and ends with the server: what it was at can be resumed from its folder.
"""

import contextlib
import glob
import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

from anisoscope.base.crash import crash_line
from anisoscope.base.errors import AnisoscopeError, RecordError, RigError, UsageError
from anisoscope.base.json_fields import as_json
from anisoscope.base.json_file import parsed_json
from anisoscope.base.language import language, use
from anisoscope.base.progress import Advance
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.inspection.folder import JOB, file_name_of, working_in
from anisoscope.record.schema import RECORD_NAME, REPORT_NAME, Particulars, read_record
from anisoscope.rig.acquisition.opening import hold_devices, open_devices
from anisoscope.rig.hold import ASKING, SharedCamera, is_held
from anisoscope.rig.holdline import stop_held
from anisoscope.rig.light import Light
from anisoscope.rig.rigfile import read_rig

if TYPE_CHECKING:
    from anisoscope.inspection.reports import Reports, Wanted
    from anisoscope.inspection.run import Inspected, UsedBefore

Emit = Callable[[str, dict[str, Any]], None]
POLL_S = 0.02
WAIT_S = 0.05
LINE = "line"
"""Folder of the journal of jobs, among the inspections; who carries one out has it locked."""


def _nothing(*_: object) -> None:
    """Enter nothing."""


def _no_mates(*_: object) -> tuple[Any, ...]:
    return ()


def _none_anew(*_: object, reports: object) -> tuple[Any, ...]:
    del reports
    return ()


def _never(_: object) -> "UsedBefore":
    return lambda *_: None


def _no_lines(_: object) -> list[str]:
    return []


@dataclass(frozen=True)
class Task:
    """One thing to do: ``inspect`` a part, ``resume`` the inspection of a folder, ``check`` the rig; or a ``job``.

    A ``step`` calls ``do`` with the place and progress; what it returns is emitted as ``stepped``.
    A job is an inspection with its id in its particulars. Where it is not ``fresh``, an earlier process may have begun
    or finished it: it is finished from there, and not done twice. One that was ``stopped`` is not begun or continued.
    """

    kind: Literal["inspect", "resume", "check", "job", "step"]
    recipe: Path | None = None
    serial: str = ""
    particulars: Particulars = field(default_factory=Particulars)
    folder: Path | None = None
    exposure_s: float = 0.0
    gain: float = 1.0
    channel: str | None = None
    fresh: bool = True
    stopped: bool = False
    do: "Callable[[Workplace, Advance], Any] | None" = None


@dataclass(frozen=True)
class Workplace:
    """Place of inspections, and functions that take their results; handed to a process.

    Attributes:
        rig: rig file.
        out: folder of the inspection folders.
        history: place of the history, or None.
        remember: called with a finished inspection and the place.
        lot_mates: inspections of a lot, from the place and the lot.
        explain: lines that say what is wrong and where, from a record.
        methods: as for `anisoscope.inspection.run.inspect_part`.
        reports: which parts get a report by themselves.
        used_before: whose pictures were in earlier inspections, from the place.
        judge_lot: judges parts of the lot of an inspection anew, from the inspection, the place and ``reports``.
    """

    rig: Path
    out: Path
    history: str | Path | None = None
    remember: Callable[[Any, str | Path | None], None] = _nothing
    lot_mates: Callable[[str | Path | None, str | None], Sequence[Any]] = _no_mates
    explain: Callable[[Any], list[str]] = _no_lines
    methods: Any = None
    reports: "Wanted" = "all"
    used_before: "Callable[[str | Path | None], UsedBefore]" = _never
    judge_lot: "Callable[..., Sequence[Inspected]]" = _none_anew


class Worker(Protocol):
    """Does one task after the other."""

    def run(self, task: Task, emit: Emit, cancel: threading.Event) -> None:
        """Do a task; return when it has ended, and all that it emitted has arrived.

        Args:
            task: what to do.
            emit: called with ``progress``, ``folder``, ``verdict``, ``entered`` (into the history), ``checked``,
                ``stepped``, ``note``, and at last ``failed``.
            cancel: stops the rig and ends the task.
        """


@dataclass(frozen=True)
class WorkerHere:
    """Does tasks in the thread that asks for them."""

    place: Workplace

    def run(self, task: Task, emit: Emit, cancel: threading.Event) -> None:
        """Do a task; see `Worker`."""
        perform(task, self.place, emit, cancel)


def perform(task: Task, place: Workplace, emit: Emit, cancel: threading.Event) -> None:
    """Do a task in this thread; whatever goes wrong is emitted as ``failed``, in a line, with what to do next."""
    try:
        {"check": _check, "job": _carry_out, "step": _step}.get(task.kind, _inspect)(
            task, place, emit, cancel
        )
    except (AnisoscopeError, KeyboardInterrupt) as error:
        lines = [" ".join(str(error).split()), *getattr(error, "__notes__", ())]
        emit("failed", {"text": "; ".join(filter(None, lines)), "stopped": cancel.is_set()})
    except Exception as error:  # noqa: BLE001 - the console goes on
        emit("failed", {"text": crash_line(error, f"{task.kind} {task.serial}"), "stopped": False})


def _inspect(task: Task, place: Workplace, emit: Emit, cancel: threading.Event) -> None:
    from anisoscope.inspection.reports import Reports  # noqa: PLC0415 - the page is served before all of it is loaded
    from anisoscope.inspection.run import inspect_part, resume_part  # noqa: PLC0415

    def advance(doing: str, done: int, total: int) -> None:
        emit("progress", {"doing": doing, "done": done, "total": total})

    def begun(folder: Path) -> None:
        emit("folder", {"folder": folder.name})

    with Reports(lambda text: emit("note", {"text": text}), place.reports) as reports:
        if task.folder is not None:
            begun(task.folder)
            inspected = resume_part(
                task.folder,
                advance,
                lot_mates=lambda lot: tuple(place.lot_mates(place.history, lot)),
                used_before=place.used_before(place.history),
                cancel=cancel,
                methods=place.methods,
                reports=reports,
            )
        else:
            assert task.recipe is not None
            inspected = inspect_part(
                task.recipe,
                place.rig,
                task.serial,
                place.out,
                advance,
                particulars=task.particulars,
                lot_mates=place.lot_mates(place.history, task.particulars.lot),
                used_before=place.used_before(place.history),
                cancel=cancel,
                methods=place.methods,
                reports=reports,
                on_folder=begun,
            )
        _concluded(inspected, place, emit, reports)


def _concluded(inspected: "Inspected", place: Workplace, emit: Emit, reports: "Reports") -> None:
    """Say the verdict and enter it into the history."""
    record = inspected.record
    said = record.conclusion
    emit(
        "verdict",
        {
            "verdict": record.verdict,
            "serial": record.serial,
            "product": record.product,
            "finding": "" if said is None else said.finding,
            "action": "" if said is None else said.action,
            "reasons": list(record.reasons),
            "lines": place.explain(record),
            "folder": inspected.folder.name,
        },
    )
    place.remember(inspected, place.history)
    emit("entered", {"folder": inspected.folder.name})
    for anew in place.judge_lot(inspected, place.history, reports=reports):
        emit("note", {"text": anew.anew_text})
    for note in inspected.notes:
        emit("note", {"text": note})


def _carry_out(task: Task, place: Workplace, emit: Emit, cancel: threading.Event) -> None:
    """Carry out a job once, whatever an earlier process did of it before it was killed.

    The lock of the journal's folder is that of the process which works: a server that was killed leaves its inspecting
    process for a moment, and the one after it waits for its end before it looks at what there is.
    """
    with _alone(place.out / LINE, cancel):
        found = None if task.fresh else folder_of_job(place.out, task.serial, task.particulars.job)
        if found is not None and (found / RECORD_NAME).exists():
            _finish(found, place, emit)
            return
        if task.stopped or cancel.is_set():
            raise RigError("the job was stopped")
        _inspect(task if found is None else replace(task, folder=found), place, emit, cancel)


def _finish(folder: Path, place: Workplace, emit: Emit) -> None:
    """Complete an inspection that has its record: its row in the history and its report."""
    from anisoscope.inspection.reports import Reports, gets_report  # noqa: PLC0415 - as for `_inspect`
    from anisoscope.inspection.run import Inspected, missing_report  # noqa: PLC0415

    with Reports(lambda text: emit("note", {"text": text}), place.reports) as reports:
        emit("folder", {"folder": folder.name})
        record = read_record(folder)
        _concluded(Inspected(record, folder, folder / REPORT_NAME), place, emit, reports)
        report = missing_report(folder) if gets_report(place.reports, record.verdict) else None
        if report is not None:
            reports.add(report)


def folder_of_job(out: Path, serial: str, job: str | None) -> Path | None:
    """The inspection folder of a job, finished or not; None where none was begun."""
    for path in sorted(out.glob(f"{glob.escape(file_name_of(serial))}-*/{JOB}")):
        try:
            begun = parsed_json(bounded_bytes(path))
        except (OSError, ValueError):
            continue  # torn, so that nothing was photographed
        if job is not None and begun.get("particulars", {}).get("job") == job:
            return path.parent
    return None


@contextlib.contextmanager
def _alone(folder: Path, cancel: threading.Event) -> Iterator[None]:
    """Wait until no other process works for this folder of jobs, and lock it."""
    with contextlib.ExitStack() as stack:
        while True:
            try:
                stack.enter_context(working_in(folder))
                break
            except RecordError:
                if cancel.wait(WAIT_S):
                    raise
        yield


def _check(task: Task, place: Workplace, emit: Emit, cancel: threading.Event) -> None:
    from anisoscope.commissioning.selftest import self_test  # noqa: PLC0415
    from anisoscope.commissioning.selftest_record import Settings, write_self_test  # noqa: PLC0415

    def advance(doing: str, done: int, total: int) -> None:
        if cancel.is_set():
            raise KeyboardInterrupt("the self test was stopped")
        emit("progress", {"doing": doing, "done": done, "total": total})

    result = self_test(
        place.rig,
        Settings(exposure_s=task.exposure_s, gain=task.gain, light_channel=task.channel),
        on_progress=advance,
    )
    write_self_test(result, place.out / "selftests")
    emit("checked", as_json({"fit": result.fit, "checks": [one.model_dump() for one in result.checks]}))


def _step(task: Task, place: Workplace, emit: Emit, cancel: threading.Event) -> None:
    def advance(doing: str, done: int, total: int) -> None:
        if cancel.is_set():
            raise KeyboardInterrupt("the step was stopped: begin it again")
        emit("progress", {"doing": doing, "done": done, "total": total})

    assert task.do is not None
    emit("stepped", as_json(task.do(place, advance)))


class WorkerProcess:
    """A process that does tasks; one that has ended is followed by a new one at the next task.

    Args:
        place: where, and what becomes of it; its functions are those of modules.
    """

    def __init__(self, place: Workplace) -> None:
        self._place = place
        self._context = multiprocessing.get_context("spawn")
        self._process: Any = None
        self._line: Connection | None = None
        self.start()

    def start(self) -> None:
        """Start the process, unless it runs."""
        if self._process is not None and self._process.is_alive():
            return
        self._line, theirs = self._context.Pipe()
        self._process = self._context.Process(
            target=_work, args=(theirs, self._place, language()), name="anisoscope inspections"
        )
        self._process.start()
        theirs.close()

    def run(self, task: Task, emit: Emit, cancel: threading.Event) -> None:
        """Do a task; see `Worker`."""
        self.start()
        assert self._line is not None
        asked = False
        try:
            self._line.send(task)
            while True:
                if cancel.is_set() and not asked:
                    self._line.send(None)
                    asked = True
                if not self._line.poll(POLL_S):
                    continue
                kind, content = self._line.recv()
                if kind == "end":
                    return
                emit(kind, content)
        except (EOFError, OSError):
            emit(
                "failed",
                {
                    "text": "the process of the inspection has ended; resume the inspection",
                    "stopped": False,
                    "ended": True,
                },
            )

    def close(self) -> None:
        """End the process; an inspection is stopped before, and can be resumed."""
        if self._line is not None:
            self._line.close()
        if self._process is not None:
            self._process.join(10.0)
            if self._process.is_alive():
                self._process.kill()


def _work(line: Connection, place: Workplace, lang: str) -> None:
    """Main function of the process: tasks come along the line, None cancels, and its end ends everything."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # whoever ends the console closes the line
    use(lang)
    tasks: list[Task] = []
    ready, over, cancel = threading.Semaphore(0), threading.Event(), threading.Event()

    def listen() -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                task = line.recv()
                if task is None:
                    cancel.set()
                else:
                    cancel.clear()
                    tasks.append(task)
                    ready.release()
        over.set()
        cancel.set()
        ready.release()

    threading.Thread(target=listen, name="tasks", daemon=True).start()
    import anisoscope.inspection.run  # noqa: F401, PLC0415 - before the first part comes

    sending = threading.Lock()

    def emit(kind: str, content: dict[str, Any]) -> None:
        with sending, contextlib.suppress(OSError):
            line.send((kind, content))

    while True:
        ready.acquire()
        if over.is_set():
            return
        perform(tasks.pop(0), place, emit, cancel)
        emit("end", {})


@dataclass(frozen=True)
class HeldRig:
    """A rig that a server holds: camera and light at hand, and what stops its axes, by table what went wrong."""

    camera: SharedCamera | None
    light: Light | None
    stop: Callable[[], dict[str, str]]
    channel: str | None = None
    """Light channel that is used where a recipe names none."""


@contextlib.contextmanager
def held_rig(rig: Path) -> Iterator[HeldRig]:
    """The rig, held by this process, or by another one that holds it already (`anisoscope rig hold`).

    Raises:
        UsageError: a device asks the operator in a terminal, which a server has not.
        RigFileError, RigError: the rig cannot be read or opened.
    """
    file = read_rig(rig)
    asking = [table for table, part in file.axes.items() if part.driver in ASKING]
    asking += ["light"] * (file.light.driver in ASKING)
    if asking:
        raise UsageError(
            f"{rig}: {' and '.join(asking)} of this rig are set by hand, which asks in a terminal: use "
            "`anisoscope inspect` there"
        )
    if any(map(is_held, file.axes.values())):
        with open_devices({}, file.camera, file.light) as devices:
            assert devices.camera is not None

            def stop() -> dict[str, str]:
                return {table: why for found in stop_held(rig).values() for table, why in found.items()}

            yield HeldRig(SharedCamera(devices.camera), devices.light, stop, file.light.channel)
        return
    with hold_devices(file.axes, file, str(rig)) as held:
        yield HeldRig(held.owner.camera, held.devices.light, held.owner.stop_all, file.light.channel)
