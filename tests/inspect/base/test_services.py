"""Services end by a signal only: faults thrown in every callback of every loop, which goes on and ends when told."""

import asyncio
import contextlib
import itertools
import os
import queue
import random
import threading
import types
from functools import partial
from pathlib import Path

import pytest

from anisoscope.base import crash
from anisoscope.base.crash import Steady
from anisoscope.base.errors import NotConnected, RecordError, UsageError
from anisoscope.console.station import Station
from anisoscope.history import signs, store
from anisoscope.inspection import archive as archives
from anisoscope.inspection.batch import run as batches
from anisoscope.inspection.batch import watch as watching
from anisoscope.inspection.batch.operator import Answer
from anisoscope.inspection.reports import Reports
from anisoscope.inspection.work import Task, Workplace
from anisoscope.line import jobs as orders
from anisoscope.line import press as presses
from anisoscope.line.jobs import Jobs
from anisoscope.line.modbus import Handshake
from anisoscope.line.mqtt import EdgeNode, broker_of
from anisoscope.line.opcua import VisionServer
from anisoscope.line.sparkplug import Names

MANY, CAMPAIGN = 60, 700
"""Faults for each callback."""
FAULTS = (
    OSError(28, "No space left on device"),
    BrokenPipeError(32, "Broken pipe"),
    PermissionError(13, "Permission denied"),
    TimeoutError("timed out"),
    ValueError("no number"),
    KeyError("serial"),
    TypeError("no text"),
    AssertionError(),
    AttributeError("none"),
    RecursionError("too deep"),
    MemoryError(),
    ZeroDivisionError("by zero"),
    UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"),
    RuntimeError("a driver"),
    StopIteration(),
    RecordError("a damaged record"),
    UsageError("a wrong word"),
    NotConnected("nobody there"),
)


class Thrower:
    """Throws faults in turn, a number of them, and then does as it is told."""

    def __init__(self, count, then=lambda *_, **__: None):
        self.left, self.then, self.done = count, then, threading.Event()
        self.draw = random.Random(count)

    def __call__(self, *given, **named):
        if self.left <= 0:
            self.done.set()
            return self.then(*given, **named)
        self.left -= 1
        fault = self.draw.choice(FAULTS)
        fault.__context__ = None  # of the time before
        raise fault.with_traceback(None)


@pytest.fixture(autouse=True)
def no_files(monkeypatch):
    """The files of what nothing foresaw are not written thousands of times."""
    monkeypatch.setattr(crash, "crash_line", lambda error, during: f"{during}: {type(error).__name__}")
    monkeypatch.setattr(watching, "crash_line", crash.crash_line)


def watch_of(tmp_path, monkeypatch, callback, thrower):
    """A watch of a folder whose parts are looked at again and again."""
    numbers = itertools.count()
    arrival = lambda *_: iter([watching.Arrival("in/a", f"a{next(numbers)}", (1, 1))])  # noqa: E731
    listener = types.SimpleNamespace(bad=lambda *_: None)
    found = watching.Watch(
        types.SimpleNamespace(root=tmp_path, out=tmp_path / "out", poll_s=0.0, settle_s=0.0), listener, None
    )
    found._journal = types.SimpleNamespace(knows=lambda _: False)
    monkeypatch.setattr(watching, "LEISURE", 0.0)
    monkeypatch.setattr(watching, "arrivals", arrival)
    monkeypatch.setattr(watching, "signature_of", lambda _: ())
    monkeypatch.setattr(found, "_take", lambda *_: None)
    if callback == "journal":
        found._journal.knows = thrower
    elif callback == "listener":
        thrower.then = listener.bad = thrower
        monkeypatch.setattr(found, "_take", Thrower(10**9))
        thrower.then = lambda *_: None
    elif callback == "part":
        monkeypatch.setattr(found, "_take", thrower)
    elif callback == "folder":
        thrower.then = arrival
        monkeypatch.setattr(watching, "arrivals", thrower)
    else:
        thrower.then = lambda _: ()
        monkeypatch.setattr(watching, "signature_of", thrower)
    stop = threading.Event()
    return partial(found.run, stop), stop.set


def modbus_of(tmp_path, monkeypatch, callback, thrower):
    """The handshake as the command goes round in it."""
    io = types.SimpleNamespace(read=lambda: 1, write=lambda _: None)
    job = types.SimpleNamespace(state="done", verdict="PASS")
    jobs = types.SimpleNamespace(running=None, submit=lambda _: job)
    said = thrower if callback == "operator" else lambda _: None
    if callback == "operator":
        io.read = Thrower(10**9)
    else:
        thrower.then = {"read": lambda: 1, "write": lambda _: None, "submit": lambda _: job}[callback]
        setattr(jobs if callback == "submit" else io, callback, thrower)
    stop, handshake = threading.Event(), Handshake(io, jobs, "plate", "", said)
    numbers = itertools.count()
    if callback == "submit":
        io.read = lambda: next(numbers)

    def run():
        steady = Steady("line modbus", said)
        while not stop.is_set():
            steady(handshake.step, None)

    return run, stop.set


def mqtt_of(tmp_path, monkeypatch, callback, thrower):
    """The loop of the node, without a broker."""
    said = thrower if callback == "operator" else lambda _: None
    names = Names("group", "node", "device")
    node = EdgeNode(broker_of("mqtt://127.0.0.1"), names, tmp_path / "h", tmp_path / "m", said)
    for name in ("_begin", "_look", "_die"):
        monkeypatch.setattr(node, name, lambda: None)
    monkeypatch.setattr(node, "_connect", lambda: 0.0)
    monkeypatch.setattr(node, "_on_job", lambda *_: None)
    ever = types.SimpleNamespace(
        put=node._events.put, get=lambda timeout: next_event(node._events, inner, timeout)
    )
    inner = node._events
    monkeypatch.setattr(node, "_events", ever)
    if callback == "operator":
        monkeypatch.setattr(node, "_on_job", Thrower(10**9))
    else:
        thrower.then = (lambda: 0.0) if callback == "_connect" else thrower.then
        monkeypatch.setattr(node, callback, thrower)
    turn = itertools.count()

    def next_event(_, events, timeout):
        try:
            return events.get_nowait()
        except queue.Empty:
            if callback == "_look" or next(turn) % 2:
                raise
            return ("job", "done", None)

    return node.run, node.end


def signs_of(tmp_path, monkeypatch, callback, thrower):
    """The thread that gives signs of a station."""
    complain = thrower if callback == "operator" else lambda _: None
    monkeypatch.setattr(store, "open_history", thrower if callback == "history" else Thrower(10**9))
    beacon = signs.Beacon(tmp_path / "h.sqlite", "north", complain, beat_s=0.0)
    return beacon._run, beacon._over.set


def batch_of(tmp_path, monkeypatch, callback, thrower):
    """A batch of more slots than faults; the slot after the last fault is at work until the end."""
    stop = threading.Event()
    slots = [
        types.SimpleNamespace(label=f"{n}", serial=f"{n}", state="waiting", slot=f"{n}") for n in range(2000)
    ]
    operator = types.SimpleNamespace(
        place=lambda *_, **__: Answer(),
        progress=lambda *_: contextlib.nullcontext(),
        finished=lambda *_: None,
        trouble=lambda *_: "stop" if stop.is_set() else "go on",
    )
    order = types.SimpleNamespace(
        tray=types.SimpleNamespace(placed=False, slots=slots),
        out=tmp_path,
        look=None,
        files=lambda _: (None, None),
    )
    batch = types.SimpleNamespace(slots=slots)
    run = batches._Run(order, operator, lambda _: None, batch, None, None)
    monkeypatch.setattr(run, "_note", lambda *_, **__: None)
    thrower.then = lambda *_, **__: stop.wait()
    monkeypatch.setattr(*{"part": (run, "_inspect"), "code": (run, "_identify")}[callback], thrower)
    return run.all_slots, stop.set


def push_of(tmp_path, monkeypatch, callback, thrower):
    """A push of more folders than faults."""
    stop = threading.Event()
    thrower.then = lambda *_, **__: stop.wait()
    monkeypatch.setattr(archives, "check_format", lambda *_, **__: None)
    monkeypatch.setattr(archives, "finished_folders", lambda _: [tmp_path / f"{n}" for n in range(2000)])
    monkeypatch.setattr(archives, {"record": "read_record", "push": "push"}[callback], thrower)
    if callback == "push":
        who = types.SimpleNamespace(particulars=types.SimpleNamespace(station=None))
        monkeypatch.setattr(archives, "read_record", lambda _: who)
        monkeypatch.setattr(archives, "record_signature", lambda _: None)
    return partial(archives.push_all, None, [], remove=False, tell=lambda _: None), stop.set


def jobs_of(tmp_path, monkeypatch, callback, thrower):
    """Jobs one after the other; each has an end."""
    order = types.SimpleNamespace(operator="", lot=None, cavity=None, job="1", recipe="plate", serial="1")
    job, ended, stop = types.SimpleNamespace(id="1", order=order), [], threading.Event()
    jobs = Jobs(
        types.SimpleNamespace(out=tmp_path), tmp_path, types.SimpleNamespace(run=lambda *_: None), None
    )
    monkeypatch.setattr(jobs, "_end", lambda _, state, *__, **___: ended.append(jobs._say("ended", job, {})))
    monkeypatch.setattr(orders, "recipe_paths", lambda _: {"plate": tmp_path})
    if callback == "listener":
        jobs._listeners.append(thrower)
    elif callback == "recipes":
        thrower.then = orders.recipe_paths
        monkeypatch.setattr(orders, "recipe_paths", thrower)
    else:
        jobs._worker.run = thrower

    def run():
        for number in itertools.count(1):
            jobs._do(job, threading.Event(), None, True)
            assert len(ended) == number
            if stop.is_set():
                return

    return run, stop.set


def opcua_of(tmp_path, monkeypatch, callback, thrower):
    """The task that follows the jobs of the server."""
    server, over = VisionServer.__new__(VisionServer), threading.Event()

    async def ended(*_):
        thrower()

    async def main():
        server._heard, server._lock, server._ended = asyncio.Queue(), asyncio.Lock(), ended
        following = asyncio.create_task(server._follow())
        while not over.is_set():
            server._heard.put_nowait(("failed", types.SimpleNamespace(id="1"), None))
            await asyncio.sleep(0)
            assert not following.done()
        following.cancel()

    return lambda: asyncio.run(main()), over.set


def press_of(tmp_path, monkeypatch, callback, thrower):
    """The reader of a machine's cycles, without the machine."""
    over, numbers = threading.Event(), itertools.count()
    said = thrower if callback == "operator" else lambda _: None

    @contextlib.asynccontextmanager
    async def connected(_):
        if callback == "_connect" and next(numbers):  # a wrong word ends it before it was ever connected
            try:
                thrower()
            except StopIteration:  # a coroutine makes it a RuntimeError, a context manager does not
                raise RuntimeError from None
        yield types.SimpleNamespace(check_connection=check)

    async def check():
        if over.is_set():
            raise asyncio.CancelledError
        cycle = types.SimpleNamespace(data_types={"t": presses._REALS[0]}, t=float(next(numbers)))
        reader.event_notification(cycle)
        if callback == "_connect" and not thrower.done.is_set():
            raise OSError("gone again")

    async def subscribed(_):
        return None

    take = (
        thrower if callback == "history" else Thrower(10**9) if callback == "operator" else lambda _: "taken"
    )
    thrower.then = lambda *_: "taken"
    monkeypatch.setattr(presses, "_connected", connected)
    reader = presses.PressReader("opc.tcp://127.0.0.1", take, said, again_s=(0.0,))
    monkeypatch.setattr(reader, "_subscribe", subscribed)

    def run():
        with contextlib.suppress(asyncio.CancelledError):
            asyncio.run(reader.run())

    return run, over.set


def serve_of(tmp_path, monkeypatch, callback, thrower):
    """Tasks of the console one after the other; each ends, and the page says why."""
    worker = types.SimpleNamespace(run=lambda *_: None)
    station, stop = (
        Station(Workplace(tmp_path, tmp_path), tmp_path, worker, dict, None, None),
        threading.Event(),
    )
    if callback == "worker":
        worker.run = thrower
    else:
        thrower.then = station.live.pause
        monkeypatch.setattr(station.live, "pause", thrower)

    def run():
        while not stop.is_set():
            station._now.state, left = "running", thrower.left
            station._do(Task("job", None, "1", None), threading.Event())
            now = station.state()[1]
            assert now["state"] == "failed"
            assert now["failure"] or thrower.left == left

    return run, stop.set


LOOPS = {
    watch_of: ("folder", "journal", "signature", "part", "listener"),
    modbus_of: ("read", "write", "submit", "operator"),
    mqtt_of: ("_connect", "_look", "_on_job", "operator"),
    signs_of: ("history", "operator"),
    batch_of: ("part", "code"),
    push_of: ("record", "push"),
    jobs_of: ("recipes", "worker", "listener"),
    opcua_of: ("_on_job",),
    press_of: ("_connect", "history", "operator"),
    serve_of: ("worker", "camera"),
}
CASES = [(loop, callback) for loop, callbacks in LOOPS.items() for callback in callbacks]


def thrown(loop, callback, tmp_path, monkeypatch, count):
    """A loop with that many faults in one callback: it still runs afterwards, and ends when it is told."""
    thrower, problems = Thrower(count), []
    run, end = loop(tmp_path, monkeypatch, callback, thrower)

    def guarded():
        try:
            run()
        except BaseException as error:  # noqa: BLE001 - that is what is looked for
            problems.append(error)

    thread = threading.Thread(target=guarded)
    thread.start()
    try:
        assert thrower.done.wait(120), (thrower.left, problems)
        assert thread.is_alive()
    finally:
        end()
        thread.join(20)
    assert not thread.is_alive()
    assert not problems


@pytest.mark.parametrize(("loop", "callback"), CASES, ids=lambda one: getattr(one, "__name__", one))
def test_no_fault_ends_a_service(loop, callback, tmp_path, monkeypatch):
    thrown(loop, callback, tmp_path, monkeypatch, MANY)


@pytest.mark.soak
@pytest.mark.parametrize(("loop", "callback"), CASES, ids=lambda one: getattr(one, "__name__", one))
def test_ten_thousand_faults_end_no_service(loop, callback, tmp_path, monkeypatch):
    thrown(loop, callback, tmp_path, monkeypatch, CAMPAIGN)


def test_reports_are_written_though_nobody_hears_of_them(tmp_path):
    written = []

    class Pending:
        folder = tmp_path

        def write(self):
            written.append(1)
            return ("a note",)

        def discard(self):
            pass

    with Reports(Thrower(10**9)) as reports:
        for _ in range(MANY):
            reports.add(Pending())
        reports.wait()
    assert len(written) == MANY


def test_a_fault_is_said_once_until_it_is_over():
    said = []
    steady = Steady("a service", said.append)

    def fail(text):
        raise RecordError(text)

    for text in ("away", "away", "full", "away"):
        assert steady(partial(fail, text), 7) == 7
    assert said == ["away", "full", "away"]
    assert steady(lambda: 3, 7) == 3
    steady(partial(fail, "away"), 7)
    assert said[3:] == ["away"]
    with pytest.raises(KeyboardInterrupt):
        steady(lambda: (_ for _ in ()).throw(KeyboardInterrupt), 7)


SERVICES = {
    watch_of: "`watch`",
    modbus_of: "`line modbus`",
    mqtt_of: "`line mqtt`",
    signs_of: "signs of a station",
    batch_of: "`batch`",
    push_of: "`archive push`",
    jobs_of: "jobs of `line`",
    opcua_of: "`line opcua`",
    press_of: "`line press`",
    serve_of: "`serve`",
}
WORDS = {
    "folder": "reading the watched folder",
    "journal": "the journal",
    "signature": "looking at a part's folder",
    "part": "inspecting a part",
    "operator": "printing",
    "read": "reading inputs",
    "write": "setting outputs",
    "submit": "beginning a job",
    "_connect": "connecting",
    "record": "reading a record",
    "push": "sending an inspection",
    "_look": "reading the history",
    "_on_job": "taking a job's events",
    "history": "writing the history",
    "code": "reading a part's code",
    "recipes": "reading the folder of recipes",
    "worker": "the process that inspects",
    "listener": "printing",
    "camera": "pausing the live picture",
}
MARKS = "<!-- services: the faults that tests throw -->\n", "<!-- end of services -->"


def test_the_docs_say_where_faults_are_thrown():
    rows = [
        f"| {SERVICES[loop]} | {', '.join(WORDS[one] for one in callbacks)} |"
        for loop, callbacks in LOOPS.items()
    ]
    table = "\n".join(["| service | faults thrown in |", "|---|---|", *rows, ""])
    page = Path(__file__).resolve().parents[3] / "docs" / "evidence" / "line.md"
    text = page.read_text(encoding="utf-8")
    before, _, rest = text.partition(MARKS[0])
    _, _, after = rest.partition(MARKS[1])
    wanted = before + MARKS[0] + table + MARKS[1] + after
    if os.environ.get("ANISOSCOPE_WRITE_DOCS"):
        page.write_text(wanted, encoding="utf-8")
    assert text == wanted or os.environ.get("ANISOSCOPE_WRITE_DOCS")
