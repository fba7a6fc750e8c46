import base64
import contextlib
import itertools
import json
import os
import select
import subprocess
import sys
import time
from html.parser import HTMLParser

import numpy as np
import pytest

from anisoscope.profiles.heightmap import HeightMap
from anisoscope.record.schema import Record, upgraded
from anisoscope.report.inspection_page import Pictures

# Chromium wants its pipes as descriptors 3 and 4. They may have any number here, also 3 and 4 themselves.
BECOME = """
import fcntl, os, sys
given = [int(word) for word in sys.argv[1:3]]
aside = [fcntl.fcntl(one, fcntl.F_DUPFD_CLOEXEC, 20) for one in given]
for one in given:
    os.close(one)
os.dup2(aside[0], 3)
os.dup2(aside[1], 4)
os.execv(sys.argv[3], sys.argv[3:])
"""
SILENT_S = 180.0
DRAWN = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 30))))"


class Page:
    """A page in headless Chromium, driven over the DevTools pipe (file descriptors 3 and 4, NUL between messages)."""

    def __init__(self, executable, profile, *options):
        to_browser_read, self._to_browser = os.pipe()
        self._from_browser, from_browser_write = os.pipe()

        pipes = (to_browser_read, from_browser_write)
        command = [sys.executable, "-ISc", BECOME, *map(str, pipes)]
        command += [executable, "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe"]
        command += ["--disable-dev-shm-usage"]  # in a container there may be little of it
        command += ["--enable-unsafe-swiftshader"]  # WebGL without a graphics card
        command += [
            f"--user-data-dir={profile}",
            "--no-first-run",
            "--disable-background-networking",
            *options,
            "about:blank",
        ]
        self._process = subprocess.Popen(
            command,
            pass_fds=pipes,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_browser_read)
        os.close(from_browser_write)
        self._ids = itertools.count(1)
        self._rest = b""
        self._session = self._page = None
        self.events = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        # frames without an origin run in processes of their own, and are watched as well
        self.call("Target.setAutoAttach", autoAttach=True, waitForDebuggerOnStart=True, flatten=True)

    def _read(self):
        while b"\0" not in self._rest:
            heard = select.select([self._from_browser], [], [], SILENT_S)[0]
            assert heard, f"chromium has said nothing for {SILENT_S:g} s"
            chunk = os.read(self._from_browser, 1 << 20)
            if not chunk:
                raise ConnectionError("chromium ended")
            self._rest += chunk
        message, self._rest = self._rest.split(b"\0", 1)
        message = json.loads(message)
        if message.get("method") == "Target.attachedToTarget" and self._session:
            self._watch(message["params"]["sessionId"])
        return message

    def _watch(self, session):
        for method in ("Runtime.enable", "Log.enable", "Network.enable", "Runtime.runIfWaitingForDebugger"):
            self._send(session, method, {})

    def _send(self, session, method, parameters):
        message = {"id": next(self._ids), "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        os.write(self._to_browser, json.dumps(message).encode() + b"\0")
        return message["id"]

    def call(self, method, **parameters):
        number = self._send(self._session, method, parameters)
        while True:
            answer = self._read()
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(answer["error"])
                return answer["result"]
            self.events.append(answer)

    def open(self, url, width=1100, height=1400):
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        page = url.partition("#")[0]
        if page == self._page:  # to another place in the same page nothing would be loaded
            self._load("about:blank")
        self._page = page
        self._load(url)
        self.evaluate(DRAWN)

    def leave(self):
        """Go to an empty page."""
        if self._page is not None:
            self._page = None
            self._load("about:blank")

    def _load(self, url):
        self.events.clear()
        self.call("Page.navigate", url=url)
        deadline = time.monotonic() + 180
        while not any(event.get("method") == "Page.loadEventFired" for event in self.events):
            assert time.monotonic() < deadline, "the page did not load"
            self.events.append(self._read())

    def screenshot(self, selector):
        """PNG of an element, as it stands in the page."""
        box = self.evaluate(
            f"(r => [r.x + scrollX, r.y + scrollY, r.width, r.height])"
            f"(document.querySelector('{selector}').getBoundingClientRect())"
        )
        clip = dict(zip(("x", "y", "width", "height"), box, strict=True)) | {"scale": 1}
        return base64.b64decode(self.call("Page.captureScreenshot", format="png", clip=clip)["data"])

    def drag(self, start, steps):
        """Press the left button at ``start`` = (x, y) of the window, move by each of ``steps``, and let go."""
        x, y = start
        mouse = {"button": "left", "clickCount": 1}
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        self.call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, buttons=1, **mouse)
        for dx, dy in steps:
            x, y = x + dx, y + dy
            self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, buttons=1, **mouse)
        self.call("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, buttons=0, **mouse)

    def prefer(self, scheme, media=""):
        """Light or dark, screen or print; "" for what the browser would do."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.call("Emulation.setEmulatedMedia", media=media, features=features)

    def evaluate(self, expression):
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def complaints(self):
        """Console messages, exceptions and log entries (blocked loads among them) since the page was opened.

        The driver's remark that a screenshot of WebGL is slow is left out: it comes late, also into the next page.
        """
        found = []
        for event in self.events:
            match event.get("method"):
                case "Runtime.consoleAPICalled" | "Runtime.exceptionThrown":
                    found.append(event["params"])
                case "Log.entryAdded":
                    found.append(event["params"]["entry"]["text"])
        return [one for one in found if "ReadPixels" not in str(one)]

    def requests(self):
        """Addresses asked for since the page was opened, data URIs left out."""
        asked = [
            e["params"]["request"]["url"]
            for e in self.events
            if e.get("method") == "Network.requestWillBeSent"
        ]
        return [url for url in asked if not url.startswith(("data:", "about:srcdoc"))]

    def close(self):
        self._process.kill()
        self._process.wait()
        os.close(self._to_browser)
        os.close(self._from_browser)


@contextlib.contextmanager
def browser(program, profile, *options):
    found = Page(program, profile, *options)
    yield found
    found.close()


@pytest.fixture(scope="session")
def only_page(chromium_program, tmp_path_factory):
    with browser(chromium_program, tmp_path_factory.mktemp("chromium")) as found:
        yield found


@pytest.fixture
def page(only_page):
    """The page of the one browser of a worker; between tests it is empty, as a scene would be drawn on and on."""
    yield only_page
    only_page.leave()


@pytest.fixture
def flat_page(chromium_program, tmp_path):
    """A browser that has no WebGL."""
    with browser(chromium_program, tmp_path / "profile", "--disable-3d-apis") as found:
        yield found


def contrast(from_deg, to_deg, measured, predicted, **changes):
    return {
        "from_deg": from_deg,
        "to_deg": to_deg,
        "tilt_deg": 0.0,
        "kind": "log_ratio",
        "measured": measured,
        "predicted": predicted,
        "u": 0.0507,
        "tolerance": 0.25,
        "guard": 0.0834,
        "conformance_probability": 0.527,
        "verdict": "PASS",
        "p_value": 0.02,
        "tolerance_ratio": 2.46,
    } | changes


def pose(stage_deg, measured, predicted):
    marks = {"marker_angle_deg": stage_deg + 0.01, "pixel_um": 4.0, "residual_px": 0.02, "markers": 4}
    return {"stage_deg": stage_deg, "tilt_deg": 0.0, "measured": measured, "predicted": predicted} | marks


def cause(name, title, unit, severity, u, **changes):
    base = {"cause": name, "title": title, "unit": unit, "severity": severity, "u": u, "weight": 0.6}
    return base | {"chi2": 1.5, "at_bound": False, "tie": True} | changes


def region(number):
    place = {"x": 0.2 * number - 0.4, "y": 0.1 * number, "width": 0.05, "length": 0.12}
    return place | {"area_share": 0.002, "cells": 3, "kind": "scratch", "deviation": -0.6, "p_value": 3e-5}


RECORD = {
    "software": "anisoscope 1.2.3",
    "created_at": "2026-03-04T05:06:07+00:00",
    "serial": "A-17",
    "particulars": {"operator": "M. Okafor", "lot": "L7", "cavity": "3", "station": "Line 2"},
    "product": "ridged plate",
    "verdict": "FAIL",
    "reasons": ["ln ratio 0°/90° deviates by +0.4"],
    "model": "relief",
    "convention": {
        "light_angle_deg": 10.0,
        "tilt_plane": "perpendicular",
        "facet_azimuth_deg": 0.0,
        "rotation_sense": "ccw",
    },
    "poses": [pose(0.0, 0.41, 0.26), pose(90.0, 0.038, 0.031), pose(180.0, 0.0307, 0.0276)],
    "contrasts": [
        contrast(0.0, 90.0, 2.538, 2.135, verdict="FAIL"),
        contrast(90.0, 180.0, 0.227, 0.122, u=0.0217),
    ],
    "d2": 62.6,
    "dof": 2,
    "p_value": 2.5e-14,
    "area": {"share": 0.0123, "u": 0.0006, "max_share": 0.03, "cells": 6400, "verdict": "PASS"},
    "budget": [
        {"source": "roughness along the ridges", "kind": "prediction", "contributions": [0.04, 0.0074]},
        {"source": "stray light", "kind": "measurement", "contributions": [0.0311, 0.0204]},
        {"source": "registration", "kind": "measurement", "contributions": [0.0001, 0.00001]},
    ],
    "drift": -0.0021,
    "conformance_probability": 0.527,
    "regions": [region(number) for number in range(4)],
    "diagnosis": {
        "says": "ridge angle, off by; cannot be distinguished from: the part lies tilted about y",
        "causes": [
            cause("ridge-angle", "ridge angle, off by", "°", -2.048, 0.2, interval=(-2.44, -1.65)),
            cause(
                "seating-y",
                "the part lies tilted about y",
                "°",
                -2.083,
                None,
                interval=(None, None),
                weight=0.3,
            ),
        ],
        "unexplained_p": 0.4,
    },
    "conclusion": {
        "finding": "Ridges are about 2.0° flatter than designed (8.0° ± 0.4°).",
        "action": "Seat it again once; if it fails again, reject.",
        "follows_from": "ridge-angle",
    },
    "comparisons": [
        {"surface": name, "decides": name == "design", "model": "relief", "predicted": [0.3, 0.03, 0.02]}
        | {"d2": d2, "dof": 2, "p_value": p, "agrees": p > 0.01}
        for name, d2, p in (("design", 62.6, 2.5e-14), ("height_map", 1.2, 0.55))
    ],
    "reading": "it agrees with the height map and not with the design: a shape defect",
    "shape": {
        "estimates": [
            {
                "name": "ridge_angle",
                "title": "ridge angle",
                "unit": "°",
                "value": 8.9,
                "u": 0.2,
                "at_bound": False,
            },
            {"name": "k", "title": "scale", "unit": "", "value": None, "u": None, "at_bound": False},
        ],
        "held": [],
        "chi2": 3.1,
        "dof": 4,
        "p_value": 0.54,
        "advice": "a tilt of 20°",
    },
    "golden": {
        "parts": 4,
        "mean": [-2.1, -2.2],
        "contrasts": [[-2.1, -2.2], [-2.0, -2.3], [-2.2, -2.1], [-2.1, -2.2]],
        "measured": [-2.538, -2.765],
    },
    "rounds": 2,
    "notes": ["the lamp was replaced"],
    "white_reference": {
        "taken_at": "2026-03-01T00:00:00+00:00",
        "reflectance": 0.99,
        "camera": "C1",
        "sha256": "b6" * 32,
    },
    "recipe": {
        "version": 3,
        "decision": {"alpha": 0.001, "deviation": "warn", "coverage": 1.645},
        "acquisition": {"exposure_s": 0.006, "gain": 1.0, "frames_per_pose": 4},
        "area": {"max_share": 0.02},
        "region": {"center_mm": [0.0, 0.0]},
        "poses": {"facet_azimuth_deg": 0.0},
    },
    "rig": {
        "name": "rig 4",
        "camera": {"pixel_um": 4.0},
        "light": {"driver": "manual", "angle_deg": 10.0},
    },
    "camera": "camera C1",
    "stage": "ELL14 1140",
    "inputs": [
        {"name": "inputs/recipe.toml", "sha256": "f5" * 32},
        {"name": "inputs/rig.toml", "sha256": "21" * 32},
    ],
    "frames": [
        {"name": "frames/000_dark.tif", "sha256": "79" * 32, "kind": "dark", "stage_deg": 0.0}
        | {"commanded_deg": 0.0, "exposure_s": 0.006, "gain": 1.0, "captured_at": "2026-03-04T05:06:00+00:00"}
    ],
}


@pytest.fixture(scope="session")
def make_report_record():
    """``make_report_record(verdict="PASS")`` gives a record with everything in it, and changes."""
    return lambda **changes: Record.model_validate(upgraded(RECORD | changes))


@pytest.fixture(scope="session")
def report_pictures():
    rng = np.random.default_rng(3)
    rows, cols = 24, 32
    height = np.tile((np.arange(300) % 100) * 0.17, (200, 1)) + 0.02 * rng.standard_normal((200, 300))
    return Pictures(
        aligned=tuple((level * rng.random((120, 160))).astype(np.float32) for level in (0.8, 0.08, 0.06)),
        size_mm=(0.6, 0.8),
        predicted=np.broadcast_to(np.array([0.26, 0.031, 0.028])[:, None, None], (3, rows, cols)),
        predicted_text="the mean",
        differences=np.stack([level + 0.1 * rng.random((rows, cols)) for level in (0.58, 0.23, 0.11)]),
        difference_text="averaged",
        ratios=2.0 + 0.1 * rng.standard_normal((2, rows, cols)),
        deviating=rng.random((rows, cols)) < 0.05,
        deviation=0.1 * rng.standard_normal((rows, cols)),
        surface=HeightMap(height, 2.0, 2.0),
    )


class Elements(HTMLParser):
    """All elements of a page with their attributes, its text, and what of it is read: neither style nor script."""

    def __init__(self, text):
        super().__init__()
        self.found, self.text, self.words = [], "", ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text += data
        self.words += "" if self.cdata_elem else data


@pytest.fixture(scope="session")
def parsed():
    """``parsed(path)``: elements and text of a page on disk."""
    return lambda path: Elements(path.read_text(encoding="utf-8"))
