"""What the console refuses of the network, and what it sends with every answer."""

import asyncio
import contextlib
import socket
from urllib.parse import urlsplit

import httpx
import pytest
from fastapi import APIRouter

from anisoscope.base.errors import UsageError
from anisoscope.console.access import Access
from anisoscope.console.application import check_exposure, create_app, listen, permissions_of
from anisoscope.console.trail import Trail


@pytest.fixture(scope="module")
def address(served, small_app):
    with served(small_app) as found:
        yield found


@pytest.fixture
def client(address):
    with httpx.Client(base_url=address, follow_redirects=True) as found:
        yield found


def raw(address, text):
    """What the server answers to bytes, up to its end of the connection."""
    with socket.create_connection((urlsplit(address).hostname, urlsplit(address).port)) as line:
        line.sendall(text.encode("latin-1"))
        found = b""
        while part := line.recv(65536):
            found += part
        return found.decode("latin-1")


def test_the_first_page_is_the_first_of_the_navigation(client):
    answer = client.get("/")
    assert answer.status_code == 200
    assert answer.url.path == "/fleet"
    assert "no accounts are set up" in answer.text


def test_every_answer_forbids_what_comes_from_elsewhere(client):
    for path in ("/fleet", "/static/console.css", "/nothing"):
        headers = client.get(path).headers
        assert headers["content-security-policy"].startswith("default-src 'none'; script-src 'self'")
        assert headers["x-content-type-options"] == "nosniff"
    cookie = httpx.get(f"{client.base_url}/fleet").headers["set-cookie"]
    assert {"HttpOnly", "SameSite=Lax"} <= set(cookie.split("; "))


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8040", "127.0.0.1", "localhost:1", ""])
def test_a_name_of_the_web_that_points_here_is_refused(client, host):
    assert client.get("/fleet", headers={"Host": host}).status_code == 421


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
        {},
        {"X-CSRF-Token": "guessed"},
    ],
)
def test_a_form_of_another_page_is_refused(client, headers):
    client.get("/fleet")  # brings the cookie, which a browser would send along
    assert client.post("/logout", headers=headers).status_code == 403


@pytest.mark.parametrize(
    "path",
    [
        "/static/../access.py",
        "/static/..%2faccess.py",
        "/static/%2e%2e/%2e%2e/etc/passwd",
        "/static//etc/passwd",
    ],
)
def test_no_path_leads_out_of_the_static_files(address, path):
    host = urlsplit(address).netloc
    answer = raw(address, f"GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n")
    assert answer.split()[1] == "404"


def test_large_bodies_are_refused_whether_they_say_so_or_not(client):
    assert client.post("/login", content=b"x" * 70_000).status_code == 413
    assert client.post("/login", content=(b"x" * 7000 for _ in range(10))).status_code == 413


def test_long_headers_are_refused(address):
    host = urlsplit(address).netloc
    answer = raw(address, f"GET /fleet HTTP/1.1\r\nHost: {host}\r\nX: {'x' * 20_000}")
    assert answer.split()[1] == "400"


def test_without_accounts_and_tls_other_computers_are_refused():
    check_exposure("127.0.0.1", users=False, tls=False)
    check_exposure("::1", users=False, tls=False)
    check_exposure("0.0.0.0", users=True, tls=True)
    for host in ("0.0.0.0", "192.168.1.4", "station.example", "::"):
        with pytest.raises(UsageError, match=r"accounts.* and TLS"):
            check_exposure(host, users=False, tls=False)
    with pytest.raises(UsageError, match="takes TLS"):
        check_exposure("0.0.0.0", users=True, tls=False)


def test_a_route_without_a_permission_is_refused_at_the_start(small_app):
    router = APIRouter()

    @router.get("/open")
    def route():
        return {}

    with pytest.raises(ValueError, match="GET /open names no permission"):
        create_app(Access(None, Trail(None)), [router], frozenset())
    routes = permissions_of(small_app(frozenset()))
    assert [path for path, needs in routes.items() if needs is None] == [("GET", "/static/{name}")]


def test_answers_do_not_wait_for_acknowledgements():
    """With Nagle's algorithm the body of an answer waits for the client's delayed ACK of its head: 40 ms a request."""

    async def without_delay():
        found = asyncio.get_running_loop().create_future()

        async def look(_, writer):
            accepted = writer.get_extra_info("socket")
            found.set_result(accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            writer.close()

        with contextlib.closing(listen("127.0.0.1", 0)) as listener:
            async with await asyncio.start_server(look, sock=listener):
                _, writer = await asyncio.open_connection(*listener.getsockname())
                try:
                    return await found
                finally:
                    writer.close()

    assert asyncio.run(without_delay())
