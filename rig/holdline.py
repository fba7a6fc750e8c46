"""Requests to the process that holds a rig open for others, and the stop of all that is held.

The socket is bound to 127.0.0.1. A request is a line of JSON, ``{"token", "device", "do", "args"}``, and so is its
answer, ``{"ok": …}`` or ``{"error", "text"}``. Without a device ``devices`` answers the names of all by their tables in
the rig file, and ``stop`` stops all axes. A stage knows ``describe``, ``is_homed``, ``motion_state``, ``position_deg``,
``home``, ``move_to``, ``move_by`` and ``stop``; a light ``describe``, ``on`` and ``off``; a camera ``describe``,
``configure`` and ``grab``, both with exposure in seconds and gain. The answer to a grab is ``{"ok": [rows, cols],
"bytes"}``, and so many bytes follow it: counts of 16 bits, little-endian, row by row. While something takes long the
owner sends empty lines: a client that hears nothing for `SILENCE_S` gives up. A stop needs a connection of its own and
waits for no other request.

Nothing heavy is imported here: a stop is sent while the rest of the program still loads.
"""

import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

from anisoscope.base import errors
from anisoscope.base.errors import NotConnected, RigError
from anisoscope.rig.portholder import Holder, servers

ALIVE_S, SILENCE_S = 0.5, 5.0
LONGEST_LINE = 65536


class HoldLine:
    """Requests to the owner of a port, one after the other; a connection that broke is made anew."""

    def __init__(self, holder: Holder) -> None:
        self._holder = holder
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None
        self._pending = b""

    def ask(self, device: str | None, do: str, *arguments: float | str) -> Any:  # noqa: ANN401
        """Answer of the owner.

        Raises:
            NotConnected: it has ended, or does not answer.
            AnisoscopeError: what it raised.
        """
        return self._request(device, do, arguments)["ok"]

    def fetch(self, device: str, do: str, *arguments: float) -> tuple[Any, bytearray]:
        """Answer of the owner, and the bytes that follow it; errors as for `ask`."""
        answer = self._request(device, do, arguments)
        return answer["ok"], answer.get("data", bytearray())

    def _request(self, device: str | None, do: str, arguments: tuple[float | str, ...]) -> dict[str, Any]:
        request = {"token": self._holder.token, "device": device, "do": do, "args": arguments}
        with self._lock:
            try:
                answer = self._exchange(json.dumps(request).encode() + b"\n")
            except OSError as problem:
                self.close()
                silent = isinstance(problem, TimeoutError)
                raise NotConnected(
                    f"process {self._holder.pid}, which holds {self._holder.port}, "
                    f"{'does not answer; look at its window' if silent else 'has ended; start the command again'}"
                ) from problem
            except BaseException:
                self.close()  # an answer that nobody waits for would be taken for that of the next request
                raise
        if "error" in answer:
            kind = getattr(errors, str(answer["error"]), RigError)
            raise kind(str(answer["text"]))
        return answer

    def describe(self, device: str) -> dict[str, Any]:
        """Description of the device; errors as for `ask`, after which nothing is open."""
        try:
            return cast("dict[str, Any]", self.ask(device, "describe"))
        except BaseException:
            self.close()
            raise

    def _exchange(self, request: bytes) -> dict[str, Any]:
        if self._socket is None:
            host, _, port = self._holder.serves_at.rpartition(":")
            self._socket = socket.create_connection((host, int(port)), timeout=SILENCE_S)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._pending = b""
        self._socket.sendall(request)
        while True:
            line, found, rest = self._pending.partition(b"\n")
            if not found:
                came = self._socket.recv(LONGEST_LINE)
                if not came:
                    raise ConnectionResetError
                self._pending += came
                continue
            self._pending = rest
            if line:
                answer = cast("dict[str, Any]", json.loads(line))
                if count := int(answer.get("bytes", 0)):
                    answer["data"] = self._receive(count)
                return answer

    def _receive(self, count: int) -> bytearray:
        assert self._socket is not None
        data = bytearray(count)
        begun = min(count, len(self._pending))
        data[:begun], self._pending = self._pending[:begun], self._pending[begun:]
        with memoryview(data) as rest:
            while begun < count:
                if not (came := self._socket.recv_into(rest[begun:])):
                    raise ConnectionResetError
                begun += came
        return data

    def close(self) -> None:
        """Let go of the owner."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def stop_held(rig: Path | None = None) -> dict[int, dict[str, str]]:
    """Stop all axes that other processes hold for others; of one rig file, if it is named.

    Returns:
        By process, by table: what went wrong, or "".

    Raises:
        NotConnected: one of these processes does not answer; the others were asked.
    """
    found: dict[int, dict[str, str]] = {}
    problems = []
    for holder in held_rigs(rig):
        line = HoldLine(holder)
        try:
            found[holder.pid] = line.ask(None, "stop")
        except NotConnected as problem:
            problems.append(str(problem))
        finally:
            line.close()
    if problems:
        raise NotConnected("; ".join(problems))
    return found


def held_rigs(rig: Path | None = None) -> Iterator[Holder]:
    """The processes that hold a rig for others; of one rig file, if it is named."""
    wanted = None if rig is None else str(rig.resolve())
    return (holder for holder in servers() if wanted is None or holder.rig == wanted)
