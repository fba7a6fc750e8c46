"""Clients that are slow, many, or say nothing; and TLS."""

import asyncio
import contextlib
import resource
import socket
import ssl
import threading
from urllib.parse import urlsplit

import httpx
import pytest
from fastapi import APIRouter, Depends
from fastapi.responses import StreamingResponse

from anisoscope.console import application
from anisoscope.console.access import Access, Needs
from anisoscope.console.application import MOST_CONNECTIONS, Connection, Guard, create_app
from anisoscope.console.trail import Trail

PATIENCE_S = 0.02
"""Of a server that is to lose its patience with clients that send nothing more."""


def connected(address, text=""):
    """A connection that has sent a text."""
    line = socket.create_connection((urlsplit(address).hostname, urlsplit(address).port), 60)
    line.sendall(text.encode())
    return line


def request(address, method="GET", path="/fleet", *headers):
    return "".join(
        f"{one}\r\n" for one in (f"{method} {path} HTTP/1.1", f"Host: {urlsplit(address).netloc}", *headers)
    )


class Endless:
    """A route whose answer has no end, and whether somebody still gets it."""

    def __init__(self):
        self.router, self.ended, self.go_on = APIRouter(), threading.Event(), threading.Event()

        @self.router.get("/flood", dependencies=[Depends(Needs("look"))])
        async def flood():
            return StreamingResponse(self.flood())

        @self.router.get("/waiting", dependencies=[Depends(Needs("look"))])
        async def waiting():
            return StreamingResponse(self.wait())

    async def flood(self):
        try:
            while True:
                yield b"x" * 65536
                await asyncio.sleep(0)
        finally:
            self.ended.set()

    async def wait(self):
        yield b"first"
        await asyncio.to_thread(self.go_on.wait)
        yield b"last"


@pytest.fixture
def endless():
    return Endless()


@pytest.fixture
def app_with(endless):
    return lambda hosts: create_app(Access(None, Trail(None)), [endless.router], hosts)


def test_headers_that_do_not_come_end_the_connection(served, small_app, monkeypatch):
    monkeypatch.setattr(Connection, "request_s", PATIENCE_S)
    with (
        served(small_app) as address,
        connected(address, request(address)) as line,
        connected(address) as mute,
    ):
        assert (line.recv(100), mute.recv(100)) == (b"", b"")


def test_a_body_that_does_not_come_is_refused(served, small_app, monkeypatch):
    monkeypatch.setattr(Guard, "body_s", PATIENCE_S)
    with served(small_app) as address:
        text = request(address, "POST", "/login", "Content-Length: 100", "", '{"name": ')
        with connected(address, text.removesuffix("\r\n")) as line:
            assert line.recv(1000).split()[1] == b"408"
            while line.recv(1000):
                pass


def test_who_reads_nothing_is_cut_off_and_what_was_made_for_it_ends(served, app_with, endless, monkeypatch):
    monkeypatch.setattr(Connection, "write_s", PATIENCE_S)
    with served(app_with) as address, connected(address, request(address, "GET", "/flood", "", "")) as line:
        assert endless.ended.wait(60)
        with contextlib.suppress(ConnectionResetError):  # after what was on its way
            while line.recv(1 << 20):
                pass


def test_a_thousand_connections_leave_room_for_others_and_end_no_answer(served, app_with, endless):
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 4096 if hard == resource.RLIM_INFINITY else min(4096, hard)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, wanted), hard))
    with served(app_with) as address, contextlib.ExitStack() as stack:
        first = stack.enter_context(httpx.stream("GET", f"{address}/waiting", timeout=60))
        parts = first.iter_raw()
        assert next(parts) == b"first"
        lines = [stack.enter_context(connected(address)) for _ in range(1000)]
        assert httpx.get(f"{address}/login", timeout=60).status_code == 200
        for line in lines[: 1000 - MOST_CONNECTIONS]:  # the oldest made room
            assert line.recv(1) == b""
        stack.enter_context(connected(address, request(address, "GET", "/login", "", ""))).recv(1)
        endless.go_on.set()
        assert next(parts) == b"last"


def client_of(address, tls):
    return httpx.Client(base_url=address, verify=ssl.create_default_context(cafile=tls[0]), timeout=60)


def test_it_is_served_by_tls_alone(served, small_app, tls):
    def secure_app(hosts):
        return create_app(Access(None, Trail(None), secure=True), small_app(hosts).state.routers[2:], hosts)

    with served(secure_app, tls) as address, client_of(address, tls) as client:
        answer = client.get("/fleet")
        assert answer.status_code == 200
        assert answer.headers["strict-transport-security"].startswith("max-age=")
        assert "Secure" in answer.headers["set-cookie"].split("; ")
        token = {"X-CSRF-Token": answer.text.partition('name="token" content="')[2].partition('"')[0]}
        plain = address.replace("https", "http")
        assert client.post("/logout", headers=token | {"Origin": plain}).status_code == 403
        assert client.post("/logout", headers=token | {"Origin": address}).status_code == 200
        with pytest.raises(httpx.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
            httpx.get(address)
        with pytest.raises(httpx.RemoteProtocolError):
            httpx.get(plain)


def test_who_begins_no_encryption_is_cut_off(served, small_app, tls, monkeypatch):
    monkeypatch.setattr(application, "REQUEST_S", PATIENCE_S)
    with served(small_app, tls) as address, connected(address) as line:
        assert line.recv(100) == b""
