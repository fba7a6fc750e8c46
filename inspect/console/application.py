"""The application of the console, what guards it against the network, and the server that runs it."""

import asyncio
import contextlib
import functools
import logging
import socket
import ssl
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import uvicorn
from fastapi import APIRouter, Depends, FastAPI, HTTPException, Request, Response
from fastapi.dependencies.models import Dependant
from fastapi.exceptions import RequestValidationError
from fastapi.responses import HTMLResponse, JSONResponse, RedirectResponse
from fastapi.routing import APIRoute
from pydantic import BaseModel, ConfigDict, Field
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException as AnyHTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from anisoscope.base.address import is_loopback
from anisoscope.base.errors import AnisoscopeError, UsageError
from anisoscope.base.language import LANGUAGES, answering, language, of_browser
from anisoscope.console.access import SAFE_METHODS, SESSION_S, Access, Needs, Permission, Session, cookie_name
from anisoscope.console.accounts import ROLES, Accounts, Role
from anisoscope.console.openid import OpenId
from anisoscope.console.pages import render, static_router

MOST_BODY = 64 * 1024
HERE = "127.0.0.1"
BODY_S = 10.0
REQUEST_S = 10.0
WRITE_S = 30.0
KEPT_S = 15
MOST_LINES = 500
MOST_CONNECTIONS = 256
LANGUAGE_COOKIE = "language"
UNGUARDED = frozenset({"/static/{name}"})
"""Routes of which everybody may read the answer."""

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
HEADERS = {
    "content-security-policy": POLICY,
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "cache-control": "no-store",
}


class _TooSlow(Exception):
    pass


class Guard:
    """Refuses what no page of ours sends, before the application sees it, and adds headers to every answer.

    A name of the web that points to this computer (DNS rebinding) has a foreign Host; a form on a foreign page has a
    foreign Origin. Bodies are read here, whole and small, so that nobody holds a request open by sending slowly.

    Args:
        app: what is guarded.
        hosts: ``name:port`` by which browsers may call the console.
        scheme: http or https.
    """

    body_s = BODY_S

    def __init__(self, app: ASGIApp, hosts: frozenset[str], scheme: str) -> None:
        self.app, self.hosts = app, hosts
        self.origins = frozenset(f"{scheme}://{host}" for host in hosts)
        self.extra = {"strict-transport-security": "max-age=31536000"} if scheme == "https" else {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request of the server."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self.app(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                sent = {name.lower() for name, _ in message["headers"]}
                message["headers"] = [
                    *message["headers"],
                    *(
                        (name.encode(), text.encode())
                        for name, text in (HEADERS | self.extra).items()
                        if name.encode() not in sent
                    ),
                ]
            await send(message)

        refusal = self._refusal(scope)
        if refusal is None:
            try:
                body = await self._body(receive)
            except TimeoutError:
                refusal = 408, "the request did not arrive in time"
            else:
                if len(body) > MOST_BODY:
                    refusal = 413, f"a request has {MOST_BODY // 1024} KiB at most"
                else:
                    await self.app(scope, _replayed(body, receive), send_guarded)
                    return
        status, text = refusal
        answer = JSONResponse({"error": text}, status, headers={"connection": "close"})
        await answer(scope, receive, send_guarded)

    def _refusal(self, scope: Scope) -> tuple[int, str] | None:
        headers = Headers(scope=scope)
        if headers.get("host", "").lower() not in self.hosts:
            return 421, "the console does not answer to this name of the computer"
        length = headers.get("content-length", "0")
        if not length.isdigit() or int(length) > MOST_BODY:
            return 413, f"a request has {MOST_BODY // 1024} KiB at most"
        if scope["method"] in SAFE_METHODS:
            return None
        origin, site = headers.get("origin"), headers.get("sec-fetch-site", "none")
        if (origin is not None and origin.lower() not in self.origins) or site not in {"same-origin", "none"}:
            return 403, "requests of other pages are refused"
        return None

    async def _body(self, receive: Receive) -> bytes:
        found = b""
        async with asyncio.timeout(self.body_s):
            while len(found) <= MOST_BODY:
                message = await receive()
                found += message.get("body", b"")
                if not message.get("more_body", False):
                    break
        return found


def _replayed(body: bytes, receive: Receive) -> Receive:
    given = False

    async def replay() -> Message:
        nonlocal given
        if given:
            return await receive()
        given = True
        return {"type": "http.request", "body": body, "more_body": False}

    return replay


class Credentials(BaseModel):
    """Name and password of a login."""

    name: str = Field(max_length=80)
    password: str = Field(max_length=1000)


class _Reasoned(BaseModel):
    model_config = ConfigDict(extra="forbid")

    name: str = Field(max_length=80)
    why: str = Field(min_length=1, max_length=500, pattern=r"\S")


class NewAccount(_Reasoned):
    """An account to add, and why."""

    role: Role
    password: str = Field(max_length=1000)


class ChangedAccount(_Reasoned):
    """Change of an account, with its reason."""

    role: Role | None = None
    password: str | None = Field(None, max_length=1000)
    locked: bool | None = None


@dataclass(frozen=True)
class Page:
    """A page of the navigation: its path, its name in English, and what one has to be allowed to open it."""

    path: str
    name: str
    needs: Permission = "look"


def create_app(
    access: Access,
    routers: Sequence[APIRouter],
    hosts: frozenset[str],
    *,
    pages: Sequence[Page] = (),
    lang: str | None = None,
    closing: Callable[[], None] = lambda: None,
) -> FastAPI:
    """The application of the console.

    Args:
        access: sessions and accounts.
        routers: the routes; each route names what it needs (`anisoscope.console.access.Needs`).
        hosts: as for `Guard`.
        pages: the navigation, its first page is the start.
        lang: language of browsers whose user has chosen none; None: the browser's, if it is one of ours.
        closing: called at the end.

    Raises:
        ValueError: a route that names no permission.
    """

    @contextlib.asynccontextmanager
    async def lifespan(_: FastAPI) -> Any:  # noqa: ANN401 - as Starlette has it
        yield
        closing()

    app = FastAPI(
        title="anisoscope console",
        version="1",
        summary="Start, stop and follow inspections at a station, and read their results.",
        docs_url=None,  # these pages load from elsewhere
        redoc_url=None,
        openapi_url=None,
        lifespan=lifespan,
    )
    every = (static_router(), _login_router(access, pages), _accounts_router(access), *routers)
    every = (*every, *([] if access.openid is None else [_openid_router(access, access.openid)]))
    pages = (*pages, *([] if access.accounts is None else [Page("/accounts", "Accounts", "administer")]))
    pages = (*pages, *([] if access.trail.path is None else [Page("/audit", "Audit trail", "audit")]))
    app.state.access, app.state.pages, app.state.routers = access, tuple(pages), every
    for router in every:
        app.include_router(router)
    for (method, path), needs in permissions_of(app).items():
        if needs is None and path not in UNGUARDED:
            raise ValueError(f"{method} {path} names no permission")
    app.add_exception_handler(AnisoscopeError, _say_problem)
    app.add_exception_handler(AnyHTTPException, _say_http)
    app.add_exception_handler(RequestValidationError, _say_invalid)
    app.add_middleware(_NewCookies)
    app.add_middleware(_Language, lang=lang)
    app.add_middleware(Guard, hosts=hosts, scheme="https" if access.secure else "http")
    return app


def permissions_of(app: FastAPI) -> dict[tuple[str, str], Needs | None]:
    """Permission that every route of an application of `create_app` needs, by method and path.

    Raises:
        ValueError: a route of another sort, which would be answered without a question.
    """
    found: dict[tuple[str, str], Needs | None] = {}
    for route in (route for router in app.state.routers for route in router.routes):
        if not isinstance(route, APIRoute):
            raise ValueError(f"{route} is no route with dependencies")  # noqa: TRY004 - a fault of the program
        found |= {(method, route.path): _needs(route.dependant) for method in sorted(route.methods or ())}
    return found


def _needs(dependant: Dependant) -> Needs | None:
    return next((one.call for one in dependant.dependencies if isinstance(one.call, Needs)), None)


class _NewCookies:
    """Sends the cookie of a session that a request began."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        scope.setdefault("state", {})

        async def send_cookie(message: Message) -> None:
            session = scope["state"].get("new_session")
            if message["type"] == "http.response.start" and session is not None:
                secure = "; Secure" if scope["app"].state.access.secure else ""
                name = cookie_name(Request(scope))
                what = f"{name}={session.id}; Max-Age={SESSION_S:.0f}"
                cookie = f"{what}; HttpOnly; SameSite=Lax; Path=/{secure}"
                message["headers"] = [*message["headers"], (b"set-cookie", cookie.encode())]
            await send(message)

        await self.app(scope, receive, send_cookie)


class _Language:
    """Answers in the language that the user chose on the page, else the server's, else the browser's."""

    def __init__(self, app: ASGIApp, lang: str | None) -> None:
        self.app, self.lang = app, lang

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        request = Request(scope)
        chosen = request.cookies.get(LANGUAGE_COOKIE)
        if chosen not in LANGUAGES:
            chosen = self.lang or of_browser(request.headers.get("accept-language", "")) or language()
        with answering(chosen):
            await self.app(scope, receive, send)


def _wants_page(request: Request) -> bool:
    return request.method == "GET" and "text/html" in request.headers.get("accept", "")


async def _say_http(request: Request, error: Exception) -> Response:
    assert isinstance(error, AnyHTTPException)
    if error.status_code == 401 and _wants_page(request):
        return RedirectResponse("/login", 303)
    return _said(request, str(error.detail), error.status_code, error.headers)


def _said(request: Request, text: str, status: int, headers: Mapping[str, str] | None = None) -> Response:
    """A refusal: a page where a browser wants one, else JSON."""
    if not _wants_page(request) or not hasattr(request.state, "session"):
        return JSONResponse({"error": text}, status, headers=headers)
    page = render(request, "problem.html", text=text)
    page.status_code = status
    return page


async def _say_problem(request: Request, error: Exception) -> Response:
    return _said(request, " ".join(str(error).split()), 409)


async def _say_invalid(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    return _said(request, f"{where}: {first['msg'].removeprefix('Value error, ')}", 422)


def _login_router(access: Access, pages: Sequence[Page]) -> APIRouter:
    router = APIRouter(include_in_schema=False)
    Anyone = Annotated[Session, Depends(Needs(None))]

    @router.get("/")
    def start(_: Anyone) -> RedirectResponse:
        return RedirectResponse(pages[0].path if pages else "/login", 303)

    @router.get("/login")
    def page(request: Request, _: Anyone) -> HTMLResponse:
        return _login_page(request, access)

    @router.post("/login")
    def log_in(request: Request, given: Credentials, before: Anyone) -> dict[str, str]:
        if access.accounts is None:
            raise HTTPException(409, "there are no accounts: everybody at this computer may do everything")
        address = "" if request.client is None else request.client.host
        session = access.log_in(given.name, given.password, address)
        if session is None:
            raise HTTPException(401, "name or password is wrong")
        access.end(before)
        request.state.new_session = session
        return {"name": session.name, "token": session.token}

    @router.post("/logout")
    def log_out(session: Anyone) -> dict[str, str]:
        access.end(session)
        return {}

    return router


def _login_page(request: Request, access: Access, problem: str = "", status: int = 200) -> HTMLResponse:
    host = "" if access.openid is None else access.openid.host
    page = render(request, "login.html", provider=host, problem=problem)
    page.status_code = status
    return page


def _openid_router(access: Access, openid: OpenId) -> APIRouter:
    """The way to the OpenID provider, and back."""
    router = APIRouter(include_in_schema=False)
    Anyone = Annotated[Session, Depends(Needs(None))]

    def back(request: Request) -> str:
        return f"http{'s' * access.secure}://{request.headers['host']}/openid/return"

    @router.get("/openid/login")
    def leave(request: Request, session: Anyone) -> Response:
        try:
            address, session.begun = openid.begin(back(request))
        except HTTPException as problem:
            return _login_page(request, access, problem.detail, problem.status_code)
        return RedirectResponse(address, 303)

    @router.get("/openid/return")
    def come_back(request: Request, before: Anyone) -> Response:
        address = "" if request.client is None else request.client.host
        begun, before.begun = before.begun, None
        try:
            person = openid.finish(begun, back(request), request.query_params)
            session = access.admit(person, address)
        except HTTPException as problem:
            access.trail.add("", "login refused", problem.detail, address=address)
            return _login_page(request, access, problem.detail, problem.status_code)
        access.end(before)
        request.state.new_session = session
        return RedirectResponse("/", 303)

    return router


def _accounts(access: Access) -> Accounts:
    if access.accounts is None:
        raise HTTPException(409, "there are no accounts: `anisoscope user add` makes the first")
    return access.accounts


def _check_other(session: Session, name: str) -> None:
    if name == session.name:  # so that one administrator is left
        raise HTTPException(
            409, "another administrator has to change this account: you are logged in with it"
        )


def _accounts_router(access: Access) -> APIRouter:
    """Accounts, for administrators, and the audit trail; who changes an account says why."""
    router, trail = APIRouter(include_in_schema=False), access.trail
    Administrator = Annotated[Session, Depends(Needs("administer"))]

    @router.get("/accounts")
    def page(request: Request, session: Administrator) -> HTMLResponse:
        found = [] if access.accounts is None else list(access.accounts.read().values())
        return render(request, "accounts.html", accounts=found, roles=ROLES, me=session.name)

    @router.post("/accounts/add")
    def add(given: NewAccount, session: Administrator) -> dict[str, str]:
        known = _accounts(access)
        if given.name in known.read():
            raise HTTPException(409, f"there is an account '{given.name}' already")
        more = {"name": given.name, "role": given.role}
        known.put(
            given.name,
            given.role,
            given.password,
            lambda: trail.add(session.name, "account set", given.why, **more),
        )
        return more

    @router.post("/accounts/change")
    def change(given: ChangedAccount, session: Administrator) -> dict[str, str]:
        changes = given.model_dump(exclude_none=True, exclude={"why"})
        if set(changes) - {"name", "password"}:
            _check_other(session, given.name)
        said = changes | ({"password": "new"} if "password" in changes else {})
        _accounts(access).change(
            record=lambda: trail.add(session.name, "account changed", given.why, **said), **changes
        )
        return {"name": given.name}

    @router.post("/accounts/remove")
    def remove(given: _Reasoned, session: Administrator) -> dict[str, str]:
        _check_other(session, given.name)
        _accounts(access).remove(
            given.name, lambda: trail.add(session.name, "account removed", given.why, name=given.name)
        )
        return {"name": given.name}

    @router.get("/audit")
    def audit(request: Request, _: Annotated[Session, Depends(Needs("audit"))]) -> HTMLResponse:
        lines = trail.lines()
        shown = lines[: -MOST_LINES - 1 : -1]
        return render(request, "audit.html", lines=shown, count=len(lines), damaged=trail.damaged())

    return router


# The server.


class Connection(H11Protocol):
    """A connection that ends where its request comes or its answer is read too slowly, or others need its place."""

    most = MOST_CONNECTIONS
    request_s, write_s = REQUEST_S, WRITE_S

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin; where there are too many, those that wait for nothing make room, the oldest first."""
        super().connection_made(transport)  # type: ignore[arg-type]
        self._late: asyncio.TimerHandle | None = None
        self._unread: asyncio.TimerHandle | None = None
        self._expect()
        others: dict[Connection, None] = self.server_state.__dict__.setdefault("in_order", {})
        others[self] = None
        if len(others) > self.most:
            victim = next((one for one in others if not one.is_at_work), self)
            victim.transport.close()
            others.pop(victim, None)

    @property
    def is_at_work(self) -> bool:
        """Whether a request is being answered."""
        cycle: Any = self.cycle  # None before the first request, whatever its declaration says
        return cycle is not None and not cycle.response_complete

    def data_received(self, data: bytes) -> None:
        """Take what came; a request that has begun has to be complete in time."""
        super().data_received(data)
        self._expect()

    def _expect(self) -> None:
        if self.is_at_work:
            if self._late is not None:
                self._late.cancel()
                self._late = None
        elif self._late is None:
            self._late = self.loop.call_later(self.request_s, self._too_late)

    def _too_late(self) -> None:
        self._late = None
        if not self.is_at_work:
            self.transport.close()

    def pause_writing(self) -> None:
        """Wait for who reads slowly; who reads nothing for long is cut off."""
        super().pause_writing()
        self._unread = self.loop.call_later(self.write_s, self.transport.abort)

    def resume_writing(self) -> None:
        """Go on."""
        super().resume_writing()
        if self._unread is not None:
            self._unread.cancel()

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        for timer in (self._late, self._unread):
            if timer is not None:
                timer.cancel()
        self.server_state.__dict__.get("in_order", {}).pop(self, None)
        super().connection_lost(exc)


def hosts_of(host: str, port: int, names: Sequence[str] = ()) -> frozenset[str]:
    """``name:port`` by which a console is called that listens at an address."""
    known = {host, *names}
    if is_loopback(host):
        known |= {"127.0.0.1", "localhost", "[::1]"}
    return frozenset(f"{name.lower()}:{port}" for name in known)


def check_exposure(host: str, *, users: bool, tls: bool) -> None:
    """Refuse to listen beyond this computer without accounts and TLS.

    Raises:
        UsageError: one of them is missing.
    """
    if is_loopback(host):
        return
    missing = [
        *([] if users else ["accounts (--users FILE, from `anisoscope user add`)"]),
        *([] if tls else ["TLS (--certificate and --key)"]),
    ]
    if missing:
        raise UsageError(
            f"--host {host} can be reached from other computers: that takes {' and '.join(missing)}; without, the "
            "console serves 127.0.0.1 only"
        )


def listen(host: str, port: int, option: str = "--port") -> socket.socket:
    """A socket that listens; ``option`` chooses the port.

    Raises:
        UsageError: the port is taken, or there is no such address here.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # asyncio turns Nagle's algorithm off only where the protocol is stated: else each answer waits 40 ms for an ACK
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(512)
    except (OSError, OverflowError) as problem:
        listener.close()
        reason = getattr(problem, "strerror", None) or problem
        raise UsageError(f"cannot serve at {host}:{port}: {reason}; choose another {option}") from problem
    return listener


def server_of(
    app: ASGIApp, tls: tuple[Path, Path] | None = None, ending: Callable[[], None] = lambda: None
) -> uvicorn.Server:
    """The server of an application; ``server.run(sockets=[…])`` serves until ``should_exit`` is set or a signal comes.

    Args:
        app: from `create_app`.
        tls: certificate and key, PEM.
        ending: called before it waits for the end of its answers; ends those that have none.

    Raises:
        UsageError: certificate and key cannot be used.
    """
    options: Mapping[str, Any] = {}
    if tls is not None:
        certificate, key = tls
        options = {"ssl_certfile": certificate, "ssl_keyfile": key}
    config = uvicorn.Config(
        app,
        http=Connection,
        ws="none",
        log_config=None,
        access_log=False,
        server_header=False,
        timeout_keep_alive=KEPT_S,
        timeout_graceful_shutdown=2,
        h11_max_incomplete_event_size=16 * 1024,
        **options,
    )
    try:
        config.load()
    except (OSError, ssl.SSLError) as problem:
        raise UsageError(f"--certificate and --key cannot be used: {problem}") from problem
    logging.getLogger("uvicorn.error").setLevel(logging.ERROR)
    return _Server(config, ending)


def run_server(server: uvicorn.Server, listener: socket.socket, ended: threading.Event | None = None) -> None:
    """Serve until Ctrl-C, or until an event is set."""
    if ended is not None:

        def watch() -> None:
            ended.wait()
            server.should_exit = True

        threading.Thread(target=watch, name="end of the server", daemon=True).start()
    with contextlib.suppress(KeyboardInterrupt):
        server.run(sockets=[listener])


class _Server(uvicorn.Server):
    """A server that does not wait long for those who connect and do not say how they encrypt."""

    def __init__(self, config: uvicorn.Config, ending: Callable[[], None]) -> None:
        super().__init__(config)
        self._ending = ending

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._ending()
        await super().shutdown(sockets)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        loop = asyncio.get_running_loop()
        begin = loop.create_server
        if self.config.ssl is not None:
            begin = functools.partial(begin, ssl_handshake_timeout=REQUEST_S)
        loop.create_server = begin  # type: ignore[method-assign]
        await super().startup(sockets)
