"""A job is carried out once: ordered twice, refused, stopped, or killed at every point of its way."""

import json
import threading
from dataclasses import replace

import pytest

from anisoscope.base.errors import CameraError, RecordError
from anisoscope.history.store import open_history
from anisoscope.inspection import work
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.run import write_report_again
from anisoscope.inspection.work import Task, WorkerHere, perform
from anisoscope.line.jobs import Jobs, Order, Refused, order_of, result_of
from anisoscope.record.schema import Particulars
from anisoscope.sim.bench.camera import SimulatedCamera


class Killed(BaseException):
    """The process is no more: nothing catches this but the tests."""


def rows_of(place):
    with open_history(place.history, create=False) as history:
        return history.rows()


def records_of(place):
    return sorted(path.parent.name for path in place.out.glob("*/record.json"))


@pytest.fixture(scope="module")
def place(place_of):
    return place_of("jobs")


def test_a_job_is_done_once_and_its_result_is_that_of_the_record(place, jobs_at):
    jobs, _ = jobs_at(*place)
    heard = []
    jobs.listen(lambda kind, job, _: heard.append((kind, job.id)))
    order = Order(job="J1", recipe="plate", serial="A-1", lot="L7", cavity="2", operator="PLC")
    jobs.submit(order)
    assert jobs.wait(600)
    done = jobs.job("J1")
    assert (done.state, done.verdict, done.problem) == ("done", "PASS", None)
    assert jobs.submit(order) == done  # the answer was lost: ordered again
    record = jobs.record("J1")
    assert (record.serial, record.verdict) == ("A-1", "PASS")
    who = record.particulars
    assert (who.job, who.lot, who.cavity, who.operator, who.station) == ("J1", "L7", "2", "PLC", "S1")
    assert [row.folder for row in rows_of(place[0]) if row.serial == "A-1"] == [str(done.folder)]
    assert [kind for kind, _ in heard if kind != "progress"] == ["accepted", "done"]
    assert ("progress", "J1") in heard
    with pytest.raises(Refused, match="for another part") as refused:
        jobs.submit(order.model_copy(update={"serial": "A-2"}))
    assert refused.value.why == "changed"
    assert records_of(place[0]).count(done.folder.name) == 1
    assert not any(name.startswith("A-2") for name in records_of(place[0]))


@pytest.mark.parametrize(
    ("name", "angle", "reports", "verdict", "is_there"),
    [
        ("jobs", 10.0, "not-pass", "PASS", False),
        ("worn", 6.0, "not-pass", "INCONCLUSIVE", True),
        ("worn", 6.0, "none", "INCONCLUSIVE", False),
    ],
)
def test_a_part_gets_a_report_where_that_is_wanted(
    place_of, jobs_at, name, angle, reports, verdict, is_there
):
    """Without one its folder is as whole, its result links none, and one can be written later."""
    place, recipes = place_of(name, bench={"sample": {"ridge_angle_deg": angle}})
    jobs, _ = jobs_at(replace(place, reports=reports), recipes)
    order = Order(job=f"{verdict} {reports}", recipe="plate", serial=f"{verdict} {reports}")
    jobs.submit(order)
    assert jobs.wait(600)
    done = jobs.job(order.job)
    report = done.folder / "report.html"
    assert (done.verdict, report.exists()) == (verdict, is_there)
    found = verify(done.folder)
    assert (found.intact, found.finished, found.report_written) == (True, True, is_there)
    link = report.as_uri() if is_there else None
    assert result_of(done, jobs.record(order.job), reports)["links"]["report"] == link
    if not is_there:
        write_report_again(done.folder)
        assert verify(done.folder).report_written
        assert result_of(done, jobs.record(order.job), reports)["links"]["report"] == report.as_uri()


@pytest.mark.parametrize(
    ("changes", "why", "words"),
    [
        ({"recipe": "no such"}, "recipe", "there is no recipe 'no such'"),
        ({"recipe": "../recipe"}, "recipe", "there is no recipe"),
        ({"recipe": "broken"}, "recipe", "recipe broken cannot be used"),
        ({"serial": "=1+1"}, "serial", "cannot be used"),
        ({"serial": ""}, "serial", "cannot be used"),
    ],
)
def test_what_cannot_be_done_is_refused_and_leaves_nothing(place_of, jobs_at, changes, why, words):
    place, recipes = place_of("refused")
    (recipes / "broken.toml").write_text("schema = 1\n")
    jobs, _ = jobs_at(place, recipes)
    with pytest.raises(Refused, match=words) as refused:
        jobs.submit(Order(**({"job": "J", "recipe": "plate", "serial": "A"} | changes)))
    assert refused.value.why == why
    assert "\n" not in str(refused.value)
    assert (jobs.all(), records_of(place)) == ([], [])


@pytest.mark.parametrize(
    "content",
    [
        None,
        [],
        {"job": "J"},
        {"job": 7, "recipe": "plate", "serial": "A"},
        {"job": "J", "recipe": ["plate"], "serial": "A"},
        {"job": "a\nb", "recipe": "plate", "serial": "A"},
        {"job": "J", "recipe": "plate", "serial": "A", "more": 1},
    ],
)
def test_what_is_no_order_is_refused_by_name(content):
    with pytest.raises(Refused) as refused:
        order_of(content)
    assert refused.value.why == "order"


@pytest.fixture
def at_the_third(monkeypatch):
    """Inspections wait at their third frame, until they may go on."""
    grab, count, reached, go = SimulatedCamera.grab, [], threading.Event(), threading.Event()

    def wait(camera):
        count.append(1)
        if len(count) == 3:
            reached.set()
            go.wait()
        return grab(camera)

    monkeypatch.setattr(SimulatedCamera, "grab", wait)
    yield reached, go
    go.set()


def test_a_second_job_is_refused_and_a_stop_is_for_good(place_of, jobs_at, at_the_third):
    place = place_of("stopped")
    reached, go = at_the_third
    with Jobs(*place, WorkerHere(place[0]), lambda: {"stage": "jammed", "tilt": ""}) as jobs:
        jobs.submit(Order(job="J1", recipe="plate", serial="A-1"))
        assert reached.wait(600)
        assert jobs.running.id == "J1"
        with pytest.raises(Refused, match="job J1 is at work") as refused:
            jobs.submit(Order(job="J2", recipe="plate", serial="A-2"))
        assert refused.value.why == "busy"
        assert jobs.stop() == {"stage": "jammed"}
        go.set()
        assert jobs.wait(600)
        assert (jobs.job("J1").state, jobs.running) == ("stopped", None)
        assert jobs.record("J1") is None
    with pytest.raises(Refused, match="ending"):
        jobs.submit(Order(job="J3", recipe="plate", serial="A-3"))
    again, _ = jobs_at(*place)
    assert again.job("J1").state == "stopped"
    assert again.running is None


def test_a_fault_of_the_rig_fails_the_job_and_the_next_one_is_done(place_of, jobs_at, monkeypatch):
    place = place_of("fault")
    jobs, _ = jobs_at(*place)
    with monkeypatch.context() as patch:

        def fail(_):
            raise CameraError("the cable came off")

        patch.setattr(SimulatedCamera, "grab", fail)
        jobs.submit(Order(job="J1", recipe="plate", serial="A-1"))
        assert jobs.wait(600)
    assert (jobs.job("J1").state, jobs.job("J1").verdict) == ("failed", None)
    assert "the cable came off" in jobs.job("J1").problem
    jobs.submit(Order(job="J2", recipe="plate", serial="A-2"))
    assert jobs.wait(600)
    assert jobs.job("J2").verdict == "PASS"
    assert len(rows_of(place[0])) == 1


def test_another_server_is_refused_while_one_works_in_the_folder(place, jobs_at):
    jobs_at(*place)
    with pytest.raises(RecordError, match="another process"), Jobs(*place, WorkerHere(place[0]), dict):
        pass


class Dying:
    """A worker that dies at a point, as by kill -9: nothing after it happens, and nobody hears of it."""

    def __init__(self, place, point, patch):
        self.place, self.point, self.patch = place, point, patch

    def run(self, task, emit, cancel):
        def told(kind, content):
            if kind == self.point:
                raise Killed
            emit(kind, content)

        place = self.place
        if self.point == "frame":
            grab, count = SimulatedCamera.grab, []

            def die(camera):
                count.append(1)
                if len(count) == 4:
                    raise Killed
                return grab(camera)

            self.patch.setattr(SimulatedCamera, "grab", die)
        try:
            if self.point == "begin":
                raise Killed
            work.perform(task, place, told, cancel)
        except Killed:
            self.patch.undo()


@pytest.mark.parametrize(
    ("point", "reports"),
    [
        ("begin", "all"),
        ("folder", "all"),
        ("frame", "none"),
        ("verdict", "all"),
        ("verdict", "not-pass"),
        ("entered", "all"),
    ],
)
def test_a_job_that_was_killed_anywhere_is_taken_up_and_done_once(
    place_of, jobs_at, monkeypatch, point, reports
):
    place, recipes = place_of(f"killed at {point}, reports {reports}")
    place = replace(place, reports=reports), recipes
    order = Order(job="J1", recipe="plate", serial="A [1]", lot="L")
    with pytest.MonkeyPatch.context() as patch:
        before = Jobs(*place, Dying(place[0], point, patch), dict)
        monkeypatch.setattr(before, "_end", lambda *_, **__: None)  # the journal ends with the process
        with before:
            before.submit(order)
            assert before.wait(600)
    with (place[0].out / "line" / "jobs.jsonl").open("ab") as torn:
        torn.write(b'{"line":"end","at":')
    jobs, _ = jobs_at(*place)
    assert jobs.wait(600)
    done = jobs.submit(order)
    assert (done.state, done.verdict) == ("done", "PASS")
    assert records_of(place[0]) == [done.folder.name]
    assert [(row.serial, row.folder) for row in rows_of(place[0])] == [("A [1]", str(done.folder))]
    assert (done.folder / "report.html").exists() == (reports == "all")
    lines = [json.loads(text) for text in (place[0].out / "line" / "jobs.jsonl").read_text().splitlines()]
    assert [line["line"] for line in lines] == ["accepted", "end"]


def test_the_oldest_jobs_are_forgotten_and_their_results_stay(place_of, jobs_at, monkeypatch):
    monkeypatch.setattr("anisoscope.line.jobs.KNOWN", 1)
    place, recipes = place_of("known")
    orders = [Order(job=f"J{number}", recipe="plate", serial=f"A-{number}") for number in range(3)]
    journal = place.out / "line" / "jobs.jsonl"

    def full(*_):
        raise RecordError("no space left on the device")

    with Jobs(place, recipes, WorkerHere(place), dict) as jobs:
        for order in orders[:2]:
            jobs.submit(order)
            assert jobs.wait(600)
        before = journal.read_bytes()
        with monkeypatch.context() as patch, pytest.raises(RecordError, match="no space"):
            patch.setattr("anisoscope.base.json_file.write_text", full)
            jobs.submit(orders[2])
        assert ([job.id for job in jobs.all()], journal.read_bytes()) == (["J0", "J1"], before)
        jobs.submit(orders[2])
        assert jobs.wait(600)
        latest = jobs.all()
    assert [(job.id, job.state, job.verdict) for job in latest] == [
        ("J1", "done", "PASS"),
        ("J2", "done", "PASS"),
    ]
    again, _ = jobs_at(place, recipes)
    assert again.all() == latest
    assert again.submit(orders[1]) == latest[0]  # known: not done again
    assert again.record("J2").serial == "A-2"
    assert [row.serial for row in rows_of(place)] == ["A-0", "A-1", "A-2"]
    assert len(records_of(place)) == 3


def test_a_journal_that_was_changed_is_refused(place_of):
    place = place_of("damaged")
    journal = place[0].out / "line" / "jobs.jsonl"
    journal.parent.mkdir(parents=True)
    for text, words in [
        ("{}\n", "line 1 is damaged"),
        ('{"line":"end","at":"","job":"J","state":"done"}\n', "never"),
    ]:
        journal.write_text(text)
        with pytest.raises(RecordError, match=words), Jobs(*place, WorkerHere(place[0]), dict):
            pass


def test_parts_of_a_lot_that_were_judged_anew_are_noted(place):
    heard = []
    anew = replace(place[0], judge_lot=lambda inspected, _, reports: (inspected,))
    task = Task("inspect", place[1] / "plate.toml", "S-1", Particulars(lot="L1"))
    perform(task, anew, lambda kind, content: heard.append((kind, content)), threading.Event())
    kinds = [kind for kind, _ in heard if kind != "progress"]
    assert kinds.index("entered") < kinds.index("note")
    assert any("judged anew after" in content["text"] for kind, content in heard if kind == "note")
