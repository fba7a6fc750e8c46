"""The report of an inspection with everything in it, as a browser shows it."""

import itertools
import json
import time
import zlib
from dataclasses import replace

import numpy as np
import pytest

from anisoscope.diagnosis.cause_words import plastic_words
from anisoscope.record.schema import REPORT_NAME
from anisoscope.report.inspection_page import Pictures, report_page, start_renderer
from anisoscope.report.peers import Lot, LotPart
from anisoscope.report.surface_sections import surface_sections
from anisoscope.report.wording import cause_range

pytestmark = pytest.mark.browser

LOT = Lot("L7", tuple(LotPart(f"B-{n}", "PASS", (2.1 + 0.01 * n, 0.1 + 0.02 * n)) for n in range(5)))
EVIL = (
    "<script>document.title='owned'</script><img src=x onerror=alert(1)>\" onload=\"alert(2)' javascript:alert(3) "
    "{{ 7*7 }} </iframe></style>\u202egnp.exe\u2066"
)


@pytest.fixture(scope="module")
def view(report_pictures):
    renderer = start_renderer(report_pictures.surface)
    return renderer.result()


@pytest.fixture(scope="module")
def report(tmp_path_factory, make_report_record, report_pictures, view):
    """Folder and record of a report with a 3-D view."""
    folder = tmp_path_factory.mktemp("A-17-20260304T050607Z")
    record = make_report_record()
    pictures = replace(report_pictures, lot=LOT)
    page = report_page(record, pictures, folder, view, surface_sections(record, pictures, plastic_words()))
    (folder / REPORT_NAME).write_text(page, encoding="utf-8")
    return folder, record


@pytest.fixture
def shown(page, report):
    page.prefer("light")
    page.open((report[0] / "report.html").as_uri(), height=900)
    yield page
    page.prefer("")


def poll(probe, seconds=180.0):
    """The first true answer of ``probe``, or its last."""
    deadline = time.monotonic() + seconds
    while not (found := probe()) and time.monotonic() < deadline:
        time.sleep(0.1)
    return found


def texts(page, selector):
    return page.evaluate(f"[...document.querySelectorAll('{selector}')].map(e => e.textContent.trim())")


def number(text):
    return float(text.replace("−", "-").split("±")[-1].split("≤")[-1].split()[0].rstrip("°"))


def test_it_is_silent_self_contained_whole_and_small(shown, report):
    address = (report[0] / "report.html").as_uri()
    shown.evaluate("document.querySelector('.relief')?.scrollIntoView()")
    pictures = shown.evaluate("[...document.images].map(i => [i.complete, i.naturalWidth, i.alt])")
    assert len(pictures) >= 10
    assert all(complete and width > 100 and len(alt) > 20 for complete, width, alt in pictures)
    assert shown.complaints() == []
    assert shown.requests() == [address]
    assert (report[0] / "report.html").stat().st_size < 6e6


@pytest.fixture
def relief(shown, view):
    """The 3-D view, drawn and in sight; gives the page and the middle of the view."""
    if view.scene is None:
        pytest.skip(f"no 3-D view can be made here: {view.note}")
    shown.evaluate("document.querySelector('.relief').scrollIntoView({block: 'center'})")
    # it keeps its size: a viewer that starts in a frame without one never draws
    shown.evaluate("document.querySelector('#viewer').style.visibility = 'hidden'")
    still = shown.screenshot(".relief")
    shown.evaluate("document.querySelector('#viewer').style.visibility = ''")
    assert poll(lambda: shown.screenshot(".relief") != still and settled(shown)), "nothing was drawn"
    return shown, middle_of(shown)


def middle_of(page):
    """Where the middle of the view is in the window now."""
    x, y, width, height = page.evaluate(
        "(r => [r.x, r.y, r.width, r.height])(document.querySelector('#viewer').getBoundingClientRect())"
    )
    return x + width / 2, y + height / 2


def settled(page):
    """Two pictures of the view at different times, alike; gives the last."""
    before = page.screenshot(".relief")
    time.sleep(0.4)
    after = page.screenshot(".relief")
    return after if after == before and colours(after) > 100 else None


def colours(png):
    """How many different values the scan lines of a PNG hold, as a sign of whether anything is drawn."""
    data, at = b"", 8
    while at < len(png):
        size = int.from_bytes(png[at : at + 4], "big")
        if png[at + 4 : at + 8] == b"IDAT":
            data += png[at + 8 : at + 8 + size]
        at += 12 + size
    return len(np.unique(np.frombuffer(zlib.decompress(data), dtype=np.uint8)))


def test_the_height_map_turns_when_it_is_dragged(relief):
    page, (x, y) = relief
    before = settled(page)
    page.drag((x, y), [(12, 4)] * 10)
    assert poll(lambda: (after := settled(page)) and after != before), "it does not turn"
    assert page.complaints() == []


def test_the_wheel_scrolls_the_page_and_keys_turn_the_map(relief):
    page, (x, y) = relief
    before, top = settled(page), page.evaluate("scrollY")
    page.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    page.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-200)
    assert poll(lambda: page.evaluate("scrollY") < top), "the page does not scroll"
    page.evaluate("document.querySelector('.relief').scrollIntoView({block: 'center'})")
    assert poll(lambda: settled(page)) == before, "the wheel moves the map"

    def turned():  # again where a busy machine had not scrolled back yet, or gave the key to the page
        page.drag(middle_of(page), [])  # a click, which gives the map the keys
        page.call("Input.dispatchKeyEvent", type="keyDown", key="ArrowLeft", code="ArrowLeft")
        return (after := settled(page)) and after != before

    assert poll(turned), "it does not turn"
    assert page.complaints() == []


def test_tables_say_what_the_record_says(shown, report):
    record = report[1]
    rows = shown.evaluate(
        "Object.fromEntries([...document.querySelectorAll('table[id]')].map(t => [t.id, "
        "[...t.tBodies[0].rows].map(r => [...r.cells].map(c => c.textContent.trim()))]))"
    )
    for row, c in zip(rows["contrasts"], record.details.contrasts, strict=False):
        wanted = [c.measured, c.predicted, c.measured - c.predicted, c.u, c.tolerance, c.guard]
        assert [number(cell) for cell in row[1:7]] == pytest.approx(wanted, abs=5.1e-4)
        assert row[9] == c.verdict
    assert [number(cell) for cell in rows["contrasts"][3][1:2]] == pytest.approx([1.2])
    budget = {row[0]: row[2:] for row in rows["budget"] + rows["small-budget"]}
    for row in record.budget:
        shown_values = [0.0 if cell.startswith("<") else number(cell) for cell in budget[row.source]]
        assert shown_values == pytest.approx(list(row.contributions), abs=5.1e-5)
    assert [row[0] for row in rows["budget"][:-1]] == [row.source for row in record.budget[:2]]
    for row, c in zip(rows["diagnosis"], record.diagnosis.causes, strict=True):
        assert (row[0], number(row[1])) == (c.title, pytest.approx(c.severity, rel=5e-3))
        assert row[2] == cause_range(c)
    for row, r in zip(rows["regions"], record.details.regions, strict=True):
        x, y = (number(part) for part in row[2].split("; "))
        assert (row[1], x, y) == (r.kind, pytest.approx(r.x, abs=5.1e-3), pytest.approx(r.y, abs=5.1e-3))
    assert [number(row[1]) for row in rows["shape"][:1]] == pytest.approx([8.9])
    assert [row[3:] for row in rows["comparisons"]] == [["no", "yes"], ["yes", "no"]]
    assert [number(row[1]) for row in rows["golden"]] == pytest.approx(
        record.details.golden.measured, abs=5.1e-4
    )
    assert [number(row[2]) for row in rows["lot"]] == pytest.approx([2.12, 0.14], abs=5.1e-4)
    assert [row[5] for row in rows["lot"]] == ["5 of 5", "5 of 5"]
    assert {row[0]: row[1] for row in rows["files"]} == {f.name: f.sha256 for f in record.inputs}


def test_it_says_why_and_how_to_check(shown, report):
    folder, record = report
    assert texts(shown, "#verdict") == ["FAIL"]
    assert "1 contrast lies outside the tolerance" in texts(shown, "#rule")[0]
    assert "−2.05° (95 %: −2.44° to −1.65°); cannot be distinguished from" in texts(shown, "#cause")[0]
    assert "5 other parts inspected before, 5 PASS" in texts(shown, "#lot-verdicts")[0]
    commands = texts(shown, "pre")[0]
    assert f"anisoscope verify {folder.name}" in commands
    assert f"anisoscope recompute {folder.name}" in commands
    poses = shown.evaluate(
        "[...document.querySelectorAll('.pose')].map(p => p.querySelectorAll('img').length)"
    )
    assert poses == [3] * len(record.poses)  # measured, predicted, difference
    assert shown.evaluate("document.querySelectorAll('.pose .marked svg use').length") == len(record.poses)
    assert [one.replace("\N{NO-BREAK SPACE}", " ") for one in texts(shown, "#finding")] == [
        record.conclusion.finding
    ]
    assert texts(shown, "#action") == [f"What to do next: {record.conclusion.action}"]
    told = shown.evaluate("document.body.textContent")
    particulars = record.particulars.model_dump(
        exclude_none=True
    ).values()  # a part in the middle has no place
    for value in (*particulars, record.camera, record.stage, record.software):
        assert value in told


UNREADABLE = """
(() => {
  const parse = c => (c.match(/[\\d.]+/g) || []).map(Number);
  const light = c => { const [r, g, b] = c.map(v => (v /= 255) <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4);
                       return .2126 * r + .7152 * g + .0722 * b; };
  const found = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const text = walker.currentNode.nodeValue.trim(), element = walker.currentNode.parentElement;
    if (!text || element.closest("caption, style, script")) continue;
    let behind = element;
    while (behind && (parse(getComputedStyle(behind).backgroundColor)[3] ?? 1) === 0) behind = behind.parentElement;
    const grounds = [parse(getComputedStyle(behind).backgroundColor).slice(0, 3)];
    if (element.closest(".bar")) {
      const probe = document.createElement("i");
      probe.style.color = "var(--bar)"; document.body.append(probe);
      grounds.push(parse(getComputedStyle(probe).color).slice(0, 3)); probe.remove();
    }
    const style = getComputedStyle(element), size = parseFloat(style.fontSize);
    const needed = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700) ? 3 : 4.5;
    for (const ground of grounds) {
      const [low, high] = [light(parse(style.color).slice(0, 3)), light(ground)].sort((a, b) => a - b);
      const ratio = (high + .05) / (low + .05);
      if (ratio < needed) found.push([text.slice(0, 40), ratio.toFixed(2)]);
    }
  }
  return found;
})()
"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("verdict", ["PASS", "FAIL", "INCONCLUSIVE", "INVALID"])
def test_text_stands_out_from_its_ground(page, tmp_path, make_report_record, scheme, verdict):
    """WCAG 2.2, 1.4.3: 4.5 to 1, for large text 3 to 1."""
    contrasts = [c.model_dump() | {"verdict": verdict} for c in make_report_record().details.contrasts]
    record = make_report_record(verdict=verdict, contrasts=contrasts)
    path, sections = tmp_path / REPORT_NAME, surface_sections(record, Pictures(), plastic_words())
    path.write_text(report_page(record, Pictures(), tmp_path, None, sections), encoding="utf-8")
    try:
        page.prefer(scheme)
        page.open(path.as_uri())
        assert page.evaluate(UNREADABLE) == []
        ground = page.evaluate("getComputedStyle(document.querySelector('main')).backgroundColor")
        assert (ground == "rgb(255, 255, 255)") == (scheme == "light")
    finally:
        page.prefer("")


def test_drawings_follow_the_screen_and_stay_light_on_paper(shown):
    light = shown.screenshot("figure img[alt^=Deviations]")
    try:
        shown.prefer("dark")
        assert poll(lambda: shown.screenshot("figure img[alt^=Deviations]") != light)
        shown.prefer("dark", "print")
        assert shown.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
        assert shown.evaluate("getComputedStyle(document.body).color") == "rgb(28, 39, 51)"
    finally:
        shown.prefer("")


def test_headings_tables_and_frames_can_be_read_aloud(shown):
    levels = shown.evaluate("[...document.querySelectorAll('h1,h2,h3')].map(h => Number(h.tagName[1]))")
    assert levels[0] == 1
    assert all(later - earlier <= 1 for earlier, later in itertools.pairwise(levels))
    assert shown.evaluate("document.documentElement.lang") == "en"
    assert shown.evaluate("[...document.querySelectorAll('th')].filter(h => !h.scope).length") == 0
    assert shown.evaluate("[...document.querySelectorAll('table')].filter(t => !t.caption).length") == 0
    assert (
        shown.evaluate(
            "[...document.querySelectorAll('tbody tr')].filter(r => !r.querySelector('th')).length"
        )
        == 0
    )
    assert shown.evaluate(
        "[...document.querySelectorAll('iframe')].every(f => f.title && f.sandbox == 'allow-scripts')"
    )


def test_on_paper_nothing_is_cut_off_and_the_still_picture_stands_for_the_3d_view(shown, view):
    shown.prefer("light", "print")
    shown.call(
        "Emulation.setDeviceMetricsOverride", width=688, height=1000, deviceScaleFactor=1, mobile=False
    )  # 182 mm at 96 dpi
    wide = "[...document.querySelectorAll('main, .wide, table, pre')].filter(e => e.scrollWidth > e.clientWidth + 1)"
    assert shown.evaluate(f"{wide}.map(e => e.id || e.className || e.tagName)") == []
    if view.scene is not None:
        assert shown.evaluate("getComputedStyle(document.querySelector('#viewer')).display") == "none"
        assert shown.evaluate("document.querySelector('.relief img').getBoundingClientRect().width") > 200
    assert shown.evaluate("document.querySelector('#small-budget').getBoundingClientRect().height") > 10
    tall = "[...document.querySelectorAll('figure')].filter(f => f.getBoundingClientRect().height > 1000)"
    assert shown.evaluate(f"{tall}.length") == 0
    told = shown.call("Page.printToPDF", preferCSSPageSize=True, printBackground=True)["data"]
    assert len(told) > 10_000


@pytest.mark.parametrize("width", [360, 800, 1280, 1600])
def test_nothing_overflows_sideways(shown, report, width):
    shown.open((report[0] / "report.html").as_uri(), width=width)
    assert shown.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
    if width >= 1280:
        cut = "[...document.querySelectorAll('.wide')].filter(e => e.scrollWidth > e.clientWidth + 1)"
        assert shown.evaluate(f"{cut}.map(e => e.textContent.slice(0, 60))") == []


def spoiled(value, keep):
    """Every text of a record's content replaced, except those that are checked or looked up."""
    if isinstance(value, dict):
        return {key: part if key in keep else spoiled(part, keep) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [spoiled(part, keep) for part in value]
    return EVIL if isinstance(value, str) else value


def test_texts_stay_texts(page, tmp_path, make_report_record, report_pictures):
    fixed = {"schema", "verdict", "kind", "surface", "deviation", "created_at", "taken_at", "cause", "test"}
    fixed |= {"origin"}
    content = spoiled(json.loads(make_report_record().model_dump_json(by_alias=True)), fixed)
    record = type(make_report_record()).model_validate(content)
    raw = tuple((EVIL, picture) for picture in report_pictures.aligned[:1])
    lot = Lot(EVIL, (LotPart(EVIL, EVIL, ()),))
    pictures = replace(report_pictures, surface=None, raw=raw, lot=lot)
    path, sections = tmp_path / REPORT_NAME, surface_sections(record, pictures, plastic_words())
    path.write_text(report_page(record, pictures, tmp_path, None, sections), encoding="utf-8")
    page.open(path.as_uri())
    assert page.complaints() == []
    assert page.requests() == [path.as_uri()]
    assert page.evaluate("document.querySelectorAll('script, iframe, [onerror], [onload], a').length") == 0
    assert page.evaluate("[...document.images].filter(i => !i.src.startsWith('data:image/')).length") == 0
    assert page.evaluate("document.title").endswith("anisoscope")
    said = page.evaluate("document.body.textContent")
    assert said.count("<script>document.title='owned'</script>") > 25
    assert "{{ 7*7 }}" in said
    stray = (
        "[...document.querySelectorAll('h1, .reasons li, dd, #files th')].filter(e => /[\\u202e\\u2066]/.test("
        "[...e.childNodes].filter(n => n.nodeType === 3).map(n => n.nodeValue).join('')))"
    )
    assert page.evaluate(f"{stray}.length") == 0  # direction marks end where their text does


def test_without_webgl_the_still_picture_shows(flat_page, report, view):
    if view.scene is None:
        pytest.skip(f"no 3-D view can be made here: {view.note}")
    address = (report[0] / "report.html").as_uri()
    flat_page.prefer("light")
    flat_page.open(address, height=900)
    assert not flat_page.evaluate("Boolean(document.createElement('canvas').getContext('webgl2'))")
    flat_page.evaluate("document.querySelector('.relief').scrollIntoView({block: 'center'})")
    seen = poll(lambda: settled(flat_page))
    flat_page.evaluate("document.querySelector('#viewer').remove()")
    assert seen
    assert (
        poll(lambda: settled(flat_page)) == seen
    )  # what is seen is the picture below the view, and nothing else
    assert flat_page.complaints() == []
    assert flat_page.requests() == [address]


def test_on_paper_no_paragraph_and_no_heading_is_torn_from_what_it_belongs_to(shown):
    shown.prefer("light", "print")
    style = "getComputedStyle(document.querySelector('{}')).{}"
    for what in ("p", "pre", "figure", "#budget"):
        assert shown.evaluate(style.format(what, "breakInside")) == "avoid", what
    for what in ("h2", "h3", "p:has(+ pre)"):
        assert shown.evaluate(style.format(what, "breakAfter")) == "avoid", what
    heights = "[...document.querySelectorAll('.row.two img')].map(i => i.getBoundingClientRect().height)"
    assert max(shown.evaluate(heights)) < 240.0  # 62 mm: two rows of maps and their words share a page
