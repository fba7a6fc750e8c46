"""A part is inspected by the interface of programs: what it shows, who may steer, what a stop and a crash leave."""

import asyncio
import contextlib
import json
import runpy
import threading
from pathlib import Path
from types import SimpleNamespace

import httpx
import numpy as np
import pytest

from anisoscope.console.access import Session
from anisoscope.console.live import EventLog, exposure_advice, focus_advice
from anisoscope.console.station import Start, _in_short, _Present
from anisoscope.inspection import run
from anisoscope.rig.acquisition.journal import read_journal
from anisoscope.sim.bench.camera import SimulatedCamera


@pytest.fixture(scope="module")
def at(station_at):
    return station_at("api")[0]


@pytest.fixture(scope="module")
def address(served, app_of, at):
    with served(app_of(at)) as found:
        yield found


class Browser:
    """A client with a session."""

    def __init__(self, address):
        self.client = httpx.Client(base_url=f"{address}/api/v1", timeout=60)
        self.who = self.client.get("/session").json()
        self.client.headers["X-CSRF-Token"] = self.who["token"]

    def post(self, path, **content):
        return self.client.post(path, json=content)

    def get(self, path, **query):
        return self.client.get(path, params=query).json()

    def events(self, last=""):
        """Events as (id, kind, content), until the connection is cut."""
        with self.client.stream("GET", "/events", headers={"Last-Event-ID": last}) as answer:
            event = {}
            for line in answer.iter_lines():
                if line:
                    name, _, text = line.partition(": ")
                    event[name] = text
                elif "data" in event:
                    yield event["id"], event["event"], json.loads(event["data"])
                    event = {}

    def first(self, last=""):
        """The first event after an id; then the connection is cut."""
        with contextlib.closing(self.events(last)) as events:
            return next(events)

    def wait(self):
        """The state once the rig is at rest again."""
        with contextlib.closing(self.events()) as events:
            states = (content for _, kind, content in events if kind == "state")
            return next(state for state in states if state["state"] in {"done", "failed"})


@pytest.fixture
def browser(address):
    found = Browser(address)
    yield found
    found.post("/release")
    found.client.close()


def begin(browser, serial, **more):
    answer = browser.post("/start", recipe="plate", serial=serial, **more)
    assert answer.status_code == 200, answer.text


def test_a_part_is_inspected_and_enters_the_history(browser, at, monkeypatch):
    reported = []
    monkeypatch.setattr(at, "_report", lambda *said: reported.append(said))
    begin(browser, "A-1", lot="L7")
    state = browser.wait()
    assert (state["verdict"]["verdict"], state["verdict"]["serial"]) == ("PASS", "A-1")
    assert all(state["verdict"][name] for name in ("finding", "action"))
    journal = read_journal(at.place.out / state["folder"])
    shown = sum(line.kind == "sample" for line in journal.frames)
    assert state["frames"] == shown < len(journal.frames)
    for number in (1, shown):
        picture = browser.client.get(f"/frames/{number}.jpg")
        assert picture.content[:2] == b"\xff\xd8"
    assert browser.client.get(f"/frames/{shown + 1}.jpg").status_code == 404
    at._busy.join()  # the history follows the verdict
    assert ("running", "A-1") in reported
    assert reported[-1] == ("idle", "")
    (row,) = browser.get("/results", serial="A-1")
    assert (row["verdict"], row["lot"], row["station"], row["operator"]) == (
        "PASS",
        "L7",
        "S1",
        "this computer",
    )


def test_every_reader_has_the_events_in_its_language(browser, address):
    german = Browser(address)
    german.client.headers["accept-language"] = "de-DE, en;q=0.5"
    first = german.first()[0]
    begin(browser, "A-9")
    assert browser.wait()["verdict"]["word"] == "PASS"
    assert german.wait()["verdict"]["word"] == "bestanden"
    doing, last, state = set(), first, {"state": "", "task": {}}
    while (state["state"], state["task"].get("serial")) != ("done", "A-9"):
        last, kind, content = german.first(last)
        doing.add(content["doing"])
        state = content if kind == "state" else state
    assert "Dunkelbild bei -10,000°" in doing
    assert state["verdict"]["word"] == "bestanden"
    german.client.cookies.set("language", "da")
    assert german.get("/status")["verdict"]["word"] == "godkendt"
    german.client.close()


def test_every_event_arrives_once_though_the_connection_is_cut_after_each(browser, at):
    if at._busy is not None:
        at._busy.join()
    first, _, _ = browser.first()
    begin(browser, "A-2")
    seen, last = [], first
    while not seen or (seen[-1][2].get("state"), seen[-1][2].get("task", {}).get("serial")) != (
        "done",
        "A-2",
    ):
        last, kind, content = browser.first(last)
        seen.append((last, kind, content))
    numbers = [int(id_.partition("-")[2]) for id_, _, _ in seen]
    assert numbers == list(range(int(first.partition("-")[2]) + 1, numbers[-1] + 1))
    counted = [content["frames"] for _, kind, content in seen if kind == "progress"]
    assert counted == sorted(counted)
    assert seen[-1][2]["frames"] == sum(
        line.kind == "sample" for line in read_journal(at.place.out / seen[-1][2]["folder"]).frames
    )


@pytest.mark.soak
def test_no_event_of_a_thousand_inspections_is_lost_though_connections_are_cut(browser, at):
    rng, cuts, seen = np.random.default_rng(24), 0, []
    if at._busy is not None:
        at._busy.join()
    last = start = browser.first()[0]
    for part in range(1000):
        begin(browser, f"N-{part}")
        ended = False
        while not ended:
            with contextlib.closing(browser.events(last)) as events:
                for last, kind, content in events:
                    seen.append(last)
                    ended = kind == "state" and (content["state"], content["task"].get("serial")) == (
                        "done",
                        f"N-{part}",
                    )
                    if ended or rng.random() < 0.1:
                        cuts += not ended
                        break
    first, *_, newest = (int(id_.partition("-")[2]) for id_ in (start, *seen))
    print(f"{len(seen)} events, {cuts} connections cut, {newest - first - len(seen)} lost")  # noqa: T201 - the number
    assert [int(id_.partition("-")[2]) for id_ in seen] == list(range(first + 1, newest + 1))
    assert {id_.partition("-")[0] for id_ in seen} == {start.partition("-")[0]}


def test_what_failed_by_itself_is_a_fault_for_the_page_of_all_stations():
    failure = {"text": "the camera does not answer", "stopped": False}
    assert _in_short(_Present("failed", failure=failure)) == ("fault", "the camera does not answer")
    assert _in_short(_Present("failed", failure=failure | {"stopped": True})) == ("idle", "")
    checked = {"fit": False, "checks": []}
    assert _in_short(_Present("done", {"kind": "check"}, checked=checked))[0] == "fault"
    assert _in_short(_Present("done", {"kind": "check"}, checked=checked | {"fit": True})) == ("idle", "")
    assert _in_short(_Present("stopping", {"kind": "resume", "folder": "A-1-x"})) == ("running", "A-1-x")


def test_who_comes_back_after_a_restart_gets_the_state(browser):
    assert browser.first("0123abcd-99")[1] == "state"
    assert browser.first("nonsense")[1] == "state"


def test_only_one_holds_the_rig_and_all_may_stop(address, browser):
    other = Browser(address)
    browser.post("/take")
    following = browser.events()
    next(following)  # the page of the holder is open
    state = other.post("/take").json()
    assert (state["holder"]["id"], state["asking"]["id"]) == (browser.who["id"], other.who["id"])
    refused = other.post("/start", recipe="plate", serial="A-3")
    assert refused.status_code == 409
    assert "ask for it" in refused.json()["error"]
    assert other.post("/release").status_code == 409
    assert other.post("/stop").status_code == 200
    state = browser.post("/release").json()
    assert (state["holder"]["id"], state["asking"]) == (other.who["id"], None)
    following.close()
    other.post("/release")
    other.client.close()


def test_a_stop_ends_the_inspection_and_it_can_be_resumed(browser, at, monkeypatch):
    grab, count, reached, go = SimulatedCamera.grab, [], threading.Event(), threading.Event()

    def wait_at_the_fifth(camera):
        count.append(1)
        if len(count) == 5:
            reached.set()
            go.wait()
        return grab(camera)

    with monkeypatch.context() as patch:
        patch.setattr(SimulatedCamera, "grab", wait_at_the_fifth)
        begin(browser, "A-4")
        assert reached.wait(60)
        assert browser.get("/status")["state"] == "running"
        assert browser.post("/start", recipe="plate", serial="A-5").status_code == 409
        assert browser.client.get("/live.jpg", params={"recipe": "plate"}).status_code == 409
        browser.post("/stop")
        go.set()
        state = browser.wait()
    assert state["state"] == "failed"
    assert state["failure"]["stopped"]
    assert browser.get("/resumable")[0] == state["folder"]  # the latest
    assert browser.post("/resume", name="../../etc").status_code == 404
    browser.post("/resume", name=state["folder"])
    done = browser.wait()
    assert (done["verdict"]["serial"], done["verdict"]["verdict"]) == ("A-4", "PASS")
    assert state["folder"] not in browser.get("/resumable")


@pytest.mark.parametrize("work", ["begin_series", "judge"])
def test_a_stop_while_a_part_is_judged_ends_it_at_the_next_step(browser, at, monkeypatch, work):
    """Else the page went on for as long as its kernels are compiled, to a verdict."""
    usual, begun, go = getattr(run, work), threading.Event(), threading.Event()

    def wait(*given, **more):
        found = usual(*given, **more)
        begun.set()
        go.wait()
        return found

    with monkeypatch.context() as patch:
        patch.setattr(run, work, wait)
        begin(browser, "A-8")
        assert begun.wait(60)
        browser.post("/stop")
        assert browser.get("/status")["state"] == "stopping"
        go.set()
        state = browser.wait()
    assert state["failure"]["stopped"]
    assert "the inspection was stopped" in state["failure"]["text"]
    browser.post("/resume", name=state["folder"])
    assert browser.wait()["verdict"]["serial"] == "A-8"


def test_a_stop_reaches_the_axes_though_every_thread_waits(station_at, served, app_of, monkeypatch):
    station, stops = station_at("stopping")
    go, waiting = threading.Event(), threading.Semaphore(0)

    def hang(*_):
        waiting.release()
        go.wait()
        return b"", {"advice": []}

    monkeypatch.setattr(station.live, "look", hang)
    with served(app_of(station)) as address:
        browser = Browser(address)
        cookies = dict(browser.client.cookies)
        threads = [
            threading.Thread(
                target=httpx.get,
                args=(f"{address}/api/v1/live.jpg?recipe=plate",),
                kwargs={"cookies": cookies, "timeout": 60},
            )
            for _ in range(45)
        ]
        for thread in threads:
            thread.start()
        for _ in range(40):  # all threads of the server
            assert waiting.acquire(timeout=60)
        assert browser.post("/stop").status_code == 200
        assert stops == [1]
        go.set()
        for thread in threads:
            thread.join()
        browser.client.close()


def test_the_live_picture_has_numbers_and_the_lamp_goes_off_for_others(browser, at):
    answer = browser.client.get("/live.jpg", params={"recipe": "plate"})
    numbers = json.loads(answer.headers["x-numbers"])
    assert answer.content[:2] == b"\xff\xd8"
    assert numbers["relative_focus"] == 1.0
    lamp = at.live._eyes.light
    assert at.live._lit
    at.live.pause()
    assert not at.live._lit
    at.live.go_on()
    assert lamp is not None
    assert browser.client.get("/live.jpg", params={"recipe": "no such"}).status_code == 404


def test_advice():
    assert exposure_advice(0.5, 0.0) == []
    assert exposure_advice(0.5, 0.01) == ["too bright: shorten the exposure"]
    assert exposure_advice(0.02, 0.0) == ["too dark: lengthen the exposure"]
    assert focus_advice(1.0, None, 1.0) == []
    assert focus_advice(1.1, 1.0, 1.0) == ["sharper: go on in this direction"]
    assert focus_advice(0.9, 1.0, 0.95) == ["less sharp than it was: go back"]
    assert focus_advice(0.5, 0.5, 0.6) == ["less sharp than it was: go back"]
    assert focus_advice(float("nan"), 1.0, float("nan")) == []


def test_a_check_of_the_rig_shows_every_light(browser):
    browser.post("/check", name="plate")
    state = browser.wait()
    outcomes = {one["key"]: one["outcome"] for one in state["checked"]["checks"]}
    assert outcomes["axes.home"] == "PASS"
    assert len(outcomes) > 8


def test_calibrations_say_how_long_they_hold(browser):
    (flat,) = browser.get("/calibrations")
    assert (flat["kind"], flat["light"]) == ("flat", "green")
    assert 29.0 < flat["days"] <= 30.0


@pytest.mark.parametrize("serial", ["<script>alert(1)</script>", "", "x" * 65, "\x00", "=1+1"])
def test_serial_numbers_that_cannot_be_used_are_refused(browser, serial):
    answer = browser.post("/start", recipe="plate", serial=serial)
    assert answer.status_code in {409, 422}
    assert "\n" not in answer.json()["error"]


def test_places_are_for_rigs_with_axes_that_go_there(browser, at, monkeypatch):
    answer = browser.post("/start", recipe="plate", serial="P-1", x_mm=1.0, y_mm=2.0)
    assert (answer.status_code, answer.json()["error"]) == (
        409,
        "This rig has no axes x and y: leave the place out.",
    )
    assert (
        'name="x_mm"' not in browser.client.get(f"{browser.client.base_url.copy_with(path='/station')}").text
    )
    text = at.place.rig.read_text(encoding="utf-8")
    axis = 'driver = "zaber"\nport = "sim://zaber?bench=${here}/bench.toml"\n'
    at.place.rig.write_text(f"{text}\n[x]\n{axis}[y]\n{axis}", encoding="utf-8")
    tasks = []
    try:
        with monkeypatch.context() as patch:
            patch.setattr(at, "_worker", SimpleNamespace(run=lambda task, *_: tasks.append(task)))
            for wrong in (
                {"x_mm": 1.0},
                {"y_mm": 1.0},
                {"x_mm": "1e999", "y_mm": 1.0},
                {"x_mm": "a", "y_mm": 1.0},
            ):
                assert browser.post("/start", recipe="plate", serial="P-1", **wrong).status_code in {409, 422}
            assert (
                'name="x_mm"'
                in browser.client.get(f"{browser.client.base_url.copy_with(path='/station')}").text
            )
            assert (
                browser.post("/start", recipe="plate", serial="P-1", x_mm="-1.5", y_mm=2.0).status_code == 200
            )
            at._busy.join()
    finally:
        at.place.rig.write_text(text, encoding="utf-8")
    (task,) = tasks
    assert task.particulars.place_mm == (-1.5, 2.0)
    assert at._trail.lines()[-1]["more"]["place_mm"] == "-1.5, 2"


def test_no_name_leads_out_of_the_folders(browser, address):
    for name in ("../recipe", "/etc/passwd", "plate.toml", "..\\recipe"):
        assert browser.post("/start", recipe=name, serial="A-9").status_code == 404
    for path in ("..%2f..%2fetc", "%2e%2e", "nothing"):
        assert browser.client.get(f"{address}/inspections/{path}/report.html").status_code == 404


def test_who_did_what_is_in_the_trail(browser, at):
    begin(browser, "A-5")
    browser.post("/stop")
    at._busy.join()
    assert browser.post("/check", name="plate").status_code == 200
    at._busy.join()
    whats = [line["what"] for line in at._trail.lines()]
    assert {"inspect", "check", "stop", "holds the rig"} <= set(whats)
    assert at._trail.damaged() == []


def test_an_event_that_is_gone_is_followed_by_the_state(monkeypatch):
    log = EventLog()
    for number in range(6000):
        log.add("progress", {"number": number})
    assert log.after(10) is None
    assert [number for number, _, _ in log.after(5998)] == [5999, 6000]
    assert log.after(6001) is None


def test_a_stream_wakes_when_a_thread_adds():
    log = EventLog()

    async def follow():
        stream = log.stream("", lambda: (log.number, {}))
        assert "event: state" in await anext(stream)
        adding = threading.Thread(target=log.add, args=("progress", {"done": 1}))
        adding.start()
        found = await anext(stream)
        adding.join()
        await stream.aclose()
        return found

    assert '"done": 1' in asyncio.run(follow())
    assert log._waiting == set()


def test_streams_end_with_the_server():
    log = EventLog()

    async def follow():
        stream = log.stream("", lambda: (log.number, {}))
        await anext(stream)
        threading.Timer(0.0, log.close).start()
        return [text async for text in stream]

    assert asyncio.run(follow()) == []
    assert log._waiting == set()


def test_the_holder_who_closed_the_page_makes_room(at):
    first, second = Session("a", "t", "anna"), Session("b", "t", "bo")
    at.take(first)
    at.take(second)
    assert at.state()[1]["holder"]["name"] == "bo"
    at.release(second)
    assert Start(recipe="plate", serial="A").lot is None


def test_the_client_of_the_docs_inspects_a_part(address, capsys):
    client = runpy.run_path(str(Path(__file__).parents[3] / "docs/examples/console/client.py"))
    client["main"](address, "plate", "C-1")
    assert capsys.readouterr().out.splitlines()[-1] == "PASS"


def test_a_rig_that_was_never_commissioned_is_a_question_on_the_page(station_at, served, app_of):
    for name, changes, asked in (("untaught", {"rig": {"calibration": None}}, True), ("taught", {}, False)):
        with served(app_of(station_at(name, **changes)[0])) as address:
            page = httpx.get(
                f"{address}/station", headers={"Accept": "text/html"}, follow_redirects=True
            ).text
        assert ('data-question="this rig was never commissioned; stage home and turn' in page) == asked
        assert "Check the rig (it moves)" in page
