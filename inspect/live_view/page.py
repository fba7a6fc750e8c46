"""Live picture in a browser of this machine: MJPEG over HTTP, for one camera and a few viewers.

Served on 127.0.0.1 only, below a path that nobody can guess. Requests for another host name are refused, so that no
page of the web can read the picture through a name that it lets point here (DNS rebinding). Who looks slowly misses
pictures; the camera never waits for anybody.
"""

import contextlib
import json
import math
import os
import secrets
import socket
import socketserver
import threading
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from types import TracebackType
from typing import Any, Self, cast

from anisoscope.base.errors import RigError
from anisoscope.rig.jogging import Jogger, commands_of

HOST = "127.0.0.1"
SLOW_S = 5.0
WAIT_S = 0.5
MAX_VIEWERS = 16
MAX_KEY = 16  # bytes of a key
BOUNDARY = "frame"

Number = float | int | str | None | list[float]


class LivePage:
    """The page; as a context manager it serves in threads of its own.

    Args:
        port: TCP port of 127.0.0.1; 0 takes any free one.
        title: what the page is headed with.
        jogger: moves the axes by keys that are pressed on the page; without it the page only shows.

    Attributes:
        address: what to open in a browser; whoever knows it can see the picture.

    Raises:
        RigError: the port is taken, or not a port number.
    """

    def __init__(self, port: int = 0, title: str = "anisoscope live", jogger: Jogger | None = None) -> None:
        if not 0 <= port < 65536:
            raise RigError(f"cannot serve on TCP port {port}; choose 1…65535, or 0 for any")
        self.feed = _Feed()
        self.token = secrets.token_urlsafe(24)
        self._nonce = secrets.token_urlsafe(16)
        self.jogger = jogger
        self.html = _render(title, self._nonce, jogs=jogger is not None)
        try:
            self._server = _Server(self, port)
        except OSError as problem:
            reason = problem.strerror or problem
            raise RigError(f"cannot serve on TCP port {port}: {reason}; choose another") from problem
        self.port = int(self._server.server_address[1])
        self.address = f"http://{HOST}:{self.port}/{self.token}/"
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.05}, name="live page", daemon=True
        )

    @property
    def policy(self) -> str:
        """Content security policy of the page: same origin only."""
        inline = f"'nonce-{self._nonce}'"
        return (
            f"default-src 'none'; img-src 'self' data:; connect-src 'self'; style-src {inline}; "
            f"script-src {inline}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )

    def publish(self, jpeg: bytes, numbers: Mapping[str, Number]) -> None:
        """Publish a picture and its numbers; returns at once. NaN is shown as an empty value."""
        plain = {name: or_none(value) for name, value in numbers.items()}
        if self.jogger is not None:
            plain["axes"] = self.jogger.state()
        self.feed.put(jpeg, json.dumps(plain).encode())

    def close(self) -> None:
        """End all streams, free the port, wait until both is done."""
        self.feed.end()
        if self._thread.is_alive():
            self._server.shutdown()
        self._server.hang_up()
        self._server.server_close()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def or_none(value: Number) -> Number:
    """The value, or None in place of NaN and infinity, which JSON does not have."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _render(title: str, nonce: str, *, jogs: bool) -> bytes:
    import jinja2  # noqa: PLC0415 - only who serves a page needs it

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("anisoscope.report"), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template("live.html").render(title=title, nonce=nonce, jogs=jogs).encode()


class _Feed:
    """Newest picture and its numbers; waiting threads are notified of the next."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._count = 0
        self._jpeg = b""
        self._ended = False
        self.numbers = b"{}"

    def put(self, jpeg: bytes, numbers: bytes) -> None:
        with self._condition:
            self._jpeg, self.numbers = jpeg, numbers
            self._count += 1
            self._condition.notify_all()

    def end(self) -> None:
        with self._condition:
            self._ended = True
            self._condition.notify_all()

    def newer_than(self, count: int) -> tuple[int, bytes] | None:
        """Number and bytes of the newest picture, once it is newer than `count`; None at the end."""
        with self._condition:
            while not self._ended and self._count <= count:
                self._condition.wait(WAIT_S)
            return None if self._ended else (self._count, self._jpeg)


class _Server(socketserver.ThreadingTCPServer):
    daemon_threads = False
    allow_reuse_address = os.name != "nt"  # on Windows this would let two programs share the port

    def __init__(self, page: LivePage, port: int) -> None:
        self.page = page
        self._open: set[socket.socket] = set()
        self._ending = False
        self._lock = threading.Lock()
        super().__init__((HOST, port), _Handler)

    def admit(self, connection: socket.socket) -> bool:
        """Register a connection, so that it ends with the page; False if there are too many, or the page ends."""
        with self._lock:
            self._open.add(connection)
            if self._ending:
                connection.shutdown(socket.SHUT_RDWR)
            return not self._ending and len(self._open) <= MAX_VIEWERS

    def dismiss(self, connection: socket.socket) -> None:
        with self._lock:
            self._open.discard(connection)

    def hang_up(self) -> None:
        """End every connection, also one blocked by a viewer that does not read."""
        with self._lock:
            self._ending = True
            for connection in self._open:
                with contextlib.suppress(OSError):  # who has gone already need not be hung up on
                    connection.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ANN401 - as the base class has it
        """Ignore errors of a connection: viewers come and go."""


class _Handler(BaseHTTPRequestHandler):
    timeout = SLOW_S
    server_version = "anisoscope"
    sys_version = ""

    @property
    def _page(self) -> LivePage:
        return cast("_Server", self.server).page

    def setup(self) -> None:
        super().setup()
        self._welcome = cast("_Server", self.server).admit(self.connection)

    def finish(self) -> None:
        cast("_Server", self.server).dismiss(self.connection)
        super().finish()

    def do_GET(self) -> None:
        if self._may_be_served():
            self._serve(self._requested_path())

    def do_POST(self) -> None:
        """A key of the page: its body is what a terminal sends for it."""
        if not self._may_be_served():
            return
        jogger = self._page.jogger
        if jogger is None or self._requested_path() != "key":
            self._answer(HTTPStatus.NOT_FOUND)
            return
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > MAX_KEY:
            self._answer(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
            return
        for command in commands_of(self.rfile.read(int(length))):
            jogger.do(command)
        self._answer(HTTPStatus.NO_CONTENT)

    def _may_be_served(self) -> bool:
        """Whether there is room, and the request is for this host; it is answered where not."""
        if not self._welcome:
            self._answer(HTTPStatus.SERVICE_UNAVAILABLE)
            return False
        if self.headers.get("Host", "") in {f"{HOST}:{self._page.port}", f"localhost:{self._page.port}"}:
            return True
        self._answer(HTTPStatus.MISDIRECTED_REQUEST)
        return False

    def _requested_path(self) -> str | None:
        """Path below the token; None if the token is wrong."""
        _, _, rest = self.path.partition("/")
        token, slash, name = rest.partition("/")
        known = secrets.compare_digest(token.encode("utf-8", "replace"), self._page.token.encode())
        return name if known and slash else None

    def _serve(self, name: str | None) -> None:
        match name:
            case "":
                self._answer(HTTPStatus.OK, "text/html; charset=utf-8", self._page.html)
            case "numbers.json":
                self._answer(HTTPStatus.OK, "application/json", self._page.feed.numbers)
            case "stream.mjpg":
                self._stream()
            case _:
                self._answer(HTTPStatus.NOT_FOUND)

    def _answer(self, status: HTTPStatus, kind: str = "text/plain", body: bytes = b"") -> None:
        self.send_response(status)
        self._send_head(kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def _send_head(self, kind: str) -> None:
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", self._page.policy)
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("X-Content-Type-Options", "nosniff")

    def _stream(self) -> None:
        # A backlog in the line would be shown as delay: what does not fit is better not sent.
        self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 17)
        self.send_response(HTTPStatus.OK)
        self._send_head(f"multipart/x-mixed-replace; boundary={BOUNDARY}")
        self.end_headers()
        self.wfile.write(f"--{BOUNDARY}\r\n".encode())
        count = 0
        while (newest := self._page.feed.newer_than(count)) is not None:
            count, jpeg = newest
            head = f"Content-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            # Browsers show a part when they see that it has ended: its end is sent along.
            self.wfile.write(head.encode() + jpeg + f"\r\n--{BOUNDARY}\r\n".encode())

    def log_message(self, format: str, *arguments: object) -> None:  # noqa: A002 - as the base class has it
        """Log nothing: the path contains the token."""
