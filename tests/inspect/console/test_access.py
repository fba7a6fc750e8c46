"""Accounts, sessions, the audit trail, and every route with every role."""

import contextlib
import io
import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from fastapi import HTTPException

from anisoscope.base.clock import VirtualClock
from anisoscope.base.errors import ConfigError, UsageError
from anisoscope.cli import run
from anisoscope.console import access as module
from anisoscope.console import accounts as module_of_accounts
from anisoscope.console.access import IDLE_S, LONGEST_WAIT_S, TRIES, TRIES_OF_ALL, Access
from anisoscope.console.accounts import Accounts
from anisoscope.console.application import create_app, permissions_of
from anisoscope.console.openid import OpenId, Provider
from anisoscope.console.trail import Trail, trail_of

ROLES = ("operator", "engineer", "auditor", "administrator")
EVERYBODY = {None, *ROLES}
LOGGED_IN = set(ROLES)
WORKERS = {"operator", "engineer"}
# Who may use which route; None is somebody without a login. Written down here, not read from the code.
TABLE = {
    ("GET", "/"): EVERYBODY,
    ("GET", "/login"): EVERYBODY,
    ("POST", "/login"): EVERYBODY,
    ("POST", "/logout"): EVERYBODY,
    ("GET", "/openid/login"): EVERYBODY,
    ("GET", "/openid/return"): EVERYBODY,
    ("GET", "/static/{name}"): EVERYBODY,
    ("GET", "/fleet"): LOGGED_IN,
    ("GET", "/fleet/view"): LOGGED_IN,
    ("GET", "/fleet/charts"): LOGGED_IN,
    ("GET", "/fleet/maps"): LOGGED_IN,
    ("GET", "/fleet/export/{form}"): LOGGED_IN,
    ("GET", "/fleet/inspections/{number}"): LOGGED_IN,
    ("GET", "/fleet/inspections/{number}/report"): LOGGED_IN,
    ("POST", "/fleet/inspections/{number}/dispositions"): {"engineer", "auditor"},
    ("GET", "/accounts"): {"administrator"},
    ("POST", "/accounts/add"): {"administrator"},
    ("POST", "/accounts/change"): {"administrator"},
    ("POST", "/accounts/remove"): {"administrator"},
    ("GET", "/audit"): {"auditor", "administrator"},
    ("GET", "/station"): LOGGED_IN,
    ("GET", "/inspections/{folder}/report.html"): LOGGED_IN,
    ("GET", "/api/v1/openapi.json"): LOGGED_IN,
    ("GET", "/api/v1/session"): LOGGED_IN,
    ("GET", "/api/v1/recipes"): LOGGED_IN,
    ("GET", "/api/v1/status"): LOGGED_IN,
    ("GET", "/api/v1/calibrations"): LOGGED_IN,
    ("GET", "/api/v1/resumable"): LOGGED_IN,
    ("GET", "/api/v1/events"): LOGGED_IN,
    ("GET", "/api/v1/live.jpg"): LOGGED_IN,
    ("GET", "/api/v1/frames/{number}.jpg"): LOGGED_IN,
    ("GET", "/api/v1/results"): LOGGED_IN,
    ("GET", "/api/v1/stations"): LOGGED_IN,
    ("POST", "/api/v1/take"): WORKERS,
    ("POST", "/api/v1/release"): WORKERS,
    ("POST", "/api/v1/start"): WORKERS,
    ("POST", "/api/v1/resume"): WORKERS,
    ("POST", "/api/v1/check"): WORKERS,
    ("POST", "/api/v1/stop"): LOGGED_IN,
    ("GET", "/api/v1/guides"): LOGGED_IN,
    ("POST", "/api/v1/guides/begin"): WORKERS,
    ("POST", "/api/v1/guides/step"): WORKERS,
    ("POST", "/api/v1/guides/end"): WORKERS,
}
PASSWORD = "correct horse battery"


@pytest.fixture(scope="module")
def quick():
    """Hashes that take no time; what argon2 takes is its own business."""
    from argon2 import PasswordHasher

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            module_of_accounts, "_hasher", lambda: PasswordHasher(time_cost=1, memory_cost=64, parallelism=1)
        )
        yield


@pytest.fixture(scope="module")
def accounts(quick, tmp_path_factory):
    found = Accounts(tmp_path_factory.mktemp("users") / "users.json")
    for role in ROLES:
        found.put(f"the {role}", role, PASSWORD)
    return found


@pytest.fixture
def clock():
    return VirtualClock()


@pytest.fixture
def access(accounts, clock):
    away = Provider(issuer="http://127.0.0.1:9", client="console", roles={"a": "operator"})
    return Access(accounts, Trail(None), clock, openid=OpenId(away, clock))


@pytest.fixture
def address(served, app_of, station_at, access):
    with served(app_of(station_at("users")[0], access)) as found:
        yield found


def client_of(address, role):
    client = httpx.Client(base_url=address, timeout=60)
    page = client.get("/login").text
    client.headers["X-CSRF-Token"] = page.partition('name="token" content="')[2].partition('"')[0]
    if role is not None:
        answer = client.post("/login", json={"name": f"the {role}", "password": PASSWORD})
        assert answer.status_code == 200
        client.headers["X-CSRF-Token"] = answer.json()["token"]
    return client


def test_every_route_with_every_role(address, served, app_of, station_at, access):
    app = app_of(station_at("users")[0], access)(frozenset())
    assert set(permissions_of(app)) == set(TABLE)
    ends = {("POST", "/login"), ("POST", "/logout")}  # these end the session: last
    for role in (None, *ROLES):
        with contextlib.closing(client_of(address, role)) as client:
            for (method, path), allowed in sorted(TABLE.items(), key=lambda one: one[0] in ends):
                if path == "/api/v1/events" and role in allowed:  # has no end
                    with client.stream(method, path) as answer:
                        assert answer.status_code == 200
                    continue
                where = (
                    path.replace("{name}", "icon.svg").replace("{folder}", "none").replace("{number}", "1")
                )
                if method == "POST":
                    wrong = {"X-CSRF-Token": "of another session"}
                    assert client.post(where, json={}, headers=wrong).status_code in {401, 403}, (role, path)
                answer = client.request(method, where, json={} if method == "POST" else None)
                refused = answer.status_code in {401, 403}
                assert refused == (role not in allowed), (role, method, path, answer.status_code, answer.text)


def test_a_page_without_a_login_leads_to_it(address):
    with httpx.Client(base_url=address, follow_redirects=True) as client:
        answer = client.get("/station", headers={"Accept": "text/html"})
    assert (answer.url.path, answer.status_code) == ("/login", 200)


def test_wrong_passwords_and_unknown_names_are_one_answer_and_soon_wait(address, access, clock):
    with contextlib.closing(client_of(address, None)) as client:
        answers = {
            (answer.status_code, answer.text)
            for name in ("the operator", "nobody")
            for answer in [client.post("/login", json={"name": name, "password": "wrong"})]
        }
        assert len(answers) == 1
        for _ in range(TRIES - 1):
            assert (
                client.post("/login", json={"name": "the operator", "password": "wrong"}).status_code == 401
            )
        right = {"name": "the operator", "password": PASSWORD}
        refused = client.post("/login", json=right)
        assert (refused.status_code, refused.headers["retry-after"]) == (429, "1")
        clock.sleep(1.1)
        assert client.post("/login", json=right).status_code == 200


def wait_of(access, name, address, password="wrong"):
    """Seconds that a try has to wait; 0 where it was checked."""
    try:
        access.log_in(name, password, address)
    except HTTPException as refused:
        return int(refused.headers["retry-after"])
    return 0


def test_sixty_wrong_passwords_at_once_are_five(accounts, access, monkeypatch):
    checked, together = [], threading.Barrier(60)

    def slowly(name, _):
        time.sleep(0.05)
        checked.append(name)

    monkeypatch.setattr(accounts, "check", slowly)

    def guess(number):
        together.wait()
        return wait_of(access, "the operator", "10.0.0.9", f"wrong-{number}") > 0

    with ThreadPoolExecutor(60) as pool:
        refused = sum(pool.map(guess, range(60)))
    assert (len(checked), refused) == (TRIES, 60 - TRIES)


def test_waits_double_up_to_a_minute_and_refused_tries_do_not_prolong_them(access, clock):
    assert [wait_of(access, "the operator", "10.0.0.9") for _ in range(TRIES)] == [0] * TRIES
    waits = []
    for _ in range(8):
        waits.append(wait_of(access, "the operator", "10.0.0.9"))
        assert wait_of(access, "the operator", "10.0.0.9") == waits[-1]
        clock.sleep(waits[-1])
        assert wait_of(access, "the operator", "10.0.0.9") == 0
    assert waits == [1, 2, 4, 8, 16, 32, 60, 60]
    clock.sleep(LONGEST_WAIT_S)
    assert access.log_in("the operator", PASSWORD, "10.0.0.9") is not None
    assert [wait_of(access, "the operator", "10.0.0.9") for _ in range(TRIES)] == [0] * TRIES


def test_a_month_of_wrong_passwords_locks_neither_the_administrator_nor_the_address(access, clock):
    """Somebody tries from two addresses whenever he may; the administrator works at a third, and one of his own."""
    assert access.log_in("the administrator", PASSWORD, "10.0.0.1") is not None
    assert access.log_in("the administrator", PASSWORD, "10.0.0.8") is not None
    tried = 0
    for _ in range(1500):
        for address in ("10.0.0.8", "10.0.0.9"):
            tried += wait_of(access, "the administrator", address) == 0
        for name in ("the operator", "nobody"):
            tried += wait_of(access, name, "10.0.0.1") == 0
        assert access.log_in("the administrator", PASSWORD, "10.0.0.1") is not None
        clock.sleep(30.0)
    assert tried < 5 * TRIES_OF_ALL + 4 * 1500 * 30 / LONGEST_WAIT_S


def test_a_name_tried_from_everywhere_waits_at_addresses_that_it_never_logged_in_from(access, clock):
    found = [wait_of(access, "the operator", f"10.0.{k}.9") for k in range(TRIES_OF_ALL + 5)]
    assert (found[:TRIES_OF_ALL], min(found[TRIES_OF_ALL:])) == ([0] * TRIES_OF_ALL, 1)
    clock.sleep(LONGEST_WAIT_S)
    assert wait_of(access, "the operator", "10.1.0.1") == 0
    networks = [wait_of(access, f"somebody {k}", f"2001:db8::{k:x}") for k in range(TRIES_OF_ALL + 5)]
    assert min(networks[TRIES_OF_ALL:]) == 1  # one network of IPv6 is one address


def test_a_session_in_which_nobody_works_may_only_look_and_stop(address, access, clock):
    with contextlib.closing(client_of(address, "engineer")) as client:
        clock.sleep(IDLE_S - 1.0)
        assert client.post("/api/v1/take").status_code == 200
        clock.sleep(IDLE_S - 1.0)
        assert client.get("/api/v1/status").status_code == 200  # of the page, not of a person
        clock.sleep(2.0)
        assert client.get("/api/v1/status").status_code == 200
        refused = client.post("/api/v1/take")
        assert (refused.status_code, refused.json()["error"]) == (
            401,
            "Nobody has worked here for a while: log in again.",
        )
        assert client.post("/api/v1/stop").status_code == 200


def test_a_lock_and_a_new_password_at_the_same_time_both_hold(quick, tmp_path, monkeypatch):
    accounts = Accounts(tmp_path / "users.json")
    accounts.put("anna", "operator", PASSWORD)
    hashing, locked = threading.Event(), threading.Event()
    plain = module_of_accounts._hash_of

    def slowly(password):
        hashing.set()
        assert locked.wait(10)
        return plain(password)

    monkeypatch.setattr(module_of_accounts, "_hash_of", slowly)
    with ThreadPoolExecutor(1) as pool:
        changing = pool.submit(accounts.change, "anna", password=PASSWORD + "!")
        assert hashing.wait(10)
        accounts.change("anna", locked=True)
        locked.set()
        changing.result(10)
    assert accounts.read()["anna"].locked
    assert accounts.check("anna", PASSWORD + "!") is None
    accounts.change("anna", locked=False)
    assert accounts.check("anna", PASSWORD + "!") is not None


def test_a_login_begins_a_session_of_its_own(address):
    with contextlib.closing(client_of(address, None)) as client:
        cookie = f"anisoscope_session_{client.base_url.port}"
        before = client.cookies[cookie]
        client.post("/login", json={"name": "the operator", "password": PASSWORD})
        after = client.cookies[cookie]
        assert before != after
        client.headers["X-CSRF-Token"] = client.get("/api/v1/session").json()["token"]
        assert client.post("/logout").status_code == 200
        assert client.get("/api/v1/status").status_code == 401


def test_a_session_ends_after_its_time(access, clock):
    session = access.begin()
    assert access.find(session.id) is session
    clock.sleep(module.SESSION_S + 1.0)
    assert access.find(session.id) is None


def test_those_who_work_keep_their_sessions_when_others_come(access):
    mine = access.log_in("the operator", PASSWORD, "127.0.0.1")
    for _ in range(module.MOST_SESSIONS + 10):
        access.begin()
    assert access.find(mine.id) is mine


def test_the_file_of_accounts_is_private_and_has_no_password(accounts):
    assert accounts.path.stat().st_mode & 0o077 == 0
    text = accounts.path.read_text()
    assert PASSWORD not in text
    assert text.count("$argon2id$") == len(ROLES)


@pytest.mark.parametrize(
    ("name", "role", "password"),
    [
        ("", "operator", PASSWORD),
        ("a\nb", "operator", PASSWORD),
        ("a", "king", PASSWORD),
        ("a", "operator", "short"),
    ],
)
def test_accounts_that_cannot_be(quick, tmp_path, name, role, password):
    with pytest.raises(UsageError):
        Accounts(tmp_path / "users.json").put(name, role, password)


def test_a_file_that_is_none_of_accounts(tmp_path):
    (tmp_path / "users.json").write_text('{"kind": "other"}')
    with pytest.raises(ConfigError, match="no file of accounts"):
        Accounts(tmp_path / "users.json")


@pytest.fixture
def administered(quick, served, tmp_path):
    """Accounts of an own file, their trail, and the address of a console with them."""
    known, trail = Accounts(tmp_path / "users.json"), trail_of(tmp_path / "users.json")
    for role in ROLES:
        known.put(f"the {role}", role, PASSWORD)
    with served(lambda hosts: create_app(Access(known, trail), [], hosts)) as address:
        yield known, trail, address


def test_accounts_are_changed_on_their_page_with_a_reason(administered):
    known, trail, address = administered
    boss, worker = client_of(address, "administrator"), client_of(address, "operator")
    with contextlib.closing(boss), contextlib.closing(worker):
        add = {"name": "<b>eve</b>", "role": "auditor", "password": "quite long enough"}
        for why in ({}, {"why": ""}, {"why": "  "}):
            assert boss.post("/accounts/add", json=add | why).status_code == 422
        assert boss.post("/accounts/add", json=add | {"why": "audits"}).status_code == 200
        assert boss.post("/accounts/add", json=add | {"why": "again"}).status_code == 409
        assert (
            boss.post("/accounts/add", json=add | {"name": "f", "password": "short", "why": "x"}).status_code
            == 409
        )
        assert "<b>eve" not in boss.get("/accounts").text
        assert "&lt;b&gt;eve" in boss.get("/accounts").text
        change = {"name": "the operator", "why": "left"}
        assert boss.post("/accounts/change", json=change | {"role": "engineer"}).status_code == 200
        assert worker.get("/audit").status_code == 401, "the session of the changed account has ended"
        assert boss.post("/accounts/change", json=change | {"locked": True}).status_code == 200
        assert known.check("the operator", PASSWORD) is None
        assert boss.post("/accounts/change", json=change | {"locked": False}).status_code == 200
        assert known.check("the operator", PASSWORD).role == "engineer"
        assert (
            boss.post("/accounts/change", json=change | {"password": "another password"}).status_code == 200
        )
        assert known.check("the operator", "another password") is not None
        assert boss.post("/accounts/remove", json=change).status_code == 200
        assert boss.post("/accounts/remove", json=change).status_code == 409
        me = {"name": "the administrator", "why": "mistake"}
        for path, more in (("remove", {}), ("change", {"locked": True}), ("change", {"role": "auditor"})):
            assert boss.post(f"/accounts/{path}", json=me | more).status_code == 409
        page = boss.get("/audit").text
    said = [(line["who"], line["what"], line["why"], line["more"]) for line in trail.lines() if line["why"]]
    assert said == [
        ("the administrator", "account set", "audits", {"name": "<b>eve</b>", "role": "auditor"}),
        ("the administrator", "account changed", "left", {"name": "the operator", "role": "engineer"}),
        ("the administrator", "account changed", "left", {"name": "the operator", "locked": True}),
        ("the administrator", "account changed", "left", {"name": "the operator", "locked": False}),
        ("the administrator", "account changed", "left", {"name": "the operator", "password": "new"}),
        ("the administrator", "account removed", "left", {"name": "the operator"}),
    ]
    assert "another password" not in trail.path.read_text()
    assert "No line was changed." in page
    assert page.count("account changed") == 4


def test_a_session_ends_with_what_it_was_given_for(administered):
    known, _, address = administered
    with contextlib.closing(client_of(address, "auditor")) as client:
        assert client.get("/audit").status_code == 200
        known.change("the engineer", locked=True)
        assert client.get("/audit").status_code == 200
        known.remove("the auditor")
        assert client.get("/audit").status_code == 401


def test_accounts_by_the_command_line(quick, tmp_path, capsys, monkeypatch):
    users = tmp_path / "users.json"
    monkeypatch.setattr("sys.stdin", io.StringIO(f"{PASSWORD}\n"))
    assert run(["user", "add", "anna", "--users", str(users), "--as", "operator", "--why", "new"]) == 0
    capsys.readouterr()
    assert run(["user", "list", "--users", str(users), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "users": {"anna": "operator"},
        "locked": [],
        "damaged_lines_of_the_trail": [],
    }
    assert Accounts(users).check("anna", PASSWORD).role == "operator"
    assert run(["user", "lock", "anna", "--users", str(users), "--why", "leave"]) == 0
    assert Accounts(users).check("anna", PASSWORD) is None
    assert run(["user", "unlock", "anna", "--users", str(users)]) == 0
    assert Accounts(users).check("anna", PASSWORD) is not None
    assert run(["user", "lock", "bo", "--users", str(users)]) == 64
    assert run(["user", "remove", "anna", "--users", str(users)]) == 0
    assert run(["user", "remove", "anna", "--users", str(users)]) == 64
    assert [(line["what"], line["why"]) for line in trail_of(users).lines()] == [
        ("account set", "new"),
        ("account changed", "leave"),
        ("account changed", ""),
        ("account removed", ""),
    ]
