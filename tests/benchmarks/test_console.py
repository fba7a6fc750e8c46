"""The console as it is started: cold start, size of the station page, live picture, Stop, and fifty browsers.

All on the demo's virtual rig in processes of their own. Where others use the machine, processor times say more than
those of the clock; both are noted.
"""

import contextlib
import re
import statistics
import subprocess
import sys
import threading
import time
from dataclasses import dataclass

import cv2
import httpx
import numpy as np
import psutil
import pytest

from anisoscope.operations.demo.ridges import SCENE

pytestmark = pytest.mark.benchmark
COLD_START_S, STOP_S, PAGE_BYTES, FRAMES_PER_S, BROWSERS = 2.0, 0.2, 200_000, 10.0, 50
PARTS, STOPS, RESTING_S = 5, 5, 20.0


@dataclass
class Console:
    """A console that was started, its address and its processes."""

    address: str
    server: psutil.Process
    client: httpx.Client

    def processor_s(self):
        """Processor time of the server alone, and of the process of its inspections."""
        own = self.server.cpu_times()
        others = [one.cpu_times() for one in self.server.children(recursive=True)]
        return own.user + own.system, sum(one.user + one.system for one in others)

    def post(self, path, **content):
        answer = self.client.post(f"/api/v1/{path}", json=content)
        assert answer.status_code == 200, answer.text

    def wait(self, *states):
        """The state, once it is one of some."""
        while (state := self.client.get("/api/v1/status").json())["state"] not in states:
            time.sleep(0.01)
        return state

    def inspect(self, serial):
        """Seconds from the start of an inspection to its verdict."""
        started = time.monotonic()
        self.post("start", recipe="recipe", serial=serial)
        state = self.wait("done", "failed")
        assert state["failure"] is None, state["failure"]
        assert state["verdict"]["verdict"] == "PASS"
        return time.monotonic() - started


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    return SCENE.lay_out(tmp_path_factory.mktemp("console") / "demo", 1, lambda *_: None)


@contextlib.contextmanager
def started(rig):
    """A console, and the seconds from its start to its first page, on the clock and of the processor."""
    places = {"--rig": rig / "bench" / "good" / "rig.toml", "--recipes": rig, "--out": rig / "inspections"}
    command = [sys.executable, "-Im", "anisoscope", "serve", "--port", "0"]
    began = time.monotonic()
    with subprocess.Popen(
        [*command, *(str(one) for pair in places.items() for one in pair)], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            address = process.stdout.readline().split()[-1].rstrip("/")
            with httpx.Client(base_url=address, timeout=120) as client:
                assert client.get("/station").status_code == 200
                took = time.monotonic() - began
                console = Console(address, psutil.Process(process.pid), client)
                client.headers["X-CSRF-Token"] = client.get("/api/v1/session").json()["token"]
                yield console, took
        finally:
            process.terminate()


@pytest.fixture(scope="module")
def console(rig):
    with started(rig) as (found, _):
        found.inspect("first")  # has everything loaded
        yield found


def test_cold_start(bench, rig):
    spans, processor = [], []
    for _ in range(3):
        with started(rig) as (console, took):
            spans.append(took)
            processor.append(console.processor_s()[0])
    bench.note(f"`serve` to its first page: {min(spans):.2f} s at best, processor {min(processor):.2f} s")
    assert min(processor) <= COLD_START_S


def test_the_station_page(bench, console):
    page = console.client.get("/station").content
    files = ("console.css", "console.js", "picture.js", "station.js", "guide.js", "icon.svg")
    size = len(page) + sum(len(console.client.get(f"/static/{name}").content) for name in files)
    bench.note(f"station page with scripts and style: {size / 1000:.1f} kB")
    assert size <= PAGE_BYTES


def test_the_live_picture(bench, console):
    def look():
        answer = console.client.get("/api/v1/live.jpg?recipe=recipe")
        assert answer.status_code == 200
        return answer.content

    rows, cols = cv2.imdecode(np.frombuffer(look(), np.uint8), cv2.IMREAD_COLOR).shape[:2]
    began, (before, _) = time.monotonic(), console.processor_s()
    for _ in range(40):
        look()
    took, busy = time.monotonic() - began, console.processor_s()[0] - before
    bench.note(
        f"live picture, JPEG of {cols} × {rows}: {40 / took:.1f} frames/s, processor {1e3 * busy / 40:.0f} ms a frame "
        "with that of the simulated camera"
    )
    assert busy / 40 <= 1.0 / FRAMES_PER_S


def test_stop(bench, console):
    spans = []
    for number in range(STOPS):
        console.post("start", recipe="recipe", serial=f"stopped-{number}")
        console.wait("running")
        while not console.client.get("/api/v1/status").json()["frames"]:
            time.sleep(0.005)
        began = time.monotonic()
        console.post("stop")
        spans.append(time.monotonic() - began)
        console.wait("failed", "done")
    median, least = 1e3 * statistics.median(spans), 1e3 * min(spans)
    bench.note(f"Stop while a part is inspected: median {median:.0f} ms, least {least:.0f} ms")
    assert min(spans) <= STOP_S


def test_fifty_browsers_on_the_fleet_page(bench, console):
    over = threading.Event()

    def browser(known):
        """Looks as the page does, and follows the events of the station besides."""
        with httpx.Client(base_url=console.address, timeout=120) as client:
            mark = re.search('data-mark="&#34;(.*?)&#34;"', client.get("/fleet").text)[1]
            known.release()
            with client.stream("GET", "/api/v1/events"):
                while not over.wait(5.0):
                    answer = client.get("/fleet/view", headers={"If-None-Match": f'"{mark}"'})
                    mark = answer.headers["etag"].strip('"')

    @contextlib.contextmanager
    def browsers():
        known = threading.Semaphore(0)
        threads = [threading.Thread(target=browser, args=(known,)) for _ in range(BROWSERS)]
        over.clear()
        for thread in threads:
            thread.start()
        for _ in threads:
            known.acquire()
        yield
        over.set()
        for thread in threads:
            thread.join()

    spent = []
    for look in (contextlib.nullcontext, browsers):
        with look():
            before = console.processor_s()[0]
            time.sleep(RESTING_S)
            spent.append(console.processor_s()[0] - before)
    each = 1e3 * (spent[1] - spent[0]) / BROWSERS * 60.0 / RESTING_S
    bench.note(f"a browser costs the server {each:.0f} ms of processor a minute while nothing is inspected")
    alone, together, own = [], [], []
    for part in range(PARTS):
        alone.append(console.inspect(f"alone-{part}"))
        with browsers():
            before = console.processor_s()[0]
            together.append(console.inspect(f"together-{part}"))
            own.append(console.processor_s()[0] - before)
    first, second, busy = (statistics.median(one) for one in (alone, together, own))
    share = second / first - 1.0
    bench.note(f"an inspection alone {first:.2f} s, with {BROWSERS} browsers {second:.2f} s ({share:+.1%})")
    bench.note(
        f"the browsers run on the same processors; the server took {busy:.2f} s of processor meanwhile"
    )
