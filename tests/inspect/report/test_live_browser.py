"""The live page in a browser: it moves, its numbers follow, nothing is asked from outside, nobody complains."""

import threading

import numpy as np
import pytest

from anisoscope.cli.rig.live import numbers
from anisoscope.live_view.page import LivePage
from anisoscope.live_view.picture import as_jpeg, draw
from anisoscope.live_view.view import Meter, look_at
from anisoscope.rig.camera import CameraInfo

pytestmark = pytest.mark.browser

INFO = CameraInfo("test", "1", rows=360, cols=480, bit_depth=12, black_level=64.0)


def turning_ridges(step):
    rows, cols = np.indices((INFO.rows, INFO.cols))
    angle = np.radians(5.0 * step)
    wave = np.cos(2.0 * np.pi * (cols * np.cos(angle) - rows * np.sin(angle)) / 17.0)
    counts = 64 + 1500 + 900 * wave
    counts[:40, -60:] = 4095
    return counts.astype(np.uint16)


@pytest.fixture(scope="module")
def live():
    """A page to which a camera delivers pictures of turning ridges."""
    ended = threading.Event()
    meter = Meter()

    def deliver(page):
        step = 0
        while not ended.wait(0.05):
            counts = turning_ridges(step)
            reading = meter.read(look_at(counts, INFO), step * 0.05)
            page.publish(as_jpeg(draw(counts, INFO, reading.view, reading.relative_focus)), numbers(reading))
            step += 1

    with LivePage(title="rig 2 – live") as found:
        camera = threading.Thread(target=deliver, args=(found,))
        camera.start()
        yield found
        ended.set()
        camera.join()


SHOWN = "Object.fromEntries([...document.querySelectorAll('dd')].map(e => [e.id, e.textContent]))"
PIXELS = """(() => { const i = document.images[0], c = document.createElement('canvas');
  c.width = i.naturalWidth; c.height = i.naturalHeight; const x = c.getContext('2d'); x.drawImage(i, 0, 0);
  return [c.width, c.height, [...x.getImageData(0, 0, c.width, c.height).data].reduce((a, b) => a + b, 0)]; })()"""


def wait_for(page, expression):
    return page.evaluate(
        f"new Promise(done => {{ const look = () => ({expression}) ? done(true) : setTimeout(look, 50); look(); }})"
    )


def test_the_picture_moves_and_the_numbers_follow(page, live):
    page.open(live.address)
    wait_for(
        page, "document.images[0].naturalWidth > 0 && document.getElementById('frame').textContent !== '–'"
    )
    width, height, first = page.evaluate(PIXELS)
    assert (width, height) == (480, 360)
    shown = page.evaluate(SHOWN)
    assert shown["ridges"].endswith("°")
    assert shown["saturated"] == "1.39 %"
    wait_for(page, f"document.getElementById('frame').textContent > {int(shown['frame']) + 3}")
    assert wait_for(page, f"{PIXELS}[2] !== {first}")  # the stream may lag behind the numbers
    bars = page.evaluate("[...document.querySelectorAll('#histogram div')].map(e => e.offsetHeight)")
    assert len(bars) == 32
    assert max(bars) > 100
    assert page.complaints() == []
    assert all(url.startswith(live.address) for url in page.requests())


@pytest.mark.parametrize("width", [390, 1100])
def test_nothing_overflows_sideways(page, live, width):
    page.open(live.address, width=width)
    assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")


def test_the_page_says_when_the_camera_is_gone(page):
    with LivePage() as short:
        page.open(short.address)
        wait_for(page, "document.getElementById('state').textContent.includes('waiting')")
    assert wait_for(page, "document.getElementById('state').textContent.includes('ended')")
