"""The page of a plate in a browser: pixels of fields as the engine has them, keys, and what a screen reader gets."""

import json
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from anisoscope.base.errors import UsageError
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.plates import Plan
from anisoscope.report.plate_page import write_plate_page
from anisoscope.sim.light import corrected

PLAN = Plan(
    ("ABCDD", ".ABCA", "DDABB", "CAAAA"),
    {"A": 0.0, "B": -90.0, "C": 131.0, "D": -45.0},
    0.1,
    {"B": 5.0, "C": 14.0, "D": 7.3},
)
DESIGN = RidgeDesign(50.0, 10.0, 10.0, edge_radius_um=1.0)
PLASTIC = Material(0.06, 0.1, 0.2)


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    path = tmp_path_factory.mktemp("plate") / "appearance.html"
    write_plate_page(path, "<four> classes", PLAN, DESIGN, PLASTIC, 10.0, (0.0, 90.0), (0.02, 0.2))
    return path


def wait(page, condition):
    deadline = time.monotonic() + 120.0
    while not page.evaluate(condition):
        assert time.monotonic() < deadline, condition
        time.sleep(0.02)


def ready(page, url, width=1300):
    page.open(url, width, 1000)
    wait(page, "document.body.dataset.ready === 'yes'")


def turned(case):
    """From the frame of the plate to that of the picture."""
    return Rotation.from_euler("zx", [case["stage"], case["tilt"]], degrees=True)


def engine(case, letter):
    """Radiance of a class by the reflectance model."""
    lift, around = np.radians([case["elevation"], case["azimuth"]])
    light = [np.cos(lift) * np.cos(around), np.cos(lift) * np.sin(around), np.sin(lift)]
    into = Rotation.from_euler("z", -PLAN.azimuths_deg[letter], degrees=True) * turned(case).inv()
    ridges = PLAN.design_of(letter, DESIGN)
    value = corrected.radiance(into.apply([light]), into.apply([[0.0, 0.0, 1.0]]), ridges, PLASTIC)[0]
    border = 0.5 * ridges.height_um * np.tan(np.radians(10.0)) / 100.0
    return float(value) * (1.0 - 2.0 * border) ** 2


@pytest.mark.browser
def test_pixels_of_fields_are_those_of_the_engine_within_a_percent(page, plate):
    ready(page, plate.as_uri() + "#selftest")
    found = json.loads(page.evaluate("document.getElementById('selftest').textContent"))
    size, rows, cols = found["size"], *PLAN.shape
    scale = 0.94 * size / np.hypot(rows, cols)
    seen = 0
    for case in found["cases"]:
        pixels = np.array(case["pixels"]).reshape(size, size)
        for row in range(rows):
            for col in range(cols):
                place = turned(case).apply([col + 0.5 - 0.5 * cols, 0.5 * rows - row - 0.5, 0.0])
                x, y = 0.5 * size + scale * place[0], 0.5 * size - scale * place[1]
                value, letter = pixels[int(y), int(x)], PLAN.rows[row][col]
                due = 0.0 if letter == "." else engine(case, letter)
                assert value == pytest.approx(due, rel=0.01, abs=1e-5), (case["stage"], row, col)
                seen += due > 0.01
        assert pixels[0, 0] == -1.0
    assert seen > 50
    assert page.complaints() == []
    assert page.requests() == [plate.as_uri()]


@pytest.mark.browser
def test_keys_turn_the_part_and_the_line_says_what_is_seen(page, plate):
    ready(page, plate.as_uri())
    wait(page, "document.getElementById('said').textContent.includes('Row 1, column 1: class A')")
    assert page.evaluate("document.getElementById('said').getAttribute('aria-live')") == "polite"
    page.evaluate("document.getElementById('plate').focus()")
    for key in ("ArrowLeft", "ArrowLeft", "ArrowDown", "+"):
        page.call("Input.dispatchKeyEvent", type="keyDown", key=key)
        page.call("Input.dispatchKeyEvent", type="keyUp", key=key)
    value = "document.getElementById('{}').value"
    assert [page.evaluate(value.format(key)) for key in ("stage", "tilt", "zoom")] == ["10", "5", "1.2"]
    page.call("Input.dispatchKeyEvent", type="keyDown", key="ArrowUp", modifiers=8)
    assert page.evaluate(value.format("azimuth")) != "0"
    page.evaluate("document.querySelector('[data-stage=\"90\"]').click()")
    assert [page.evaluate(value.format(key)) for key in ("stage", "tilt", "azimuth")] == ["90", "0", "0"]
    page.evaluate(
        "(e => { e.value = 2; e.dispatchEvent(new Event('input')); })(document.getElementById('row'))"
    )
    wait(page, "document.getElementById('said').textContent.includes('Row 2, column 1: flat')")
    page.evaluate(
        "(e => { e.value = 2; e.dispatchEvent(new Event('input')); })(document.getElementById('col'))"
    )
    wait(page, "document.getElementById('said').textContent.includes('Row 2, column 2: class A')")
    said = page.evaluate("document.getElementById('said').textContent")
    stated = float(said.rpartition(": ")[2].partition(" per sr")[0])
    case = {"stage": 90.0, "tilt": 0.0, "azimuth": 0.0, "elevation": 80.0}
    assert stated == pytest.approx(engine(case, "A"), rel=0.01)


@pytest.mark.browser
def test_a_click_reads_a_field_and_every_control_has_a_label(page, plate):
    ready(page, plate.as_uri())
    x, y, wide, high = page.evaluate(
        "(r => [r.x, r.y, r.width, r.height])(document.getElementById('plate').getBoundingClientRect())"
    )
    scale = 0.94 * min(wide, high) / np.hypot(*PLAN.shape)
    page.drag((x + 0.5 * wide + 2.0 * scale, y + 0.5 * high - 1.5 * scale), [])
    value = "document.getElementById('{}').value"
    assert [page.evaluate(value.format(key)) for key in ("row", "col")] == ["1", "5"]
    page.drag((x + 0.5 * wide, y + 0.5 * high), [(-25, 0)])
    assert float(page.evaluate(value.format("stage"))) == pytest.approx(10.0)
    labels = page.evaluate(
        "[...document.querySelectorAll('[data-key]')].map(e => e.labels[0]?.innerText.trim())"
    )
    assert len(labels) == 9
    assert all(labels)
    for width in (1300, 420):
        ready(page, plate.as_uri(), width)
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


@pytest.mark.browser
def test_without_webgl_the_page_says_so(flat_page, plate):
    flat_page.open(plate.as_uri())
    assert flat_page.evaluate("document.body.dataset.webgl") == "missing"
    assert not flat_page.evaluate("document.getElementById('missing').hidden")
    still = flat_page.evaluate(
        "(one => [one.naturalWidth, one.complete, one.alt])(document.querySelector('#missing img'))"
    )
    assert still[0] >= 240
    assert still[1:] == [True, "Still picture: a grey for each class of fields"]


def test_the_page_is_escaped_and_refuses_a_lobe_that_it_does_not_know(plate, tmp_path):
    text = plate.read_text(encoding="utf-8")
    assert "&lt;four&gt; classes" in text
    assert "default-src 'none'" in text
    assert "https://" not in text
    with pytest.raises(UsageError, match="Beckmann's lobe only"):
        write_plate_page(
            tmp_path / "x.html", "x", PLAN, DESIGN, Material(tail=1.0), 10.0, (0.0,), (0.02, 0.2)
        )
    assert not (tmp_path / "x.html").exists()
