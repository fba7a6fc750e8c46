"""The camera of a bench for other programs, over TCP on this machine; several clients at a time.

The protocol, version 1. The client sends one line of JSON, the server answers with one line of JSON, both end with a
line feed; where the answer has a key ``bytes``, so many raw bytes follow::

    {"do": "info"}
        {"protocol": 1, "model": …, "serial": …, "rows": …, "cols": …, "bit_depth": …, "black_level": …, "linear": …,
         "pixel_pitch_um": …, "auto_exposure": …, "filters": …}
    {"do": "configure", "exposure_s": 0.01, "gain": 1.0}
        {"exposure_s": 0.01, "gain": 1.0}                    what the camera really uses, for this client
    {"do": "grab"}
        {"rows": …, "cols": …, "bytes": …}                   then counts, row by row, uint16, little-endian
    anything that cannot be done
        {"error": "one line"}                                the connection stays open
"""

import contextlib
import json
import socket
import socketserver
import threading
from collections.abc import Callable
from dataclasses import asdict
from types import TracebackType
from typing import Any, Self, cast

from anisoscope.base.errors import AnisoscopeError, CameraError, RigError
from anisoscope.rig.camera import Camera

PROTOCOL = 1
MAX_LINE = 4096
POLL_S = 0.05


class CameraServer:
    """Server of a camera; a context manager, which serves in threads.

    Args:
        open_one: makes a camera for a client; each has settings of its own.
        port: port number of 127.0.0.1; 0 takes any free one.

    Attributes:
        port: what a client opens: ``host:port``.

    Raises:
        RigError: the port is taken, or not a port number.
    """

    def __init__(self, open_one: Callable[[], Camera], port: int = 0) -> None:
        if not 0 <= port < 65536:
            raise RigError(f"cannot serve on TCP port {port}; choose 1…65535, or 0 for any")
        try:
            self._server = _Server(open_one, port)
        except OSError as problem:
            raise RigError(
                f"cannot serve on TCP port {port}: {problem}; choose another, or 0 for any"
            ) from problem
        self.port = f"127.0.0.1:{self._server.server_address[1]}"
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": POLL_S}, name="camera", daemon=True
        )

    def close(self) -> None:
        """Hang up on all clients and release the port."""
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


class _Server(socketserver.ThreadingTCPServer):
    # a picture that is being rendered ends before the program: Python's end would cut it off within native code, and
    # that aborts the program
    daemon_threads = False
    block_on_close = False  # but closing does not wait for it

    def __init__(self, open_one: Callable[[], Camera], port: int) -> None:
        self.open_one = open_one
        self.clients: set[socket.socket] = set()
        super().__init__(("127.0.0.1", port), _Handler)

    def hang_up(self) -> None:
        for client in tuple(self.clients):
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ANN401 - as the base class has it
        """Clients come and go; a broken connection is theirs to notice."""


class _Handler(socketserver.StreamRequestHandler):
    disable_nagle_algorithm = True

    def handle(self) -> None:
        server = cast("_Server", self.server)
        server.clients.add(self.connection)
        camera = server.open_one()
        try:
            while line := self.rfile.readline(MAX_LINE):
                self.wfile.write(_answer(camera, line))
        finally:
            server.clients.discard(self.connection)
            camera.close()


def _answer(camera: Camera, line: bytes) -> bytes:
    try:
        request = json.loads(line)
        head, data = _do(camera, request)
    except AnisoscopeError as problem:
        head, data = {"error": " ".join(str(problem).split())}, b""
    except (ValueError, KeyError, TypeError):
        head, data = {"error": 'not understood; a request is a line such as {"do": "grab"}'}, b""
    return json.dumps(head).encode() + b"\n" + data


def _do(camera: Camera, request: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
    match request["do"]:
        case "info":
            return {"protocol": PROTOCOL, **asdict(camera.info)}, b""
        case "configure":
            settings = camera.configure(float(request["exposure_s"]), float(request["gain"]))
            return asdict(settings), b""
        case "grab":
            counts = camera.grab()
            data = counts.astype("<u2").tobytes()
            return {"rows": counts.shape[0], "cols": counts.shape[1], "bytes": len(data)}, data
        case other:
            raise CameraError(f"this camera knows info, configure and grab, not '{other}'")
