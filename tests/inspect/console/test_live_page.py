"""The live picture alone, as `anisoscope rig live --web` serves it: by a client and in a browser."""

import json
import re

import httpx
import numpy as np
import pytest

from anisoscope.base.clock import VirtualClock
from anisoscope.console.access import Access
from anisoscope.console.application import Page, create_app, permissions_of
from anisoscope.console.live import Eyes, Live
from anisoscope.console.routes import live_router
from anisoscope.console.trail import Trail
from anisoscope.live_view.lamps import Lamp
from anisoscope.rig.camera import CameraInfo
from anisoscope.rig.jogging import Step
from anisoscope.rig.light import Channel, ChannelLight

INFO = CameraInfo("test", "1", rows=360, cols=480, bit_depth=12, black_level=64.0)


class Ridges:
    """A camera below which ridges turn by 5° from frame to frame; a corner is saturated."""

    info = INFO

    def __init__(self):
        self.frames = 0

    def grab(self, exposure_s, gain):
        rows, cols = np.indices((INFO.rows, INFO.cols))
        angle = np.radians(5.0 * self.frames)
        wave = np.cos(2.0 * np.pi * (cols * np.cos(angle) - rows * np.sin(angle)) / 17.0)
        counts = 64 + 1500 + 900 * wave
        counts[:40, -60:] = 4095
        self.frames += 1
        return counts.astype(np.uint16)


class RigLights:
    """What reads four lamps, of which one is grey; and how often it was to forget."""

    def __init__(self):
        self.forgot = 0

    def read(self, counts, info, taken, now_s, channel=None):
        return (
            Lamp("lamp level", "green", 99.84, "%"),
            Lamp("stray light", "grey", why="not taught (anisoscope calibrate fixture)"),
            Lamp("focus", "yellow", 9.32, "µm"),
            Lamp("angle", "red", why="the markers are not seen"),
        )

    def forget(self):
        self.forgot += 1


class Keys:
    """What takes the commands of a page."""

    def __init__(self):
        self.axes = {"stage": None, "z": None}
        self.taken = []

    def do(self, command):
        self.taken.append(command)

    def stop(self):
        self.taken.append("stop")

    def state(self):
        return f"stage 12°; ± 1° ({len(self.taken)})"


def app_with(keys):
    router = live_router(Live(Eyes(Ridges(), None, lamps=RigLights), gap_s=0.0), 0.003, 1.0, keys, "rig <2>")
    pages = [Page("/station", "Picture")]
    return lambda hosts: create_app(Access(None, Trail(None)), [router], hosts, pages=pages)


@pytest.fixture(scope="module")
def keys():
    return Keys()


@pytest.fixture(scope="module")
def address(served, keys):
    with served(app_with(keys)) as found:
        yield found


@pytest.fixture
def client(address):
    with httpx.Client(base_url=address) as found:
        found.headers["X-CSRF-Token"] = re.search(
            'name="token" content="([^"]+)', found.get("/station").text
        )[1]
        yield found


def test_every_picture_has_its_numbers(client):
    answer = client.get("/api/v1/live.jpg")
    numbers = json.loads(answer.headers["X-Numbers"])
    assert answer.content[:2] == b"\xff\xd8"
    assert numbers["saturated_share"] == pytest.approx(40 * 60 / (360 * 480))
    assert sum(numbers["histogram"]) == pytest.approx(1.0)
    assert numbers["advice"] == ["too bright: shorten the exposure"]
    later = json.loads(client.get("/api/v1/live.jpg").headers["X-Numbers"])
    assert (later["ridge_deg"] - numbers["ridge_deg"]) % 180 == pytest.approx(5.0, abs=0.5)
    assert later["frame"] == numbers["frame"] + 1


def test_the_lamps_of_the_rig_have_colours_and_words(client):
    lamps = json.loads(client.get("/api/v1/live.jpg").headers["X-Numbers"])["lamps"]
    assert [(one["colour"], one["words"]) for one in lamps] == [
        ("green", "lamp level: good, 99.8 %"),
        ("grey", "stray light: not taught (anisoscope calibrate fixture)"),
        ("yellow", "focus: look at it, 9.3 µm"),
        ("red", "angle: not good, the markers are not seen"),
    ]


def test_another_exposure_and_work_at_the_rig_begin_the_lamps_anew():
    lamps = RigLights()
    live = Live(Eyes(Ridges(), None, lamps=lambda: lamps), VirtualClock(), gap_s=0.0)
    for exposure_s in (0.003, 0.003, 0.004):
        live.look(exposure_s, 1.0)
    assert lamps.forgot == 1
    live.pause()
    live.go_on()
    assert lamps.forgot == 2


def test_axes_are_moved_by_the_page_alone(client, keys):
    keys.taken.clear()
    for asked in ({"axis": "stage", "sign": -1}, {"axis": "z"}, {"size": "finer"}):
        assert client.post("/api/v1/jog", json=asked).status_code == 200
    assert client.post("/api/v1/stop", json={}).json() == {}
    assert keys.taken == [Step("stage", -1), Step("z", 1), "finer", "stop"]
    for asked in ({"axis": "stage", "sign": 40}, {"size": "huge"}, {"axis": "x" * 99}, {"by": 1}):
        assert client.post("/api/v1/jog", json=asked).status_code == 422
    elsewhere = {"Origin": "http://evil.example"}
    assert client.post("/api/v1/jog", json={"axis": "z"}, headers=elsewhere).status_code == 403
    del client.headers["X-CSRF-Token"]
    assert client.post("/api/v1/jog", json={"axis": "z"}).status_code == 403
    assert len(keys.taken) == 4


def test_without_axes_the_page_shows_and_moves_nothing(keys):
    routes = {
        path: needs.permission
        for (_, path), needs in permissions_of(app_with(keys)(frozenset())).items()
        if needs
    }
    assert (routes["/api/v1/jog"], routes["/api/v1/stop"]) == ("operate", "stop")
    assert not {path for _, path in permissions_of(app_with(None)(frozenset()))} & {
        "/api/v1/jog",
        "/api/v1/stop",
    }


class Lamps:
    """Three lamps, and what shone when a picture was wanted."""

    lamps = ("red", "green", "blue")

    def __init__(self):
        self.selected, self.shone = {}, []

    def select(self, levels_percent):
        self.selected = dict(levels_percent)

    def on(self):
        self.shone.append(self.selected)

    def off(self):
        self.shone.append(None)

    def close(self):
        pass


def test_the_picture_is_lit_by_the_channel_of_the_recipe_else_by_the_usual_one():
    lamps = Lamps()
    light = ChannelLight(lamps, None, {name: Channel({name: 50}) for name in lamps.lamps})
    live = Live(Eyes(Ridges(), light, "green"), VirtualClock(), gap_s=0.0)
    for channel in ("red", "red", None, "blue"):
        live.look(0.003, 1.0, channel)
    live.pause()
    assert lamps.shone == [{"red": 50}, None, {"green": 50}, None, {"blue": 50}, None]


@pytest.fixture
def page(opened_page, address):
    with opened_page(address) as found:
        yield found


@pytest.mark.browser
def test_the_picture_moves_and_the_numbers_follow(page):
    page.locator("#ridges").get_by_text(re.compile("°")).wait_for()
    assert page.locator("h1").inner_text() == "rig <2>"
    assert page.locator("#saturated").inner_text() == "1.39 %"
    assert page.locator("#lamps li.yellow").inner_text().strip() == "focus: look at it, 9.3 µm"
    assert page.locator("#lamps li").count() == 4
    first = page.evaluate("document.images[0].src")
    page.wait_for_function(
        "first => document.images[0].src !== first && document.images[0].naturalWidth === 480", arg=first
    )
    bars = page.evaluate("[...document.querySelectorAll('#histogram div')].map(e => e.offsetHeight)")
    assert (len(bars), max(bars) > 40) == (32, True)
    for width in (390, 1100):
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")


@pytest.mark.browser
def test_keys_and_buttons_step_the_axes_and_space_stops(page, keys):
    page.locator("#axes").get_by_text("stage 12°").wait_for()
    keys.taken.clear()
    for act in (
        lambda: page.keyboard.press("ArrowLeft"),
        lambda: page.get_by_role("button", name="z +").click(),
        lambda: page.keyboard.press("+"),
        lambda: page.keyboard.press("Space"),
        lambda: page.get_by_role("button", name="STOP").click(),
        lambda: page.evaluate("dispatchEvent(new Event('blur'))"),
    ):
        with page.expect_response(re.compile("/(jog|stop)$")):
            act()
    assert keys.taken == [Step("stage", -1), Step("z", 1), "coarser", "stop", "stop", "stop"]


@pytest.mark.browser
def test_the_page_says_when_the_command_has_ended(chromium, served):
    found = chromium.new_page()
    with served(app_with(None)) as address:
        found.goto(address)
        found.locator("#ridges").get_by_text(re.compile("°")).wait_for()
        assert not found.locator("#stop").count()
    found.get_by_text("The live picture has ended.").wait_for()
    found.close()
