"""The fleet page: what it shows, what it exports, what it refuses, and what no record can make it do."""

import csv
import html
import io
import json
import re
import shutil
from base64 import b64decode
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from urllib.parse import quote
from xml.etree import ElementTree as ET

import httpx
import numpy as np
import pytest
from PIL import Image

from anisoscope.base.clock import VirtualClock
from anisoscope.base.language import speaking
from anisoscope.console import fleet
from anisoscope.console.access import COOKIE, PERMISSIONS, Access
from anisoscope.console.accounts import ROLES, Accounts
from anisoscope.console.application import create_app, permissions_of
from anisoscope.console.fleet import fleet_router
from anisoscope.console.trail import Trail
from anisoscope.history import signs
from anisoscope.history.columns import to_us
from anisoscope.history.export import csv_lines, json_lines
from anisoscope.history.filters import Filters
from anisoscope.history.rows import NewRow, row_of
from anisoscope.history.signs import give_sign
from anisoscope.history.store import open_history
from anisoscope.quality.control import Settings, control_study
from anisoscope.quality.limits import individuals
from anisoscope.record.schema import write_record

START = datetime(2026, 11, 1, 6, 0, tzinfo=UTC)
NOW = START + timedelta(hours=10)
COUNT = 130
NASTY = "<script>alert('x')</script>\"'&{{ 7*7 }}"


def new_row(number, **changes):
    values = np.random.default_rng(number).normal(0.0, 0.05)
    values = {
        "created_at": START + timedelta(minutes=2 * number),
        "serial": f"A{number}",
        "product": "ridged plate",
        "recipe": "ridged plate 0123456789ab",
        "lot": f"L{number // 50}",
        "cavity": str(number % 4),
        "station": ("east", "west")[number % 3 == 0],
        "operator": "M. M.",
        "verdict": ("PASS", "PASS", "PASS", "FAIL", "INVALID")[number % 5],
        "reasons": (f"the ratio deviates by {values:+.3f} (tolerance ±0.25)",),
        "folder": f"/data/inspections/A{number}",
        "seal": sha256(str(number).encode()).hexdigest(),
        "software": "anisoscope 0.1.0",
        "numbers": {"ln 0-90": 2.1 + values, "deviation ln 0-90": values, "tolerance ln 0-90": 0.25}
        | ({"cause haze": 0.9} if number % 10 == 3 else {}),
    }
    return NewRow(**values | changes)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    found = tmp_path_factory.mktemp("fleet") / "history.sqlite"
    with open_history(found) as history:
        history.append_all([new_row(number) for number in range(COUNT)])
        history.dispose(7, reviewer="Q. Quast", decision="accept", comment="burrs are allowed here")
    return found


@pytest.fixture(scope="module")
def client_of(served):
    """``client_of(place, access)``: a client of a console that is served while the tests of this module run."""
    with ExitStack() as stack:

        def serve(place, access=None):
            app = lambda hosts: create_app(  # noqa: E731
                access or Access(None, Trail(None)), [fleet_router(place, lambda: NOW)], hosts
            )
            address = stack.enter_context(served(app))
            return stack.enter_context(httpx.Client(base_url=address, headers={"Accept": "text/html"}))

        yield serve


@pytest.fixture(scope="module")
def client(place, client_of):
    return client_of(place)


def text_of(page):
    return " ".join(re.sub(r"<[^>]+>", " ", page).split())


def listed(page):
    return [int(one) for one in re.findall(r'aria-label="inspection (\d+)"', page)]


def test_stations_show_what_the_history_knows_of_them(client, place):
    words = text_of(client.get("/fleet").text)
    assert f"Inspections: {COUNT}" in words
    # the last ones: 129 at west (a multiple of 3), 128 at east, at 4:18 and 4:16 after the start
    assert re.search(r"west no sign since .* 6 h ago .* 44 .* east no sign since .* 6 h ago .* 86 ", words)
    # 78 PASS of 104 that could be judged; the interval of Clopper and Pearson from R: binom.test(78, 104)
    assert "Yield 75.0 % (65.6 to 83.0 %)" in words
    assert "78 PASS, 26 FAIL, 26 INVALID" in words


def test_the_state_of_every_station_is_shown_and_silence_is_no_rest(tmp_path, client_of, monkeypatch):
    place, names = tmp_path / "history.sqlite", ("busy", "faulty", NASTY, "off", "silent")
    moment = to_us(NOW)
    monkeypatch.setattr(signs, "moment_us", lambda _: moment)
    with open_history(place) as history:
        history.append_all(
            [new_row(number, station=(*names, "unsigned")[number % 6]) for number in range(12)]
        )
        for name in names:
            give_sign(history, name, "running", "A9")
        moment += 40_000_000
        for name, doing, words in (
            ("busy", "running", f"A9 {NASTY}"),
            ("faulty", "fault", "the camera does not answer"),
            (NASTY, "idle", ""),
            ("off", "off", ""),
            ("new", "idle", ""),
        ):
            give_sign(history, name, doing, words)
    client = client_of(place)
    found = {one["station"]: one for one in client.get("/api/v1/stations").json()}
    assert {name: one["state"] for name, one in found.items()} == {
        "busy": "running",
        "faulty": "fault",
        NASTY: "idle",
        "off": "off",
        "new": "idle",
        "silent": "no sign",
        "unsigned": "no sign",
    }
    since = {name: datetime.fromisoformat(one["since"]) for name, one in found.items()}
    assert since["busy"] < since["faulty"]  # it runs on, since the first sign
    assert since["unsigned"] == START + timedelta(minutes=22)  # its last inspection
    assert found["faulty"]["words"] == "the camera does not answer"
    assert found["silent"]["words"] == found["off"]["words"] == ""
    page = client.get("/fleet").text
    assert "<script>alert" not in page
    words = text_of(page)
    assert re.search(r"faulty fault since [0-9:]+ the camera does not answer", words)
    assert re.search(r"new idle since [0-9:]+ 0 –", words)
    assert "new idle" not in text_of(client.get("/fleet?station=busy").text)


def test_a_view_is_drawn_once_for_all_and_anew_when_something_changed(tmp_path, served, monkeypatch):
    place, clock, drawn = tmp_path / "history.sqlite", VirtualClock(), []
    draw = fleet.drawn
    monkeypatch.setattr(fleet, "drawn", lambda *one, **more: drawn.append(one) or draw(*one, **more))
    with open_history(place) as history:
        history.append(new_row(1))
    app = lambda hosts: create_app(  # noqa: E731
        Access(None, Trail(None)), [fleet_router(place, lambda: NOW, clock)], hosts
    )
    with (
        served(app) as address,
        httpx.Client(base_url=address) as one,
        httpx.Client(base_url=address) as other,
    ):
        page = other.get("/fleet").text
        first = one.get("/fleet/view")
        assert html.unescape(re.search('data-mark="(.*?)"', page)[1]) == first.headers["etag"]
        assert first.text in page
        seen = {"If-None-Match": first.headers["etag"]}
        assert one.get("/fleet/view", headers=seen).status_code == 304
        assert len(drawn) == 1
        one.get("/fleet/view?station=west")
        assert len(drawn) == 2
        with open_history(place) as history:
            history.append(new_row(2))
            give_sign(history, "east", "running", "A3")
        assert one.get("/fleet/view", headers=seen).status_code == 304  # it asks the history once a second
        clock.sleep(1.0)
        second = one.get("/fleet/view", headers=seen)
        assert (second.status_code, listed(second.text)) == (200, [2, 1])
        assert "running since" in text_of(second.text)
        clock.sleep(1.0)
        with open_history(place) as history:
            history.dispose(2, reviewer="Q. Quast", decision="hold", comment="later")
        assert "Q. Quast" in one.get("/fleet/view", headers={"If-None-Match": second.headers["etag"]}).text
        assert len(drawn) == 4
        assert 'name="token"' not in first.text  # of no session


def test_the_list_has_pages_with_the_latest_first(client):
    pages = [listed(client.get(f"/fleet?page={number}").text) for number in (1, 2, 3, 4)]
    assert [one for page in pages for one in page] == list(range(COUNT, 0, -1))
    assert list(map(len, pages)) == [50, 50, 30, 0]


@pytest.mark.parametrize(
    ("query", "filters"),
    [
        ("station=west", Filters(station="west")),
        ("verdict=FAIL&cavity=3", Filters(verdict="FAIL", cavity="3")),
        ("lot=L1&product=ridged+plate", Filters(lot="L1")),
        ("serial=A77", Filters(serial="A77")),
        ("since=2026-11-01T09:00Z", Filters(since=START + timedelta(hours=3))),
        ("since=&until=&station=&verdict=&lot=L0", Filters(lot="L0")),
        ("since=7h&until=6h", Filters(since=NOW - timedelta(hours=7), until=NOW - timedelta(hours=6))),
        ("station=nowhere", Filters(station="nowhere")),
    ],
)
def test_filters_are_those_of_the_history_in_page_charts_and_exports(client, place, query, filters):
    with open_history(place) as history:
        rows = history.rows(filters)
    page = client.get(f"/fleet?{query}").text
    assert f"Inspections: {len(rows)}" in text_of(page)
    assert listed(page) == [row.id for row in rows[::-1][:50]]
    exported = client.get(f"/fleet/export/json?{query}").json()
    assert [one["id"] for one in exported] == [row.id for row in rows]
    assert client.get(f"/fleet/charts?{query}").status_code == 200


def test_causes_are_counted_and_lead_to_their_inspections(client):
    page = client.get("/fleet").text
    words = text_of(page)
    assert "the ratio deviates by … 39 75.0 % 75.0 % haze 13 25.0 % 100.0 %" in words
    assert listed(client.get("/fleet?cause=haze").text) == [n for n in range(COUNT, 0, -1) if n % 10 == 4]
    assert f"cause={quote('the ratio deviates by …').replace('%20', '+')}" in page


def test_exports_are_those_of_the_command(client, place):
    with open_history(place) as history, history.selection(Filters()) as chosen:
        table = "".join(csv_lines(chosen.decided(), chosen.labels()))
        text = "".join(json_lines(chosen.decided()))
    answer = client.get("/fleet/export/csv")
    assert answer.headers["content-disposition"] == 'attachment; filename="inspections.csv"'
    assert answer.content == table.encode()
    assert client.get("/fleet/export/json").content == text.encode()
    assert list(csv.DictReader(io.StringIO(answer.text)))[6]["disposition"] == "accept"
    assert client.get("/fleet/export/xml").status_code == 422


def test_a_chart_shows_the_limits_and_patterns_that_spc_computes(client, place):
    with open_history(place) as history:
        rows = [row for row in history.rows(Filters(cavity="2")) if row.verdict != "INVALID"]
        every = history.rows(Filters(cavity="2"))
    values = np.array([row.numbers["ln 0-90"] if row.verdict != "INVALID" else np.nan for row in every])
    study = control_study("", individuals(values, tuple(row.serial for row in every)), Settings())
    page = client.get("/fleet/charts?cavity=2&number=ln+0-90").text
    (svg,) = re.findall(r"<svg class=\"chart\".*?</svg>", page, re.DOTALL)
    drawn = ET.fromstring(svg)
    label = drawn.get("aria-label")
    assert f"{len(rows)} values of ln ratio 0° / 90°" in label
    for level in (study.limits.center, study.limits.lower, study.limits.upper, 1.85, 2.35):
        assert f"{level:.4g}" in label
    dots = drawn.findall("circle") + drawn.findall("rect")
    assert len(dots) == len(rows)
    # heights of the drawing are linear in the values
    heights = {one[0].text.split(":")[0]: float(one.get("cy") or float(one.get("y")) + 4.0) for one in dots}
    pairs = np.array([(row.numbers["ln 0-90"], heights[row.serial]) for row in rows])
    slope, offset = np.polyfit(pairs[:, 0], pairs[:, 1], 1)
    assert slope < 0.0
    assert np.abs(pairs[:, 1] - slope * pairs[:, 0] - offset).max() < 0.2
    assert len(re.findall("complete at", page)) == min(15, len(study.flags))


@pytest.mark.parametrize(
    ("lang", "words"),
    [("de", r"unter \d+ Werten|nicht stabil: "), ("da", r"blandt \d+ værdier|ikke stabil: ")],
)
def test_what_spc_says_is_in_the_language_of_the_page(client, lang, words):
    with speaking(lang):
        page = client.get("/fleet/charts?cavity=2&number=ln+0-90").text
    assert re.search(words, text_of(page))
    assert '<html lang="en"' not in page
    assert "stable" not in text_of(page)


def test_a_pattern_leads_to_the_inspection_that_completed_it(tmp_path, client_of):
    with open_history(tmp_path / "history.sqlite") as history:
        history.append_all(
            [
                new_row(
                    number, verdict="PASS", numbers={"ln 0-90": 0.01 * (number % 2) + 5.0 * (number == 20)}
                )
                for number in range(30)
            ]
        )
    page = client_of(tmp_path / "history.sqlite").get("/fleet/charts").text
    assert 'rule 1: one value beyond 3 sigma, complete at <a href="/fleet/inspections/21">A20</a>' in page


def problem_of(answer):
    """What a page says where something was refused."""
    return html.unescape(re.search('role="alert" class="refused">(.*)</p>', answer.text)[1])


def test_charts_for_each_cavity(client):
    words = text_of(client.get("/fleet/charts?by=cavity&number=deviation+ln+0-90").text)
    for cavity in range(4):
        assert f"cavity {cavity}" in words
    wrong = problem_of(client.get("/fleet/charts?number=none"))
    assert wrong.startswith("the selection: there is no number 'none'")
    few = client.get("/fleet/charts?serial=A1").text
    assert "ln ratio 0° / 90°, tilt 0°: " in few
    assert '<svg class="chart"' not in few


def test_a_history_that_is_not_there_or_empty(tmp_path, client_of):
    for place in (None, tmp_path / "history.sqlite"):
        client = client_of(place)
        assert "Inspections: 0" in text_of(client.get("/fleet").text)
        assert client.get("/fleet/charts").status_code == 200
        assert problem_of(client.get("/fleet/inspections/1")) == "the history has no inspection 1"
        assert problem_of(client.get("/fleet/export/csv")) == "there is no history yet"
    with open_history(tmp_path / "history.sqlite"):
        pass
    client = client_of(tmp_path / "history.sqlite")
    assert "Inspections: 0" in text_of(client.get("/fleet").text)
    assert client.get("/fleet/export/json").json() == []


@pytest.mark.parametrize(
    ("query", "status", "message"),
    [
        (f"station={'x' * 300}", 422, "query.station: String should have at most 200 characters"),
        (f"since={'9' * 100}", 422, "query.since: String should have at most 40 characters"),
        ("since=never", 409, "since takes 2026-11-01"),
        ("until=999999w", 409, "until takes 2026-11-01"),
        ("verdict=GOOD", 422, "query.verdict: Input should be 'PASS'"),
        ("page=0", 422, "query.page: Input should be greater than or equal to 1"),
        (f"page={'9' * 400}", 422, "query.page: "),
        ("by=operator", 422, "query.by: "),
        ("nothing=1", 422, "query.nothing: Extra inputs are not permitted"),
    ],
)
def test_what_makes_no_sense_gets_one_message(client, query, status, message):
    for path in ("/fleet", "/fleet/charts", "/fleet/export/csv"):
        page = client.get(f"{path}?{query}")
        assert page.status_code == status
        assert problem_of(page).startswith(message)
        answer = client.get(f"{path}?{query}", headers={"Accept": "application/json"})
        assert answer.status_code == status
        assert answer.json().keys() == {"error"}
        assert answer.json()["error"].startswith(message)
        assert len(answer.json()["error"]) < 250


@pytest.mark.parametrize("number", ["0", "-1", "x", "9" * 30, "1%00", "..%2f..%2fetc%2fpasswd"])
def test_no_inspection_has_such_a_number(client, number):
    for path in ("", "/report"):
        assert client.get(f"/fleet/inspections/{number}{path}").status_code in {404, 422}


def test_script_in_every_text_of_a_record_stays_text(tmp_path, client_of):
    texts = ("serial", "product", "lot", "cavity", "station", "operator", "software", "folder")
    changes = {name: f"{name} {NASTY}" for name in texts}
    changes |= {"reasons": (NASTY, f"two {NASTY}"), "recipe": f"{changes['product']} 0123456789ab"}
    place = tmp_path / "history.sqlite"
    with open_history(place) as history:
        rows = [
            new_row(
                n, **changes, verdict="FAIL", numbers={f"ln {NASTY}": 1.0 + 0.01 * n, f"cause {NASTY}": 1.0}
            )
            for n in range(20)
        ]
        history.append_all([*rows, new_row(30, **changes, verdict="FAIL")])
        history.dispose(21, reviewer=f"who {NASTY}", decision="hold", comment=f"why {NASTY}")
    client = client_of(place)
    pages = ["/fleet", "/fleet/charts", "/fleet/maps", "/fleet/inspections/21", "/fleet/inspections/1"]
    pages += [f"/fleet?station={quote(NASTY)}&cause={quote(NASTY)}&lot={quote(NASTY)}&serial={quote(NASTY)}"]
    pages += [f"/fleet/charts?by={by}" for by in ("station", "cavity", "lot", "product")]
    for path in pages:
        page = client.get(path).text
        assert "alert(" in page
        assert "<script>alert" not in page
        assert "{{ 7*7 }}" in page
        for tag in re.findall(r"<[a-zA-Z][^<>]*>", page):
            assert "alert('" not in tag  # no quote of a value ended its attribute
    answer = client.get("/fleet/inspections/21/report")
    assert answer.status_code == 404
    assert "alert(" in problem_of(answer)
    assert "<script>alert" not in answer.text


def reporting(client_of, place, inspected, **changes):
    """A client of a history with one real inspection, whose row is changed."""
    new = row_of(inspected.record, inspected.folder)
    fields = {name: getattr(new, name) for name in new.__dataclass_fields__}
    with open_history(place) as history:
        history.append(NewRow(**fields | changes))
    return client_of(place)


def test_a_report_on_this_computer_is_shown_without_any_right(client_of, tmp_path, inspected_part):
    _, inspected = inspected_part
    client = reporting(client_of, tmp_path / "history.sqlite", inspected)
    assert 'href="/fleet/inspections/1/report"' in client.get("/fleet/inspections/1").text
    answer = client.get("/fleet/inspections/1/report")
    assert answer.content == inspected.report.read_bytes()
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("sandbox allow-scripts allow-popups; default-src 'none'")
    assert "allow-same-origin" not in policy
    assert "connect-src" not in policy


def picture_of(uri):
    """Values of a picture, from -1, blue, by 0, white, to 1, red."""
    with Image.open(io.BytesIO(b64decode(uri.removeprefix("data:image/png;base64,")))) as found:
        rgb = np.asarray(found.convert("RGB"), dtype=float)
    return (
        np.where(rgb[..., 0] < rgb[..., 2], -1, 1)
        * (255.0 - rgb[..., 1])
        / np.where(rgb[..., 0] < rgb[..., 2], 191, 239)
    )


@pytest.fixture(scope="module")
def with_burrs(virtual_rigs):
    """A part with burrs, and one without."""
    rig = virtual_rigs("good")
    bad = virtual_rigs("burrs", bench={"sample": {"burr_coverage": 0.02}})
    return [rig.inspect(serial="good"), bad.inspect(serial="bad")]


def test_where_parts_deviate_is_laid_over_each_other(client_of, tmp_path, with_burrs):
    place = tmp_path / "history.sqlite"
    with open_history(place) as history:
        for one in with_burrs:
            folder = shutil.copytree(one.folder, tmp_path / one.folder.name)
            who = one.record.particulars.model_copy(update={"cavity": "3"})
            record = one.record.model_copy(update={"particulars": who})
            write_record(record, folder)
            history.append(row_of(record, folder))
        history.append(new_row(1, folder="/data/inspections/A1", station="east"))
    page = client_of(place).get("/fleet/maps")
    words = text_of(page.text)
    assert "cavity 3: 2 parts" in words
    assert "1 not on this computer: made at east in /data/inspections" in words
    share, mean = map(picture_of, re.findall(r'<image href="([^"]+)"', page.text))
    # from what was kept, by another way: cells above their limit, and ln ratios of poses that follow each other
    number, offs = 0.0, []
    for one in with_burrs:
        with np.load(one.folder / "measured.npz") as kept:
            score, limit, off = (np.asarray(kept[f"local_{name}"]) for name in ("score", "limit", "off"))
        offs.append(off.astype(float))
        number = number + (score > limit)
    assert number.max() >= 1
    np.testing.assert_allclose(share, number / number.max(), atol=0.01)
    both = np.mean(offs, axis=0)
    strongest = np.take_along_axis(both, np.abs(both).argmax(axis=0)[None], axis=0)[0]
    np.testing.assert_allclose(mean, strongest / np.abs(strongest).max(), atol=0.02)


def test_a_report_elsewhere_has_a_placeholder_that_says_where(client):
    page = text_of(client.get("/fleet/inspections/5").text)
    assert (
        "The report is not on this computer. It was written at station east, into /data/inspections/A4"
        in page
    )
    assert client.get("/fleet/inspections/5/report").status_code == 404


@pytest.mark.parametrize("attack", ["other folder", "other record", "changed", "link", "gone", "parents"])
def test_no_row_opens_another_file_of_this_computer(client_of, tmp_path, inspected_part, attack):
    _, inspected = inspected_part
    secret = tmp_path / "secret"
    secret.mkdir()
    (secret / "report.html").write_text("secret")
    changes = {
        "other folder": {"folder": str(secret)},
        "other record": {"seal": "ab" * 32},
        "parents": {"folder": f"{inspected.folder}/../../../secret"},
    }
    client = reporting(client_of, tmp_path / "history.sqlite", inspected, **changes.get(attack, {}))
    if attack in {"changed", "gone", "link"}:
        inspected.report.unlink()
    if attack == "changed":
        inspected.report.write_text("secret")
    if attack == "link":
        inspected.report.symlink_to(secret / "report.html")
    answer = client.get("/fleet/inspections/1/report")
    assert answer.status_code == 404
    assert "secret" not in problem_of(answer).replace(str(secret), "").replace("/secret", "")
    assert "placeholder" in client.get("/fleet/inspections/1").text


def test_a_sealed_folder_whose_report_lies_elsewhere_is_not_followed(client_of, tmp_path, inspected_part):
    _, inspected = inspected_part
    elsewhere = tmp_path / "elsewhere.html"
    shutil.move(inspected.report, elsewhere)
    inspected.report.symlink_to(elsewhere)  # the very bytes that the seal names
    client = reporting(client_of, tmp_path / "history.sqlite", inspected)
    assert client.get("/fleet/inspections/1/report").status_code == 404


def session_of(access, role):
    session = access.begin()
    session.name, session.roles = "anna", frozenset({role} if role else ())
    return session


def test_every_route_by_every_role(client_of, tmp_path, place):
    own = tmp_path / "history.sqlite"
    shutil.copy(place, own)
    access = Access(Accounts(tmp_path / "users.json"), Trail(tmp_path / "users.audit.jsonl"))
    routes = permissions_of(create_app(access, [fleet_router(own)], frozenset()))
    routes = {one: needs for one, needs in routes.items() if "/fleet" in one[1] or "stations" in one[1]}
    client = client_of(own, access)
    assert len(routes) == 9
    for (method, path), needs in routes.items():
        target = path.format(form="csv", number=7)
        for role in (None, *ROLES):
            session = session_of(access, role)
            given = {"json": {"decision": "hold", "reason": "to be looked at"}} if method == "POST" else {}
            for token in (session.token, "guessed"):
                headers = {
                    "X-CSRF-Token": token,
                    "Cookie": f"{COOKIE}_{client.base_url.port}={session.id}",
                    "Accept": "*/*",
                }
                answer = client.request(method, target, headers=headers, **given)
                if role is None:
                    assert answer.status_code == 401
                elif role not in PERMISSIONS[needs.permission] or (method == "POST" and token == "guessed"):
                    assert answer.status_code == 403
                else:
                    assert answer.status_code == (404 if path.endswith("/report") else 200)
    assert {needs.permission for needs in routes.values()} == {"look", "review"}
    with open_history(own) as history:  # engineer and auditor, by the right token only
        assert [one.reviewer for one in history.dispositions(7)] == ["Q. Quast", "anna", "anna"]


def test_a_disposition_enters_history_and_audit_trail_with_who_when_and_why(client_of, tmp_path, place):
    own = tmp_path / "history.sqlite"
    shutil.copy(place, own)
    access = Access(Accounts(tmp_path / "users.json"), Trail(tmp_path / "users.audit.jsonl", lambda: NOW))
    session = session_of(access, "engineer")
    client = client_of(own, access)
    client.cookies.set(f"{COOKIE}_{client.base_url.port}", session.id)
    client.headers["X-CSRF-Token"] = session.token
    path = "/fleet/inspections/9/dispositions"
    for wrong in (
        {"decision": "accept", "reason": ""},
        {"decision": "accept", "reason": "  "},
        {"decision": "accept"},
        {"decision": "perhaps", "reason": "x"},
        {"decision": "accept", "reason": "x" * 501},
        {"decision": "accept", "reason": "x", "reviewer": "the boss"},
    ):
        assert client.post(path, json=wrong).status_code == 422
    assert client.post(path.replace("9", "999"), json={"decision": "hold", "reason": "x"}).status_code == 404
    assert access.trail.lines() == []
    given = {"decision": "rework", "reason": f"deburr {NASTY}"}
    assert client.post(path, json=given).json()["reviewer"] == "anna"
    (line,) = access.trail.lines()
    assert (line["who"], line["at"], line["why"]) == (
        "anna",
        NOW.isoformat(timespec="milliseconds"),
        given["reason"],
    )
    assert line["more"] == {"inspection": 9, "serial": "A8", "decision": "rework"}
    with open_history(own) as history:
        (made,) = history.dispositions(9)
        assert (made.reviewer, made.decision, made.comment) == ("anna", "rework", given["reason"])
        assert history.row(9).verdict == "FAIL"
        assert history.verify_chain() == []
    assert "deburr" in client.get("/fleet/inspections/9").text
    exported = json.loads(client.get("/fleet/export/json?serial=A8").text)
    assert exported[0]["dispositions"][0]["decision"] == "rework"


def test_what_cannot_enter_the_audit_trail_is_not_decided(client_of, tmp_path, place):
    own = tmp_path / "history.sqlite"
    shutil.copy(place, own)
    access = Access(Accounts(tmp_path / "users.json"), Trail(own / "no folder.jsonl"))
    session = session_of(access, "engineer")
    client = client_of(own, access)
    client.cookies.set(f"{COOKIE}_{client.base_url.port}", session.id)
    answer = client.post(
        "/fleet/inspections/9/dispositions",
        json={"decision": "hold", "reason": "x"},
        headers={"X-CSRF-Token": session.token},
    )
    assert answer.status_code == 409
    with open_history(own) as history:
        assert history.dispositions(9) == []
