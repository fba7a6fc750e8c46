"""The operator's day in a real browser, on a virtual rig."""

import re
import threading

import pytest

from anisoscope.history.store import open_history
from anisoscope.sim.bench.camera import SimulatedCamera

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def station(station_at):
    return station_at("day", recipe={"product": "<script>document.title='broken'</script> plate"})


@pytest.fixture(scope="module")
def address(served, app_of, station):
    with served(app_of(station[0])) as found:
        yield found


@pytest.fixture
def page(opened_page, address):
    with opened_page(address, but=("409", "404")) as found:
        found.locator("#holder").get_by_text(re.compile("rig")).wait_for()
        if found.locator("#verdict").is_visible():  # of the part before
            found.get_by_role("button", name="Next part").click()
        found.evaluate("$('take').hidden || $('take').click()")  # whose page is closed
        found.locator("#holder").get_by_text(re.compile("You hold the rig|free")).wait_for()
        yield found


def start(page, serial, lot=""):
    page.get_by_label("Serial number").fill(serial)
    page.get_by_label("Lot").fill(lot)
    page.get_by_role("button", name="Start", exact=True).click()


def test_a_day(page, station):
    page.locator("#focus-text").get_by_text("%").wait_for()
    page.get_by_role("button", name="Check the rig").click()
    page.locator("#checks .lamp").nth(5).wait_for()
    start(page, "D-1", "<img src=x onerror=\"document.title='broken'\">")
    verdict = page.locator("#verdict")
    verdict.get_by_text("PASS", exact=True).wait_for()
    assert "D-1 · <script>" in verdict.inner_text()
    assert page.locator("#frames img").count() == 8
    assert page.title().startswith("Station")
    page.get_by_role("button", name="Next part").click()
    assert not verdict.is_visible()
    station[0]._busy.join()
    page.get_by_role("link", name="Fleet").click()
    fleet = page.inner_text("main")
    assert re.search(r"Inspections: [1-9]", fleet)
    assert "D-1" in fleet
    with open_history(station[0].place.history) as history:
        history.dispose(1, reviewer="Q. Quast", decision="hold", comment="decided elsewhere")
    page.get_by_text("decided elsewhere").wait_for(timeout=120_000)  # without being loaded anew


def test_the_space_bar_stops_and_the_page_offers_to_resume(page, station, monkeypatch):
    grab, count, reached, go = SimulatedCamera.grab, [], threading.Event(), threading.Event()

    def wait_at_the_fifth(camera):
        count.append(threading.current_thread().name == "task")  # the others are of the live picture
        if sum(count) == 5:
            reached.set()
            go.wait()
        return grab(camera)

    with page.expect_response(re.compile("live.jpg")):
        pass
    with monkeypatch.context() as patch:
        page.get_by_label("Serial number").fill("D-2")
        patch.setattr(SimulatedCamera, "grab", wait_at_the_fifth)
        page.get_by_role("button", name="Start", exact=True).click()
        assert reached.wait(60)
        page.locator("#work").wait_for()
        before = len(station[1])
        with page.expect_response(re.compile("/stop$")):
            page.keyboard.press("Space")
        assert len(station[1]) == before + 1
        page.locator("#doing").get_by_text("Stopping: waits for the end of this step: ").wait_for()
        go.set()
        page.locator("#failure").get_by_text("stopped").wait_for()
    page.reload()
    page.get_by_role("button", name=re.compile("Resume D-2")).click()
    page.locator("#word").get_by_text("PASS", exact=True).wait_for()


def test_two_browsers_see_the_same_and_one_holds_the_rig(page, chromium, address):
    other = chromium.new_context().new_page()
    other.set_default_timeout(60_000)
    other.goto(address)
    start(page, "D-3")
    for one in (page, other):
        one.locator("#word").get_by_text("PASS", exact=True).wait_for()
    other.get_by_role("button", name="Next part").click()
    assert other.get_by_role("button", name="Start", exact=True).is_disabled()
    other.get_by_role("button", name="Ask for the rig").click()
    page.locator("#holder").get_by_text("asks for it").wait_for()
    page.get_by_role("button", name="Next part").click()
    page.get_by_role("button", name="Hand the rig over").click()
    other.locator("#holder").get_by_text("You hold the rig").wait_for()
    other.get_by_role("button", name="Hand the rig over").click()
    other.locator("#holder").get_by_text("free").wait_for()
    other.close()


def test_stop_is_answered_with_eight_pages_of_one_browser(page, station, chromium, address):
    context = chromium.new_context()
    seen = [context.new_page() for _ in range(8)]  # a browser has six connections to one server
    for one in seen:
        one.set_default_timeout(60_000)
        one.goto(address)
    for one in seen:
        one.locator("#holder").get_by_text(re.compile("rig")).wait_for()
        one.locator("#focus-text").get_by_text("%").wait_for()
    before = len(station[1])
    seen[-1].locator("#stop").click()
    seen[-1].locator("#stopping").get_by_text("Stopped: the axes stand still.").wait_for()
    assert len(station[1]) == before + 1
    seen[0].close()  # the page that follows the events for the others
    page.get_by_label("Serial number").fill("D-5")
    page.get_by_role("button", name="Start", exact=True).click()
    for one in seen[1:]:
        one.locator("#word").get_by_text("PASS", exact=True).wait_for()
    context.close()


def test_a_stop_without_answer_says_so(page):
    waiting = []

    def hold(route):
        waiting.append(route)

    page.route("**/api/v1/stop", hold)
    page.locator("#stop").click()
    page.locator("#stopping").get_by_text("Stopping …").wait_for()
    page.locator("#problem").get_by_text("STOP NOT CONFIRMED: use the emergency stop.").wait_for()
    waiting.pop().fulfill(json={"stage": "no answer within 0.5 s"})
    page.locator("#problem").get_by_text("emergency stop. stage: no answer within 0.5 s").wait_for()
    page.unroute("**/api/v1/stop")
    page.locator("#stop").click()
    page.locator("#stopping").get_by_text("Stopped: the axes stand still.").wait_for()
    assert not page.locator("#problem").is_visible()


def test_a_rig_is_free_once_its_holder_has_closed_the_page(page, chromium, address):
    context = chromium.new_context()
    other = context.new_page()
    other.set_default_timeout(60_000)
    other.goto(address)
    page.evaluate("$('release').hidden || $('release').click()")
    other.locator("#holder").get_by_text("free").wait_for()
    if other.locator("#verdict").is_visible():  # of the part before
        other.get_by_role("button", name="Next part").click()
    start(other, "D-6")
    other.locator("#word").get_by_text("PASS", exact=True).wait_for()
    page.locator("#holder").get_by_text("holds the rig.").wait_for()
    context.close()
    page.locator("#holder").get_by_text("The rig is free.").wait_for()


def test_guided_work_goes_by_steps(page, station):
    page.get_by_text("Rotation", exact=True).click()
    form = page.locator("form[data-guide=rotation]")
    form.get_by_label("Reason").fill("lens changed")
    form.get_by_role("button").click()
    page.locator("#guide-ask").get_by_text("Seat the fixture").wait_for()
    page.get_by_role("button", name="Start this step").click()
    page.locator("#guide-results .good table td").nth(3).wait_for()
    assert not page.locator("#guide-step").is_visible()
    assert page.locator("#guide-title").inner_text() == "Rotation – 1/1"
    page.screenshot(path=station[0].place.out / "guided.png", full_page=True)
    page.locator("#guide-end").click()
    page.locator("#guide").wait_for(state="hidden")
    (line,) = [line for line in station[0]._trail.lines() if line["what"] == "guided work"]
    assert line["why"] == "lens changed"


END_IS_IN_SIGHT = """() => {
  scrollTo(0, document.body.scrollHeight);
  const end = [...document.querySelectorAll('main > section')].at(-1).getBoundingClientRect().bottom;
  return end <= document.querySelector('.bar').getBoundingClientRect().top; }"""


def test_the_page_is_small_and_stop_is_in_sight_at_every_size(page):
    sizes = []
    page.on("response", lambda one: sizes.append(one) if "live" not in one.url else None)
    page.reload()
    page.locator("#stop").wait_for()
    for width, height in ((1024, 768), (1920, 1080), (390, 844)):
        page.set_viewport_size({"width": width, "height": height})
        box = page.locator("#stop").bounding_box()
        assert min(box["x"], box["y"]) >= 0
        assert box["x"] + box["width"] <= width
        assert box["y"] + box["height"] <= height
        assert box["height"] >= 48
        page.wait_for_function(END_IS_IN_SIGHT)  # whatever the live picture does meanwhile
    assert page.locator(".see").bounding_box()["y"] < page.locator(".choose").bounding_box()["y"], (
        "on a phone"
    )
    assert 20_000 < sum(int(one.headers.get("content-length", 0)) for one in sizes) < 200_000


def test_it_is_worked_by_the_keyboard_alone(page):
    page.get_by_label("Serial number").focus()
    page.keyboard.type("D-4")
    page.keyboard.press("Enter")
    page.locator("#word").get_by_text("PASS", exact=True).wait_for()
    assert page.evaluate("document.activeElement.id") == "next"
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.name") == "serial"


CONTRAST = """() => {
  const linear = x => (x /= 255) <= .03928 ? x / 12.92 : ((x + .055) / 1.055) ** 2.4;
  const light = c => { const v = c.match(/[\\d.]+/g).map(linear); return .2126 * v[0] + .7152 * v[1] + .0722 * v[2]; };
  const clear = c => c.endsWith(', 0)');
  const ground = e => { while (e && clear(getComputedStyle(e).backgroundColor)) e = e.parentElement;
    return e ? getComputedStyle(e).backgroundColor : 'rgb(255, 255, 255)'; };
  const speaks = e => e.offsetParent && [...e.childNodes].some(n => n.nodeType === 3 && n.data.trim());
  return [...document.querySelectorAll('body *')].filter(speaks).map(e => {
    const a = light(getComputedStyle(e).color), b = light(ground(e));
    return [(Math.max(a, b) + .05) / (Math.min(a, b) + .05), e.textContent.trim().slice(0, 40)];
  }).filter(x => x[0] < 4.5); }"""


def test_the_switch_on_top_changes_the_language_of_this_browser(page):
    page.locator("#language").select_option("de")
    page.get_by_role("heading", name="Teil", exact=True).wait_for()
    page.locator("#holder").get_by_text("Prüfstand").wait_for()
    page.locator("#language").select_option("en")
    page.get_by_role("heading", name="Part", exact=True).wait_for()


def test_texts_have_the_contrast_of_wcag_aa_and_every_control_a_name(page):
    assert page.evaluate(CONTRAST) == []
    unnamed = page.evaluate(
        "[...document.querySelectorAll('button, input, select, img, a')].filter(e => e.offsetParent && "
        "!(e.textContent.trim() || e.labels?.length || e.alt || e.ariaLabel)).map(e => e.outerHTML)"
    )
    assert unnamed == []
