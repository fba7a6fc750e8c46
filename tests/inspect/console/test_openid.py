"""Login by OpenID Connect at a provider by others (Django OAuth Toolkit), which runs as a process and requires PKCE."""

import contextlib
import dataclasses
import json
import re
import sqlite3
import subprocess
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest
from fastapi import HTTPException
from jwcrypto.common import base64url_encode
from jwcrypto.jwk import JWK
from jwcrypto.jwt import JWT

from anisoscope.base.clock import VirtualClock
from anisoscope.base.errors import ConfigError, UsageError
from anisoscope.console import accounts as module_of_accounts
from anisoscope.console import openid as module
from anisoscope.console.access import SESSION_S, Access
from anisoscope.console.accounts import Accounts
from anisoscope.console.application import create_app
from anisoscope.console.openid import BEGUN_S, OpenId, Person, Provider, read_provider
from anisoscope.console.trail import trail_of
from anisoscope.parameters.serving import ConsoleSettings

ROLES = {"inspectors": "operator", "auditors": "auditor"}
PASSWORD = "correct horse battery"


@pytest.fixture(scope="module")
def provider(tmp_path_factory):
    """The folder and the issuer of a provider that runs."""
    folder = tmp_path_factory.mktemp("provider")
    command = [sys.executable, Path(__file__).with_name("openid_provider.py"), folder]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        yield folder, process.stdout.readline().strip()
        process.terminate()


def settings(issuer, **more):
    return Provider(issuer=issuer, client="console", secret="secret", roles=ROLES, **more)


@pytest.fixture
def users(tmp_path, monkeypatch):
    from argon2 import PasswordHasher

    quick = PasswordHasher(time_cost=1, memory_cost=64, parallelism=1)
    monkeypatch.setattr(module_of_accounts, "_hasher", lambda: quick)
    accounts = Accounts(tmp_path / "users.json")
    accounts.put("the operator", "operator", PASSWORD)
    return accounts


@pytest.fixture
def clock():
    return VirtualClock()


@pytest.fixture
def console(served, users, provider, clock):
    """``console(**more)``: a console with this provider; its address, its sessions and its trail."""
    with contextlib.ExitStack() as stack:

        def make(issuer=provider[1], **more):
            trail = trail_of(users.path)
            access = Access(users, trail, clock, openid=OpenId(settings(issuer, **more), clock))
            return stack.enter_context(served(lambda hosts: create_app(access, [], hosts))), access, trail

        yield make


class Browser:
    """A client that goes the way of a browser; its cookies are those of both sides."""

    def __init__(self, address):
        self.client = httpx.Client(base_url=address, timeout=60)

    def authorized(self, who):
        """Where the provider sends the browser of somebody who has begun to log in at the console."""
        self.client.cookies.delete("sessionid")  # of the login before, at the provider
        way = self.client.get("/openid/login")
        assert way.status_code == 303, way.text
        form = self.client.get(way.headers["location"], follow_redirects=True)
        token = re.search('name="csrfmiddlewaretoken" value="([^"]+)', form.text)[1]
        given = {"username": who, "password": "password", "csrfmiddlewaretoken": token}
        found = self.client.post(form.url, data=given)
        assert found.status_code == 302, found.text
        found = self.client.get(f"{form.url.scheme}://{form.url.netloc.decode()}{found.headers['location']}")
        return found.headers["location"]

    def log_in(self, who):
        return self.client.get(self.authorized(who))


@pytest.fixture
def browser_of():
    """``browser_of(address)``: a browser, closed at the end."""
    with contextlib.ExitStack() as stack:

        def make(address):
            found = Browser(address)
            stack.enter_context(found.client)
            return found

        yield make


def said(answer):
    """What a page complains about."""
    return re.search('role="alert" class="refused">([^<]+)<', answer.text)[1]


def session_of(access):
    return next(one for one in access._sessions.values() if one.begun is not None)


def test_a_person_of_the_provider_has_the_roles_of_its_claim(console, browser_of):
    address, access, trail = console()
    browser = browser_of(address)
    assert "Log in by localhost" in browser.client.get("/login").text
    answer = browser.log_in("otto")
    assert (answer.status_code, answer.headers["location"]) == (303, "/")
    (mine,) = (one for one in access._sessions.values() if one.roles)
    assert (mine.name, mine.roles) == ("otto", {"operator", "auditor"})
    assert browser.client.get("/audit").status_code == 200
    assert browser.client.get("/accounts").status_code == 403
    (line,) = trail.lines()
    assert (line["who"], line["what"]) == ("otto", "login")
    assert line["more"]["subject"]
    # local accounts go on beside it
    token = re.search('name="token" content="([^"]+)', browser.client.get("/login").text)[1]
    local = {"name": "the operator", "password": PASSWORD}
    assert browser.client.post("/login", json=local, headers={"X-CSRF-Token": token}).status_code == 200


def test_a_session_ends_though_its_page_stays_open(console, browser_of, clock):
    address, access, _ = console()
    browser_of(address).log_in("anna")
    (mine,) = (one for one in access._sessions.values() if one.roles)
    for _ in range(2):
        clock.sleep(0.49 * SESSION_S)
        assert access.find(mine.id) is mine
    clock.sleep(0.03 * SESSION_S)
    assert not access.holds(mine)
    assert access.find(mine.id) is None


def test_a_login_is_of_the_browser_that_began_it_and_once(console, browser_of):
    address, access, _ = console()
    browser, other = browser_of(address), browser_of(address)
    back = browser.authorized("anna")
    other.client.get("/openid/login")
    for one, way in ((other, back), (browser, re.sub("state=[^&]+", "state=guessed", back))):
        answer = one.client.get(way)
        assert (answer.status_code, said(answer)) == (
            400,
            "This browser has begun no such login: log in again.",
        )
    assert browser.client.get(back).status_code == 400, "the wrong state has ended it"
    assert not any(one.roles for one in access._sessions.values())
    back = browser.authorized("anna")
    assert browser.client.get(back).status_code == 303
    assert browser.client.get(back).status_code == 400


def test_a_code_that_has_expired_or_is_of_another_verifier_is_one_line(console, provider, browser_of):
    address, access, trail = console()
    browser = browser_of(address)
    back = browser.authorized("anna")
    with sqlite3.connect(provider[0] / "provider.sqlite") as database:
        database.execute("UPDATE oauth2_provider_grant SET expires = '2001-01-01 00:00:00'")
    answer = browser.client.get(back)
    expired = "The code of the login has expired or was used: log in again."
    assert (answer.status_code, said(answer)) == (401, expired)
    back = browser.authorized("anna")
    mine = session_of(access)
    mine.begun = dataclasses.replace(mine.begun, verifier="x" * 64)
    assert said(browser.client.get(back)) == expired, "the provider compares it with the challenge"
    assert [(line["what"], line["why"]) for line in trail.lines()] == [("login refused", expired)] * 2


def test_a_login_that_takes_too_long_is_one_line(console, clock, browser_of):
    address, _, _ = console()
    browser = browser_of(address)
    back = browser.authorized("anna")
    clock.sleep(BEGUN_S + 1.0)
    assert said(browser.client.get(back)) == "The login took too long: log in again."


@pytest.mark.parametrize(
    ("who", "words"),
    [
        ("eve", "eve has no role here: groups is sales, which the file of --openid gives none."),
        ("the operator", "There is an account the operator here: log in with its password."),
        ("The Operator", "There is an account the operator here: log in with its password."),
        ("the оperаtоr", "There is an account the operator here: log in with its password."),  # Cyrillic
        ("this computer", "There is an account this computer here: log in with its password."),
    ],
)
def test_people_without_a_role_or_with_the_name_of_an_account_are_refused(console, who, words, browser_of):
    address, _, _ = console()
    answer = browser_of(address).log_in(who)
    assert (answer.status_code, said(answer)) == (403, words)


def test_another_issuer_and_a_provider_that_is_away_are_one_line(console, provider, browser_of):
    issuer = provider[1]
    address, _, _ = console(f"{issuer}/")
    answer = browser_of(address).client.get("/openid/login")
    words = f"The provider calls itself {issuer}, not {issuer}/: mend the issuer in the file of --openid."
    assert (answer.status_code, said(answer)) == (502, words)
    for other in (issuer.removesuffix("/o"), "http://127.0.0.1:9"):
        address, _, _ = console(other)
        answer = browser_of(address).client.get("/openid/login")
        assert answer.status_code == 502
        assert "does not answer as an OpenID provider" in said(answer)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ({"iss": "https://evil.example", "code": "c"}, "The answer is not of localhost"),
        (
            {"error": "access_denied", "error_description": "not today"},
            "refused the login: access_denied not today",
        ),
    ],
)
def test_answers_of_others_and_refusals_of_the_provider(provider, answer, words):
    openid = OpenId(settings(provider[1]))
    _, begun = openid.begin("http://127.0.0.1:1/openid/return")
    with pytest.raises(HTTPException, match=words):
        openid.finish(begun, "http://127.0.0.1:1/openid/return", {"state": begun.state, **answer})


ISSUER, KEY = "https://login.example", JWK.generate(kty="RSA", size=2048, kid="k", use="sig", alg="RS256")
RIGHT = {
    "iss": ISSUER,
    "aud": "console",
    "sub": "1",
    "nonce": "n",
    "iat": time.time(),
    "exp": time.time() + 86_400,
}


def signed(header=None, key=KEY, **changes):
    token = JWT(
        {"alg": "RS256", "kid": "k"} | (header or {}),
        {k: v for k, v in (RIGHT | changes).items() if v is not None},
    )
    token.make_signed_token(key)
    return token.serialize()


def claims(token):
    keys = {"keys": [json.loads(KEY.export_public())]}
    return OpenId(settings(ISSUER))._claims({"id_token": token}, keys, "n")


def test_a_token_that_is_right():
    assert claims(signed(aud=["console", "other"], azp="console"))["sub"] == "1"


@pytest.mark.parametrize(
    "changes",
    [
        {"iss": "https://evil.example"},
        {"iss": None},
        {"aud": "other"},
        {"aud": None},
        {"aud": ["console", "other"], "azp": "other"},
        {"nonce": "m"},
        {"nonce": None},
        {"exp": time.time() - 3600},
        {"exp": None},
        {"sub": None},
        {"key": JWK.generate(kty="RSA", size=2048, kid="k")},
        {"header": {"alg": "HS256"}, "key": JWK(kty="oct", k=base64url_encode(KEY.export_to_pem()))},
    ],
)
def test_tokens_that_are_forged_old_or_of_others(changes):
    with pytest.raises(HTTPException, match=r"The token of login\.example cannot be trusted: \w+"):
        claims(signed(**changes))


def test_a_token_without_a_signature_or_that_is_none():
    head, body, _ = signed().split(".")
    for token in (f"eyJhbGciOiJub25lIn0.{body}.", f"{head}.{body}.", "x", None, 3):
        with pytest.raises(HTTPException, match="cannot be trusted"):
            claims(token)


@pytest.mark.parametrize(
    ("claim", "value", "roles"),
    [
        ("groups", "inspectors", {"operator"}),
        ("realm_access.roles", ["x", "auditors"], {"auditor"}),
        ("https://a.example/roles", ["inspectors"], {"operator"}),
    ],
)
def test_roles_are_of_a_text_a_list_or_within_tables(claim, value, roles):
    given = {claim: value} if ":" in claim or "." not in claim else {"realm_access": {"roles": value}}
    person = OpenId(settings(ISSUER, claim=claim))._person(
        {"sub": "1", "preferred_username": "anna", **given}
    )
    assert person.roles == roles


def test_a_second_person_of_one_name_is_refused_and_every_line_says_who_it_was(users, clock):
    trail = trail_of(users.path)
    access = Access(users, trail, clock, openid=OpenId(settings(ISSUER), clock))
    anna = Person("anna", frozenset({"operator"}), "4711")
    session = access.admit(anna, "10.0.0.1")
    assert access.admit(anna, "10.0.0.2").name == "anna"
    for name in ("anna", "Anna", "аnna"):
        with pytest.raises(HTTPException, match=r"Another person of login\.example is"):
            access.admit(Person(name, frozenset({"operator"}), "4712"), "10.0.0.1")
    trail.add(session.name, "stop")
    trail.add("the operator", "stop")
    said = [(one["who"], one["more"].get("issuer"), one["more"].get("subject")) for one in trail.lines()]
    assert said == [("anna", ISSUER, "4711")] * 3 + [("the operator", None, None)]


@pytest.mark.parametrize("verified", [False, "false", None])
def test_an_address_that_is_not_verified_is_no_name(verified):
    openid = OpenId(settings(ISSUER, name="email"))
    given = {"sub": "1", "email": "anna@plant.example", "groups": "inspectors"}
    assert openid._person(given).name == "anna@plant.example"
    assert openid._person(given | {"email_verified": True}).roles == {"operator"}
    with pytest.raises(HTTPException, match="gives no name"):
        openid._person(given | {"email_verified": verified})


class _Answers(BaseHTTPRequestHandler):
    """Answers with what the path asks for."""

    def log_message(self, *_):
        pass

    def do_GET(self):
        self.send_response(200)
        self.end_headers()
        if self.path == "/endless":
            with contextlib.suppress(OSError):
                while True:
                    self.wfile.write(b"x" * (1 << 16))
        elif self.path == "/slow":
            with contextlib.suppress(OSError):
                while True:
                    self.wfile.write(b"x")
                    time.sleep(0.05)
        else:
            said = {"sub": self.path[1:], "preferred_username": "anna", "groups": ["inspectors"]}
            self.wfile.write(json.dumps(said).encode())


@pytest.fixture
def answers():
    with ThreadingHTTPServer(("127.0.0.1", 0), _Answers) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.mark.parametrize("path", ["/endless", "/slow"])
def test_answers_without_end_are_cut_off(answers, path, monkeypatch):
    monkeypatch.setattr(module, "ANSWER_S", 1.0)
    openid = OpenId(settings(ISSUER))
    begun = time.monotonic()
    with openid._session("") as session, pytest.raises(HTTPException, match="does not answer as an OpenID"):
        openid._fetched(session, answers + path)
    assert time.monotonic() - begun < 5.0


def test_name_and_roles_that_the_token_lacks_are_asked_for(answers):
    openid = OpenId(settings(ISSUER))
    with openid._session("") as session:
        session.token = {"access_token": "a", "token_type": "Bearer"}
        found = openid._completed({"sub": "1"}, session, {"userinfo_endpoint": f"{answers}/1"})
        assert openid._person(found) == Person("anna", frozenset({"operator"}), "1")
        with pytest.raises(HTTPException, match="is of another person than its token"):
            openid._completed({"sub": "1"}, session, {"userinfo_endpoint": f"{answers}/2"})
        with pytest.raises(HTTPException, match="does not answer as an OpenID"):
            openid._completed({"sub": "1"}, session, {"userinfo_endpoint": "http://elsewhere.example/1"})
        assert openid._completed({"sub": "1"}, session, {}) == {"sub": "1"}


@pytest.mark.parametrize("name", [None, "", "a\nb", "x" * 81, ["anna"]])
def test_a_name_that_is_none_is_refused(name):
    with pytest.raises(HTTPException, match="gives no name"):
        OpenId(settings(ISSUER))._person({"sub": "1", "preferred_username": name, "groups": "inspectors"})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('issuer = "http://login.example"\nclient = "c"\nroles = {a = "operator"}', "issuer: .*https://"),
        ('issuer = "https://login.example"\nclient = "c"\nroles = {a = "king"}', "roles.a"),
        ('issuer = "https://login.example"\nclient = "c"\nroles = {}', "roles"),
        ('issuer = "https://login.example"\nroles = {a = "operator"}', "client"),
    ],
)
def test_a_file_that_cannot_be_used(tmp_path, text, words):
    (tmp_path / "openid.toml").write_text(text)
    with pytest.raises(ConfigError, match=words):
        read_provider(tmp_path / "openid.toml")


def test_the_option_goes_with_accounts(tmp_path):
    with pytest.raises(UsageError, match="--openid goes with --users"):
        ConsoleSettings(openid=tmp_path / "openid.toml")


@pytest.mark.browser
def test_in_a_browser_the_way_leads_back_with_a_role(chromium, console):
    address, _, _ = console()
    page = chromium.new_context().new_page()
    page.set_default_timeout(15_000)
    page.goto(f"{address}/login")
    page.get_by_role("link", name="Log in by localhost").click()
    page.get_by_label("Username").fill("otto")
    page.get_by_label("Password").fill("password")
    page.get_by_role("button", name="Log in").click()
    page.get_by_role("button", name="Log out").wait_for()
    assert page.locator(".who").inner_text().startswith("otto")
    assert page.url.startswith(address)
    page.goto(f"{address}/audit")
    page.get_by_text("No line was changed").wait_for()
    page.context.close()
